"""Reads an open text file of numbers as chunks; bad rows are left out, and what is wrong becomes problems.

Rows pass several steps. `FollowedChanges` makes the times run on where they follow daylight saving.
`SpreadRows` gives every row a time where several rows share a stamp, such as whole seconds. `IdleFill` marks
what a device wrote while it slept. Rows of small blocks are then joined, since every stretch of rows costs
the same afterwards, however short. The assembler makes chunks of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core import recording
from accelcal_cli.core.clock import MICROSECONDS, RESET_US, Clock, StampClock, UniformClock, rate_fraction
from accelcal_cli.core.errors import AccelcalError, UnreadableError, counted, printable
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.local_time import FOLLOWED, LocalStamps
from accelcal_cli.core.recording import (
    CUT_SHORT,
    Channels,
    Chunk,
    Intake,
    Problem,
    Reader,
    Recording,
    Validity,
)
from accelcal_cli.formats._problems import Event, Kind, ProblemLog, Run
from accelcal_cli.formats._rows import RepeatedSamples
from accelcal_cli.formats._stamps import GAP_PERIODS, IMPOSSIBLE, Pace, SharedStamps
from accelcal_cli.formats._tables.sensors import device_of
from accelcal_cli.formats._wraps import WRAPPED, RunningOn, Wraps, text_of
from accelcal_cli.formats.csv.detect import HEAD_BYTES, Detected, detect, last_timestamp
from accelcal_cli.formats.csv.dialect import Dialect
from accelcal_cli.formats.csv.exports import sibling_gyroscope
from accelcal_cli.formats.csv.gyroscope import READ_AS, WithGyroscope, can_join
from accelcal_cli.formats.csv.lines import Block, InUtf8, LineCutter, LineFile, RepeatedHeads
from accelcal_cli.formats.csv.rows import CsvRows, Fault, RowParser, joined_rows, not_rows

BLOCK_BYTES = 1 << 21
"""Text that is parsed at a time, however many samples are wanted: its table takes as much again."""

MOST_JOINED = 1 << 18
"""Rows that are joined however many are wanted: more of them are made no faster, and take memory."""

LEAST_SHARE = 0.5
"""Share of the time that its rows take below which the span of a file's times is not its length."""

SINGLE = 50
"""Problems of one kind that are given one by one; more are summed up."""

MISSING = ("missing_value", "{rows} from line {line} on left out: a value is missing")
OUT_OF_RANGE = ("out_of_range", "{rows} from line {line} on left out: a value is beyond any sensor's range")
BAD_LINE = ("bad_line", "{rows} from line {line} on left out: {why}")
IMPOSSIBLE_TIME = ("impossible_time", "{rows} from line {line} on left out: an impossible time")
ASLEEP = ("idle_sleep", "{rows} from line {line} on not measured: the device slept, and repeated a value")
AHEAD = ("clock_gap", "the time jumps ahead{jump} before line {line}{repeated}")
BACK = ("clock_back", "the time goes back{jump} before line {line}{repeated}")
WITH_ITS_ZONE = (FOLLOWED, "the times follow a change of the clocks in {zone} before line {{line}}")
NO_LINE_END = "no_line_end"
BROKEN_OFF = "the compressed data ends early or is damaged; the rows before that were read"
KINDS = MISSING, OUT_OF_RANGE, IMPOSSIBLE_TIME, BAD_LINE, ASLEEP, AHEAD, BACK, WITH_ITS_ZONE
CODES = [*(code for code, _ in KINDS), WRAPPED]
"""The order of problems that only the end of the file completes."""

NO_DATE = "the file has no date; times count from 1970-01-01"


class FollowedChanges:
    """Makes times run on where they follow a change of their zone's offset.

    Attributes:
        rows: numbers, from 0, of the rows before which they follow one.
    """

    def __init__(self, zone: str | None) -> None:
        self._stamps = None if zone is None else LocalStamps(zone)
        self.rows: list[int] = []

    def add(self, rows: CsvRows, _last: bool) -> CsvRows:
        """Return the next rows with the times of a clock that runs on."""
        if rows.time_us is None or self._stamps is None:
            return rows
        timed = np.flatnonzero(rows.time_us > IMPOSSIBLE)
        running, followed = self._stamps.running_on(rows.time_us[timed])
        self.rows += (rows.first_row + timed[followed]).tolist()
        times = rows.time_us.copy()
        times[timed] = running
        return replace(rows, time_us=times)


