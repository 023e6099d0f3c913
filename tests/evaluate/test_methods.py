"""Every optimizer on the same points: sample recordings, and how far each is from the optimum."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.points import MODELS, PointSet
from accelcal_cli.core.settings import DEFAULT
from accelcal_cli.evaluate.methods import Row, collected, compare
from accelcal_cli.optimize import all_optimizers
from accelcal_cli.pipeline.calibrate import calibrate
from accelcal_cli.pipeline.jobs import Request, no_progress, plan
from tests.optimize.oracle import least_squares
from tests.optimize.test_contract import norms_mg
from tests.recordings import good_csv

SAMPLES = Path(__file__).resolve().parent.parent.parent / "sample_data"
RECORDINGS = ("recording.bin", "evening.csv.gz", "night.h5")
NINE = [item for item in all_optimizers() if "9" in item.models and item.name != "fixed16"]


@cache
def sample_points(name: str) -> PointSet:
    return collected(SAMPLES / name, ReadOptions(), DEFAULT, no_progress).result()


@pytest.mark.parametrize(
    "name", [RECORDINGS[0], *(pytest.param(name, marks=pytest.mark.nightly) for name in RECORDINGS[1:])]
)
@pytest.mark.parametrize("optimizer", NINE, ids=lambda item: item.name)
def test_nine_parameters_end_at_the_optimum_of_the_sample_recordings(optimizer, name: str) -> None:
    held, model = sample_points(name), MODELS["9"]
    best = least_squares(held, model.free)
    assert best.converged
    found = optimizer.fit(held, model, optimizer.settings["default"]).parameters
    exact = tuple(float(value) * (1 << 29) for value in best.p)
    assert np.abs(norms_mg(found, held) - norms_mg(exact, held)).max() < 0.02


def rows_of(path: Path, *names: str, settings=DEFAULT) -> list[Row]:
    return list(compare(path, ReadOptions(), settings, names, no_progress))


def test_the_default_s_row_is_what_calibrate_says(tmp_path: Path) -> None:
    path = good_csv(tmp_path)
    (row,) = rows_of(path, "fixed32")
    report = calibrate(
        plan([path], None, None)[0], Request(settings=replace(DEFAULT, prior="none"), report_only=True)
    ).report
    held, made = report["holdout"], report["calibration"]["optimizer"]
    assert (row.outcome, row.model) == (report["outcome"], report["calibration"]["model"])
    assert (row.points, row.postures) == (held["points"], held["postures"])
    assert row.before_mg == pytest.approx(held["before_mg"]["mean"], abs=1e-4)
    assert row.after_mg == pytest.approx(held["after_mg"]["mean"], abs=1e-4)
    assert row.improvement_percent == pytest.approx(held["improvement_percent"], abs=0.1)
    assert row.iterations == made["iterations"]
    assert {"additions": row.additions, "multiplications": row.multiplications} == made["operations"]
    assert row.seconds is not None and row.seconds > 0


def test_all_are_judged_by_the_same_hold_out(tmp_path: Path) -> None:
    rows = rows_of(good_csv(tmp_path), "ellipsoid", "gauss-newton", "closest-point")
    assert len({(row.points, row.postures, row.before_mg) for row in rows}) == 1
    assert [row.model for row in rows] == ["6", "9", "6"]
    assert rows[1].after_mg < min(rows[0].after_mg, rows[2].after_mg)
    assert all(row.additions is None for row in rows), "not counted is not zero"


def test_what_cannot_be_read_is_said(tmp_path: Path) -> None:
    with pytest.raises(UnreadableError):
        rows_of(tmp_path / "none.csv", "fixed32")
