"""Objects of the package as plain JSON values, and back: what a program remembers, for a file.

Numbers, texts, containers, arrays, paths (by their names), and functions and objects of the packages in KEPT
are kept, the latter by their fields; nothing else is. Lists, dictionaries and objects that several others
hold stay shared. Equal objects give equal text, whatever machine made it.

Plain values may come from anybody. Reading them back imports modules of KEPT alone, runs no code but that of
classes which ask for it by `__getnewargs__`, and takes no more memory than some ten times that of the values.
"""

from __future__ import annotations

import importlib
import re
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum, EnumType
from fractions import Fraction
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np
from numpy.typing import NDArray

PACKAGE = __name__.split(".", maxsplit=1)[0]
KEPT = ("collect", "core", "formats", "pipeline", "segment")
PLAIN = (type(None), bool, int, float, str)
NUMBER = re.compile(r"[<>|][iufb][1248]")
"""Types of the numbers in arrays."""


class ThawError(ValueError):
    """The values do not stand for objects of this package."""


def frozen(value: Any) -> Any:
    """A value as lists of plain ones.

    Raises:
        TypeError: it holds something that is never kept, such as an open file.
    """
    return _Freezer().freeze(value)


def thawed(plain: Any) -> Any:
    """What `frozen` made the plain values of.

    Raises:
        ThawError: it made no such values.
    """
    try:
        return _Thawer().thaw(plain)
    except (ValueError, TypeError, LookupError, AttributeError, ImportError, ArithmeticError) as error:
        raise ThawError(f"{type(error).__name__}: {error}") from error


def _name(thing: Any) -> str:
    """Of a class or function of the package."""
    top, _, module = thing.__module__.partition(".")
    if top != PACKAGE or not module.startswith(KEPT) or "<" in thing.__qualname__:
        raise TypeError(f"{thing!r} cannot be kept")
    return f"{module}:{thing.__qualname__}"


def _named(name: str, kind: type) -> Any:
    module, _, place = name.partition(":")
    if module.partition(".")[0] not in KEPT:
        raise ThawError(f"{name} is never kept")
    thing: Any = importlib.import_module(f"{PACKAGE}.{module}")
    for part in place.split("."):
        thing = getattr(thing, part)
    if not isinstance(thing, kind) or _name(thing) != name:
        raise ThawError(f"{name} is no {kind.__name__}")
    return thing


def _attributes(value: Any) -> list[tuple[str, Any]]:
    """Names and values, in an order that does not depend on when they were set."""
    if is_dataclass(value):
        return [(field.name, getattr(value, field.name)) for field in fields(value)]
    return sorted(vars(value).items())


class _Freezer:
    """Numbers lists, dictionaries and objects in the order in which they are met."""

    def __init__(self) -> None:
        self._met: dict[int, int] = {}
        self._alive: list[Any] = []

    def freeze(self, value: Any) -> Any:
        kind = type(value)
        if kind in PLAIN:
            return value
        if (single := _single(value)) is not None:
            return single
        if kind is tuple:
            return ["tuple", *map(self.freeze, value)]
        if id(value) in self._met:
            return ["same", self._met[id(value)]]
        self._met[id(value)] = len(self._met)
        self._alive.append(value)
        return list(self._shared(value, kind))

    def _shared(self, value: Any, kind: type) -> Iterator[Any]:
        """Of what may be held several times: its kind, and what it holds."""
        if kind in (list, deque):
            yield kind.__name__
            yield from map(self.freeze, value)
        elif kind in (dict, Counter, defaultdict):
            yield kind.__name__
            if kind is defaultdict:
                yield _BUILT_IN_NAMES[value.default_factory]
            for key, held in value.items():
                yield self.freeze(key)
                yield self.freeze(held)
        elif hasattr(kind, "__getnewargs__"):
            yield "made"
            yield _name(kind)
            yield from map(self.freeze, value.__getnewargs__())
        else:
            yield "object"
            yield _name(kind)
            for name, held in _attributes(value):
                yield name
                yield self.freeze(held)


def _single(value: Any) -> list[Any] | None:
    """Of what is never shared and holds nothing else; None of any other."""
    if type(value) in _FREEZE:
        return _FREEZE[type(value)](value)
    if isinstance(value, Path):
        return ["path", value.name]
    if isinstance(value, np.generic):
        return ["number", value.dtype.str, value.item()]
    return ["enum", _name(type(value)), value.name] if isinstance(value, Enum) else None


