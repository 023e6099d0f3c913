"""Blocks of a table as rows: whole counts, times and faults, in the order of the table.

`RowParser` makes rows of each block by itself, on several threads; `RowStream` then carries on what lies
between blocks. `FollowedChanges` makes the times run on where they follow daylight saving. `SpreadRows` gives
every row a time where several rows share a stamp, such as whole seconds. `IdleFill` marks what a device wrote
while it slept.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core import recording
from accelcal_cli.core.clock import MICROSECONDS, Clock, StampClock, UniformClock, rate_fraction
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.local_time import FOLLOWED, LocalStamps
from accelcal_cli.core.parallel import parallel_map
from accelcal_cli.core.recording import (
    NOT_CALIBRATED,
    Channels,
    Chunk,
    Others,
    Problem,
    Validity,
    cut_channels,
    cut_columns,
    joined_channels,
    joined_columns,
    no_others,
)
from accelcal_cli.core.vocabulary import HeatUnit
from accelcal_cli.formats._problems import Event, Kind, ProblemLog, Run
from accelcal_cli.formats._rows import RepeatedSamples
from accelcal_cli.formats._stamps import (
    GAP_PERIODS,
    IMPOSSIBLE,
    LOST,
    NO_TIME,
    WRAPPED,
    Midnights,
    Pace,
    RunningOn,
    SharedStamps,
    Wraps,
    text_of,
)
from accelcal_cli.formats.tables.cells import number_of
from accelcal_cli.formats.tables.clock import TableClock
from accelcal_cli.formats.tables.header import As, Block, CellTexts, Piece, Source
from accelcal_cli.formats.tables.roles import Group
from accelcal_cli.formats.tables.sensors import Chosen, SensorWatch, codes_of
from accelcal_cli.formats.tables.units import (
    UNKNOWN,
    Fault,
    Scale,
    as_floats,
    group_values,
    held,
    millidegrees,
    refuse_grouped,
)

HEAT, TURNS, VALIDITY, OTHERS = "temperature_mc", "gyro_counts", "validity", "others"
MOST_BAD = 100_000
"""Lines that are not rows, above which a file that mostly has such lines is not read on."""

COLUMNS = ("line", "counts", "fault", "time_us", "filled", "where", "cold")
"""Fields of `Rows` with one entry a row."""


@dataclass(frozen=True, slots=True)
class Heat:
    """The temperature of a table: its column and unit, and the first value [thousandths of a degree C]."""

    column: int
    unit: HeatUnit
    first_mc: int


@dataclass(frozen=True, slots=True)
class Turns:
    """The rotation rates of a table: their columns, and how they become counts."""

    group: Group
    scale: Scale


@dataclass(frozen=True, slots=True)
class Layout:
    """The columns that are read of a table, and how, as it was found out when it was opened.

    Attributes:
        others: numbers of the columns of other quantities, if they are asked for.
        marks: the column that tells where each row comes from, as `Validity` numbers it.
        chosen: the rows that are read; None for all.
        wraps: what the clock may do.
        stride: rows from one with values to the next, in a table that other sensors share.
        start_us: time of the first row where rows carry none; None if it is not known.
        before_us: a time before the first row, by which times of the hour 24 are put on their day.
    """

    xyz: Group
    scale: Scale
    clock: TableClock | None
    pace: Pace
    heat: Heat | None = None
    turns: Turns | None = None
    others: tuple[int, ...] = ()
    marks: int | None = None
    chosen: Chosen | None = None
    wraps: Wraps = field(default_factory=Wraps)
    repeats_idle: bool = False
    stride: int = 1
    start_us: int | None = None
    before_us: int = NO_TIME

    @property
    def has_dates(self) -> bool:
        """True if its times count from 1970 rather than from its first row."""
        return self.start_us is not None if self.clock is None else self.clock.format.has_dates

    @property
    def wanted(self) -> dict[int, As]:
        """How the columns that are read are asked for."""
        group = (*self.xyz, *(() if self.turns is None else self.turns.group))
        wanted = {column.number: As.NUMBER for column in group}
        wanted |= {} if self.heat is None else {self.heat.column: As.NUMBER}
        wanted |= {} if self.marks is None else {self.marks: As.NUMBER}
        wanted |= {} if self.clock is None else self.clock.wanted
        return wanted | ({} if self.chosen is None else self.chosen.wanted)

    @property
    def asked(self) -> dict[int, As]:
        """How all columns are asked for, also those of other quantities."""
        return dict.fromkeys(self.others, As.NUMBER) | self.wanted

    @property
    def no_channels(self) -> Channels:
        """The channels of no rows."""
        channels: Channels = {} if self.heat is None else {HEAT: np.empty(0, np.int32)}
        if self.turns is not None:
            channels[TURNS] = np.empty((0, 3), np.int32)
        return channels


@dataclass(frozen=True, slots=True)
class Rows:
    """Consecutive rows of a table, good and bad ones.

    Attributes:
        first_row: number of the first among those that are read, from 0.
        line: (n,) line in a text file, or number in the table, from 1.
        counts: (n, 3).
        fault: (n,) of `Fault`.
        time_us: (n,) or None.
        channels: (n,) or (n, 3) each.
        filled: (n,) rows that the device did not measure, or None if none are known.
        where: (n,) for a row that is lost the number of the column that has lost it; None if none is.
        cold: (n,) rows without a temperature, or None if all have one.
        bad: what is wrong with lines that are not rows, by their line.
    """

    first_row: int
    line: NDArray[np.int64]
    counts: NDArray[Any]
    fault: NDArray[np.uint8]
    time_us: NDArray[np.int64] | None
    channels: Channels
    filled: NDArray[np.bool_] | None = None
    where: NDArray[np.int32] | None = None
    cold: NDArray[np.bool_] | None = None
    bad: Mapping[int, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.line)

    @property
    def row(self) -> NDArray[np.int64]:
        """(n,) number of each row among those that are read, from 0."""
        return self.first_row + np.arange(len(self), dtype=np.int64)

    def part(self, start: int, stop: int) -> Rows:
        """Return rows start..stop-1 as views."""
        rows = slice(start, stop)
        columns, channels = cut_columns(self, COLUMNS, rows), cut_channels(self.channels, rows)
        return replace(self, first_row=self.first_row + start, channels=channels, **columns)


def joined_rows(parts: list[Rows]) -> Rows:
    """Join rows of the same table that follow each other, at least one stretch of them."""
    if len(parts) == 1:
        return parts[0]
    for name, none in (("where", np.int32(-1)), ("cold", np.bool_(False))):
        if any(getattr(part, name) is not None for part in parts):
            parts = [_with(part, name, none) for part in parts]
    channels = joined_channels([part.channels for part in parts])
    bad = {line: fault for part in parts for line, fault in part.bad.items()}
    return Rows(parts[0].first_row, channels=channels, bad=bad, **joined_columns(parts, COLUMNS))


def _with(rows: Rows, name: str, value: np.generic) -> Rows:
    """Return rows with a column that may be missing."""
    present: dict[str, Any] = {name: np.full(len(rows), value)} if getattr(rows, name) is None else {}
    return replace(rows, **present)


class RowParser:
    """Turns pieces of a table into rows, in its order.

    Args:
        watch: looks at every piece, None if nothing does.
        first_row: number of the first row.
    """

    def __init__(self, source: Source, layout: Layout, watch: SensorWatch | None, first_row: int) -> None:
        self._source, self._layout, self._watch = source, layout, watch
        self._wanted = layout.wanted
        self._last_mc = UNKNOWN if layout.heat is None else layout.heat.first_mc
        self._next_row, self._bad = first_row, 0
        self._midnights = Midnights(NO_TIME if first_row else layout.before_us)
        self._first_bad: tuple[int, str] | None = None

    def rows(self, pieces: Iterable[Piece], threads: int) -> Iterator[tuple[Rows, Piece]]:
        """Yield the rows of pieces that follow each other, each with its piece, without the memory of that.

        Args:
            threads: how many may work at a time.

        Raises:
            UnreadableError: most lines are not rows of the table, or rows are of several sensors.
        """
        for parsed, piece, seen in parallel_map(self._rows_of, pieces, threads):
            times = None if parsed.time_us is None else self._midnights.settled(parsed.time_us)
            rows = replace(parsed, time_us=times)
            if rows.bad or self._bad:
                self._refuse_mostly_bad(rows)
            if self._watch is not None:
                self._watch.see(seen, rows.time_us)
            first, self._next_row = self._next_row, self._next_row + len(rows)
            if HEAT in rows.channels and len(rows):
                values = rows.channels[HEAT]
                if values[0] == UNKNOWN:  # the last one before holds
                    values = rows.channels[HEAT] = np.where(
                        values == UNKNOWN, np.int32(self._last_mc), values
                    )
                self._last_mc = int(values[-1])
            yield replace(rows, first_row=first), piece

    def _refuse_mostly_bad(self, rows: Rows) -> None:
        """Raise UnreadableError once most lines up to one are not rows, however the lines were cut."""
        self._first_bad = self._first_bad or next(iter(rows.bad.items()))
        bad = self._bad + np.cumsum(rows.fault == Fault.LINE)
        number = self._next_row + np.arange(1, len(rows) + 1)
        if ((bad > MOST_BAD) & (2 * bad > number)).any():
            raise not_rows(self._source, *self._first_bad)
        self._bad = int(bad[-1]) if len(bad) else self._bad

    def _rows_of(self, piece: Piece) -> tuple[Rows, Piece, Any]:
        """Return the rows of a piece by themselves, and what the watch saw; this may run in any order."""
        watch, layout = self._watch, self._layout
        codes = codes_of(() if watch is None else watch.columns)
        block, others = self._parsed(piece, self._wanted | codes)
        seen = None if watch is None else watch.look(block)
        if layout.scale.is_of_whole:
            refuse_grouped(group_values(block.values, layout.xyz), block.line, self._source, layout.scale)
        rows = rows_of(block, layout)
        if layout.others:
            rows.channels[OTHERS] = others_of(others, layout.others)
        if layout.chosen is not None:
            wanted = layout.chosen.rows(block)
            columns, channels = cut_columns(rows, COLUMNS, wanted), cut_channels(rows.channels, wanted)
            rows = replace(rows, channels=channels, **columns)  # lines that are not rows are of no sensor
            seen = None if seen is None else tuple(one._replace(codes=one.codes[wanted]) for one in seen)
        return rows, piece.emptied(), seen

    def _parsed(self, piece: Piece, wanted: dict[int, As]) -> tuple[Block, Block]:
        """Return a piece's columns, and those of other quantities, whose damage does not damage the rows."""
        numbers = dict.fromkeys(self._layout.others, As.NUMBER)
        block = self._source.parse(piece, numbers | wanted)
        if numbers and (block.bad or block.damage):
            return self._source.parse(piece, wanted), self._source.parse(piece, numbers)
        return block, block


