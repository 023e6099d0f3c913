"""Outcomes and their reasons."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ONE, mean
from accelcal_cli.core.calibration import IDENTITY
from accelcal_cli.core.errors import Reason, significant
from accelcal_cli.core.points import MODELS, PointSet
from accelcal_cli.core.results import Judgement, Outcome, SphereError
from accelcal_cli.core.settings import DEFAULT, PAPER, Settings
from accelcal_cli.judge.errors import deviations_mg, per_posture, uncertainty
from accelcal_cli.judge.model_ladder import LADDER, FitFunction, Fitting, postures
from accelcal_cli.judge.posterior import outcome_by_probability
from accelcal_cli.judge.verdict import judge, judge_paper
from accelcal_cli.laboratory.optimizers.regressions import ELLIPSOID_MODELS, fit_ellipsoid
from accelcal_cli.optimize import fixed32
from accelcal_cli.output.numbers import mg
from accelcal_cli.output.sentences import sentence
from tests.judge.made import NINE, OFFSET, SIX, WARM, clusters, spread
from tests.optimize.oracle import (
    IDEAL,
    calibrated,
    directions,
    drawn_errors,
    fast_fit,
    fast_fits,
    measured,
    one_by_one,
    points,
    random_directions,
)

LADDER_ONLY = replace(DEFAULT, prior="none")
WITH_PRIOR = Fitting(DEFAULT, fixed32.fit_each, penalized=fixed32.OPTIMIZER.fit_penalized)
OFF_40 = 0.04 * np.eye(len(IDEAL))[6:9].sum(axis=0)
BELOW = Reason.of("no_stillness_on_sides", sides=["-z"], reach_g=0.3)
NO_MISALIGNMENT = Reason.of("optimizer_never_fits", optimizer="ellipsoid", what="misalignment")


def held_out_reason(code: str, found: Judgement, **values: object) -> Reason:
    """Return the reason with the errors of a verdict's hold-out."""
    assert found.holdout is not None
    before, after, number = found.holdout.before.mean, found.holdout.after.mean, found.holdout.postures
    errors = {"before_mg": before, "after_mg": after, "orientations": number, "held_out": "orientations"}
    factor = {"factor": before / after, "factor_ci95": found.holdout.improvement_ci95()}
    return Reason.of(code, **errors, **factor, **values)


def test_no_points_are_refused() -> None:
    found = judge(points(np.empty((0, 3))), Fitting(LADDER_ONLY, fast_fits))
    assert found.outcome is Outcome.REFUSED
    assert (found.reason, found.advice) == (Reason("nothing_still"), (Reason("record_longer"),))
    assert found.calibration is None and found.holdout is None and found.trials == ()


@pytest.mark.parametrize("number", [1, 8])
def test_too_few_postures_are_refused(number: int) -> None:
    held, _ = clusters(directions(number), NINE, width=0.02)
    found = judge(held, Fitting(LADDER_ONLY, fast_fits))
    assert found.outcome is Outcome.REFUSED
    assert found.reason == Reason.of("too_few_orientations", orientations=number, needed=9)
    assert found.advice == (Reason("record_longer"),)
    assert found.calibration is None and found.coverage.cells == len(held)


def test_nine_postures_are_enough() -> None:
    held, _ = clusters(directions(9), NINE, width=0.02)
    assert judge(held, Fitting(LADDER_ONLY, fast_fits)).trials


def test_a_misaligned_sensor_is_calibrated_with_all_evidence() -> None:
    held = spread(NINE)
    found = judge(held, Fitting(LADDER_ONLY, fixed32.fit_each))
    assert found.outcome is Outcome.CALIBRATED
    assert found.calibration is not None and found.fit is not None and found.fit_errors is not None
    assert found.calibration.model == "9" and found.calibration.temperature is None
    assert found.calibration.parameters == found.fit.parameters == fixed32.fit(held, MODELS["9"]).parameters
    assert np.abs(np.array(found.calibration.parameters) / ONE - NINE).max() < 2e-3
    chosen = next(trial for trial in found.trials if trial.model == "9")
    assert found.holdout == chosen.holdout
    known = uncertainty(held, found.fit.parameters, MODELS["9"])
    assert known is not None and found.standard_errors == known.standard_errors
    assert found.coverage.condition_number == known.condition_number
    assert found.coverage.worst_direction_mg == known.worst_direction_mg
    label = postures(held, 15.0)
    assert (found.fit_errors.points, found.fit_errors.postures) == (150, label.max() + 1)
    for p, value in (
        (IDENTITY, found.fit_errors.before_mg),
        (found.fit.parameters, found.fit_errors.after_mg),
    ):
        assert value == mean(list(per_posture(deviations_mg(held, p), held.weights, label).values()))
    assert found.reason == held_out_reason("calibrated_held_out", found, model="9", asked_for=False)


