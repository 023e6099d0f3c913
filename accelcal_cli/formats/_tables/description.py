"""What the names, attributes and times of a table say before its rows are read.

`find_timeline` finds out when the recording began and how fast it runs; `Plan` holds what to read.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, utc_offset_s
from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Problem, Recording
from accelcal_cli.core.vocabulary import PER_SECOND
from accelcal_cli.formats._stamps import LOST, NO_TIME, Pace, jittered_step, nice_rate, spread, stamp_pace
from accelcal_cli.formats._tables import tracks as tracks_of
from accelcal_cli.formats._tables import units
from accelcal_cli.formats._tables.attributes import Attributes, readable
from accelcal_cli.formats._tables.channels import Axes, Channel
from accelcal_cli.formats._tables.table import BLOCK_ROWS, RowSource, Table
from accelcal_cli.formats._tables.tracks import Group, Track
from accelcal_cli.formats._tables.units import Moment, StampScale, parse_moment

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
NO_COLUMN = "none"
FARTHEST = 1 << 50
"""No time since the first one is larger in any unit: 13 days in ns."""


@dataclass(frozen=True, slots=True)
class Stamps:
    """A track of times.

    Attributes:
        pace: by which rows that share a stamp are spread.
        first_us, last_us: times of its first and last row that have one.
        step_us: the mean step between rows; None if none goes forward.
    """

    track: Track
    scale: StampScale
    pace: Pace
    first_us: int
    last_us: int
    step_us: float | None


@dataclass(frozen=True, slots=True)
class Plan:
    """What to read and how, found out when the recording was opened.

    `problems` go with the first rows, those about the `missing_bytes` of a file cut short with the last.
    """

    recording: Recording
    rows: int
    accel: Axes
    stamps: Stamps | None = None
    channels: dict[str, Channel] = field(default_factory=dict)
    problems: tuple[Problem, ...] = ()
    missing_bytes: int = 0

    @property
    def tracks(self) -> tuple[Track, ...]:
        """All that is read."""
        groups = (self.accel.tracks, *(channel.tracks for channel in self.channels.values()))
        stamps = () if self.stamps is None else (self.stamps.track,)
        return (*(track for group in groups for track in group), *stamps)


@dataclass(frozen=True, slots=True)
class Source:
    """A table being opened: all its tracks, where the acceleration is, and what is stated of it."""

    table: Table
    options: ReadOptions
    tracks: tuple[Track, ...]
    group: Group
    attributes: Attributes
    damaged: int = 0

    @property
    def path(self) -> Path:
        """The file."""
        return self.table.path

    @property
    def accel(self) -> Track:
        """The track of acceleration, or of its x axis."""
        return self.group[0]


def good_rows(rows: RowSource, start: int, stop: int) -> NDArray[Any]:
    """Rows start..stop-1 without the lost ones, (n, width)."""
    values, good = rows.read(start, stop)
    return values[good]


def spread_rows(table: Table, track: Track, places: int = 5, each: int = 1024) -> NDArray[Any]:
    """Some rows from the beginning, the end and between, without lost ones."""
    rows = table.rows(track)
    last = max(0, track.rows - each)
    starts = sorted({place * last // (places - 1) for place in range(places)})
    return np.concatenate([good_rows(rows, start, min(start + each, track.rows)) for start in starts])


def stored_stamps(rows: RowSource, scale: StampScale, start: int, stop: int) -> NDArray[np.int64]:
    """Times (n,) of rows start..stop-1 [us], NO_TIME where they cannot be believed."""
    values, good = rows.read(start, stop)
    times, believable = scale.times(values[:, 0])
    if good.all() and believable.all():
        return times
    return np.where(good, np.where(believable, times, NO_TIME), LOST)


def measured_stamps(
    table: Table, track: Track, scale: StampScale, stated_hz: float | None
) -> tuple[Stamps, float]:
    """A track of times, and the sampling rate: the stated one, or what its first rows show.

    Raises:
        UnreadableError: its first rows hold no time at all, or the rate cannot be worked with.
    """
    rows, path = table.rows(track), table.path
    head = stored_stamps(rows, scale, 0, min(track.rows, BLOCK_ROWS))
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
    return Stamps(track, scale, pace, first, max(last, first), step), rate


def _usual_step(times: NDArray[np.int64]) -> tuple[float | None, float | None]:
    """Time from one row to the next [us], and the rate that it means; None if no step goes forward."""
    jittered = jittered_step(times)
    if jittered is not None:
        return jittered, nice_rate(MICROSECONDS / jittered)
    step = units.typical_step(times)
    return step, None if step is None else units.nominal_rate(step)


def checked_rate(rate_hz: float | None, path: Path) -> float:
    """A sampling rate that can be worked with.

    Raises:
        UsageError: none is known.
        UnreadableError: it is no rate of a recorder.
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


def known_zone(name: str | None) -> str | None:
    """The name or offset of a time zone if it is one, else None."""
    if name is None or name.upper() in ("UTC", "Z"):
        return name and "UTC"
    try:
        utc_offset_s(name, 0)
    except UsageError:
        return None
    return name


def header_problems(attributes: Attributes, damaged: int = 0) -> tuple[Problem, ...]:
    """One problem where attributes, datasets or groups could not be read."""
    count = len(attributes.damaged) + damaged
    if not count:
        return ()
    what = f"{count} attributes, datasets or groups cannot be read and count as absent"
    return (Problem("damaged_header", what, None, 0, count),)


