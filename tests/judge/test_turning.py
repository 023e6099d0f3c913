"""Gravity as `judge/gyroscope.py` turns it, by hand and by quaternions multiplied one after the other."""

from __future__ import annotations

from itertools import pairwise
from math import cos, hypot, radians, sin

import numpy as np
import pytest
from numpy.typing import NDArray

from accelcal_cli.core.gyroscope import Rest, Turn
from accelcal_cli.judge.gyroscope import BATCH_BLOCKS, BLOCK, TurningGravity

QUIET = Rest(0, 100, (0, 0, 256 * 100), (0, 0, 0), None)
PLAIN = (1.0, 1.0, 1.0)
Floats = NDArray[np.float64]


def turn_of(counts: NDArray[np.int32], period_us: float = 10_000.0, before: Rest = QUIET) -> Turn:
    return Turn(before, before, counts, period_us)


def end(counts: NDArray[np.int32], start: Floats, scale: Floats | None = None) -> Floats:
    turned = TurningGravity([turn_of(counts)], start[np.newaxis], PLAIN).turned(
        np.eye(3) if scale is None else scale
    )
    return turned.direction[0]


@pytest.mark.parametrize(
    ("start", "axis", "expected"),
    [("x", "z", (0, -1, 0)), ("y", "x", (0, 0, -1)), ("z", "y", (-1, 0, 0)), ("z", "z", (0, 0, 1))],
)
def test_a_quarter_turn(start: str, axis: str, expected: tuple[int, int, int]) -> None:
    """du/dt = u x w: about z, x goes to -y, as what is fixed in the room does for one who turns left."""
    counts = np.zeros((100, 3), np.int32)
    counts[:, "xyz".index(axis)] = 90
    found = end(counts, np.eye(3)["xyz".index(start)])
    np.testing.assert_allclose(found, expected, atol=1e-14)


def test_the_bias_of_the_two_rests_is_taken_off() -> None:
    counts = np.full((100, 3), 7, np.int32)
    before, after = Rest(0, 100, (0, 0, 1), (500, 500, 500), None), Rest(0, 10, (0, 0, 1), (90,) * 3, None)
    turned = TurningGravity([Turn(before, after, counts, 10_000.0)], np.eye(3)[:1], PLAIN).turned(np.eye(3))
    np.testing.assert_allclose(turned.direction[0], (1, 0, 0), atol=1e-15)


def by_quaternions(counts: NDArray[np.int32], start: Floats, scale: Floats, period_s: float) -> Floats:
    """Hamilton's product step by step; the frame turns with the product, the direction against it."""
    rates = np.vstack([np.zeros(3), counts, np.zeros(3)])
    q = np.array([1.0, 0.0, 0.0, 0.0])
    for one, other in pairwise(rates):
        angle = scale @ np.radians((one + other) / 2 * period_s)
        size = hypot(*angle)
        step = np.array([1.0, 0, 0, 0])
        if size:
            step = np.array([cos(size / 2), *(sin(size / 2) * angle / size)])
        w, v = (
            q[0] * step[0] - q[1:] @ step[1:],
            q[0] * step[1:] + step[0] * q[1:] + np.cross(q[1:], step[1:]),
        )
        q = np.array([w, *v])
    w, v = q[0], q[1:]
    matrix = (w * w - v @ v) * np.eye(3) + 2 * np.outer(v, v)
    matrix += 2 * w * np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.asarray(matrix.T @ start)


@pytest.mark.parametrize("rows", [1, BLOCK - 2, BLOCK - 1, BLOCK, 1000])
def test_any_turn_is_that_of_quaternions(rows: int) -> None:
    random = np.random.default_rng(rows)
    counts = random.integers(-1500, 1500, (rows, 3)).astype(np.int32)
    scale = np.eye(3) + random.normal(0, 0.05, (3, 3))
    start = np.array([0.6, 0.0, -0.8])
    np.testing.assert_allclose(
        end(counts, start, scale), by_quaternions(counts, start, scale, 0.01), atol=1e-12
    )


def test_half_a_turn_in_one_step() -> None:
    counts = np.array([[0, 0, 18_000]] * 2, np.int32)  # steps of 90, 180 and 90 degrees at 100 Hz
    np.testing.assert_allclose(end(counts, np.array([1.0, 0, 0])), (1, 0, 0), atol=1e-12)


def test_turns_side_by_side_and_each_with_its_own_scale() -> None:
    random = np.random.default_rng(3)
    lengths = [5, BLOCK * BATCH_BLOCKS + 1, 700, 64]
    turns = [turn_of(random.integers(-90, 90, (rows, 3)).astype(np.int32)) for rows in lengths]
    starts = random.normal(size=(4, 3))
    starts /= np.linalg.norm(starts, axis=1, keepdims=True)
    scales = np.eye(3)[:, :, np.newaxis] + random.normal(0, 0.02, (3, 3, 4))
    together = TurningGravity(turns, starts, PLAIN).turned(scales)
    for index, turn in enumerate(turns):
        alone = TurningGravity([turn], starts[index : index + 1], PLAIN).turned(scales[:, :, index])
        assert (alone.direction[0] == together.direction[index]).all()
        assert (alone.slope[0] == together.slope[index]).all()


def test_the_slope_is_that_of_small_changes() -> None:
    """Exact in the limit of small steps; steps of up to 2 degrees leave a hundredth of a percent."""
    random = np.random.default_rng(5)
    rates = np.cumsum(random.normal(0, 12, (1500, 3)), axis=0) % 400 - 200
    counts, start = np.rint(rates).astype(np.int32), np.array([0.48, -0.6, 0.64])
    gravity = TurningGravity([turn_of(counts, 2000.0)], start[np.newaxis], PLAIN)
    slope = gravity.turned(np.eye(3)).slope[0]
    assert np.abs(slope).max() > radians(20)
    for entry in range(9):
        small = np.zeros(9)
        small[entry] = 1e-5
        up, down = (gravity.turned(np.eye(3) + sign * small.reshape(3, 3)).direction[0] for sign in (1, -1))
        np.testing.assert_allclose(slope[:, entry], (up - down) / 2e-5, atol=1e-3 * np.abs(slope).max())
