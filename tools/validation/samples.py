"""Recordings as arrays, their rests of 10 s, and the orientations of these: the same for every method."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import accelcal

Real = NDArray[np.float64]
Places = NDArray[np.intp]

WINDOW_S = 10
STILL_G = 0.013
"""Largest standard deviation of each axis in a window at rest (van Hees et al. 2014)."""

POSTURE_COS = np.cos(np.radians(15))
"""Rests within 15 degrees of the first of an orientation belong to it."""

FOLDS = 5
LEAST_SHARE = 0.9
"""Part of the samples that a window has at least, since devices are a little slower than they say."""


@dataclass(frozen=True)
class Piece:
    """Samples, or a table of rests, that a method is given.

    Attributes:
        seconds: (n,) times of the samples or of the windows from some start.
        xyz: (n, 3) raw values [g]. celsius: (n,), or None without a thermometer.
        rate_hz: None for a table of rests.
    """

    name: str
    seconds: Real
    xyz: Real
    celsius: Real | None
    rate_hz: float | None

    def cut(self, which: NDArray[np.bool_]) -> Piece:
        """Return some of the samples."""
        celsius = None if self.celsius is None else self.celsius[which]
        return replace(self, seconds=self.seconds[which], xyz=self.xyz[which], celsius=celsius)

    @property
    def hours(self) -> float:
        """Time from the first to the last sample."""
        return float(self.seconds[-1] - self.seconds[0]) / 3600

    @property
    def number(self) -> NDArray[np.int64]:
        """The window of each sample; each row of a table is one of its own."""
        if self.rate_hz is None:
            return np.arange(len(self.xyz))
        return np.floor(self.seconds / WINDOW_S).astype(np.int64)


@dataclass(frozen=True)
class Rests:
    """Means of the windows at rest: (n,) number of the window, (n, 3) mean [g], (n,) temperature."""

    number: NDArray[np.int64]
    mean: Real
    celsius: Real | None

    def cut(self, which: NDArray[np.bool_] | Places) -> Rests:
        """Return some of the rests."""
        celsius = None if self.celsius is None else self.celsius[which]
        return Rests(self.number[which], self.mean[which], celsius)


def read(path: Path) -> Piece:
    """Return the samples of a recording that are measured, neither filled nor clipped."""
    with accelcal.read(path) as reading:
        parts, rate = list(reading), float(reading.recording.rate_hz)
    good = [part.validity == 0 for part in parts]
    time = np.concatenate([part.time[keep] for part, keep in zip(parts, good, strict=True)])
    xyz = np.concatenate([part.xyz[keep] for part, keep in zip(parts, good, strict=True)])
    warmth = [
        part.temperature[keep] for part, keep in zip(parts, good, strict=True) if part.temperature is not None
    ]
    seconds = (time - time[0].astype("datetime64[D]")) / np.timedelta64(1, "s")
    celsius = np.concatenate(warmth).astype(float) if warmth else None
    return Piece(path.name, seconds, np.asarray(xyz, float), celsius, rate)


def table(path: Path, hours: float) -> Piece:
    """Return a table of rests, which are spread evenly over some hours."""
    held = np.genfromtxt(path, delimiter=",", names=True)
    mean = np.stack([held[name] for name in "xyz"], axis=1)
    seconds = np.arange(len(mean)) * 3600 * hours / len(mean)
    return Piece(path.name, seconds, mean, held["temperature_c"], None)


def rests(piece: Piece) -> Rests:
    """Return the windows of 10 s at rest: all axes have a small standard deviation, and no sample lacks."""
    if piece.rate_hz is None:
        return Rests(piece.number, piece.xyz, piece.celsius)
    numbers, begin, count = np.unique(piece.number, return_index=True, return_counts=True)
    mean = np.add.reduceat(piece.xyz, begin) / count[:, np.newaxis]
    away = piece.xyz - np.repeat(mean, count, axis=0)
    deviation = np.sqrt(np.add.reduceat(away**2, begin) / count[:, np.newaxis])
    length = np.sqrt((mean**2).sum(axis=1))
    full = count >= LEAST_SHARE * WINDOW_S * piece.rate_hz
    still = full & (deviation < STILL_G).all(axis=1) & (np.abs(length - 1) < 0.5)
    celsius = None if piece.celsius is None else np.add.reduceat(piece.celsius, begin) / count
    return Rests(numbers, mean, celsius).cut(still)


def postures(found: Rests) -> Places:
    """Return the orientation of each rest, by number; the first rest of one is its middle."""
    unit = found.mean / np.sqrt((found.mean**2).sum(axis=1, keepdims=True))
    middles: list[Real] = []
    which = np.empty(len(unit), np.intp)
    for place, one in enumerate(unit):
        near = [float(one @ middle) for middle in middles]
        if near and max(near) > POSTURE_COS:
            which[place] = int(np.argmax(near))
        else:
            which[place] = len(middles)
            middles.append(one)
    return which


def folds(piece: Piece, found: Rests, posture: Places) -> Iterator[tuple[Piece, Rests]]:
    """Yield, five times, windows at rest of four fifths of the orientations, and the rests of the others."""
    for fold in range(FOLDS):
        held = posture % FOLDS == fold
        if held.any() and not held.all():
            yield piece.cut(np.isin(piece.number, found.number[~held])), found.cut(held)
