"""Reads a table of any kind: decides what to read and how (`find_plan`), and streams its rows as chunks.

The names and forms that are understood are listed in docs/csv-files.md and docs/tables.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, RESET_US
from accelcal_cli.core.errors import UsageError, counted, printable
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Chunk, Intake, OtherColumn, Reader, Recording
from accelcal_cli.core.vocabulary import HeatUnit, unit_by_values
from accelcal_cli.formats._stamps import (
    IMPOSSIBLE,
    NO_TIME,
    Midnights,
    Pace,
    RunningOn,
    Wraps,
    spread,
    time_before,
)
from accelcal_cli.formats.tables.clock import TableClock, find_clock, find_pace, wraps_of
from accelcal_cli.formats.tables.header import (
    As,
    Block,
    CellTexts,
    Column,
    Cut,
    First,
    Piece,
    Source,
    refuse_doubtful,
)
from accelcal_cli.formats.tables.roles import Roles, find_roles, names_group
from accelcal_cli.formats.tables.rows import (
    Assembler,
    Heat,
    Layout,
    RowStream,
    Turns,
    between,
    joined,
    not_rows,
    unusable,
)
from accelcal_cli.formats.tables.sensors import (
    ONLY,
    Chosen,
    SensorWatch,
    codes_of,
    find_chosen,
)
from accelcal_cli.formats.tables.units import (
    FOUND_ZERO,
    NO_GYRO_UNIT,
    UNKNOWN,
    Scale,
    as_floats,
    common_dtype,
    find_scale,
    find_turn_scale,
    group_values,
    millidegrees,
    why_not_read,
)

LEAST_SHARE = 0.5
"""Share of the time that its rows take below which the span of a file's times is not its length."""

FIRST_BYTES = 1 << 24
"""Bytes among whose rows the first usable one must be, unless they have no values at all."""

SPARSE = "one row in {} holds acceleration; the others are left out"


@dataclass(frozen=True, slots=True)
class Plan:
    """A table as it will be read, with what is known of it.

    Attributes:
        others: columns of other quantities, with what they become.
        watch: over columns that may separate several sensors, with the first rows seen; None without any.
    """

    source: Source
    layout: Layout
    notes: tuple[str, ...]
    others: tuple[tuple[Column, OtherColumn], ...]
    watch: SensorWatch | None = None


def find_plan(source: Source, options: ReadOptions) -> Plan:
    """Decide what to read of a table, and how.

    Raises:
        NoRecordingError: it holds no raw acceleration.
        UnreadableError: it holds no rows of numbers, or they can be read in several ways; the
            hint says which option settles it.
        UsageError: an option names no column, or counts come without their scale.
    """
    refuse_doubtful(source.stated, options, source.path, None)
    first = First(source.head({column.number: As.TEXT for column in source.columns}))
    roles = find_roles(source, options, lambda column: [cell for cell, _ in source.cells(first, column)])
    source.settle(roles.xyz, roles.gyro or (), options)
    said = source.stated
    if roles.time is None and options.rate_hz is None and said.rate_hz is None and said.hint_hz:
        note = f"rate: {said.hint_hz:g} Hz, by a line above the rows"
        source.stated = replace(said, rate_hz=said.hint_hz, notes=(*said.notes, note))
    sensor = options.one_sensor
    if sensor is not None and not roles.dividing and names_group(source, sensor):
        sensor = None
    chosen = find_chosen(source, sensor, roles.dividing)
    if chosen is not None:
        block = source.parse(chosen.piece, chosen.wanted)
        first = First(chosen.piece, frozenset(block.line[chosen.rows(block)].tolist()))
    clock, source = find_clock(source, first, roles, options)
    return _Understood(source, options, roles, clock, chosen).plan(first.piece)