def test_a_sensor_that_warms_is_calibrated_with_slopes() -> None:
    held = spread(WARM, warm=True)
    found = judge(held, Fitting(LADDER_ONLY, fixed32.fit_each))
    assert (found.outcome, found.calibration is not None) == (Outcome.CALIBRATED, True)
    assert found.calibration.model == "9T" and found.calibration.temperature == held.temperature
    assert found.calibration.slope_g_per_c() == pytest.approx(WARM[9:] / 4.0, abs=5e-4)


@pytest.mark.parametrize(("p", "model"), [(OFFSET, "3"), (SIX, "6")])
def test_a_smaller_model_says_why(p: np.ndarray, model: str) -> None:
    found = judge(spread(p), Fitting(LADDER_ONLY, fast_fits))
    assert found.outcome is Outcome.REDUCED_MODEL
    assert found.calibration is not None and found.calibration.model == model
    left_out = "scale and misalignment" if model == "3" else "misalignment"
    assert found.reason == held_out_reason(
        "calibrated_in_part", found, model=model, asked_for=False, left_out=left_out, why=None
    )


def one_sided(p: np.ndarray, noise: float = 0.001) -> PointSet:
    d = directions(300)
    d = d[d[:, 2] > -0.1]
    return points(measured(p, d) + noise * np.random.default_rng(0).standard_normal(d.shape))


def test_a_model_reduced_by_coverage_names_the_missing_side() -> None:
    found = judge(one_sided(OFFSET), Fitting(LADDER_ONLY, fast_fits))
    assert found.outcome is Outcome.REDUCED_MODEL
    assert found.reason.code == "calibrated_in_part"
    assert found.reason.values["left_out"] == "scale and misalignment"
    assert found.reason.values["why"] == BELOW.as_json()


def test_a_good_sensor_is_left_alone() -> None:
    found = judge(spread(IDEAL), Fitting(LADDER_ONLY, fast_fits))
    assert found.outcome is Outcome.ALREADY_GOOD
    assert found.calibration is not None and found.calibration.parameters == IDENTITY
    assert found.reason == held_out_reason("raw_no_worse", found)


def test_with_a_prior_too_a_good_sensor_keeps_its_values_and_its_error_is_that_of_these() -> None:
    found = judge(spread(IDEAL), Fitting(DEFAULT, fast_fits, penalized=fixed32.OPTIMIZER.fit_penalized))
    assert found.outcome is Outcome.ALREADY_GOOD
    assert found.calibration is not None and found.calibration.parameters == IDENTITY
    assert found.holdout is not None and found.holdout == found.trials[0].holdout
    assert found.sphere is not None and found.sphere_before is not None
    assert found.sphere.mean == found.sphere_before.mean and 0 < found.sphere.probably_better() < 0.8
    values = found.reason.values
    assert found.reason.code == "not_clearly_better" and values["percent"] < 80
    assert found.holdout.before == found.holdout.after
    assert values["raw_mg"] == significant(found.sphere_before.mean)
    text = sentence(found.reason)
    assert f"a probability of only {values['percent']:.0f} %" in text
    assert f"{mg(values['raw_mg'])} mg before, {mg(values['error_mg'])} mg after" in text


def test_a_sensor_that_nothing_helps_is_refused() -> None:
    noisy = spread(IDEAL, noise=0.06)
    found = judge(noisy, Fitting(LADDER_ONLY, fast_fits))
    assert found.outcome is Outcome.REFUSED
    assert found.calibration is None and found.holdout is not None
    assert found.reason == held_out_reason("raw_no_worse", found)
    assert found.advice == (Reason("record_longer"),)