def others_of(block: Block, columns: Sequence[int]) -> Others:
    """Return numbers of some columns, (n, k), NaN where there is none."""
    others = no_others(len(block), len(columns))
    for place, column in enumerate(columns):
        values = block.values[column]
        if isinstance(values, CellTexts):  # it may tell sensors apart, too
            numbers = [number_of(text) for text in values.texts]
            values = np.array([*(np.nan if one is None else one for one in numbers), np.nan])[values.codes]
        with np.errstate(over="ignore"):
            others[:, place] = as_floats(values)
    return others


def rows_of(block: Block, layout: Layout) -> Rows:
    """Return the rows of a block by themselves; a temperature that only earlier rows know is UNKNOWN."""
    values = block.values
    counts, fault = layout.scale.counts(group_values(values, layout.xyz))
    times, bad = None, dict(block.bad)
    if layout.clock is not None:
        times, wrong = layout.clock.times(block)
        bad |= {row: why for row, why in wrong.items() if row not in bad}
        fault[(times == NO_TIME) & (fault != Fault.EMPTY)] = Fault.MISSING
        fault[times == IMPOSSIBLE] = Fault.TIME
    channels: Channels = {}
    cold = None
    if layout.heat is not None:
        heat = millidegrees(values[layout.heat.column], layout.heat.unit)
        missing = heat == UNKNOWN
        cold = missing if missing.any() else None
        channels[HEAT] = held(heat)
    if layout.turns is not None:
        channels[TURNS], faults = layout.turns.scale.counts(group_values(values, layout.turns.group))
        faults[faults == Fault.EMPTY] = Fault.MISSING
        fault = np.where(fault == Fault.NONE, faults, fault)
    if layout.marks is not None:
        marks = values[layout.marks] % NOT_CALIBRATED
        known = (marks >= 0) & (marks <= max(Validity))
        channels[VALIDITY] = np.where(known, marks, Validity.MEASURED).astype(np.uint8)
    if bad:
        fault[[*bad]] = Fault.LINE
    where = None
    for column, lost in block.damage.items():
        where = np.full(len(block), -1, np.int32) if where is None else where
        where[lost & (where < 0)] = column
        fault[lost] = Fault.LOST
    if cold is not None:
        cold = cold & (fault == Fault.NONE)
    lines = {int(block.line[row]): why for row, why in bad.items()}
    return Rows(0, block.line, counts, fault, times, channels, None, where, cold, lines)


