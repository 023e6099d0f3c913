"""Gyroscope and temperature datasets that lie beside the acceleration."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.readers._hdf5.file import H5PY_ERRORS, Attributes, attributes_of
from accelcal_cli.readers._hdf5.find import Group, find_gyro, find_temperature
from accelcal_cli.readers._hdf5.plan import Source, first_temperature, is_readable
from accelcal_cli.readers._hdf5.scale import Scale, count_scale, gyro_scale, per_celsius, per_dps
from accelcal_cli.readers._hdf5.stream import Axes, Temperature
from accelcal_cli.readers._hdf5.track import Track

_LSB_PER_DPS = ("lsb_per_dps", "counts_per_dps", "gyro_lsb_per_dps", "lsb_per_deg_s")
_DPS_PER_LSB = ("dps_per_lsb", "dps_per_count", "gyro_dps_per_lsb")


@dataclass(frozen=True, slots=True)
class Extras:
    """What lies beside the acceleration; `notes` say what is there but not used, and why."""

    gyro: Axes | None = None
    temperature: Temperature | None = None
    notes: tuple[str, ...] = ()


def find_extras(source: Source) -> Extras:
    """Look for a gyroscope and a temperature of the same length as the acceleration."""
    file, tracks, accel = source.file, source.tracks, source.accel
    gyro, gyro_notes = _gyro(file, find_gyro(tracks, accel), source.path)
    temperature, notes = _temperature(file, find_temperature(tracks, accel), source.path)
    return Extras(gyro, temperature, gyro_notes + notes)


def _gyro(file: Any, found: tuple[Group, ...], path: Path) -> tuple[Axes | None, tuple[str, ...]]:
    if len(found) != 1:
        return None, _several("gyroscope", found)
    told = attributes_of(file, found[0][0].path)
    scale = _gyro_scale(found[0], told)
    if scale is None:
        return None, (f"{found[0][0].path} is not used: its unit is not deg/s, rad/s or counts per deg/s",)
    if not all(is_readable(file, track, path) for track in found[0]):
        return None, (f"{found[0][0].path} is not used: it is damaged",)
    return Axes(found[0], scale), ()


def _gyro_scale(group: Group, told: Attributes) -> Scale | None:
    """From `lsb_per_dps` or `dps_per_lsb` for counts, from the unit for decimal fractions."""
    per_count, counts = told.number(*_DPS_PER_LSB), told.number(*_LSB_PER_DPS)
    lsb = 1 / per_count if counts is None and per_count else counts
    if lsb is not None and lsb > 0:
        widest = max((item.dtype for item in group), key=lambda dtype: dtype.itemsize)
        return count_scale(lsb, widest) if widest.kind in "iu" else Scale(lsb)
    factor = per_dps(told.text("units", "unit") or "")
    return None if factor is None else gyro_scale(factor)


def _temperature(
    file: Any, found: tuple[Group, ...], path: Path
) -> tuple[Temperature | None, tuple[str, ...]]:
    if len(found) != 1:
        return None, _several("temperature", found)
    track = found[0][0]
    factor = _temperature_factor(file, track)
    if factor is None:
        return None, (f"{track.path} is not used: its unit is not degrees Celsius",)
    try:
        temperature = first_temperature(file, track, factor, path)
    except (UnreadableError, *H5PY_ERRORS):
        return None, (f"{track.path} is not used: it is damaged",)
    if temperature is None:
        return None, (f"{track.path} is not used: it holds no temperature",)
    return temperature, ()


def _temperature_factor(file: Any, track: Track) -> float | None:
    """Units in one degree, as the dataset says; decimal fractions that say nothing are in Celsius."""
    unit = Attributes([file[track.path]]).text("units", "unit")
    if unit is not None:
        return per_celsius(unit)
    named = track.name.lower().endswith(("_c", "_degc"))
    return 1.0 if named or track.dtype.kind == "f" else None


def _several(what: str, found: tuple[Group, ...]) -> tuple[str, ...]:
    if not found:
        return ()
    paths = ", ".join(group[0].path for group in found)
    return (f"no {what} is used: several datasets fit ({paths})",)
