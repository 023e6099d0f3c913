"""SciPy's differential evolution behind the contract: repeatable, and bounded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.fixed import ONE
from accelcal_cli.core.points import MODELS
from accelcal_cli.optimize import differential_evolution
from accelcal_cli.optimize.differential_evolution import DEFAULT
from tests.optimize.oracle import directions, least_squares, points
from tests.optimize.test_fixed32 import made


def test_any_seed_ends_at_the_optimum_and_the_same_seed_at_the_same_bits() -> None:
    held = made(1, 40, warm=False, weighted=True)
    best = least_squares(held, MODELS["9"].free).p
    runs = [differential_evolution.fit(held, MODELS["9"], replace(DEFAULT, seed=seed)) for seed in (1, 1, 2)]
    assert runs[0] == runs[1] != runs[2]
    for run in runs:
        assert np.abs(np.array(run.parameters) / ONE - best).max() < 1e-5


def test_a_search_that_ends_at_the_edge_of_its_box_is_an_error() -> None:
    with pytest.raises(DivergedError, match="edge of its box"):
        differential_evolution.fit(points(0.7 * directions(30)), MODELS["6"])


def test_too_few_generations_are_an_error() -> None:
    with pytest.raises(DivergedError, match="not converged after 5 generations"):
        differential_evolution.fit(
            made(1, 40, warm=False, weighted=False), MODELS["9"], replace(DEFAULT, max_generations=5)
        )
