"""Reads Parquet files a column and a few pages at a time; damaged row groups lose only their own rows."""

from __future__ import annotations

import json
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from accelcal_cli.core.errors import NoRecordingError, UnreadableError, printable
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.parallel import thread_pool
from accelcal_cli.core.recording import METADATA_KEY, Calibrated, Chunk, Reader
from accelcal_cli.core.system import open_file_name
from accelcal_cli.formats._bytes import ByteSource
from accelcal_cli.formats._tables.channels import Marks
from accelcal_cli.formats._tables.reader import ReadingPlan, TableReader, plan_of, source_of
from accelcal_cli.formats._tables.table import BLOCK_ROWS, Attributes, SensorTable, Track
from accelcal_cli.formats.arrow import ENCRYPTED_MAGIC, PARQUET_MAGIC
from accelcal_cli.formats.arrow.columns import (
    ARROW_ERRORS,
    Columns,
    PartRows,
    attributes,
    stated_of,
)
from accelcal_cli.parquet import row_group_offsets

PAGES_BYTES, WHOLE_BYTES = 1 << 20, 32 << 20
"""Bytes of a column that are read at a time: a row group may be as long as the recording. In a shorter one a
column is read whole, and pyarrow believes no page that claims to be longer (else it asks for up to 2 GB)."""

HIGHEST_RATIO = 1100
"""No recording has more rows for each byte of its file; a damaged footer may claim any number."""

FARTHEST_ROWS = 1 << 22
"""Longest row group [rows] of a preview that is spread evenly: each can be entered only at its beginning."""

LARGEST_TEXT, MOST_ENTRIES = 100_000_000, 2_000_000
"""Bytes of a text, and entries of a list, in the footer."""

MOST_LOOKED_AT = 1 << 22
"""Longest footer [bytes] that is searched for where row groups begin (2 s)."""

REFUSED = "refused"
LONGEST_WORD, LARGEST_MG = 40, 1e6
AGAIN = "copy it again from its source"


def open_recording(path: Path, options: ReadOptions) -> ParquetReader:
    """Open a Parquet file whose acceleration is three columns of numbers, or one of lists of three.

    Raises:
        UnreadableError: damaged, cut short, encrypted, or nothing in it is known as acceleration.
        UsageError: an option names no column.
    """
    with opened(path) as table:
        plan = plan_of(source_of(table, table.tracks, options, table.damaged), "parquet")
        if table.is_ours:
            plan = as_ours(plan, table.calibrated, table.tracks)
        return ParquetReader(plan, table.longest)


def as_ours(plan: ReadingPlan, calibrated: Calibrated | None, tracks: tuple[Track, ...]) -> ReadingPlan:
    """Return the plan of a file that accelcal wrote, which marks the rows that were measured."""
    marks = Marks(tuple(track for track in tracks if track.path == "/validity"))
    channels = {**plan.channels, "validity": marks} if marks.tracks else plan.channels
    return replace(plan, recording=replace(plan.recording, calibrated=calibrated), channels=channels)


class ParquetReader(TableReader):
    """Streams the rows of a plan."""

    def __init__(self, plan: ReadingPlan, longest: int) -> None:
        super().__init__(plan)
        self._longest = longest

    @contextmanager
    def table(self) -> Iterator[ParquetTable]:
        """Open the file; portions are read ahead where several threads may work."""
        with thread_pool(self.threads, "parquet") as pool, opened(self.recording.path, pool) as table:
            yield table

    def preview(self, chunk_samples: int, pieces: int) -> Iterator[Chunk]:
        """Yield up to `pieces` chunks, spread evenly where row groups are short enough to be entered."""
        if self._longest > FARTHEST_ROWS:
            yield from Reader.preview(self, chunk_samples, pieces)
        else:
            yield from super().preview(chunk_samples, pieces)


