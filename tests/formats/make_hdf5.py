"""Writes small HDF5 recordings with h5py, and joins what a reader gives."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from accelcal_cli.core.formats import Format
from accelcal_cli.formats.tables import HDF5
from tests.formats.expected import Expected
from tests.formats.reading import Read, read_all

START = "2024-03-04T00:00:00"
START_US = 1_709_510_400_000_000


def make(folder: Path, counts: np.ndarray, rate_hz: float, lsb_per_g: float) -> Expected:
    """A packed file of counts with the usual attributes."""
    path = folder / "made.h5"
    about = {"sample_rate": rate_hz, "units": "counts", "lsb_per_g": lsb_per_g, "start_time": START}
    write(path, {"accel": counts}, chunks=(256, 3), compression="gzip", about={**about, "serial": "0042"})
    return Expected(path, counts / lsb_per_g, rate_hz, even_times(len(counts), rate_hz), 0, "0042")


def even_times(rows: int, rate_hz: float) -> np.ndarray:
    """Start plus k / rate, rounded to the nearest microsecond with whole numbers."""
    rate = Fraction(rate_hz).limit_denominator(10_000)
    steps = [int(Fraction(row * 1_000_000) / rate + Fraction(1, 2)) for row in range(rows)]
    return START_US + np.array(steps, np.int64)


def about(**changes: Any) -> dict[str, Any]:
    """The attributes of a plain file of counts, with changes; None takes one away."""
    usual = {"sample_rate": 100.0, "units": "counts", "lsb_per_g": 256.0, "start_time": START}
    return {name: value for name, value in {**usual, **changes}.items() if value is not None}


def write(
    path: Path,
    datasets: dict[str, np.ndarray],
    about: dict[str, Any] | None = None,
    libver: Any = None,
    **layout: Any,
) -> Path:
    """A file of these datasets; attributes go to the first one, `layout` shapes it."""
    with h5py.File(path, "w", libver=libver) as file:
        for place, (name, values) in enumerate(datasets.items()):
            file.create_dataset(name, data=values, **(layout if place == 0 else {}))
        if datasets:
            file[next(iter(datasets))].attrs.update(about or {})
    return path


def read(path: Path, chunk_samples: int = 1000, form: Format = HDF5, **options: Any) -> Read:
    """All of a recording, with the chunks joined."""
    return read_all(path, form, chunk_samples, **options)
