"""Reads Parquet files, and Arrow IPC files (Feather) and streams: a part of a column at a time.

A column of numbers is a track of one number a row, a list of three numbers one of three. A field of a
structure has the structure's name before its own. Empty cells are NaN among fractions, and EMPTY among whole
numbers of 64 bits, which times are. Rows lie in parts, row groups or batches, which are lost alone. An IPC
file that was cut short has lost its footer: behind its magic number it is read as a stream is.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from copy import copy
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO, ClassVar, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from accelcal_cli.core.errors import NoRecordingError, UnreadableError, printable, unread
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.identity import SAMPLES, is_ours, refuse_other
from accelcal_cli.core.recording import METADATA_KEY, Calibrated
from accelcal_cli.core.written_times import header_zone
from accelcal_cli.formats._bytes import refuse_packed
from accelcal_cli.formats.tables import signatures
from accelcal_cli.formats.tables.header import Attributes, readable
from accelcal_cli.formats.tables.reader import TableReader, open_table
from accelcal_cli.formats.tables.tracks import (
    AGAIN,
    BLOCK_ROWS,
    HIGHEST_RATIO,
    READ_ERRORS,
    TEXT,
    OpenRows,
    Track,
    TrackSource,
)
from accelcal_cli.formats.tables.units import EMPTY

ARROW_ERRORS = (pa.ArrowException, *READ_ERRORS)
"""Errors that pyarrow raises for damaged files."""

UNNAMED_INDEX = "__index_level_0__"
"""Name that pandas gives to the index of a table that has none."""

DEEPEST = 8
"""Structures within structures; no laboratory has more, and a damaged schema may have no end."""

PAGES_BYTES, WHOLE_BYTES = 1 << 20, 32 << 20
"""Bytes of a column that are read at a time: a row group may be as long as the recording. In shorter ones a
column is read whole, and pyarrow believes no page that claims to be longer (else it asks for up to 2 GB)."""

FARTHEST_ROWS = 1 << 22
"""Longest part [rows] of a preview that is spread evenly: each can be entered only at its beginning."""

LARGEST_TEXT, MOST_ENTRIES = 100_000_000, 2_000_000
"""Bytes of a text, and entries of a list, in the footer."""

MOST_LOOKED_AT = 1 << 22
"""Longest footer [bytes] that is searched for where row groups begin (2 s)."""

LONGEST_WORD, LARGEST_MG = 40, 1e6


def open_parquet(path: Path, options: ReadOptions) -> TableReader:
    """Open a Parquet file whose acceleration is three columns of numbers, or one of lists of three.

    Raises:
        UnreadableError: damaged, cut short, encrypted, or nothing in it is known as acceleration.
        UsageError: an option names no column.
    """
    return open_table(ArrowSource("parquet", path, ParquetTable), options)


def open_feather(path: Path, options: ReadOptions) -> TableReader:
    """Open an Arrow IPC file or stream whose acceleration is given so; of one cut short, the rest is read.

    Raises:
        UnreadableError: damaged, of the first version of Feather, or nothing in it is known as acceleration.
        UsageError: an option names no column.
    """
    return open_table(ArrowSource("feather", path, IpcTable), options)


class ArrowSource(TrackSource):
    """The columns of a file of Arrow, which is opened again whenever rows are read."""

    repack = "write it again with at most 65 536 rows in a batch (in Python: pyarrow.feather.write_feather)"

    def __init__(self, name: str, path: Path, kind: type[ArrowTable]) -> None:
        self.format = name
        table = self._table = opened(path, kind)
        self.missing_bytes, tracks = table.missing_bytes(), [leaf.track for leaf in table.leaves.values()]
        super().__init__(path, tracks, damaged=table.damaged)
        self.can_be_entered = table.longest <= FARTHEST_ROWS
        if table.is_ours:
            marks = next((number for number, track in enumerate(tracks) if track.path == "/validity"), None)
            self.stated = replace(self.stated, calibrated=table.calibrated, marks=marks)

    @contextmanager
    def opened(self) -> Iterator[OpenRows]:
        """See `TrackSource`."""
        try:
            file = self.path.open("rb")
        except OSError as error:
            raise unread(error, self.path) from error
        with file:
            table = copy(self._table)  # others may be reading at the same time
            try:
                table.attach(file)
            except ARROW_ERRORS as error:
                what = "has changed since it was opened"
                raise UnreadableError(what, path=self.path, hint="wait until it is complete") from error
            yield lambda track: PartRows(table, table.leaves[track.path])

    def own(self, path: str) -> Attributes:
        """Return the metadata of a column."""
        return Attributes([self._table.leaves[path].own])

    def around(self, path: str) -> Attributes:
        """Return the metadata of a column, then those of the file."""
        return Attributes([self._table.leaves[path].own, self._table.around])


@contextmanager
def damage_suppressed(path: Path) -> Iterator[None]:
    """Suppress what pyarrow raises for damaged files; raise UnreadableError for errors of the disk."""
    try:
        yield
    except ARROW_ERRORS as error:
        if isinstance(error, OSError) and error.errno is not None:  # those of Arrow have no number
            raise unread(error, path) from error


class Leaf(NamedTuple):
    """A track, the column and the fields of structures where it lies, its type, and its own metadata."""

    track: Track
    column: str
    fields: tuple[str, ...]
    type: Any
    own: Mapping[str, object]


def _leaves(field: Any, names: tuple[str, ...], path: str, rows: int) -> Iterator[Leaf]:
    types, kind = pa.types, _value_type(field.type)
    if types.is_struct(kind) and len(names) <= DEEPEST:
        for child in kind:
            yield from _leaves(child, (*names, child.name), f"{path}/{_part(child.name)}", rows)
        return
    number = _value_type(kind.value_type) if _is_list(kind) else kind
    if _is_text(kind):
        yield Leaf(Track(path, rows, 1, 0, TEXT), names[0], names[1:], pa.string(), {})
    elif (dtype := _dtype(number)) and not (types.is_fixed_size_list(kind) and kind.list_size != 3):
        stamps = types.is_timestamp(number)
        unit = number.unit if stamps or types.is_duration(number) else ""
        clock = stamps and number.tz is None
        zone = header_zone(number.tz)[0] if stamps and number.tz else None
        track = Track(path, rows, 1 if number is kind else 3, 0, dtype, stamps, clock, unit, zone)
        yield Leaf(track, names[0], names[1:], kind, _texts(field.metadata))


def _part(name: str) -> str:
    return readable(name).replace("/", "_")


def _is_text(kind: Any) -> bool:
    types = pa.types
    texts = types.is_string(kind) or types.is_large_string(kind) or types.is_string_view(kind)
    return bool(texts or types.is_date(kind) or types.is_time(kind))  # which are split as in a text file


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
    return np.dtype(kind.to_pandas_dtype()) if types.is_integer(kind) or types.is_floating(kind) else None


def _texts(metadata: Mapping[bytes, bytes] | None) -> dict[str, object]:
    return {readable(key.decode("utf-8", "replace")): value for key, value in (metadata or {}).items()}


def json_object(value: object) -> dict[str, Any]:
    """Return an object of JSON, also from text or bytes in metadata; an empty one for anything else."""
    with suppress(ValueError, RecursionError):
        value = json.loads(value) if isinstance(value, bytes | str) else value
    return value if isinstance(value, dict) else {}


class ArrowTable:
    """An open file whose columns are Arrow's, and which holds its rows in parts.

    Attributes:
        names: of the kind of file, and of what says where its rows are.
        leaves: by the paths of their tracks, in the order of the file.
        first_rows: (parts + 1,) first rows of the parts, and the number of all rows.
        longest: rows of the longest part.
        kept_rows: rows that have to be unpacked at once.
        damaged: number of columns that cannot be told apart.
        around: what is stated of the whole table, with the `attrs` of a pandas table.
        is_ours: True if accelcal wrote it.
        calibrated: set for a calibrated recording of ours.
    """

    names: ClassVar[tuple[str, str]]
    path: Path
    kept_rows = 0
    is_ours = False
    calibrated: Calibrated | None = None

    def __init__(self, path: Path, file: BinaryIO) -> None:
        """Open a table of a kind; raises UnreadableError, or as pyarrow does, for a file of another."""
        raise NotImplementedError

    def attach(self, file: BinaryIO) -> None:
        """Read from the same file as it is opened again; what is known of it is not looked for again."""
        raise NotImplementedError

    def _find(self, path: Path, schema: Any, part_rows: Sequence[int]) -> None:
        """Find the columns; raises UnreadableError if there are no rows, or more than a file can hold."""
        self.path, rows = path, sum(part_rows)
        if min(part_rows, default=0) < 0 or rows > path.stat().st_size * HIGHEST_RATIO:
            raise UnreadableError(f"claims {rows} rows, more than the file can hold", path=path, hint=AGAIN)
        if not rows:
            raise UnreadableError("holds no rows", path=path, hint="write it again with its rows")
        self.first_rows, self.longest = np.cumsum([0, *part_rows], dtype=np.int64), max(part_rows)
        names, self.leaves = Counter(schema.names), dict[str, Leaf]()
        self.damaged = sum(number > 1 for number in names.values())
        for field in (field for field in schema if names[field.name] == 1):
            shown = "time" if field.name == UNNAMED_INDEX and not names["time"] else field.name
            for leaf in _leaves(field, (field.name,), "/" + _part(shown), rows):
                self.leaves.setdefault(leaf.track.path, leaf)
        stated = _texts(schema.metadata)
        self.around = {**json_object(json_object(stated.get("pandas")).get("attributes")), **stated}
        ours = self.around.get(METADATA_KEY.decode())  # also in the `attrs` of a frame of a result
        self.is_ours, about_it = ours is not None, json_object(ours)
        named, whole = about_it.get("kind") == SAMPLES, {"time", *"xyz", "validity"} <= {*schema.names}
        if self.is_ours and not (named or whole):
            hint = "use `accelcal fit` for still windows"
            raise NoRecordingError("is a table that accelcal wrote, not a recording", path=path, hint=hint)
        if self.is_ours:
            if is_ours(about_it):  # not damaged
                refuse_other(about_it, SAMPLES, path)
            rate = json_object(about_it.get("recording")).get("sample_rate_hz")
            self.around |= {"sample_rate": rate, "time_zone": None}
            if about_it.get("outcome") != "refused" or about_it.get("calibration") is not None:
                self.calibrated = _calibrated(about_it)  # a refused one holds raw values

    def missing_bytes(self) -> int:
        """Return -1 for a file that was cut short: how much is missing is not known."""
        return 0

    def blocks(self, leaf: Leaf, part: int) -> Iterator[Any]:
        """Yield the rows of a part as validated record batches with a leaf's column; raises as pyarrow does.

        Those that are not validated may end the process: pyarrow believes any length and place.
        """
        raise NotImplementedError

    def begin(self, part: int) -> int | None:
        """Return the byte in the file at which a part begins; None if that is not known."""
        raise NotImplementedError


def opened(path: Path, kind: type[ArrowTable]) -> ArrowTable:
    """Return a file as a table of a kind, closed again; raise UnreadableError for another."""
    refuse_packed(path, kind.names[0])
    try:
        with path.open("rb") as file:
            return kind(path, file)
    except ARROW_ERRORS as error:
        with damage_suppressed(path):
            raise
        what = f"its {kind.names[1]} cannot be read ({' '.join(str(error).split())[:200]})"
        raise UnreadableError(what, path=path, hint=f"the file is damaged: {AGAIN}") from error


class IpcTable(ArrowTable):
    """An open Arrow IPC file or stream; batches that cannot be found are among what is damaged."""

    names = ("an Arrow file", "schema")

    def __init__(self, path: Path, file: BinaryIO) -> None:
        head = file.read(len(signatures.FEATHER_MAGIC))
        if head.startswith(signatures.OLD_FEATHER_MAGIC):
            hint = "write it again with a newer pyarrow or arrow"
            raise UnreadableError("is a Feather file of version 1", path=path, hint=hint)
        if head != signatures.FEATHER_MAGIC and not head.startswith(signatures.CONTINUATION):
            raise UnreadableError("is not an Arrow file, or its beginning is damaged", path=path, hint=AGAIN)
        self.path, self._file = path, pa.PythonFile(file, "r")  # pyarrow itself takes names as UTF-8 alone
        self._start = len(signatures.FEATHER_MAGIC) if head == signatures.FEATHER_MAGIC else 0
        self._readers: dict[int, Any] = {}
        self._whole = False
        with damage_suppressed(path):
            self._schema = pa.ipc.open_file(self._file).schema
            self._whole = self._start > 0
        if not self._whole:
            self._file.seek(self._start)
            self._schema = pa.ipc.open_stream(self._file).schema
        if self._whole:
            rows = [*map(self._rows_of, range(pa.ipc.open_file(self._file).num_record_batches))]
        else:
            rows = [rows for _, _, rows, _ in self._heads[0]]
        self._find(path, self._schema, [max(0, number) for number in rows])
        self.damaged += sum(number < 0 for number in rows)
        numbers = [leaf.track for leaf in self.leaves.values() if leaf.track.dtype != TEXT]
        unpacked = sum(rows) * sum(track.width * track.dtype.itemsize for track in numbers)
        if self.longest > BLOCK_ROWS and unpacked > path.stat().st_size:
            self.kept_rows = self.longest

    def attach(self, file: BinaryIO) -> None:
        """See `ArrowTable`."""
        self._file, self._readers = pa.PythonFile(file, "r"), {}

    @cached_property
    def _heads(self) -> tuple[list[tuple[int, int, int, bytes]], bool]:
        """Where each batch lies, its rows, and schema and dictionaries before it; True at a proper end.

        They may be asked for when the rows have been read and the file is closed.
        """
        found, before, place = [], b"", self._start
        with damage_suppressed(self.path), self.path.open("rb") as plain:
            file = pa.PythonFile(plain, "r")
            file.seek(place)
            for message in pa.ipc.MessageReader.open_stream(file):
                begin, place = place, file.tell()
                if message.type == "record batch":
                    rows = pa.ipc.read_record_batch(message, pa.schema([])).num_rows
                    found.append((begin, place, rows, before))
                else:
                    before += message.serialize().to_pybytes()
            return found, self._start == 0
        return found, False

    def _rows_of(self, number: int) -> int:
        """Return the rows of a batch that the footer knows; -1 for one that cannot be found."""
        with damage_suppressed(self.path):
            return int(self._batch(0, number).num_rows)
        heads = self._heads[0]
        return heads[number][2] if number < len(heads) else -1

    def _batch(self, column: int, number: int) -> Any:
        """Return a column of a batch."""
        options = pa.ipc.IpcReadOptions(use_threads=False, included_fields=[column])
        if self._whole:
            if column not in self._readers:
                self._readers[column] = pa.ipc.open_file(self._file, options=options)
            return self._readers[column].get_batch(number)
        place, end, _, before = self._heads[0][number]
        self._file.seek(place)
        stream = before + self._file.read(end - place)
        return pa.ipc.open_stream(stream, options=options).read_next_batch()

    def missing_bytes(self) -> int:
        """See `ArrowTable`."""
        return 0 if self._whole or self._heads[1] else -1

    def begin(self, part: int) -> int | None:
        """Return the byte at which the message of a batch begins; None if that cannot be found."""
        heads = self._heads[0]
        return heads[part][0] if part < len(heads) else None

    def blocks(self, leaf: Leaf, part: int) -> Iterator[Any]:
        """Yield the rows of a batch, a block at a time."""
        batch = self._batch(self._schema.get_field_index(leaf.column), part)
        batch.validate(full=True)
        for start in range(0, len(batch), BLOCK_ROWS):
            yield batch.slice(start, BLOCK_ROWS)


class ParquetTable(ArrowTable):
    """An open Parquet file."""

    names = ("a Parquet file", "footer")

    def __init__(self, path: Path, file: BinaryIO) -> None:
        _refuse_ends(path, file)
        source = pa.PythonFile(file, "r")  # pyarrow itself takes names as UTF-8 alone
        self._file = _parquet_file(source)
        self._about, schema = self._file.metadata, self._file.schema_arrow
        groups = [self._about.row_group(number) for number in range(self._about.num_row_groups)]
        self._find(path, schema, [group.num_rows for group in groups])
        wide = any(group.total_byte_size > WHOLE_BYTES for group in groups)
        self._how = {"buffer_size": PAGES_BYTES} if wide else {}

    def attach(self, file: BinaryIO) -> None:
        """See `ArrowTable`."""
        self._file = _parquet_file(pa.PythonFile(file, "r"), metadata=self._about, **self._how)

    def blocks(self, leaf: Leaf, part: int) -> Iterator[Any]:
        """Yield the rows of a row group, some pages at a time."""
        name = ".".join((leaf.column, *leaf.fields))
        for batch in self._file.iter_batches(BLOCK_ROWS, [part], [name], use_threads=False):
            batch.validate(full=True)
            yield batch

    @cached_property
    def _begins(self) -> list[int | None]:
        from accelcal_cli.parquet import row_group_offsets

        return row_group_offsets(self.path, MOST_LOOKED_AT)

    def begin(self, part: int) -> int | None:
        """Return the byte at which the first column of a row group begins; None if that cannot be told."""
        return self._begins[part] if part < len(self._begins) else None


def _calibrated(about: dict[str, Any]) -> Calibrated:
    """Return how a recording of ours was calibrated, by its metadata."""
    recording, result = (json_object(about.get(name)) for name in ("recording", "result"))
    outcome, error = result.get("outcome"), result.get("held_out_mg")
    return Calibrated(
        printable(Path(str(recording.get("path") or "a recording of unknown name")).name),
        printable(outcome)[:LONGEST_WORD] if isinstance(outcome, str) else None,
        float(error) if isinstance(error, int | float) and abs(error) < LARGEST_MG else None,
    )


def _parquet_file(source: Any, **options: Any) -> Any:
    """Open a Parquet file; what its footer claims is bounded."""
    from pyarrow import parquet as pq  # Feather needs none of it

    return pq.ParquetFile(
        source,
        pre_buffer=False,
        page_checksum_verification=True,
        thrift_string_size_limit=LARGEST_TEXT,
        thrift_container_size_limit=MOST_ENTRIES,
        **options,
    )


def _refuse_ends(path: Path, file: BinaryIO) -> None:
    """Raise UnreadableError if the first or the last bytes are not those of a whole Parquet file."""
    first, size = file.read(4), file.seek(0, os.SEEK_END)
    file.seek(max(4, size - 4))
    last = file.read(4) if size >= 12 else b""
    if signatures.ENCRYPTED_MAGIC in (first, last):
        raise UnreadableError("is encrypted", path=path, hint="write it again without encryption")
    if first != signatures.PARQUET_MAGIC:
        raise UnreadableError("is not a Parquet file, or its beginning is damaged", path=path, hint=AGAIN)
    if last != signatures.PARQUET_MAGIC:
        what = "is cut short: its end, which says where everything is, is missing"
        hint = "copy it again from its source, or let the program that writes it finish"
        raise UnreadableError(what, path=path, byte_offset=size, hint=hint)


class PartRows:
    """The rows of a track, read in order; only parts that cannot be read are lost."""

    def __init__(self, table: ArrowTable, leaf: Leaf) -> None:
        self._table, self._leaf = table, leaf
        self.row_bytes = leaf.track.width * leaf.track.dtype.itemsize
        self.kept_bytes = table.kept_rows * self.row_bytes
        self._part, self._start, self._lost = -1, 0, False
        self._cells = pa.nulls(0)
        self._left: Iterator[tuple[Any, bool]] = iter(())

    def chunk_offset(self, row: int) -> int | None:
        """Return the byte in the file of the part that holds a row; None if that is not known."""
        return self._table.begin(self._part_of(row))

    def read(self, start: int, stop: int) -> tuple[Any, NDArray[np.bool_]]:
        """See `RowSource`."""
        cells, good = self.cells(start, stop)
        return (cells if self._leaf.track.dtype == TEXT else values_of(cells)), good

    def cells(self, start: int, stop: int) -> tuple[Any, NDArray[np.bool_]]:
        """Return rows start..stop-1 as a `pyarrow.Array` (n,), and flags (n,) of those that are not lost.

        Those of a column of texts are strings without blanks at their ends. Empty and lost ones are null.
        """
        pieces, good, row = [pa.nulls(0, self._leaf.type)], np.ones(stop - start, np.bool_), start
        while row < stop:
            self._reach(row)
            pieces.append(self._cells[row - self._start :][: stop - row])
            good[row - start :][: len(pieces[-1])] = not self._lost
            row += len(pieces[-1])
        return (pieces[1] if len(pieces) == 2 else pa.concat_arrays(pieces)), good

    def _part_of(self, row: int) -> int:
        return int(np.searchsorted(self._table.first_rows, row, "right")) - 1

    def _reach(self, row: int) -> None:
        """Move to the cells that hold a row; back to the beginning of its part, or to another part."""
        part = self._part_of(row)
        if part != self._part or row < self._start:
            self._part, self._left, self._cells = part, self._cells_of(part), self._cells[:0]
            self._start = int(self._table.first_rows[part])
        while row >= self._start + len(self._cells):
            self._start += len(self._cells)
            self._cells, self._lost = next(self._left)

    def _cells_of(self, part: int) -> Iterator[tuple[Any, bool]]:
        """Yield the cells of a part, and True for those that are lost."""
        left = int(self._table.first_rows[part + 1]) - int(self._table.first_rows[part])
        with damage_suppressed(self._table.path):
            for block in self._table.blocks(self._leaf, part):
                cells = _cells_of(self._leaf, block)[:left]
                left -= len(cells)
                yield cells, False
        for row in range(0, left, BLOCK_ROWS):
            yield pa.nulls(min(left - row, BLOCK_ROWS), self._leaf.type), True


def _cells_of(leaf: Leaf, batch: Any) -> Any:
    """Return the cells (n,) of a leaf in a record batch."""
    array = batch.column(batch.schema.get_field_index(leaf.column))
    for name in leaf.fields:
        array = _unwrapped(array)
        array = array.flatten()[array.type.get_field_index(name)]
    array = _unwrapped(array)
    if not _is_text(array.type):
        return array
    from pyarrow import compute  # takes .1 s, and few tables have columns of texts

    texts = compute.utf8_trim(array.cast(pa.string()), "\0 ")
    return compute.if_else(compute.equal(texts, ""), pa.scalar(None, pa.string()), texts)


def _unwrapped(array: Any) -> Any:
    """Return the array behind extensions and dictionaries."""
    while isinstance(array.type, pa.BaseExtensionType):
        array = array.storage
    return array.dictionary_decode() if pa.types.is_dictionary(array.type) else array


def values_of(cells: Any) -> NDArray[Any]:
    """Return numbers, or lists of three, as (n, width); lists that are null or of other lengths as empty."""
    if not _is_list(cells.type):
        return _numbers(cells).reshape(-1, 1)
    fixed = pa.types.is_fixed_size_list(cells.type)
    lengths = np.full(len(cells), 3) if fixed else np.diff(_numbers(cells.offsets)[: len(cells) + 1])
    lengths = np.where(_known(cells), lengths, 0)
    inner, whole = _numbers(cells.flatten()), lengths == 3
    if whole.all():
        return inner.reshape(-1, 3)
    dtype = inner.dtype if inner.dtype.kind == "f" or inner.dtype == np.int64 else np.float64
    values = np.full((len(cells), 3), EMPTY if dtype == np.int64 else np.nan, dtype)
    values[whole] = inner[(np.cumsum(lengths) - lengths)[whole, None] + np.arange(3)]
    return values


def _numbers(array: Any) -> NDArray[Any]:
    """Return numbers (n,), nulls as NaN or EMPTY; Arrow's own ways to numpy import pandas (.3 s)."""
    array = _unwrapped(array)
    if pa.types.is_decimal(array.type):
        array = array.cast(pa.float64())
    dtype = _dtype(array.type) or np.dtype(np.float64)
    if not len(array):
        return np.empty(0, dtype)
    values = np.frombuffer(array.buffers()[1], dtype, len(array), dtype.itemsize * array.offset)
    if not array.null_count:
        return values
    return np.where(_known(array), values, EMPTY if dtype == np.int64 else np.nan)


def _known(array: Any) -> NDArray[np.bool_]:
    """Return flags (n,) of cells that are not null."""
    if not array.null_count:
        return np.ones(len(array), np.bool_)
    end = array.offset + len(array)
    bits = np.frombuffer(array.buffers()[0], np.uint8)
    return np.unpackbits(bits, count=end, bitorder="little")[array.offset :].view(np.bool_)
