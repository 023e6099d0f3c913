"""Writes small GENEActiv .bin files line by line from the vendor's description, without the package."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from tests.formats.expected import Expected

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
START_US = 1_709_510_400_500_000
"""2024-03-04 00:00:00.5."""

SERIAL = "012345"
HEADER = """\
Device Identity
Device Unique Serial Code:{serial}
Device Type:GENEActiv
Device Model:1.1
Device Firmware Version:Ver4.08a date14Jul14
Calibration Date:2019-02-04 13:49:24:000

Device Capabilities
Accelerometer Range:{range}
Accelerometer Resolution:0.0039
Accelerometer Units:g
Light Meter Range:0 to 5000
Light Meter Resolution:5
Light Meter Units:lux
Temperature Sensor Range:0 to 70
Temperature Sensor Resolution:0.1
Temperature Sensor Units:deg. C

Configuration Info
Measurement Frequency:{rate} Hz
Measurement Period:360 Hours
Start Time:{start}
Time Zone:{zone}

Trial Info
Study Centre:centre
Study Code:1
Investigator ID:\0\0\0\0
Exercise Type:
Config Operator ID:
Config Time:{configured}
Config Notes:{notes}
Extract Operator ID:
Extract Time:2024-3-9 12:00:00:000
Extract Notes:{extract}

Subject Info
Device Location Code:left wrist
Subject Code:7
Date of Birth:1900-1-1
Sex:
Height:
Weight:
Handedness Code:
Subject Notes:\0\0\0\0

Calibration Data
x gain:{gain[0]}
x offset:{offset[0]}
y gain:{gain[1]}
y offset:{offset[1]}
z gain:{gain[2]}
z offset:{offset[2]}
Volts:300
Lux:800

Memory Status
Number of Pages:{pages}

"""
DEFAULTS = {
    "serial": SERIAL,
    "range": "-8 to 8",
    "rate": "50",
    "start": "2024-03-04 00:00:00:000",
    "zone": "GMT +01:00",
    "configured": "2024-03-03 10:00:00:000",
    "notes": "",
    "extract": "",
    "gain": (25600, 25600, 25600),
    "offset": (0, 0, 0),
    "pages": 4,
}


def header(**told: object) -> bytes:
    return HEADER.format(**(DEFAULTS | told)).encode("ascii")


def stamp(time_us: int) -> str:
    moment = EPOCH + timedelta(microseconds=time_us)
    return f"{moment:%Y-%m-%d %H:%M:%S}:{moment.microsecond // 1000:03d}"


def digits(rows: np.ndarray, light: int = 200, button: int = 0) -> str:
    """Twelve hexadecimal digits a sample: x, y, z, light and button."""
    rest = f"{light << 2 | button << 1:03X}"
    return "".join(
        f"{x:03X}{y:03X}{z:03X}{rest}" for x, y, z in (np.asarray(rows, np.int64) & 0xFFF).tolist()
    )


@dataclass(frozen=True)
class Page:
    """One page; `body` goes before the digits of `rows`."""

    rows: np.ndarray
    sequence: int
    time_us: int = START_US
    serial: str = SERIAL
    temperature: str = "25.3"
    battery: str = "4.1642"
    rate: str = "50.0"
    body: str | None = None
    time: str | None = None

    def to_bytes(self) -> bytes:
        lines = (
            "Recorded Data",
            f"Device Unique Serial Code:{self.serial}",
            f"Sequence Number:{self.sequence}",
            f"Page Time:{self.time or stamp(self.time_us)}",
            "Unassigned:",
            f"Temperature:{self.temperature}",
            f"Battery voltage:{self.battery}",
            "Device Status:Recording",
            f"Measurement Frequency:{self.rate}",
            digits(self.rows) if self.body is None else self.body,
        )
        return "".join(line + "\n" for line in lines).encode("ascii")


def pages(counts: np.ndarray, rate_hz: float = 50.0, **told: object) -> list[Page]:
    if len(counts) % 300:
        raise ValueError("pages have 300 samples")
    told = {"rate": f"{rate_hz:.1f}"} | told
    begins = range(0, len(counts), 300)
    span_us = round(300e6 / rate_hz)
    return [
        replace(Page(counts[at : at + 300], k, START_US + k * span_us), **told) for k, at in enumerate(begins)
    ]


def written(path: Path, content: list[Page], head: bytes | None = None, ending: bytes = b"\r\n") -> Path:
    head = header(pages=len(content)) if head is None else head
    text = head + b"".join(page.to_bytes() for page in content)
    path.write_bytes(text.replace(b"\n", ending))
    return path


def make(folder: Path, counts: np.ndarray, rate_hz: float, lsb_per_g: float) -> Expected:
    """A file of full pages with equal gains and no offsets.

    Raises:
        ValueError: the counts do not fill pages, or need more than 12 bits.
    """
    if counts.min() < -2048 or counts.max() > 2047:
        raise ValueError("raw values have 12 bits")
    gain = round(100 * lsb_per_g)
    head = header(rate=f"{rate_hz:g}", gain=(gain,) * 3, pages=len(counts) // 300)
    path = written(folder / "hand.bin", pages(counts, rate_hz), head)
    times = START_US + np.array([round(k * 1e6 / rate_hz) for k in range(len(counts))], np.int64)
    return Expected(path, counts / lsb_per_g, rate_hz, times, serial=SERIAL)
