"""Profile paper: F's iteration step by step, and its cost by counting."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import IDENTITY
from accelcal_cli.core.errors import FixedPointOverflowError
from accelcal_cli.core.points import MODELS, Operations, PointSet
from accelcal_cli.optimize import fixed32
from tests.optimize.oracle import drawn_errors, measured, paper_descent, points, random_directions


def case(seed: int) -> PointSet:
    """18 points by eq. 17-20, with 1 mg or 5 mg of noise."""
    random = np.random.default_rng(seed)
    v = measured(drawn_errors(random), random_directions(random, 18))
    return points(v + (0.001, 0.005)[seed % 2] * random.standard_normal((18, 3)))


def test_the_settings_are_the_papers() -> None:
    assert fixed32.PAPER.max_iterations == 50
    assert not fixed32.PAPER.converge
    assert fixed32.PAPER.forward_step == round(1e-5 * ONE) == 5369
    assert fixed32.PAPER.rates == {"scale": 0.3, "misalignment": 0.8, "offset": 0.2, "slope": 0.2}


@pytest.mark.parametrize("seed", range(30))
def test_every_iteration_follows_the_papers_equations_in_float64(seed: int) -> None:
    held = case(seed)
    found = fixed32.fit(held, MODELS["9"], replace(fixed32.PAPER, keep_history=True))
    expected = np.array(paper_descent(held.xyz_g(), 50))
    assert (found.iterations, found.stop, len(found.history)) == (50, "iterations", 50)
    assert np.abs(np.array(found.history) / ONE - expected).max() < 5e-5


def test_the_paper_run_approaches_the_known_errors() -> None:
    """With 1 mg of noise scales and offsets come to about 1e-3 (the Cramer-Rao bound is 5e-4)."""
    errors = []
    for seed in range(40):
        random = np.random.default_rng(seed)
        p = drawn_errors(random)
        v = measured(p, random_directions(random, 18)) + 0.001 * random.standard_normal((18, 3))
        found = fixed32.fit(points(v), MODELS["9"], fixed32.PAPER).parameters
        errors.append(np.abs(np.array(found) / ONE - p)[:9])
    mean = np.median(errors, axis=0)
    assert (mean[[0, 1, 2, 6, 7, 8]] < 1.5e-3).all() and (mean[3:6] < 4e-3).all()


def test_the_paper_case_costs_90150_additions_and_as_many_multiplications() -> None:
    operations = fixed32.fit(case(0), MODELS["9"], fixed32.PAPER).operations
    assert operations == Operations(90_150, 90_150)
    seconds = (28 * operations.additions + 97 * operations.multiplications) / 16e6
    assert 0.69 < seconds < 0.71, "F section II.C: about 0.7 s on an ATmega328 at 16 MHz"


@pytest.mark.parametrize(("iterations", "number"), [(1, 1), (1, 18), (7, 9), (50, 12), (20, 40), (3, 144)])
def test_operations_are_m_times_100_n_plus_3(iterations: int, number: int) -> None:
    random = np.random.default_rng(number)
    held = points(random_directions(random, number) * 0.99)
    found = fixed32.fit(held, MODELS["9"], replace(fixed32.PAPER, max_iterations=iterations))
    expected = iterations * (100 * number + 3)
    assert found.operations == Operations(expected, expected)
    assert found.iterations == iterations


def test_a_smaller_model_costs_its_share() -> None:
    # an evaluation of the cost is 10 N operations; one for the start and one for each free parameter
    found = fixed32.fit(case(0), MODELS["6"], replace(fixed32.PAPER, max_iterations=4))
    assert found.operations == Operations(*[4 * (7 * 10 * 18 + 2)] * 2)


def test_parameters_that_are_not_free_are_not_probed() -> None:
    found = fixed32.fit(case(1), MODELS["3"], fixed32.PAPER)
    assert found.parameters[:6] == IDENTITY[:6] and found.parameters[9:] == IDENTITY[9:]
    assert all(found.parameters[6:9])


def test_the_sum_of_the_printed_objective_would_diverge() -> None:
    """Why the mean is used: 18 times the published rates leave the range at once."""
    with pytest.raises(FixedPointOverflowError):
        steep = {name: 18 * rate for name, rate in fixed32.RATES_OF_F.items()}
        fixed32.fit(case(0), MODELS["9"], replace(fixed32.PAPER, rates=steep))