@dataclass(frozen=True, slots=True)
class Timeline:
    """Start, rate and stamps; None if the file does not say."""

    rate_hz: float | None
    start_us: int | None = None
    is_utc: bool = False
    has_offsets: bool = False
    stamps: Stamps | None = None
    duration_s: float | None = None
    problems: tuple[Problem, ...] = ()
    notes: tuple[str, ...] = ()


def find_timeline(source: Source) -> Timeline:
    """How the rows of the acceleration lie in time.

    Raises:
        UnreadableError: the time dataset makes no sense.
        UsageError: the named time dataset is not there, or several fit.
    """
    attributes, options = source.attributes, source.options
    rate = attributes.number(*RATE_NAMES) if options.rate_hz is None else options.rate_hz
    stated = attributes.value(*START_NAMES)
    start = None if stated is None else parse_moment(stated)
    track = _time_track(source)
    if track is not None:
        with source.table.guard(f"{source.table.word} of times {readable(track.path)}"):
            return _stamped(source.table, track, rate, start)
    if start is not None:
        return Timeline(rate, *start)
    what = "the file does not tell when the recording began"
    if stated is not None:
        what = f"the start time {stated!r} is not a date and time"
    problem = Problem("no_start_time", f"{what}; times count from 1970-01-01", None, 0)
    return Timeline(rate, problems=(problem,))


def _time_track(source: Source) -> Track | None:
    name = source.options.time_column
    if name is not None:
        return None if name.lower() == NO_COLUMN else _named(source, name)
    found = tracks_of.find_time(source.tracks, source.accel)
    if len(found) > 1:
        listed = ", ".join(group[0].path for group in found)
        raise UnreadableError(
            f"several {source.table.word}s may hold the times: {listed}",
            path=source.path,
            hint=f"choose one with --time-column PATH, or `--time-column {NO_COLUMN}`",
        )
    return found[0][0] if found else None


def _named(source: Source, name: str) -> Track:
    track = tracks_of.named_track(source.tracks, name, source.table)
    if track.width != 1 or track.rows != source.accel.rows:
        raise UsageError(
            f"{track.path} is not one column as long as the acceleration ({source.accel.rows} rows)",
            path=source.path,
        )
    return track


def _stamped(table: Table, track: Track, rate: float | None, start: Moment | None) -> Timeline:
    """The timeline of a time dataset, absolute or counting from the start."""
    scale, since = _stamp_scale(table, track, rate, start)
    stamps, rate = measured_stamps(table, track, scale, rate)
    problem = Problem(
        "no_start_time",
        f"{readable(track.path)} counts from an unknown start; times count from 1970-01-01",
        None,
        0,
    )
    return Timeline(
        rate,
        stamps.first_us if since else None,
        bool(since and since.is_utc),
        bool(since and since.had_offset),
        stamps,
        (stamps.last_us - stamps.first_us) / MICROSECONDS + 1 / rate,
        () if since else (problem,),
        stamps.pace.notes,
    )


def _stamp_scale(
    table: Table, track: Track, rate: float | None, start: Moment | None
) -> tuple[StampScale, Moment | None]:
    """Unit and base of a time dataset, and the moment from which it counts, None if that is not known."""
    stated = table.own(track.path).text("units", "unit")
    unit = _stated_unit(table, track, stated)
    head = good_rows(table.rows(track), 0, min(track.rows, BLOCK_ROWS))[:, 0]
    head = head[(head > 0) & np.isfinite(head)]
    if unit is None and (day := units.day_of_1970(head)) is not None:
        return StampScale("days", epoch_day=day), Moment(0)
    unit = unit or (units.unit_by_size(float(head[0])) if len(head) else None) or _unit_by_rate(head, rate)
    if unit is None:
        raise UnreadableError(
            f"the unit of the times in {readable(track.path)} is not stated",
            path=table.path,
            hint="give that dataset an attribute `units` (s, ms, us or ns), "
            f"or ignore it with `--time-column {NO_COLUMN}`",
        )
    since = parse_moment(stated.split(" since ", 1)[1].strip()) if stated and " since " in stated else None
    if since is not None and since.us:
        return StampScale(unit, since.us), since
    first = float(head[0]) / PER_SECOND[unit] * MICROSECONDS if len(head) else 0.0
    if first >= units.EARLIEST_ABSOLUTE_US:
        return StampScale(unit), Moment(0, is_utc=not track.clock)
    return StampScale(unit, start.us if start else 0), start


def _stated_unit(table: Table, track: Track, stated: str | None) -> str | None:
    """The unit by attribute, or by a name such as `time_ms`."""
    if stated is None:
        return tracks_of.split_time_name(track.name)[1]
    unit = units.time_unit(stated)
    if unit is None:
        raise UnreadableError(
            f"the unit {stated!r} of the times in {readable(track.path)} is not known",
            path=table.path,
            hint=f"ignore that {table.word} with `--time-column {NO_COLUMN}`",
        )
    return unit


def _unit_by_rate(head: Any, rate: float | None) -> str | None:
    """The unit in which the steps between times fit the sampling rate within 5 %, or else an actigraph's."""
    low, high = units.PLAUSIBLE_HZ if rate is None else (rate / 1.05, rate * 1.05)
    for unit, per_second in PER_SECOND.items():
        typical = _typical_step(head - head[0], per_second) if len(head) > 1 else None
        if typical and low < 1 / typical < high:
            return unit
    return None


def _typical_step(since: Any, per_second: int) -> float | None:
    """Mean step [s] of times since the first one; half precision has no room for the farthest."""
    since = since.astype(np.float64) if since.dtype.itemsize < 4 and since.dtype.kind == "f" else since
    step = units.typical_step(np.rint(1000.0 * np.clip(since, -FARTHEST, FARTHEST)).astype(np.int64))
    return None if step is None else step / 1000 / per_second
