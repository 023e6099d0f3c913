"""Which still windows can be rest under gravity at all."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.settings import Settings
from accelcal_cli.core.windows import Windows


def norms_g(windows: Windows, lsb_per_g: float) -> NDArray[np.float64]:
    """Length of each window's raw mean [g], (m,)."""
    mean_g = windows.sums / (windows.samples[:, np.newaxis] * lsb_per_g)
    squares = mean_g * mean_g
    return np.asarray(np.sqrt(squares[:, 0] + squares[:, 1] + squares[:, 2]))


def plausible(windows: Windows, lsb_per_g: float, settings: Settings) -> NDArray[np.bool_]:
    """Windows whose mean has a length near 1 g, (m,); zeros written by a device have not."""
    norms = norms_g(windows, lsb_per_g)
    return np.asarray((norms > settings.norm_low_g) & (norms < settings.norm_high_g))