class RunningRows:
    """Makes times run on where a counter wraps, or a clock shows no new day (see `RunningOn`)."""

    def __init__(self, wraps: Wraps) -> None:
        self.clock = RunningOn(wraps)

    def add(self, rows: CsvRows, _last: bool) -> CsvRows:
        """Return the next rows with the times of a clock that runs on."""
        return rows if rows.time_us is None else replace(rows, time_us=self.clock.running_on(rows.time_us))


class SpreadRows:
    """Gives rows that share a stamp times of their own (see `SharedStamps`)."""

    def __init__(self, pace: Pace) -> None:
        self._stamps = SharedStamps(pace)
        self._waiting: CsvRows | None = None

    def add(self, rows: CsvRows, last: bool) -> CsvRows:
        """Take the next rows; return those whose times are settled (all, where these are the last)."""
        assert rows.time_us is not None
        times = self._stamps.add(rows.time_us, last)
        rows = rows if self._waiting is None else joined_rows([self._waiting, rows])
        self._waiting = None if last else rows.part(len(times), len(rows))
        return replace(rows.part(0, len(times)), time_us=times)


class IdleFill:
    """Marks rows of zeros, and rows that repeat the one before for long (see `RepeatedSamples`).

    Args:
        least: length of a run of equal rows from which on all but the first are marked.
    """

    def __init__(self, least: int) -> None:
        self._repeats = RepeatedSamples(least)
        self._waiting: CsvRows | None = None

    def add(self, rows: CsvRows, last: bool) -> CsvRows:
        """Take the next rows; return those that are settled (all, where these are the last)."""
        rows = rows if self._waiting is None else joined_rows([self._waiting, rows])
        usable = rows.fault == Fault.NONE
        filled = self._repeats.mark(rows.counts, usable, last=last)
        settled = len(filled)
        x, y, z = rows.counts[:settled].T
        filled |= usable[:settled] & ((x | y | z) == 0)
        self._waiting = rows.part(settled, len(rows)) if settled < len(rows) else None
        return replace(rows.part(0, settled), filled=filled)


class RowStream:
    """Parses blocks into rows with their final times, in the order of the file.

    Args:
        zone: whose daylight saving the times may follow, None if they do not.

    Attributes:
        followed: numbers of the rows before which the times follow a change; it grows with the rows.
        clock: knows before which rows the times were read on.
        heads: finds the names of the columns where they stand again.
    """

    def __init__(self, detected: Detected, zone: str | None = None) -> None:
        watch = None if detected.watch is None else detected.watch.again()
        self._parser = RowParser(detected.parser, detected.scale, detected.first_values, detected.gyro, watch)
        self.heads, self._dialect = RepeatedHeads(detected.head), detected.parser.dialect
        running, changes = RunningRows(detected.wraps), FollowedChanges(zone)
        self.clock, self.followed = running.clock, changes.rows
        self._steps: list[RunningRows | FollowedChanges | SpreadRows | IdleFill] = [running, changes]
        if detected.pace.stamp_period_us:
            self._steps.append(SpreadRows(detected.pace))
        if detected.export.repeats_idle:
            self._steps.append(IdleFill(round(detected.pace.rate_hz)))

    def rows(self, blocks: Iterable[Block], threads: int) -> Iterator[tuple[CsvRows, Block]]:
        """Yield the settled rows, and the block they came with, once a block."""
        whole = map(self._with_last_row, map(self.heads.without, blocks))
        for parsed, block in self._parser.rows(whole, threads):
            rows = parsed
            for step in self._steps:
                rows = step.add(rows, block.last)
            yield rows, block

    def _with_last_row(self, block: Block) -> Block:
        """Return the last block with a row at its end that has no line end, but all its columns."""
        if not block.last or block.broken or block.zeros or not self._dialect.is_row(block.tail):
            return block
        end = block.end + len(block.tail)
        return replace(block, data=block.data + block.tail + b"\n", lines=block.lines + 1, tail=b"", end=end)


