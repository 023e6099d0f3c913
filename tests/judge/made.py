"""Point sets with known errors, for the judge."""

from __future__ import annotations

import numpy as np

from accelcal_cli.core.points import PointSet
from accelcal_cli.core.results import ErrorSummary, Holdout, Trial
from tests.optimize.oracle import IDEAL, directions, measured, points, random_directions

OFFSET = np.array([1.0, 1, 1, 0, 0, 0, 0.04, -0.03, 0.02, 0, 0, 0])
SIX = OFFSET + np.array([0.02, -0.015, 0.01, 0, 0, 0, 0, 0, 0, 0, 0, 0])
NINE = SIX + np.array([0, 0, 0, 0.02, -0.015, 0.018, 0, 0, 0, 0, 0, 0])
WARM = NINE + np.array([0, 0, 0, 0, 0, 0, 0, 0, 0, 0.012, -0.01, 0.015])
"""Errors that models 3, 6, 9 and 9T describe."""


def spread(
    p: np.ndarray = IDEAL, *, number: int = 150, noise: float = 0.002, seed: int = 0, warm: bool = False
) -> PointSet:
    """Points all over the sphere of a sensor with errors p; noise in g."""
    random = np.random.default_rng(seed)
    tau = random.uniform(-1.5, 1.5, number) if warm else None
    v = measured(p, directions(number), tau) + noise * random.standard_normal((number, 3))
    return points(v, windows=random.integers(1, 500, number), tau=tau)


def clusters(
    centres: np.ndarray,
    p: np.ndarray = IDEAL,
    *,
    each: int = 30,
    width: float = 0.06,
    noise: float = 0.001,
    seed: int = 0,
) -> tuple[PointSet, np.ndarray]:
    """Points about a few postures, and the number of each point's posture."""
    random = np.random.default_rng(seed)
    which = np.repeat(np.arange(len(centres)), each)
    a = centres[which] + width * random.standard_normal((len(which), 3))
    a /= np.sqrt((a**2).sum(axis=1))[:, None]
    v = measured(p, a) + noise * random.standard_normal(a.shape)
    return points(v), which


def four_postures(seed: int) -> np.ndarray:
    """Four directions at least 50 degrees apart."""
    random = np.random.default_rng(seed)
    while True:
        found = random_directions(random, 4)
        if (found @ found.T - np.eye(4)).max() < 0.64:
            return found


def trial(model: str, after: list[float], reason: str | None = None) -> Trial:
    """A trial with given errors of its postures."""
    mean = sum(after) / len(after)
    pairs = tuple((20.0, value) for value in after)
    before = ErrorSummary(20.0, 20.0, 20.0)
    errors = (before, ErrorSummary(mean, mean, mean), (0.0, 1.0))
    held = Holdout("", len(after), len(after), *errors, pairs, tuple(enumerate(after)))
    return Trial(model, None if reason else held, reason)
