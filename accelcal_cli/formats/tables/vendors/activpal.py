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
from accelcal_cli.formats.tables.vendors import Doubt, Head, Stated, Vendor

NUMBER = re.compile(r".*(?:index|sample).*")
"""The column of the number of a sample."""

LARGEST_8_BITS = 255
EIGHT_BITS, TEN_BITS = (63.0, 127, 2.0), (127.375, 513, 4.0)
"""Counts in one g, the count of 0 g (of 10 bits it is 513.5), and the range in g."""

COMPRESSED = Doubt(
    "it is compressed: samples that repeat the one before were left out",
    "export the uncompressed csv; or give --unit counts and --lsb-per-g to read it anyway, with gaps",
)


def recognise(head: Head) -> bool:
    """Return True if the columns are a time, the number of a sample, and X, Y and Z, written so."""
    upper = {"X", "Y", "Z"} <= {name.strip(' "') for name in head.names}
    return upper and head.numbers("time", "x", "y", "z") is not None and _number(head) is not None


def _number(head: Head) -> int | None:
    """Return the column of the number of a sample."""
    return next((number for number, name in enumerate(head.plain) if NUMBER.fullmatch(name)), None)


def describe(head: Head) -> Stated:
    """Return scale and range by the largest of the first values, and whether samples are left out."""
    axes = head.numbers("x", "y", "z") or ()
    ten_bits = any(_whole(cell) > LARGEST_8_BITS for number in axes for cell in head.cells(number))
    lsb_per_g, zero, range_g = TEN_BITS if ten_bits else EIGHT_BITS
    numbers = [_whole(cell) for cell in head.cells(_number(head) or 0)]
    skips = any(after - before > 1 for before, after in pairwise(numbers))
    return Stated(
        title="activPAL",
        device=Device("activPAL4" if ten_bits else "activPAL3"),
        unit="counts",
        lsb_per_g=lsb_per_g,
        zero=zero,
        range_g=range_g,
        doubt=COMPRESSED if skips else None,
    )


def _whole(cell: str) -> int:
    cell = cell.strip('" ')
    return int(cell) if cell.isascii() and cell.isdigit() and len(cell) < 19 else 0


VENDOR = Vendor("activpal", recognise, describe, by_names=True)
