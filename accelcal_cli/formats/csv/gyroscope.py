"""The columns of a gyroscope in a text file, and their unit.

They are found by their names, or the user or a file beside it says which they are. Rates of turn of a unit
that nothing states are not read: no length of gravity tells it.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats._tables.channels import NOT_READ, turn_scale
from accelcal_cli.formats._tables.units import Scale
from accelcal_cli.formats.csv.cells import Kind, microseconds_in
from accelcal_cli.formats.csv.columns import (
    ACCEL_NAMES,
    GYRO_NAMES,
    SHORT,
    Roles,
    Title,
    chosen_axes,
    column_name,
    titles_of,
)
from accelcal_cli.formats.csv.dialect import Dialect
from accelcal_cli.formats.csv.vendors import ExportDescription

ANGULAR = (("angular", "velocity"), ("angular", "rate"), ("rotation", "rate"))
NOT_MEASURED = frozenset({"bias", "drift", "unbiased", "mag", "magnetometer", "temp", "temperature"})
LEAST_SHARE = 0.99
"""Of the first rows with an acceleration, how many must have a rate of turn: a row without is left out."""

NO_UNIT = "its unit is not known, give --gyro-unit deg/s or rad/s"


class GyroColumns(NamedTuple):
    """Where x, y and z are, and how their numbers become counts."""

    xyz: tuple[int, int, int]
    scale: Scale


def find_gyroscope(
    dialect: Dialect, roles: Roles, export: ExportDescription, options: ReadOptions, path: Path
) -> tuple[GyroColumns | None, tuple[str, ...]]:
    """The gyroscope of a file, None without; and notes: that there is one, and why it is not read.

    Raises:
        UnreadableError: a column of --gyro-columns does not hold numbers.
        UsageError: --gyro-columns names no column of the file.
    """
    chosen = chosen_axes(dialect, options.gyro_columns, path, "--gyro-columns")
    used = {*roles.xyz, roles.time, roles.date, *roles.channels.values()}
    titles = [title for title in titles_of(dialect) if title.number not in used]
    known = chosen or export.gyro
    groups = [known] if known else _named(titles, dialect, roles)
    if not groups:
        return None, ()
    if options.gyro_unit == "none":
        return None, (NOT_READ,)
    if len(groups) > 1:
        return None, (
            "no gyroscope is read: several groups of columns are named like one; --gyro-columns chooses",
        )
    xyz = groups[0]
    names = ", ".join(column_name(dialect, column) for column in xyz)
    if any(dialect.kinds[column] is not Kind.NUMBER for column in xyz):
        if chosen:
            raise UnreadableError(
                f"{names}: not all of them hold numbers", path=path, line=dialect.names_line
            )
        return None, (f"the gyroscope ({names}) is not read: not all of its columns hold numbers",)
    scale = _scale(titles, xyz, export, options)
    if scale is None:
        return None, (f"the gyroscope ({names}) is not read: {NO_UNIT}",)
    return GyroColumns(xyz, scale), (f"gyroscope: {names}",)


def often_missing(values: NDArray[np.float64], rates: NDArray[np.float64]) -> str | None:
    """Why a gyroscope is not read whose values (n, 3) are missing in many of the first rows."""
    rows = ~np.isnan(values).any(axis=1)
    missing = int((rows & np.isnan(rates).any(axis=1)).sum())
    if missing <= (1 - LEAST_SHARE) * rows.sum():
        return None
    return f"the gyroscope is not read: {missing} of the first {rows.sum()} rows have no value of it"


def _named(titles: list[Title], dialect: Dialect, roles: Roles) -> list[tuple[int, int, int]]:
    """Groups of three columns that are named like a gyroscope's, those of the acceleration's place alone.

    A group with two columns for one axis counts as two.
    """
    groups: dict[tuple[str, ...], dict[str, list[int]]] = {}
    for title in titles:
        if title.axis and _turns(title.stem):
            groups.setdefault(title.stem, {}).setdefault(title.axis, []).append(title.number)
    found = {
        stem: list(zip(axes["x"], axes["y"], axes["z"], strict=False))
        for stem, axes in groups.items()
        if len(axes) == 3
    }
    around = {_place(title.stem) for title in titles_of(dialect) if title.number in roles.xyz}
    near = [group for stem, same in found.items() if _place(stem) in around for group in same]
    return near or [group for same in found.values() for group in same]


def _turns(stem: tuple[str, ...]) -> bool:
    if NOT_MEASURED & set(stem):
        return False
    pairs = pairwise(stem)
    return (
        bool(GYRO_NAMES & set(stem))
        or (len(stem) == 1 and stem[0] in SHORT)
        or any(p in ANGULAR for p in pairs)
    )


def _place(stem: tuple[str, ...]) -> tuple[str, ...]:
    """What is left of a name without the sensor, such as a side of the body."""
    sensor = {*ACCEL_NAMES, *GYRO_NAMES, *SHORT, *(word for pair in ANGULAR for word in pair)}
    return tuple(word for word in stem if word not in sensor)


def _scale(
    titles: list[Title], xyz: tuple[int, int, int], export: ExportDescription, options: ReadOptions
) -> Scale | None:
    """By the user, the names of the columns, or the vendor."""
    if options.lsb_per_dps is not None:
        return Scale(options.lsb_per_dps)
    hints = {title.hint for title in titles if title.number in xyz and microseconds_in(title.hint) is None}
    named = next(iter(hints)) if len(hints) == 1 else ""
    unit = options.gyro_unit or named or export.gyro_unit
    return None if unit is None else turn_scale(unit)
