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

COLUMNS = ("time", "x", "y", "z", "light", "button", "temperature")
SUMMARY_COLUMNS = 12
"""Columns of a table of epochs."""


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
    named = head[first_row - 1].count(delimiter) + 1 == columns > 2
    return Stated(
        title="GENEActiv",
        device=_device(header),
        preamble=first_row - named,
        names=COLUMNS if columns == len(COLUMNS) else None,
        unit="g" if header.get("Units", "g") == "g" else None,
        rate_hz=_number(RATE.match(header.get("Measurement Frequency", ""))),
        timezone=stated_zone(header.get("Time Zone", "")),
        range_g=_range(header.get("Range", "")),
        notes=header_zone(header.get("Time Zone", ""))[1],
        doubt=_doubt(columns),
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


def _device(header: dict[str, str]) -> Device:
    model = f"GENEActiv {header.get('Device Model', '')}".strip()
    serial, firmware = header.get("Device Unique Serial Code"), header.get("Device Firmware Version")
    return Device(model, serial or None, firmware or None)


def _number(match: re.Match[str] | None) -> float | None:
    number = 0.0 if match is None else float(match[1].replace(",", "."))
    return number if number > 0 else None


def _range(text: str) -> float | None:
    match = RANGE.match(text)
    return _number(match) if match and match[1] == match[2] else None


def _doubt(columns: int) -> Doubt | None:
    if columns != SUMMARY_COLUMNS:
        return None
    return Doubt(
        "it holds means and sums over epochs, not raw acceleration",
        "export the raw data; or give --columns and --unit to read it anyway",
    )


VENDOR = Vendor("geneactiv", recognise, describe)
