"""`--precision`: the same values on a coarser grid, in a smaller file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from accelcal_cli.core.calibration import steps_per_g
from tests.cli.run import run
from tests.recordings import good_raw


@pytest.mark.parametrize(
    ("precision_mg", "steps"),
    [(0.25, 4096), (1.0, 1024), (1000 / 1024, 1024), (0.97, 2048), (1000, 1), (0.001, 1 << 20), (None, None)],
)
def test_the_step_is_the_largest_power_of_two_within(precision_mg: float | None, steps: int | None) -> None:
    assert steps_per_g(precision_mg) == steps


def values(folder: Path) -> np.ndarray:
    return pd.read_parquet(folder / "good.calibrated.parquet")[["x", "y", "z"]].to_numpy(np.float64)


def test_values_are_those_of_full_precision_on_the_grid(tmp_path: Path) -> None:
    fine, coarse = tmp_path / "fine", tmp_path / "coarse"
    assert run("calibrate", good_raw(tmp_path), "-d", fine).code == 0
    assert run("calibrate", good_raw(tmp_path), "-d", coarse, "--precision", 0.25).code == 0
    steps = values(coarse) * 4096
    assert (steps == np.rint(steps)).all()
    assert np.abs(values(coarse) - values(fine)).max() <= 0.5 / 4096 + 1e-7
    one, other = (json.loads((f / "good.calibration.json").read_text()) for f in (fine, coarse))
    assert one["calibration"] == other["calibration"] and one["holdout"] == other["holdout"]
    assert other["settings"]["precision_mg"] == 0.25
    sizes = [(f / "good.calibrated.parquet").stat().st_size for f in (fine, coarse)]
    assert sizes[1] < 0.6 * sizes[0]


def test_a_result_of_another_precision_is_made_again(tmp_path: Path) -> None:
    words = ("calibrate", good_raw(tmp_path), "-d", tmp_path)
    assert run(*words).code == 0
    assert "up to date" not in run(*words, "--precision", 1).err
    assert "up to date" in run(*words, "--precision", 1).err
    assert run(*words, "--precision", 0).code == 2


def test_coefficients_are_applied_at_any_precision(tmp_path: Path) -> None:
    assert run("calibrate", good_raw(tmp_path), "-d", tmp_path, "--precision", 1).code == 0
    report, out = tmp_path / "good.calibration.json", tmp_path / "fine"
    assert run("apply", "--coefficients", report, good_raw(tmp_path), "-d", out).code == 0
    steps = values(out) * 1024
    assert (steps != np.rint(steps)).any()


def stored_as_numbers(folder: Path) -> list[str]:
    """Columns that are whole numbers and a table."""
    group = pq.ParquetFile(folder / "good.calibrated.parquet").metadata.row_group(0)
    found = [group.column(index) for index in range(group.num_columns)]
    return [one.path_in_schema for one in found if "RLE_DICTIONARY" in one.encodings]


@pytest.mark.parametrize(
    ("options", "names"),
    [((), ["x"]), (("--model", 6), ["x", "y", "z"]), (("--precision", 0.25), ["x", "y", "z"])],
)
def test_axes_of_one_count_or_on_a_grid_are_stored_as_numbers(
    options: tuple[str | float, ...], names: list[str], tmp_path: Path
) -> None:
    assert run("calibrate", good_raw(tmp_path), "-d", tmp_path, *options).code == 0
    assert stored_as_numbers(tmp_path) == [*names, "validity"]
