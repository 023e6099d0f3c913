"""Files of the HDF5 writer, read by h5py and by the reader."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from accelcal_cli.core.clock import StampClock, UniformClock
from accelcal_cli.core.recording import FLOAT_LSB_PER_G, Chunk, Device, Recording
from accelcal_cli.formats import named_encoder
from tests.formats.make_hdf5 import START, START_US, even_times, read

ROWS = 1_000
ENCODER = named_encoder("hdf5")


def recording(**changes: Any) -> Recording:
    usual: dict[str, Any] = {
        "rate_hz": 100.0,
        "lsb_per_g": 256.0,
        "range_g": 8.0,
        "start_us": START_US,
        "device": Device("AX3", "012345", "5.0"),
    }
    return Recording(Path("unknown"), "simulated", total_bytes=0, **(usual | changes))


def counts(dtype: type = np.int16) -> np.ndarray:
    return np.random.default_rng(2).integers(-2048, 2048, (ROWS, 3)).astype(dtype)


def chunks(
    values: np.ndarray, size: int = 300, times: np.ndarray | None = None, **extras: np.ndarray
) -> Iterator[Chunk]:
    for start in range(0, len(values), size):
        rows = slice(start, start + size)
        even = UniformClock(START_US, start, Fraction(100))
        clock = even if times is None else StampClock(times[rows])
        parts: dict[str, Any] = {name: item[rows] for name, item in extras.items()}
        yield Chunk(start, values[rows], clock, 0, **parts)


def test_counts_and_attributes_are_seen_by_h5py(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    ENCODER.write(path, recording(), chunks(counts()))
    with h5py.File(path) as file:
        dataset = file["accel"]
        assert list(file) == ["accel"]
        assert (dataset[:] == counts()).all()
        assert (dataset.dtype, dataset.compression, dataset.shuffle) == (np.dtype("<i2"), "gzip", True)
        told = dict(dataset.attrs)
    assert told == {
        "sample_rate": 100.0,
        "units": b"counts",
        "lsb_per_g": 256.0,
        "range_g": 8.0,
        "start_time": START.encode(),
        "serial": b"012345",
        "model": b"AX3",
        "firmware": b"5.0",
    }


def test_the_reader_gives_back_what_was_written(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    warm = (20_000 + np.arange(ROWS)).astype(np.int32)
    gyro = counts()[::-1]
    about = recording(gyro_dps_per_lsb=(0.0625,) * 3, timezone="Europe/Berlin", start_us=START_US + 250_000)
    ENCODER.write(path, about, chunks(counts(), temperature_mc=warm, gyro_counts=gyro))
    got = read(path)
    assert (got.counts == counts()).all()
    assert got.temperature is not None
    assert (got.temperature == warm).all()
    assert got.gyro is not None
    assert (got.gyro == gyro).all()
    again = got.recording
    assert (again.rate_hz, again.lsb_per_g, again.range_g) == (100.0, 256.0, 8.0)
    assert (again.device, again.timezone) == (about.device, "Europe/Berlin")
    assert again.gyro_dps_per_lsb == (0.0625,) * 3


def test_wide_counts_keep_their_width(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    values = counts(np.int32) * 65_536
    ENCODER.write(path, recording(lsb_per_g=FLOAT_LSB_PER_G, start_us=None), chunks(values))
    got = read(path)
    assert (got.counts == values).all()
    assert got.counts.dtype == np.int32


@pytest.mark.parametrize("gap_at", [1, 450, ROWS - 1])
def test_gaps_are_kept_as_times(tmp_path: Path, gap_at: int) -> None:
    path = tmp_path / "a.h5"
    times = even_times(ROWS, 100.0)
    times[gap_at:] += 60_000_000
    ENCODER.write(path, recording(), chunks(counts(), times=times))
    got = read(path)
    assert (got.times == times).all()
    assert got.breaks == [gap_at]


def test_the_same_recording_gives_the_same_bytes(tmp_path: Path) -> None:
    one, two = tmp_path / "a.h5", tmp_path / "b.h5"
    for path in (one, two):
        ENCODER.write(path, recording(), chunks(counts()))
    assert one.read_bytes() == two.read_bytes()


def test_unknown_things_are_left_away(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    ENCODER.write(path, recording(range_g=None, start_us=None, device=Device()), chunks(counts()))
    with h5py.File(path) as file:
        assert set(file["accel"].attrs) == {"sample_rate", "units", "lsb_per_g"}


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    path = tmp_path / "absent" / "a.h5"
    with pytest.raises(FileNotFoundError) as caught:
        ENCODER.write(path, recording(), chunks(counts()))
    assert caught.value.filename == str(path)