def _frozen_array(array: NDArray[Any]) -> list[Any]:
    """Whole numbers as differences, which are short; a column each of a table."""
    if array.dtype.names:
        columns = [[name, _frozen_array(np.ascontiguousarray(array[name]))] for name in array.dtype.names]
        return ["table", len(array), columns]
    kind = array.dtype.kind
    if kind not in "iufb":
        raise TypeError(f"an array of {array.dtype} cannot be kept")
    if kind in "iu" and array.ndim:
        array = np.diff(array, axis=_longest(array.shape), prepend=array.dtype.type(0))
    return ["array", array.dtype.str, list(array.shape), array.ravel().tolist()]


_BUILT_IN: dict[str, type] = {"int": int, "list": list}
_BUILT_IN_NAMES: dict[Any, str] = {kind: name for name, kind in _BUILT_IN.items()}
_FREEZE: dict[type, Callable[[Any], list[Any]]] = {
    bytes: lambda value: ["bytes", value.hex()],
    Fraction: lambda value: ["fraction", value.numerator, value.denominator],
    np.ndarray: _frozen_array,
    FunctionType: lambda value: ["function", _name(value)],
    set: lambda value: ["set", *sorted(value)],
    frozenset: lambda value: ["frozenset", *sorted(value)],
}


class _Thawer:
    def __init__(self) -> None:
        self._met: list[Any] = []

    def thaw(self, plain: Any) -> Any:
        if type(plain) in PLAIN:
            return plain
        kind, *held = plain
        if kind in _THAW:
            return _THAW[kind](held)
        if kind == "tuple":
            return tuple(map(self.thaw, held))
        if kind == "same":
            return self._met[held[0]]
        return self._shared(kind, held)

    def _shared(self, kind: str, held: list[Any]) -> Any:
        if kind == "made":
            return self._made(held)
        if kind == "object":
            return self._object(held)
        if kind == "defaultdict":
            empty: Any = defaultdict(_BUILT_IN[held.pop(0)])
        else:
            empty = {"list": list, "deque": deque, "dict": dict, "Counter": Counter}[kind]()
        self._met.append(empty)
        if isinstance(empty, dict):
            for key, value in zip(held[::2], held[1::2], strict=True):
                empty[self.thaw(key)] = self.thaw(value)
        else:
            empty.extend(map(self.thaw, held))
        return empty

    def _made(self, held: list[Any]) -> Any:
        place = len(self._met)
        self._met.append(None)
        kind = _named(held[0], type)
        if not hasattr(kind, "__getnewargs__"):
            raise ThawError(f"{kind.__name__} is made of its fields")
        self._met[place] = kind(*map(self.thaw, held[1:]))
        return self._met[place]

    def _object(self, held: list[Any]) -> Any:
        kind = _named(held[0], type)
        made = object.__new__(kind)
        self._met.append(made)
        names = held[1::2]
        if is_dataclass(kind) and names != [field.name for field in fields(kind)]:
            raise ThawError(f"{held[0]} has other fields")
        for name, value in zip(names, held[2::2], strict=True):
            if name.startswith("__"):
                raise ThawError(f"{name} is never kept")
            object.__setattr__(made, name, self.thaw(value))
        return made


def _number(kind: str) -> np.dtype[Any]:
    if not NUMBER.fullmatch(kind):
        raise ThawError(f"{kind} is no type of numbers")
    return np.dtype(kind)


def _thawed_array(held: list[Any]) -> NDArray[Any]:
    kind, shape, values = held
    array = np.array(values, _number(kind)).reshape(shape)
    if array.dtype.kind in "iu" and array.ndim:
        array = np.cumsum(array, axis=_longest(shape), dtype=array.dtype)
    return array


def _longest(shape: Sequence[int]) -> int:
    return shape.index(max(shape))


def _thawed_table(held: list[Any]) -> NDArray[Any]:
    number, columns = held
    parts = [(name, _thawed_array(part[1:])) for name, part in columns]
    if any(len(part) != number for _, part in parts) or not parts:
        raise ThawError("columns of a table differ in length")
    table = np.zeros(number, [(name, part.dtype, part.shape[1:]) for name, part in parts])
    for name, part in parts:
        table[name] = part
    return table


_THAW: dict[str, Callable[[list[Any]], Any]] = {
    "bytes": lambda held: bytes.fromhex(held[0]),
    "fraction": lambda held: Fraction(held[0], held[1]),
    "array": _thawed_array,
    "table": _thawed_table,
    "path": lambda held: Path(Path(held[0]).name),
    "number": lambda held: _number(held[0]).type(held[1]),
    "enum": lambda held: _named(held[0], EnumType)[held[1]],
    "function": lambda held: _named(held[0], FunctionType),
    "set": set,
    "frozenset": frozenset,
}
