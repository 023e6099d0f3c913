"""The files of a session as one stream: each on its own, one after the other, whenever they were made."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Chunk, Reader, joined
from accelcal_cli.formats import open_recording
from tests.device_recordings import write_device
from tests.six_pose.made import RATE_HZ

PERIOD_US = round(1e6 / RATE_HZ)
OPTIONS = ReadOptions()


def rows(number: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, 0.3, (number, 3)).round(6)


def write(
    path: Path, values: np.ndarray, start: str = "2024-03-04T08:00:00", rate_hz: float = RATE_HZ
) -> Path:
    steps = np.round(np.arange(len(values)) * 1e6 / rate_hz).astype("timedelta64[us]")
    lines = (
        f"{time},{x:.6f},{y:.6f},{z:.6f}"
        for time, (x, y, z) in zip(np.datetime64(start, "us") + steps, values, strict=True)
    )
    path.write_text("time,x [g],y [g],z [g]\n" + "\n".join(lines) + "\n")
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "s").mkdir()
    write(tmp_path / "s/a.csv", rows(233, 1))
    write(tmp_path / "s/b.csv", rows(101, 2), "2024-03-01T10:00:00")
    write(tmp_path / "s/c.csv", rows(57, 3), "2024-03-04T08:00:01")
    return tmp_path / "s"


def opened(path: Path) -> Reader:
    return open_recording(path, OPTIONS, session=True)


def whole(path: Path, chunk_samples: int = 1000) -> tuple[Chunk, Reader]:
    with opened(path) as reader:
        return joined(list(reader.chunks(chunk_samples))), reader


@pytest.mark.parametrize("chunk_samples", [1, 50, 1000])
def test_all_rows_come_by_name_with_a_break_before_each_file(folder: Path, chunk_samples: int) -> None:
    found, reader = whole(folder, chunk_samples)
    expected = np.concatenate([rows(233, 1), rows(101, 2), rows(57, 3)])
    np.testing.assert_allclose(found.counts / reader.recording.lsb_per_g, expected, atol=1e-7)
    assert found.first_sample == 0
    assert found.breaks.tolist() == [233, 334]
    assert len(found.clock_jumps) == 0, "windows must not go on from file to file"
    start_us = int(np.datetime64("2024-03-04T08:00:00", "us").astype(np.int64))
    np.testing.assert_array_equal(found.time_us, start_us + PERIOD_US * np.arange(391))


def test_chunks_count_the_rows_of_the_session(folder: Path) -> None:
    at = 0
    with opened(folder) as reader:
        for chunk in reader.chunks(40):
            assert chunk.first_sample == at
            at += len(chunk)
            assert chunk.end_byte <= reader.recording.total_bytes
    assert at == 391


def test_the_files_are_known_once_all_is_read(folder: Path) -> None:
    _, reader = whole(folder)
    start_us, hour_us = int(np.datetime64("2024-03-04T08:00:00", "us").astype(np.int64)), 3_600_000_000
    assert [(one.name, one.first_sample, one.samples) for one in reader.files] == [
        ("a.csv", 0, 233), ("b.csv", 233, 101), ("c.csv", 334, 57),
    ]  # fmt: skip
    assert [one.first_us for one in reader.files] == [start_us + PERIOD_US * at for at in (0, 233, 334)]
    moved = [0, 233 * PERIOD_US + 70 * hour_us, 334 * PERIOD_US - 1_000_000]
    assert [one.moved_us for one in reader.files] == moved
    assert {(one.dated, one.problems, one.lost_bytes) for one in reader.files} == {(True, 0, 0)}
    assert reader.recording.total_bytes == sum(path.stat().st_size for path in folder.iterdir())


def test_problems_are_placed_in_the_session_and_named(folder: Path) -> None:
    lines = (folder / "b.csv").read_text().splitlines()
    lines[11] = lines[11].split(",")[0] + ",nan,1,2"
    (folder / "b.csv").write_text("\n".join(lines) + "\n")
    found, reader = whole(folder)
    (problem,) = found.problems
    assert (problem.code, problem.sample) == ("missing_value", 243)
    assert problem.message.startswith("b.csv: ")
    assert found.breaks.tolist() == [233, 243, 333]
    assert [one.problems for one in reader.files] == [0, 1, 0]
    assert reader.files[1].lost_bytes == problem.lost_bytes


def test_files_without_dates_are_told(folder: Path) -> None:
    for path in folder.iterdir():
        lines = [line.partition(",")[2] for line in path.read_text().splitlines()]
        path.write_text("\n".join(lines) + "\n")
    with open_recording(folder, replace(OPTIONS, rate_hz=RATE_HZ), session=True) as reader:
        found = joined(list(reader.chunks(100)))
    assert not any(one.dated for one in reader.files)
    np.testing.assert_array_equal(np.diff(found.time_us), PERIOD_US)


@pytest.mark.parametrize(
    ("start", "rate_hz", "told"), [("2024-03-04T08:00:00", 40.0, "its sampling rate is another")]
)
def test_a_file_that_is_unlike_is_named(folder: Path, start: str, rate_hz: float, told: str) -> None:
    write(folder / "d.csv", rows(50, 4), start, rate_hz)
    with pytest.raises(UsageError, match=f"d.csv: does not go with a.csv: {told}"):
        opened(folder)


@pytest.mark.parametrize(
    ("device", "told"),
    [
        ({"serial": "B2"}, "its serial number is B2, not A1"),
        ({"model": "M2"}, "its model is M2, not M1"),
        ({"lsb_per_g": 512.0}, "its scale is another"),
    ],
)
def test_devices_are_compared(tmp_path: Path, device: dict[str, object], told: str) -> None:
    (tmp_path / "s").mkdir()
    first = {"serial": "A1", "model": "M1"}
    write_device(tmp_path / "s/a.raw", rows(50, 1), **first)
    write_device(tmp_path / "s/b.raw", rows(50, 1), **first | device)
    with pytest.raises(UsageError, match=told):
        opened(tmp_path / "s")


def test_a_file_that_cannot_be_read_ends_it(folder: Path, tmp_path: Path) -> None:
    (folder / "b.csv").write_bytes(b"what is this?")
    with pytest.raises(UnreadableError, match=r"b\.csv"):
        opened(folder)
    (tmp_path / "none").mkdir()
    with pytest.raises(UnreadableError, match="holds no recordings"):
        opened(tmp_path / "none")