def joined(parts: Iterable[tuple[CsvRows, Block]], samples: int) -> Iterator[tuple[CsvRows, Block]]:
    """Yield rows of blocks, joined up to `samples` rows, each with its last block."""
    samples = min(samples, MOST_JOINED)
    stretches: list[CsvRows] = []
    number, last_block = 0, None
    for rows, block in parts:
        if last_block is not None and number + len(rows) > samples:
            yield _emptied(stretches), last_block
            number = 0
        if len(rows) or not stretches:
            stretches.append(rows)
        number, last_block = number + len(rows), block
    if last_block is not None:
        yield _emptied(stretches), last_block


def _emptied(stretches: list[CsvRows]) -> CsvRows:
    """Join stretches of rows, and empty the list so that it does not keep their memory."""
    rows = joined_rows(stretches)
    stretches.clear()
    return rows


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a text file of numbers.

    Raises:
        UnreadableError: it holds no rows of numbers, or they can be read in several ways; the
            hint says which option settles it.
        UsageError: an option names no column, or counts come without their scale.
    """
    reader = CsvReader(path, detect(path, options))
    stated = options.gyro_unit is not None or options.gyro_columns is not None or options.columns is not None
    gyro = None if stated else sibling_gyroscope(path)
    if gyro is None or reader.recording.gyro_dps_per_lsb is not None:
        return reader
    read_as = ReadOptions(unit=READ_AS[gyro.unit][0], columns=gyro.columns, gyro_unit="none")
    try:
        rates = CsvReader(gyro.path, detect(gyro.path, read_as))
    except AccelcalError as error:
        return _noted(reader, f"{gyro.path.name} was not used: {error.message}")
    if not can_join(reader, rates):
        return _noted(reader, f"{gyro.path.name} was not used: it did not begin together with {path.name}")
    return WithGyroscope(reader, rates, gyro.path.name, gyro.unit)


def _noted(reader: CsvReader, note: str) -> CsvReader:
    """Return a reader whose recording has one more note."""
    reader.recording = replace(reader.recording, notes=(*reader.recording.notes, printable(note)))
    return reader


class CsvReader(Reader):
    """Streams a text file. See `docs/csv-files.md` for what is recognised."""

    def __init__(self, path: Path, detected: Detected) -> None:
        self._path = path
        self._detected = detected
        self.may_hold_several = detected.watch is not None and detected.watch.again() is not None
        self.recording = _recording(path, detected, self._first_time(), last_timestamp(detected.parser))

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """Yield all usable rows, at most `chunk_samples` at a time.

        Raises:
            UnreadableError: a line is not a row of the file, or most rows cannot be used.
        """
        stream = RowStream(self._detected, self._zone)
        assembler = CsvAssembler(self._detected, stream, self.recording.timezone)
        for rows, block in joined(self._rows(stream, chunk_samples), chunk_samples):
            for chunk in assembler.chunks(rows, block, chunk_samples):
                if len(chunk) or chunk.problems:
                    yield chunk
        if (end := assembler.end(block, stream.heads.lines)).problems:
            yield end

    def intake(self) -> Intake:
        """See `Reader`."""
        stream = RowStream(self._detected, self._zone)
        return CsvIntake(self._detected, stream, self.recording.timezone)

    @property
    def _zone(self) -> str | None:
        return self.recording.timezone if self.recording.stamped else None

    def _rows(self, stream: RowStream, chunk_samples: int) -> Iterator[tuple[CsvRows, Block]]:
        dialect = self._detected.parser.dialect
        size = max(1, min(BLOCK_BYTES, int(0.95 * chunk_samples * self._detected.line_bytes)))
        with LineFile(self._path, dialect.bare_returns, self.threads) as file:
            yield from stream.rows(file.blocks(dialect.offset, dialect.skipped + 1, size), self.threads)

    def _first_time(self) -> int | None:
        assembler = CsvAssembler(self._detected)
        samples = int(HEAD_BYTES / self._detected.line_bytes)
        for rows, block in self._rows(RowStream(self._detected), samples):
            for chunk in assembler.chunks(rows, block, max(samples, 1)):
                if len(chunk):
                    return int(chunk.clock.times(0, 1)[0]) if self._detected.has_dates else None
            if assembler.rows > 2 * assembler.empty and block.offset > 16 * HEAD_BYTES:
                break
        raise _unusable(self._detected, f"none of its first {assembler.rows} rows holds usable values")


def _unusable(detected: Detected, what: str) -> UnreadableError:
    parser = detected.parser
    line = parser.dialect.skipped + 1
    return UnreadableError(what, path=parser.path, line=line, hint="check --columns and --unit")


class CsvIntake(Intake):
    """Takes a text file as it grows, whole lines at a time."""

    def __init__(self, detected: Detected, stream: RowStream, zone: str | None) -> None:
        dialect = detected.parser.dialect
        self._bare_returns, self._in_utf8 = dialect.bare_returns, InUtf8()
        self._lines = LineCutter(detected.parser.path, dialect.offset, dialect.skipped + 1)
        self._stream = stream
        self._assembler = CsvAssembler(detected, stream, zone)

    def take(self, data: bytes, *, last: bool) -> Iterator[Chunk]:
        """See `Intake`."""
        data = self._in_utf8(data)
        lines = self._lines.cut([data.replace(b"\r", b"\n") if self._bare_returns else data])
        block = self._lines.block(lines, last)
        if not lines and not last:
            return
        for rows, passed in self._stream.rows([block], 1):
            yield from self._assembler.chunks(rows, passed, max(1, len(rows)))
            if last:
                yield self._assembler.end(passed, self._stream.heads.lines)


def _recording(path: Path, detected: Detected, first_us: int | None, last_us: int | None) -> Recording:
    export, written, watch = detected.export, detected.parser.time, detected.watch
    length = None if first_us is None or last_us is None else _length_s(path, detected, last_us - first_us)
    return Recording(
        path=path,
        format="csv",
        rate_hz=detected.pace.rate_hz,
        lsb_per_g=detected.scale.lsb_per_g,
        total_bytes=path.stat().st_size,
        device=device_of(export.device, watch.note if detected.parser.sensor and watch else None),
        range_g=export.range_g,
        start_us=first_us,
        timezone=detected.timezone,
        has_offsets=written is not None and written.has_offsets,
        stamped=written is not None and written.since_1970,
        duration_s=length,
        has_temperature="temperature_mc" in detected.first_values,
        gyro_dps_per_lsb=None if detected.gyro is None else (1 / detected.gyro.lsb,) * 3,
        companion=export.companion,
        notes=detected.notes(),
    )


def _length_s(path: Path, detected: Detected, span_us: int) -> float | None:
    """Return the time from the first row to the last [s]; None if the clock did not run on between them."""
    rows = path.stat().st_size / detected.line_bytes
    ran_on = max(0.0, LEAST_SHARE * rows * detected.pace.period_us) < span_us <= RESET_US
    return span_us / MICROSECONDS if ran_on or (detected.parser.sensor and span_us > 0) else None


@dataclass(frozen=True, slots=True)
class _GoodRows:
    """The good rows of a stretch: their numbers, lines and times (times None for a uniform clock)."""

    keep: NDArray[np.bool_] | None
    row: NDArray[np.int64]
    line: NDArray[np.int64]
    time_us: NDArray[np.int64] | None

    def of(self, values: Any) -> Any:
        """Return the entries of these rows in a column of the stretch."""
        return values if self.keep is None else values[self.keep]


class CsvAssembler:
    """Makes chunks of all rows of a file, in order.

    Args:
        stream: of the rows, which knows before which of them the times were changed; None: none were.
    """

    def __init__(self, detected: Detected, stream: RowStream | None = None, zone: str | None = None) -> None:
        self._detected = detected
        problems = () if detected.has_dates else (Problem("no_start_time", NO_DATE, None, 0),)
        self._row_bytes = max(1, round(detected.line_bytes))
        self._no_channels: Channels = {name: np.empty(0, np.int32) for name in detected.first_values}
        if detected.gyro is not None:
            self._no_channels["gyro_counts"] = np.empty((0, 3), np.int32)
        self._stamped = detected.parser.time is not None
        self._start_us = detected.start_us or 0
        self._pace = detected.pace
        self._rate = rate_fraction(detected.pace.rate_hz)
        self._log, self._bad = ProblemLog(problems, self._message, SINGLE, by_end=True), dict[int, str]()
        self._followed = [] if stream is None else stream.followed
        self._ran_on = RunningOn(Wraps()) if stream is None else stream.clock
        self._with_its_zone = (FOLLOWED, WITH_ITS_ZONE[1].format(zone=zone))
        self._last_row = -1
        self._last_us = 0
        self._last_jump: Kind | None = None
        self.samples = self.rows = self.empty = 0

    def chunks(self, rows: CsvRows, block: Block, chunk_samples: int) -> Iterator[Chunk]:
        """Yield the good rows of the next ones, which end with a block, at most `chunk_samples` a chunk."""
        kept = self._kept(rows)
        counts = kept.of(rows.counts)
        channels = {name: kept.of(values) for name, values in rows.channels.items()}
        if rows.filled is not None and rows.filled.any():
            validity = np.where(rows.filled, np.uint8(Validity.FILLED), np.uint8(Validity.MEASURED))
            channels["validity"] = kept.of(validity)
        events = list(self._row_events(rows))
        breaks, clock_jumps = self._breaks(kept, events, rows.first_row + len(rows))
        for event in events:
            self._log.add(event)
        for line in rows.bad if len(self._bad) <= SINGLE else ():
            self._bad[line] = rows.bad[line]
        self.rows += len(rows)
        self.empty += int(np.count_nonzero(rows.fault == Fault.EMPTY))
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

    def end(self, block: Block, repeated_heads: Sequence[int]) -> Chunk:
        """Return an empty chunk with what the end of the file completes: runs that reach it, sums of many.

        Args:
            repeated_heads: lines in which the names of the columns stand again.

        Raises:
            UnreadableError: most rows cannot be used.
        """
        if 2 * self.samples < self.rows - self.empty or not self.samples:
            if self._bad:
                raise not_rows(self._detected.parser.path, *next(iter(self._bad.items())))
            what = f"only {self.samples} of {self.rows} rows hold usable values"
            raise _unusable(self._detected, what)
        more = _joined_files(repeated_heads, self.samples)
        left = sorted(self._log.take(None), key=lambda problem: CODES.index(problem.code))
        return Chunk(
            self.samples,
            np.empty((0, 3), np.int32),
            StampClock(np.empty(0, np.int64)),
            block.end_byte,
            problems=(*left, *more, *_cut_short(block, self.samples, self._detected.parser.dialect)),
            used_bytes=0,
            **self._no_channels,
        )

    def _row_events(self, rows: CsvRows) -> Iterator[Event]:
        """Yield what concerns single rows: those left out, those not measured, changes of the clocks."""
        yield from self._wrap_events(rows)
        good = rows.fault == Fault.NONE
        flags: list[tuple[Kind, NDArray[np.bool_], int]] = []
        if not good.all():
            missing = rows.fault == Fault.MISSING
            missing |= (rows.fault == Fault.EMPTY) & (self._detected.stride == 1)
            flags.append((MISSING, missing, self._row_bytes))
            flags.append((OUT_OF_RANGE, rows.fault == Fault.OUT_OF_RANGE, self._row_bytes))
            flags.append((IMPOSSIBLE_TIME, rows.fault == Fault.TIME, self._row_bytes))
            flags.append((BAD_LINE, rows.fault == Fault.LINE, self._row_bytes))
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
                empty = int(np.count_nonzero(rows.fault[places[index : index + count]] == Fault.EMPTY))
                amounts = (self.samples + sample, count, 0, (count - empty) * row_bytes)
                yield Event(row, count, *kind, None, *amounts, line, scattered, empty)

    def _message(self, run: Run) -> str:
        """Return what is wrong with a run of rows."""
        size, count, line = run.event.amount_us, run.count, run.event.line
        text = run.event.text.format(
            rows="1 row" if count == 1 else f"{count} rows",
            line=line,
            why=self._bad.get(line, "lines that are not rows of this table"),
            jump=f" by {abs(size) / MICROSECONDS:g} s" if size and not run.scattered else "",
            repeated=f", and so on for {count} rows" if count > 1 else "",
        )
        return f"and more of the same: {text}" if run.scattered else text

    def _wrap_events(self, rows: CsvRows) -> Iterator[Event]:
        for row, jump_us in self._ran_on.taken(rows.first_row + len(rows)):
            place = row - rows.first_row
            sample = self.samples + int(np.count_nonzero(rows.fault[:place] == Fault.NONE))
            kind = WRAPPED, text_of(jump_us)
            yield Event(row, 1, *kind, None, sample, 1, jump_us, 0, int(rows.line[place]))

    def _kept(self, rows: CsvRows) -> _GoodRows:
        if not rows.fault.any():
            return _GoodRows(None, rows.row, rows.line, rows.time_us)
        keep = rows.fault == Fault.NONE
        stamps = rows.time_us
        if stamps is None:
            stamps = UniformClock(self._start_us, rows.first_row, self._rate).times(0, len(rows))
        return _GoodRows(keep, rows.row[keep], rows.line[keep], stamps[keep])

    def _clock(self, kept: _GoodRows, start: int, stop: int) -> Clock:
        if kept.time_us is not None:
            return StampClock(kept.time_us[start:stop])
        first = int(kept.row[start]) if len(kept.row) else 0
        return UniformClock(self._start_us, first, self._rate)

    def _breaks(
        self, kept: _GoodRows, events: list[Event], stop: int
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return rows before which the recording is not continuous, and those where only the clock jumps.

        Jumps of the clock are added to the events. A jump reaches up to the next good row, or to `stop`, the
        row after the stretch, until more is known.
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

    def _strides(self, kept: _GoodRows) -> NDArray[np.int64]:
        """Return distances [rows] from the good row before: (n,), or (1,) where all are alike."""
        before = int(kept.row[0]) - 1 if self._last_row < 0 else self._last_row
        if kept.keep is None and kept.row[0] == before + 1:
            return np.ones(1, np.int64)
        return -(-np.diff(kept.row, prepend=before) // self._detected.stride)

    def _jumps(
        self, kind: Kind, places: NDArray[np.int64], kept: _GoodRows, steps: NDArray[np.int64], stop: int
    ) -> Iterator[Event]:
        """Yield jumps before the good rows `places`; `steps` are the times since the good row before [us]."""
        ends = np.append(kept.row[1:], stop)
        for index, count, scattered in self._log.runs(kind, places):
            place = int(places[index])
            row = int(kept.row[place])
            length = int(ends[places[index + count - 1]]) - row
            line, size = int(kept.line[place]), int(steps[place])
            yield Event(row, length, *kind, None, self.samples + place, count, size, 0, line, scattered)


def _joined_files(lines: Sequence[int], samples: int) -> tuple[Problem, ...]:
    """Return the problem that the names of the columns stand in these lines again."""
    if not lines:
        return ()
    more = f" and {counted(len(lines) - 1, 'more line')}" if len(lines) > 1 else ""
    text = f"the names of the columns are repeated in line {lines[0]}{more}: files that were joined"
    return (Problem("repeated_head", text, None, samples, count=len(lines)),)


def _cut_short(block: Block, samples: int, dialect: Dialect) -> tuple[Problem, ...]:
    """Return what is wrong with the end; more is missing unless the last line has all its cells."""
    text, code = BROKEN_OFF, CUT_SHORT
    if not block.broken:
        if not block.tail.strip() and not block.zeros:
            return ()
        line = block.line + block.lines
        text = f"line {line}, the last one, has no end: it may be cut off and was left out"
        code = NO_LINE_END if dialect.is_whole(block.tail) else CUT_SHORT
        if not block.tail.strip(b"\0"):
            text = f"the file ends in {block.zeros + len(block.tail)} bytes of zeros, which hold no rows"
    return (Problem(code, text, block.end, samples, lost_bytes=len(block.tail) + block.zeros),)
