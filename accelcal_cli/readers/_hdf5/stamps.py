"""When a recording in an HDF5 file began and how fast it runs: from attributes and time datasets."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.recording import Problem
from accelcal_cli.readers._hdf5.file import Attributes, h5py_guard
from accelcal_cli.readers._hdf5.find import find_time, named_track, split_time_name
from accelcal_cli.readers._hdf5.plan import Source, head_rows, measured_stamps
from accelcal_cli.readers._hdf5.stream import Stamps
from accelcal_cli.readers._hdf5.time import (
    EARLIEST_ABSOLUTE_US,
    PER_SECOND,
    StampScale,
    nominal_rate,
    parse_moment,
    time_unit,
    typical_step,
    unit_by_size,
)
from accelcal_cli.readers._hdf5.track import Track

RATE_NAMES = (
    "sample_rate",
    "sample_rate_hz",
    "sampling_rate",
    "sampling_rate_hz",
    "samplerate",
    "rate_hz",
    "sampling_frequency",
    "sampling_frequency_hz",
    "sample_frequency",
    "frequency_hz",
    "sfreq",
    "fs",
    "fs_hz",
    "hz",
    "rate",
    "frequency",
)
START_NAMES = (
    "start_time",
    "start",
    "start_timestamp",
    "start_datetime",
    "recording_start",
    "recording_start_time",
    "start_time_utc",
)
NO_COLUMN = "none"


@dataclass(frozen=True, slots=True)
class Timeline:
    """Start, rate and stamps; None where the file does not tell."""

    rate_hz: float | None
    start_us: int | None = None
    is_utc: bool = False
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
    told = attributes.value(*START_NAMES)
    start = None if told is None else parse_moment(told)
    track = _time_track(source)
    if track is not None:
        with h5py_guard(source.path, f"dataset of times {track.path}"):
            return _stamped(source.file, track, rate, start, source.path)
    if start is not None:
        return Timeline(rate, start[0], start[1])
    said = "the file does not tell when the recording began"
    if told is not None:
        said = f"the start time {told!r} is not a date and time"
    problem = Problem("no_start_time", f"{said}; times count from 1970-01-01", None, 0)
    return Timeline(rate, problems=(problem,))


def _time_track(source: Source) -> Track | None:
    name = source.options.time_column
    if name is not None:
        return None if name.lower() == NO_COLUMN else _named(source, name)
    found = find_time(source.tracks, source.accel)
    if len(found) > 1:
        listed = ", ".join(group[0].path for group in found)
        raise UnreadableError(
            f"several datasets may hold the times: {listed}",
            path=source.path,
            hint=f"choose one with --time-column PATH, or `--time-column {NO_COLUMN}`",
        )
    return found[0][0] if found else None


def _named(source: Source, name: str) -> Track:
    track = named_track(source.tracks, name, source.path)
    if track.width != 1 or track.rows != source.accel.rows:
        raise UsageError(
            f"{track.path} is not one column as long as the acceleration ({source.accel.rows} rows)",
            path=source.path,
        )
    return track


def _stamped(
    file: Any, track: Track, rate: float | None, start: tuple[int, bool] | None, path: Path
) -> Timeline:
    """The timeline of a time dataset, absolute or counting from the start."""
    scale, is_utc, known = _stamp_scale(file, track, rate, start, path)
    stamps, first, last, step = measured_stamps(file, track, scale, path)
    if rate is None and step is not None:
        rate = nominal_rate(step)
    period = 1 / rate if rate else 0.0
    problem = Problem(
        "no_start_time", f"{track.path} counts from an unknown start; times count from 1970-01-01", None, 0
    )
    return Timeline(
        rate,
        first if known else None,
        is_utc,
        stamps,
        (last - first) / MICROSECONDS + period,
        () if known else (problem,),
    )


def _stamp_scale(
    file: Any, track: Track, rate: float | None, start: tuple[int, bool] | None, path: Path
) -> tuple[StampScale, bool, bool]:
    """Unit and base of a time dataset, whether it is UTC for certain, whether its start is known."""
    told = Attributes([file[track.path]]).text("units", "unit")
    unit = _told_unit(track, told, path)
    head = head_rows(file, track, path)[:, 0]
    head = head[head > 0]
    unit = unit or (unit_by_size(float(head[0])) if len(head) else None) or _unit_by_rate(head, rate)
    if unit is None:
        raise UnreadableError(
            f"the unit of the times in {track.path} is not told",
            path=path,
            hint="give that dataset an attribute `units` (s, ms, us or ns), "
            f"or leave it aside with `--time-column {NO_COLUMN}`",
        )
    since = parse_moment(told.split(" since ", 1)[1].strip()) if told and " since " in told else None
    if since is not None and since[0]:
        return StampScale(unit, since[0]), since[1], True
    first = float(head[0]) / PER_SECOND[unit] * MICROSECONDS if len(head) else 0.0
    if first >= EARLIEST_ABSOLUTE_US:
        return StampScale(unit), False, True
    return StampScale(unit, start[0] if start else 0), bool(start and start[1]), start is not None


def _told_unit(track: Track, told: str | None, path: Path) -> str | None:
    """The unit by attribute, or by a name such as `time_ms`."""
    if told is None:
        return split_time_name(track.name)[1]
    unit = time_unit(told)
    if unit is None:
        raise UnreadableError(
            f"the unit {told!r} of the times in {track.path} is not known",
            path=path,
            hint=f"leave that dataset aside with `--time-column {NO_COLUMN}`",
        )
    return unit


def _unit_by_rate(head: Any, rate: float | None) -> str | None:
    """The unit in which the steps between times fit the sampling rate within 5 %."""
    for unit in PER_SECOND:
        times, _ = StampScale(unit).times(head)
        typical = typical_step(times) if len(head) > 1 else None
        if rate and typical and abs(typical[0] * rate / MICROSECONDS - 1) < 0.05:
            return unit
    return None
