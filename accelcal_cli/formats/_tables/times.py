"""Times of a table: when its recording began, how fast it ran, and the time of each row.

`find_timeline` decides by names, attributes and the first rows; `RowTimes` then reads a track of stamps: the
times run on where they follow daylight saving, and rows that share a stamp are spread.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, RESET_US
from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.local_time import FOLLOWED, LocalStamps
from accelcal_cli.core.recording import Problem
from accelcal_cli.core.vocabulary import PER_SECOND, TABLES
from accelcal_cli.core.written_times import written_start
from accelcal_cli.formats._stamps import (
    EPOCH_DAYS,
    LOST,
    NO_TIME,
    PLAUSIBLE_HZ,
    Pace,
    SharedStamps,
    jittered_step,
    nice_rate,
    spread,
    stamp_pace,
)
from accelcal_cli.formats._tables.table import (
    BLOCK_ROWS,
    TEXT,
    Group,
    RowSelection,
    RowSource,
    SensorTable,
    TableSource,
    Track,
    find_time,
    good_rows,
    named_track,
    readable,
    shown,
    split_time_name,
)
from accelcal_cli.formats._tables.texts import written_times
from accelcal_cli.formats._wraps import WRAPPED, RunningOn, Wraps, find_wraps

DAY_S = 86_400
EARLIEST_ABSOLUTE_US = 315_532_800 * MICROSECONDS
"""1980-01-01: a smaller number counts from the start of the recording, not from 1970."""

LATEST_US = 4_102_444_800 * MICROSECONDS
"""2100-01-01: a later time is damage."""

FARTHEST = 1 << 50
"""Largest time since the first one that is believed, in any unit: 13 days in ns."""

LEAST_SHARE = 0.5
"""Share of the time that its rows take below which the span of a table's times is not its length."""

SLOWEST_HZ, FASTEST_HZ = 0.01, 100_000.0
RATE_NAMES = (
    *("sample_rate", "sample_rate_hz", "sampling_rate", "sampling_rate_hz", "rate_hz"),
    *("sampling_frequency", "sampling_frequency_hz", "sample_frequency", "frequency_hz", "sfreq"),
    *("fs", "fs_hz", "hz", "rate", "frequency"),
)
START_NAMES = (
    *("start_time", "start", "start_timestamp", "start_datetime"),
    *("recording_start", "recording_start_time", "start_time_utc"),
)
MICROSECOND = "us"
"""The unit of times that were written as texts."""

GIVE_FORM = (
    "give their form, as in --time-format '%d/%m/%Y %H:%M:%S.%f'; or ignore them with --time-column none and "
    "give --rate HZ"
)
NO_COLUMN = "none"
"""The value of --time-column for no column."""

UNBELIEVABLE = ("missing_value", "rows without a believable time left out")
COUNTER_WRAPS = (WRAPPED, "jumps back of a counter that wraps; its times are read as running on")
WITH_ITS_ZONE = "the times follow a change of the clocks in {}"


class Moment(NamedTuple):
    """A time in microseconds since 1970.

    Attributes:
        is_utc: it is UTC for certain.
        had_offset: it was written with an offset.
    """

    us: int
    is_utc: bool = False
    had_offset: bool = False


def parse_moment(value: str | float) -> Moment | None:
    """Return the moment of a start attribute; None if it is not a moment.

    A number counts s, ms, us or ns since 1970, by its size, and is UTC. A text is a date and time;
    only one with a zone is UTC for certain.
    """
    if isinstance(value, float):
        unit = _unit_by_size(value)
        return None if unit is None else Moment(round(value / PER_SECOND[unit] * MICROSECONDS), is_utc=True)
    if re.fullmatch(r"\d+(\.\d*)?", value):
        return parse_moment(float(value))
    found = written_start(value)
    if found is None or not 0 <= found.start_us < LATEST_US:
        return None
    return Moment(found.start_us, found.timezone == "UTC", found.had_offset)


