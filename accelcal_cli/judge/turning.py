"""Gravity as a gyroscope turns it from one rest to the next, and how that depends on the scale matrix.

In the sensor's frame a direction u that is fixed in the room moves as du/dt = u x w (G 4.3). With w constant
from one sample to the next, the turn of a step is that of a unit quaternion, here as its matrix by
Rodrigues' formula. What S does to the end follows from the same pass: a change dS of the scale matrix moves
the end of the turn by Q(T) (u(0) x sum of Q(t)^T dS r(t) dt), where Q(t) has turned u(0) to u(t).

All is elementwise, in a fixed order, with sums, products and quotients only (series instead of sine and
cosine), so that turns give the same bits on every machine.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import radians

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.gyroscope import Triple, Turn

BLOCK = 32
"""Samples that are processed one after the other; blocks of them are processed side by side."""

BATCH_BLOCKS = 4096
"""Blocks that are processed at a time, so that memory is bounded and fits the processor's cache."""

SERIES = 12
"""Terms of the series of sin(x) / x and (1 - cos x) / x^2: exact to 1e-13 up to half a turn in a step."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class _TurnBatch:
    """Turns cut into blocks.

    Attributes:
        first: number of the first turn.
        steps: (BLOCK, 3, t) angle of each step by the raw rate, less the bias [rad]; zero after the end.
        begins: (p,) number of each turn's first block; blocks: (p,) number of its blocks.
    """

    first: int
    steps: Floats
    begins: NDArray[np.int64]
    blocks: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Turned:
    """Gravity at the end of n turns.

    Attributes:
        direction: (n, 3) unit vectors.
        slope: (n, 3, 9) derivatives with respect to the entries of S, row by row.
    """

    direction: Floats
    slope: Floats


class TurningGravity:
    """Turns of a gyroscope, with gravity's direction at their beginning.

    Args:
        before: (n, 3) unit vectors of the calibrated accelerometer.
    """

    def __init__(self, turns: Sequence[Turn], before: Floats, dps_per_lsb: Triple) -> None:
        self._before = before
        self._batches = list(_batches(turns, dps_per_lsb))

    def __len__(self) -> int:
        return len(self._before)

    def turned(self, scale: Floats) -> Turned:
        """Return gravity's direction after each turn.

        Args:
            scale: S, (3, 3), or (3, 3, n) with one for each turn.
        """
        parts = [self._turned(batch, scale) for batch in self._batches]
        return Turned(
            np.concatenate([part.direction for part in parts]), np.concatenate([part.slope for part in parts])
        )

    def _turned(self, batch: _TurnBatch, scale: Floats) -> Turned:
        turns = slice(batch.first, batch.first + len(batch.begins))
        own = scale if scale.ndim == 2 else np.repeat(scale[:, :, turns], batch.blocks, axis=2)
        turn, moment = _joined(batch, *_through_blocks(batch.steps, own))
        start = self._before[turns].T
        end = _times(turn, start[:, np.newaxis])[:, 0]
        across = _times(turn, _cross(start, moment.reshape(3, 9, -1)))
        return Turned(end.T.copy(), across.transpose(2, 0, 1).copy())


def raw_steps(turn: Turn, dps_per_lsb: Triple) -> Floats:
    """Return angles from each sample to the next by the raw rate less that of the rests [rad], (n + 1, 3).

    The first step begins at rest, the last one ends there: n samples make n + 1 trapezoids.
    """
    before, after = turn.before, turn.after
    padded = np.zeros((len(turn) + 2, 3))
    for axis in range(3):
        bias = before.gyro_sums[axis] / before.samples + after.gyro_sums[axis] / after.samples
        padded[1:-1, axis] = turn.counts[:, axis] - bias / 2
        padded[:, axis] *= radians(dps_per_lsb[axis]) * (turn.period_us / 1e6)
    return np.asarray((padded[:-1] + padded[1:]) / 2)


def _batches(turns: Sequence[Turn], dps_per_lsb: Triple) -> Iterator[_TurnBatch]:
    first, steps_of_turns, total = 0, list[Floats](), 0
    for number, turn in enumerate(turns):
        steps = raw_steps(turn, dps_per_lsb)
        blocks = -(-len(steps) // BLOCK)
        if steps_of_turns and total + blocks > BATCH_BLOCKS:
            yield _batch(first, steps_of_turns)
            first, steps_of_turns, total = number, [], 0
        padded = np.zeros((blocks * BLOCK, 3))
        padded[: len(steps)] = steps
        steps_of_turns.append(padded.reshape(blocks, BLOCK, 3))
        total += blocks
    if steps_of_turns:
        yield _batch(first, steps_of_turns)


def _batch(first: int, steps_of_turns: list[Floats]) -> _TurnBatch:
    blocks = np.array([len(one) for one in steps_of_turns], np.int64)
    steps = np.ascontiguousarray(np.concatenate(steps_of_turns).transpose(1, 2, 0))
    return _TurnBatch(first, steps, np.cumsum(blocks) - blocks, blocks)


def _through_blocks(steps: Floats, scale: Floats) -> tuple[Floats, Floats]:
    """Return Q of each block, (3, 3, t), and its sum of Q^T (x) r dt, (3, 3, 3, t)."""
    own = scale[:, :, np.newaxis] if scale.ndim == 2 else scale
    turn = np.zeros((3, 3, steps.shape[2]))
    turn[[0, 1, 2], [0, 1, 2]] = 1.0
    moment = np.zeros((3, *turn.shape))
    for step in steps:
        right = own[:, 0] * step[0] + own[:, 1] * step[1] + own[:, 2] * step[2]
        following = _times(_rotation(right), turn)
        middle = (turn + following) / 2
        moment += middle.transpose(1, 0, 2)[:, :, np.newaxis] * step
        turn = following
    return turn, moment


def _rotation(angle: Floats) -> Floats:
    """Return matrices (3, 3, t) that turn directions as a rotation of the sensor by angles (3, t) [rad]."""
    x, y, z = angle
    squared = x * x + y * y + z * z
    sine, versine = _series(squared, 1), _series(squared, 2)
    matrix = versine * (angle[:, np.newaxis] * angle[np.newaxis])
    cosine = 1.0 - versine * squared
    for axis in range(3):
        matrix[axis, axis] += cosine
        following, last = (axis + 1) % 3, (axis + 2) % 3
        matrix[following, last] += sine * angle[axis]
        matrix[last, following] -= sine * angle[axis]
    return matrix


def _series(squared: Floats, first: int) -> Floats:
    """Return sin(x) / x (first = 1) or (1 - cos x) / x^2 (first = 2) of x^2."""
    total = np.ones_like(squared)
    for term in range(SERIES, 0, -1):
        total = 1.0 - squared / ((2 * term + first - 1) * (2 * term + first)) * total
    return total if first == 1 else total / 2


def _joined(batch: _TurnBatch, turn: Floats, moment: Floats) -> tuple[Floats, Floats]:
    """Combine blocks to whole turns: Q (3, 3, p), and the sums (3, 3, 3, p)."""
    number = len(batch.begins)
    whole, total = np.zeros((3, 3, number)), np.zeros((3, 3, 3, number))
    whole[[0, 1, 2], [0, 1, 2]] = 1.0
    for place in range(int(batch.blocks.max())):
        going = np.flatnonzero(batch.blocks > place)
        block = batch.begins[going] + place
        so_far = whole[:, :, going]
        part = _times(so_far.transpose(1, 0, 2), moment[:, :, :, block].reshape(3, 9, -1))
        total[:, :, :, going] += part.reshape(3, 3, 3, -1)
        whole[:, :, going] = _times(turn[:, :, block], so_far)
    return whole, total


def _times(left: Floats, right: Floats) -> Floats:
    """Return matrix products (3, 3, t) (3, m, t), term by term."""
    parts = (left[:, index, np.newaxis] * right[np.newaxis, index] for index in range(3))
    first, second, third = parts
    return np.asarray(first + second + third)


def _cross(left: Floats, right: Floats) -> Floats:
    """Return the cross products (3, t) x (3, m, t) for each of m."""
    return np.stack(
        [left[(a + 1) % 3] * right[(a + 2) % 3] - left[(a + 2) % 3] * right[(a + 1) % 3] for a in range(3)]
    )
