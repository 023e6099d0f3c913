"""Physics Toolbox Sensor Suite: one table of all sensors that were chosen, with short names.

`gFx,gFy,gFz` are acceleration with gravity in g, `ax,ay,az` without it in m/s2, `wx,wy,wz` rotation rates in
rad/s; the first column is the time, and others may stand between (vieyrasoftware.net, "Physics Toolbox Sensor
Suite", and the heads of its exports). Only the acceleration with gravity is read.
"""

from __future__ import annotations

from accelcal_cli.formats.tables.vendors import Head, Stated, Vendor

G_FORCE, ROTATION = ("gfx", "gfy", "gfz"), ("wx", "wy", "wz")


def recognise(head: Head) -> bool:
    """Return True if a column is the time, and three have the names of its g-force meter."""
    return head.numbers("time", *G_FORCE) is not None


def describe(head: Head) -> Stated:
    """Return the columns of acceleration with gravity, and of the gyroscope."""
    return Stated(
        title="Physics Toolbox",
        xyz=head.numbers(*G_FORCE),
        time=head.plain.index("time"),
        unit="g",
        gyro=head.numbers(*ROTATION),
        gyro_unit="rad/s",
    )


VENDOR = Vendor("physicstoolbox", recognise, describe, by_names=True)
