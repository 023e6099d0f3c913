"""An open text file of numbers: what is known of the recording, and its rows as chunks.

Bad rows are left out; breaks, jumps of the clock and what else is wrong become problems.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core import recording
from accelcal_cli.core.clock import MICROSECONDS, Clock, StampClock, UniformClock, rate_fraction
from accelcal_cli.core.errors import UnreadableError, counted
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.local_time import FOLLOWED
from accelcal_cli.core.recording import Channels, Chunk, Intake, Problem, Reader, Recording, Validity
from accelcal_cli.formats._problems import Event, Kind, ProblemLog, Run
from accelcal_cli.formats._stamps import GAP_PERIODS
from accelcal_cli.formats.csv.detect import HEAD_BYTES, Detected, detect, last_timestamp
from accelcal_cli.formats.csv.rows import (
    Fault,
    FollowedChanges,
    IdleFill,
    RowParser,
    Rows,
    SpreadRows,
    block_bytes,
    joined,
)
from accelcal_cli.formats.csv.table import Block, LineCutter, LineFile, RepeatedHeads

SINGLE = 50
"""Problems of a kind that are given one by one."""

MISSING = ("missing_value", "{rows} from line {line} on left out: a value is missing")
OUT_OF_RANGE = ("out_of_range", "{rows} from line {line} on left out: a value is beyond any sensor's range")
IMPOSSIBLE = ("impossible_time", "{rows} from line {line} on left out: an impossible time")
ASLEEP = ("idle_sleep", "{rows} from line {line} on not measured: the device slept, and repeated a value")
AHEAD = ("clock_gap", "the time jumps ahead{jump} before line {line}{repeated}")
BACK = ("clock_back", "the time goes back{jump} before line {line}{repeated}")
WITH_ITS_ZONE = (FOLLOWED, "the times follow a change of the clocks in {zone} before line {{line}}")
BROKEN_OFF = "the compressed data ends early or is damaged; the rows before that were read"
CODES = [code for code, _ in (MISSING, OUT_OF_RANGE, IMPOSSIBLE, ASLEEP, AHEAD, BACK, WITH_ITS_ZONE)]
"""The order of those problems that only the end of the file completes."""

NO_DATE = "the file has no date; times count from 1970-01-01"


def open_recording(path: Path, options: ReadOptions) -> CsvReader:
    """Open a text file of numbers.

    Raises:
        UnreadableError: it holds no rows of numbers, or they can be read in several ways; the
            hint says which option settles it.
        UsageError: an option names no column, or counts come without their scale.
    """
    return CsvReader(path, detect(path, options))


class CsvReader(Reader):
    """Streams a text file. See `docs/csv-files.md` for what is recognised."""

    def __init__(self, path: Path, detected: Detected) -> None:
        self._path = path
        self._detected = detected
        self.recording = _recording(path, detected, self._first_time(), last_timestamp(detected.parser))

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """Yield all usable rows, at most `chunk_samples` at a time.

        Raises:
            UnreadableError: a line is no row of the file, or most rows cannot be used.
        """
        changes = self._changes()
        assembler = Assembler(self._detected, changes.rows, self.recording.timezone)
        heads = RepeatedHeads(self._detected.head)
        for rows, block in joined(self._settled(chunk_samples, heads, [changes]), chunk_samples):
            for chunk in assembler.chunks(rows, block, chunk_samples):
                if len(chunk) or chunk.problems:
                    yield chunk
        if (end := _ended(assembler, heads, block, self._detected)).problems:
            yield end

    def intake(self) -> Intake:
        """See `Reader`."""
        return CsvIntake(self._detected, self._changes(), self.recording.timezone)

    def _changes(self) -> FollowedChanges:
        return FollowedChanges(self.recording.timezone if self.recording.stamped else None)

    def _settled(
        self, chunk_samples: int, heads: RepeatedHeads, changes: Sequence[FollowedChanges] = ()
    ) -> Iterator[tuple[Rows, Block]]:
        """Rows with their final times, and the block they came with; once a block."""
        detected, dialect = self._detected, self._detected.parser.dialect
        row_parser = RowParser(detected.parser, detected.scale, detected.first_values, detected.gyro)
        stages = [*changes, *_stages(detected)]
        size = block_bytes(chunk_samples, detected.line_bytes)
        with LineFile(self._path, dialect.bare_returns, self.threads) as file:
            blocks = file.blocks(dialect.offset, dialect.skipped + 1, size)
            for parsed, block in row_parser.rows(map(heads.without, blocks), self.threads):
                rows = parsed
                for stage in stages:
                    rows = stage.add(rows, block.last)
                yield rows, block

    def _first_time(self) -> int | None:
        """Time of the first usable row [us], None without dates."""
        assembler = Assembler(self._detected)
        samples = int(HEAD_BYTES / self._detected.line_bytes)
        for rows, block in self._settled(samples, RepeatedHeads(self._detected.head)):
            for chunk in assembler.chunks(rows, block, max(samples, 1)):
                if len(chunk):
                    return int(chunk.clock.times(0, 1)[0]) if self._detected.has_dates else None
            if block.offset > 16 * HEAD_BYTES:
                break
        raise _unusable(self._detected, f"none of its first {assembler.rows} rows holds usable values")


def _unusable(detected: Detected, what: str) -> UnreadableError:
    parser = detected.parser
    line = parser.dialect.skipped + 1
    return UnreadableError(what, path=parser.path, line=line, hint="check --columns and --unit")


def _stages(detected: Detected) -> list[SpreadRows | IdleFill]:
    """What is done to rows after they are parsed and their zone's changes are undone."""
    stages: list[SpreadRows | IdleFill] = []
    if detected.pace.stamp_period_us:
        stages.append(SpreadRows(detected.pace))
    if detected.export.repeats_idle:
        stages.append(IdleFill(round(detected.pace.rate_hz)))
    return stages


