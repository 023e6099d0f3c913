"""The parts of the uncertainty of |a| at rest, against draws of the same posterior and by hand."""

from __future__ import annotations

import numpy as np
import pytest

from accelcal_cli.judge.errors import directions
from accelcal_cli.judge.posterior import (
    Circumstances,
    PossibleChange,
    columns,
    sensor_of,
    uncertainty_budget,
)
from tests.judge.test_bend import known_of, worn
from tests.optimize.oracle import measured


def test_the_squares_of_rests_and_bend_are_those_of_draws() -> None:
    held, _, _ = worn(1, 0.0, 25)
    known, _ = known_of(held)
    parts = {one.source: one for one in uncertainty_budget(known, Circumstances(10.0))}
    drawn = np.random.RandomState(1).multivariate_normal(np.zeros(12), np.array(known.covariance), 20_000)
    found = sensor_of(known.found.fit)
    raw = found.bent(measured(np.array(known.found.fit.parameters) / 2**29, directions()))
    spread_mg = 1000 * np.sqrt(((drawn @ (columns(raw, known) / 2).T) ** 2).mean())
    assert np.hypot(parts["rests"].mg, parts["bend"].mg) == pytest.approx(spread_mg, rel=0.02)
    assert parts["gravity"].mg == parts["change"].mg == 0
    assert sum(one.share_percent for one in parts.values()) == pytest.approx(100)


def test_a_certain_change_and_an_unknown_place_by_hand() -> None:
    """An offset of x that is 0 for three quarters of the time, then 20 mg: 10 mg in the root mean square."""
    held, _, _ = worn(1, 0.0, 60, noise_g=0.0001)
    known, _ = known_of(held)
    moved = np.zeros(24)
    moved[12 + 6] = 0.020
    factor = np.linalg.cholesky(np.array(known.covariance))
    change = PossibleChange(1.0, 0.75, moved, np.concatenate([factor, np.zeros((12, 12))]))
    *_, changed, gravity = uncertainty_budget(known, Circumstances(10.0, 0.0015, [change]))
    assert changed.axes_mg[0] == pytest.approx(10.0, rel=0.1) and changed.axes_mg[1] < 1.5
    assert changed.mg == pytest.approx(10 / np.sqrt(3), rel=0.1), "the mean square of a cosine is a third"
    assert gravity.mg == gravity.worst_mg == pytest.approx(1.5)