def test_rests_that_scatter_more_than_rest_does_are_told() -> None:
    found = judge(spread(NINE, noise=0.03, seed=4), WITH_PRIOR)
    assert found.calibration is not None and found.rest_scatter_mg is not None
    assert found.rest_scatter_mg == pytest.approx(1000 * 0.03 * np.sqrt(2 / np.pi), rel=0.2)
    assert [one.code for one in found.cautions] == ["scatter_over_limit"]
    assert not judge(spread(NINE, noise=0.001, seed=4), WITH_PRIOR).cautions


def test_postures_that_disagree_are_not_told_to_be_more() -> None:
    found = judge(spread(NINE, noise=0.06, seed=4), WITH_PRIOR)
    assert found.outcome is Outcome.PROVISIONAL
    (advice,) = found.advice
    assert advice.code == "orientations_disagree"
    assert advice.values["orientations"] == found.coverage.distinct_orientations
    assert advice.values["by_mg"] == significant(found.rest_scatter_mg)


@pytest.mark.parametrize(("seed", "number"), [(10, 12), (110, 11), (137, 10)])
def test_verdicts_3_extrapolated_errors_are_no_disagreement(seed: int, number: int) -> None:
    """Rests that scatter by 2.5 mg on a belt: held out, each is as far off as the others leave open."""
    random = np.random.default_rng(seed)
    assert random.integers(9, 13) == number
    poses = random_directions(random, number) * [1, 1, 0.35]
    poses /= np.linalg.norm(poses, axis=1)[:, None]
    poses *= 1 + 0.0025 * random.standard_normal((number, 1))
    found = judge(points(measured(drawn_errors(random), poses)), WITH_PRIOR)
    assert found.outcome is Outcome.PROVISIONAL and found.holdout is not None
    assert found.holdout.after.mean > 5 and found.rest_scatter_mg is not None and found.rest_scatter_mg < 4
    assert [one.code for one in found.advice] == ["record_longer"]