def _ended(assembler: Assembler, heads: RepeatedHeads, block: Block, detected: Detected) -> Chunk:
    """What the end of a file completes; raises UnreadableError if most rows cannot be used."""
    if 2 * assembler.samples < assembler.rows or not assembler.samples:
        raise _unusable(detected, f"only {assembler.samples} of {assembler.rows} rows hold usable values")
    return assembler.end(block, _joined_files(heads.lines, assembler.samples))


class CsvIntake(Intake):
    """Takes a text file as it grows, whole lines at a time."""

    def __init__(self, detected: Detected, changes: FollowedChanges, zone: str | None) -> None:
        dialect = replace(detected.parser.dialect, sample=(), lines=())
        detected = replace(detected, parser=replace(detected.parser, dialect=dialect))
        self._detected = detected
        self._lines = LineCutter(dialect, detected.parser.path)
        self._heads = RepeatedHeads(detected.head)
        self._parser = RowParser(detected.parser, detected.scale, detected.first_values, detected.gyro)
        self._stages = [changes, *_stages(detected)]
        self._assembler = Assembler(detected, changes.rows, zone)

    def take(self, data: bytes, *, last: bool) -> Iterator[Chunk]:
        """See `Intake`."""
        block = self._lines.cut(data, last=last)
        if not block.data and not last:
            return
        for parsed, passed in self._parser.rows([self._heads.without(block)], 1):
            rows = parsed
            for stage in self._stages:
                rows = stage.add(rows, last)
            yield from self._assembler.chunks(rows, passed, max(1, len(rows)))
        if last:
            yield _ended(self._assembler, self._heads, block, self._detected)


def _recording(path: Path, detected: Detected, first_us: int | None, last_us: int | None) -> Recording:
    export, written = detected.export, detected.parser.time
    length = None if first_us is None or last_us is None else (last_us - first_us) / 1e6
    return Recording(
        path=path,
        format="csv",
        rate_hz=detected.pace.rate_hz,
        lsb_per_g=detected.scale.lsb_per_g,
        total_bytes=path.stat().st_size,
        device=export.device,
        range_g=export.range_g,
        start_us=first_us,
        timezone=detected.timezone,
        has_offsets=written is not None and written.has_offsets,
        stamped=written is not None and written.since_1970,
        duration_s=length if length is not None and length > 0 else None,
        has_temperature="temperature_mc" in detected.first_values,
        gyro_dps_per_lsb=None if detected.gyro is None else (1 / detected.gyro.lsb,) * 3,
        companion=export.companion,
        notes=detected.notes(),
    )


@dataclass(frozen=True, slots=True)
class _Kept:
    """The good rows of a stretch: their numbers, lines and times (times None for a uniform clock)."""

    keep: NDArray[np.bool_] | None
    row: NDArray[np.int64]
    line: NDArray[np.int64]
    time_us: NDArray[np.int64] | None

    def of(self, values: Any) -> Any:
        """The entries of these rows in a column of the stretch."""
        return values if self.keep is None else values[self.keep]


