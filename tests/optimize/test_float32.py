"""The same descent in single precision: what its 24 bits are good for."""

from __future__ import annotations

import numpy as np
import pytest

from accelcal_cli.core.fixed import ONE
from accelcal_cli.core.points import MODELS
from accelcal_cli.optimize import _float, float32, float64
from tests.optimize.test_fixed32 import made
from tests.optimize.test_float64 import drawn


@pytest.mark.parametrize("model", ["6", "9", "9T"])
def test_it_agrees_with_double_precision_to_five_digits(model: str) -> None:
    for seed in range(6):
        held = made(seed, 80, warm=model.endswith("T"), weighted=True)
        short, long = (np.array(item.fit(held, MODELS[model]).parameters) for item in (float32, float64))
        assert np.abs(short - long).max() < 5e-6 * ONE


def test_profile_paper_agrees_with_double_precision_to_four_digits() -> None:
    for seed in range(6):
        held = drawn(seed)
        short, long = (
            np.array(item.fit(held, MODELS["9"], item.PAPER).parameters) for item in (float32, float64)
        )
        assert 0 < np.abs(short - long).max() < 5e-4 * ONE


def test_everything_stays_in_single_precision() -> None:
    held = _float.as_floats(made(1, 20, warm=True, weighted=True), np.float32)
    p = _float.ideal(np.float32)
    state = _float.evaluate(held, p)
    results = [held.v, held.tau, held.weights, state.shifted, state.calibrated, state.residual]
    results += [_float.cost(held, state), _float.gradient(held, state, p)]
    assert {item.dtype for item in results} == {np.dtype(np.float32)}


def test_its_result_is_exact_in_fixed_point() -> None:
    found = float32.fit(drawn(1, 60), MODELS["9"]).parameters
    assert all(np.float32(value / ONE) * ONE == value for value in found)
