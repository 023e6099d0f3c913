"""What every optimizer must do; a new file in `optimize/` is taken in by itself."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.fixed import ONE
from accelcal_cli.core.points import IDENTITY, MODELS, Fit, Optimizer
from accelcal_cli.core.settings import PROFILES
from accelcal_cli.optimize import all_optimizers, named_optimizer
from tests.optimize.oracle import directions, measured, points

TRUE = np.array([1.04, 0.97, 1.02, 0.012, -0.02, 0.008, 0.03, -0.05, 0.02, 0, 0, 0])
EVERY = pytest.mark.parametrize("optimizer", all_optimizers(), ids=lambda item: item.name)


def errors_of(model: str) -> np.ndarray:
    free = list(MODELS[model].free)
    known = np.array(IDENTITY) / ONE
    known[free] = TRUE[free]
    return known


def fit(optimizer: Optimizer, v: np.ndarray, model: str) -> Fit:
    return optimizer.fit(points(v), MODELS[model], optimizer.settings["default"])


@EVERY
@pytest.mark.parametrize("model", ["0", "3", "6", "9"])
def test_known_errors_are_recovered_from_points_without_noise(optimizer: Optimizer, model: str) -> None:
    known = errors_of(model)
    found = fit(optimizer, measured(known, directions(60)), model).parameters
    assert np.abs(np.array(found) / ONE - known).max() < 1e-6


@EVERY
@pytest.mark.parametrize("model", ["0", "3", "6"])
def test_parameters_that_are_not_free_stay_ideal(optimizer: Optimizer, model: str) -> None:
    found = fit(optimizer, measured(TRUE, directions(60)), model).parameters
    assert len(found) == 12
    for index in set(range(12)) - set(MODELS[model].free):
        assert found[index] == IDENTITY[index]


@EVERY
@pytest.mark.parametrize("model", sorted(MODELS))
def test_no_points_give_the_ideal_sensor(optimizer: Optimizer, model: str) -> None:
    assert fit(optimizer, np.empty((0, 3)), model).parameters == IDENTITY


@EVERY
def test_parameters_are_plain_integers_with_a_reason_to_stop(optimizer: Optimizer) -> None:
    found = fit(optimizer, measured(TRUE, directions(40)), "9")
    assert all(type(value) is int for value in found.parameters)
    assert found.stop and found.iterations >= 1


@EVERY
def test_a_fit_can_be_repeated(optimizer: Optimizer) -> None:
    v = measured(TRUE, directions(40))
    assert fit(optimizer, v, "9") == fit(optimizer, v, "9")


@EVERY
def test_the_points_are_left_as_they_were(optimizer: Optimizer) -> None:
    held = points(measured(TRUE, directions(40)))
    before = (held.xyz.copy(), held.weights.copy())
    optimizer.fit(held, MODELS["9"], optimizer.settings["default"])
    assert (held.xyz == before[0]).all() and (held.weights == before[1]).all()


@EVERY
def test_it_is_found_by_name_and_has_settings_for_a_report(optimizer: Optimizer) -> None:
    assert named_optimizer(optimizer.name) is optimizer
    assert optimizer.title
    assert set(optimizer.settings) <= set(PROFILES) and "default" in optimizer.settings
    for numbers in optimizer.settings.values():
        assert asdict(numbers)


@EVERY
def test_it_has_a_test_file_of_its_own(optimizer: Optimizer) -> None:
    assert (Path(__file__).parent / f"test_{optimizer.name}.py").is_file()


def test_names_are_distinct_and_the_default_exists() -> None:
    names = [item.name for item in all_optimizers()]
    assert names == sorted(set(names))
    assert all(named_optimizer(item.optimizer).name in names for item in PROFILES.values())


def test_an_unknown_name_is_answered_with_the_known_ones() -> None:
    with pytest.raises(UsageError, match=r"'gradient'.*fixed32"):
        named_optimizer("gradient")