@dataclass(frozen=True, slots=True)
class StampScale:
    """How the numbers of a track of times become microseconds since 1970.

    Attributes:
        unit: s, ms, us, ns or days.
        base_us: the moment from which they count.
        epoch_day: the number of 1970-01-01, for days.
    """

    unit: str
    base_us: int = 0
    epoch_day: float = 0.0

    def times(self, values: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return times (n,) [us], and flags of the believable ones."""
        per_second = PER_SECOND.get(self.unit, 1 / DAY_S)
        if self.epoch_day:
            values = values - self.epoch_day
        largest = LATEST_US // MICROSECONDS * per_second
        with np.errstate(invalid="ignore"):
            believable = (values >= 0) & (values < largest)
        kept = values if believable.all() else np.where(believable, values, 0)
        if kept.dtype.kind == "f":
            ticks = np.rint(kept.astype(np.float64) * (MICROSECONDS / per_second)).astype(np.int64)
        elif per_second > MICROSECONDS:
            ticks = (kept.astype(np.int64) + 500) // 1000
        else:
            ticks = kept.astype(np.int64, copy=False)
            if per_second != MICROSECONDS:
                ticks = ticks * (MICROSECONDS // int(per_second))
        times = ticks + self.base_us if self.base_us else ticks
        return times, believable & (times < LATEST_US) if self.base_us else believable


@dataclass(frozen=True, slots=True)
class Stamps:
    """A track of times.

    Attributes:
        pace: tells how rows that share a stamp are spread.
        wraps: what its clock may do.
        first_us, last_us: times of its first and last row that have one.
        step_us: the mean step between rows; None if none goes forward.
    """

    track: Track
    scale: StampScale
    pace: Pace
    first_us: int
    last_us: int
    step_us: float | None
    wraps: Wraps = field(default_factory=Wraps)


def stored_stamps(rows: RowSource, scale: StampScale, start: int, stop: int) -> NDArray[np.int64]:
    """Return times (n,) of rows start..stop-1 [us], NO_TIME where they cannot be believed."""
    values, good = rows.read(start, stop)
    times, believable = scale.times(values[:, 0])
    if good.all() and believable.all():
        return times
    return np.where(good, np.where(believable, times, NO_TIME), LOST)


def measured_stamps(
    table: SensorTable, track: Track, scale: StampScale, stated_hz: float | None
) -> tuple[Stamps, float]:
    """Return a track of times, and the sampling rate: the stated one, or that of its first rows.

    Raises:
        UnreadableError: its first rows hold no time at all, or the rate cannot be worked with.
    """
    rows, path = table.rows(track), table.path
    head = stored_stamps(rows, scale, 0, min(track.rows, BLOCK_ROWS))
    wraps = find_wraps(head, _unit_of_counter(scale, head))
    head = RunningOn(wraps).running_on(head)
    times = head[head > LOST]
    if not len(times):
        raise UnreadableError(
            f"{table.word} {readable(track.path)} holds no plausible time",
            path=path,
            hint="ignore it with --time-column none and give --rate HZ",
        )
    step, shown_hz = _usual_step(times)
    rate = checked_rate(shown_hz if stated_hz is None and step else stated_hz, path)
    pace = stamp_pace(times, stated_hz, rate)
    begin = spread(head, pace)
    end = spread(stored_stamps(rows, scale, max(0, track.rows - BLOCK_ROWS), track.rows), pace)
    first, last = int(begin[0]), int(end[-1] if len(end) else begin[-1])
    return Stamps(track, scale, pace, first, max(last, first), step, wraps), rate


def _unit_of_counter(scale: StampScale, head: NDArray[np.int64]) -> float | None:
    """Return the microseconds in one unit of times that count from some start; None for moments."""
    times = head[head > LOST] - scale.base_us
    counts = scale.unit in PER_SECOND and len(times) and times[0] < EARLIEST_ABSOLUTE_US
    return MICROSECONDS / PER_SECOND[scale.unit] if counts else None


def _usual_step(times: NDArray[np.int64]) -> tuple[float | None, float | None]:
    """Return the time from one row to the next [us], and the rate [Hz]; None if no step goes forward."""
    jittered = jittered_step(times)
    if jittered is not None:
        return jittered, nice_rate(MICROSECONDS / jittered)
    step = _typical_step(times)
    if step is None:
        return None, None
    rate = MICROSECONDS / step
    whole = round(rate)  # a rate within 0.1 % of a whole number of Hz means that number
    return step, float(whole) if whole and abs(rate - whole) <= whole / 1000 else round(rate, 4)


def _typical_step(times: NDArray[np.int64]) -> float | None:
    """Return the mean step between samples without gaps; None if there is no step forward."""
    changes = np.flatnonzero(np.diff(times)) + 1
    if len(changes) < 2:
        changes = np.array([0, len(times) - 1])
    steps, rows = np.diff(times[changes]), np.diff(changes)
    if not (steps > 0).any():
        return None
    usual = float(np.median(steps[steps > 0]))
    regular = (steps > 0) & (steps <= 3 * usual)
    return float(steps[regular].sum() / rows[regular].sum())


def checked_rate(rate_hz: float | None, path: Path) -> float:
    """Return a sampling rate that can be worked with.

    Raises:
        UsageError: none is known.
        UnreadableError: it is not a rate of a recorder.
    """
    if rate_hz is None:
        raise UnreadableError(
            "the file does not state the sampling rate",
            path=path,
            hint="give it with --rate HZ; means of still windows are for `accelcal fit`",
        )
    if not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
        raise UnreadableError(
            f"a sampling rate of {rate_hz:g} Hz cannot be right", path=path, hint="give it with --rate HZ"
        )
    return rate_hz


@dataclass(frozen=True, slots=True)
class TableTimeline:
    """Start, rate and stamps of a table; None where the file does not tell."""

    rate_hz: float | None
    start_us: int | None = None
    is_utc: bool = False
    has_offsets: bool = False
    stamps: Stamps | None = None
    duration_s: float | None = None
    problems: tuple[Problem, ...] = ()
    notes: tuple[str, ...] = ()


def find_timeline(source: TableSource) -> TableTimeline:
    """Find out how the rows of the acceleration lie in time.

    Raises:
        UnreadableError: the track of times makes no sense.
        UsageError: the named track of times is not there, or several fit.
    """
    attributes, options = source.attributes, source.options
    rate = attributes.number(*RATE_NAMES) if options.rate_hz is None else options.rate_hz
    stated = attributes.value(*START_NAMES)
    start = None if stated is None else parse_moment(stated)
    track = _time_track(source)
    if track is not None:
        with source.table.guard(f"{source.table.word} of times {readable(track.path)}"):
            unit = MICROSECOND if track.dtype == np.int64 and track.written else _asked_unit(source)
            return _stamped_timeline(source.table, track, rate, start, unit)
    texts = () if options.time_column else _near_texts(source)
    words = f"{source.table.word} {readable(texts[0][0].path)} holds texts, not times" if texts else ""
    if words and rate is None:
        raise UnreadableError(words, path=source.path, hint=GIVE_FORM)
    if start is not None:
        return TableTimeline(rate, *start)
    what = words or "the file does not tell when the recording began"
    if stated is not None:
        what = f"the start time {stated!r} is not a date and time"
    problem = Problem("no_start_time", f"{what}; times count from 1970-01-01", None, 0)
    return TableTimeline(rate, problems=(problem,))


def _time_track(source: TableSource) -> Track | None:
    name = source.options.time_column
    if name is not None:
        return None if name.lower() == NO_COLUMN else _named_time_track(source, name)
    found = find_time(source.tracks, source.accel)
    if len(found) > 1:
        raise UnreadableError(
            f"several {source.table.word}s may hold the times: {shown([group[0].path for group in found])}",
            path=source.path,
            hint=f"choose one with --time-column PATH, or `--time-column {NO_COLUMN}`",
        )
    if found:
        return found[0][0]
    texts = _near_texts(source)
    return written_times(source.table, texts[0][0], source.options.time_format) if len(texts) == 1 else None


def _near_texts(source: TableSource) -> tuple[Group, ...]:
    """Return the columns of texts whose names are those of times."""
    return find_time(source.table.text_tracks, source.accel)


def _named_time_track(source: TableSource, name: str) -> Track:
    track = named_track((*source.tracks, *source.table.text_tracks), name, source.table)
    if track.width != 1 or track.rows != source.accel.rows:
        raise UsageError(
            f"{track.path} is not one column as long as the acceleration ({source.accel.rows} rows)",
            path=source.path,
        )
    if track.dtype != TEXT:
        return track
    written = written_times(source.table, track, source.options.time_format)
    if written is None:
        what = f"{source.table.word} {readable(track.path)} holds texts that are not times of one form"
        raise UnreadableError(what, path=source.path, hint=GIVE_FORM)
    return written


def _asked_unit(source: TableSource) -> str | None:
    """Return the unit that --time-format gives; raises UsageError for anything else."""
    asked = source.options.time_format
    unit = None if asked is None else TABLES.durations.get(asked.lower())
    if asked is not None and unit is None:
        what = f"--time-format {asked!r} is not a unit, and the times of this table are numbers"
        raise UsageError(what, path=source.path, hint="give s, ms, us or ns")
    return unit


def _stamped_timeline(
    table: SensorTable, track: Track, rate: float | None, start: Moment | None, asked: str | None
) -> TableTimeline:
    """Return the timeline of a track of times, absolute or counting from the start."""
    scale, since = _stamp_scale(table, track, rate, start, asked)
    stamps, rate = measured_stamps(table, track, scale, rate)
    problem = Problem(
        "no_start_time",
        f"{readable(track.path)} counts from an unknown start; times count from 1970-01-01",
        None,
        0,
    )
    return TableTimeline(
        rate,
        stamps.first_us if since else None,
        bool(since and since.is_utc),
        bool(since and since.had_offset),
        stamps,
        _length_s(stamps, rate),
        () if since else (problem,),
        stamps.pace.notes,
    )


def _length_s(stamps: Stamps, rate_hz: float) -> float | None:
    """Return the length by the first and last time [s]; None if the clock did not run on between them."""
    span_us = stamps.last_us - stamps.first_us
    ran_on = LEAST_SHARE * stamps.track.rows * MICROSECONDS / rate_hz <= span_us <= RESET_US
    return span_us / MICROSECONDS + 1 / rate_hz if ran_on else None


def _stamp_scale(
    table: SensorTable, track: Track, rate: float | None, start: Moment | None, asked: str | None
) -> tuple[StampScale, Moment | None]:
    """Return unit and base of a track of times, and the moment from which it counts, None if not known."""
    stated = table.own(track.path).text("units", "unit")
    unit = asked or _stated_unit(table, track, stated)
    head = good_rows(table.rows(track), 0, min(track.rows, BLOCK_ROWS))[:, 0]
    head = head[(head > 0) & np.isfinite(head)]
    if unit is None and (day := _day_of_1970(head)) is not None:
        return StampScale("days", epoch_day=day), Moment(0)
    unit = unit or (_unit_by_size(float(head[0])) if len(head) else None) or _unit_by_rate(head, rate)
    if unit is None:
        raise UnreadableError(
            f"the unit of the times in {readable(track.path)} is not stated",
            path=table.path,
            hint="give it with --time-format (s, ms, us or ns), or as an attribute `units` of that dataset; "
            f"or ignore it with `--time-column {NO_COLUMN}`",
        )
    since = parse_moment(stated.split(" since ", 1)[1].strip()) if stated and " since " in stated else None
    if since is not None and since.us:
        return StampScale(unit, since.us), since
    first = float(head[0]) / PER_SECOND[unit] * MICROSECONDS if len(head) else 0.0
    if first >= EARLIEST_ABSOLUTE_US:
        return StampScale(unit), Moment(0, is_utc=not track.clock)
    return StampScale(unit, start.us if start else 0), start


def _stated_unit(table: SensorTable, track: Track, stated: str | None) -> str | None:
    """Return the unit of an attribute such as `seconds since 2024-03-04`, or of a name such as `time_ms`."""
    if stated is None:
        return split_time_name(track.name)[1]
    unit = TABLES.durations.get(next(iter(stated.lower().split()), ""))
    if unit is None:
        raise UnreadableError(
            f"the unit {stated!r} of the times in {readable(track.path)} is not known",
            path=table.path,
            hint=f"ignore that {table.word} with `--time-column {NO_COLUMN}`",
        )
    return unit


def _unit_by_size(value: float) -> str | None:
    """Return the unit in which a number is a moment of 1980..2100; at most one fits."""
    moments_us = {unit: value / per_second * MICROSECONDS for unit, per_second in PER_SECOND.items()}
    return next((unit for unit, us in moments_us.items() if EARLIEST_ABSOLUTE_US <= us < LATEST_US), None)


def _day_of_1970(head: NDArray[Any]) -> float | None:
    """Return the number of 1970-01-01 if numbers (n,) are days of our time whose steps fit an actigraph."""
    step = float(np.median(np.diff(head))) * DAY_S if len(head) > 1 and head.dtype.kind == "f" else 0.0
    if step <= 0 or not PLAUSIBLE_HZ[0] <= 1 / step <= PLAUSIBLE_HZ[1]:
        return None
    moments = {day: (float(head[0]) - day) * DAY_S * MICROSECONDS for day in EPOCH_DAYS}
    return next((day for day, us in moments.items() if EARLIEST_ABSOLUTE_US <= us < LATEST_US), None)


def _unit_by_rate(head: Any, rate: float | None) -> str | None:
    """Return the unit in which steps between times fit the sampling rate within 5 %, or an actigraph's."""
    low, high = PLAUSIBLE_HZ if rate is None else (rate / 1.05, rate * 1.05)
    if len(head) < 2:
        return None
    since = head - head[0]
    # Half precision has no room for FARTHEST.
    since = since.astype(np.float64) if since.dtype.itemsize < 4 and since.dtype.kind == "f" else since
    step = _typical_step(np.rint(1000.0 * np.clip(since, -FARTHEST, FARTHEST)).astype(np.int64))
    if step is None:
        return None
    rates = {unit: 1 / (step / 1000 / per_second) for unit, per_second in PER_SECOND.items()}
    return next((unit for unit, rate_hz in rates.items() if low < rate_hz < high), None)


class RowTimes:
    """Gives the times of rows in their order.

    Stamps are read ahead, and in the middle of a file from before the first row that is wanted, as far as
    rows that share one may reach; each is read once. Only what was read and not yet asked for is kept.

    Args:
        start: the first row that is wanted.
        zone: whose daylight saving the times may follow.

    Attributes:
        stamps: of the rows that `next` returned last, before they were spread.
    """

    def __init__(self, source: RowSource, stamps: Stamps, start: int, zone: str | None) -> None:
        self._source, self._scale, self._rows = source, stamps.scale, stamps.track.rows
        self._shared = SharedStamps(stamps.pace) if stamps.pace.stamp_period_us else None
        self._reach = self._shared.longest if self._shared else 0
        self._first = self._next = max(0, start - self._reach)
        self._stamps = self._times = np.empty(0, np.int64)
        self._on, self._base = RunningOn(stamps.wraps), self._first
        self._running, self._with_its_zone = LocalStamps(zone), (FOLLOWED, WITH_ITS_ZONE.format(zone))
        self._followed = self.stamps = np.empty(0, np.int64)

    def next(self, selection: RowSelection) -> NDArray[np.int64]:
        """Return times (n,) [us] of the next rows, those of a selection; rows without a time are left out."""
        self._read(min(selection.stop + self._reach, self._rows))
        begin, end = selection.start - self._first, selection.stop - self._first
        stamps, times = self._stamps[begin:end], self._times[begin:end]
        self.stamps = stamps
        self._first, self._stamps, self._times = selection.stop, self._stamps[end:], self._times[end:]
        if len(stamps) and stamps.min() <= LOST:
            selection.lose(self._source, stamps == LOST)
            selection.leave_out(UNBELIEVABLE, stamps == NO_TIME)
        followed, self._followed = np.split(self._followed, np.searchsorted(self._followed, [selection.stop]))
        wrapped = [row for row, _ in self._on.taken(selection.stop - self._base)]
        selection.note(COUNTER_WRAPS, np.array(wrapped, np.int64) + self._base - selection.start)
        selection.note(self._with_its_zone, followed[followed >= selection.start] - selection.start)
        return times

    def _read(self, stop: int) -> None:
        """Read the next stamps, up to a row, and settle times."""
        if stop <= self._next:
            return
        stamps = stored_stamps(self._source, self._scale, self._next, stop)
        stamps = self._on.running_on(stamps)
        known = np.flatnonzero(stamps > LOST)
        if len(known) == len(stamps):
            stamps, followed = self._running.running_on(stamps)
        else:
            stamps[known], followed = self._running.running_on(stamps[known])
        times = self._shared.add(stamps, last=stop == self._rows) if self._shared else stamps
        self._followed = np.append(self._followed, self._next + known[followed])
        if len(self._stamps):
            stamps, times = np.append(self._stamps, stamps), np.append(self._times, times)
        self._stamps, self._times = stamps, times
        self._next = stop
