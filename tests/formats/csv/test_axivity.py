"""Axivity: CSV of OmGui and cwa-convert, with no header at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError
from tests.formats.make_csv import GRID, START_US, read, written

COUNTS = [(-44, 3 * row, 240 - row) for row in range(12)]


def cells(lsb_per_g: int) -> list[list[str]]:
    """Return x, y and z as `%f` of C writes them: six decimals."""
    one = lsb_per_g // 256
    return [[f"{(count * one + count % one) / lsb_per_g:.6f}" for count in row] for row in COUNTS]


def rows(lsb_per_g: int, more: str = "") -> str:
    return "".join(
        f"2024-03-04 00:00:00.{10 * row:03d},{','.join(values)}{more}\n"
        for row, values in enumerate(cells(lsb_per_g))
    )


def raw_rows(one_g: int) -> str:
    """Whole counts are written by `%d`."""
    return "".join(f"2024-03-04 00:00:00.{10 * row:03d},-5,{row},{one_g - row}\n" for row in range(12))


SAMPLE = rows(256).encode()


@pytest.mark.parametrize("lsb_per_g", [256, 512, 2048, 16384])
def test_rows_in_g(tmp_path: Path, lsb_per_g: int) -> None:
    found = read(written(tmp_path, rows(lsb_per_g)))
    assert np.array_equal(found.counts, np.rint(np.array(cells(lsb_per_g), float) * GRID))
    assert (found.times - START_US).tolist() == [row * 10_000 for row in range(12)]
    assert found.recording.rate_hz == 100.0
    assert found.recording.notes[0] == "an export of Axivity"
    assert found.problems == []


@pytest.mark.parametrize("more", [",1.220703,-0.061035,0.000000", ",0.5,1,2,3,4,5", ",17,"])
def test_acceleration_stands_before_what_else_was_exported(tmp_path: Path, more: str) -> None:
    found = read(written(tmp_path, rows(256, more)))
    assert np.array_equal(found.counts, np.rint(np.round(np.array(COUNTS) / 256, 6) * GRID))


def test_rows_off_the_sensors_grid_are_anybodys(tmp_path: Path) -> None:
    text = "".join(
        f"2024-03-04 00:00:00.{10 * row:03d},0.01{row:02d}17,0.200001,0.9{row:02d}003,1.0,2.0,3.0\n"
        for row in range(12)
    )
    with pytest.raises(UnreadableError, match="--columns"):
        read(written(tmp_path, text))


@pytest.mark.parametrize("one_g", [256, 2048, 4096, 16384])
def test_raw_units_are_asked_about_with_the_likely_answer(tmp_path: Path, one_g: int) -> None:
    path = written(tmp_path, raw_rows(one_g))
    with pytest.raises(UnreadableError, match=rf"--unit counts with --lsb-per-g \({one_g} would fit\)"):
        read(path)
    found = read(path, lsb_per_g=float(one_g))
    assert found.counts.tolist() == [[-5, row, one_g - row] for row in range(12)]


@pytest.mark.parametrize(("epoch_day", "name"), [(25_569, "spreadsheet"), (719_529, "MATLAB")])
def test_times_in_days(tmp_path: Path, epoch_day: int, name: str) -> None:
    days = [epoch_day + 19_786 + row / 100 / 86_400 for row in range(50)]
    text = "".join(f"{day:.12f},0.000000,0.000000,1.000000\n" for day in days)
    found = read(written(tmp_path, text))
    assert np.abs(found.times - START_US - np.arange(50) * 10_000).max() <= (1 if epoch_day < 1e5 else 10), (
        name
    )
    assert found.recording.rate_hz == 100.0


def test_days_from_the_start(tmp_path: Path) -> None:
    text = "".join(f"{row / 100 / 86_400:.12f},0.000000,0.000000,1.000000\n" for row in range(50))
    found = read(written(tmp_path, text))
    assert found.times.tolist() == [row * 10_000 for row in range(50)]
    assert found.codes == ["no_start_time"]


def test_sample_numbers_are_no_times(tmp_path: Path) -> None:
    text = "".join(f"{row},0.000000,0.000000,1.000000\n" for row in range(50))
    with pytest.raises(UnreadableError, match="-R time_column=none with --rate"):
        read(written(tmp_path, text))
