"""Parameters, models, window counts, settings, judgements."""

from __future__ import annotations

import json

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import IDENTITY, PARAMETER_NAMES, Calibration, TemperatureScale
from accelcal_cli.core.points import MODELS, PointSet, WindowCounts, Windows
from accelcal_cli.core.results import ErrorSummary, Holdout
from accelcal_cli.core.settings import DEFAULT, PAPER, PROFILES


@pytest.mark.parametrize(
    ("name", "free"),
    [
        ("0", ""),
        ("3", "ox oy oz"),
        ("6", "k_xx k_yy k_zz ox oy oz"),
        ("9", "k_xx k_yy k_zz k_yx k_zx k_zy ox oy oz"),
        ("3T", "ox oy oz sx sy sz"),
        ("6T", "k_xx k_yy k_zz ox oy oz sx sy sz"),
        ("9T", "k_xx k_yy k_zz k_yx k_zx k_zy ox oy oz sx sy sz"),
    ],
)
def test_models_free_what_their_name_says(name: str, free: str) -> None:
    model = MODELS[name]
    assert [PARAMETER_NAMES[index] for index in model.free] == free.split()
    assert model.has_temperature == name.endswith("T")


def test_the_ideal_sensor_changes_nothing() -> None:
    ideal = Calibration("0", IDENTITY)
    assert ideal.gain().tolist() == np.eye(3).tolist()
    assert ideal.offset_g().tolist() == [0, 0, 0]
    assert ideal.slope_g_per_c().tolist() == [0, 0, 0]
    assert ideal.reference_c() == 0


def test_parameters_land_in_their_places() -> None:
    parameters = tuple(ONE * k // 16 for k in range(1, 13))
    found = Calibration("9T", parameters, TemperatureScale(30_250, 4.0))
    assert (found.gain() * 16).tolist() == [[1, 0, 0], [4, 2, 0], [5, 6, 3]]
    assert (found.offset_g() * 16).tolist() == [7, 8, 9]
    assert (found.slope_g_per_c() * 64).tolist() == [10, 11, 12]
    assert found.reference_c() == 30.25


@pytest.mark.parametrize("which", [np.array([True, False, True]), np.array([2, 0])])
def test_selecting_points_keeps_every_column_together(which: np.ndarray) -> None:
    xyz = np.arange(9, dtype=np.int64).reshape(3, 3)
    points = PointSet(xyz, np.array([1, 2, 3]), np.array([4, 5, 6]), np.array([7, 8, 9]))
    chosen = points.select(which)
    rows = chosen.xyz[:, 0] // 3
    assert len(chosen) == 2
    assert (chosen.weights - 1).tolist() == rows.tolist()
    assert (chosen.windows - 4).tolist() == rows.tolist()
    assert chosen.tau is not None and (chosen.tau - 7).tolist() == rows.tolist()


def test_selecting_windows_keeps_every_column_together() -> None:
    sums = np.arange(6, dtype=np.int64).reshape(2, 3)
    windows = Windows(np.array([5, 6]), np.array([0, 5]), sums, sums + 1, np.array([7, 8]))
    chosen = windows.select(np.array([False, True]))
    assert (chosen.samples.tolist(), chosen.first_sample.tolist()) == ([6], [5])
    assert (chosen.sums.tolist(), chosen.spread.tolist()) == ([[3, 4, 5]], [[4, 5, 6]])
    assert chosen.temperature_sums is not None and chosen.temperature_sums.tolist() == [8]


def test_positions_in_g_are_exact() -> None:
    points = PointSet(np.array([[ONE, -ONE // 2, 1]]), np.array([1]), np.array([1]))
    assert points.xyz_g().tolist() == [[1.0, -0.5, 2.0**-29]]


def test_window_counts_add_field_by_field() -> None:
    total = WindowCounts(1, 2, 3, 4, 5, 6) + WindowCounts(10, 20, 30, 40, 50, 60)
    assert total == WindowCounts(11, 22, 33, 44, 55, 66)
    assert total.complete == 11 and total.still == 66


def test_settings_are_the_papers_where_they_name_a_source() -> None:
    assert (DEFAULT.segment_seconds, DEFAULT.stillness_threshold_g) == (5.0, 0.12)
    assert (DEFAULT.stillness_deviation_g, DEFAULT.coverage_g, DEFAULT.max_error_mg) == (0.013, 0.3, 10.0)
    assert DEFAULT.stillness_axes == (0, 1, 2)
    assert (PAPER.profile, PAPER.model, PAPER.temperature) == ("paper", "auto", False)
    assert (PAPER.stillness_deviation_g, PAPER.stillness_axes) == (None, (0,))
    assert (PAPER.segment_seconds, PAPER.stillness_threshold_g) == (5.0, 0.12)
    assert {name: item.profile for name, item in PROFILES.items()} == {"default": "default", "paper": "paper"}


def test_settings_go_into_json_whole() -> None:
    text = json.loads(json.dumps(DEFAULT.as_json()))
    assert set(text) == set(DEFAULT.__dataclass_fields__)
    assert text["stillness_axes"] == [0, 1, 2]


@pytest.mark.parametrize(("before", "after", "percent"), [(20.0, 4.0, 500.0), (3.0, 6.0, 50.0)])
def test_improvement_is_eq_21(before: float, after: float, percent: float) -> None:
    summaries = [ErrorSummary(value, 1.0, 1.0) for value in (before, after)]
    held = Holdout("", 1, 1, *summaries, (0.0, 1.0), ())
    assert held.improvement_percent() == percent


def test_improvement_to_nothing_is_infinite() -> None:
    held = Holdout("", 1, 1, ErrorSummary(1, 1, 1), ErrorSummary(0, 0, 0), (0.0, 1.0), ())
    assert held.improvement_percent() == float("inf")