class Assembler:
    """Makes chunks of all rows of a file, in order.

    Args:
        followed: numbers of the rows before which the times follow a change of their zone; known as soon as
            the rows are.
    """

    def __init__(self, detected: Detected, followed: Sequence[int] = (), zone: str | None = None) -> None:
        problems = () if detected.has_dates else (Problem("no_start_time", NO_DATE, None, 0),)
        self._row_bytes = max(1, round(detected.line_bytes))
        self._no_channels: Channels = {name: np.empty(0, np.int32) for name in detected.first_values}
        if detected.gyro is not None:
            self._no_channels["gyro_counts"] = np.empty((0, 3), np.int32)
        self._stamped = detected.parser.time is not None
        self._start_us = detected.start_us or 0
        self._pace = detected.pace
        self._rate = rate_fraction(detected.pace.rate_hz)
        self._log = ProblemLog(problems, _message, SINGLE, by_end=True)
        self._followed, self._with_its_zone = followed, (FOLLOWED, WITH_ITS_ZONE[1].format(zone=zone))
        self._last_row = -1
        self._last_us = 0
        self._last_jump: Kind | None = None
        self.samples = 0
        self.rows = 0

    def chunks(self, rows: Rows, block: Block, chunk_samples: int) -> Iterator[Chunk]:
        """The good ones of the next rows, which end with a block, at most `chunk_samples` to a chunk."""
        kept = self._kept(rows)
        counts = kept.of(rows.counts)
        channels = {name: kept.of(values) for name, values in (rows.channels | _validity(rows)).items()}
        events = list(self._row_events(rows))
        breaks, clock_jumps = self._breaks(kept, events, rows.first_row + len(rows))
        for event in events:
            self._log.add(event)
        self.rows += len(rows)
        problems = self._log.take(self.rows)
        pieces = max(1, -(-len(counts) // chunk_samples))
        borders = [len(counts) * piece // pieces for piece in range(pieces + 1)]
        for start, stop in pairwise(borders):
            part = slice(start, stop)
            yield Chunk(
                self.samples,
                counts[part],
                self._clock(kept, start, stop),
                block.end_byte,
                breaks=breaks[(breaks >= start) & (breaks < stop)] - start,
                clock_jumps=clock_jumps[(clock_jumps >= start) & (clock_jumps < stop)] - start,
                problems=problems if start == 0 else (),
                used_bytes=(stop - start) * self._row_bytes,
                **recording.cut_channels(channels, part),
            )
            self.samples += stop - start

    def end(self, block: Block, more: tuple[Problem, ...] = ()) -> Chunk:
        """An empty chunk with what the end of the file completes: runs that reach it, the rest of many."""
        left = sorted(self._log.take(None), key=lambda problem: CODES.index(problem.code))
        return Chunk(
            self.samples,
            np.empty((0, 3), np.int32),
            StampClock(np.empty(0, np.int64)),
            block.end_byte,
            problems=(*left, *more, *_cut_short(block, self.samples)),
            used_bytes=0,
            **self._no_channels,
        )

    def _row_events(self, rows: Rows) -> Iterator[Event]:
        """Rows that are left out, and such as the device did not measure."""
        good = rows.fault == Fault.NONE
        flags: list[tuple[Kind, NDArray[np.bool_], int]] = []
        if not good.all():
            flags.append((MISSING, rows.fault == Fault.MISSING, self._row_bytes))
            flags.append((OUT_OF_RANGE, rows.fault == Fault.OUT_OF_RANGE, self._row_bytes))
            flags.append((IMPOSSIBLE, rows.fault == Fault.TIME, self._row_bytes))
        if rows.filled is not None and rows.filled.any():
            flags.append((ASLEEP, rows.filled, 0))
        here = [row - rows.first_row for row in self._followed if 0 <= row - rows.first_row < len(rows)]
        if here:
            flags.append((self._with_its_zone, np.isin(np.arange(len(rows)), here), 0))
        before = np.cumsum(good) - good if flags else good
        for kind, flag, row_bytes in flags:
            places = np.flatnonzero(flag)
            for index, count, scattered in self._log.runs(kind, places):
                place = int(places[index])
                row, line, sample = rows.first_row + place, int(rows.line[place]), int(before[place])
                amounts = (self.samples + sample, count, 0, count * row_bytes)
                yield Event(row, count, *kind, None, *amounts, line, scattered)

    def _kept(self, rows: Rows) -> _Kept:
        if not rows.fault.any():
            return _Kept(None, rows.row, rows.line, rows.time_us)
        keep = rows.fault == Fault.NONE
        stamps = rows.time_us
        if stamps is None:
            stamps = UniformClock(self._start_us, rows.first_row, self._rate).times(0, len(rows))
        return _Kept(keep, rows.row[keep], rows.line[keep], stamps[keep])

    def _clock(self, kept: _Kept, start: int, stop: int) -> Clock:
        if kept.time_us is not None:
            return StampClock(kept.time_us[start:stop])
        first = int(kept.row[start]) if len(kept.row) else 0
        return UniformClock(self._start_us, first, self._rate)

    def _breaks(
        self, kept: _Kept, events: list[Event], stop: int
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Rows before which the recording is not continuous, and those of them where only the clock jumps.

        Jumps of the clock are added to the events.

        A jump reaches up to the next good row, or to `stop`, the row after the stretch, until more is known.
        """
        if self._last_jump is not None:
            length = (int(kept.row[0]) if len(kept.row) else stop) - self.rows
            events.append(Event(self.rows, length, *self._last_jump, None, self.samples, 0))
        if not len(kept.row):
            return recording.NO_BREAKS, recording.NO_BREAKS
        first = self._last_row < 0
        rows = self._strides(kept)
        broken = rows > 1
        self._last_row = int(kept.row[-1])
        if kept.time_us is None or not self._stamped:
            return np.flatnonzero(broken), recording.NO_BREAKS
        steps = np.diff(kept.time_us, prepend=kept.time_us[0] if first else self._last_us)
        self._last_us = int(kept.time_us[-1])
        ahead = steps > (rows + GAP_PERIODS - 1) * self._pace.period_us
        back = steps < 0
        for kind, jumps in ((AHEAD, ahead), (BACK, back)):
            if jumps.any():
                events += self._jumps(kind, np.flatnonzero(jumps), kept, steps, stop)
        self._last_jump = AHEAD if ahead[-1] else BACK if back[-1] else None
        jumps = ahead | back
        return np.flatnonzero(broken | jumps), np.flatnonzero(jumps & ~broken)

    def _strides(self, kept: _Kept) -> NDArray[np.int64]:
        """How many rows of the file each is after the good one before: (n,), or (1,) where all are alike."""
        before = int(kept.row[0]) - 1 if self._last_row < 0 else self._last_row
        if kept.keep is None and kept.row[0] == before + 1:
            return np.ones(1, np.int64)
        return np.diff(kept.row, prepend=before)

    def _jumps(
        self, kind: Kind, places: NDArray[np.int64], kept: _Kept, steps: NDArray[np.int64], stop: int
    ) -> Iterator[Event]:
        """Jumps before the good rows `places`; `steps` are the times since the good row before [us]."""
        ends = np.append(kept.row[1:], stop)
        for index, count, scattered in self._log.runs(kind, places):
            place = int(places[index])
            row = int(kept.row[place])
            length = int(ends[places[index + count - 1]]) - row
            line, size = int(kept.line[place]), int(steps[place])
            yield Event(row, length, *kind, None, self.samples + place, count, size, 0, line, scattered)


def _message(run: Run) -> str:
    """What is wrong with the rows of a run, and where."""
    size, count, line = run.event.amount_us, run.count, run.event.line
    text = run.event.text.format(
        rows="1 row" if count == 1 else f"{count} rows",
        line=line,
        jump=f" by {abs(size) / MICROSECONDS:g} s" if size and not run.scattered else "",
        repeated=f", and so on for {count} rows" if count > 1 else "",
    )
    return f"and more of the same: {text}" if run.scattered else text


def _joined_files(lines: Sequence[int], samples: int) -> tuple[Problem, ...]:
    """That the names of the columns stand in these lines again."""
    if not lines:
        return ()
    more = f" and {counted(len(lines) - 1, 'more line')}" if len(lines) > 1 else ""
    text = f"the names of the columns stand again in line {lines[0]}{more}: files that were joined"
    return (Problem("repeated_head", text, None, samples, count=len(lines)),)


def _cut_short(block: Block, samples: int) -> tuple[Problem, ...]:
    """What the last block leaves behind."""
    text = BROKEN_OFF
    if not block.broken:
        if not block.tail.strip() and not block.zeros:
            return ()
        line = block.line + block.lines
        text = f"line {line}, the last one, has no end: it may be cut off and was left out"
        if not block.tail.strip(b"\0"):
            text = f"the file ends in {block.zeros + len(block.tail)} bytes of zeros, which hold no rows"
    return (Problem("truncated", text, block.end, samples, lost_bytes=len(block.tail) + block.zeros),)


def _validity(rows: Rows) -> Channels:
    """Of every row, as a channel; none if all were measured."""
    if rows.filled is None or not rows.filled.any():
        return {}
    return {"validity": np.where(rows.filled, np.uint8(Validity.FILLED), np.uint8(Validity.MEASURED))}
