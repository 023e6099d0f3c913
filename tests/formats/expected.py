"""What a hand-made recording holds, for the tests that every format must pass."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from accelcal_cli.core.formats import ReadOptions


@dataclass(frozen=True)
class Expected:
    """The truth about a file that a `make_<format>.make(path)` wrote.

    counts_g: (n, 3) float64 of raw values in g (counts / lsb_per_g), exact.
    times_us: (n,) int64, or None where the format's times are tested elsewhere.
    tolerance_us: how far a stamp may be rounded by the format.
    """

    path: Path
    counts_g: np.ndarray
    rate_hz: float
    times_us: np.ndarray | None
    tolerance_us: int = 1
    serial: str | None = None
    options: ReadOptions = field(default_factory=ReadOptions)
