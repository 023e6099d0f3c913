"""Documents in JSON that are declared once, as frozen records: they are written, read and described by these.

A field is a key of the object, and its type that of the value. `Key`, behind the type in `Annotated`, says
the rest: what it means, its unit, how it is rounded, what values it may have.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from enum import StrEnum
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, cast, get_args, get_origin, get_type_hints

from accelcal_cli.core.errors import significant

SHA256 = "^[0-9a-f]{64}$"

Schema = dict[str, Any]
Record = TypeVar("Record")


@dataclass(frozen=True, slots=True)
class Key:
    """The properties of a key besides its type.

    Attributes:
        meaning: a phrase, without its unit and a full stop.
        digits: decimals that are written; significant: four digits are.
        least: smallest value; positive: it is larger than 0.
        words: all values that a text may have; only: the one value of the key.
        pattern: of a text.
        fewest: entries that a list has at least.
        absent: the key is left out where there is no value.
        entries: keys of a plain object, with their meanings; the first `needed` of them are always there.
        needs: keys that are always there, of an object that has others as well.
    """

    meaning: str
    unit: str = ""
    digits: int | None = None
    significant: bool = False
    least: float | None = None
    positive: bool = False
    words: tuple[str, ...] = ()
    only: object = None
    pattern: str = ""
    fewest: int | None = None
    absent: bool = False
    entries: Mapping[str, str] | None = None
    needed: int | None = None
    needs: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """The meaning as a sentence, with the unit."""
        return f"{self.meaning} [{self.unit}]." if self.unit else f"{self.meaning}."


@dataclass(frozen=True, slots=True)
class Field:
    """A key of a record: its name, its type without None, whether it may be null, and what is said of it."""

    name: str
    kind: Any
    nullable: bool
    key: Key


@cache
def fields_of(kind: Any) -> tuple[Field, ...]:
    """Return the declared keys of a record, in their order."""
    hints = get_type_hints(kind, include_extras=True)
    return tuple(_field(one.name, hints[one.name]) for one in fields(kind))


def _field(name: str, hint: Any) -> Field:
    key = Key(name.replace("_", " ").capitalize())
    if get_origin(hint) is Annotated:
        hint, key = get_args(hint)[0], next(one for one in get_args(hint)[1:] if isinstance(one, Key))
    return Field(name, *_without_none(hint), key)


def _without_none(hint: Any) -> tuple[Any, bool]:
    """Return a type without None, and whether None is allowed."""
    kinds = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    plain = [one for one in kinds if one is not NoneType]
    return plain[0] if len(plain) == 1 else Any, NoneType in kinds


# Writing


def as_json(record: Any) -> dict[str, Any]:
    """Return the object of a record: keys in their order, numbers rounded, absent ones left out."""
    found = {}
    kind: Any = type(record)
    for field in fields_of(kind):
        value = getattr(record, field.name)
        if value is not None or not field.key.absent:
            found[field.name] = _json_value(value, field.key)
    return found


def json_or_null(record: Any) -> dict[str, Any] | None:
    """Return the object of a record; None for None."""
    return None if record is None else as_json(record)


def _json_value(value: Any, key: Key) -> Any:
    if isinstance(value, float):
        if key.significant:
            return significant(value)
        return value if key.digits is None else round(value, key.digits)
    if isinstance(value, list | tuple):
        return [_json_value(one, key) for one in value]
    if isinstance(value, Mapping):
        return {name: _json_value(one, key) for name, one in value.items()}
    if is_dataclass(value):
        return as_json(value)
    return str(value) if isinstance(value, StrEnum) else value


# Reading


def from_json(kind: Callable[..., Record], section: Mapping[str, Any]) -> Record:
    """Make a record of an object that has been checked; keys that are not declared are passed over."""
    return kind(**{name: read(section[name]) for name, read in _readers(kind) if name in section})


@cache
def _readers(kind: Any) -> tuple[tuple[str, Callable[[Any], Any]], ...]:
    return tuple((field.name, _reader(field.kind)) for field in fields_of(kind))


def _reader(kind: Any) -> Callable[[Any], Any]:
    """Return what reads a value: a record, a list of records, a word, or the value as it is."""
    inner: Any = next((one for one in get_args(kind) if is_dataclass(one)), None)
    if isinstance(kind, type) and is_dataclass(kind):
        return lambda value: None if value is None else from_json(kind, value)
    if inner is not None and get_origin(kind) is tuple:
        return lambda values: None if values is None else tuple(from_json(inner, one) for one in values)
    if inner is not None:
        return lambda values: (
            None if values is None else {name: from_json(inner, one) for name, one in values.items()}
        )
    return kind if isinstance(kind, type) and issubclass(kind, StrEnum) else lambda value: value


# Describing


@cache
def schema_of(kind: Any) -> Schema:
    """Return the JSON Schema of a record."""
    known = fields_of(kind)
    return {
        "type": "object",
        "required": [one.name for one in known if not one.key.absent],
        "properties": {one.name: _described(one) for one in known},
        "additionalProperties": False,
    }


def _described(field: Field) -> Schema:
    found = _schema(field.kind, field.key)
    if field.nullable and not field.key.absent:
        found = {"anyOf": [found, {"type": "null"}]}
    return {"description": field.key.text, **found}


PLAIN = {str: "string", int: "integer", float: "number", bool: "boolean"}


def _schema(kind: Any, key: Key) -> Schema:
    origin, inner = get_origin(kind), get_args(kind)
    if isinstance(kind, type) and is_dataclass(kind):
        return schema_of(cast("Any", kind))
    if key.only is not None:
        return {"const": key.only}
    if words := key.words or (inner if origin is Literal else _words_of(kind)):
        return {"enum": list(words)}
    if kind in PLAIN:
        return _of_plain(kind, key)
    if origin is Mapping:
        return _of_mapping(inner[1], key)
    return _of_list(origin, inner, key) if inner else {}


def _words_of(kind: Any) -> tuple[str, ...]:
    return tuple(map(str, kind)) if isinstance(kind, type) and issubclass(kind, StrEnum) else ()


def _of_plain(kind: Any, key: Key) -> Schema:
    limits = {"minimum": key.least, "pattern": key.pattern or None}
    return {"type": PLAIN[kind], **_known(limits), **({"exclusiveMinimum": 0} if key.positive else {})}


def _of_list(origin: Any, inner: Sequence[Any], key: Key) -> Schema:
    length = len(inner) if origin is tuple and ... not in inner else None
    plain, nullable = _without_none(inner[0])
    items = _schema(plain, replace(key, fewest=None))
    if nullable:
        items = {**items, "type": [items["type"], "null"]}
    return {"type": "array", "items": items, **_known({"minItems": length or key.fewest, "maxItems": length})}


def _of_mapping(kind: Any, key: Key) -> Schema:
    each = _schema(kind, replace(key, entries=None, meaning=""))
    if key.entries is None:
        open_to = {"additionalProperties": each or None, "required": [*key.needs] or None}
        return {"type": "object", **_known(open_to)}
    return {
        "type": "object",
        "required": [*key.entries][: key.needed],
        "properties": {name: {"description": f"{text}.", **each} for name, text in key.entries.items()},
        "additionalProperties": False,
    }


def _known(limits: Mapping[str, Any]) -> Schema:
    return {name: value for name, value in limits.items() if value is not None}
