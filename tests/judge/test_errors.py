"""Error figures against hand numbers."""

from __future__ import annotations

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import IDENTITY
from accelcal_cli.judge import errors
from tests.optimize.oracle import calibrated, points


def test_deviations_by_hand() -> None:
    held = points(np.array([[0.6, 0.0, 0.8], [0.0, 1.02, 0.0], [0.3, -0.4, 0.0]]))
    assert errors.deviations_mg(held, IDENTITY) == pytest.approx([0, 20, 500], abs=1e-4)


def test_deviations_with_every_parameter() -> None:
    random = np.random.default_rng(1)
    v, tau = random.uniform(-1, 1, (20, 3)), random.uniform(-1, 1, 20)
    p = np.rint((np.array(IDENTITY) / ONE + random.uniform(-0.1, 0.1, 12)) * ONE)
    a = calibrated(p / ONE, v, tau)
    expected = abs(np.sqrt((a**2).sum(axis=1)) - 1) * 1000
    found = errors.deviations_mg(points(v, tau=tau), tuple(int(value) for value in p))
    assert found == pytest.approx(expected, abs=1e-5)


def test_slopes_are_not_used_without_temperatures() -> None:
    held = points(np.array([[1.0, 0, 0]]))
    assert errors.deviations_mg(held, (*IDENTITY[:9], ONE, ONE, ONE)).tolist() == [0]


def test_each_posture_has_its_weighted_mean() -> None:
    values, weights = np.array([1.0, 4.0, 10.0, 20.0]), np.array([3, 1, 5, 5])
    found = errors.per_posture(values, weights, np.array([7, 7, 2, 2]))
    assert found == {2: 15.0, 7: 1.75}


def test_summary_by_hand() -> None:
    found = errors.summary([5.0, 1.0, 4.0, 2.0, 3.0, 9.0])
    assert (found.mean, found.median) == (4.0, 3.5)
    assert found.p95 == pytest.approx(5 + 0.75 * 4)
