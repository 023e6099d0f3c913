"""A record declares a document: it is written, read and described by what its fields say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

from accelcal_cli.core.declared import Key, as_json, from_json, schema_of


class Colour(StrEnum):
    RED = "red"
    BLUE = "blue"


@dataclass(frozen=True, slots=True)
class Inner:
    size_mg: Annotated[float, Key("Size", "mg", digits=2, least=0)]
    ends: Annotated[tuple[float, float] | None, Key("Ends", significant=True)]


@dataclass(frozen=True, slots=True)
class Outer:
    name: str
    colour: Colour
    inner: Inner
    several: tuple[Inner, ...]
    by_name: Annotated[Mapping[str, int], Key("Numbers", entries={"a": "First", "b": "Second"}, needed=1)]
    note: Annotated[str | None, Key("Only sometimes", absent=True)] = None


INNER = {"size_mg": 1.23, "ends": [0.1235, 1235.0]}
DOCUMENT = {
    "name": "n",
    "colour": "red",
    "inner": INNER,
    "several": [{"size_mg": 0.0, "ends": None}],
    "by_name": {"a": 1},
}


def made() -> Outer:
    inner = Inner(1.2345, (0.123456, 1234.56))
    return Outer("n", Colour.RED, inner, (Inner(0.0, None),), {"a": 1})


def test_numbers_are_rounded_and_keys_without_a_value_left_out() -> None:
    assert as_json(made()) == DOCUMENT
    assert list(as_json(made())) == list(DOCUMENT)


def test_a_document_is_read_as_its_record() -> None:
    found = from_json(Outer, DOCUMENT | {"unknown": 1})
    assert found == Outer("n", Colour.RED, Inner(1.23, [0.1235, 1235.0]), (Inner(0.0, None),), {"a": 1})  # type: ignore[arg-type]


def test_the_schema_says_types_limits_and_what_is_needed() -> None:
    schema = schema_of(Outer)
    assert schema["required"] == ["name", "colour", "inner", "several", "by_name"]
    assert schema["properties"]["colour"]["enum"] == ["red", "blue"]
    assert schema["properties"]["note"] == {"description": "Only sometimes.", "type": "string"}
    inner = schema["properties"]["inner"]["properties"]
    assert inner["size_mg"] == {"description": "Size [mg].", "type": "number", "minimum": 0}
    pair = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}
    assert inner["ends"] == {"description": "Ends.", "anyOf": [pair, {"type": "null"}]}
    assert schema["properties"]["by_name"]["required"] == ["a"]
    assert schema["properties"]["by_name"]["properties"]["b"] == {"description": "Second.", "type": "integer"}
