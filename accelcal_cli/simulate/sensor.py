"""The sensor's errors: from true acceleration to raw counts (the inverse of F eq. 7-9)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import RandomState
from numpy.typing import NDArray

SCALE_ERROR = 0.05
MISALIGNMENT = 0.025
OFFSET_G = 0.05


@dataclass(frozen=True, slots=True)
class Sensor:
    """A sensor with known errors, in the convention of the report: a = K (v + o + s (T - Tref)).

    Attributes:
        gain: K, (3, 3) lower triangular.
        offset_g: o, (3,).
        slope_g_per_c: s, (3,).
        noise_g: standard deviation of white noise on each axis.
    """

    gain: NDArray[np.float64]
    offset_g: NDArray[np.float64]
    slope_g_per_c: NDArray[np.float64]
    noise_g: float
    lsb_per_g: float
    range_g: float
    reference_c: float = 30.0

    def counts(
        self, acceleration: NDArray[np.float64], temperature_c: NDArray[np.float64], random: RandomState
    ) -> NDArray[np.int16]:
        """Raw counts (n, 3) of true acceleration (n, 3) in g."""
        raw = acceleration @ np.linalg.inv(self.gain).T - self.offset_g
        if self.slope_g_per_c.any():
            raw -= np.multiply.outer(temperature_c - self.reference_c, self.slope_g_per_c)
        if self.noise_g:
            raw += self.noise_g * random.standard_normal(raw.shape)
        limit = round(self.range_g * self.lsb_per_g)
        return np.clip(np.rint(raw * self.lsb_per_g), -limit, limit - 1).astype(np.int16)

    def as_json(self) -> dict[str, Any]:
        """The truth file's `sensor` object."""
        return {
            "gain": self.gain.tolist(),
            "offset_g": self.offset_g.tolist(),
            "slope_g_per_c": self.slope_g_per_c.tolist(),
            "reference_c": self.reference_c,
            "noise_g": self.noise_g,
            "lsb_per_g": self.lsb_per_g,
            "range_g": self.range_g,
        }


def draw_gain_and_offset(
    seed: int, size: float, misalignment: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Errors drawn uniformly from half of F's ranges (eq. 17), times `size`.

    Returns:
        K as in F eq. 18 (misalignment terms times the factor `misalignment`), and o in g.
    """
    draw = RandomState(seed).uniform(-1, 1, 9) * size
    scale = 1 + SCALE_ERROR * draw[:3]
    xy, xz, yz = MISALIGNMENT * misalignment * draw[3:6]
    gain = np.array(
        [[scale[0], 0, 0], [scale[1] * xy, scale[1], 0], [scale[2] * xz, scale[2] * yz, scale[2]]]
    )
    return gain, OFFSET_G * draw[6:]
