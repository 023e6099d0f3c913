"""Sensors of `laboratory/segments.py` on the rests of a recording: their truth by hand, and the command."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import IDENTITY, Calibration
from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.points import Windows
from accelcal_cli.core.recording import FLOAT_LSB_PER_G
from accelcal_cli.core.settings import DEFAULT
from accelcal_cli.laboratory.segments import (
    Population,
    Segment,
    Simulation,
    Stillness,
    Track,
    WornSensor,
    bouts,
    rests_of,
    simulated,
    sphere_error_mg,
    stillness_of_table,
    track,
)
from tests.cli.run import run
from tests.laboratory.test_segments import table

Capture = pytest.CaptureFixture[str]
QUIET = Population(bout_mg=0.0, window_mg=0.0)
PERFECT = WornSensor(np.eye(3), np.zeros(3))


def windows(samples: list[int]) -> Windows:
    """Windows of these lengths of a sensor that has measured nothing yet."""
    number = len(samples)
    none = np.zeros((number, 3), np.int64)
    return Windows(np.array(samples), np.cumsum([0, *samples[:-1]]), none, none)


def test_a_bout_is_a_run_of_windows_within_a_posture_of_its_first() -> None:
    degrees = np.radians([0, 10, 14, 16, 20, 0, 1, 90, 0])
    unit = np.stack([np.cos(degrees), np.sin(degrees), 0 * degrees], axis=1)
    assert bouts(unit, 15.0).tolist() == [0, 0, 0, 1, 1, 2, 2, 3, 4]
    assert bouts(unit, 179.0).tolist() == [0] * 9
    assert bouts(unit[:0], 15.0).tolist() == []


def test_a_long_bout_is_one() -> None:
    unit = np.tile([0.0, 0.0, 1.0], (5000, 1))
    unit[[1024, 3000]] = [1.0, 0.0, 0.0]
    assert np.bincount(bouts(unit, 15.0)).tolist() == [1024, 1, 1975, 1, 1999]


def test_what_a_sensor_measures_by_hand() -> None:
    """y = 1.1 v_y + 0.02 v_x and so on, solved for v by hand."""
    sensor = WornSensor(np.array([[0.5, 0, 0], [0.02, 1.0, 0], [0.1, 0, 2.0]]), np.array([0.01, 0.0, -0.03]))
    assert sensor.raw(np.eye(3)) == pytest.approx(
        np.array([[2 - 0.01, -0.04, -0.1 + 0.03], [-0.01, 1, 0.03], [-0.01, 0, 0.53]])
    )


def test_windows_hold_what_the_sensor_would_have_measured() -> None:
    unit = np.array([[0, 0, 1.0], [1.0, 0, 0]])
    sensor = WornSensor(np.diag([0.5, 1.0, 1.0]), np.array([0.0, 0.25, 0.0]))
    found = Track(windows([3, 8]), unit, np.array([0, 1])).worn(sensor, QUIET, np.random.default_rng(1))
    expected = np.array([[0, -0.75, 3], [16, -2, 0]]) * FLOAT_LSB_PER_G
    assert found.sums.tolist() == expected.tolist()


def test_rests_scatter_by_bout_and_by_window() -> None:
    number = 4000
    unit, bout = np.tile([0.0, 1.0, 0.0], (number, 1)), np.arange(number) // 4
    rests = Track(windows([1] * number), unit, bout)
    people = Population(bout_mg=2.0, window_mg=0.5)
    sums = rests.worn(PERFECT, people, np.random.default_rng(3)).sums
    length_mg = 1000 * (sums[:, 1] / FLOAT_LSB_PER_G - 1).reshape(-1, 4)
    assert length_mg.std(axis=1, ddof=1).mean() == pytest.approx(0.5, rel=0.1)
    assert length_mg.mean(axis=1).std() == pytest.approx(np.hypot(2.0, 0.25), rel=0.1)


def test_sensors_are_drawn_within_their_ranges_and_with_one_large_misalignment() -> None:
    people = Population(gain_percent=3, misalignment_percent=2, offset_mg=50, one_misalignment_percent=5)
    drawn = [people.draw(np.random.default_rng(seed)) for seed in range(200)]
    gains = np.array([sensor.gain for sensor in drawn])
    scales = np.abs(np.diagonal(gains, axis1=1, axis2=2) - 1)
    below = np.sort(np.abs(gains[:, [1, 2, 2], [0, 0, 1]]), axis=1)
    offsets = np.abs([sensor.offset_g for sensor in drawn])
    assert 0.028 < scales.max() <= 0.03 and 0.048 < offsets.max() <= 0.05
    assert 0.018 < below[:, 1].max() <= 0.02 and np.all(below[:, 2] == 0.05)
    assert not gains[:, [0, 0, 1], [1, 2, 2]].any()
    places = {int(np.argmax(np.abs(gain[[1, 2, 2], [0, 0, 1]]))) for gain in gains}
    assert places == {0, 1, 2}


def by(scale: float = 1.0, offset_g: Sequence[float] = (0.0, 0.0, 0.0)) -> Calibration:
    offset = (round(value * ONE) for value in offset_g)
    return Calibration("6", (*(round(scale * ONE),) * 3, 0, 0, 0, *offset, 0, 0, 0))


def test_the_true_error_by_hand() -> None:
    assert sphere_error_mg(PERFECT, by()) == pytest.approx(0, abs=1e-5)
    assert sphere_error_mg(PERFECT, by(1.01)) == pytest.approx(10)
    # |u + o| - 1 is o cos(angle) to first order, of which the mean size over the sphere is o / 2.
    offset = WornSensor(np.eye(3), np.array([0.0, 0.0, 0.002]))
    assert sphere_error_mg(offset, by()) == pytest.approx(1.0, rel=0.01)
    assert sphere_error_mg(offset, by(1.0, offset.offset_g)) == pytest.approx(0, abs=1e-5)
    local = WornSensor(np.eye(3), np.array([0.0, 0.0, 0.002]))
    assert sphere_error_mg(local, by(1.0, 0.5 * local.offset_g), local_g=0.5) == pytest.approx(0, abs=1e-5)


def test_true_directions_are_those_of_the_calibrated_means() -> None:
    calibration = Calibration("9", (2 * IDENTITY[0], *IDENTITY[1:]))
    raw = np.array([[0.5, 0, 0], [0, 0, -0.9]])
    rests = track(windows([1, 1]), raw, calibration, 15.0)
    assert rests.directions == pytest.approx(np.array([[1, 0, 0], [0, 0, -1]]))
    assert rests.bout.tolist() == [0, 1]


@pytest.fixture(scope="module")
def still(tmp_path_factory: pytest.TempPathFactory) -> Stillness:
    path = table(tmp_path_factory.mktemp("sensors") / "a.csv", rows=80)
    return stillness_of_table(path, DEFAULT, 24.0)


def test_sensors_with_no_scatter_are_found_exactly(still: Stillness) -> None:
    plan = Simulation(2, seed=5, population=QUIET)
    found = list(simulated(still, [(12.0, 0.0), (12.0, 12.0)], replace(DEFAULT, latitude=45.5), plan))
    assert [(item.sensor, item.hours, item.start_h) for item in found] == [(0, 12.0, 0.0), (1, 12.0, 12.0)]
    for item in found:
        assert item.raw_mg is not None and item.raw_mg > 10
        assert item.true_mg is not None and item.true_mg < 0.1
        assert item.ci95_mg is not None and item.true_mg < item.ci95_mg[1] < 0.1


def test_the_same_seed_gives_the_same_sensors_however_many_there_are(still: Stillness) -> None:
    def first(sensors: int, seed: int) -> Segment:
        return next(simulated(still, [(12.0, 0.0)], DEFAULT, Simulation(sensors, seed)))

    assert first(2, 1) == first(1, 1)
    assert first(1, 1).raw_mg != first(1, 2).raw_mg
    assert not list(simulated(still, [], DEFAULT, Simulation(2)))


def test_rests_that_give_no_calibration_are_refused(still: Stillness) -> None:
    few = replace(still, windows=still.windows.select(np.arange(2)))
    with pytest.raises(DivergedError, match="true directions are not known"):
        rests_of(few, DEFAULT)


def test_the_command(tmp_path: Path, capsys: Capture) -> None:
    path = table(tmp_path / "a.csv", rows=80)
    words = ("evaluate", "segments", path, "--table-hours", 24, "--hours", "12", "-q")
    ran = run(capsys, *words, "--sensors", 2, "--errors", "one_misalignment_percent=5", "--json")
    found = [json.loads(line) for line in ran.lines]
    assert (ran.code, [item["sensor"] for item in found]) == (0, [0, 1])
    assert all(0 < item["true_mg"] < item["raw_mg"] for item in found)
    assert all(
        item["holds"] == (item["ci95_mg"][0] <= item["true_mg"] <= item["ci95_mg"][1]) for item in found
    )
    ran = run(
        capsys, *words, "--sensors", 1, "--errors", "gain_percent=0", "--errors", "misalignment_percent=0",
        "--errors", "offset_mg=0",
    )  # fmt: skip
    assert ran.lines[1].split()[-2:] == ["worse", "holds"]
    assert ran.lines[-1].split()[:4] == ["all", "1", "1", "1"]
    ran = run(capsys, *words, "--errors", "offset_mg=5")
    assert (ran.code, "add --sensors" in ran.err) == (2, True)