@dataclass(frozen=True, slots=True)
class _Understood:
    """A table whose columns and clock are known."""

    source: Source
    options: ReadOptions
    roles: Roles
    clock: TableClock | None
    chosen: Chosen | None

    def plan(self, piece: Piece) -> Plan:
        """Return the plan, by the first rows."""
        source, options, roles, clock = self.source, self.options, self.roles, self.clock
        whole = source.parse(piece, self._wanted)
        block = self._head(whole)
        if 2 * len(block.bad) > len(block):
            row, fault = next(iter(block.bad.items()))
            raise not_rows(source, int(block.line[row]), fault)
        times = None if clock is None else clock.times(block)[0]
        before_us = NO_TIME if times is None else time_before(times)
        times = None if times is None else Midnights(before_us).settled(times)
        wraps = wraps_of(clock, times)
        times = None if times is None else RunningOn(wraps).running_on(times)
        watch = self._watch(block, times)
        values = as_floats(group_values(block.values, roles.xyz))
        scale, guessed = find_scale(self._more_values(values), block.line, roles, source, options)
        stride = _usual_stride(values)
        measured = times if times is None or stride == 1 else times[~np.isnan(values).any(axis=1)]
        pace = find_pace(measured, source, options)
        (heat, heat_notes), (turns, turn_notes) = self._heat(block), self._turns(block, values)
        layout = self._layout(scale, pace, (heat, turns), wraps, stride)
        layout = replace(layout, before_us=before_us)
        source.check(layout.wanted)
        source.row_bytes = source.row_bytes_of(layout.wanted) * len(whole) / max(len(block), 1)
        notes = self._notes(layout, heat_notes, turn_notes, guessed=guessed)
        return Plan(source, layout, notes, roles.others, watch)

    def _layout(
        self, scale: Scale, pace: Pace, channels: tuple[Heat | None, Turns | None], wraps: Wraps, stride: int
    ) -> Layout:
        """Return what is read, and how; `channels` are the temperature and the rotation rates."""
        stated, start_us = self.source.stated, None
        heat, turns = channels
        if self.clock is None and stated.start is not None:
            start_us = stated.start.us(self.options.date_format or stated.date_order, self.source.path)
        return Layout(
            xyz=self.roles.xyz, scale=scale, clock=self.clock, pace=pace, heat=heat, turns=turns,
            marks=stated.marks, chosen=self.chosen, wraps=wraps, repeats_idle=stated.repeats_idle,
            stride=stride, start_us=start_us,
        )  # fmt: skip

    def _notes(
        self, layout: Layout, heat_notes: Sequence[str], turn_notes: Sequence[str], *, guessed: bool
    ) -> tuple[str, ...]:
        """Return what the report says of how the table is read."""
        stated, scale, stride = self.source.stated, layout.scale, layout.stride
        return (
            *[f"an export of {stated.title}"] * bool(stated.title),
            *stated.notes,
            f"x, y, z: {', '.join(column.described for column in layout.xyz)}",
            f"unit: {scale.unit}{' (judged by the length of gravity)' * guessed}",
            *[FOUND_ZERO.format(scale.zero)] * scale.found_zero,
            *self._time_notes(),
            *heat_notes,
            *[SPARSE.format(stride)] * (stride > 1),
            *turn_notes,
            *self.roles.other_notes,
            *layout.pace.notes,
            *self.source.last_notes,
        )

    @property
    def _wanted(self) -> dict[int, As]:
        """How the columns of all roles are asked for."""
        roles = self.roles
        columns = (*roles.xyz, *(roles.gyro or ()), *(() if roles.heat is None else (roles.heat,)))
        wanted = {column.number: As.NUMBER for column in columns} | codes_of(roles.dividing)
        wanted |= {} if self.clock is None else self.clock.wanted
        return wanted | ({} if self.chosen is None else self.chosen.wanted)

    def _head(self, block: Block) -> Block:
        """Return the rows of the sensor that is read, without those that are lost."""
        if self.chosen is None and not block.damage:
            return block
        kept = np.ones(len(block), np.bool_) if self.chosen is None else self.chosen.rows(block)
        for lost in block.damage.values():
            kept = kept & ~lost
        return only(block, np.flatnonzero(kept))

    def _watch(self, block: Block, times: NDArray[np.int64] | None) -> SensorWatch | None:
        """Return the watch that has seen the first rows; raise UnreadableError if these show several."""
        dividing, options = self.roles.dividing, self.options
        grouped = options.one_sensor is not None and self.chosen is None
        if not dividing or grouped:
            return None
        since_1970 = self.clock is not None and self.clock.format.has_dates
        watch = SensorWatch(self.source, dividing, (options.sensor, self.chosen), since_1970)
        watch.see(watch.look(block), times)
        return watch

    def _more_values(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return accelerations (n, 3), with those of other places where the first rows have none."""
        if np.isfinite(values).all(axis=1).any() and np.nan_to_num(values).any():
            return values
        wanted = {column.number: As.NUMBER for column in self.roles.xyz}
        blocks = (self.source.parse(piece, wanted) for piece in self.source.more(wanted))
        more = [as_floats(group_values(block.values, self.roles.xyz)) for block in blocks]
        return np.concatenate([values, *more])

    def _heat(self, block: Block) -> tuple[Heat | None, list[str]]:
        """Return the temperature with the unit that its values show, and notes.

        A column whose unit nothing shows, or without any value in the first rows, is not read.
        """
        column, like, heat = self.roles.heat, self.roles.like_heat, None
        notes: list[str] = []
        if column is not None:
            values = as_floats(block.values[column.number])
            unit: HeatUnit | None = self.roles.heat_unit or unit_by_values(values)
            if unit is None:
                like = (*like, column) if np.isfinite(values).any() else like
            elif len(known := (steps := millidegrees(values, unit))[steps != UNKNOWN]):
                heat = Heat(column.number, unit, int(known[0]))
                notes = [f"temperature: {column.described}, in {unit.name}"]
        if like:
            names = ", ".join(one.described for one in like)
            notes.append(f"not read, though it looks like a temperature: {names}")
        return heat, notes

    def _turns(self, block: Block, values: NDArray[np.float64]) -> tuple[Turns | None, tuple[str, ...]]:
        """Return the rotation rates, None if they are not read, and notes."""
        gyro, notes = self.roles.gyro, self.roles.gyro_notes
        if gyro is None:
            return None, notes
        scale = find_turn_scale(gyro, block, self.source, self.options)
        if scale is None:
            names = ", ".join(column.described for column in gyro)
            return None, (f"the gyroscope ({names}) is not read: {NO_GYRO_UNIT}",)
        if fault := why_not_read(values, as_floats(group_values(block.values, gyro))):
            return None, (fault,)
        return Turns(gyro, scale), notes

    def _time_notes(self) -> list[str]:
        """Return which column is the time, and which rows are read."""
        notes, stated = [], self.source.stated
        if self.clock is not None:
            date = "" if self.roles.date is None else f"{self.roles.date.described} and "
            notes.append(f"time: {date}{self.clock.column.described}{self.clock.format.how}")
            if self.clock.format.is_utc and stated.timezone not in (None, "UTC"):
                notes.append(f"its times are UTC; it names the time zone {stated.timezone}")
        if stated.pauses:
            notes.append(f"{counted(stated.pauses, 'pause')} of the experiment are not in its times")
        return notes + ([self.chosen.note] if self.chosen is not None else [])


def _usual_stride(values: NDArray[np.float64]) -> int:
    """Return the usual distance [rows] between rows (n, 3) with values, 1 where they follow one another."""
    places = np.flatnonzero(~np.isnan(values).any(axis=1))
    return max(1, int(np.median(np.diff(places)))) if len(places) > 1 else 1


def only(block: Block, rows: NDArray[np.int64]) -> Block:
    """Return some rows of a block, by their numbers."""

    def taken(values: Any) -> Any:
        if isinstance(values, CellTexts):
            return values._replace(codes=values.codes[rows])
        return values[rows] if isinstance(values, np.ndarray) else values.take(rows)

    values = {number: taken(one) for number, one in block.values.items()}
    bad = {place: block.bad[row] for place, row in enumerate(rows.tolist()) if row in block.bad}
    return replace(block, line=block.line[rows], values=values, bad=bad, damage={})


class TableReader(Reader):
    """Streams the rows of a plan. The file is open only while a stream runs."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self.may_hold_several = plan.watch is not None and plan.watch.again() is not None
        with plan.source.explaining():
            self.recording = self._described(self._first_time(), self._last_time())

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """Yield all usable rows, at most `chunk_samples` at a time.

        Raises:
            UnreadableError: a line is not a row of the file, or most rows cannot be used.
        """
        yield from self._assembled(self._watched(), chunk_samples)

    def preview(self, chunk_samples: int, pieces: int) -> Iterator[Chunk]:
        """Yield up to `pieces` chunks, spread evenly over a file that can be entered anywhere."""
        source, rows = self._plan.source, self._plan.source.rows
        if not source.can_be_entered or rows is None or rows <= pieces * chunk_samples:
            yield from super().preview(chunk_samples, pieces)
            return
        for piece in range(pieces):
            start = piece * rows // pieces
            begin = max(0, start - self._plan.layout.pace.reach)
            stream = RowStream(source, self._plan.layout, None, self._zone, begin)
            yield from self._assembled(stream, chunk_samples, start, start + chunk_samples)

    def intake(self) -> Intake:
        """See `Reader`."""
        cut, stream = self._plan.source.intake(), self._watched()
        return super().intake() if cut is None else TableIntake(cut, stream, self._assembler(stream))

    def _watched(self) -> RowStream:
        """Return all rows, over which the watch begins again."""
        watch = None if self._plan.watch is None else self._plan.watch.again()
        return RowStream(self._plan.source, self._layout, watch, self._zone)

    @property
    def _layout(self) -> Layout:
        others = self._plan.others if self.with_others else ()
        return replace(self._plan.layout, others=tuple(column.number for column, _ in others))

    @property
    def _zone(self) -> str | None:
        return self.recording.timezone if self.recording.stamped else None

    def _assembler(self, stream: RowStream, zone: str | None = None, start: int = 0) -> Assembler:
        return Assembler(self._plan.source, self._plan.layout, stream, zone, start)

    def _assembled(
        self, stream: RowStream, chunk_samples: int, start: int = 0, stop: int | None = None
    ) -> Iterator[Chunk]:
        """Yield chunks of rows; of a part of the table without what the end of the file completes."""
        source, assembler = self._plan.source, self._assembler(stream, self.recording.timezone, start)
        wanted, end = self._layout.asked, None if stop is None else stop + self._plan.layout.pace.reach
        with (
            source.explaining(),
            closing(source.pieces(wanted, chunk_samples, stream.first_row, end, self.threads)) as read,
        ):
            parts = stream.rows(read, self.threads)
            parts = parts if stop is None else between(parts, start, stop)
            for rows, piece in joined(parts, chunk_samples):
                for chunk in assembler.chunks(rows, piece, chunk_samples):
                    if len(chunk) or chunk.problems:
                        yield chunk
            if stop is None and (last := assembler.end(piece)).problems:
                yield last

    def _first_time(self) -> int | None:
        """Return the time of the first usable row [us], None if it is not known; raise if there is none."""
        source, layout = self._plan.source, self._plan.layout
        stream = RowStream(source, layout)
        assembler = self._assembler(stream)
        samples = max(1, int((1 << 20) / source.row_bytes))
        with closing(source.pieces(layout.wanted, samples, threads=self.threads)) as pieces:
            for rows, piece in stream.rows(pieces, self.threads):
                for chunk in assembler.chunks(rows, piece, samples):
                    if len(chunk):
                        return int(chunk.clock.times(0, 1)[0]) if self._plan.layout.has_dates else None
                if assembler.rows > 2 * assembler.empty and piece.offset > FIRST_BYTES:
                    break
        raise unusable(source, f"none of its first {assembler.rows} rows holds usable values")

    def _last_time(self) -> int | None:
        """Return the time of the last row [us]; None if it cannot be reached or has no times."""
        layout, clock = self._plan.layout, self._plan.layout.clock
        if clock is None or (piece := self._plan.source.last(layout.wanted)) is None:
            return None
        block = self._plan.source.parse(piece, layout.wanted)
        times = Midnights().settled(clock.times(block)[0])
        times = times if layout.chosen is None else times[layout.chosen.rows(block)]
        known = spread(times[times > IMPOSSIBLE], layout.pace)
        return int(known[-1]) if len(known) else None

    def _described(self, first_us: int | None, last_us: int | None) -> Recording:
        source, layout, stated = self._plan.source, self._plan.layout, self._plan.source.stated
        form = None if layout.clock is None else layout.clock.format
        zone, offsets = stated.timezone, stated.has_offsets
        if form is not None:
            zone = "UTC" if form.is_utc else form.zone or zone
            offsets = form.has_offsets or (offsets and not form.since_1970)
        shown_in = None if layout.clock is None else layout.clock.column.zone
        shown_in = None if shown_in == zone else shown_in
        device = stated.device
        if (
            layout.chosen is not None and device.serial is not None
        ):  # each sensor of a device is one of its own
            whose = layout.chosen.note.removeprefix(ONLY)
            device = replace(device, serial=printable(f"{device.serial} ({whose})"))
        columns = (*layout.xyz, *(() if layout.turns is None else layout.turns.group))
        are_counted = form is None and layout.chosen is None and common_dtype(columns).kind in "iu"
        return Recording(
            path=source.path,
            format=source.format,
            rate_hz=layout.pace.rate_hz,
            lsb_per_g=layout.scale.lsb,
            total_bytes=source.path.stat().st_size,
            device=device,
            range_g=stated.range_g,
            start_us=first_us,
            timezone=zone,
            has_offsets=offsets,
            shown_in=shown_in,
            stamped=form is not None
            and form.since_1970  # as by a computer; a counter does not follow its zone
            and shown_in is None,
            samples=source.rows if are_counted else None,  # else only reading shows which rows are good
            duration_s=self._length_s(first_us, last_us),
            has_temperature=layout.heat is not None,
            gyro_dps_per_lsb=None if layout.turns is None else (1 / layout.turns.scale.lsb,) * 3,
            others=tuple(other for _, other in self._plan.others),
            companion=stated.companion,
            calibrated=stated.calibrated,
            notes=self._plan.notes,
        )

    def _length_s(self, first_us: int | None, last_us: int | None) -> float | None:
        """Return the length [s], to the end of the last row; None if the clock did not run on until then."""
        source, period_us = self._plan.source, self._plan.layout.pace.period_us
        if self._plan.layout.clock is None:
            whole = source.rows is not None and self._plan.layout.chosen is None
            return (source.rows or 0) * period_us / MICROSECONDS if whole else None
        if first_us is None or last_us is None:
            return None
        span_us = last_us - first_us + period_us
        size = source.path.stat().st_size / source.row_bytes if source.rows is None else source.rows
        ran_on = LEAST_SHARE * size * period_us <= span_us <= RESET_US
        chosen = self._plan.layout.chosen is not None and span_us > period_us
        return span_us / MICROSECONDS if span_us > 0 and (ran_on or chosen) else None


class TableIntake(Intake):
    """Takes a table of text as it grows, whole lines at a time."""

    def __init__(self, cut: Cut, stream: RowStream, assembler: Assembler) -> None:
        self._cut, self._stream, self._assembler = cut, stream, assembler

    def take(self, data: bytes, *, last: bool) -> Iterator[Chunk]:
        """See `Intake`."""
        piece = self._cut(data, last)
        if piece is None:
            return
        for rows, passed in self._stream.rows([piece], 1):
            yield from self._assembler.chunks(rows, passed, max(1, len(rows)))
            if last:
                yield self._assembler.end(passed)


def open_table(source: Source, options: ReadOptions) -> TableReader:
    """Return the reader of a table.

    Raises what `find_plan` does, and a UsageError for a rate or scale that is not a positive number.
    """
    for name, value in (("--rate", options.rate_hz), ("--lsb-per-g", options.lsb_per_g)):
        if value is not None and not 0 < value < np.inf:
            what, hint = f"{name} {value:g} is not a positive number", "give it as a number such as 100"
            raise UsageError(what, hint=hint)
    with source.explaining():
        plan = find_plan(source, options)
    return TableReader(plan)