class ParquetTable(SensorTable):
    """An open Parquet file.

    Attributes:
        is_ours: True if accelcal wrote it.
        calibrated: set for a calibrated recording of ours.
        damaged: number of columns that cannot be told apart.
        longest: rows of the longest row group.
    """

    def __init__(self, path: Path, file: Any, again: Any, pool: Executor | None) -> None:
        self.path, self._again, self._pool = path, again, pool
        self._begins: list[int | None] | None = None
        self._metadata = file.metadata
        schema = file.schema_arrow
        groups = [
            self._metadata.row_group(number).num_rows for number in range(self._metadata.num_row_groups)
        ]
        self._first_rows = self._checked(groups)
        self._columns = Columns(schema, int(self._first_rows[-1]))
        self.damaged = self._columns.doubtful
        self._stated = stated_of(schema)
        self.is_ours, self.calibrated = self._origin(schema)
        self.longest = max(groups, default=0)
        self.tracks, self.text_tracks = self._columns.tracks, self._columns.text_tracks

    def _checked(self, groups: list[int]) -> NDArray[np.int64]:
        rows = sum(groups)
        if min(groups, default=0) < 0 or rows > self.path.stat().st_size * HIGHEST_RATIO:
            raise UnreadableError(
                f"its footer claims {rows} rows, more than the file can hold", path=self.path, hint=AGAIN
            )
        if not rows:
            raise UnreadableError("holds no rows", path=self.path, hint="write it again with its rows")
        return np.cumsum([0, *groups], dtype=np.int64)

    def _origin(self, schema: Any) -> tuple[bool, Calibrated | None]:
        """Return whether we wrote it, and how it was calibrated; a refused one holds raw values."""
        text = (schema.metadata or {}).get(METADATA_KEY)
        if text is None:
            return False, None
        if not {"time", *"xyz", "validity"} <= set(schema.names):
            what, hint = (
                "is a table that accelcal wrote, not a recording",
                "use `accelcal fit` for still windows",
            )
            raise NoRecordingError(what, path=self.path, hint=hint)
        about = _section(text)
        recording, result = (about.get(name) for name in ("recording", "result"))
        recording, result = (one if isinstance(one, dict) else {} for one in (recording, result))
        self._stated |= {"sample_rate": recording.get("sample_rate_hz"), "time_zone": None}
        if about.get("outcome") == REFUSED and about.get("calibration") is None:
            return True, None
        name = printable(Path(str(recording.get("path") or "a recording of unknown name")).name)
        outcome, error = result.get("outcome"), result.get("held_out_mg")
        return True, Calibrated(
            name,
            printable(outcome)[:LONGEST_WORD] if isinstance(outcome, str) else None,
            float(error) if isinstance(error, int | float) and abs(error) < LARGEST_MG else None,
        )

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
        leaf, whole, paged = self._columns.leaves[track.path], self._again(0), self._again(PAGES_BYTES)
        names = [".".join((leaf.column, *leaf.fields))]

        def batches(first: int, end: int) -> Iterator[NDArray[Any]]:
            groups = list(range(first, end))
            large = any(self._metadata.row_group(group).total_byte_size > WHOLE_BYTES for group in groups)
            file = paged if large else whole
            for batch in file.iter_batches(BLOCK_ROWS, groups, names, use_threads=False):
                yield self._columns.values_of(track, batch)

        return PartRows(track, self._first_rows, batches, self._offset, self._pool)

    def _offset(self, group: int) -> int | None:
        """Return the byte at which the first column of a row group begins."""
        if self._begins is None:
            self._begins = row_group_offsets(self.path, MOST_LOOKED_AT)
        return self._begins[group] if group < len(self._begins) else None


def _section(text: bytes) -> dict[str, Any]:
    """Return our metadata; empty if they are damaged."""
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


@contextmanager
def opened(path: Path, pool: Executor | None = None) -> Iterator[ParquetTable]:
    """Open a Parquet file, and close it afterwards.

    Raises:
        UnreadableError: its footer is missing, damaged or encrypted.
    """
    _refuse_ends(path)
    with path.open("rb") as plain:
        # pyarrow takes names as UTF-8 alone, and reads through Python only one thread at a time.
        name = open_file_name(plain)
        files: list[Any] = []

        def again(buffer_bytes: int = 0, metadata: Any = None) -> Any:
            source = pa.OSFile(name) if name is not None else pa.PythonFile(path.open("rb"), "r")
            files.append(source)
            return pq.ParquetFile(
                source,
                metadata=metadata,
                buffer_size=buffer_bytes,
                pre_buffer=False,
                page_checksum_verification=True,
                thrift_string_size_limit=LARGEST_TEXT,
                thrift_container_size_limit=MOST_ENTRIES,
            )

        try:
            try:
                file = again()
                table = ParquetTable(path, file, lambda size: again(size, file.metadata), pool)
            except ARROW_ERRORS as error:
                what = f"its footer cannot be read ({' '.join(str(error).split())[:200]})"
                raise UnreadableError(what, path=path, hint=f"the file is damaged: {AGAIN}") from error
            yield table
        finally:
            for source in files:
                source.close()


def _refuse_ends(path: Path) -> None:
    """Raise UnreadableError if the first or the last bytes are not those of a whole Parquet file."""
    with ByteSource(path) as source:
        if source.compressed:
            raise UnreadableError(
                "is a Parquet file inside gzip", path=path, hint="unpack it first with gunzip"
            )
        first, last = source.read_exact(4), b""
        size = source.file_bytes
        if size >= 12:
            source.seek(size - 4)
            last = source.read_exact(4)
    if ENCRYPTED_MAGIC in (first, last):
        raise UnreadableError("is encrypted", path=path, hint="write it again without encryption")
    if first != PARQUET_MAGIC:
        raise UnreadableError("is not a Parquet file, or its beginning is damaged", path=path, hint=AGAIN)
    if last != PARQUET_MAGIC:
        raise UnreadableError(
            "is cut short: its end, which says where everything is, is missing",
            path=path,
            byte_offset=size,
            hint="copy it again from its source, or let the program that writes it finish",
        )
