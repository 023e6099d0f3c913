"""Which model? By held-out postures, with rules for what the points cannot hold."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import TemperatureScale
from accelcal_cli.core.errors import FixedPointOverflowError, Reason
from accelcal_cli.core.points import MODELS, Fit, Model, PointSet
from accelcal_cli.core.results import Coverage, Trial, sides_not_up
from accelcal_cli.core.settings import DEFAULT, Settings
from accelcal_cli.judge.errors import coverage, slope_information
from accelcal_cli.judge.model_ladder import (
    LADDER,
    FitFunction,
    Fitting,
    Sample,
    choose,
    not_eligible,
    postures,
    temperature_blocks,
    temperature_range_c,
    try_models,
)
from accelcal_cli.optimize import fixed32
from tests.judge.made import NINE, OFFSET, SIX, WARM, spread, trial
from tests.optimize.oracle import IDEAL, directions, fast_fit, fast_fits, measured, one_by_one, points


def evidence(held: PointSet) -> tuple[Sample, Coverage]:
    label = postures(held, DEFAULT.posture_degrees)
    sample = Sample(held, label, temperature_blocks(held, label, DEFAULT.temperature_block_c))
    return sample, coverage(held, label)


def trials_of(
    held: PointSet,
    settings: Settings = DEFAULT,
    fit: FitFunction = fast_fits,
    models: tuple[str, ...] = LADDER,
) -> dict[str, Trial]:
    return {item.model: item for item in try_models(*evidence(held), Fitting(settings, fit, models))}


def chosen(held: PointSet) -> str:
    return choose(try_models(*evidence(held), Fitting(DEFAULT, fixed32.fit_each))).model


@pytest.mark.parametrize(
    ("p", "warm", "model"),
    [
        (IDEAL, False, "0"), (OFFSET, False, "3"), (SIX, False, "6"), (NINE, False, "9"), (NINE, True, "9"),
        (WARM, True, "9T"),
    ],
    ids=["ideal", "offset", "scale", "misalignment", "constant temperature error", "slopes"],
)  # fmt: skip
@pytest.mark.parametrize("seeds", [3, pytest.param(12, marks=pytest.mark.nightly)])
def test_the_simplest_model_that_describes_the_sensor_is_chosen(
    p: np.ndarray, warm: bool, model: str, seeds: int
) -> None:
    picks = Counter(chosen(spread(p, seed=seed, warm=warm)) for seed in range(seeds))
    assert picks[model] > 0.8 * seeds, picks


def test_the_ladder_rises_by_number_of_parameters() -> None:
    assert set(LADDER) == set(MODELS)
    numbers = [len(MODELS[name].free) for name in LADDER]
    assert numbers == sorted(numbers)


@pytest.mark.parametrize(
    ("model", "warm", "tried"),
    [
        ("auto", False, ["0", "3", "6", "9"]), ("auto", True, ["0", "3", "6", "3T", "9", "6T", "9T"]),
        ("6", False, ["0", "6"]), ("9", True, ["0", "9", "9T"]), ("3", True, ["0", "3", "3T"]),
    ],
)  # fmt: skip
def test_the_identity_and_the_models_the_user_allows_are_tried(
    model: str, warm: bool, tried: list[str]
) -> None:
    held = spread(NINE, number=60, warm=warm)
    trials = trials_of(held, replace(DEFAULT, model=model)).values()
    assert [item.model for item in trials] == tried
    assert all(item.holdout is not None and item.reason is None for item in trials)


def one_sided() -> PointSet:
    d = directions(200)
    return points(measured(NINE, d[d[:, 0] > -0.1]))


def test_scale_needs_stillness_on_both_sides_of_every_axis() -> None:
    trials = trials_of(one_sided())
    for model in ("6", "9"):
        assert trials[model].holdout is None
        assert trials[model].reason == Reason.of("no_stillness_on_sides", sides=["-x"], reach_g=0.3)
    assert trials["3"].holdout is not None and trials["0"].holdout is not None


def test_a_model_the_user_insists_on_need_not_be_covered() -> None:
    insisted = replace(DEFAULT, model="9")
    assert not_eligible(*evidence(one_sided()), Fitting(insisted, fast_fits), MODELS["9"]) is None


def test_sides_without_points_are_named() -> None:
    seen = replace(
        coverage(spread(), np.zeros(150, np.int64)),
        axis_min_g=(-0.3, -0.29, -1.0),
        axis_max_g=(0.2, 0.3, 1.0),
    )
    assert sides_not_up(seen.axis_min_g, seen.axis_max_g, 0.3) == ["+x", "-y"]


def warm_points(degrees: float) -> PointSet:
    held = spread(NINE, number=60)
    tau = np.random.default_rng(2).permutation(np.linspace(-0.5, 0.5, 60)) * degrees / 4
    fixed = np.rint(tau * ONE).astype(np.int64)
    return PointSet(held.xyz, held.weights, held.windows, fixed, TemperatureScale(30_000, 4.0))


def test_the_range_of_temperatures_is_in_degrees() -> None:
    assert temperature_range_c(warm_points(2.5)) == pytest.approx(2.5)
    assert temperature_range_c(spread()) == 0
    assert temperature_range_c(warm_points(3.0).select(np.zeros(60, bool))) == 0


@pytest.mark.parametrize("model", ["auto", pytest.param("9", marks=pytest.mark.nightly)])
@pytest.mark.parametrize(("degrees", "tried"), [(1.9, False), (2.1, True)])
def test_slopes_need_a_range_of_temperatures(degrees: float, tried: bool, model: str) -> None:
    trials = trials_of(warm_points(degrees), replace(DEFAULT, model=model)).values()
    for item in trials:
        if item.model.endswith("T"):
            assert (item.holdout is not None) == tried
            even = Reason.of("temperature_too_even", range_c=degrees, least_c=2.0)
            assert item.reason == (None if tried else even)
        else:
            assert item.holdout is not None


@pytest.mark.parametrize("hot", [(7,), (7, 8)], ids=["one posture", "two"])
def test_slopes_need_more_than_one_hot_posture(hot: tuple[int, ...]) -> None:
    """5. of the hostile run: an ordinary glitch took 20 000 steps in each fold, half a minute in all."""
    held = spread(NINE, number=60)
    tau = np.zeros(60)
    tau[list(hot)] = 1.6, *[0.9] * (len(hot) - 1)
    fixed = np.rint((tau - tau.mean()) * ONE).astype(np.int64)
    glitched = PointSet(held.xyz, held.weights, held.windows, fixed, TemperatureScale(25_000, 64.0))
    steps: list[int] = []

    def counted(sets: Sequence[PointSet], model: Model) -> list[Fit]:
        found = fixed32.fit_each(sets, model)
        steps.extend(fit.iterations for fit in found)
        return found

    trials = trials_of(glitched, fit=counted)
    slopes = {name for name in trials if name.endswith("T")}
    assert {getattr(trials[name].reason, "code", None) for name in slopes} == {
        "few_orientations_differ_in_temperature"
    }
    assert all(trials[name].holdout is not None for name in trials.keys() - slopes)
    assert max(steps) < 500


def test_what_points_say_of_slopes_is_least_where_they_lie_in_a_plane() -> None:
    flat = points(np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]]))
    tau = np.array([1, -1, 1, -1]) * ONE // 2
    assert slope_information(replace(flat, tau=tau)) == pytest.approx(0, abs=1e-15)
    axes = points(np.repeat(np.eye(3), 2, axis=0))
    swing = np.array([1, -1, 2, -2, 3, -3]) * ONE // 4
    assert slope_information(replace(axes, tau=swing)) == pytest.approx(2 / 6 / 16)
    assert slope_information(replace(axes, tau=swing + ONE)) == pytest.approx(2 / 6 / 16)
    posture = np.array([1, 1, 0, 0, 0, 0]) * ONE
    assert slope_information(replace(axes, tau=posture)) == pytest.approx(0, abs=1e-15)
    assert slope_information(axes) == 0


def test_a_slope_that_follows_the_posture_is_not_believed() -> None:
    held = warm_points(2.5)
    order = np.argsort(held.xyz[:, 2])
    tau = np.empty_like(held.xyz[:, 2])
    tau[order] = np.sort(warm_points(2.5).tau)
    trials = trials_of(replace(held, tau=tau))
    assert trials["9"].holdout is not None
    assert trials["9T"].holdout is None
    assert trials["9T"].reason is not None and trials["9T"].reason.code == "uncertain_somewhere"


def test_points_in_a_plane_determine_nothing_across_it() -> None:
    turn = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    flat = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    noisy = measured(OFFSET, flat) + 0.001 * np.random.default_rng(1).standard_normal((60, 3))
    trials = trials_of(points(noisy))
    assert all(trials[name].holdout is None for name in ("3", "6", "9"))
    assert trials["3"].reason == Reason.of("no_stillness_along", axes=["z"], reach_g=0.3)


def test_an_offset_needs_one_side_of_an_axis() -> None:
    d = directions(200)
    above = points(measured(OFFSET, d[d[:, 2] > 0.1]))
    trials = trials_of(above)
    assert trials["3"].holdout is not None and trials["6"].holdout is None


def diverging(held: PointSet, model: Model) -> Fit:
    if model.name == "9":
        raise FixedPointOverflowError("a residual leaves the range")
    return fast_fit(held, model)


def test_a_model_whose_fit_diverges_is_not_eligible() -> None:
    trials = trials_of(spread(NINE), fit=one_by_one(diverging))
    assert trials["9"].holdout is None
    assert trials["9"].reason == Reason("fit_diverges")
    assert trials["6"].holdout is not None


@pytest.mark.parametrize(
    ("models", "reasons"),
    [
        (("0", "3", "6"), {"9": "misalignment", "3T": "temperature slopes", "9T": "misalignment"}),
        (("0", "6", "6T"), {"3": "model 3", "9": "misalignment", "3T": "model 3T"}),
    ],
)
def test_a_model_that_the_optimizer_does_not_fit_is_not_tried(
    models: tuple[str, ...], reasons: dict[str, str]
) -> None:
    trials = trials_of(warm_points(5.0), replace(DEFAULT, optimizer="some"), models=models)
    assert {name for name, item in trials.items() if item.holdout is not None} == set(models)
    for name, kind in reasons.items():
        assert trials[name].reason == Reason.of("optimizer_never_fits", optimizer="some", what=kind)


BEST = trial("9", [2.0, 2.0, 2.0, 2.0])


@pytest.mark.parametrize(
    ("simple", "model"),
    [
        ([2.0, 2.0, 2.0, 2.0], "6"), ([1.0, 3.5, 1.5, 2.5], "6"), ([3.0, 2.0, 2.0, 2.0], "6"),
        ([3.0, 3.0, 2.0, 2.0], "9"), ([2.1, 2.1, 2.1, 2.1], "9"), ([9.0, 8.0, 9.0, 8.0], "9"),
    ],
    ids=["equal", "within", "just one standard error", "beyond", "little but always", "much"],
)  # fmt: skip
def test_a_tie_goes_to_the_simpler_model(simple: list[float], model: str) -> None:
    # [1, 0, 0, 0]: mean 1/4, standard error sqrt(0.25 / 4) = 1/4; [1, 1, 0, 0]: 1/2 and 0.289
    trials = (trial("0", [20.0, 21.0, 20.0, 21.0]), trial("6", simple), BEST)
    assert choose(trials).model == model


def with_blocks(model: str, blocks: list[tuple[int, float]]) -> Trial:
    held = trial(model, [2.0, 2.0]).holdout
    assert held is not None
    return Trial(model, replace(held, blocks=tuple(blocks)), None)


def test_a_slope_counts_where_a_posture_was_held_at_several_temperatures() -> None:
    plain = with_blocks("9", [(0, 2.0), (0, 6.0), (1, 6.0), (1, 2.0), (2, 5.0)])
    slopes = with_blocks("9T", [(0, 2.0), (0, 2.0), (1, 2.0), (1, 2.0), (2, 2.0)])
    # mean difference 11/5; sums of deviations by posture -0.4, -0.4, 0.8: sqrt(3/2 0.96) / 5 = 0.24
    assert choose((plain, slopes)).model == "9T"


@pytest.mark.parametrize(("gained", "model"), [(0.64, "9"), (0.66, "9T")])
def test_many_temperatures_of_one_posture_count_as_one_posture(gained: float, model: str) -> None:
    plain = with_blocks("9", [(0, 4.0)] * 8 + [(1, 1.0), (2, 1.0), (3, 1.0)])
    warm = with_blocks("9T", [(0, 4.0 - gained)] * 8 + [(1, 1.56), (2, 1.56), (3, 1.56)])
    # mean m = (8 g - 3 e) / 11 with e = 0.56; its error 4 (e + m) / 11: a tie up to g = 65 e / 56 = 0.65,
    # where blocks that knew nothing of each other would have an error of half of that
    assert choose((plain, warm)).model == model


def test_a_better_simple_model_wins_outright() -> None:
    assert choose((trial("6", [1.0, 1.0]), trial("9", [2.0, 2.0]))).model == "6"


def test_models_that_were_not_eligible_are_never_chosen() -> None:
    out: Trial = trial("6", [0.0] * 4, reason="no stillness")
    assert choose((trial("0", [20.0] * 4), out, BEST)).model == "9"
