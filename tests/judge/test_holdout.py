"""Held-out error: whole postures, and what a random hold-out would hide."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.collect.cells import CellCollector
from accelcal_cli.collect.table import read_table, windows_of
from accelcal_cli.core.arithmetic import ONE, interval95, mean
from accelcal_cli.core.calibration import IDENTITY
from accelcal_cli.core.points import MODELS, Fit, Model, PointSet
from accelcal_cli.core.prior import POPULATION
from accelcal_cli.core.results import Holdout
from accelcal_cli.core.settings import DEFAULT
from accelcal_cli.judge.errors import deviations_mg, per_posture, summary
from accelcal_cli.judge.model_ladder import FitFunction, Sample, control, folds, postures
from accelcal_cli.judge.model_ladder import blocked as blocked_sample
from accelcal_cli.judge.posterior import posterior
from accelcal_cli.optimize import fixed32
from accelcal_cli.pipeline.procedures import CellProcedure
from tests.judge.made import NINE, clusters, four_postures, spread
from tests.optimize.oracle import fast_fit, fast_fits, one_by_one, points

NINE_FREE = MODELS["9"]


def blocked(held: PointSet, label: np.ndarray, model: Model, fit: FitFunction, number: int) -> Holdout:
    return blocked_sample(Sample(held, label, label), model, fit, number)[0]


def test_every_fold_is_judged_by_a_fit_of_the_others() -> None:
    held = spread(NINE, number=60)
    label = postures(held, 20.0)
    seen_sets: list[set[bytes]] = []

    def fit(seen: PointSet, model: Model) -> Fit:
        seen_sets.append({row.tobytes() for row in seen.xyz})
        return fast_fit(seen, model)

    _, whole = blocked_sample(Sample(held, label, label), NINE_FREE, one_by_one(fit), 5)
    assert whole == fast_fit(held, NINE_FREE)
    fold = folds(label, 5)
    everything = {row.tobytes() for row in held.xyz}
    *left_out, none = [everything - seen for seen in seen_sets]
    assert none == set()
    assert left_out == [{row.tobytes() for row in held.xyz[fold == number]} for number in range(5)]


def test_figures_are_those_of_a_plain_computation() -> None:
    held = spread(NINE, number=60)
    label = postures(held, 20.0)
    found = blocked(held, label, NINE_FREE, fast_fits, 4)
    after: dict[int, float] = {}
    for number in range(4):
        out = label % 4 == number
        p = fast_fit(held.select(~out), NINE_FREE).parameters
        after |= per_posture(deviations_mg(held, p)[out], held.weights[out], label[out])
    before = per_posture(deviations_mg(held, IDENTITY), held.weights, label)
    values = [after[k] for k in sorted(after)]
    assert found.per_posture == tuple((before[k], after[k]) for k in sorted(after))
    assert (found.points, found.postures) == (60, label.max() + 1)
    assert found.before == summary(list(before.values())) and found.after == summary(values)
    assert found.ci95 == interval95(values)
    assert found.method == "4 folds of whole postures"


def test_every_posture_counts_the_same_however_many_points_it_has() -> None:
    g = np.array([[1.0, 0, 0]] * 50 + [[0, 1.1, 0], [0, 0, 1.2]])
    found = blocked(points(g), np.array([0] * 50 + [1, 2]), MODELS["0"], fast_fits, 3)
    assert found.before.mean == found.after.mean == pytest.approx(100, abs=1e-3)


def test_the_identity_changes_nothing() -> None:
    held = spread(NINE)
    found = blocked(held, postures(held, 15.0), MODELS["0"], fixed32.fit_each, 5)
    assert found.before == found.after


def test_held_out_error_is_honest_about_known_errors() -> None:
    held = spread(NINE, noise=0.002)
    found = blocked(held, postures(held, 15.0), NINE_FREE, fixed32.fit_each, 5)
    assert found.before.mean > 15
    assert 1.2 < found.after.mean < 2.2, "2 mg of noise leave 1.6 mg of mean error"
    assert found.ci95[0] < found.after.mean < found.ci95[1]


def test_four_postures_look_perfect_on_a_random_hold_out_alone() -> None:
    naive, honest = [], []
    for seed in range(4):
        held, which = clusters(four_postures(seed), NINE, seed=seed)
        random = np.random.default_rng(seed).permutation(len(held))
        naive.append(blocked(held, random, NINE_FREE, fast_fits, 5).after.mean)
        honest.append(blocked(held, which, NINE_FREE, fast_fits, 5).after.mean)
    assert max(naive) < 2, "neighbours of every held-out point are in the fit"
    assert np.mean(honest) > 10 and np.median(honest) > 5 * np.median(naive)


def test_the_control_set_is_judged_point_by_point() -> None:
    held = points(np.array([[1.01, 0, 0], [0, 0.98, 0], [0, 0, 1.03]]))
    parameters = (ONE, ONE, ONE, 0, 0, 0, round(-0.01 * ONE), 0, 0, 0, 0, 0)
    found = control(held, parameters)
    assert (found.points, found.postures) == (3, 3)
    assert found.before.mean == pytest.approx(20, abs=1e-4)
    assert [pair[0] for pair in found.per_posture] == pytest.approx([10, 20, 30], abs=1e-4)
    # the offset also tilts the other two by 0.01 g: sqrt(0.98^2 + 0.01^2), sqrt(1.03^2 + 0.01^2)
    assert [pair[1] for pair in found.per_posture] == pytest.approx([0, 19.949, 30.0485], abs=1e-3)
    assert found.method.startswith("control points")


def test_one_posture_is_judged_by_a_fit_of_nothing() -> None:
    held = points(np.array([[1.02, 0, 0], [1.0, 0.01, 0]]))
    found = blocked(held, np.zeros(2, np.int64), NINE_FREE, fixed32.fit_each, 5)
    assert found.before == found.after
    assert found.ci95 == (0.0, float("inf"))


GUARD_DEGREES = 5.0


def guarded(held: PointSet, label: np.ndarray, fit: FitFunction) -> list[float]:
    """Held-out errors of postures whose fits have no point within 5 degrees of one that was left out."""
    unit = held.xyz_g() / np.linalg.norm(held.xyz_g(), axis=1, keepdims=True)
    errors = np.empty(len(held))
    for fold in range(5):
        out = label % 5 == fold
        near = (unit @ unit[out].T).max(axis=1) > np.cos(np.radians(GUARD_DEGREES))
        (fitted,) = fit([held.select(~out & ~near)], NINE_FREE)
        errors[out] = deviations_mg(held.select(out), fitted.parameters)
    return list(per_posture(errors, held.weights, label).values())


def assert_a_band_changes_little(held: PointSet) -> None:
    """The mean changes by less than half of the distance to the end of its 95 % interval."""
    assert fixed32.OPTIMIZER.fit_penalized is not None
    label = postures(held, 15.0)
    known = posterior(held, label.max() + 1, NINE_FREE, POPULATION, fixed32.OPTIMIZER.fit_penalized)
    fit = known.fitter(fixed32.OPTIMIZER.fit_penalized)
    found = blocked(held, label, NINE_FREE, fit, 5)
    change_mg = mean(guarded(held, label, fit)) - found.after.mean
    assert 0 < abs(change_mg) < (found.ci95[1] - found.after.mean) / 2


@pytest.mark.parametrize("seed", range(4))
def test_verdicts_7_a_guard_band_of_5_degrees_changes_less_than_the_interval(seed: int) -> None:
    assert_a_band_changes_little(spread(NINE, number=2400, noise=0.003, seed=seed))


def test_verdicts_7_a_guard_band_changes_less_than_the_interval_on_a_wrist(real_data: Path) -> None:
    table = read_table(real_data / "points" / "geneactiv_84h_points.csv.gz")
    collector = CellCollector(table.lsb_per_g, DEFAULT, temperature=False)
    collector.add(windows_of(table))
    assert_a_band_changes_little(CellProcedure(collector).result())
