"""An axis that measures nothing beyond a value short of its range: found, left out, and part of the claim."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from accelcal_cli.collect.cells import Saturation
from accelcal_cli.core.points import Windows
from tests.cli.run import run
from tests.optimize.oracle import directions as even_directions
from tests.recordings import GAIN, LSB_PER_G, OFFSET_G, directions, still_counts, write_raw

Capture = pytest.CaptureFixture[str]


def windows(means: np.ndarray, spread: np.ndarray) -> Windows:
    number = len(means)
    samples = np.full(number, 100, np.int64)
    return Windows(samples, np.arange(number), (means * 100).astype(np.int64), spread.astype(np.int64))


def standing(number: int, value: int, others: int, *, moved: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """x stands at a value in so many windows, and moves in others; y and z always move by `moved` counts."""
    x = np.concatenate([np.full(number, value), np.linspace(-0.9 * value, 0.9 * value, others).round()])
    means = np.stack([x, np.zeros_like(x), np.full_like(x, 100)], axis=1)
    spread = np.full(means.shape, moved)
    spread[:number, 0] = 0
    return means, spread


def found(*parts: tuple[np.ndarray, np.ndarray]) -> tuple[tuple[int, float], ...]:
    one = Saturation()
    for means, spread in parts:
        other = Saturation()
        other.add(windows(means, spread))
        one.merge(other)
    return one.found(256.0)


def test_an_axis_that_stands_at_its_extreme_value_saturates_there() -> None:
    assert found(standing(12, 243, 300)) == ((0, 243 / 256),)
    assert found(standing(12, -243, 300)) == ((0, -243 / 256),)
    assert found(standing(7, 243, 300), standing(5, 243, 10)) == ((0, 243 / 256),)
    assert found(standing(20, 243, 300), standing(20, -243, 300)) == ((0, -243 / 256), (0, 243 / 256))


@pytest.mark.parametrize(
    "why",
    [
        pytest.param([standing(11, 243, 300)], id="too few windows"),
        pytest.param([standing(12, 243, 300, moved=2)], id="the other axes hardly move"),
        pytest.param([standing(12, 243, 300), standing(2, 50, 0)], id="it stands elsewhere too"),
        pytest.param([standing(12, 243, 300), standing(0, 300, 50)], id="it goes further"),
        pytest.param([standing(12, 100, 300)], id="no wrist is so still in one place"),
        pytest.param([], id="nothing"),
    ],
)
def test_what_else_stands_still_does_not_saturate(why: list[tuple[np.ndarray, np.ndarray]]) -> None:
    assert found(*why) == ()


@pytest.fixture
def saturated(tmp_path: Path) -> Path:
    counts = still_counts(directions(120))
    counts[:, 2] = np.maximum(counts[:, 2], round(-0.9 * LSB_PER_G))
    return write_raw(tmp_path / "a.raw", counts)


def true_errors_mg(report: dict) -> np.ndarray:
    """| |a| - 1 g | in even directions, of the saturated sensor with a report's calibration."""
    raw = even_directions(2000) @ np.linalg.inv(GAIN).T - OFFSET_G
    raw[:, 2] = np.maximum(raw[:, 2], -230 / LSB_PER_G)  # what -0.9 g is in counts
    a = (raw + np.array(report["calibration"]["offset_g"])) @ np.array(report["calibration"]["gain"]).T
    return 1000 * np.abs(np.linalg.norm(a, axis=1) - 1)


@pytest.mark.parametrize("prior", ["population", "none"])
def test_it_is_told_and_spoils_neither_fit_nor_claim(
    saturated: Path, tmp_path: Path, capsys: Capture, prior: str
) -> None:
    words = ("--prior", prior, "--windows", tmp_path / "w.csv", "--json", "-q", "--report-only")
    report = json.loads(run(capsys, "calibrate", saturated, *words).out)
    assert report["outcome"] == "calibrated"
    assert {"code": "axis_saturates", "values": {"axis": "z", "at_g": -0.8984}} in report["cautions"]
    assert report["coverage"]["saturated"] == [{"axis": "z", "at_g": round(-230 / 256, 4)}]
    table = pd.read_csv(tmp_path / "w.csv")
    left_out = table[table["role"] == "saturated"]
    assert len(left_out) == report["fit"]["windows"]["saturated_left_out"] > 30
    assert left_out["z"].max() < -0.8
    assert np.abs(np.array(report["calibration"]["gain"]) - GAIN).max() < 5e-4
    error = true_errors_mg(report)
    assert error.mean() > 4 and error.max() > 100
    if prior == "population":
        low, high = report["calibration_error_mg"]["ci95"]
        assert low <= error.mean() <= high
        assert report["calibration_error_mg"]["worst_direction"] == pytest.approx(error.max(), rel=0.1)
        assert report["calibration_error_mg"]["worst_direction_at"][2] < -0.9
    again = json.loads(run(capsys, "fit", tmp_path / "w.csv", "--prior", prior, "--json").out)
    report["coverage"]["subsets_full_after_h"] = None  # a table does not say when its windows were
    assert [again[key] for key in ("coverage", "calibration_error_mg", "reason", "values")] == [
        report[key] for key in ("coverage", "calibration_error_mg", "reason", "values")
    ]
    assert again["calibration"]["fixed_point"] == report["calibration"]["fixed_point"]


def test_a_sound_sensor_has_none(tmp_path: Path, capsys: Capture) -> None:
    path = write_raw(tmp_path / "a.raw", still_counts(directions(60)))
    report = json.loads(run(capsys, "calibrate", path, "--json", "-q", "--report-only").out)
    assert report["coverage"]["saturated"] == [] and report["fit"]["windows"]["saturated_left_out"] == 0
