"""Blocks of text on several threads: the same rows and the same errors, in bounded memory."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats import open_recording
from accelcal_cli.formats.tables.rows import MOST_JOINED
from accelcal_cli.formats.tables.text import lines as csv_lines
from accelcal_cli.formats.tables.text import source as csv_reader
from tests.formats.make_csv import stamp, written

HEADER = "time,x,y,z,temperature\n"


def line(number: int, cells: str = "0,0,1,20.5") -> str:
    return f"{stamp(number * 10_000)},{cells}\n"


@pytest.fixture
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(csv_reader, "BLOCK_BYTES", 400)
    monkeypatch.setattr(csv_lines, "PIECE_BYTES", 100)
    monkeypatch.setattr(csv_reader, "HEAD_BYTES", 4000)


@pytest.mark.usefixtures("small_blocks")
@pytest.mark.parametrize("threads", [1, 3])
def test_small_blocks_are_joined_to_chunks_as_large_as_wanted(tmp_path: Path, threads: int) -> None:
    path = written(tmp_path, HEADER + "".join(line(number, f"0,0,{number % 7},20") for number in range(1000)))
    with open_recording(path, ReadOptions(unit="m/s2"), threads) as reader:
        chunks = list(reader.chunks(300))
    sizes = [len(chunk) for chunk in chunks]
    assert sum(sizes) == 1000
    assert all(270 < size <= 300 for size in sizes[:-1])
    ends = [chunk.end_byte for chunk in chunks]
    assert ends == sorted(ends) and ends[0] < ends[-1] == path.stat().st_size


@pytest.mark.usefixtures("small_blocks")
@pytest.mark.parametrize("threads", [1, 3])
def test_temperatures_are_held_over_blocks(tmp_path: Path, threads: int) -> None:
    warmth = ["5000", "", "21.5", *[""] * 60, "nan", "22", *[""] * 60, "-40.25", "1e9", *[""] * 30]
    lines = [line(number, f"0,0,1,{cell}") for number, cell in enumerate(warmth)]
    with open_recording(written(tmp_path, HEADER + "".join(lines)), ReadOptions(unit="g"), threads) as reader:
        found = np.concatenate([chunk.temperature_mc for chunk in reader.chunks(50)])
    assert found.tolist() == [21_500] * 64 + [22_000] * 61 + [-40_250] * 32


@pytest.mark.usefixtures("small_blocks")
@pytest.mark.parametrize("threads", [1, 2, 4])
def test_t17_bad_lines_are_the_same_for_any_number_of_threads(tmp_path: Path, threads: int) -> None:
    bad = {380: "0,0,one,20", 382: "0,0", 390: "two,0,1,20"}
    text = HEADER + "".join(line(number, bad.get(number, "0,0,1,20")) for number in range(400))
    packed = gzip.compress(text.encode(), mtime=0)
    for path in (written(tmp_path, text), written(tmp_path, packed, "a.csv.gz")):
        with open_recording(path, ReadOptions(unit="g"), threads) as reader:
            problems = [problem for chunk in reader.chunks(100_000) for problem in chunk.problems]
        bad = [problem for problem in problems if problem.code == "bad_line"]
        assert [problem.place for problem in bad] == [f"from line {number} on" for number in (382, 384, 392)]
        assert bad[0].message == "1 row left out: column 3 holds 'one', which is not a number"


def test_the_memory_does_not_grow_with_the_samples_wanted(tmp_path: Path) -> None:
    path = written(tmp_path, b"x,y,z\n" + b"0.125,0.5,0.75\n" * 700_000)
    with open_recording(path, ReadOptions(unit="g", rate_hz=100.0)) as reader:
        sizes = [len(chunk) for chunk in reader.chunks(1 << 20)]
    assert sum(sizes) == 700_000 and max(sizes) <= MOST_JOINED
    assert 0 < pa.system_memory_pool().max_memory() < 6 * csv_reader.BLOCK_BYTES
