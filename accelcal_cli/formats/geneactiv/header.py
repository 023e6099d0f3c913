"""The text before the first page of a GENEActiv .bin file: who recorded, with which settings.

It has 59 lines of `key:value` in sections; notes of several lines make it longer. Source: Activinsights,
GENEActiv instructions, "Understanding .bin files".
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction

from accelcal_cli.core.clock import WIDEST_OFFSET_H
from accelcal_cli.core.recording import Device
from accelcal_cli.formats.geneactiv import MARK
from accelcal_cli.formats.geneactiv.decode import Factory, factory_of, whole_number
from accelcal_cli.formats.geneactiv.scan import number

CALIBRATION = "Calibration Data"
RESET_DATE = "2010-09-16"
"""Where the clock of a device stands after its battery was empty; the header then has lost its times."""

NO_DEVICE = Device()
_PAGE_LINE = re.compile(
    MARK + rb"[ \t]*(?:[\r\n]|\Z)|(?:^|(?<=\r))(?:Sequence Number:|Page Time:|[0-9A-Fa-f]{256})",
    re.MULTILINE,
)
"""What a page begins with, or a line of one, whichever comes first: a damaged page, even one whose lines
end in carriage returns alone, or before which the end of a line is lost, is no part of the header."""

_RANGE = re.compile(r"-\s*(\d+(?:\.\d+)?)\s*to\s*(\d+(?:\.\d+)?)")
_DRIFT = re.compile(r"clock drift (-?\d+(?:\.\d+)?) ?s")
_ZONE = re.compile(r"GMT\s*([+-]\d{2}:[0-5]\d)")


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
    factory = factory_of(measured)
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
        pages=whole_number(measured.get("Number of Pages", "")),
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
