"""The text before the first page of a GENEActiv .bin file: who recorded, and the factory's calibration.

It has 59 lines of `key:value` in sections; notes of several lines make it longer. The factory's gain and
offset of each axis give g = (raw * 100 - offset) / gain; all three axes are put on one grid of whole
counts, slope * raw - shift with one number of counts per g. The counts are exact where that takes no more
than 2**24 counts per g, as with equal gains; else the values are rounded to a grid of 1 / 2**24 g, 0.03
micro-g at most. Source: Activinsights, GENEActiv instructions, "Understanding .bin files".
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import gcd, lcm

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import WIDEST_OFFSET_H
from accelcal_cli.core.recording import FLOAT_LSB_PER_G, Counts, Device
from accelcal_cli.formats.geneactiv import MARK
from accelcal_cli.formats.geneactiv.scan import number

RAW_VALUES = 1 << 12
RAW_LIMIT = RAW_VALUES // 2
"""Raw values are two's complement of 12 bits: -2048 to 2047."""

GAINS = (6_400, 102_400)
"""Hundredths of a count per g that are possible: ranges of 32 g down to 2 g over 12 bits."""

CALIBRATION = "Calibration Data"
RESET_DATE = "2010-09-16"
"""Where the clock of a device stands after its battery was empty; the header then has lost its times."""

NO_DEVICE = Device()
_PAGE_LINE = re.compile(
    rb"^(?:" + MARK + rb"[ \t]*\r?$|Sequence Number:|Page Time:|[0-9A-Fa-f]{256})", re.MULTILINE
)
"""A line of a page, whichever comes first: a damaged page must not pass for a part of the header."""

_RANGE = re.compile(r"-\s*(\d+(?:\.\d+)?)\s*to\s*(\d+(?:\.\d+)?)")
_DRIFT = re.compile(r"clock drift (-?\d+(?:\.\d+)?) ?s")
_WHOLE = re.compile(r"-?\d{1,9}")
_ZONE = re.compile(r"GMT\s*([+-]\d{2}:[0-5]\d)")
AXES = "xyz"


@dataclass(frozen=True, slots=True)
class Factory:
    """The header's calibration block, x y z: g = (raw * 100 - offset) / gain."""

    gain: tuple[int, int, int]
    offset: tuple[int, int, int]

    @property
    def possible(self) -> bool:
        """Whether gains are those of a wrist-worn sensor and offsets below 1 g."""
        return all(
            GAINS[0] <= gain <= GAINS[1] and abs(offset) <= gain
            for gain, offset in zip(self.gain, self.offset, strict=True)
        )


