"""An open text file of numbers: what is known of the recording, and its rows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from accelcal_cli.core.clock import StampClock
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Chunk, Problem, Reader, Recording
from accelcal_cli.formats.csv.chunks import Assembler
from accelcal_cli.formats.csv.detect import HEAD_BYTES, Opened, examine, last_time
from accelcal_cli.formats.csv.rows import FillFinder, RowMaker, Rows, Spreader, block_bytes, joined
from accelcal_cli.formats.csv.table import Block, LineFile


class CsvReader(Reader):
    """Streams a text file. See `docs/csv-files.md` for what is recognised."""

    def __init__(self, path: Path, opened: Opened, timezone: str | None) -> None:
        self._path = path
        self._opened = opened
        self.recording = _recording(path, opened, timezone, self._first_time(), last_time(opened.sheet))

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """Yield all usable rows, at most `chunk_samples` at a time.

        Raises:
            UnreadableError: a line is no row of the file, or most rows cannot be used.
        """
        assembler = self._assembler()
        notice = self._notices()
        end_byte = 0
        for rows, block in joined(self._settled(chunk_samples), chunk_samples):
            end_byte = block.end_byte
            for chunk in assembler.chunks(rows, end_byte, chunk_samples):
                if len(chunk) or chunk.problems or notice:
                    yield _with_problems(chunk, notice)
                    notice = ()
            if block.last:
                notice += (*assembler.finish(), *self._end_problems(block, assembler.samples))
        self._refuse_mostly_unusable(assembler)
        if notice:
            yield _end_chunk(assembler, notice, end_byte, self.recording.has_temperature)

    def _assembler(self) -> Assembler:
        opened = self._opened
        row_bytes = max(1, round(opened.line_bytes))
        return Assembler(opened.pace, opened.sheet.time is not None, opened.start_us or 0, row_bytes)

    def _settled(self, chunk_samples: int) -> Iterator[tuple[Rows, Block]]:
        """Rows with their final times, and the block they came with; once a block."""
        opened, dialect = self._opened, self._opened.sheet.dialect
        maker = RowMaker(opened.sheet, opened.scale, opened.temperature_c)
        stages: list[Spreader | FillFinder] = []
        if opened.pace.stamp_period_us:
            stages.append(Spreader(opened.pace))
        if opened.known.repeats_idle:
            stages.append(FillFinder(round(opened.pace.rate_hz)))
        size = block_bytes(chunk_samples, opened.line_bytes)
        file = LineFile(self._path, dialect.bare_returns)
        try:
            blocks = file.blocks(dialect.offset, dialect.skipped + 1, size)
            for made, block in maker.rows(blocks, self.threads):
                rows = made
                for stage in stages:
                    rows = stage.add(rows, block.last)
                yield rows, block
        finally:
            file.close()

    def _notices(self) -> tuple[Problem, ...]:
        if self._opened.dated:
            return ()
        text = "the file has no date; times count from 1970-01-01"
        return (Problem("no_start_time", text, None, 0),)

    def _end_problems(self, block: Block, samples: int) -> list[Problem]:
        if block.broken:
            text = "the compressed data ends early or is damaged; the rows before that were read"
            return [Problem("truncated", text, block.end, samples, lost_bytes=len(block.tail))]
        if block.tail.strip():
            line = block.line + block.lines
            text = f"line {line}, the last one, has no end: it may be cut off and was left out"
            return [Problem("truncated", text, block.end, samples, lost_bytes=len(block.tail))]
        return []

    def _refuse_mostly_unusable(self, assembler: Assembler) -> None:
        if 2 * assembler.samples < assembler.rows or not assembler.samples:
            raise UnreadableError(
                f"only {assembler.samples} of {assembler.rows} rows hold usable values",
                path=self._path,
                line=self._opened.sheet.dialect.skipped + 1,
                hint="check --columns and --unit",
            )

    def _first_time(self) -> int | None:
        """Time of the first usable row [us], None without dates.

        Raises:
            UnreadableError: the beginning of the file holds no usable row.
        """
        assembler = self._assembler()
        samples = int(HEAD_BYTES / self._opened.line_bytes)
        for rows, block in self._settled(samples):
            for chunk in assembler.chunks(rows, 0, max(samples, 1)):
                if len(chunk):
                    return int(chunk.clock.times(0, 1)[0]) if self._opened.dated else None
            if block.offset > 16 * HEAD_BYTES:
                break
        raise UnreadableError(
            f"none of its first {assembler.rows} rows holds usable values",
            path=self._path,
            line=self._opened.sheet.dialect.skipped + 1,
            hint="check --columns and --unit",
        )


def open_recording(path: Path, options: ReadOptions) -> CsvReader:
    """Open a text file of numbers.

    Raises:
        UnreadableError: it holds no rows of numbers, or they can be read in several ways; the
            hint says which option settles it.
        UsageError: an option names no column, or counts come without their scale.
    """
    return CsvReader(path, examine(path, options), options.timezone)


def _recording(
    path: Path, opened: Opened, timezone: str | None, first_us: int | None, last_us: int | None
) -> Recording:
    told, zone = opened.known, opened.timezone
    length = None if first_us is None or last_us is None else (last_us - first_us) / 1e6
    return Recording(
        path=path,
        format="csv",
        rate_hz=opened.pace.rate_hz,
        lsb_per_g=opened.scale.lsb_per_g,
        total_bytes=path.stat().st_size,
        device=told.device,
        range_g=told.range_g,
        start_us=first_us,
        timezone=zone if zone == "UTC" else timezone or zone,
        duration_s=length if length is not None and length > 0 else None,
        has_temperature=opened.temperature_c is not None,
        notes=opened.notes(),
    )


def _with_problems(chunk: Chunk, problems: tuple[Problem, ...]) -> Chunk:
    if not problems:
        return chunk
    return replace(chunk, problems=(*problems, *chunk.problems))


def _end_chunk(
    assembler: Assembler, problems: tuple[Problem, ...], end_byte: int, temperature: bool
) -> Chunk:
    """An empty chunk that carries what was found at the end of the file."""
    return Chunk(
        assembler.samples,
        np.empty((0, 3), np.int32),
        StampClock(np.empty(0, np.int64)),
        end_byte,
        temperature_mc=np.empty(0, np.int32) if temperature else None,
        problems=problems,
    )
