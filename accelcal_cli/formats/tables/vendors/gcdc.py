"""Gulf Coast Data Concepts: tables of the USB loggers X2, X6, X8, X16 and HAM, behind a head of settings.

Each line of the head is a comment: `;Title` with the model, `;Version` with the serial number, `;Start_time`,
and at its end the names of the columns. Rows are seconds since the start, and counts. HAM loggers state how
many are one g, in `;Accel`; for the others it depends on the model, the firmware and the gain (files of an
X16-1c of 2012, an X16-mini of 2017 and a HAM-IMU of 2022 in public repositories).
"""

from __future__ import annotations

import re

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.recording import Device
from accelcal_cli.formats.tables.vendors import Lines, Start, Stated, Vendor

TITLE = re.compile(r"\W*Title\s*,[^,]*gcdataconcepts[^,]*,\s*([^,]+)", re.IGNORECASE)
VERSION = re.compile(r"\W*Version\s*,\s*([^,\s]+)", re.IGNORECASE)
SERIAL = re.compile(r"\bSN:\s*([^,\s]+)", re.IGNORECASE)
START = re.compile(
    r"\W*Start_time\s*,\s*(\d{4}-\d\d-\d\d)\s*,\s*([01]\d|2[0-3]):([0-5]\d):([0-5]\d)(\.\d{1,6})?",
    re.IGNORECASE,
)
SENSITIVITY = re.compile(r"\W*Accel\s*,\s*[\d.]+\s*,\s*([1-9]\d{0,5})\s*,\s*[\d.]+\s*,\s*g\b", re.IGNORECASE)
HEADER_LINES = 30


def recognise(head: Lines) -> bool:
    """Return True if the first line names the maker."""
    return TITLE.match(head[0]) is not None


def describe(head: Lines) -> Stated:
    """Return the device, and the start that seconds in the first column count from."""
    model, version, serial = (_first(pattern, head) for pattern in (TITLE, VERSION, SERIAL))
    start = next(filter(None, map(_start, enumerate(head[:HEADER_LINES], 1))), None)
    device = Device(f"Gulf Coast Data Concepts {model}", serial, version)
    per_g = _first(SENSITIVITY, head)
    return Stated(
        title="Gulf Coast Data Concepts",
        device=device,
        start=start,
        counts_from_zero=start is not None,
        unit=None if per_g is None else "counts",
        lsb_per_g=None if per_g is None else float(per_g),
    )


def _first(pattern: re.Pattern[str], head: Lines) -> str | None:
    found = next(filter(None, map(pattern.search, head[:HEADER_LINES])), None)
    return None if found is None else found[1].strip()


def _start(numbered: tuple[int, str]) -> Start | None:
    number, line = numbered
    found = START.match(line)
    if found is None:
        return None
    seconds = int(found[2]) * 3600 + int(found[3]) * 60 + int(found[4])
    return Start(seconds * MICROSECONDS + round(float(found[5] or 0) * MICROSECONDS), found[1], number)


VENDOR = Vendor("gcdc", recognise, describe)
