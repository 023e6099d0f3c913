"""Segments of a recording against the rest of it, where the truth is known."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.settings import DEFAULT, PAPER
from accelcal_cli.laboratory.segments import Segment, Stillness, segments, stillness_of_table, summary
from tests.cli.run import run
from tests.optimize.oracle import IDEAL, directions, measured

Capture = pytest.CaptureFixture[str]

SENSOR = IDEAL + np.array([0.01, -0.02, 0.015, 0.01, -0.005, 0.008, 0.03, -0.02, 0.04, 0, 0, 0])


def table(path: Path, rows: int = 1200, noise_g: float = 0.001) -> Path:
    """Still windows of 24 h in every direction, mixed, so that each hour has fifty."""
    random = np.random.default_rng(4)
    poses = directions(rows)[random.permutation(rows)]
    g = measured(SENSOR, poses * (1 + noise_g * random.standard_normal((rows, 1))))
    path.write_text("x,y,z\n" + "".join(f"{x:.7f},{y:.7f},{z:.7f}\n" for x, y, z in g))
    return path


@pytest.fixture(scope="module")
def still(tmp_path_factory: pytest.TempPathFactory) -> Stillness:
    return stillness_of_table(table(tmp_path_factory.mktemp("table") / "a.csv"), DEFAULT, 24.0)


def test_segments_are_spread_over_the_recording(still: Stillness) -> None:
    found = list(segments(still, 6.0, 3, DEFAULT))
    assert [item.start_h for item in found] == [0.0, 9.0, 18.0]
    assert [item.start_h for item in segments(still, 16.0, 100, DEFAULT)] == [0.0, 8.0]
    assert list(segments(still, 25.0, 3, DEFAULT)) == []


def test_the_error_on_the_rest_is_that_of_the_scatter_and_the_claim_holds_it(still: Stillness) -> None:
    (found,) = segments(still, 12.0, 1, replace(DEFAULT, latitude=45.5))
    assert (found.outcome, found.model) == ("calibrated", "9")
    assert found.raw_mg is not None and found.raw_mg > 20
    assert found.true_mg == pytest.approx(1.0 * np.sqrt(2 / np.pi), rel=0.15)
    assert found.rest_scatter_mg == pytest.approx(found.true_mg, rel=0.2), "each row is a rest of its own"
    assert found.claimed_mg is not None and found.claimed_mg < 0.3 * found.true_mg
    assert found.ci95_mg is not None and found.holds


def test_without_a_prior_the_claim_is_the_held_out_error(still: Stillness) -> None:
    (found,) = segments(still, 12.0, 1, replace(DEFAULT, prior="none"))
    assert found.claimed_mg == found.holdout_mg


def test_only_the_default_profile_has_segments(still: Stillness) -> None:
    with pytest.raises(UsageError, match="profile default"):
        list(segments(still, 12.0, 1, PAPER))


def test_the_summary_by_hand() -> None:
    def one(raw: float | None, true: float | None, ci: tuple[float, float] | None = (1.0, 3.0)) -> Segment:
        return Segment(3.0, 0.0, "calibrated", "9", raw, true, 2.0, ci, 1.0, orientations=2)

    found = summary([one(10.0, 2.0), one(10.0, 12.0), one(None, None), one(4.0, 1.0, None)], 10.0)
    assert (found.segments, found.tried, found.usable, found.provisional) == (4, 4, 3, 0)
    assert (found.above_limit, found.worse) == (1, 1)
    assert (found.raw_mg, found.true_mg, found.claimed_mg) == (8.0, 5.0, 2.0)
    assert found.holds == 0.5
    scatters = replace(one(10.0, 3.5), rest_scatter_mg=1.0)
    assert scatters.holds and not replace(scatters, sensor=1).holds, "the true error of a sensor has none"


def test_the_command(tmp_path: Path, capsys: Capture) -> None:
    path = table(tmp_path / "a.csv", rows=300)
    words = ("evaluate", "segments", path, "--table-hours", 24, "--hours", "6,12", "--number", 2, "-q")
    ran = run(capsys, *words)
    assert ran.code == 0
    head, _, *lines = ran.lines[1:]
    assert head.split() == [
        *("hours", "segments", "tried", "usable", "provisional", "raw", "mg", "true", "mg"),
        *("claimed", "mg", "above", "limit", "worse", "holds"),
    ]
    assert [line.split()[:3] for line in lines] == [["6", "2", "2"], ["12", "2", "2"], ["all", "4", "4"]]
    assert {line.split()[4] for line in lines} == {"0"}, "none is provisional"
    items = [json.loads(line) for line in run(capsys, *words, "--json").lines]
    assert [item["start_h"] for item in items] == [0.0, 18.0, 0.0, 12.0]
    assert {item["recording"] for item in items} == {str(path)}