def not_rows(source: Source, line: int, fault: str) -> UnreadableError:
    """Return the error of a file most of whose lines are not rows, by the first of these."""
    line_of = line if source.place_word == "line" else None
    return UnreadableError(fault, path=source.path, line=line_of, hint="correct or remove that line")


class FollowedChanges:
    """Makes times run on where they follow a change of their zone's offset.

    Attributes:
        rows: numbers, from 0, of the rows before which they follow one.
    """

    def __init__(self, zone: str | None) -> None:
        self._stamps = None if zone is None else LocalStamps(zone)
        self.rows: list[int] = []

    def add(self, rows: Rows, _last: bool) -> Rows:
        """Return the next rows with the times of a clock that runs on."""
        if rows.time_us is None or self._stamps is None:
            return rows
        timed = np.flatnonzero(rows.time_us > LOST)
        running, followed = self._stamps.running_on(rows.time_us[timed])
        self.rows += (rows.first_row + timed[followed]).tolist()
        times = rows.time_us.copy()
        times[timed] = running
        return replace(rows, time_us=times)


class SpreadRows:
    """Gives rows that share a stamp times of their own (see `SharedStamps`)."""

    def __init__(self, pace: Pace) -> None:
        self._stamps = SharedStamps(pace)
        self._waiting: Rows | None = None

    def add(self, rows: Rows, last: bool) -> Rows:
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
        self._waiting: Rows | None = None

    def add(self, rows: Rows, last: bool) -> Rows:
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
    """Parses pieces into rows with their final times, in the order of the table.

    Args:
        watch: over columns that may show several sensors, from the first row on.
        zone: whose daylight saving the times may follow, None if they do not.
        first_row: number of the first row.

    Attributes:
        followed: numbers of the rows before which the times follow a change; it grows with the rows.
        clock: knows before which rows the times were read on, counted from the first one.
    """

    def __init__(
        self,
        source: Source,
        layout: Layout,
        watch: SensorWatch | None = None,
        zone: str | None = None,
        first_row: int = 0,
    ) -> None:
        self._parser = RowParser(source, layout, watch, first_row)
        self.clock, changes = RunningOn(layout.wraps), FollowedChanges(zone)
        self.followed, self.first_row = changes.rows, first_row
        self._steps: list[FollowedChanges | SpreadRows | IdleFill] = [changes]
        if layout.clock is not None and (layout.pace.stamp_period_us or layout.clock.format.unit_us):
            self._steps.append(SpreadRows(layout.pace))
        if layout.repeats_idle:
            self._steps.append(IdleFill(round(layout.pace.rate_hz)))

    def rows(self, pieces: Iterable[Piece], threads: int) -> Iterator[tuple[Rows, Piece]]:
        """Yield the settled rows, and the piece they came with, once a piece."""
        for parsed, piece in self._parser.rows(pieces, threads):
            times = None if parsed.time_us is None else self.clock.running_on(parsed.time_us)
            rows = replace(parsed, time_us=times)
            for step in self._steps:
                rows = step.add(rows, piece.last)
            yield rows, piece


