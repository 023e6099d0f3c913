"""Rows that share a stamp, wherever rows are cut, or entered, or lost."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats._stamps import LOST, NO_TIME, Pace, SharedStamps
from accelcal_cli.formats.tables import HDF5, OPAL
from accelcal_cli.formats.tables.hdf5 import TrackRows
from tests.formats import make_hdf5
from tests.formats.make_csv import START_US
from tests.formats.make_opal import add_sensor
from tests.formats.reading import Read

SECOND = 1_000_000
NOTE = "several rows share a time stamp; they were spread evenly until the next one"


def seconds(sizes: Sequence[int]) -> list[int]:
    return [second for second, size in enumerate(sizes) for _ in range(size)]


def hdf5(folder: Path, stamps: Sequence[int], rate_hz: float) -> Path:
    """Rows with these stamps, in seconds since the start."""
    about = make_hdf5.about(sample_rate=rate_hz, units="mg", lsb_per_g=None, start_time=None)
    datasets = {"accel": np.tile(np.array([0, 0, 1000], np.int16), (len(stamps), 1))}
    times = {"time": START_US / SECOND + np.array(stamps, float)}
    return make_hdf5.write(folder / "a.h5", datasets | times, about)


def after_start(found: Read) -> list[int]:
    return (found.times - START_US).tolist()


@given(
    stamps=st.lists(st.sampled_from([NO_TIME, LOST, *range(9)]), max_size=12),
    sizes=st.lists(st.sampled_from([1, 2, 3, 4, 4, 4, 5, 30]), min_size=12, max_size=12),
    cuts=st.lists(st.integers(0, 80), max_size=8),
)
def test_spread_times_do_not_depend_on_where_the_rows_are_cut(
    stamps: list[int], sizes: list[int], cuts: list[int]
) -> None:
    rows = np.repeat(np.array(stamps, np.int64), sizes[: len(stamps)])
    rows = np.where(rows > LOST, rows * SECOND, rows)
    pace = Pace(4.0, SECOND)
    whole = SharedStamps(pace).add(rows, last=True)
    cut = SharedStamps(pace)
    pieces, held = np.split(rows, sorted(cuts)), 0
    times = []
    for number, piece in enumerate(pieces):
        times.append(cut.add(piece, last=number == len(pieces) - 1))
        held += len(piece) - len(times[-1])
        assert held <= cut.longest == 16
    assert held == 0
    assert np.concatenate(times).tolist() == whole.tolist()


@pytest.mark.parametrize("chunk_samples", [1, 7, 1000])
def test_each_stamp_is_read_once_and_no_more_than_four_groups_ahead(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, chunk_samples: int
) -> None:
    path = hdf5(tmp_path, seconds([10] * 40), 10.0)
    asked: list[tuple[int, int]] = []
    read = TrackRows.read

    def noted(rows: TrackRows, start: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
        if rows.path == "/time":
            asked.append((start, stop))
        return read(rows, start, stop)

    with HDF5.open(path, ReadOptions()) as reader:
        monkeypatch.setattr(TrackRows, "read", noted)
        for chunk in reader.chunks(chunk_samples):
            assert asked[-1][1] <= chunk.first_sample + len(chunk) + 4 * 10
    assert [asked[0][0], asked[-1][1]] == [0, 400]
    assert all(before[1] == after[0] for before, after in pairwise(asked))


def test_pieces_from_the_middle_of_a_file_have_the_times_of_the_whole(tmp_path: Path) -> None:
    path = hdf5(tmp_path, seconds([7, *[10, 9, 11] * 30]), 10.0)
    whole = make_hdf5.read(path).times
    with HDF5.open(path, ReadOptions()) as reader:
        for piece in reader.preview(13, 7):
            rows = slice(piece.first_sample, piece.first_sample + len(piece))
            assert piece.clock.times(0, len(piece)).tolist() == whole[rows].tolist()


def test_rows_beside_lost_stamps_keep_their_place_in_the_second(tmp_path: Path) -> None:
    """Of 50 rows a second, rows 64 to 127 have lost their stamps: those around them are in place."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        accel = file.create_dataset("accel", data=np.tile(np.array([0, 0, 256], np.int16), (320, 1)))
        accel.attrs.update(make_hdf5.about(sample_rate=50.0, start_time=None))
        stamps = file.create_dataset("time", (320,), "i8", chunks=(64,))
        known = np.array([*range(64), *range(128, 320)])
        whole = START_US // SECOND + np.arange(320) // 50
        stamps[:64], stamps[128:] = whole[:64], whole[128:]
    for chunk_samples in (9, 1000):
        found = make_hdf5.read(path, chunk_samples)
        assert after_start(found) == (20_000 * known).tolist()
        assert (found.breaks, found.codes) == ([64], ["bad_page"])


def test_a_rate_that_the_stamps_deny_does_not_misplace_rows(tmp_path: Path) -> None:
    """With 40 rows a second as stated, the first group would be the last quarter of its second."""
    path = hdf5(tmp_path, seconds([10] * 5), 40.0)
    with pytest.raises(UnreadableError, match="header says 40 Hz, the times of its rows say 10 Hz"):
        make_hdf5.read(path)
    found = make_hdf5.read(path, rate_hz=10.0)
    assert after_start(found) == list(range(0, 5 * SECOND, SECOND // 10))


def test_stamps_that_rows_of_an_opal_file_share_are_told(tmp_path: Path) -> None:
    times = START_US + SECOND * (np.arange(500) // 100)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.attrs["FileFormatVersion"] = np.uint32(5)
        add_sensor(file, ("XI-000001", "Lumbar"), np.tile([0.0, 0.0, 1.0], (500, 1)), times, 100.0)
    found = make_hdf5.read(tmp_path / "a.h5", form=OPAL)
    assert NOTE in found.recording.notes
    assert after_start(found) == list(range(0, 5 * SECOND, SECOND // 100))
