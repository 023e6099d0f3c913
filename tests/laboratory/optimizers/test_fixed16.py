"""Sixteen bits: bit by bit against plain integers, and honest about what they reach."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import IDENTITY
from accelcal_cli.core.errors import FixedPointOverflowError
from accelcal_cli.core.points import MODELS, WEIGHT_ONE, Operations
from accelcal_cli.laboratory.optimizers import fixed16
from tests.optimize.oracle import directions, measured, points
from tests.optimize.test_contract import TRUE
from tests.optimize.test_fixed32 import made


def half_up(value: int, bits: int) -> int:
    return (value + (1 << (bits - 1))) >> bits


def squared_residual(p: list[int], v: list[int], tau: int, weight: int) -> int:
    x, y, z = (v[i] + p[6 + i] + half_up(p[9 + i] * tau, 13) for i in range(3))
    ax = half_up(p[0] * x, 13)
    ay = half_up(p[3] * x + p[1] * y, 13)
    az = half_up(p[4] * x + p[5] * y + p[2] * z, 13)
    r = half_up(ax * ax + ay * ay + az * az - (1 << 26), 13)
    return half_up(r * weight, 15) * r


@pytest.mark.parametrize("model", ["6", "9", "9T"])
def test_every_bit_is_what_plain_integers_give(model: str) -> None:
    held = made(3, 20, warm=model.endswith("T"), weighted=True)
    rows = [[half_up(int(value), 16) for value in row] for row in held.xyz]
    taus = [0] * 20 if held.tau is None else [half_up(int(value), 16) for value in held.tau]
    weights = [int(value) for value in held.weights]
    p, rates = [8192] * 3 + [0] * 9, [30] * 3 + [80] * 3 + [20] * 6
    history = []

    def cost(q: list[int]) -> int:
        return sum(map(squared_residual, [q] * 20, rows, taus, weights))

    for _ in range(10):
        base, step = cost(p), [0] * 12
        for i in MODELS[model].free:
            rise = cost([value + 82 * (j == i) for j, value in enumerate(p)]) - base
            exact = rise * rates[i] * WEIGHT_ONE
            step[i] = (2 * exact + (sum(weights) << 13)) // (sum(weights) << 14)
        p = [value - change for value, change in zip(p, step, strict=True)]
        history.append(tuple(value << 16 for value in p))
    numbers = replace(fixed16.PAPER, max_iterations=10, keep_history=True)
    assert fixed16.fit(held, MODELS[model], numbers).history == tuple(history)


def test_the_result_has_thirteen_fraction_bits() -> None:
    found = fixed16.fit(made(1, 40, warm=False, weighted=False), MODELS["9"]).parameters
    assert all(value % (1 << 16) == 0 for value in found)


def test_it_improves_the_raw_data_but_leaves_what_sixteen_bits_leave() -> None:
    found = np.array(fixed16.fit(points(measured(TRUE, directions(60))), MODELS["9"]).parameters) / ONE
    ideal = np.array(IDENTITY) / ONE
    assert 0.001 < np.abs(found - TRUE).max() < 0.02 < np.abs(ideal - TRUE).max()


def test_it_counts_the_paper_s_operations() -> None:
    held = made(1, 18, warm=False, weighted=False)
    assert fixed16.fit(held, MODELS["9"], fixed16.PAPER).operations == Operations(90_150, 90_150)


@pytest.mark.parametrize(
    ("v", "what"),
    [
        (3.99 * directions(20), "a sum of products|a square|a calibrated point|a shifted point"),
        (2.3 * directions(20), "a residual"),
        (np.tile([1.3, 0.0, 0.0], (100, 1)), "the cost"),
        (np.tile([4.5, 0.0, 0.0], (3, 1)), "a point"),
    ],
    ids=["products", "residual", "sum", "point"],
)
def test_overflow_is_raised_and_never_wrapped(v: np.ndarray, what: str) -> None:
    # Points beyond +-4 g do not arise in fixed point; the tile of 4.5 stands for a damaged set.
    with pytest.raises(FixedPointOverflowError, match=f"^({what}) leaves"):
        fixed16.fit(points(v), MODELS["9"])
