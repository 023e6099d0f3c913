"""The 512-byte data sector of an Axivity .cwa file: its fields, settings and checksum.

Sources: the vendor's format document `Docs/ax3/cwa.h` and the notes beside it,
`Docs/ax3/ax3-technical.md` and `ax3-auxiliary.md` (github.com/digitalinteraction/openmovement).
All numbers are little-endian.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.readers._cwa.signature import SECTOR_MAGIC

SAMPLE_BYTES = 480
MAGIC = int.from_bytes(SECTOR_MAGIC, "little")

SECTOR = np.dtype(
    [
        ("magic", "<u4"),
        ("fraction", "<u2"),
        ("session", "<u4"),
        ("sequence", "<u4"),
        ("stamp", "<u4"),
        ("light", "<u2"),
        ("temperature", "<u2"),
        ("events", "u1"),
        ("battery", "u1"),
        ("rate", "u1"),
        ("axes", "u1"),
        ("offset", "<i2"),
        ("count", "<u2"),
        ("data", "u1", (SAMPLE_BYTES,)),
        ("checksum", "<u2"),
    ]
)
FIELDS = np.dtype([(name, "<u2") for name in ("low", "high")])
"""The two halves of a packed sample of 32 bits."""

Sectors = NDArray[Any]
"""(n,) of SECTOR."""

PACKED = 0x30
FULL_ROWS = {PACKED: 120, 0x32: 80, 0x62: 40, 0x92: 26}
"""Samples in a full sector, by the byte that tells axes and packing: packed x y z; 16-bit x y z;
gyroscope and accelerometer; gyroscope, accelerometer and magnetometer."""

OVERFLOW_EVENTS = 0x30
"""The sensor's (bit 4) or the firmware's (bit 5) buffer ran over: samples were lost."""

HIGHEST_RATE = 3200


@dataclass(frozen=True, slots=True)
class Settings:
    """How a sector was recorded.

    Attributes:
        rate_code: the byte that tells rate and range; 0 in the oldest files, which give the rate
            in `old_rate_hz` and carry no checksum.
        axes_code: a key of FULL_ROWS.
        scale_bits: unit of the accelerometer (upper three) and range of the gyroscope.
    """

    rate_code: int
    axes_code: int
    scale_bits: int
    old_rate_hz: int = 0

    @property
    def rate(self) -> Fraction:
        """Nominal samples per second."""
        return Fraction(self.old_rate_hz) if self.is_old else rate_of(self.rate_code)

    @property
    def is_old(self) -> bool:
        """Whether this is the oldest format, without checksums and fractions of seconds."""
        return self.rate_code == 0

    @property
    def range_g(self) -> float:
        """The accelerometer clips at +- this."""
        return float(16 >> (self.rate_code >> 6))

    @property
    def rows(self) -> int:
        """Samples in a full sector."""
        return FULL_ROWS[self.axes_code]

    @property
    def width(self) -> int:
        """16-bit numbers in one sample: 3, 6 or 9; 3 for packed samples too."""
        return self.axes_code >> 4

    @property
    def lsb_per_g(self) -> float:
        """Counts in one g; packed samples are always of 1/256 g."""
        return 256.0 if self.axes_code == PACKED else float(256 << (self.scale_bits >> 3))

    @property
    def gyro_dps_per_lsb(self) -> float | None:
        """deg/s in one count, None without a gyroscope or where its range is not told."""
        gyro_bits = self.scale_bits & 7
        return 8000 / (1 << gyro_bits) / 32768 if self.width > 3 and gyro_bits else None


def rate_of(code: int) -> Fraction:
    """Samples per second of a rate code: 3200 Hz for 15, half of it for each one less."""
    return Fraction(HIGHEST_RATE, 1 << (15 - (code & 15)))


def settings_of(sector: Any) -> Settings:
    """Settings of one sector (a scalar of SECTOR)."""
    code, axes = int(sector["rate"]), int(sector["axes"])
    old_rate = int(sector["offset"]) & 0xFFFF if code == 0 else 0
    return Settings(code, axes, scale_mask(axes) & (int(sector["light"]) >> 10), old_rate)


def scale_mask(axes_code: int) -> int:
    """Which of the six scale bits matter: the gyroscope's do only where there is one."""
    return 0x38 if axes_code >> 4 == 3 else 0x3F


def as_sectors(pages: NDArray[np.uint8]) -> Sectors:
    """The fields of sectors (n, 512), as a view."""
    return pages.reshape(-1).view(SECTOR)


def checksums(pages: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Sums of the 256 16-bit words of each sector (n, 512), modulo 65536; 0 where it is intact."""
    return np.asarray(pages.view("<u2").sum(axis=1, dtype=np.uint16))


def plausible(pages: NDArray[np.uint8]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which sectors can be believed without knowing the recording's settings: (n,) each.

    Returns:
        those that a checksum proves, and those of the oldest format, which has none.
    """
    sectors = as_sectors(pages)
    full = np.zeros(256, np.int64)
    full[list(FULL_ROWS)] = list(FULL_ROWS.values())
    usable = (
        (sectors["magic"] == MAGIC) & (sectors["count"] > 0) & (sectors["count"] <= full[sectors["axes"]])
    )
    old = sectors["rate"] == 0
    old_rate = sectors["offset"].view("<u2")
    proved = usable & ~old & (checksums(pages) == 0)
    return proved, usable & old & (old_rate > 0) & (old_rate <= HIGHEST_RATE)
