"""A calibration as any method gives it, and its error on rests and over all orientations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tools.validation.samples import Places, Real, Rests


@dataclass(frozen=True)
class Found:
    """a = matrix v + constant + per_c T, with v in g and T in degrees C.

    Attributes:
        claimed: mean error [mg] and its 95 % interval as the method states them, if it does.
    """

    matrix: Real
    constant: Real
    per_c: Real
    claimed: tuple[float, float, float] | None = None

    def __call__(self, raw: Real, celsius: Real | None) -> Real:
        """Return calibrated values [g] of (n, 3) raw ones."""
        here = raw @ self.matrix.T + self.constant
        return here if celsius is None else here + np.outer(celsius, self.per_c)

    def error_g(self, still: Rests) -> float:
        """Return the mean | |a| - 1 g | of rests."""
        return float(self.errors_g(still).mean())

    def errors_g(self, still: Rests) -> Real:
        """Return | |a| - 1 g | of each rest."""
        length = np.sqrt((self(still.mean, still.celsius) ** 2).sum(axis=1))
        return np.asarray(np.abs(length - 1))


RAW = Found(np.eye(3), np.zeros(3), np.zeros(3))


def by_posture_mg(found: Found, still: Rests, posture: Places) -> dict[int, float]:
    """Return the mean error [mg] of the rests of each orientation."""
    errors = found.errors_g(still)
    return {int(one): 1000 * float(errors[posture == one].mean()) for one in np.unique(posture)}


def sphere() -> Real:
    """Return 2000 directions spread evenly over the sphere."""
    turn = np.arange(2000) * np.pi * (3 - np.sqrt(5))
    z = (np.arange(2000) + 0.5) / 1000 - 1
    around = np.sqrt(1 - z**2)
    return np.stack([around * np.cos(turn), around * np.sin(turn), z], axis=1)


def everywhere_mg(found: Found, gain: Real, offset_g: Real, celsius: float) -> float:
    """Return the mean error [mg] over all orientations of a sensor whose a = gain (v + offset)."""
    raw = sphere() @ np.linalg.inv(gain).T - offset_g
    return 1000 * found.error_g(Rests(np.arange(len(raw)), raw, np.full(len(raw), celsius)))
