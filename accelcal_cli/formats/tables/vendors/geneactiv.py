"""GENEActiv: the CSV of its PC software, behind a header of 100 lines of `key,value`.

Rows are time, x, y, z in calibrated g, light, button and temperature, without names. Times are
written `2024-03-04 12:34:56:789` (Activinsights, "GENEActiv Instructions", data file formats).
"""

from __future__ import annotations

import re

from accelcal_cli.core.recording import Device
from accelcal_cli.core.written_times import header_zone, stated_zone
from accelcal_cli.formats.tables.vendors import Doubt, Lines, Stated, Vendor

FIRST = re.compile(r"\W*Device Type[^\S\t]*([,;\t])\s*GENEActiv", re.IGNORECASE)
ROW = re.compile(r'"?\d{4}-\d\d-\d\d[ T]\d\d:\d\d:\d\d')
RANGE = re.compile(r"-(\d{1,3}(?:\.\d{1,3})?) to (\d{1,3}(?:\.\d{1,3})?)$")
RATE = re.compile(r"(\d{1,4}(?:[.,]\d{1,4})?)\s*Hz$")

COLUMNS = ("time", "x", "y", "z", "light [lux]", "button", "temperature")
SUMMARY_COLUMNS = 12
"""Columns of a table of epochs."""

SUMMARY = Doubt(
    "it holds means and sums over epochs, not raw acceleration",
    "export the raw data; or give --columns and --unit to read it anyway",
)


def recognise(head: Lines) -> bool:
    """Return True if the first line names the device."""
    return FIRST.match(head[0]) is not None


def describe(head: Lines) -> Stated:
    """Return what the header says."""
    match = FIRST.match(head[0])
    delimiter = match[1] if match else ","
    header = _pairs(head, delimiter)
    first_row = next((number for number, line in enumerate(head) if ROW.match(line)), len(head))
    columns = head[first_row].count(delimiter) + 1 if first_row < len(head) else 0
    limits = RANGE.match(header.get("Range", ""))
    named = head[first_row - 1].count(delimiter) + 1 == columns > 2
    return Stated(
        title="GENEActiv",
        device=Device(
            f"GENEActiv {header.get('Device Model', '')}".strip(),
            header.get("Device Unique Serial Code") or None,
            header.get("Device Firmware Version") or None,
        ),
        preamble=first_row - named,
        names=COLUMNS if columns == len(COLUMNS) else None,
        unit="g" if header.get("Units", "g") == "g" else None,
        rate_hz=_number(RATE.match(header.get("Measurement Frequency", ""))),
        timezone=stated_zone(header.get("Time Zone", "")),
        range_g=_number(limits) if limits and limits[1] == limits[2] else None,
        notes=header_zone(header.get("Time Zone", ""))[1],
        doubt=SUMMARY if columns == SUMMARY_COLUMNS else None,
    )


def _pairs(head: Lines, delimiter: str) -> dict[str, str]:
    """Return the first value of every key; the first of three sensors with a range is the accelerometer."""
    header: dict[str, str] = {}
    for line in head:
        if ROW.match(line):
            break
        key, _, value = line.partition(delimiter)
        header.setdefault(key.strip().strip('"'), value.strip(' "\t,;'))
    return header


def _number(match: re.Match[str] | None) -> float | None:
    number = 0.0 if match is None else float(match[1].replace(",", "."))
    return number if number > 0 else None


VENDOR = Vendor("geneactiv", recognise, describe)
