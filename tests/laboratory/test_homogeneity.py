"""`accelcal evaluate homogeneity`: simulated devices with one movement, known lags, and plain sums."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accelcal_cli.core.calibration import Transform
from accelcal_cli.core.clock import UniformClock, rate_fraction
from accelcal_cli.core.recording import Chunk
from accelcal_cli.laboratory.homogeneity import (
    HOUR_US,
    Compared,
    Homogeneity,
    Likeness,
    Shift,
    hours,
    lag_between,
    line_of,
    side_by_side,
)
from accelcal_cli.simulate import SimulatedSensor, Wearer, draw_gain_and_offset
from tests.cli.run import run
from tests.recordings import LSB_PER_G, START, good_raw, still_counts, write_raw

Capture = pytest.CaptureFixture[str]
RATE_HZ, HOURS = 25.0, 4
AHEAD_S = (0.0, 2.36, -17.8, 0.0, 40.0, 0.52)
"""How far each clock is ahead of the first one's: multiples of a sample."""


def movement(samples: int) -> np.ndarray:
    """True acceleration (samples, 3) in g."""
    parts, made = [], 0
    for bout in Wearer(RATE_HZ, 21).bouts():
        parts.append(bout.acceleration)
        made += len(bout.acceleration)
        if made >= samples:
            return np.concatenate(parts)[:samples]
    raise AssertionError


