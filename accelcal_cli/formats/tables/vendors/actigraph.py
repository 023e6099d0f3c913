"""ActiGraph: raw CSV as ActiLife and its imitators write it, behind a header of ten lines; Verisense too.

The first line states the model, the firmware, how dates are written, and the rate; the others the
serial number and the start. Rows are x, y, z in g, with or without a time stamp before them, with or
without a line of names. While it sleeps, the device repeats its last sample at the usual rate, or
writes zeros (ActiGraph, "Idle Sleep Mode Explained"; github.com/actigraph/agcounts, issue 19).

Shimmer's Verisense has the same header with its own name in place of ActiGraph's, and rates that are not
whole number (github.com/wadpac/GGIR, `g.inspectfile` and `g.extractheadervars`); it has no idle sleep.

The table of a GT9X's second sensor has gyroscope, temperature and magnetometer as well, `Gyroscope X` in
deg/s (R package AGread, `read_IMU`).
"""

from __future__ import annotations

import re

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.recording import Device
from accelcal_cli.core.written_times import ORDERS, order_in, read_date
from accelcal_cli.formats.tables.vendors import Doubt, Lines, Start, Stated, Vendor

HEADER_LINES = 15
FASTEST_HZ = 1000.0

FIRST = re.compile(r"Data\s+(?:Table\s+)?File\s+Created\s+By\s+(ActiGraph|Verisense)\s+(\S+)", re.I)
RATE = re.compile(r"\bat\s*(\d{1,4}(?:[.,]\d{1,9})?)\s*Hz", re.IGNORECASE)
FIRMWARE = re.compile(r"Firmware\s+v?(\S+)")
DATES = re.compile(r"date\s+format\s+(\S.{3,24}?\S)\s+(?:at\s*\d|Filter|-{3})", re.IGNORECASE)
KEY = re.compile(r"\W*(?:(?:Serial|Start|Epoch|Window|Cycle|Download|Current)\b|-{5,})")
CLOCK = re.compile(r"(\d{1,2})[:.](\d\d)[:.](\d\d)\s*([AP]M)?", re.IGNORECASE)


def recognise(head: Lines) -> bool:
    """Return True if the first line says that ActiLife or Verisense made the file."""
    return FIRST.search(head[0]) is not None


def describe(head: Lines) -> Stated:
    """Return what the header says; ActiLife writes raw acceleration in g."""
    first = head[0]
    made_by = FIRST.search(first)
    verisense = made_by is not None and made_by[1].lower() == "verisense"
    maker, model = "Verisense" if verisense else "ActiGraph", made_by[2].rstrip(",;") if made_by else ""
    firmware, dates, rate = (_group(pattern, first) for pattern in (FIRMWARE, DATES, RATE))
    rate_hz = 0.0 if rate is None else float(rate.replace(",", "."))
    lines = max((number for number, line in enumerate(head[:HEADER_LINES]) if KEY.match(line)), default=0) + 1
    while lines < len(head) and not head[lines].strip():  # blank ones that some programs write behind it
        lines += 1
    return Stated(
        title=maker,
        device=Device(f"{maker} {model}", _value(head, "Serial Number:?"), firmware),
        preamble=lines,
        unit="g",
        rate_hz=rate_hz if 0 < rate_hz <= FASTEST_HZ else None,
        start=_start(head),
        date_order=None if dates is None else order_in(dates),
        repeats_idle=not verisense,
        doubt=_doubt(head, maker),
        gyro_unit=None if verisense else "deg/s",
    )


def _group(pattern: re.Pattern[str], line: str) -> str | None:
    match = pattern.search(line)
    return None if match is None else match[1].rstrip(",;")


def _value(head: Lines, key: str) -> str | None:
    """Return the value behind a key; tables saved by a spreadsheet have delimiters after it."""
    pattern = re.compile(rf"\W*{key}\s*([^,;\t]+(?:, ?\d{{4}}\b)?)")
    match = next((match for line in head[1:HEADER_LINES] if (match := pattern.match(line))), None)
    return None if match is None else match[1].strip().strip('"') or None


def _seconds(text: str | None) -> int | None:
    """Return the seconds in `10:54:00` or `10:54:00 PM`."""
    match = CLOCK.match(text or "")
    if match is None:
        return None
    hour, minute, second = (int(match[part]) for part in (1, 2, 3))
    if match[4]:
        hour = hour % 12 + (12 if match[4].upper() == "PM" else 0)
    return hour * 3600 + minute * 60 + second if max(hour - 23, minute - 59, second - 59) <= 0 else None


def _start(head: Lines) -> Start | None:
    seconds, day = _seconds(_value(head, "Start Time")), _value(head, "Start Date")
    if seconds is None or day is None or not any(read_date(day, order) for order in ORDERS):
        return None
    line = next(number for number, text in enumerate(head, 1) if "Start Date" in text)
    return Start(seconds * MICROSECONDS, day, line)


def _doubt(head: Lines, maker: str) -> Doubt | None:
    """Return the doubt about tables of counts, which have an epoch; that of raw data has no length."""
    match = CLOCK.match(_value(head, r"(?:Epoch|Window|Cycle) \w+ \(hh:mm:ss\)") or "")
    epoch = 0 if match is None else int(match[1]) * 3600 + int(match[2]) * 60 + int(match[3])
    if not epoch:
        return None
    source = " from ActiLife" if maker == "ActiGraph" else ""
    return Doubt(
        f"it holds counts of {epoch} s each, not raw acceleration",
        f"export the raw data{source}; or give --unit to read it anyway",
        epochs=True,
    )


VENDOR = Vendor("actigraph", recognise, describe)
