"""How many times smaller the held-out error is: its interval, and the places where it is read."""

from __future__ import annotations

import json
from math import exp
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ratio_uncertainty95
from accelcal_cli.core.declared import json_or_null
from accelcal_cli.core.results import Holdout
from accelcal_cli.judge.model_ladder import of_postures
from accelcal_cli.output.report import improvement
from tests.cli.run import run_process
from tests.cli.studies import rows
from tests.recordings import good_raw


def held_out(*pairs: tuple[float, float]) -> Holdout:
    return of_postures("by hand", len(pairs), pairs)


def test_verdicts_10_the_interval_is_that_of_the_logarithm_of_the_ratio() -> None:
    """Relative differences of the pairs: 0, -0.5, 0.5; Student's t of 2 degrees of freedom is 4.303."""
    found = held_out((10.0, 1.0), (10.0, 1.5), (10.0, 0.5))
    by = exp(4.303 * 0.5 / 3**0.5)
    assert found.improvement_factor() == 10.0
    assert found.improvement_ci95() == pytest.approx((10 / by, 10 * by))
    assert json_or_null(improvement(found)) == {
        "value": 10.0,
        "ci95": [float(f"{10 / by:.4g}"), float(f"{10 * by:.4g}")],
    }


def test_verdicts_10_what_is_alike_in_all_pairs_is_certain() -> None:
    assert held_out((40.0, 4.0), (20.0, 2.0)).improvement_ci95() == (10.0, 10.0)


@pytest.mark.parametrize(
    ("pairs", "shown"),
    [
        (((40.0, 2.0),), {"value": 20.0, "ci95": None}),
        (((0.0, 1.0), (0.0, 2.0)), {"value": 0.0, "ci95": None}),
        (((40.0, 0.0), (30.0, 0.0)), None),
    ],
)
def test_verdicts_10_without_a_spread_or_a_ratio_there_is_no_interval(
    pairs: tuple[tuple[float, float], ...], shown: dict[str, Any] | None
) -> None:
    found = held_out(*pairs)
    assert found.improvement_ci95() is None and json_or_null(improvement(found)) == shown


def test_verdicts_10_the_interval_holds_the_ratio_in_95_of_100_recordings() -> None:
    """Errors of 20 postures, before and after: half-normal, as those of an offset and of rests are."""
    random, held = np.random.default_rng(1), 0
    for _ in range(1000):
        before, after = np.abs(random.standard_normal((2, 20))) * [[30.0], [2.0]]
        by = ratio_uncertainty95(list(zip(before.tolist(), after.tolist(), strict=True)))
        assert by is not None
        held += 1 / by < (before.mean() / after.mean()) / 15 < by
    assert 925 < held < 975


def test_verdicts_10_it_stands_in_line_table_json_and_page(tmp_path: Path) -> None:
    """The line in a pipe, the table of a study, the report, its message, and the page."""
    good_raw(tmp_path)
    ran = run_process("study", tmp_path, "-d", tmp_path / "out", "--html")
    (line,) = ran.out.splitlines()
    (row,) = rows(tmp_path / "out")
    report = json.loads((tmp_path / "out" / "good.calibration.json").read_text())
    factor = report["holdout"]["improvement_factor"]
    low, high = factor["ci95"]
    assert low < factor["value"] < high
    columns = ("improvement_factor", "improvement_factor_low", "improvement_factor_high")
    assert [float(row[name]) for name in columns] == [factor["value"], low, high]
    fields = line.split("\t")
    assert float(fields[5]) == pytest.approx(100 * factor["value"], rel=0.005)
    error = report["calibration_error_mg"]
    better = report["probability"]["better_than_raw"]
    assert list(map(float, fields[7:])) == pytest.approx([error["mean"], *error["ci95"], better], abs=0.001)
    said = f"{factor['value']:.0f} times smaller (95 % interval {low:.0f} to {high:.0f})"
    assert said in report["message"] and said in (tmp_path / "out" / "good.html").read_text()
