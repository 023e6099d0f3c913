"""The options of the functions, as keywords with types. tools/make_options.py writes this file.

An option that is left out, or None, has its default.
"""

from __future__ import annotations

from datetime import datetime
from os import PathLike
from typing import Literal, TypedDict

Columns = str | tuple[str | int, str | int, str | int] | list[str] | list[int]


class ReadingOptions(TypedDict, total=False):
    """How a recording is read."""

    format: str | None
    """Format, if the content does not show it."""

    rate: float | None
    """[Hz] Sampling rate, if the file has no times (above 0, at most 100000)."""

    unit: Literal["g", "mg", "m/s2", "counts"] | None
    """Unit, if the file does not state it."""

    lsb_per_g: float | None
    """Counts per g (above 0, at most 1e+09)."""

    zero: int | None
    """Count that means 0 g in a table, such as 512 for a 10-bit converter (-1.07374e+09 to
    1.07374e+09)."""

    columns: Columns | None
    """Names of the columns, or numbers from 0."""

    time_column: str | None
    """Column of the times."""

    date_format: Literal["dmy", "mdy", "ymd"] | None
    """Order of day, month and year in dates such as 04/03/2024."""

    time_format: str | None
    """Form of a table's times, in strptime codes: '%d/%m/%Y %H:%M:%S.%f'. Numbers: s, ms, us or ns."""

    timezone: str | None
    """Time zone of its clock, such as Europe/Berlin."""

    force_timezone: bool | None
    """Use timezone even if a file states another zone."""

    start: str | datetime | None
    """Start time, for files that do not contain one."""

    shift: float | None
    """[s] Add SECONDS to all times, to correct a clock that was wrong (-1e+09 to 1e+09)."""

    configured_zone: str | None
    """Time zone that the device's clock was set to (with worn_zone)."""

    worn_zone: str | None
    """Time zone where the device was worn, if it differs from the zone its clock was set to."""

    layout: str | PathLike[str] | None
    """Layout of a raw dump."""

    sensor: str | None
    """One of several sensors in the file."""

    gyro_columns: Columns | None
    """Columns of the gyroscope's x, y and z."""

    gyro_unit: Literal["deg/s", "rad/s", "none"] | None
    """Unit of the gyroscope; none: do not read it."""

    lsb_per_dps: float | None
    """Counts of the gyroscope per deg/s (above 0, at most 1e+09)."""

    only_motion: bool | None
    """Leave light, buttons, battery, pressure and the like out of the calibrated data."""


class MethodOptions(ReadingOptions, total=False):
    """How a recording is read and fitted."""

    profile: Literal["default", "paper"] | None
    """paper: the published procedure (default: default)."""

    optimizer: str | None
    """Optimizer that finds the parameters (default: fixed32)."""

    model: Literal["auto", "9", "6", "3"] | None
    """Number of parameters (default: auto)."""

    recalibrate: Literal["auto", "never"] | None
    """auto: adapt the calibration when the sensor changes during the recording. never: only report the
    change (default: auto)."""

    no_temperature: bool | None
    """Leave temperature out."""

    stillness: Literal["both", "range", "deviation", "adaptive"] | None
    """Rule by which a window counts as still (default: both; profile paper: range, or both if no axis
    calibrates)."""

    segment_seconds: float | None
    """[s] Length of a window (above 0, at most 3600; default: depends on stillness)."""

    stillness_threshold_g: float | None
    """[g] Largest max - min in a still window (rules both, range) (above 0, at most 4; default: 0.12)."""

    stillness_axis: Literal["x", "y", "z"] | None
    """Axis that stillness range checks."""

    longest_gap: float | None
    """[s] Longest gap between time stamps that a window may span; 0 for none (0 to 10; default: 0.5;
    profile paper: 0)."""

    max_error: float | None
    """[mg] Limit of the calibration error (above 0, at most 1e+06; default: 10.0)."""

    strict: bool | None
    """Refuse provisional calibrations."""

    precision: float | None
    """[mg] Round values to steps of at most MG, for smaller files (0.001 to 1000; default: exact)."""

    latitude: float | None
    """[degrees] Latitude of the place where the recording was made, for local gravity (-90 to 90)."""

    altitude: float | None
    """[m] Altitude above sea level (-500 to 9000; default: 0)."""

    max_damage: float | None
    """[%] Refuse a recording if more of it is damaged (0 to 100; default: 50.0)."""

    min_distance_g: float | None
    """[g] Smallest distance between two points (profile paper only); 0 for no limit (0 to 2; default:
    profile paper: 0.2)."""

    min_subset_points: int | None
    """Minimum number of points per subset (profile paper only) (1 to 100; default: 2)."""

    max_subset_points: int | None
    """Maximum number of points per subset (profile paper only) (1 to 100; default: 2)."""


class CalibrationOptions(MethodOptions, total=False):
    """Options of `calibrate`."""

    prior: Literal["population", "none"] | None
    """none: fit only what the recording supports (default: population)."""


class StudyOptions(MethodOptions, total=False):
    """Options of `study` for each recording."""

    prior: Literal["population", "none", "study", "device"] | None
    """none: fit only what the recording supports (default: population)."""


class FitOptions(TypedDict, total=False):
    """Options of `fit`."""

    optimizer: str | None
    """Optimizer that finds the parameters (default: fixed32)."""

    model: Literal["auto", "9", "6", "3"] | None
    """Number of parameters (default: auto)."""

    no_temperature: bool | None
    """Leave temperature out."""

    latitude: float | None
    """[degrees] Latitude of the place where the recording was made, for local gravity (-90 to 90)."""

    altitude: float | None
    """[m] Altitude above sea level (-500 to 9000; default: 0)."""

    max_error: float | None
    """[mg] Limit of the calibration error (above 0, at most 1e+06; default: 10.0)."""

    strict: bool | None
    """Refuse provisional calibrations."""

    prior: Literal["population", "none"] | None
    """none: fit only what the recording supports (default: population)."""


class PoseOptions(ReadingOptions, total=False):
    """Options of `from_poses`."""

    unchecked: bool | None
    """Fit four poses too, of which none can be held out."""

    segment_seconds: float | None
    """[s] Length of a window (0.1 to 60)."""

    stillness_threshold_g: float | None
    """[g] Largest max - min in a still window (above 0, at most 4; default: 0.12)."""

    longest_gap: float | None
    """[s] Longest gap between time stamps that a window may span; 0 for none (0 to 10; default: 0.5;
    profile paper: 0)."""

    face_degrees: float | None
    """[degrees] Largest angle between the raw mean of a face and its axis (1 to 45; default: 15.0)."""

    max_damage: float | None
    """[%] Refuse a recording if more of it is damaged (0 to 100; default: 50.0)."""

    max_error: float | None
    """[mg] Limit of the calibration error (above 0, at most 1e+06; default: 10.0)."""

    latitude: float | None
    """[degrees] Latitude of the place where the recording was made, for local gravity (-90 to 90)."""

    altitude: float | None
    """[m] Altitude above sea level (-500 to 9000; default: 0)."""