# Rows of a table as chunks: bad rows are left out, and what is wrong becomes problems with their
# places.

MOST_JOINED = 1 << 18
"""Rows that are joined however many are wanted: more of them are made no faster, and take memory."""

SINGLE = 50
"""Problems of one kind that are given one by one; more are summed up."""

MISSING = ("missing_value", "{rows} left out: a value is missing")
OUT_OF_RANGE = ("out_of_range", "{rows} left out: a value is beyond any sensor's range")
BAD_LINE = ("bad_line", "{rows} left out: {why}")
FRACTION = ("bad_row", "{rows} left out: a count is not a whole number")
IMPOSSIBLE_TIME = ("impossible_time", "{rows} left out: an impossible time")
LOST_PARTS = ("bad_page", "{{rows}} lost in damaged or missing parts of {column}")
ASLEEP = ("idle_sleep", "{rows} not measured: the device slept, and repeated a value")
COLD = ("missing_value", "{rows} without a temperature: the last one before holds")
AHEAD = ("clock_gap", "the time jumps ahead{jump}{repeated}")
BACK = ("clock_back", "the time goes back{jump}{repeated}")
WITH_ITS_ZONE = (FOLLOWED, "the times follow a change of the clocks in {zone}")
FAULTS = (
    *((OUT_OF_RANGE, Fault.OUT_OF_RANGE), (IMPOSSIBLE_TIME, Fault.TIME)),
    *((BAD_LINE, Fault.LINE), (FRACTION, Fault.FRACTION)),
)
CODES = [
    *(MISSING[0], OUT_OF_RANGE[0], IMPOSSIBLE_TIME[0], BAD_LINE[0], FRACTION[0], LOST_PARTS[0], ASLEEP[0]),
    *(AHEAD[0], BACK[0], FOLLOWED, WRAPPED),
]
"""The order of problems that only the end of the file completes."""

