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
from accelcal_cli.formats.tables.clock import find_pace
from accelcal_cli.formats.tables.hdf5 import TrackRows
from accelcal_cli.formats.tables.header import Source, Stated
from tests.formats import make_csv, make_hdf5
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
        assert held <= 2 * cut.longest == 120
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


def written(start_s: float, rows: int, rate_hz: float, digits: int) -> np.ndarray:
    """The stamps [us] of even rows that are written with so many digits, as `%.5g` does."""
    times = start_s + np.arange(rows) / rate_hz
    return np.array([round(float(f"{time:.{digits}g}") * SECOND) for time in times])


def pace_of(stamps: np.ndarray) -> Pace:
    source = Source()
    source.path, source.stated = Path(), Stated()
    return find_pace(stamps, source, ReadOptions())


@pytest.mark.parametrize(
    ("start_s", "rows", "rate_hz", "digits", "coarsest_us"),
    [
        (9900.0, 9000, 25.0, 5, SECOND),  # as MATLAB's csvwrite does
        (99_900.0, 9000, 25.0, 6, SECOND),
        (0.0, 9000, 40.0, 3, SECOND),
        (940.0, 9000, 100.0, 5, SECOND // 10),  # most rows have a stamp of their own
        (90.0, 12_000, 12.5, 3, 10 * SECOND),
    ],
)
def test_stamps_with_few_digits_are_spread_where_they_become_coarser(
    start_s: float, rows: int, rate_hz: float, digits: int, coarsest_us: int
) -> None:
    stamps = written(start_s, rows, rate_hz, digits)
    pace = pace_of(stamps)
    assert pace.rate_hz == rate_hz
    times = SharedStamps(pace).add(stamps, last=True)
    steps = np.diff(times)
    assert (steps.min() >= 0, steps.max() <= 3 * pace.period_us) == (True, True)
    assert np.abs(times - start_s * SECOND - np.arange(rows) * pace.period_us).max() <= coarsest_us
    cut = SharedStamps(pace)
    parts = [cut.add(part, last=number == 8) for number, part in enumerate(np.array_split(stamps, 9))]
    assert np.concatenate(parts).tolist() == times.tolist()


def test_stamps_become_coarser_long_after_the_first_rows() -> None:
    stamps = written(9000.0, 36_000, 25.0, 6)
    early = pace_of(stamps[:5000])
    assert early == Pace(25.0)
    times = SharedStamps(early).add(stamps, last=True)
    assert times[:25_000].tolist() == stamps[:25_000].tolist()
    assert (np.diff(times).min() >= 0, np.diff(times).max() <= 120_000) == (True, True)
    even = np.round(9000 * SECOND + np.arange(36_000) * 40_000)
    assert np.abs(times - even)[25_010:].max() <= 40_000  # rows are in the middle of their rounded stamps


@pytest.mark.parametrize("missing_s", [4, 60])
def test_a_gap_between_coarser_stamps_remains_one(missing_s: int) -> None:
    stamps = written(9900.0, 9000, 25.0, 5)
    kept = np.delete(stamps, np.arange(5000, 5000 + 25 * missing_s))
    times = SharedStamps(pace_of(kept)).add(kept, last=True)
    steps = np.diff(times)
    assert np.flatnonzero((steps < 0) | (steps > 120_000)).tolist() == [4999]
    assert abs(int(steps[4999]) - missing_s * SECOND) <= SECOND // 2


@pytest.mark.parametrize("first", [[0], [0, 40_000], [0, 0, 100_000]])
def test_rows_before_stamps_are_shared_are_no_incomplete_group(first: list[int]) -> None:
    """The first stamps are finer than those which later rows share."""
    begun = written(first[-1] / SECOND, 9000, 25.0, 3)
    rows = np.array([*first[:-1], *begun])
    assert (
        SharedStamps(Pace(25.0, 100_000)).add(rows, last=True)[: len(first) + 1].tolist()
        == {
            1: [0, 40_000],
            2: [0, 40_000, 80_000],
            3: [0, 50_000, 100_000, 140_000],
        }[len(first)]
    )


def test_numbers_with_few_digits_in_a_text_file(tmp_path: Path) -> None:
    lines = [f"{9990 + row / 50:.5g},0.0,0.{row % 7},1.0" for row in range(2000)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["time (s),x,y,z", *lines, ""]))
    found = make_csv.read(path)
    assert (found.recording.rate_hz, len(found.times), found.codes) == (50.0, 2000, ["no_start_time"])
    assert found.times[:6].tolist() == [9_990_040_000 + 20_000 * row for row in range(6)]
    assert not found.breaks
