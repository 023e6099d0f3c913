"""Written CSV files, read with Python's own csv module."""

from __future__ import annotations

import csv
import gzip
from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.clock import StampClock, UniformClock
from accelcal_cli.core.errors import OutputError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Chunk, Recording
from accelcal_cli.formats.tables import CSV as FORMAT
from accelcal_cli.formats.tables.csv_writer import ENCODER

START_US = 1_709_510_400_000_000
COUNTS = np.random.default_rng(4).integers(-2048, 2048, (300, 3)).astype(np.int16)


def recording(**facts: object) -> Recording:
    given = {"start_us": START_US, **facts}
    return Recording(Path("a"), "csv", 100.0, 256.0, 0, **given)  # type: ignore[arg-type]


def chunks(temperature: bool = False) -> Iterator[Chunk]:
    for first in range(0, len(COUNTS), 70):
        part = COUNTS[first : first + 70]
        spare = np.full(len(part), 30_125, np.int32) if temperature else None
        yield Chunk(first, part, UniformClock(START_US, first, Fraction(100)), 0, temperature_mc=spare)


def written(path: Path, what: Recording, parts: Iterator[Chunk]) -> list[list[str]]:
    ENCODER.write(path, what, parts)
    with gzip.open(path, "rt", newline="") as file:
        return list(csv.reader(file))


def test_times_and_shortest_exact_decimals(tmp_path: Path) -> None:
    head, *rows = written(tmp_path / "a.csv.gz", recording(), chunks())
    assert head == ["time", "x", "y", "z"]
    assert [[float(cell) for cell in row[1:]] for row in rows] == (COUNTS / 256).tolist()
    assert all(len(cell) <= len(repr(float(cell))) for row in rows for cell in row[1:])
    steps = [datetime.fromisoformat(row[0]) - datetime(2024, 3, 4) for row in rows]
    assert [step.total_seconds() for step in steps] == [number / 100 for number in range(300)]
    assert rows[1][0] == "2024-03-04 00:00:00.010000"


def test_a_gyroscope_comes_back(tmp_path: Path) -> None:
    what = recording(gyro_dps_per_lsb=(0.0625,) * 3)
    turned = (replace(chunk, gyro_counts=chunk.counts[::-1]) for chunk in chunks())
    head, *rows = written(tmp_path / "a.csv.gz", what, turned)
    assert head[4:] == ["gyro_x_dps", "gyro_y_dps", "gyro_z_dps"]
    assert [float(cell) for cell in rows[0][4:]] == (COUNTS[69] / 16).tolist()
    with FORMAT.open(tmp_path / "a.csv.gz", ReadOptions()) as reader:
        found = [chunk.gyro_counts for chunk in reader.chunks(1000) if chunk.gyro_counts is not None]
    assert np.concatenate(found)[:70].tolist() == (COUNTS[69::-1].astype(int) * 4096).tolist()


def test_temperature_and_zone(tmp_path: Path) -> None:
    what = recording(has_temperature=True, timezone="UTC")
    head, *rows = written(tmp_path / "a.csv.gz", what, chunks(temperature=True))
    assert head[-1] == "temperature_c"
    assert {row[-1] for row in rows} == {"30.125"}
    assert rows[0][0] == "2024-03-04 00:00:00.000000Z"


def test_no_start_no_time_column(tmp_path: Path) -> None:
    assert written(tmp_path / "a.csv.gz", recording(start_us=None), chunks())[0] == ["x", "y", "z"]


def test_the_same_recording_gives_the_same_bytes(tmp_path: Path) -> None:
    one, two = tmp_path / "one.csv.gz", tmp_path / "other name.csv.gz"
    ENCODER.write(one, recording(), chunks())
    whole = Chunk(0, COUNTS, UniformClock(START_US, 0, Fraction(100)), 0)
    ENCODER.write(two, recording(), [whole])
    with gzip.open(one) as first, gzip.open(two) as second:
        assert first.read() == second.read()
    ENCODER.write(two, recording(), chunks())
    assert one.read_bytes() == two.read_bytes()
    assert one.read_bytes()[3:8] == bytes(5)


def test_the_reader_gives_back_what_was_written(tmp_path: Path) -> None:
    path = tmp_path / "a.csv.gz"
    times = START_US + np.cumsum(np.random.default_rng(1).integers(9_990, 10_011, 300))
    ENCODER.write(path, recording(), [Chunk(0, COUNTS, StampClock(times), 0)])
    with FORMAT.open(path, ReadOptions(unit="g")) as reader:
        found = list(reader.chunks(1000))
        assert reader.recording.rate_hz == 100.0
    assert np.array_equal(np.concatenate([chunk.counts for chunk in found]), COUNTS * np.int32(65536))
    assert np.array_equal(found[0].clock.times(0, 300), times)


def test_a_folder_that_is_missing_is_an_output_error(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="cannot be written"):
        ENCODER.write(tmp_path / "none" / "a.csv.gz", recording(), chunks())
