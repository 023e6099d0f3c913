"""EDF and EDF+ (16 bits), BDF and BDF+ (24 bits), of polysomnographs: how they are recognised.

The header is text of fixed width (Kemp and others 1992; Kemp and Olivan 2003; www.edfplus.info/specs).
"""

from __future__ import annotations

import re

from accelcal_cli.core.formats import ONLY_TABLES, TIMES_OF_TABLES, Format, Probe

EDF_MAGIC = b"0       "
BDF_MAGIC = b"\xffBIOSEMI"
START = re.compile(
    rb"[\dX]{2}\.[\dX]{2}\.[\dXy]{2}[\dX]{2}\.[\dX]{2}\.[\dX]{2}[ \d]{8}", re.ASCII | re.IGNORECASE
)
START_AT = 168


def sniff(probe: Probe) -> int:
    """Return 100 for BDF's signature, or for EDF's with a date, a time and a length after it."""
    if probe.head.startswith(BDF_MAGIC):
        return 100
    return 100 if probe.head.startswith(EDF_MAGIC) and START.match(probe.head, START_AT) else 0


FORMAT = Format(
    "edf",
    "EDF, EDF+, BDF or BDF+ with signals of an accelerometer",
    (".edf", ".bdf", ".rec"),
    sniff,
    reader="accelcal_cli.formats.edf.reader:open_recording",
    ignores=(*TIMES_OF_TABLES, "layout", *ONLY_TABLES),
)
