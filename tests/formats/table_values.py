"""What tests write into tables of every format: vectors that any kind of number can hold, and their times."""

from __future__ import annotations

import numpy as np

from tests.formats.make_hdf5 import even_times

ROWS = 600
TIMES = even_times(ROWS, 50.0)


def values(rows: int = ROWS) -> np.ndarray:
    """Vectors of about 1 g on the grid of decimal fractions, (n, 3)."""
    around = np.random.RandomState(3).standard_normal((rows, 3))
    around /= np.linalg.norm(around, axis=1)[:, None]
    grid: np.ndarray = np.rint(around * 4096) / 4096
    return grid