JUMPS = (AHEAD[0], BACK[0], FOLLOWED, WRAPPED)
"""Codes of what lies before a row."""

NO_DATE = "the file has no date; times count from 1970-01-01"


def joined(parts: Iterable[tuple[Rows, Piece]], samples: int) -> Iterator[tuple[Rows, Piece]]:
    """Yield rows of pieces, joined up to `samples` rows, each with its last piece."""
    samples = min(samples, MOST_JOINED)
    stretches: list[Rows] = []
    number, last = 0, None
    for rows, piece in parts:
        if last is not None and number + len(rows) > samples:
            yield _emptied(stretches), last
            number = 0
        if len(rows) or not stretches:
            stretches.append(rows)
        number, last = number + len(rows), piece
    if last is not None:
        yield _emptied(stretches), last


def between(parts: Iterable[tuple[Rows, Piece]], start: int, stop: int) -> Iterator[tuple[Rows, Piece]]:
    """Yield those of the rows of pieces whose numbers are start..stop-1."""
    for rows, piece in parts:
        first, last = (min(max(row - rows.first_row, 0), len(rows)) for row in (start, stop))
        if first < last:
            yield rows.part(first, last), piece


def _emptied(stretches: list[Rows]) -> Rows:
    """Join stretches of rows, and empty the list so that it does not keep their memory."""
    rows = joined_rows(stretches)
    stretches.clear()
    return rows


@dataclass(frozen=True, slots=True)
class _GoodRows:
    """The good rows of a stretch: their numbers, lines and times (times None for a uniform clock)."""

    keep: NDArray[np.bool_] | None
    row: NDArray[np.int64]
    line: NDArray[np.int64]
    time_us: NDArray[np.int64] | None