@dataclass(frozen=True, slots=True, eq=False)
class Scale:
    """From raw values to counts.

    Attributes:
        lsb_per_g: counts in one g, of every axis.
        table: (3, 4096) counts of x, y, z by the raw value's 12 bits; int16 where they fit, else int32.
        exact: whether counts / lsb_per_g is what the factory's formula gives, without rounding.
        plain: whether counts are the raw values themselves.
    """

    lsb_per_g: float
    table: Counts
    exact: bool
    plain: bool

    @property
    def clipped(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Counts of each axis, (3,), at the low and at the high end of what the sensor can tell."""
        return self.table[:, RAW_LIMIT].astype(np.int64), self.table[:, RAW_LIMIT - 1].astype(np.int64)


def raw_scale(lsb_per_g: float) -> Scale:
    """Raw values as they are, for a scale that the user gives."""
    return _scale(lsb_per_g, _linear((1, 1, 1), (0, 0, 0)), exact=True)


def factory_scale(factory: Factory) -> Scale:
    """The factory's formula on the coarsest grid that holds it exactly, or on 2**24 counts per g."""
    slopes = [Fraction(100, gain) for gain in factory.gain]
    shifts = [Fraction(offset, gain) for offset, gain in zip(factory.offset, factory.gain, strict=True)]
    grid = lcm(*(number.denominator for number in slopes + shifts))
    whole = [int(number * grid) for number in slopes + shifts]
    common = gcd(*whole)
    lsb_per_g = Fraction(grid, common)
    if lsb_per_g > FLOAT_LSB_PER_G:
        return _scale(FLOAT_LSB_PER_G, _rounded(factory), exact=False)
    reduced = [number // common for number in whole]
    return _scale(float(lsb_per_g), _linear(reduced[:3], reduced[3:]), exact=True)


def _raw_values() -> NDArray[np.int64]:
    """The raw value of each pattern of 12 bits, (4096,)."""
    bits = np.arange(RAW_VALUES, dtype=np.int64)
    return np.where(bits < RAW_LIMIT, bits, bits - RAW_VALUES)


def _linear(slope: Sequence[int], shift: Sequence[int]) -> NDArray[np.int64]:
    """slope * raw - shift of each axis, (3, 4096)."""
    return _raw_values() * np.array(slope, np.int64)[:, None] - np.array(shift, np.int64)[:, None]


def _rounded(factory: Factory) -> NDArray[np.int64]:
    """Counts of 1 / 2**24 g, (3, 4096), rounded to the nearest; gains below 2**24 leave no halves."""
    gain = np.array(factory.gain, np.int64)[:, None]
    counts = _linear((100, 100, 100), factory.offset) * int(FLOAT_LSB_PER_G)
    return np.asarray((2 * counts + gain) // (2 * gain))


def _scale(lsb_per_g: float, table: NDArray[np.int64], *, exact: bool) -> Scale:
    narrow = np.abs(table).max() <= np.iinfo(np.int16).max
    stored: Counts = table.astype(np.int16) if narrow else table.astype(np.int32)
    return Scale(lsb_per_g, stored, exact, plain=bool((table == _raw_values()).all()))


@dataclass(frozen=True, slots=True)
class Header:
    """What the header says; None if it does not.

    Attributes:
        data_start: where the first page lies, bytes.
        rate: the configured one [Hz].
        range_g: the sensor's, +-.
        timezone: of the device's clock, `UTC` or such as `+01:00`.
        factory: the calibration block.
        pages: how many it announces.
        reset: its times are those of a device that was reset.
        drift_s: what it notes of the device's clock at the download.
        missing: what it should say but does not, in plain words.
    """

    data_start: int
    device: Device = NO_DEVICE
    rate: Fraction | None = None
    range_g: float | None = None
    timezone: str | None = None
    factory: Factory | None = None
    pages: int | None = None
    reset: bool = False
    drift_s: str | None = None
    missing: tuple[str, ...] = ()


def parse_header(head: bytes) -> Header:
    """Read the header.

    Args:
        head: the file's first bytes.
    """
    match = _PAGE_LINE.search(head)
    end = match.start() if match else 0
    text = head[:end].decode("ascii", "replace")
    about, measured = _values(text), _values(text.rpartition(CALIBRATION)[2])
    factory = _factory(measured)
    rate = number(about.get("Measurement Frequency", "").encode("ascii", "replace"))
    range_g = _range_g(about.get("Accelerometer Range", ""))
    serial = about.get("Device Unique Serial Code")
    needed = {
        "serial number": serial,
        "measurement frequency": rate,
        "range": range_g,
        "calibration": factory,
    }
    return Header(
        data_start=end,
        device=_device(about, serial),
        rate=rate,
        range_g=range_g,
        timezone=_zone(about.get("Time Zone", "")),
        factory=factory,
        pages=_whole(measured.get("Number of Pages", "")),
        reset=any(about.get(key, "").startswith(RESET_DATE) for key in ("Config Time", "Start Time")),
        drift_s=_first(_DRIFT, about.get("Extract Notes", "")),
        missing=tuple(name for name, value in needed.items() if value is None),
    )


def _values(text: str) -> dict[str, str]:
    """Values by their keys, the first of each; empty ones are left out."""
    values: dict[str, str] = {}
    for line in text.splitlines():
        key, _, value = line.partition(":")
        shown = "".join(letter for letter in value if letter.isprintable()).strip()
        if shown:
            values.setdefault(key.strip(), shown)
    return values


def _device(about: dict[str, str], serial: str | None) -> Device:
    model = " ".join(about[key] for key in ("Device Type", "Device Model") if key in about)
    return Device(model or None, serial, about.get("Device Firmware Version"))


def _factory(measured: dict[str, str]) -> Factory | None:
    """The calibration block, None if a number is missing or impossible."""
    gains = [_whole(measured.get(f"{axis} gain", "")) for axis in AXES]
    offsets = [_whole(measured.get(f"{axis} offset", "")) for axis in AXES]
    known = [value for value in gains + offsets if value is not None]
    if len(known) < 2 * len(AXES):
        return None
    factory = Factory((known[0], known[1], known[2]), (known[3], known[4], known[5]))
    return factory if factory.possible else None


def _whole(text: str) -> int | None:
    return int(text) if _WHOLE.fullmatch(text) else None


def _first(pattern: re.Pattern[str], text: str) -> str | None:
    match = pattern.search(text)
    return match[1] if match else None


def _range_g(text: str) -> float | None:
    """The range of `-8 to 8`; None if it is not symmetric."""
    match = _RANGE.search(text)
    return float(match[2]) if match and float(match[1]) == float(match[2]) > 0 else None


def _zone(text: str) -> str | None:
    """The zone of `GMT +01:00`; None if the text is not one."""
    match = _ZONE.fullmatch(text)
    if match is None or int(match[1][1:3]) > WIDEST_OFFSET_H:
        return None
    return "UTC" if match[1][1:] == "00:00" else match[1]
