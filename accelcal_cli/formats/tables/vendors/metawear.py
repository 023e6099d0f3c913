"""MetaWear: tables of MetaBase, with milliseconds since 1970, a local stamp and the time since the start.

Columns are `epoc (ms),timestamp (+0100),elapsed (s),x-axis (g),y-axis (g),z-axis (g)`, in later versions
`epoch (ms)` and `time (01:00)`. The stamps have points between hours, minutes and seconds (the apps of
github.com/mbientlab), so the first column is the time.
"""

from __future__ import annotations

from accelcal_cli.core.recording import Device
from accelcal_cli.formats.tables.vendors import Head, Stated, Vendor

AXES = ("x-axis", "y-axis", "z-axis")
EPOCHS = ("epoc", "epoch")


def recognise(head: Head) -> bool:
    """Return True if there are a column of each of these names, and one of elapsed seconds."""
    return head.numbers("elapsed", *AXES) is not None and _epoch(head) is not None


def _epoch(head: Head) -> int | None:
    return next((number for number, name in enumerate(head.plain) if name in EPOCHS), None)


def describe(head: Head) -> Stated:
    """Return the roles of the columns; files of the sensor fusion have them too, so the unit is checked."""
    xyz, time = head.numbers(*AXES), _epoch(head)
    return Stated(title="MetaWear", device=Device("MetaWear"), xyz=xyz, time=time, unit="g")


VENDOR = Vendor("metawear", recognise, describe, by_names=True)