class Assembler:
    """Makes chunks of the rows of a table, in order.

    Args:
        stream: of the rows, which knows before which of them the times were changed.
        zone: of the times, for the note that they follow it.
        first_row: number of the first row that is wanted; the stream may begin before it.

    Attributes:
        samples, rows, empty: good rows, all rows and those without values so far.
    """

    def __init__(
        self,
        source: Source,
        layout: Layout,
        stream: RowStream,
        zone: str | None = None,
        first_row: int = 0,
    ) -> None:
        self._source, self._layout, self._stream = source, layout, stream
        first = () if layout.has_dates else (Problem("no_start_time", NO_DATE, None, 0),)
        self._row_bytes = max(1, round(source.row_bytes))
        self._start_us, self._stride, self._base = layout.start_us or 0, layout.stride, stream.first_row
        self._rate = rate_fraction(layout.pace.rate_hz)
        problems = (*first, *source.problems) if not first_row else ()
        self._log = ProblemLog(problems, self._message, SINGLE, by_end=True, place=self._place)
        self._bad, self._in_bad = dict[int, str](), False
        self._with_its_zone = (FOLLOWED, WITH_ITS_ZONE[1].format(zone=zone))
        self._last_row, self._last_us = first_row - 1, 0
        self._ahead_us = self._restarts = 0
        self._begun = False
        self._last_jump: Kind | None = None
        self.samples = self.rows = first_row
        self.empty = self._lost = self._lost_bytes = 0

    def chunks(self, rows: Rows, piece: Piece, chunk_samples: int) -> Iterator[Chunk]:
        """Yield the good rows of the next ones, which end with a piece, at most `chunk_samples` a chunk."""
        kept = self._kept(rows, piece.restarts)
        channels, keep = dict(rows.channels), kept.keep
        if rows.filled is not None and rows.filled.any():
            validity = np.where(rows.filled, np.uint8(Validity.FILLED), np.uint8(Validity.MEASURED))
            channels["validity"] = validity
        counts, channels = rows.counts, channels if keep is None else recording.cut_channels(channels, keep)
        counts = counts if keep is None else counts[keep]
        events = list(self._row_events(rows))
        breaks, clock_jumps = self._breaks(kept, events, rows.first_row + len(rows))
        for event in events:
            self._log.add(event)
            self._lost_bytes += event.lost_bytes
        self._keep_reasons(rows)
        self.rows += len(rows)
        self.empty += int(np.count_nonzero(rows.fault == Fault.EMPTY))
        self._lost += int(np.count_nonzero(rows.fault == Fault.LOST))
        problems = self._log.take(self.rows)
        pieces = max(1, -(-len(counts) // chunk_samples))
        borders = [len(counts) * part // pieces for part in range(pieces + 1)]
        for start, stop in pairwise(borders):
            part = slice(start, stop)
            if kept.time_us is None:
                row = int(kept.row[start]) if len(kept.row) else 0
                clock: Clock = UniformClock(self._start_us, row, self._rate)
            else:
                clock = StampClock(kept.time_us[part])
            yield Chunk(
                self.samples,
                counts[part],
                clock,
                piece.end_byte,
                breaks=breaks[(breaks >= start) & (breaks < stop)] - start,
                clock_jumps=clock_jumps[(clock_jumps >= start) & (clock_jumps < stop)] - start,
                problems=problems if start == 0 else (),
                used_bytes=(stop - start) * self._row_bytes,
                **recording.cut_channels(channels, part),
            )
            self.samples += stop - start

    def _keep_reasons(self, rows: Rows) -> None:
        """Keep what is wrong with the first line of each stretch that is not rows, however rows were cut."""
        bad = rows.fault == Fault.LINE
        if rows.bad:
            before = np.concatenate([[self._in_bad], bad])[:-1].astype(np.bool_)
            begins = np.flatnonzero(bad & ~before)
            lines = [*rows.line[begins].tolist()] or [next(iter(rows.bad))] * (not self._bad)
            self._bad |= {line: rows.bad[line] for line in lines[: SINGLE + 1 - len(self._bad)]}
        self._in_bad = bool(bad[-1]) if len(bad) else self._in_bad

    def end(self, piece: Piece) -> Chunk:
        """Return an empty chunk with what the end of the file completes: runs that reach it, sums of many.

        Raises:
            UnreadableError: most rows cannot be used.
        """
        if 2 * self.samples < self.rows - self.empty - self._lost or not self.samples:
            if self._bad:
                raise not_rows(self._source, *next(iter(self._bad.items())))
            raise unusable(self._source, f"only {self.samples} of {self.rows} rows hold usable values")
        left = sorted(self._log.take(None), key=lambda problem: CODES.index(problem.code))
        return Chunk(
            self.samples,
            np.empty((0, 3), np.int32),
            StampClock(np.empty(0, np.int64)),
            piece.end_byte,
            problems=(*left, *self._source.end_problems(piece, self.samples, self._lost_bytes)),
            used_bytes=0,
            **self._layout.no_channels,
        )

    def _row_events(self, rows: Rows) -> Iterator[Event]:
        """Yield what concerns single rows: those left out, those not measured, changes of the clocks."""
        yield from self._wrap_events(rows)
        good, flags = rows.fault == Fault.NONE, [*self._flags(rows)]
        before = np.cumsum(good) - good if flags or rows.where is not None else good
        for kind, flag, row_bytes in flags:
            yield from self._runs(rows, kind, flag, (before, row_bytes, None))
        for column in np.unique(rows.where).tolist() if rows.where is not None else ():
            if column >= 0:
                name = self._source.columns[column].described.replace("{", "{{").replace("}", "}}")
                kind = (LOST_PARTS[0], LOST_PARTS[1].format(column=name))
                yield from self._runs(rows, kind, rows.where == column, (before, self._row_bytes, column))
        if rows.cold is not None and (count := int(np.count_nonzero(rows.cold))):
            first = int(np.argmax(rows.cold))
            sample = self.samples + int(np.count_nonzero(good[:first]))
            place = rows.first_row + first, 1
            yield Event(*place, *COLD, None, sample, count, line=int(rows.line[first]), scattered=True)

    def _flags(self, rows: Rows) -> Iterator[tuple[Kind, NDArray[np.bool_], int]]:
        """Yield kinds of events, the rows (n,) that they concern, and the bytes that each of these costs."""
        if rows.fault.any():
            empty = (rows.fault == Fault.EMPTY) & (self._stride == 1)
            yield MISSING, (rows.fault == Fault.MISSING) | empty, self._row_bytes
            for kind, fault in FAULTS:
                yield kind, rows.fault == fault, self._row_bytes
        if rows.filled is not None and rows.filled.any():
            yield ASLEEP, rows.filled, 0
        here = [
            row - rows.first_row for row in self._stream.followed if 0 <= row - rows.first_row < len(rows)
        ]
        if here:
            yield self._with_its_zone, np.isin(np.arange(len(rows)), here), 0

    def _runs(
        self, rows: Rows, kind: Kind, flag: NDArray[np.bool_], about: tuple[NDArray[Any], int, int | None]
    ) -> Iterator[Event]:
        """Yield runs of rows with a flag (n,).

        Args:
            about: how many good rows are before each row (n,), bytes of a row, and the column that lost it.
        """
        before, row_bytes, column = about
        places = np.flatnonzero(flag)
        for index, count, scattered in self._log.runs(kind, places):
            place = int(places[index])
            row, line, sample = rows.first_row + place, int(rows.line[place]), int(before[place])
            empty = int(np.count_nonzero(rows.fault[places[index : index + count]] == Fault.EMPTY))
            amounts = (self.samples + sample, count, 0, (count - empty) * row_bytes)
            offset = None if column is None else self._source.offset_of(column, line - 1)
            yield Event(row, count, *kind, offset, *amounts, line, scattered, empty)

    def _message(self, run: Run) -> str:
        """Return what is wrong with a run of rows."""
        size, count = run.event.amount_us, run.count
        text = run.event.text.format(
            rows="1 row" if count == 1 else f"{count} rows",
            why=self._bad.get(run.event.line, "lines that are not rows of this table"),
            jump=f" by {abs(size) / MICROSECONDS:g} s" if size and not run.scattered else "",
            repeated=f", and so on for {count} rows" if count > 1 else "",
        )
        return f"and more of the same: {text}" if run.scattered and run.event.kind != COLD else text

    def _place(self, run: Run) -> str:
        where = self._source.place(run.event.line)
        return f"before {where}" if run.event.code in JUMPS else f"from {where} on"

    def _wrap_events(self, rows: Rows) -> Iterator[Event]:
        for row, jump_us in self._stream.clock.taken(rows.first_row + len(rows) - self._base):
            place = row + self._base - rows.first_row
            if place < 0:
                continue
            sample = self.samples + int(np.count_nonzero(rows.fault[:place] == Fault.NONE))
            kind = WRAPPED, text_of(jump_us)
            yield Event(row + self._base, 1, *kind, None, sample, 1, jump_us, 0, int(rows.line[place]))

    def _kept(self, rows: Rows, restarts: Sequence[tuple[int, int]]) -> _GoodRows:
        stamps = rows.time_us
        if stamps is None and self._layout.start_us is not None and restarts:
            stamps = self._restarted(rows, restarts)
        if not rows.fault.any():
            return _GoodRows(None, rows.row, rows.line, stamps)
        keep = rows.fault == Fault.NONE
        if stamps is None:
            stamps = self._even_times(rows.first_row, len(rows))
        return _GoodRows(keep, rows.row[keep], rows.line[keep], stamps[keep])

    def _even_times(self, row: int, rows: int) -> NDArray[np.int64]:
        return UniformClock(self._start_us, row, self._rate).times(0, rows) + self._ahead_us

    def _restarted(self, rows: Rows, restarts: Sequence[tuple[int, int]]) -> NDArray[np.int64]:
        """Return the times of rows (n,) without their own, which each restart sets."""
        if not self._restarts:
            self._last_us = int(self._even_times(self._last_row, 1)[0])
        times = self._even_times(rows.first_row, len(rows))
        for line, start_us in restarts[self._restarts :]:
            first = int(np.searchsorted(rows.line, line))
            if first == len(rows):
                break
            ahead = start_us - int(times[first])
            times[first:] += ahead
            self._ahead_us, self._restarts = self._ahead_us + ahead, self._restarts + 1
        return times

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
        first, self._begun = not self._begun, True
        before = int(kept.row[0]) - 1 if first else self._last_row
        even = kept.keep is None and kept.row[0] == before + 1
        # distances [rows] from the good row before
        rows = np.ones(1, np.int64) if even else -(-np.diff(kept.row, prepend=before) // self._stride)
        broken = rows > 1
        self._last_row = int(kept.row[-1])
        if kept.time_us is None or (self._layout.clock is None and not self._restarts):
            return np.flatnonzero(broken), recording.NO_BREAKS
        steps = np.diff(kept.time_us, prepend=kept.time_us[0] if first else self._last_us)
        self._last_us = int(kept.time_us[-1])
        ahead = steps > (rows + GAP_PERIODS - 1) * self._layout.pace.period_us
        back = steps < 0
        for kind, jumps in ((AHEAD, ahead), (BACK, back)):
            if jumps.any():
                events += self._jumps(kind, np.flatnonzero(jumps), kept, steps, stop)
        self._last_jump = AHEAD if ahead[-1] else BACK if back[-1] else None
        jumps = ahead | back
        return np.flatnonzero(broken | jumps), np.flatnonzero(jumps & ~broken)

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


def unusable(source: Source, what: str) -> UnreadableError:
    """Return the error of a table whose rows hold no usable values."""
    return UnreadableError(what, path=source.path, line=source.first_line, hint="check --columns and --unit")
