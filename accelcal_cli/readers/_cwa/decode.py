"""From sectors as they lie in the file to samples, a block of them at a time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.readers._cwa.sector import (
    FIELDS,
    FULL_ROWS,
    MAGIC,
    OVERFLOW_EVENTS,
    PACKED,
    Sectors,
    Settings,
    as_sectors,
    checksums,
    rate_of,
    scale_mask,
)
from accelcal_cli.readers._cwa.stamps import Anchors, anchors

GOOD, EMPTY, OTHER, FOREIGN, CHECKSUM, NONSENSE, RATE, SETTINGS = range(8)
"""What a sector is: OTHER is a kind without acceleration, FOREIGN no sector at all."""

KINDS_WITHOUT_SAMPLES = [int.from_bytes(name, "little") for name in (b"UB", b"SI", b"GY", b"GX")]
OVERFLOW_MASK = np.uint8(OVERFLOW_EVENTS)


@dataclass(frozen=True, slots=True, eq=False)
class SectorBlock:
    """Good sectors in file order, p of them with n samples in all.

    Attributes:
        position: (p,) int64, number of each sector in the file.
        rows: (p,) int64, samples in each, at least 1.
        sequence, session: (p,) int64.
        overflow: (p,) bool, the device lost samples before or in the sector.
        anchors: their times.
        counts: (n, 3) int16.
        temperature: (p,) uint16, raw words.
        gyro: (n, 3) int16, or None.
    """

    position: NDArray[np.int64]
    rows: NDArray[np.int64]
    sequence: NDArray[np.int64]
    session: NDArray[np.int64]
    overflow: NDArray[np.bool_]
    anchors: Anchors
    counts: NDArray[np.int16]
    temperature: NDArray[np.uint16]
    gyro: NDArray[np.int16] | None

    def __len__(self) -> int:
        return len(self.position)


def decode(
    pages: NDArray[np.uint8], first_position: int, settings: Settings
) -> tuple[SectorBlock, NDArray[np.uint8]]:
    """The good sectors of a block, and what every sector is.

    Args:
        pages: (n, 512).

    Returns:
        the good ones, and (n,) of GOOD and the other kinds.
    """
    sectors = as_sectors(pages)
    good = fitting(sectors, settings)
    if not settings.is_old:
        good &= checksums(pages) == 0
    status = np.full(len(pages), GOOD, np.uint8)
    position = np.arange(first_position, first_position + len(pages))
    if good.all():
        return unpack(sectors, position, settings), status
    status[~good] = classify(pages[~good], settings)
    return unpack(sectors[good], position[good], settings), status


def fitting(sectors: Sectors, settings: Settings) -> NDArray[np.bool_]:
    """Which sectors say that they hold samples recorded with these settings, (n,)."""
    fits = sectors["magic"] == MAGIC
    fits &= (sectors["rate"] == settings.rate_code) & (sectors["axes"] == settings.axes_code)
    scale = scale_mask(settings.axes_code) << 10
    fits &= (sectors["light"] & np.uint16(scale)) == settings.scale_bits << 10
    fits &= (sectors["count"] - np.uint16(1)) < settings.rows
    if settings.is_old:
        fits &= sectors["offset"].view("<u2") == settings.old_rate_hz
    return np.asarray(fits)


def classify(pages: NDArray[np.uint8], settings: Settings) -> NDArray[np.uint8]:
    """Why sectors (n, 512) are not good: (n,) of the kinds above."""
    sectors = as_sectors(pages)
    known = np.isin(sectors["axes"], list(FULL_ROWS)) & (sectors["count"] > 0)
    same = (sectors["axes"] == settings.axes_code) & (sectors["count"] > settings.rows)
    status = np.full(len(pages), SETTINGS, np.uint8)
    status[rates(sectors) != float(settings.rate)] = RATE
    status[~known | same] = NONSENSE
    if not settings.is_old:
        status[checksums(pages) != 0] = CHECKSUM
    status[sectors["magic"] != MAGIC] = FOREIGN
    status[np.isin(sectors["magic"] & np.uint32(0xFFFF), KINDS_WITHOUT_SAMPLES)] = OTHER
    status[(pages == pages[:, :1]).all(axis=1) & np.isin(pages[:, 0], (0, 0xFF))] = EMPTY
    return status


def rates(sectors: Sectors) -> NDArray[np.float64]:
    """Rates of sectors in Hz, (n,)."""
    coded = np.array([float(rate_of(code)) for code in range(16)])[sectors["rate"] & 15]
    return np.where(sectors["rate"] == 0, sectors["offset"].view("<u2"), coded)


def unpack(sectors: Sectors, position: NDArray[np.int64], settings: Settings) -> SectorBlock:
    """All samples of good sectors (p,) of SECTOR."""
    rows = sectors["count"].astype(np.int64)
    accel, gyro = _samples(sectors, settings)
    short = bool((rows < settings.rows).any())
    return SectorBlock(
        position=position,
        rows=rows,
        sequence=sectors["sequence"].astype(np.int64),
        session=sectors["session"].astype(np.int64),
        overflow=(sectors["events"] & OVERFLOW_MASK) != 0,
        anchors=anchors(sectors, settings),
        counts=_joined(accel, rows if short else None),
        temperature=sectors["temperature"].copy(),
        gyro=None if gyro is None else _joined(gyro, rows if short else None),
    )


def _samples(sectors: Sectors, settings: Settings) -> tuple[NDArray[np.int16], NDArray[np.int16] | None]:
    """Acceleration and rotation, (p, rows, 3) each, as views where they are not packed."""
    if settings.axes_code == PACKED:
        return unpacked(sectors), None
    used = sectors["data"][:, : 2 * settings.rows * settings.width].view("<i2")
    values = used.reshape(len(sectors), settings.rows, settings.width)
    if settings.width == 3:
        return values, None
    return values[:, :, 3:6], values[:, :, :3]


def _joined(values: NDArray[np.int16], rows: NDArray[np.int64] | None) -> NDArray[np.int16]:
    """Samples of all sectors one after the other, (n, 3) in memory of their own.

    Args:
        values: (p, rows, 3).
        rows: how many of each sector's are used, None where all are.
    """
    if rows is not None:
        return values[np.arange(values.shape[1]) < rows[:, None]]
    joined = np.empty(values.shape, np.int16)
    joined[:] = values
    return joined.reshape(-1, 3)


def unpacked(sectors: Sectors) -> NDArray[np.int16]:
    """Packed samples of 10 bits an axis and a common exponent as counts of 1/256 g, (p, 120, 3).

    A word of 32 bits is, from the top, the exponent (2 bits), z, y and x. Each number is moved to
    the top of a 16-bit integer, and its sign with it, before it is shifted down again.
    """
    halves = sectors["data"].copy().view(FIELDS)
    low, high = halves["low"], halves["high"]
    factor = (np.int16(1) << (high >> np.uint16(14)).astype(np.int16)).astype(np.int16)
    counts = np.empty((len(sectors), FULL_ROWS[PACKED], 3), np.int16)
    y = (high << np.uint16(12)) | ((low >> np.uint16(4)) & np.uint16(0x0FC0))
    for axis, top in enumerate((low << np.uint16(6), y, high << np.uint16(2))):
        np.multiply(top.view(np.int16) >> 6, factor, out=counts[:, :, axis])
    return counts
