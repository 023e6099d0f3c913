"""Columns of Arrow tables as tracks, and their values as numpy arrays.

A column of numbers is a track of one number a row, a list of three numbers one of three. What is inside a
structure has the structure's name before its own. Empty cells are NaN among fractions, and among whole
numbers of 64 bits, which times are, `units.EMPTY`.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from accelcal_cli.formats._tables.attributes import Attributes, readable
from accelcal_cli.formats._tables.tracks import Track
from accelcal_cli.formats._tables.units import EMPTY

UNNAMED_INDEX = "__index_level_0__"
"""What pandas calls the index of a table that has no name."""

DEEPEST = 8
"""Structures within structures; no laboratory has more, and a damaged schema has no end."""


@dataclass(frozen=True, slots=True)
class Leaf:
    """A track, and where it is in the schema.

    Attributes:
        column: name of the column.
        fields: names on the way from there, through structures.
        type: of its cells.
        own: what the metadata of its fields say.
    """

    track: Track
    column: str
    fields: tuple[str, ...]
    type: Any
    own: Mapping[str, object]


def leaves_of(schema: Any, rows: int) -> tuple[dict[str, Leaf], int]:
    """All tracks of a schema by their paths, and how many columns share their name with another."""
    names = Counter(schema.names)
    indexed = {"time", UNNAMED_INDEX} & set(names)
    found: dict[str, Leaf] = {}
    for field in schema:
        if names[field.name] > 1:
            continue
        shown = "time" if field.name == UNNAMED_INDEX and "time" not in indexed else field.name
        for leaf in _leaves(field, field.name, (), f"/{_part(shown)}", rows):
            found.setdefault(leaf.track.path, leaf)
    return found, sum(number > 1 for number in names.values())


def _leaves(field: Any, column: str, fields: tuple[str, ...], path: str, rows: int) -> Iterator[Leaf]:
    kind = _stored(field.type)
    if pa.types.is_struct(kind) and len(fields) < DEEPEST:
        for child in kind:
            yield from _leaves(child, column, (*fields, child.name), f"{path}/{_part(child.name)}", rows)
        return
    width, number = (3, _stored(kind.value_type)) if _is_list(kind) else (1, kind)
    if pa.types.is_fixed_size_list(kind) and kind.list_size != 3:
        return
    dtype = _dtype(number)
    if dtype is not None:
        clock = pa.types.is_timestamp(number) and number.tz is None
        own = {**_texts(field.metadata), **_of_type(number)}
        yield Leaf(Track(path, rows, width, 0, dtype, clock), column, fields, kind, own)


def _part(name: str) -> str:
    """A name as a part of a path: `X [m/s2]` is one."""
    return readable(name).replace("/", "_")


def _is_list(kind: Any) -> bool:
    types = pa.types
    return bool(types.is_fixed_size_list(kind) or types.is_list(kind) or types.is_large_list(kind))


def _stored(kind: Any) -> Any:
    """The type of values behind extensions and dictionaries."""
    while isinstance(kind, pa.BaseExtensionType):
        kind = kind.storage_type
    return kind.value_type if pa.types.is_dictionary(kind) else kind


def _dtype(kind: Any) -> np.dtype[Any] | None:
    """Of the values of a type of numbers or times; None for any other."""
    types = pa.types
    if types.is_timestamp(kind) or types.is_duration(kind):
        return np.dtype(np.int64)
    if types.is_decimal(kind):
        return np.dtype(np.float64)
    if types.is_integer(kind) or types.is_floating(kind):
        found: np.dtype[Any] = np.dtype(kind.to_pandas_dtype())
        return found
    return None


def _of_type(kind: Any) -> dict[str, object]:
    """The unit of times, which their type states."""
    timed = pa.types.is_timestamp(kind) or pa.types.is_duration(kind)
    return {"units": kind.unit} if timed else {}


def _texts(metadata: Mapping[bytes, bytes] | None) -> dict[str, object]:
    return {readable(key.decode("utf-8", "replace")): value for key, value in (metadata or {}).items()}


def stated_of(schema: Any) -> dict[str, object]:
    """What the metadata of a schema say, with the `attrs` of a pandas table."""
    stated = _texts(schema.metadata)
    try:
        about = json.loads(bytes(schema.metadata[b"pandas"])) if "pandas" in stated else {}
        attributes = about.get("attributes") if isinstance(about, dict) else None
    except (ValueError, RecursionError):
        attributes = None
    return {**(attributes if isinstance(attributes, dict) else {}), **stated}


def attributes(leaf: Leaf, *around: Mapping[str, object]) -> Attributes:
    """What is stated of a leaf, and around it."""
    return Attributes([leaf.own, *around])


def values_of(leaf: Leaf, batch: Any) -> NDArray[Any]:
    """The values (n, width) of a leaf in a record batch."""
    array = batch.column(batch.schema.get_field_index(leaf.column))
    for name in leaf.fields:
        array = _plain(array)
        array = array.flatten()[array.type.get_field_index(name)]
    array = _plain(array)
    if not _is_list(array.type):
        return _numbers(array).reshape(-1, 1)
    return _triples(array)


def _plain(array: Any) -> Any:
    """The array behind extensions and dictionaries."""
    if isinstance(array.type, pa.BaseExtensionType):
        array = array.storage
    return array.dictionary_decode() if pa.types.is_dictionary(array.type) else array


def _numbers(array: Any) -> NDArray[Any]:
    """Numbers (n,), those that are null as NaN or EMPTY."""
    array = _plain(array)
    if pa.types.is_decimal(array.type):
        array = array.cast(pa.float64())
    dtype = _dtype(array.type)
    if dtype is None or not len(array):
        return np.empty(0, dtype or np.float64)
    buffer = array.buffers()[1]
    values: NDArray[Any] = np.frombuffer(buffer, dtype, len(array), dtype.itemsize * array.offset)
    if not array.null_count:
        return values
    empty = ~_known(array)
    if dtype == np.int64:
        return np.where(empty, EMPTY, values)
    return np.where(empty, np.nan, values if dtype.kind == "f" else values.astype(np.float64))


def _known(array: Any) -> NDArray[np.bool_]:
    """Which cells (n,) are not null."""
    bits = np.frombuffer(array.buffers()[0], np.uint8)
    known = np.unpackbits(bits, bitorder="little")[array.offset : array.offset + len(array)]
    return known.astype(np.bool_)


def _triples(array: Any) -> NDArray[Any]:
    """Lists of three numbers as (n, 3); lists that are null, or of other lengths, as NaN."""
    known = _known(array) if array.null_count else np.ones(len(array), np.bool_)
    if pa.types.is_fixed_size_list(array.type):
        inner = array.values[3 * array.offset : 3 * (array.offset + len(array))]
        values = _numbers(inner).reshape(-1, 3)
        return values if known.all() else _without(values, known)
    offsets = _numbers(array.offsets)[: len(array) + 1]
    known &= np.diff(offsets) == 3
    inner = _numbers(array.values)
    places = np.where(known, offsets[:-1], 0)[:, None] + np.arange(3)
    if not known.any():
        return np.full((len(array), 3), np.nan)
    values = inner[np.minimum(places, len(inner) - 1)]
    return values if known.all() else _without(values, known)


def _without(values: NDArray[Any], known: NDArray[np.bool_]) -> NDArray[Any]:
    values = values if values.dtype.kind == "f" else values.astype(np.float64)
    return np.where(known[:, None], values, np.nan)
