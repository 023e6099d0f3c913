"""info.txt: what the device's software wrote about a recording, one "key: value" a line.

Source: github.com/actigraph/GT3X-File-Format and NHANES-GT3X-File-Format, info.txt.md. Times are
.NET ticks, 100 ns since the year 1, on the device's clock.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isfinite

from accelcal_cli.core.recording import Device

TICKS_PER_US = 10
YEAR_1_TO_1970_US = 62_135_596_800 * 1_000_000
LATEST_US = (1 << 32) * 1_000_000
HIGHEST_RATE_HZ = 1000


@dataclass(frozen=True, slots=True)
class Info:
    """What info.txt says; None where it does not.

    Attributes:
        start_us, last_us: first and last sample, or planned start and stop, local time.
        scale: counts in one g.
        zone: offset of the local time from UTC, such as -05:00.
    """

    device: Device = field(default_factory=Device)
    rate_hz: int | None = None
    start_us: int | None = None
    last_us: int | None = None
    scale: float | None = None
    range_g: float | None = None
    zone: str | None = None


def parse_info(data: bytes) -> Info:
    """Read the bytes of info.txt; unusable values are taken for missing."""
    text = data.decode("utf-8-sig", "replace")
    pairs = [line.partition(":") for line in text.splitlines()]
    values = {key.strip(): value.strip() for key, _, value in pairs if value.strip()}
    low, high = _number(values.get("Acceleration Min")), _number(values.get("Acceleration Max"))
    rate = _number(values.get("Sample Rate"))
    return Info(
        Device(values.get("Device Type"), values.get("Serial Number"), values.get("Firmware")),
        int(rate) if rate and rate == int(rate) and 0 < rate <= HIGHEST_RATE_HZ else None,
        _time_us(values.get("Start Date")),
        _time_us(values.get("Last Sample Time")) or _time_us(values.get("Stop Date")),
        _positive(_number(values.get("Acceleration Scale"))),
        None if low is None or high is None else _positive(min(-low, high)),
        _zone(values.get("TimeZone")),
    )


def _number(text: str | None) -> float | None:
    """A number, with a decimal comma in some countries."""
    try:
        value = float((text or "").replace(",", "."))
    except ValueError:
        return None
    return value if isfinite(value) else None


def _positive(value: float | None) -> float | None:
    return value if value is not None and value > 0 else None


def _time_us(text: str | None) -> int | None:
    """Microseconds since 1970 of ticks; None where it is no time of our days."""
    if text is None or not text.isascii() or not text.isdigit():
        return None
    time_us = int(text[:30]) // TICKS_PER_US - YEAR_1_TO_1970_US
    return time_us if 0 < time_us < LATEST_US else None


def _zone(text: str | None) -> str | None:
    """-05:00:00 as -05:00, 02:00:00 as +02:00."""
    parts = (text or "").lstrip("+-").split(":")
    if len(parts) != 3 or not all(part.isdigit() and len(part) == 2 for part in parts):
        return None
    return f"{'-' if text and text.startswith('-') else '+'}{parts[0]}:{parts[1]}"
