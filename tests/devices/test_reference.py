"""Offsets at one temperature, by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.devices.table import read
from accelcal_cli.devices.trends import TEMPERATURE_DOUBT_C, at_one_temperature
from tests.devices.made import NOW_S, fitted, write

WARM = {"slope_x_g_per_c": 0.002, "slope_y_g_per_c": -0.001, "slope_z_g_per_c": 0.0, "offset_x_g": 0.01}


def referred(tmp_path: Path, rows: list[dict], temperature_c: float | None = None):
    held = read(write(tmp_path, rows), NOW_S)
    return held, at_one_temperature(held, np.ones(len(held), bool), temperature_c)


def test_offsets_move_along_their_slopes(tmp_path: Path) -> None:
    rows = [
        fitted("A", number, WARM, model="9T", reference_c=warm) for number, warm in enumerate((28, 30, 35))
    ]
    held, found = referred(tmp_path, rows)
    assert found.temperature_c.tolist() == [30]
    moved = found.records
    assert moved.values[:, 6].tolist() == pytest.approx([0.01 + 0.004, 0.01, 0.01 - 0.010])
    assert moved.values[:, 7].tolist() == pytest.approx([-0.002, 0, 0.005])
    spread = [np.hypot(1e-4, 1e-5 * away) for away in (2, 0, 5)]
    assert moved.errors[:, 6].tolist() == pytest.approx(spread)
    assert (moved.values[:, :6] == held.values[:, :6]).all()
    assert (moved.values[:, 9:] == held.values[:, 9:]).all()


def test_a_given_temperature_is_taken(tmp_path: Path) -> None:
    _, found = referred(tmp_path, [fitted("A", 0, WARM, model="6T", reference_c=28.0)], 20.0)
    assert found.records.values[0, 6] == pytest.approx(0.01 - 8 * 0.002)


def test_an_offset_without_slope_is_that_of_an_unknown_temperature(tmp_path: Path) -> None:
    rows = [fitted("A", 0, WARM, model="9T"), fitted("A", 1, {"offset_x_g": 0.02})]
    _, found = referred(tmp_path, rows)
    assert found.records.values[1, 6] == 0.02
    assert found.records.errors[1, 6] == pytest.approx(np.hypot(1e-4, TEMPERATURE_DOUBT_C * 0.002))
    assert found.records.errors[1, 8] == pytest.approx(1e-4)


def test_without_any_slope_nothing_changes(tmp_path: Path) -> None:
    held, found = referred(tmp_path, [fitted("A", 0), fitted("A", 1, model="3")])
    assert np.isnan(found.temperature_c).all()
    assert np.array_equal(found.records.values, held.values, equal_nan=True)
    assert np.array_equal(found.records.errors, held.errors, equal_nan=True)
    held, found = referred(tmp_path, [fitted("A", 0)], 20.0)
    assert np.array_equal(found.records.errors, held.errors, equal_nan=True)


def test_the_mean_slope_is_weighted(tmp_path: Path) -> None:
    rows = [
        fitted("A", 0, WARM | {"se_slope_x_g_per_c": 1e-5}, model="9T"),
        fitted("A", 1, WARM | {"slope_x_g_per_c": 0.005, "se_slope_x_g_per_c": 2e-5}, model="9T"),
        fitted("A", 2),
    ]
    _, found = referred(tmp_path, rows)
    mean = (4 * 0.002 + 0.005) / 5
    assert found.records.errors[2, 6] == pytest.approx(np.hypot(1e-4, TEMPERATURE_DOUBT_C * mean))
