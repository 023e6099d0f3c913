"""The linear ellipsoid: six numbers in one step."""

from __future__ import annotations

import numpy as np
import pytest

from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.fixed import ONE
from accelcal_cli.core.points import MODELS
from accelcal_cli.optimize import ellipsoid
from tests.optimize.oracle import directions, measured, points


def test_six_points_on_the_axes_give_the_answer_by_hand() -> None:
    v = np.diag([1.25, 1.0, 0.5])
    p = np.array(ellipsoid.fit(points(np.vstack([v + 0.125, 0.125 - v])), MODELS["6"]).parameters) / ONE
    assert np.abs(p - [0.8, 1, 2, 0, 0, 0, -0.125, -0.125, -0.125, 0, 0, 0]).max() < 1e-8


def test_the_offset_alone_is_the_centre_of_the_sphere_whatever_its_radius() -> None:
    offset = np.array([0.03, -0.02, 0.05])
    for radius in (1.0, 1.04):
        p = np.array(ellipsoid.fit(points(radius * directions(30) - offset), MODELS["3"]).parameters) / ONE
        assert np.abs(p - [1, 1, 1, 0, 0, 0, *offset, 0, 0, 0]).max() < 1e-8


def test_points_of_no_weight_take_no_part() -> None:
    p = np.array([1.02, 0.97, 1.01, 0, 0, 0, 0.02, 0.01, -0.03, 0, 0, 0])
    v = np.vstack([measured(p, directions(20)), 0.7 * directions(5)])
    found = ellipsoid.fit(points(v, weights=np.r_[np.ones(20), np.zeros(5)]), MODELS["6"]).parameters
    assert np.abs(np.array(found) / ONE - p).max() < 1e-8


def test_points_on_a_hyperboloid_are_refused() -> None:
    z = np.linspace(-1, 1, 40)
    ring = np.sqrt(0.5 + z**2)
    v = np.stack([ring * np.cos(7 * z), ring * np.sin(7 * z), z], axis=1)
    with pytest.raises(DivergedError, match="no ellipsoid"):
        ellipsoid.fit(points(v), MODELS["6"])


def test_points_in_one_plane_are_refused() -> None:
    v = directions(30) * [1, 1, 0]
    for model in ("3", "6"):
        with pytest.raises(DivergedError, match="do not determine"):
            ellipsoid.fit(points(v), MODELS[model])
