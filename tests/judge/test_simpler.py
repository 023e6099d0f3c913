"""What the points of a calibration give without misalignment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import in_standard_g
from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.gravity import Gravity
from accelcal_cli.core.points import MODELS, Fit, Model, PointSet
from accelcal_cli.core.results import Judgement, Outcome
from accelcal_cli.core.settings import DEFAULT, PAPER
from accelcal_cli.judge.errors import deviations_mg
from accelcal_cli.judge.model_ladder import Fitting, postures
from accelcal_cli.judge.verdict import judge, judge_paper
from accelcal_cli.optimize import fixed32
from tests.judge.made import NINE, SIX, WARM, spread
from tests.optimize.oracle import directions, fast_fit, fast_fits, measured, points

PENALIZED = fixed32.OPTIMIZER.fit_penalized
LADDER_ONLY = replace(DEFAULT, prior="none")


def least_squares(held: PointSet, start: np.ndarray) -> np.ndarray:
    """Scales and offsets that minimise the sum of (|a|^2 - 1)^2 of equal points, by Gauss-Newton."""
    p = start.copy()
    v = held.xyz_g()
    for _ in range(30):
        u = v + p[3:]
        rows = np.hstack([2 * p[:3] * u**2, 2 * p[:3] ** 2 * u])
        p -= np.linalg.lstsq(rows, ((p[:3] * u) ** 2).sum(axis=1) - 1, rcond=None)[0]
    return p


def with_prior(held: PointSet, **settings: object) -> Judgement:
    return judge(held, Fitting(replace(DEFAULT, **settings), fast_fits, penalized=PENALIZED))


def test_with_a_prior_it_is_all_but_the_least_squares_of_the_same_points() -> None:
    held = spread(NINE)
    found = with_prior(held).without_misalignment
    assert found is not None and found.calibration.model == "6"
    assert found.calibration.parameters[3:6] == (0, 0, 0) and found.calibration.temperature is None
    mine = np.array(found.calibration.parameters)[[0, 1, 2, 6, 7, 8]] / ONE
    assert np.abs(mine - least_squares(held, np.array([1.0, 1, 1, 0, 0, 0]))).max() < 1e-3


def test_it_is_better_than_the_calibration_cut_down_to_its_diagonal() -> None:
    held = spread(NINE)
    verdict = with_prior(held)
    assert verdict.fit is not None and verdict.without_misalignment is not None
    p = verdict.fit.parameters
    cut = (*p[:3], 0, 0, 0, *p[6:])
    fitted = (*verdict.without_misalignment.calibration.parameters[:9], 0, 0, 0)
    squares = [np.square(deviations_mg(held, one)).mean() for one in (fitted, cut)]
    assert squares[0] < squares[1]


def test_it_is_held_out_on_the_same_postures_and_its_error_is_the_larger() -> None:
    verdict = with_prior(spread(NINE))
    found = verdict.without_misalignment
    assert found is not None and verdict.holdout is not None and found.holdout is not None
    assert found.holdout.method == verdict.holdout.method
    pairs = zip(found.holdout.per_posture, verdict.holdout.per_posture, strict=True)
    assert all(one[0] == other[0] for one, other in pairs)
    assert found.holdout.after.mean > 3 * verdict.holdout.after.mean
    assert found.sphere is not None and verdict.sphere is not None
    assert found.sphere.mean > 3 * verdict.sphere.mean


def test_slopes_stay() -> None:
    held = spread(WARM, warm=True)
    verdict = with_prior(held)
    found = verdict.without_misalignment
    assert verdict.calibration is not None and verdict.calibration.model == "9T" and found is not None
    assert found.calibration.model == "6T" and found.calibration.temperature == held.temperature
    assert found.calibration.slope_g_per_c() == pytest.approx(WARM[9:] / 4.0, abs=2e-3)


def test_without_a_prior_it_is_what_the_ladder_tried() -> None:
    held = spread(NINE)
    verdict = judge(held, Fitting(LADDER_ONLY, fixed32.fit_each))
    found, tried = verdict.without_misalignment, {trial.model: trial for trial in verdict.trials}
    assert found is not None and tried["6"].fit is not None
    assert found.calibration.parameters == tried["6"].fit.parameters and found.sphere is None
    assert found.calibration.parameters == fixed32.fit(held, MODELS["6"]).parameters
    assert found.holdout == tried["6"].holdout


def test_where_the_ladder_did_not_try_it_it_is_fitted_all_the_same() -> None:
    held = spread(NINE)
    whole = judge(held, Fitting(LADDER_ONLY, fixed32.fit_each)).without_misalignment
    forced = judge(held, Fitting(replace(LADDER_ONLY, model="9"), fixed32.fit_each))
    assert "6" not in {trial.model for trial in forced.trials}
    assert forced.without_misalignment == whole is not None


def test_what_has_no_misalignment_has_nothing_beside_it() -> None:
    found = judge(spread(SIX), Fitting(LADDER_ONLY, fast_fits))
    assert found.outcome is Outcome.REDUCED_MODEL and found.without_misalignment is None


@pytest.mark.parametrize("models", [("9",), ("0", "6", "9")])
def test_where_it_cannot_be_fitted_there_is_none(models: tuple[str, ...]) -> None:
    def fits(sets: Sequence[PointSet], model: Model) -> list[Fit]:
        if model.name == "6":
            raise DivergedError("it diverges")
        return fast_fits(sets, model)

    found = judge(spread(NINE), Fitting(LADDER_ONLY, fits, models))
    assert found.outcome is Outcome.CALIBRATED and found.without_misalignment is None


def test_it_is_in_standard_g_too() -> None:
    held, local = spread(NINE), Gravity(60.0, 200.0)
    found = with_prior(held).without_misalignment
    there = with_prior(held, latitude=60.0, altitude_m=200.0).without_misalignment
    assert found is not None and there is not None and local.local_g() != Fraction(1)
    assert there.calibration.gravity == local
    assert there.calibration.parameters == in_standard_g(found.calibration.parameters, local.local_g())


def test_profile_paper_judges_it_on_its_second_set() -> None:
    first, second = (points(measured(NINE, directions(number))) for number in (18, 17))
    verdict = judge_paper(first, second, ([], []), Fitting(PAPER, fast_fits, judging=PENALIZED))
    found = verdict.without_misalignment
    assert verdict.calibration is not None and verdict.calibration.model == "9"
    assert found is not None and found.holdout is not None and verdict.holdout is not None
    assert found.calibration.parameters == fast_fit(first, MODELS["6"]).parameters
    assert (found.holdout.method, found.holdout.points) == (verdict.holdout.method, 17)
    assert found.holdout.after.mean > verdict.holdout.after.mean
    assert found.holdout.postures == len(postures(second, 0.1))