@pytest.fixture(scope="module")
def cupboard(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Six devices with errors and noise of their own, whose clocks differ."""
    folder, samples = tmp_path_factory.mktemp("cupboard"), int(HOURS * 3600 * RATE_HZ)
    true, paths = movement(samples), []
    for number, ahead_s in enumerate(AHEAD_S):
        gain, offset = draw_gain_and_offset(100 + number, 1.0, 1.0)
        sensor = SimulatedSensor(gain, offset, np.zeros(3), 0.003, LSB_PER_G, 8.0)
        counts = sensor.counts(true, np.zeros(samples), np.random.RandomState(number))
        path = write_raw(folder / f"device{number}.raw", counts)
        start = np.datetime64(START, "us") + np.timedelta64(round(ahead_s * 1e6), "us")
        layout = path.with_name(path.stem + ".layout.toml")
        layout.write_text(layout.read_text().replace(START, str(start)))
        paths.append(path)
    return paths


def found(capsys: Capture, *words: object) -> dict[str, Any]:
    ran = run(capsys, "evaluate", "homogeneity", *words, "--json")
    assert ran.code == 0, ran.err
    return json.loads(ran.out)


def test_six_devices_are_alike_after_calibration(cupboard: list[Path], capsys: Capture) -> None:
    shown = found(capsys, *cupboard)
    for one, ahead_s in zip(shown["recordings"], AHEAD_S, strict=True):
        assert one["clock"]["lag_s"] == pytest.approx(ahead_s, abs=0.01)
        assert one["clock"]["drift_ppm"] == pytest.approx(0, abs=1)
        assert one["clock"]["residual_ms"] < 10
    before, after = (shown["together"][when]["rms_mg"] for when in ("before", "after"))
    assert before["norm"] > 20 * after["norm"], "what the six must show"
    assert all(before[axis] > 10 * after[axis] for axis in "xyz")
    assert abs(shown["seconds"] - HOURS * 3600) < 120
    squares = [one["likeness"]["before"]["mean_square_g2"]["x"] for one in shown["recordings"]]
    assert shown["together"]["before"]["mean_square_g2"]["x"] == pytest.approx(np.mean(squares))


def test_the_deviations_are_those_of_means_of_a_second(cupboard: list[Path], capsys: Capture) -> None:
    """Two devices whose clocks agree: the raw figures by plain sums over the counts."""
    pair = [cupboard[0], cupboard[3]]
    shown = found(capsys, *pair)
    lag_s = shown["recordings"][1]["clock"]["lag_s"]
    raw = [np.fromfile(path, "<i2").reshape(-1, 3) / LSB_PER_G for path in pair]
    values = [np.column_stack([one, np.linalg.norm(one, axis=1)]) for one in raw]
    means = np.array([one.reshape(-1, 25, 4).mean(axis=1) for one in values])
    squares = ((means - means.mean(axis=0)) ** 2).mean(axis=(0, 1))
    told = shown["together"]["before"]["mean_square_g2"]
    assert abs(lag_s) < 0.002
    assert [told[axis] for axis in ("x", "y", "z", "norm")] == pytest.approx(squares, rel=0.01)


@pytest.mark.nightly
def test_an_acceptance_test_of_a_cupboard(cupboard: list[Path], tmp_path: Path, capsys: Capture) -> None:
    words = ("evaluate", "homogeneity", *cupboard[:2])
    ran = run(capsys, *words, "--accept", 5)
    assert ran.code == 0 and ran.out.count(" yes") == 2 and "times smaller" in ran.out
    assert run(capsys, *words, "--accept", 0.01).code == 1
    refused = write_raw(tmp_path / "refused.raw", still_counts(np.array([[0, 0, 1.0]])))
    ran = run(capsys, *words, refused, "--accept", 5)
    assert ran.code == 1 and "refused.raw: refused: " in ran.out
    rows = list(csv.DictReader(io.StringIO(run(capsys, *words, "--csv").out)))
    assert [row["outcome"] for row in rows] == ["calibrated"] * 2
    assert float(rows[0]["norm_before_mg"]) > float(rows[0]["norm_after_mg"])


def test_what_cannot_be_compared_is_said(cupboard: list[Path], tmp_path: Path, capsys: Capture) -> None:
    words = ("evaluate", "homogeneity")
    other = good_raw(tmp_path)
    assert "nothing to be compared with" in run(capsys, *words, other).err
    ran = run(capsys, *words, cupboard[0], other)
    assert ran.code == 2 and "no movement in common" in ran.err
    assert run(capsys, *words, cupboard[0], cupboard[4], "--largest-lag", 20).code == 2
    assert run(capsys, *words, cupboard[0], tmp_path / "none.raw").code == 3


def test_the_columns_of_the_table(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    refused = Homogeneity((Compared(Path("a.raw"), "7", "refused", ""),), 0, Likeness((), ()))
    monkeypatch.setattr("accelcal_cli.laboratory.homogeneity.homogeneity", lambda *_: refused)
    assert run(capsys, "evaluate", "homogeneity", "a.raw", "b.raw", "--csv").out.splitlines() == [
        "recording,serial,outcome,lag_s,drift_ppm,residual_ms,correlation,x_before_mg,x_after_mg,"
        "y_before_mg,y_after_mg,z_before_mg,z_after_mg,norm_before_mg,norm_after_mg",
        "a.raw,7,refused" + 12 * ",",
    ]


def table_of(signal: np.ndarray) -> np.ndarray:
    """One row a cell whose |a| is the signal."""
    table = np.zeros((len(signal), 5), np.int64)
    table[:, 0], table[:, 4] = 1, np.rint(signal * 2**32)
    return table


@pytest.mark.parametrize("ahead_s", [0.0, 1.0, -2.5, 0.05, -0.025])
def test_a_lag_is_found_between_cells(ahead_s: float) -> None:
    times = np.arange(36_000) / 10
    random = np.random.RandomState(8)
    slow = [(random.uniform(0.01, 0.8), random.uniform(0, 6.28)) for _ in range(40)]
    one, two = (
        1 + 0.05 * sum(np.sin(2 * np.pi * hz * (times - late) + phase) for hz, phase in slow)
        for late in (0.0, ahead_s)
    )
    lag = lag_between(table_of(one), table_of(two), 60)
    assert lag is not None
    assert lag[0] == pytest.approx(ahead_s * 1e6, abs=2000) and lag[1] > 0.99
    assert lag_between(table_of(one), table_of(np.ones(36_000)), 60) is None


def test_a_clock_that_drifts_is_a_line() -> None:
    """50 ppm from 3 s on, with one hour that is far off."""
    lags = [(hour * HOUR_US, 3e6 + 50e-6 * hour * HOUR_US, 0.9) for hour in range(20)]
    lags[7] = (7 * HOUR_US, 30e6, 0.6)
    shift, clock = line_of(lags)
    assert clock.drift_ppm == pytest.approx(50, abs=0.1) and clock.hours == 20
    times = np.array([0, 10 * HOUR_US])
    ahead = (times - shift.on_common_clock(times)) / 1e6
    assert ahead == pytest.approx([3.0, 3 + 50e-6 * 36_000], abs=1e-3)


def test_hours_do_not_depend_on_the_chunks() -> None:
    rows = np.random.RandomState(2).randint(-300, 300, (100_000, 3)).astype(np.int16)
    plain = [Transform(np.eye(3), np.zeros(3), np.zeros(3), 0.0, 256.0)]
    clock = UniformClock(1_000_000_123, 0, rate_fraction(25.0))
    whole = Chunk(0, rows, clock, 0)

    def made(step: int) -> list[tuple[int, list[Any]]]:
        parts = (whole.part(first, min(first + step, len(rows))) for first in range(0, len(rows), step))
        shift = Shift(5e5, 1e-4, 0)
        return [(number, table.tolist()) for number, table in hours(parts, plain, 1_000_000, shift)]

    one = made(100_000)
    assert made(733) == one and sum(row[0] for _, table in one for row in table) == len(rows)


def test_recordings_are_read_side_by_side() -> None:
    def stream(*numbers: int) -> Any:
        return iter([(number, np.full(1, number)) for number in numbers])

    merged = [
        (number, [None if one is None else int(one[0]) for one in tables])
        for number, tables in side_by_side([stream(1, 2, 4), stream(2, 3, 4)])
    ]
    assert merged == [(1, [1, None]), (2, [2, 2]), (3, [None, 3]), (4, [4, 4])]
