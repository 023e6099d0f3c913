"""The text before the first page of a GENEActiv .bin file: who recorded, and the factory's calibration.

It has 59 lines of `key:value` in sections; notes of several lines make it longer. Source:
Activinsights, GENEActiv instructions, "Understanding .bin files".
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction

from accelcal_cli.core.recording import Device
from accelcal_cli.core.zones import WIDEST_OFFSET_H
from accelcal_cli.readers._geneactiv.page import number
from accelcal_cli.readers._geneactiv.scale import Factory
from accelcal_cli.readers._geneactiv.signature import MARK

HEADER_LIMIT = 1 << 16
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
class Header:
    """What the header tells; None where it does not.

    Attributes:
        data_start: where the first page lies, bytes.
        rate: the configured one [Hz].
        range_g: the sensor's, +-.
        timezone: of the device's clock, `UTC` or such as `+01:00`.
        factory: the calibration block.
        pages: how many it announces.
        reset: its times are those of a device that was reset.
        drift_s: what it notes of the device's clock at the download.
        missing: what it should tell and does not, in plain words.
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
        head: the file's first HEADER_LIMIT bytes.
    """
    found = _PAGE_LINE.search(head)
    end = found.start() if found else 0
    text = head[:end].decode("ascii", "replace")
    about, measured = _values(text), _values(text.rpartition(CALIBRATION)[2])
    factory = _factory(measured)
    rate = number(about.get("Measurement Frequency", "").encode("ascii", "replace"))
    range_g = _range_g(about.get("Accelerometer Range", ""))
    serial = about.get("Device Unique Serial Code")
    told = {"serial number": serial, "measurement frequency": rate, "range": range_g, "calibration": factory}
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
        missing=tuple(name for name, value in told.items() if value is None),
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
    """The calibration block, None where a number is missing or impossible."""
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
    found = pattern.search(text)
    return found[1] if found else None


def _range_g(text: str) -> float | None:
    """The range of `-8 to 8`; None where it is not symmetric."""
    found = _RANGE.search(text)
    return float(found[2]) if found and float(found[1]) == float(found[2]) > 0 else None


def _zone(text: str) -> str | None:
    """The zone of `GMT +01:00`; None where it is not told so."""
    found = _ZONE.fullmatch(text)
    if found is None or int(found[1][1:3]) > WIDEST_OFFSET_H:
        return None
    return "UTC" if found[1][1:] == "00:00" else found[1]
