"""Blocks of a table as rows: whole counts, times and faults, in the order of the table.

`RowParser` makes rows of each block by itself, on several threads; `RowStream` then carries on what lies
between blocks. `FollowedChanges` makes the times run on where they follow daylight saving. `SpreadRows` gives
every row a time where several rows share a stamp, such as whole seconds. `IdleFill` marks what a device wrote
while it slept.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.local_time import LocalStamps
from accelcal_cli.core.parallel import parallel_map
from accelcal_cli.core.recording import (
    NOT_CALIBRATED,
    Channels,
    Validity,
    cut_channels,
    cut_columns,
    joined_channels,
    joined_columns,
)
from accelcal_cli.core.thermometers import HeatUnit
from accelcal_cli.formats._rows import RepeatedSamples
from accelcal_cli.formats._stamps import IMPOSSIBLE, LOST, NO_TIME, Pace, SharedStamps
from accelcal_cli.formats._wraps import RunningOn, Wraps
from accelcal_cli.formats.tables.clock import Clock
from accelcal_cli.formats.tables.header import As, Block, Piece, Source
from accelcal_cli.formats.tables.roles import Group
from accelcal_cli.formats.tables.sensors import Chosen, SensorWatch, codes_of
from accelcal_cli.formats.tables.units import UNKNOWN, Fault, Scale, group_values, held, millidegrees

HEAT, TURNS, VALIDITY = "temperature_mc", "gyro_counts", "validity"
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
        marks: the column that tells where each row comes from, as `Validity` numbers it.
        chosen: the rows that are read; None for all.
        wraps: what the clock may do.
        stride: rows from one with values to the next, in a table that other sensors share.
        start_us: time of the first row where rows carry none; None if it is not known.
    """

    xyz: Group
    scale: Scale
    clock: Clock | None
    pace: Pace
    heat: Heat | None = None
    turns: Turns | None = None
    marks: int | None = None
    chosen: Chosen | None = None
    wraps: Wraps = field(default_factory=Wraps)
    repeats_idle: bool = False
    stride: int = 1
    start_us: int | None = None

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
        self._first_bad: tuple[int, str] | None = None

    def rows(self, pieces: Iterable[Piece], threads: int) -> Iterator[tuple[Rows, Piece]]:
        """Yield the rows of pieces that follow each other, each with its piece, without the memory of that.

        Args:
            threads: how many may work at a time.

        Raises:
            UnreadableError: most lines are not rows of the table, or rows are of several sensors.
        """
        for rows, piece, seen in parallel_map(self._rows_of, pieces, threads):
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
        constant = {} if watch is None else watch.constant(piece)
        looked_at = () if watch is None else (one for one in watch.columns if one.number not in constant)
        block = self._source.parse(piece, self._wanted | codes_of(looked_at))
        seen = None if watch is None else watch.look(block, constant)
        rows = rows_of(block, layout)
        if layout.chosen is not None:
            wanted = layout.chosen.rows(block)
            columns, channels = cut_columns(rows, COLUMNS, wanted), cut_channels(rows.channels, wanted)
            rows = replace(rows, channels=channels, **columns)  # lines that are not rows are of no sensor
            seen = None if seen is None else tuple(one._replace(codes=one.codes[wanted]) for one in seen)
        return rows, piece.emptied(), seen


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


class RunningRows:
    """Makes times run on where a counter wraps, or a clock shows no new day (see `RunningOn`)."""

    def __init__(self, wraps: Wraps) -> None:
        self.clock = RunningOn(wraps)

    def add(self, rows: Rows, _last: bool) -> Rows:
        """Return the next rows with the times of a clock that runs on."""
        return rows if rows.time_us is None else replace(rows, time_us=self.clock.running_on(rows.time_us))


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
        running, changes = RunningRows(layout.wraps), FollowedChanges(zone)
        self.clock, self.followed, self.first_row = running.clock, changes.rows, first_row
        self._steps: list[RunningRows | FollowedChanges | SpreadRows | IdleFill] = [running, changes]
        if layout.clock is not None and layout.pace.stamp_period_us:
            self._steps.append(SpreadRows(layout.pace))
        if layout.repeats_idle:
            self._steps.append(IdleFill(round(layout.pace.rate_hz)))

    def rows(self, pieces: Iterable[Piece], threads: int) -> Iterator[tuple[Rows, Piece]]:
        """Yield the settled rows, and the piece they came with, once a piece."""
        for parsed, piece in self._parser.rows(pieces, threads):
            rows = parsed
            for step in self._steps:
                rows = step.add(rows, piece.last)
            yield rows, piece
