"""Records back from JSON, by the types of their fields."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from math import isfinite
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Generic, TypeVar, Union, get_args, get_origin, get_type_hints

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Restored(Generic[T]):
    """A record made from a JSON object.

    Attributes:
        missing: fields that the object lacks; they have their defaults.
        unknown: keys of the object that are no fields.
    """

    record: T
    missing: tuple[str, ...]
    unknown: tuple[str, ...]


def restored(kind: type[T], values: Mapping[str, Any]) -> Restored[T]:
    """A dataclass, all of whose fields have defaults, from a JSON object.

    Raises:
        ValueError: a value is not of its field's type; the message names the key.
    """
    names = [field.name for field in fields(kind)]  # type: ignore[arg-type]
    hints = get_type_hints(kind)
    held = {}
    for name in names:
        if name in values:
            try:
                held[name] = converted(values[name], hints[name])
            except TypeError as error:
                raise ValueError(f"{name} cannot be {str(values[name])[:80]!r}") from error
    missing = tuple(name for name in names if name not in values)
    return Restored(kind(**held), missing, tuple(name for name in values if name not in names))


def converted(value: Any, hint: Any) -> Any:
    """A JSON value as a type: str, int, float, bool, None, Path, records, tuples and unions of these.

    Raises:
        TypeError: it is of another type, or not finite.
    """
    origin = get_origin(hint)
    if origin in (Union, UnionType):
        return _of_union(value, get_args(hint))
    if origin is tuple:
        return _of_tuple(value, get_args(hint))
    if is_dataclass(hint):
        return _record(value, hint)
    if hint is Path and isinstance(value, str):
        return Path(value)
    if hint is float and type(value) is int:
        return float(value)
    if type(value) is not hint or (hint is float and not isfinite(value)):
        raise TypeError
    return value


def _record(value: Any, kind: Any) -> Any:
    """A record within a record: all of its fields, and no others."""
    if not isinstance(value, dict) or set(value) != {field.name for field in fields(kind)}:
        raise TypeError
    try:
        return restored(kind, value).record
    except ValueError as error:
        raise TypeError from error


def _of_union(value: Any, options: tuple[Any, ...]) -> Any:
    if value is None and NoneType in options:
        return None
    (hint,) = (option for option in options if option is not NoneType)
    return converted(value, hint)


def _of_tuple(value: Any, parts: tuple[Any, ...]) -> tuple[Any, ...]:
    if not isinstance(value, list):
        raise TypeError
    kinds = parts[:1] * len(value) if parts[1:] == (...,) else parts
    if len(kinds) != len(value):
        raise TypeError
    return tuple(converted(item, kind) for item, kind in zip(value, kinds, strict=True))
