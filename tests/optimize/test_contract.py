"""What every optimizer must do; a new file in either of their folders is taken in by itself."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import LIMIT, ONE
from accelcal_cli.core.calibration import IDENTITY
from accelcal_cli.core.errors import DivergedError, UsageError
from accelcal_cli.core.points import MODELS, WEIGHT_ONE, Fit, Optimizer, PointSet
from accelcal_cli.core.settings import PROFILES
from accelcal_cli.optimize import all_optimizers, named_optimizer
from tests.optimize.oracle import calibrated, directions, fast_fit, measured, points

TRUE = np.array([1.04, 0.97, 1.02, 0.012, -0.02, 0.008, 0.03, -0.05, 0.02, 0, 0, 0])
DEGENERATE = {
    "one point": directions(1),
    "one posture": np.tile([0.0, 0.6, 0.8], (20, 1)),
    "one plane": np.stack([np.cos(np.arange(30)), np.sin(np.arange(30)), np.zeros(30)], axis=1),
    "three points": np.eye(3),
    "far out": 3.9 * directions(20),
    "at the centre": np.zeros((12, 3)),
    "nonsense": np.random.default_rng(1).uniform(-1.8, 1.8, (30, 3)),
}
SLOW = {(name, "differential-evolution") for name in DEGENERATE if name != "far out"}
"""Up to some seconds each; nightly alone."""
TESTS = Path(__file__).resolve().parent.parent
WARM = np.array([0.0] * 9 + [0.004, -0.003, 0.002])


@dataclass(frozen=True)
class Tolerance:
    """How close an optimizer gets.

    Attributes:
        parameter: largest error of a parameter on points without noise.
        norm_mg: largest distance of |a| from the least-squares optimum on noisy points [mg].
    """

    parameter: float = 1e-6
    norm_mg: float = 0.02


TOLERANCES = {
    "float32": Tolerance(parameter=5e-6),
    "fixed16": Tolerance(parameter=0.02, norm_mg=30),
    "closest-point": Tolerance(parameter=2e-4, norm_mg=0.2),
    "differential-evolution": Tolerance(parameter=1e-5),
}
"""Every optimizer that is not named here must reach the plain values."""


def is_slow(optimizer: Optimizer, model: str) -> bool:
    """Whether a fit takes a hundred times as long as others: the smaller models of it are in every run."""
    return optimizer.name == "differential-evolution" and len(MODELS[model].free) > 6


EVERY = pytest.mark.parametrize("optimizer", all_optimizers(), ids=lambda item: item.name)
EACH_FAST = pytest.mark.parametrize(
    "optimizer",
    [
        pytest.param(item, id=item.name, marks=[pytest.mark.nightly] * is_slow(item, "9"))
        for item in all_optimizers()
    ],
)
EACH_MODEL = pytest.mark.parametrize(
    ("optimizer", "model"),
    [
        pytest.param(
            item, model, id=f"{item.name}-{model}", marks=[pytest.mark.nightly] * is_slow(item, model)
        )
        for item in all_optimizers()
        for model in item.models
    ],
)


def tolerance(optimizer: Optimizer) -> Tolerance:
    return TOLERANCES.get(optimizer.name, Tolerance())


def richest(optimizer: Optimizer) -> str:
    """The model with most parameters that it fits without temperature."""
    return max(name for name in optimizer.models if not name.endswith("T"))


def errors_of(model: str) -> np.ndarray:
    free = list(MODELS[model].free)
    known = np.array(IDENTITY) / ONE
    known[free] = (TRUE + WARM)[free]
    return known


def temperatures(model: str, number: int) -> np.ndarray | None:
    return np.sin(np.arange(number) * 1.7) if model.endswith("T") else None


def made(model: str, number: int, *, noise: float = 0.0, seed: int = 0) -> PointSet:
    """Well-spread points of a sensor that has the errors of a model and no others."""
    tau = temperatures(model, number)
    random = np.random.default_rng(seed)
    v = measured(errors_of(model), directions(number), tau) + noise * random.standard_normal((number, 3))
    return points(v, tau=tau)


def fit(optimizer: Optimizer, held: PointSet, model: str) -> Fit:
    return optimizer.fit(held, MODELS[model], optimizer.settings["default"])


def norms_mg(parameters: tuple[int, ...], held: PointSet) -> np.ndarray:
    tau = None if held.tau is None else held.tau / ONE
    return 1e3 * np.sqrt((calibrated(np.array(parameters) / ONE, held.xyz / ONE, tau) ** 2).sum(axis=1))


@EACH_MODEL
def test_known_errors_are_recovered_from_points_without_noise(optimizer: Optimizer, model: str) -> None:
    found = fit(optimizer, made(model, 60), model).parameters
    assert np.abs(np.array(found) / ONE - errors_of(model)).max() < tolerance(optimizer).parameter


@EACH_MODEL
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.nightly)])
def test_noisy_points_end_at_the_least_squares_optimum(optimizer: Optimizer, model: str, seed: int) -> None:
    held = made(model, 90, noise=0.002, seed=seed)
    found, best = fit(optimizer, held, model).parameters, fast_fit(held, MODELS[model]).parameters
    assert np.abs(norms_mg(found, held) - norms_mg(best, held)).max() < tolerance(optimizer).norm_mg


@EACH_MODEL
def test_parameters_that_are_not_free_stay_ideal(optimizer: Optimizer, model: str) -> None:
    found = fit(optimizer, made("9T", 60), model).parameters
    assert len(found) == 12
    for index in set(range(12)) - set(MODELS[model].free):
        assert found[index] == IDENTITY[index]


@EACH_MODEL
def test_no_points_give_the_ideal_sensor(optimizer: Optimizer, model: str) -> None:
    assert fit(optimizer, points(np.empty((0, 3))), model).parameters == IDENTITY


@EVERY
def test_a_model_that_it_does_not_fit_is_refused(optimizer: Optimizer) -> None:
    assert set(optimizer.models) <= set(MODELS) and {"0", "6"} <= set(optimizer.models)
    for model in set(MODELS) - set(optimizer.models):
        with pytest.raises(DivergedError, match=f"{optimizer.name} does not fit model {model}"):
            fit(optimizer, made(model, 60), model)


@EACH_FAST
def test_a_point_of_half_the_weight_counts_half(optimizer: Optimizer) -> None:
    model = richest(optimizer)
    held = made(model, 45, noise=0.004)
    weights = np.where(np.arange(45) < 15, WEIGHT_ONE, WEIGHT_ONE // 2)
    light = PointSet(held.xyz, weights, held.windows)
    twice = held.select(np.r_[np.arange(15), np.arange(45)])
    found = [norms_mg(fit(optimizer, item, model).parameters, held) for item in (light, twice, held)]
    assert np.abs(found[0] - found[1]).max() < 0.01 + 3 * (optimizer.name == "fixed16")
    assert np.abs(found[0] - found[2]).max() > 0.1


@pytest.mark.parametrize(
    ("optimizer", "v"),
    [
        pytest.param(
            item, v, id=f"{name}-{item.name}", marks=[pytest.mark.nightly] * ((name, item.name) in SLOW)
        )
        for name, v in DEGENERATE.items()
        for item in all_optimizers()
    ],
)
def test_points_that_determine_nothing_give_an_error_or_numbers_in_range(
    optimizer: Optimizer, v: np.ndarray
) -> None:
    try:
        found = fit(optimizer, points(v), richest(optimizer))
    except DivergedError:
        return
    assert max(abs(value) for value in found.parameters) < LIMIT


@EVERY
def test_points_without_weight_are_refused(optimizer: Optimizer) -> None:
    held = made("6", 20)
    with pytest.raises(DivergedError, match="no point has any weight"):
        fit(optimizer, PointSet(held.xyz, held.weights * 0, held.windows), "6")


@EVERY
def test_parameters_are_plain_integers_with_a_reason_to_stop(optimizer: Optimizer) -> None:
    found = fit(optimizer, made("9", 40), richest(optimizer))
    assert all(type(value) is int for value in found.parameters)
    assert found.stop and found.iterations >= 1


@EACH_FAST
def test_a_fit_can_be_repeated(optimizer: Optimizer) -> None:
    held, model = made("9", 40), richest(optimizer)
    assert fit(optimizer, held, model) == fit(optimizer, held, model)


@EVERY
def test_the_points_are_left_as_they_were(optimizer: Optimizer) -> None:
    held = made("9", 40)
    before = (held.xyz.copy(), held.weights.copy())
    fit(optimizer, held, richest(optimizer))
    assert (held.xyz == before[0]).all() and (held.weights == before[1]).all()


@EVERY
def test_it_is_found_by_name_and_has_settings_for_a_report(optimizer: Optimizer) -> None:
    assert named_optimizer(optimizer.name) is optimizer
    assert optimizer.title
    variants = {"symmetric"} if optimizer.name == "gauss-newton" else set()
    assert set(optimizer.settings) - variants <= set(PROFILES) and "default" in optimizer.settings
    for numbers in optimizer.settings.values():
        assert asdict(numbers)


@EVERY
def test_its_module_has_a_test_file(optimizer: Optimizer) -> None:
    """A module may bind several; those of the descents in floating point share a function."""
    _, *folders, module = optimizer.fit.__module__.split(".")
    assert TESTS.joinpath(*folders, f"test_{module}.py").is_file()


@EVERY
def test_its_kind_of_arithmetic_is_known(optimizer: Optimizer) -> None:
    assert optimizer.arithmetic == ("integer" if optimizer.name.startswith("fixed") else "float")


@EVERY
def test_a_package_that_it_needs_is_named(optimizer: Optimizer, monkeypatch: pytest.MonkeyPatch) -> None:
    if optimizer.needs is None:
        monkeypatch.setitem(sys.modules, "scipy", None)
        fit(optimizer, made("6", 20), "6")
    else:
        monkeypatch.setitem(sys.modules, optimizer.needs, None)
        with pytest.raises(UsageError):
            fit(optimizer, made("6", 20), "6")


def test_names_are_distinct_and_the_default_exists() -> None:
    names = [item.name for item in all_optimizers()]
    assert names == sorted(set(names))
    assert all(named_optimizer(item.optimizer).name in names for item in PROFILES.values())


def test_an_unknown_name_is_answered_with_the_known_ones() -> None:
    with pytest.raises(UsageError, match=r"'gradient'.*fixed32"):
        named_optimizer("gradient")
