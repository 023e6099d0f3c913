"""MetaWear: CSV of MetaBase, with milliseconds since 1970, a local stamp and the time since the start.

Columns are `epoc (ms),timestamp (+0100),elapsed (s),x-axis (g),y-axis (g),z-axis (g)`, in later versions
`epoch (ms)` and `time (01:00)`. The stamps have points between hours, minutes and seconds (the apps of
github.com/mbientlab), so the first column is the time.
"""

from __future__ import annotations

import re

from accelcal_cli.core.recording import Device
from accelcal_cli.formats.csv.vendors import ExportDescription, Head, Vendor

FIRST = re.compile(
    r"epoch? \(ms\),time(?:stamp)? \([-+]?\d\d:?\d\d\),elapsed \(s\)"
    r",x-axis \(g\),y-axis \(g\),z-axis \(g\)((?:,[^,]*)*)"
)
NAMES = ("epoch (ms)", "other", "other", "x-axis", "y-axis", "z-axis")


def recognise(head: Head) -> bool:
    """Return True if the columns have these names."""
    return FIRST.fullmatch(head[0].strip()) is not None


def describe(head: Head) -> ExportDescription:
    """Return the roles of the columns; files of the sensor fusion have them too, so the unit is checked."""
    match = FIRST.fullmatch(head[0].strip())
    others = ("other",) * (match[1].count(",") if match else 0)
    return ExportDescription(
        title="MetaWear", device=Device("MetaWear"), preamble=1, names=(*NAMES, *others), unit="g"
    )


VENDOR = Vendor("metawear", recognise, describe)
