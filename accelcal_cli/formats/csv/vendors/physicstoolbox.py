"""Physics Toolbox Sensor Suite: one table of all sensors that were chosen, with short names.

`gFx,gFy,gFz` are acceleration with gravity in g, `ax,ay,az` without it in m/s2, `wx,wy,wz` rotation rates in
rad/s; the first column is the time, and others may stand between (vieyrasoftware.net, "Physics Toolbox Sensor
Suite", and the heads of its exports). Only the acceleration with gravity is read.
"""

from __future__ import annotations

import re

from accelcal_cli.formats.csv.vendors import ExportDescription, Head, Vendor

G_FORCE, ROTATION = ("gFx", "gFy", "gFz"), ("wx", "wy", "wz")
SEPARATOR = re.compile(r"[,;\t]")


def _names(head: Head) -> list[str]:
    """Return the names of the columns, without units."""
    return [re.sub(r"\s*\(.*", "", cell.strip('" ')) for cell in SEPARATOR.split(head[0])]


def _axes(names: list[str], wanted: tuple[str, str, str]) -> tuple[int, int, int] | None:
    """Return the numbers of three columns; None if one is missing or there twice."""
    if any(names.count(name) != 1 for name in wanted):
        return None
    x, y, z = map(names.index, wanted)
    return x, y, z


def recognise(head: Head) -> bool:
    """Return True if the first column is the time, and three have the names of its g-force meter."""
    names = _names(head)
    return names[0].lower() == "time" and _axes(names, G_FORCE) is not None


def describe(head: Head) -> ExportDescription:
    """Return the columns of acceleration with gravity, and of the gyroscope."""
    names = _names(head)
    return ExportDescription(
        title="Physics Toolbox",
        xyz=_axes(names, G_FORCE),
        time=0,
        unit="g",
        gyro=_axes(names, ROTATION),
        gyro_unit="rad/s",
    )


VENDOR = Vendor("physicstoolbox", recognise, describe)