def few(sensor: np.ndarray, number: int = 4) -> PointSet:
    """Postures about +x, +y and +z, with 1 mg of scatter."""
    poses = directions(200)
    poses = poses[(poses.min(axis=1) > 0)][:: max(1, 24 // number)][:number]
    scatter = 1 + 0.001 * np.random.default_rng(2).standard_normal((len(poses), 1))
    return points(measured(sensor, poses * scatter))


def test_verdicts_1_coefficients_that_beat_raw_values_are_given_with_a_warning() -> None:
    """40 mg of offset, one side of the sphere: more than 10 mg is left, of 40, and that is known."""
    held = few(IDEAL + OFF_40)
    found = judge(held, WITH_PRIOR)
    assert found.outcome is Outcome.PROVISIONAL and found.calibration is not None
    assert found.sphere is not None and found.sphere_before is not None and found.penalty is not None
    assert found.sphere.probably_better() >= 0.95
    assert found.reason.code == "provisional" and found.reason.values["percent"] >= 95
    assert found.advice == (
        Reason.of("more_orientations", orientations=found.coverage.distinct_orientations),
    )
    assert found.calibration == found.candidate


def test_two_probabilities_decide() -> None:
    """That it is better than raw values, everywhere and where worn, and that it is within the limit."""
    far = SphereError(12.0, (5.0, 30.0), 20.0, (0, 0, 1))
    for everywhere, worn, below, raw_below, outcome in (
        (0.9, 0.95, 0.9, 0.0, Outcome.CALIBRATED),
        (0.95, 0.9, 0.89, 0.0, Outcome.PROVISIONAL),
        (0.89, 1.0, 1.0, 0.0, Outcome.PROVISIONAL),
        (0.8, 0.8, 0.0, 1.0, Outcome.PROVISIONAL),
        (1.0, 0.79, 1.0, 0.79, Outcome.REFUSED),
        (0.79, 1.0, 1.0, 0.8, Outcome.ALREADY_GOOD),
    ):
        fit = replace(far, better_everywhere=everywhere, better_where_worn=worn, below_limit=below)
        assert outcome_by_probability(fit, replace(far, below_limit=raw_below)) is outcome


def test_verdicts_6_the_limit_is_held_against_the_error_without_the_scatter_of_rests() -> None:
    """Counts of 1/16 g: rests are 18 mg off, their mean error in 60 directions a few."""
    fine = measured(NINE, directions(60))
    found = judge(points(np.rint(16 * fine) / 16), WITH_PRIOR)
    assert found.outcome is Outcome.CALIBRATED and found.sphere is not None
    assert found.rest_scatter_mg is not None and found.sphere.mean < 10 < found.rest_scatter_mg


def test_verdicts_5_a_sensor_that_is_far_off_is_noted() -> None:
    far = IDEAL.copy()
    far[[0, 7]] += (0.05, 0.1)
    (note,) = judge(few(far, 12), WITH_PRIOR).notes
    assert note.code == "unlike_most_sensors" and "oy" in note.values["parameters"]
    assert not judge(few(IDEAL + OFF_40), WITH_PRIOR).notes


def test_an_error_above_the_limit_is_refused_with_the_figure() -> None:
    scaled = np.array([0.85, 0.85, 0.85, 0, 0, 0, 0, 0, 0, 0, 0, 0])
    found = judge(spread(scaled, noise=0.03), Fitting(LADDER_ONLY, fast_fits))
    assert found.outcome is Outcome.REFUSED and found.calibration is None
    assert found.holdout is not None and found.holdout.after.mean >= 10
    assert found.reason == held_out_reason(
        "held_out_error_over_limit", found, model=found.reason.values["model"], asked_for=False, limit_mg=10.0
    )
    lenient = judge(spread(scaled, noise=0.03), Fitting(replace(LADDER_ONLY, max_error_mg=60.0), fast_fits))
    assert lenient.calibration is not None


def test_a_refusal_names_the_sides_that_are_missing() -> None:
    found = judge(one_sided(IDEAL, noise=0.06), Fitting(LADDER_ONLY, fast_fits))
    assert found.outcome is Outcome.REFUSED
    assert found.advice == (Reason.of("rest_on_sides", sides=["-z"]),)


@pytest.mark.parametrize("model", ["3", "6", "9"])
def test_a_model_can_be_forced(model: str) -> None:
    found = judge(spread(NINE), Fitting(replace(LADDER_ONLY, model=model, max_error_mg=50.0), fast_fits))
    assert found.calibration is not None and found.calibration.model == model
    assert (found.reason.values["model"], found.reason.values["asked_for"]) == (model, True)
    assert [trial.model for trial in found.trials] == ["0", model]
    assert found.outcome is (Outcome.CALIBRATED if model == "9" else Outcome.REDUCED_MODEL)


def test_a_forced_model_that_does_not_improve_is_refused() -> None:
    found = judge(spread(IDEAL, number=40, noise=0.005), Fitting(replace(LADDER_ONLY, model="9"), fast_fits))
    assert found.outcome is Outcome.REFUSED and found.calibration is None
    assert found.reason == held_out_reason("not_better", found, model="9", asked_for=True)


def overflowing() -> PointSet:
    v = measured(NINE, directions(60))
    v[5] *= 1.6
    return points(v)


def test_points_out_of_range_are_no_traceback_but_a_reason() -> None:
    found = judge(overflowing(), Fitting(LADDER_ONLY, fixed32.fit_each))
    reasons = {trial.model: trial.reason for trial in found.trials}
    assert reasons["9"] == Reason("fit_diverges")
    forced = judge(overflowing(), Fitting(replace(LADDER_ONLY, model="9"), fixed32.fit_each))
    assert forced.outcome is Outcome.REFUSED
    assert forced.reason == Reason.of("model_not_fitted", model="9", why=Reason("fit_diverges"))


def test_a_verdict_can_be_repeated() -> None:
    assert judge(spread(NINE), Fitting(LADDER_ONLY, fixed32.fit_each)) == judge(
        spread(NINE), Fitting(LADDER_ONLY, fixed32.fit_each)
    )


FULL: tuple[list[str], list[str]] = ([], [])
"""Subsets that are missing in two sets of which none is."""


def two_sets(p: np.ndarray) -> tuple[PointSet, PointSet]:
    random = np.random.default_rng(4)
    v = measured(p, random_directions(random, 36)) + 0.001 * random.standard_normal((36, 3))
    return points(v[:18]), points(v[18:])


def by_paper(settings: Settings, fit: FitFunction = fast_fits, models: tuple[str, ...] = LADDER) -> Fitting:
    """How profile `paper` fits and judges."""
    return Fitting(settings, fit, models, judging=fixed32.OPTIMIZER.fit_penalized)


def test_the_paper_needs_every_subset() -> None:
    fitted, control = two_sets(NINE)
    found = judge_paper(fitted, control, (["x -1 g", "z 0 g"], ["x +1 g"]), by_paper(PAPER))
    assert found.outcome is Outcome.REFUSED and found.calibration is None
    assert found.reason.code == "subsets_not_full"
    assert found.reason.values == {"of": "fit", "subsets": ["x -1 g", "z 0 g"], "points": 2, "apart_g": 0.2}
    assert [one.code for one in found.advice] == ["use_default_profile", "record_longer"]


def test_verdicts_9_a_second_set_that_is_not_full_is_judged_by_what_both_sets_leave_open() -> None:
    """A few control points see a few directions only: 3 of them claimed 0.4 mg where 2.2 mg were true."""
    fitted, control = two_sets(NINE)
    p = fast_fit(fitted, MODELS["9"]).parameters
    left = calibrated(np.array(p) / ONE, measured(NINE, directions(500)))
    truth = 1000 * float(np.abs(np.linalg.norm(left, axis=1) - 1).mean())
    for number, outcome in ((1, Outcome.REFUSED), (2, Outcome.CALIBRATED), (8, Outcome.CALIBRATED)):
        few = control.select(np.arange(number))
        found = judge_paper(fitted, few, ([], ["x +1 g"]), by_paper(PAPER))
        assert found.outcome is outcome
        if outcome is Outcome.CALIBRATED:
            assert found.sphere is not None and found.holdout is not None and found.sphere_before is not None
            assert truth < found.sphere.ci95[1] < 10 * truth < found.sphere_before.mean


def test_the_paper_fits_nine_parameters_and_judges_by_the_second_set() -> None:
    fitted, control = two_sets(NINE)
    found = judge_paper(fitted, control, FULL, by_paper(PAPER))
    assert found.outcome is Outcome.CALIBRATED
    assert found.calibration is not None and found.holdout is not None
    p = fast_fit(fitted, MODELS["9"]).parameters
    assert found.calibration.parameters == p and found.calibration.model == "9"
    assert found.holdout.after.mean == pytest.approx(float(deviations_mg(control, p).mean()))
    assert found.holdout.before.mean == pytest.approx(float(deviations_mg(control, IDENTITY).mean()))
    assert found.holdout.points == 18 and found.reason.code == "calibrated"
    assert found.reason.values["held_out"] == "control points"


def test_point_1_the_paper_s_fit_is_refused_where_it_is_uncertain_somewhere_on_the_sphere() -> None:
    """Control points beside the fitted ones agree with them, and say nothing of the rest of the sphere."""
    held, _ = clusters(directions(6), NINE, each=6, width=0.02)
    fitted, control = held.select(np.arange(0, 36, 2)), held.select(np.arange(1, 36, 2))
    p = fast_fit(fitted, MODELS["9"]).parameters
    known = uncertainty(fitted, p, MODELS["9"])
    assert known is not None and known.worst_direction_mg > 10 > 10 * deviations_mg(control, p).mean()
    found = judge_paper(fitted, control, FULL, by_paper(PAPER))
    assert found.outcome is Outcome.REFUSED
    assert found.calibration is None and found.holdout is None
    worst = Reason.of("uncertain_somewhere", by_mg=known.worst_direction_mg)
    assert found.reason == Reason.of("model_uncertain", model="9", why=worst)
    assert [one.code for one in found.advice] == ["use_default_profile"], "its sets are full"
    assert [trial.reason for trial in found.trials] == [worst]
    assert found.coverage.worst_direction_mg == known.worst_direction_mg
    assert (found.coverage.cells, found.coverage.distinct_orientations) == (18, 6)
    limit = replace(PAPER, max_error_mg=known.worst_direction_mg)
    assert judge_paper(fitted, control, FULL, by_paper(limit)).outcome is Outcome.REFUSED, "from the limit on"
    limit = replace(PAPER, max_error_mg=known.worst_direction_mg * 1.001)
    assert judge_paper(fitted, control, FULL, by_paper(limit)).outcome is Outcome.CALIBRATED


def test_an_optimizer_without_misalignment_gives_a_reduced_model_and_says_why() -> None:
    settings, fit = replace(LADDER_ONLY, optimizer="ellipsoid"), one_by_one(fit_ellipsoid)
    found = judge(spread(NINE), Fitting(replace(settings, max_error_mg=50.0), fit, ELLIPSOID_MODELS))
    assert found.outcome is Outcome.REDUCED_MODEL
    assert found.reason.code == "calibrated_in_part" and found.reason.values["left_out"] == "misalignment"
    assert found.reason.values["why"] == NO_MISALIGNMENT.as_json()
    forced = judge(spread(NINE), Fitting(replace(settings, model="9"), fit, ELLIPSOID_MODELS))
    assert forced.outcome is Outcome.REFUSED
    assert forced.reason == Reason.of("model_not_fitted", model="9", why=NO_MISALIGNMENT)


def test_the_paper_s_points_are_fitted_by_six_parameters_where_nine_are_not_to_be_had() -> None:
    fitted, control = two_sets(NINE)
    settings = replace(PAPER, optimizer="ellipsoid", max_error_mg=50.0)
    found = judge_paper(
        fitted, control, FULL, by_paper(settings, one_by_one(fit_ellipsoid), ELLIPSOID_MODELS)
    )
    assert found.outcome is Outcome.REDUCED_MODEL
    assert found.calibration is not None and found.calibration.model == "6"
    assert found.trials[1].reason == NO_MISALIGNMENT


def test_a_sensor_that_no_model_could_be_tried_on_is_not_called_good() -> None:
    turn = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    flat = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    found = judge(points(flat), Fitting(LADDER_ONLY, fast_fits))
    assert found.outcome is Outcome.REFUSED
    across = Reason.of("no_stillness_along", axes=["z"], reach_g=0.3)
    assert found.reason == Reason.of("no_model_tried", why=across)


def test_postures_that_are_known_are_taken_as_they_are() -> None:
    held = spread(NINE)
    label = np.arange(len(held), dtype=np.int64) % 12
    found = judge(held, Fitting(LADDER_ONLY, fast_fits), label=label)
    assert found.holdout is not None and found.holdout.postures == 12
    few = judge(held, Fitting(LADDER_ONLY, fast_fits), label=label % 3)
    assert few.reason == Reason.of("too_few_orientations", orientations=3, needed=9)


def test_results_are_in_standard_g_where_the_place_is_known() -> None:
    place = replace(LADDER_ONLY, latitude=0.0, altitude_m=2000.0)
    g = float(place.gravity.local_g())
    d = directions(150)
    standard = points(measured(NINE, d * g) + 0.001 * np.random.default_rng(3).standard_normal(d.shape))
    local = PointSet(np.rint(standard.xyz / g).astype(np.int64), standard.weights, standard.windows)
    found, plain = (
        judge(local, Fitting(place, fixed32.fit_each)),
        judge(local, Fitting(LADDER_ONLY, fixed32.fit_each)),
    )
    assert found.calibration is not None and plain.calibration is not None
    assert found.calibration.gravity == place.gravity
    assert np.array_equal(found.calibration.gain(), plain.calibration.gain())
    assert found.calibration.offset_g() == pytest.approx(plain.calibration.offset_g() * g, abs=2**-29)
    calibrated = (standard.xyz_g() + found.calibration.offset_g()) @ found.calibration.gain().T
    assert np.abs(np.linalg.norm(calibrated, axis=1) / g - 1).mean() < 0.0012
    assert np.abs(found.calibration.offset_g() - NINE[6:9]).max() < 1e-3
