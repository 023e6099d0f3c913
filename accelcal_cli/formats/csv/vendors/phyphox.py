"""phyphox: `Raw Data.csv` of its experiments on acceleration, with quoted names and exponents.

Columns are `"Time (s)","Acceleration x (m/s^2)",...`, from the start of the measurement, between commas,
semicolons or tabs, with points or commas as decimals; those of the experiment without gravity are called
`Linear Acceleration x (m/s^2)` (github.com/phyphox/phyphox-experiments, `accelerometer.phyphox` and
`linear_accelerometer.phyphox`).
"""

from __future__ import annotations

import re

from accelcal_cli.formats.csv.vendors import Doubt, ExportDescription, Head, Vendor

FIRST = re.compile(
    r'"?Time \(s\)"?[,;\t]"?(?P<linear>Linear )?Acceleration x \(m/s\^2\)"?[,;\t]'
    r'"?(?:Linear )?Acceleration y ',
    re.IGNORECASE,
)
LINEAR = Doubt(
    "it holds acceleration without gravity",
    'record the experiment "Acceleration (with g)"; or give --unit to read it anyway',
)


def recognise(head: Head) -> bool:
    """Return True if the columns have these names."""
    return FIRST.match(head[0]) is not None


def describe(head: Head) -> ExportDescription:
    """Return which of the two experiments it is; the names of the columns say the rest."""
    match = FIRST.match(head[0])
    doubt = LINEAR if match is not None and match["linear"] else None
    return ExportDescription(title="phyphox", doubt=doubt)


VENDOR = Vendor("phyphox", recognise, describe)
