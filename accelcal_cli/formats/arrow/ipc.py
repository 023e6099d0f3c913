"""Arrow IPC files (Feather) and streams: a record batch at a time, of those columns alone that are needed."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from accelcal_cli.core.errors import AccelcalError, UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.parallel import thread_pool
from accelcal_cli.formats._bytes import ByteSource
from accelcal_cli.formats._tables.attributes import Attributes
from accelcal_cli.formats._tables.plan import plan_of, source_of
from accelcal_cli.formats._tables.reader import TableReader
from accelcal_cli.formats._tables.table import BLOCK_ROWS, Table
from accelcal_cli.formats._tables.tracks import Track
from accelcal_cli.formats.arrow import CONTINUATION, FEATHER_MAGIC, OLD_FEATHER_MAGIC
from accelcal_cli.formats.arrow.columns import attributes, leaves_of, stated_of, values_of
from accelcal_cli.formats.arrow.messages import Messages, scan
from accelcal_cli.formats.arrow.parts import ARROW_ERRORS, PartRows

AGAIN = "copy it again from its source"
HIGHEST_RATIO = 1100
"""No recording has more rows for each byte of its file; a damaged message may claim any number."""


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
        """The file; batches are taken ahead where several threads may work."""
        with thread_pool(self.threads, "feather") as pool, opened(self.recording.path, pool) as table:
            yield table


@contextmanager
def _given_by_disk(path: Path) -> Iterator[None]:
    """Raise UnreadableError for what the system says; what Arrow says of a damaged file has no number."""
    try:
        yield
    except OSError as error:
        if error.errno is None:
            raise
        raise UnreadableError(f"cannot be read ({os.strerror(error.errno)})", path=path) from error


class _Batches:
    """The batches of a file, for one column: by their numbers, or one after the other in a stream."""

    def __init__(self, name: str, path: Path, messages: Messages, columns: list[int] | None) -> None:
        self._name, self._path, self._first = name, path, messages.first
        self._options = pa.ipc.IpcReadOptions(use_threads=False, included_fields=columns)
        self._whole = messages.first > 0 and not messages.missing
        self._next = 0
        with _given_by_disk(path):
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
        """Of the columns."""
        return self._reader.schema

    def batch(self, number: int) -> Any:
        """A record batch; raises as pyarrow does, and UnreadableError where the disk does not give it."""
        with _given_by_disk(self._path):
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


class IpcTable(Table):
    """An open Arrow IPC file or stream.

    Attributes:
        damaged: how many columns cannot be told apart, and batches cannot be found.
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
        self._leaves, doubtful = leaves_of(self._schema, int(self._first_rows[-1]))
        self.damaged = doubtful + messages.damaged
        self._stated = stated_of(self._schema)
        self.tracks = tuple(sorted((leaf.track for leaf in self._leaves.values()), key=lambda one: one.path))

    def missing_bytes(self) -> int:
        """How many bytes are missing at the end; -1 where that is not known."""
        return self._messages.missing

    @contextmanager
    def explaining(self, damaged: int = 0) -> Iterator[None]:
        """Add to any error of ours that the file is cut short, if it is."""
        try:
            yield
        except AccelcalError as error:
            if self._messages.missing:
                what = f"is cut short, so that {error.message}"
                raise type(error)(what, path=self.path, hint=error.hint or AGAIN) from error
            raise

    def own(self, path: str) -> Attributes:
        """The metadata of a column."""
        return attributes(self._leaves[path])

    def stated(self, path: str) -> Attributes:
        """The metadata of a column, then those of the file."""
        return attributes(self._leaves[path], self._stated)

    def rows(self, track: Track) -> PartRows:
        """The rows of a column."""
        leaf = self._leaves[track.path]
        kind = self._schema.field(leaf.column).type
        nested = pa.types.is_nested(kind) or pa.types.is_dictionary(kind)
        source = self._open([self._schema.get_field_index(leaf.column)])

        def batches(first: int, end: int) -> Iterator[NDArray[Any]]:
            for number in range(first, end):
                batch = source.batch(number)
                batch.validate(full=nested)  # pyarrow ends the process over lengths and places that cannot be
                for start in range(0, len(batch), BLOCK_ROWS):
                    yield values_of(leaf, batch.slice(start, BLOCK_ROWS))

        found = PartRows(track, self._first_rows, batches, self._offset, self._pool)
        largest = max((batch.rows for batch in self._messages.batches if batch.packed), default=0)
        found.kept_bytes = largest * found.row_bytes if largest > BLOCK_ROWS else 0
        return found

    def _offset(self, number: int) -> int | None:
        return self._messages.batches[number].offset


@contextmanager
def opened(path: Path, pool: Executor | None = None) -> Iterator[IpcTable]:
    """An Arrow IPC file or stream, closed afterwards; of one that was cut short, what is left.

    Raises:
        UnreadableError: its schema is damaged, or it is of the first version of Feather.
    """
    _refuse_others(path)
    with ExitStack() as stack:
        plain = stack.enter_context(path.open("rb"))
        name = f"/proc/self/fd/{plain.fileno()}" if Path("/proc/self/fd").exists() else str(path)
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
