"""SciPy's BFGS behind the contract."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

from accelcal_cli.core.errors import DivergedError, UsageError
from accelcal_cli.core.fixed import ONE
from accelcal_cli.core.points import IDENTITY, MODELS
from accelcal_cli.optimize import all_optimizers, bfgs, named_optimizer
from tests.optimize.oracle import least_squares
from tests.optimize.test_fixed32 import made


@pytest.mark.parametrize("model", ["6", "9", "9T"])
def test_it_ends_at_the_least_squares_optimum_to_eight_digits(model: str) -> None:
    held = made(1, 70, warm=model.endswith("T"), weighted=True)
    found = np.array(bfgs.fit(held, MODELS[model]).parameters) / ONE
    assert np.abs(found - least_squares(held, MODELS[model].free).p).max() < 1e-8


def test_too_few_iterations_are_an_error() -> None:
    held = made(1, 70, warm=False, weighted=False)
    with pytest.raises(DivergedError, match="not converged after 3 iterations"):
        bfgs.fit(held, MODELS["9"], replace(bfgs.DEFAULT, max_iterations=3))


@pytest.mark.parametrize("name", ["bfgs", "differential-evolution"])
def test_without_scipy_the_remedy_is_named(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "scipy", None)
    optimizer = named_optimizer(name)
    held = made(1, 20, warm=False, weighted=False)
    with pytest.raises(UsageError, match=rf"{name} needs SciPy; pip install 'accelcal\[methods\]'"):
        optimizer.fit(held, MODELS["6"], optimizer.settings["default"])
    assert optimizer.fit(held, MODELS["0"], optimizer.settings["default"]).parameters == IDENTITY


def test_without_scipy_the_others_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "scipy", None)
    held = made(1, 30, warm=False, weighted=False)
    for optimizer in all_optimizers():
        if optimizer.name not in ("bfgs", "differential-evolution"):
            assert optimizer.fit(held, MODELS["6"], optimizer.settings["default"]).iterations >= 1
