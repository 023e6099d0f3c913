"""A sensor does not know the names and signs of its axes, nor how its case is turned: the verdict stays."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accelcal_cli.core.points import PointSet
from accelcal_cli.core.results import Judgement
from accelcal_cli.core.settings import DEFAULT
from accelcal_cli.judge.model_ladder import Fitting
from accelcal_cli.judge.verdict import judge
from accelcal_cli.optimize import fixed32
from tests.cli.run import run
from tests.judge.test_bend import worn
from tests.optimize.oracle import points

TURN = np.array([[0.94, -0.342, 0.0], [0.342, 0.94, 0.0], [0.0, 0.0, 1.0]])
AXES = {
    "z x y": np.eye(3)[[2, 0, 1]],
    "y x z": np.eye(3)[[1, 0, 2]],
    "-x": np.diag([-1.0, 1, 1]),
    "-x -y -z": -np.eye(3),
    "turned by 20 degrees": TURN / np.linalg.norm(TURN[0, :2]),
}


def judged(held: PointSet) -> Judgement:
    return judge(held, Fitting(DEFAULT, fixed32.fit_each, penalized=fixed32.OPTIMIZER.fit_penalized))


@pytest.mark.parametrize("axes", AXES)
def test_other_names_and_signs_of_the_axes_change_no_verdict(axes: str) -> None:
    for seed in range(3):
        held, _, _ = worn(seed, 0.0, 25)
        one, other = judged(held), judged(points(held.xyz_g() @ AXES[axes].T))
        assert one.sphere is not None and other.sphere is not None
        assert other.outcome is one.outcome and other.reason.code == one.reason.code
        within = (
            0.15 if "turned" in axes else 0.05
        )  # what was scale is misalignment, which the prior knows less
        assert other.sphere.mean == pytest.approx(one.sphere.mean, rel=within)
        assert other.sphere.probably_better() == pytest.approx(one.sphere.probably_better(), abs=0.03)
        assert other.sphere.below_limit == pytest.approx(one.sphere.below_limit, abs=0.03)


@pytest.mark.parametrize("name", ["empatica_e4_32hz_2h.csv", "actigraph_gt3xplus_30hz_9h.csv.gz"])
def test_the_headline_of_real_recordings_stays_within_5_percent(
    real_data: Path, tmp_path: Path, name: str
) -> None:
    """Axes in another order, and another latitude by a degree; a latitude itself takes uncertainty off."""

    def headline(*words: object) -> float:
        path, out = real_data / "vendor" / name, tmp_path / str(len(list(tmp_path.iterdir())))
        assert run("calibrate", path, "-d", out, "-q", "--report-only", *words).code == 0
        (report,) = out.glob("*.calibration.json")
        found: dict[str, Any] = json.loads(report.read_text())
        return float(found["calibration_error_mg"]["mean"])

    usual, here = headline(), headline("--latitude", 47)
    assert here < usual
    for latitude in (46, 48):
        assert headline("--latitude", latitude) == pytest.approx(here, rel=0.05)
    if name.startswith("actigraph"):
        assert headline("--columns", "2,0,1") == pytest.approx(usual, rel=0.05)
