"""Times in HDF5 files that jitter: where only the clock jumps, and the rate that they mean."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.formats import ReadOptions
from tests.formats.make_hdf5 import HDF5, START_US, about, write

NUMBER = 1000


def recording(folder: Path, times_us: np.ndarray, lost: int | None = None) -> Path:
    """Write rows of a resting sensor with these times, one of which may be missing."""
    counts = np.tile(np.array([0, 0, 256], np.int16), (len(times_us), 1))
    times = (START_US + times_us) / 1e6
    if lost is not None:
        times[lost] = np.nan
    described = about(sample_rate=None, start_time=None)
    return write(folder / "a.h5", {"accel": counts, "timestamp": times}, described)


@pytest.mark.parametrize("chunk_samples", [1, 64, 10_000])
def test_a_jump_of_the_clock_is_told_from_lost_rows(tmp_path: Path, chunk_samples: int) -> None:
    times_us = 10_000 * np.arange(NUMBER)
    times_us[100:] += 40_000
    times_us[200:] -= 13_000
    times_us[301:] += 40_000
    with HDF5.open(recording(tmp_path, times_us, lost=300), ReadOptions()) as reader:
        chunks = list(reader.chunks(chunk_samples))
    found = [chunk.first_sample + row for chunk in chunks for row in chunk.clock_jumps.tolist()]
    breaks = [chunk.first_sample + row for chunk in chunks for row in chunk.breaks.tolist()]
    assert (breaks, found) == ([100, 200, 300], [100, 200])


def test_the_rate_of_jittery_times(tmp_path: Path) -> None:
    jitter = np.rint(5000 * np.random.default_rng(2).standard_normal(NUMBER)).astype(np.int64)
    path = recording(tmp_path, 10_000 * np.arange(NUMBER) + jitter)
    with HDF5.open(path, ReadOptions()) as reader:
        assert reader.recording.rate_hz == 100.0
