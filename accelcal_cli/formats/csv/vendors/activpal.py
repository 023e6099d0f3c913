"""activPAL: raw acceleration as its PC software exports it, in counts above zero between semicolons.

Columns are the time in days as spreadsheets count them, the number of the sample, and at the end X, Y and
Z; a line `sep=;` may stand before them. Samples that repeat the one before are left out of a compressed
export, and their numbers skipped (kb.palt.com, "Compressed acceleration data csv"). An activPAL3 measures
+-2 g in 8 bits, 1 to 253; an activPAL4 +-4 g in 10 bits, 4 to 1023 (github.com/Ergo-Tools/ActiPASS,
`readActivPALcsv.m`).
"""

from __future__ import annotations

import re
from itertools import pairwise

from accelcal_cli.core.recording import Device
from accelcal_cli.formats.csv.vendors import Doubt, ExportDescription, Head, Vendor

NAMES = re.compile(
    r'"?Time"?([;,])"?[^;,"]*(?:index|sample)[^;,"]*"?\1(?:.*\1)?"?X"?\1"?Y"?\1"?Z"?\W*', re.IGNORECASE
)
LARGEST_8_BITS = 255
EIGHT_BITS, TEN_BITS = (63.0, 127, 2.0), (127.375, 513, 4.0)
"""Counts in one g, the count of 0 g (of 10 bits it is 513.5), and the range in g."""

COMPRESSED = Doubt(
    "it is compressed: samples that repeat the one before were left out",
    "export the uncompressed csv; or give --unit counts and --lsb-per-g to read it anyway, with gaps",
)


def recognise(head: Head) -> bool:
    """Return True if a line of names stands at the beginning."""
    return _names(head) is not None


def _names(head: Head) -> int | None:
    """Return the line of the names, from 0."""
    return next((number for number, line in enumerate(head[:3]) if NAMES.fullmatch(line)), None)


def describe(head: Head) -> ExportDescription:
    """Return scale and range by the largest of the first values, and whether samples are left out."""
    names = _names(head) or 0
    match = NAMES.fullmatch(head[names])
    rows = [line.split(match[1]) for line in head[names + 1 : -1]] if match else []
    ten_bits = any(_whole(cell) > LARGEST_8_BITS for row in rows for cell in row[-3:])
    lsb_per_g, zero, range_g = TEN_BITS if ten_bits else EIGHT_BITS
    numbers = [_whole(row[1]) for row in rows if len(row) > 1]
    skips = any(after - before > 1 for before, after in pairwise(numbers))
    return ExportDescription(
        title="activPAL",
        device=Device("activPAL4" if ten_bits else "activPAL3"),
        preamble=names,
        unit="counts",
        lsb_per_g=lsb_per_g,
        zero=zero,
        range_g=range_g,
        doubt=COMPRESSED if skips else None,
    )


def _whole(cell: str) -> int:
    cell = cell.strip('" ')
    return int(cell) if cell.isascii() and cell.isdigit() and len(cell) < 19 else 0


VENDOR = Vendor("activpal", recognise, describe)
