"""The values within the frames of a raw dump: counts, temperature, gyroscope."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.recording import FLOAT_LSB_PER_G, Counts
from accelcal_cli.readers._layout.model import AXES, GYRO, Field, Layout
from accelcal_cli.readers._pages.pages import NO_TEMPERATURE

LARGEST_G = 127.0
FLOAT_DPS_PER_LSB = 2.0**-16
LARGEST_DPS = 32_767.0
LARGEST_MC = 1_000_000.0

CODES = {
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
}
INT24 = "int24"
INT24_RANGE = (-(1 << 23), (1 << 23) - 1)
SMALL, WIDE = np.iinfo(np.int16), np.iinfo(np.int32)


def number_type(endian: str, kind: str) -> np.dtype[np.generic]:
    """The numpy type of a layout's number type."""
    return np.dtype(("<" if endian == "little" else ">") + CODES[kind])


def whole_range(field: Field, zero: int) -> tuple[int, int]:
    """Smallest and largest count of a whole-number field after taking `zero` off."""
    if field.type == INT24:
        low, high = INT24_RANGE
    else:
        info = np.iinfo(np.dtype(CODES[field.type]))
        low, high = int(info.min), int(info.max)
    return low - zero, high - zero


class FrameValues:
    """Takes values out of frames.

    Whole-number accelerations stay counts. If any axis is float32, all become counts of
    FLOAT_LSB_PER_G; a gyroscope with float32 axes becomes counts of FLOAT_DPS_PER_LSB.
    """

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._axes = tuple(layout.fields[name] for name in AXES)
        self._rates = tuple(layout.fields[name] for name in GYRO if name in layout.fields)
        self._float_axes = any(field.type == "float32" for field in self._axes)
        self._float_rates = any(field.type == "float32" for field in self._rates)
        self._record = record_type(layout)
        self._axis_ranges = [] if self._float_axes else [whole_range(f, int(f.zero)) for f in self._axes]
        self._rate_ranges = [] if self._float_rates else [whole_range(f, -rate_zero(f)) for f in self._rates]

    @property
    def lsb_per_g(self) -> float:
        """Counts in one g."""
        return FLOAT_LSB_PER_G if self._float_axes else self._layout.lsb_per_g

    @property
    def dps_per_lsb(self) -> tuple[float, float, float] | None:
        """Degrees per second in one count of each gyroscope axis."""
        if not self._rates:
            return None
        x, y, z = (FLOAT_DPS_PER_LSB if self._float_rates else field.scale for field in self._rates)
        return x, y, z

    @property
    def may_fail(self) -> bool:
        """Whether a row can hold something that is not a usable number."""
        ranges = [*self._axis_ranges, *self._rate_ranges]
        beyond = any(low < WIDE.min or high > WIDE.max for low, high in ranges)
        return self._float_axes or self._float_rates or beyond

    def records(self, frames: NDArray[np.uint8]) -> NDArray[np.void]:
        """Frames (n, frame_bytes) as records (n,)."""
        return np.ascontiguousarray(frames).view(self._record)[:, 0]

    def counts(self, records: NDArray[np.void], faulty: NDArray[np.bool_]) -> Counts:
        """Accelerations (n, 3); rows that hold no usable one are marked in `faulty` (n,)."""
        if not self._float_axes:
            zeros = [int(field.zero) for field in self._axes]
            return self._whole(records, AXES, zeros, self._axis_ranges, faulty)
        columns = [
            (self._raw(records, name).astype(np.float64) - field.zero) / self._layout.lsb_per_g
            for name, field in zip(AXES, self._axes, strict=True)
        ]
        return on_grid(columns, LARGEST_G, 1 / FLOAT_LSB_PER_G, faulty)

    def gyro(self, records: NDArray[np.void], faulty: NDArray[np.bool_]) -> Counts | None:
        """Rotation rates (n, 3), None without a gyroscope; `faulty` as in `counts`."""
        if not self._rates:
            return None
        if not self._float_rates:
            zeros = [-rate_zero(field) for field in self._rates]
            return self._whole(records, GYRO, zeros, self._rate_ranges, faulty)
        columns = [
            self._raw(records, name).astype(np.float64) * field.scale + field.zero
            for name, field in zip(GYRO, self._rates, strict=True)
        ]
        return on_grid(columns, LARGEST_DPS, FLOAT_DPS_PER_LSB, faulty)

    def temperature_mc(self, records: NDArray[np.void]) -> NDArray[np.int32] | None:
        """Thousandths of a degree C (n,), NO_TEMPERATURE where not measured; None without any."""
        field = self._layout.fields.get("temperature")
        if field is None:
            return None
        raw = self._raw(records, "temperature").astype(np.float64)
        milli = (raw * field.scale + field.zero) * 1000
        measured = np.abs(milli) <= LARGEST_MC
        return np.where(measured, np.rint(np.where(measured, milli, 0)), NO_TEMPERATURE).astype(np.int32)

    def _raw(self, records: NDArray[np.void], name: str) -> NDArray[Any]:
        """One field as numbers, (n,)."""
        if self._layout.fields[name].type != INT24:
            return np.asarray(records[name])
        order = slice(None) if self._layout.endian == "little" else slice(None, None, -1)
        low, middle, high = records[name][:, order].T.astype(np.int32)
        return np.asarray(low | middle << 8 | (high ^ 0x80) - 0x80 << 16)

    def _whole(
        self,
        records: NDArray[np.void],
        names: tuple[str, ...],
        zeros: list[int],
        ranges: list[tuple[int, int]],
        faulty: NDArray[np.bool_],
    ) -> Counts:
        small = all(SMALL.min <= low and high <= SMALL.max for low, high in ranges)
        counts = np.empty((len(records), 3), np.int16 if small else np.int32)
        for axis, (name, zero, (low, high)) in enumerate(zip(names, zeros, ranges, strict=True)):
            raw = self._raw(records, name)
            shifted = raw.astype(np.int64) - zero if zero else raw
            if low < WIDE.min or high > WIDE.max:
                faulty |= (shifted < WIDE.min) | (shifted > WIDE.max)
            counts[:, axis] = shifted
        return counts


def record_type(layout: Layout) -> np.dtype[np.void]:
    """A frame as a numpy record."""
    fields = layout.fields
    formats = [
        np.dtype((np.uint8, (3,))) if field.type == INT24 else number_type(layout.endian, field.type)
        for field in fields.values()
    ]
    offsets = [field.offset for field in fields.values()]
    return np.dtype(
        {"names": list(fields), "formats": formats, "offsets": offsets, "itemsize": layout.frame_bytes}
    )


def rate_zero(field: Field) -> int:
    """A gyroscope's `zero` in whole counts."""
    return round(field.zero / field.scale)


def on_grid(
    columns: list[NDArray[np.float64]], largest: float, step: float, faulty: NDArray[np.bool_]
) -> NDArray[np.int32]:
    """Decimal fractions as whole steps, (n, 3); marks rows with a value that is none or too large."""
    counts = np.zeros((len(faulty), 3), np.int32)
    for axis, column in enumerate(columns):
        usable = np.abs(column) <= largest
        faulty |= ~usable
        counts[usable, axis] = np.rint(column[usable] / step)
    return counts
