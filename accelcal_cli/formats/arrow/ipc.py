"""Reads Arrow IPC files (Feather) and streams a record batch at a time, only the columns that are needed.

A file's footer says where its batches are. A stream has none, and a file that was cut short has lost it:
there one message follows the other. `scan` reads nothing but their heads.

Source: the Arrow columnar format, "Encapsulated message format" and "IPC file format", and its FlatBuffers
schemas: Message (version, header type, header, length of the body), RecordBatch (length, nodes, buffers,
compression), Footer (version, schema, dictionaries, record batches: each 24 bytes, with the offset first).
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.parallel import thread_pool
from accelcal_cli.core.system import open_file_name
from accelcal_cli.formats._bytes import ByteSource
from accelcal_cli.formats._tables.reader import TableReader, plan_of, source_of
from accelcal_cli.formats._tables.table import BLOCK_ROWS, Attributes, SensorTable, Track
from accelcal_cli.formats.arrow import CONTINUATION, FEATHER_MAGIC, OLD_FEATHER_MAGIC
from accelcal_cli.formats.arrow.columns import (
    ARROW_ERRORS,
    Columns,
    PartRows,
    attributes,
    is_text,
    stated_of,
)

AGAIN = "copy it again from its source"
HIGHEST_RATIO = 1100
"""No recording has more rows for each byte of its file; a damaged message may claim any number."""

BATCH = 3
"""Header type of a record batch."""

HEADER_TYPE, HEADER, BODY_LENGTH = 1, 2, 3
ROWS, COMPRESSION = 0, 3
FOOTER_BATCHES = 3
"""Numbers of the fields of Message, RecordBatch and Footer."""

BLOCK_BYTES = 24
FILE_END = FEATHER_MAGIC.rstrip(b"\0")
LARGEST_HEAD = 1 << 26
"""Largest head of a message in bytes; one that claims more is not read as a message."""


@dataclass(frozen=True, slots=True)
class Batch:
    """A record batch.

    Attributes:
        offset: byte at which its message begins.
        packed: its body is compressed.
    """

    offset: int
    rows: int
    body_bytes: int
    packed: bool


@dataclass(frozen=True, slots=True)
class Messages:
    """The messages of a file in their order.

    Attributes:
        first: byte at which the first message, the schema, begins.
        missing: bytes that the last message should have beyond the end of the file; -1 where a file ends
            without its footer; 0 for a whole one.
        damaged: number of batches that cannot be found; they stand as batches without rows.
    """

    batches: tuple[Batch, ...]
    first: int
    missing: int
    damaged: int = 0


def scan(path: Path) -> Messages:
    """Find the batches of an Arrow IPC file or stream; of one that is cut short, the first ones."""
    with path.open("rb") as file:
        size = path.stat().st_size
        if file.read(len(FEATHER_MAGIC)) != FEATHER_MAGIC:
            return _chained_messages(file, size, 0)
        offsets = _footer_offsets(file, size)
        if offsets is None:
            return _chained_messages(file, size, len(FEATHER_MAGIC))
        found = [_message_at(file, offset) for offset in offsets]
        batches = [one.batch if one and one.batch and one.end <= size else None for one in found]
        known = tuple(batch or Batch(0, 0, 0, False) for batch in batches)
        return Messages(known, len(FEATHER_MAGIC), 0, batches.count(None))


def _footer_offsets(file: BinaryIO, size: int) -> list[int] | None:
    """Return where the messages of batches begin by the footer; None without a footer."""
    tail = len(FILE_END) + 4
    file.seek(max(0, size - tail))
    end = file.read(tail)
    length = int.from_bytes(end[:4], "little")
    if end[4:] != FILE_END or length + tail > size:
        return None
    file.seek(size - tail - length)
    footer = file.read(length)
    try:
        at = _field(footer, _number_at("<I", footer, 0), FOOTER_BATCHES)
        vector = at + _number_at("<I", footer, at)
        places = range(vector + 4, vector + 4 + BLOCK_BYTES * _number_at("<I", footer, vector), BLOCK_BYTES)
        return [_number_at("<q", footer, place) for place in places] if at and places.stop <= length else None
    except (struct.error, ValueError):
        return None


def _chained_messages(file: BinaryIO, size: int, first: int) -> Messages:
    """Go from message to message, up to the end or to bytes that are not a message."""
    batches: list[Batch] = []
    place, missing = first, -1 if first else 0
    while place < size:
        found = _message_at(file, place)
        if found is None:
            return Messages(tuple(batches), first, -1)
        if not found.kind:
            break
        if found.end > size:
            return Messages(tuple(batches), first, found.end - size)
        batches += [found.batch] if found.batch else []
        place = found.end
    return Messages(tuple(batches), first, missing)


@dataclass(frozen=True, slots=True)
class _Message:
    """A message.

    Attributes:
        kind: 0 for the end of a stream.
        end: byte behind its body.
        batch: set for a record batch.
    """

    kind: int
    end: int
    batch: Batch | None = None


def _message_at(file: BinaryIO, place: int) -> _Message | None:
    """Return the message that begins at a byte; None if none does."""
    if place < 0:
        return None
    file.seek(place)
    head = file.read(8)
    length = int.from_bytes(head[4:], "little", signed=True)
    if len(head) < 8 or head[:4] != CONTINUATION or not 0 <= length <= LARGEST_HEAD:
        return None
    if not length:
        return _Message(0, place + 8)
    return _parsed_message(file.read(length), place, place + 8 + length)


def _parsed_message(data: bytes, offset: int, body: int) -> _Message | None:
    """Return a message whose body begins at byte `body`; None if it makes no sense."""
    try:
        root = _number_at("<I", data, 0)
        kind = _number_at("<B", data, _field(data, root, HEADER_TYPE))
        body_bytes = _number_at("<q", data, where) if (where := _field(data, root, BODY_LENGTH)) else 0
        batch = None
        if kind == BATCH:
            at = _field(data, root, HEADER)
            table = at + _number_at("<I", data, at)
            rows = _number_at("<q", data, where) if (where := _field(data, table, ROWS)) else 0
            batch = Batch(offset, rows, body_bytes, bool(_field(data, table, COMPRESSION)))
    except (struct.error, ValueError):
        return None
    sound = body_bytes >= 0 and kind and (batch is None or batch.rows >= 0)
    return _Message(kind, body + body_bytes, batch) if sound else None


def _field(data: bytes, table: int, number: int) -> int:
    """Return the place of a field of a FlatBuffers table; 0 if it has its default."""
    fields = table - _number_at("<i", data, table)
    place = 4 + 2 * number
    if fields < 0 or place + 2 > _number_at("<H", data, fields):
        return 0
    offset = _number_at("<H", data, fields + place)
    return table + offset if offset else 0


def _number_at(form: str, data: bytes, place: int) -> int:
    if place < 0:
        raise ValueError("before the beginning")
    (value,) = struct.unpack_from(form, data, place)
    return int(value)


def open_recording(path: Path, options: ReadOptions) -> IpcReader:
    """Open an Arrow IPC file or stream whose acceleration is three columns of numbers, or lists of three.

    Raises:
        UnreadableError: damaged, or nothing in it is known as acceleration.
        UsageError: an option names no column.
    """
    with opened(path) as table, table.explaining():
        return IpcReader(plan_of(source_of(table, table.tracks, options, table.damaged), "feather"))


class IpcReader(TableReader):
    """Streams the rows of a plan."""

    repack = "write it again with at most 65 536 rows in a batch (in Python: pyarrow.feather.write_feather)"

    @contextmanager
    def table(self) -> Iterator[IpcTable]:
        """Open the file; batches are read ahead where several threads may work."""
        with thread_pool(self.threads, "feather") as pool, opened(self.recording.path, pool) as table:
            yield table


@contextmanager
def _disk_errors(path: Path) -> Iterator[None]:
    """Raise UnreadableError for errors of the system; those of Arrow for a damaged file have no number."""
    try:
        yield
    except OSError as error:
        if error.errno is None:
            raise
        raise UnreadableError(f"cannot be read ({os.strerror(error.errno)})", path=path) from error


class _Batches:
    """The batches of a file for one column, by their numbers, or one after the other in a stream."""

    def __init__(self, name: str, path: Path, messages: Messages, columns: list[int] | None) -> None:
        self._name, self._path, self._first = name, path, messages.first
        self._options = pa.ipc.IpcReadOptions(use_threads=False, included_fields=columns)
        self._whole = messages.first > 0 and not messages.missing
        self._next = 0
        with _disk_errors(path):
            self._open()

    def _open(self) -> None:
        self._source = pa.OSFile(self._name)
        if self._whole:
            self._reader = pa.ipc.open_file(self._source, options=self._options)
        else:
            self._source.seek(self._first)
            self._reader = pa.ipc.open_stream(self._source, options=self._options)
        self._next = 0

    @property
    def schema(self) -> Any:
        """The schema of the columns."""
        return self._reader.schema

    def batch(self, number: int) -> Any:
        """Return a record batch; raise as pyarrow does, and UnreadableError if the disk fails."""
        with _disk_errors(self._path):
            return self._read(number)

    def _read(self, number: int) -> Any:
        if self._whole:
            return self._reader.get_batch(number)
        if number < self._next:
            self.close()
            self._open()
        while self._next < number:
            self._next += 1
            self._reader.read_next_batch()
        self._next += 1
        return self._reader.read_next_batch()

    def close(self) -> None:
        """Release the file."""
        self._source.close()


class IpcTable(SensorTable):
    """An open Arrow IPC file or stream.

    Attributes:
        damaged: number of columns that cannot be told apart, and of batches that cannot be found.
    """

    def __init__(
        self, path: Path, messages: Messages, open_batches: Callable[[list[int] | None], _Batches], pool: Any
    ) -> None:
        self.path, self._messages, self._open, self._pool = path, messages, open_batches, pool
        self._schema = open_batches(None).schema
        rows = [batch.rows for batch in messages.batches]
        if sum(rows) > path.stat().st_size * HIGHEST_RATIO:
            raise UnreadableError(
                f"claims {sum(rows)} rows, more than the file can hold", path=path, hint=AGAIN
            )
        if not sum(rows):
            raise UnreadableError("holds no rows", path=path, hint=AGAIN)
        self._first_rows = np.cumsum([0, *rows], dtype=np.int64)
        self._columns = Columns(self._schema, int(self._first_rows[-1]))
        self.damaged = self._columns.doubtful + messages.damaged
        self._stated = stated_of(self._schema)
        self.tracks, self.text_tracks = self._columns.tracks, self._columns.text_tracks

    def missing_bytes(self) -> int:
        """Return the number of bytes that are missing at the end; -1 if that is not known."""
        return self._messages.missing

    def texts_of(self, track: Track) -> list[str] | None:
        """Return the texts of a column that were read so far; None for one of numbers."""
        return self._columns.texts_of(track)

    def own(self, path: str) -> Attributes:
        """Return the metadata of a column."""
        return attributes(self._columns.leaves[path])

    def stated(self, path: str) -> Attributes:
        """Return the metadata of a column, then those of the file."""
        return attributes(self._columns.leaves[path], self._stated)

    def rows(self, track: Track) -> PartRows:
        """Return the rows of a column."""
        leaf = self._columns.leaves[track.path]
        kind = self._schema.field(leaf.column).type
        nested = pa.types.is_nested(kind) or pa.types.is_dictionary(kind) or is_text(kind)
        source = self._open([self._schema.get_field_index(leaf.column)])

        def batches(first: int, end: int) -> Iterator[NDArray[Any]]:
            for number in range(first, end):
                batch = source.batch(number)
                batch.validate(full=nested)  # pyarrow ends the process over lengths and places that cannot be
                for start in range(0, len(batch), BLOCK_ROWS):
                    yield self._columns.values_of(track, batch.slice(start, BLOCK_ROWS))

        def offset(number: int) -> int:
            return self._messages.batches[number].offset

        found = PartRows(track, self._first_rows, batches, offset, self._pool)
        largest = max((batch.rows for batch in self._messages.batches if batch.packed), default=0)
        found.kept_bytes = largest * found.row_bytes if largest > BLOCK_ROWS else 0
        return found


@contextmanager
def opened(path: Path, pool: Executor | None = None) -> Iterator[IpcTable]:
    """Open an Arrow IPC file or stream, and close it afterwards; of one cut short, the rest is read.

    Raises:
        UnreadableError: its schema is damaged, or it is of the first version of Feather.
    """
    _refuse_others(path)
    with ExitStack() as stack:
        plain = stack.enter_context(path.open("rb"))
        name = open_file_name(plain) or str(path)
        try:
            messages = scan(path)

            def open_batches(columns: list[int] | None) -> _Batches:
                batches = _Batches(name, path, messages, columns)
                stack.callback(batches.close)
                return batches

            table = IpcTable(path, messages, open_batches, pool)
        except ARROW_ERRORS as error:
            what = f"its schema cannot be read ({' '.join(str(error).split())[:200]})"
            raise UnreadableError(what, path=path, hint=f"the file is damaged: {AGAIN}") from error
        yield table


def _refuse_others(path: Path) -> None:
    with ByteSource(path) as source:
        head, compressed = source.read_exact(8), source.compressed
    if compressed:
        raise UnreadableError("is an Arrow file inside gzip", path=path, hint="unpack it first with gunzip")
    if head.startswith(OLD_FEATHER_MAGIC):
        raise UnreadableError(
            "is a Feather file of version 1", path=path, hint="write it again with a newer pyarrow or arrow"
        )
    if head != FEATHER_MAGIC and not head.startswith(CONTINUATION):
        raise UnreadableError("is not an Arrow file, or its beginning is damaged", path=path, hint=AGAIN)
