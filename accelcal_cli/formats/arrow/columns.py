"""Columns of Arrow tables as tracks, their values as numpy arrays, and their rows (`PartRows`).

A column of numbers is a track of one number a row, a list of three numbers one of three. A field of a
structure has the structure's name before its own. Empty cells are NaN among fractions, and EMPTY among whole
numbers of 64 bits, which times are. Files hold rows in parts: row groups of Parquet, batches of Arrow.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from accelcal_cli.formats._tables.channels import EMPTY
from accelcal_cli.formats._tables.table import (
    BLOCK_ROWS,
    READ_ERRORS,
    TEXT,
    Attributes,
    Track,
    readable,
)
from accelcal_cli.formats._tables.texts import text_codes

ARROW_ERRORS = (pa.ArrowException, *READ_ERRORS)
"""Errors that pyarrow raises for damaged files."""

UNNAMED_INDEX = "__index_level_0__"
"""Name that pandas gives to the index of a table that has none."""

DEEPEST = 8
"""Structures within structures; no laboratory has more, and a damaged schema may have no end."""


@dataclass(frozen=True, slots=True)
class Leaf:
    """A track, and where it is in the schema.

    Attributes:
        column: name of the column.
        fields: names on the way from there, through structures.
        type: of its cells.
        own: the metadata of its fields.
    """

    track: Track
    column: str
    fields: tuple[str, ...]
    type: Any
    own: Mapping[str, object]


def leaves_of(schema: Any, rows: int) -> tuple[dict[str, Leaf], int]:
    """Return all tracks of a schema by their paths, and the number of names that several columns share."""
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
    kind = _value_type(field.type)
    if pa.types.is_struct(kind) and len(fields) < DEEPEST:
        for child in kind:
            yield from _leaves(child, column, (*fields, child.name), f"{path}/{_part(child.name)}", rows)
        return
    width, number = (3, _value_type(kind.value_type)) if _is_list(kind) else (1, kind)
    if pa.types.is_fixed_size_list(kind) and kind.list_size != 3:
        return
    dtype = _dtype(number)
    if width == 1 and is_text(number):
        yield Leaf(Track(path, rows, 1, 0, TEXT), column, fields, kind, {})
    if dtype is not None:
        clock = pa.types.is_timestamp(number) and number.tz is None
        timed = pa.types.is_timestamp(number) or pa.types.is_duration(number)
        own = {**_texts(field.metadata), **({"units": number.unit} if timed else {})}
        yield Leaf(Track(path, rows, width, 0, dtype, clock), column, fields, kind, own)


def is_text(kind: Any) -> bool:
    """Return True for a type of texts."""
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def _part(name: str) -> str:
    """Return a name as one part of a path, such as `X [m_s2]`."""
    return readable(name).replace("/", "_")


def _is_list(kind: Any) -> bool:
    types = pa.types
    return bool(types.is_fixed_size_list(kind) or types.is_list(kind) or types.is_large_list(kind))


def _value_type(kind: Any) -> Any:
    """Return the type of values behind extensions and dictionaries."""
    while isinstance(kind, pa.BaseExtensionType):
        kind = kind.storage_type
    return kind.value_type if pa.types.is_dictionary(kind) else kind


def _dtype(kind: Any) -> np.dtype[Any] | None:
    """Return the numpy type of numbers or times; None for any other type."""
    types = pa.types
    if types.is_timestamp(kind) or types.is_duration(kind):
        return np.dtype(np.int64)
    if types.is_decimal(kind):
        return np.dtype(np.float64)
    if types.is_integer(kind) or types.is_floating(kind):
        found: np.dtype[Any] = np.dtype(kind.to_pandas_dtype())
        return found
    return None


def _texts(metadata: Mapping[bytes, bytes] | None) -> dict[str, object]:
    return {readable(key.decode("utf-8", "replace")): value for key, value in (metadata or {}).items()}


def stated_of(schema: Any) -> dict[str, object]:
    """Return the metadata of a schema, with the `attrs` of a pandas table."""
    stated = _texts(schema.metadata)
    try:
        about = json.loads(bytes(schema.metadata[b"pandas"])) if "pandas" in stated else {}
        attributes = about.get("attributes") if isinstance(about, dict) else None
    except (ValueError, RecursionError):
        attributes = None
    return {**(attributes if isinstance(attributes, dict) else {}), **stated}


def attributes(leaf: Leaf, *around: Mapping[str, object]) -> Attributes:
    """Return what is stated of a leaf, and around it."""
    return Attributes([leaf.own, *around])


class Columns:
    """The leaves of a table, and the texts that were read of those that hold texts."""

    def __init__(self, schema: Any, rows: int) -> None:
        self.leaves, self.doubtful = leaves_of(schema, rows)
        tracks = sorted((leaf.track for leaf in self.leaves.values()), key=lambda one: one.path)
        self.tracks = tuple(track for track in tracks if track.dtype != TEXT)
        self.text_tracks = tuple(track for track in tracks if track.dtype == TEXT)
        self._numbers: dict[str, dict[str, int]] = {track.path: {} for track in self.text_tracks}

    def texts_of(self, track: Track) -> list[str] | None:
        """Return the texts of a column of texts that were read so far."""
        numbers = self._numbers.get(track.path)
        return None if numbers is None else list(numbers)

    def values_of(self, track: Track, batch: Any) -> NDArray[Any]:
        """Return the values (n, width) of a track in a record batch, those of texts as their numbers."""
        numbers = self._numbers.get(track.path)
        array = _array_of(self.leaves[track.path], batch)
        if track.written is not None:
            return track.written.values(array).reshape(-1, 1)
        return _values(array) if numbers is None else _codes(array, numbers)


def _codes(array: Any, numbers: dict[str, int]) -> NDArray[np.int32]:
    """Return texts as numbers (n, 1), which are given as they are met; -1 where a cell is empty."""
    if not len(array):
        return np.empty((0, 1), np.int32)
    coded = _unwrapped(array).dictionary_encode()
    codes = text_codes(coded.dictionary.to_pylist(), numbers)
    found: NDArray[np.int32] = codes[_numbers(coded.indices.fill_null(len(codes) - 1))]
    return found.reshape(-1, 1)


def _array_of(leaf: Leaf, batch: Any) -> Any:
    """Return the cells of a leaf in a record batch."""
    array = batch.column(batch.schema.get_field_index(leaf.column))
    for name in leaf.fields:
        array = _unwrapped(array)
        array = array.flatten()[array.type.get_field_index(name)]
    return _unwrapped(array)


def _values(array: Any) -> NDArray[Any]:
    """Return numbers, or lists of three, as (n, width)."""
    return _triples(array) if _is_list(array.type) else _numbers(array).reshape(-1, 1)


def _unwrapped(array: Any) -> Any:
    """Return the array behind extensions and dictionaries."""
    if isinstance(array.type, pa.BaseExtensionType):
        array = array.storage
    return array.dictionary_decode() if pa.types.is_dictionary(array.type) else array


def _numbers(array: Any) -> NDArray[Any]:
    """Return numbers (n,), nulls as NaN or EMPTY."""
    array = _unwrapped(array)
    if pa.types.is_decimal(array.type):
        array = array.cast(pa.float64())
    dtype = _dtype(array.type)
    if dtype is None or not len(array):
        return np.empty(0, dtype or np.float64)
    buffer = array.buffers()[1]
    values: NDArray[Any] = np.frombuffer(buffer, dtype, len(array), dtype.itemsize * array.offset)
    if not array.null_count:
        return values
    empty = ~_not_null(array)
    if dtype == np.int64:
        return np.where(empty, EMPTY, values)
    return np.where(empty, np.nan, values if dtype.kind == "f" else values.astype(np.float64))


def _not_null(array: Any) -> NDArray[np.bool_]:
    """Return flags (n,) of cells that are not null."""
    bits = np.frombuffer(array.buffers()[0], np.uint8)
    known = np.unpackbits(bits, bitorder="little")[array.offset : array.offset + len(array)]
    return known.astype(np.bool_)


def _triples(array: Any) -> NDArray[Any]:
    """Return lists of three numbers as (n, 3); lists that are null, or of other lengths, as NaN."""
    known = _not_null(array) if array.null_count else np.ones(len(array), np.bool_)
    if pa.types.is_fixed_size_list(array.type):
        inner = array.values[3 * array.offset : 3 * (array.offset + len(array))]
        values = _numbers(inner).reshape(-1, 3)
        return values if known.all() else _nulls_as_nan(values, known)
    offsets = _numbers(array.offsets)[: len(array) + 1]
    known &= np.diff(offsets) == 3
    inner = _numbers(array.values)
    places = np.where(known, offsets[:-1], 0)[:, None] + np.arange(3)
    if not known.any():
        return np.full((len(array), 3), np.nan)
    values = inner[np.minimum(places, len(inner) - 1)]
    return values if known.all() else _nulls_as_nan(values, known)


def _nulls_as_nan(values: NDArray[Any], known: NDArray[np.bool_]) -> NDArray[Any]:
    values = values if values.dtype.kind == "f" else values.astype(np.float64)
    return np.where(known[:, None], values, np.nan)


@dataclass(frozen=True, slots=True)
class Portion:
    """Consecutive rows from `start` on.

    Attributes:
        values: (rows, width); None if the rows are lost.
    """

    start: int
    rows: int
    values: NDArray[Any] | None


class PartRows:
    """Reads rows of a track in order, each part once; only parts that cannot be read are lost.

    Args:
        first_rows: (parts + 1,) first rows of the parts, and the number of all rows.
        batches: yields the values of parts first..end-1 in portions (n, width) of any length. Raises as
            pyarrow does.
        offset: returns the byte in the file at which a part begins.
        pool: takes portions ahead; None if one thread does all.
    """

    def __init__(
        self,
        track: Track,
        first_rows: NDArray[np.int64],
        batches: Callable[[int, int], Iterator[NDArray[Any]]],
        offset: Callable[[int], int | None],
        pool: Executor | None = None,
    ) -> None:
        self._track, self._first_rows, self._batches = track, first_rows, batches
        self._offset, self._pool = offset, pool
        self._portion = Portion(0, 0, None)
        self._portions: Iterator[Portion] = iter(())
        self._ahead: Future[Portion | None] | None = None
        self.kept_bytes = 0

    @property
    def path(self) -> str:
        """The track's path."""
        return self._track.path

    @property
    def row_bytes(self) -> int:
        """Bytes of one row."""
        return self._track.width * self._track.dtype.itemsize

    def chunk_offset(self, row: int) -> int | None:
        """Return the byte in the file of the part that holds a row; None if that is not known."""
        return self._offset(self._part(row))

    def _part(self, row: int) -> int:
        return int(np.searchsorted(self._first_rows, row, "right")) - 1

    def read(self, start: int, stop: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Return rows start..stop-1, shape (stop - start, width), and flags of those that are not lost."""
        parts: list[NDArray[Any]] = []
        good = np.ones(stop - start, np.bool_)
        row = start
        while row < stop:
            portion = self._portion_with(row)
            end = min(stop, portion.start + portion.rows)
            if portion.values is None:
                parts.append(np.zeros((end - row, self._track.width), self._track.dtype))
                good[row - start : end - start] = False
            else:
                parts.append(portion.values[row - portion.start : end - portion.start])
            row = end
        return (parts[0] if len(parts) == 1 else np.concatenate(parts)), good

    def _portion_with(self, row: int) -> Portion:
        """Return the portion that holds a row; begin again at the row's part unless it comes soon."""
        here = self._portion
        end = here.start + here.rows
        if here.start <= row < end:
            return here
        part = self._part(row)
        if here.rows == 0 or row < here.start or self._first_rows[part] > end:
            if self._ahead is not None:
                self._ahead.result()
            self._ahead, self._portions = None, self._portions_from(part)
            self._portion = Portion(0, 0, None)
        while not self._portion.start <= row < self._portion.start + self._portion.rows:
            self._portion = self._next()
        return self._portion

    def _next(self) -> Portion:
        """Return the next portion, and have the pool begin the one after it."""
        found = next(self._portions, None) if self._ahead is None else self._ahead.result()
        self._ahead = None if self._pool is None else self._pool.submit(next, self._portions, None)
        assert found is not None
        return found

    def _portions_from(self, part: int) -> Iterator[Portion]:
        """Yield portions from the beginning of a part on; several small parts are read together."""
        last = len(self._first_rows) - 1
        while part < last:
            most = int(self._first_rows[part]) + BLOCK_ROWS
            end = max(part + 1, int(np.searchsorted(self._first_rows, most, "right")) - 1)
            yield from self._portions_of(part, min(end, last))
            part = min(end, last)

    def _portions_of(self, part: int, end: int) -> Iterator[Portion]:
        """Yield portions of parts part..end-1; several are read at once, or each alone if one fails."""
        start, stop = int(self._first_rows[part]), int(self._first_rows[end])
        if end - part > 1:
            values = self._all_at_once(part, end)
            if values is not None and len(values) == stop - start:
                yield Portion(start, stop - start, values)
                return
            for one in range(part, end):
                yield from self._portions_of(one, one + 1)
            return
        row = start
        try:
            for values in self._batches(part, end):
                rows = min(len(values), stop - row)
                if rows:
                    yield Portion(row, rows, values[:rows])
                row += rows
        except ARROW_ERRORS:
            pass
        for lost in range(row, stop, BLOCK_ROWS):
            yield Portion(lost, min(BLOCK_ROWS, stop - lost), None)

    def _all_at_once(self, part: int, end: int) -> NDArray[Any] | None:
        try:
            batches = [*self._batches(part, end)]
        except ARROW_ERRORS:
            return None
        return np.concatenate(batches) if len(batches) > 1 else next(iter(batches), None)
