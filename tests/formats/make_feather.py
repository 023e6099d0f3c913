"""Writes small Arrow IPC files with pyarrow."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.feather

from tests.formats.expected import Expected
from tests.formats.make_hdf5 import even_times
from tests.formats.make_parquet import SERIAL, table


def make(folder: Path, counts: np.ndarray, rate_hz: float, lsb_per_g: float) -> Expected:
    """Float columns in g and times in UTC, packed with LZ4 in batches of 256 rows."""
    path, times = folder / "made.feather", even_times(len(counts), rate_hz)
    pyarrow.feather.write_feather(table(counts / lsb_per_g, times), path, compression="lz4", chunksize=256)
    return Expected(path, counts / lsb_per_g, rate_hz, times, 0, SERIAL)
