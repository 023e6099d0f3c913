"""F's descent by `laboratory/cases.py`, and Fig. 9: against `float64`, SciPy and measured figures."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.errors import DivergedError
from accelcal_cli.laboratory.cases import (
    CasePlan,
    DescentNumbers,
    Objective,
    convergence,
    descent,
    make_case,
    methods,
    trace,
)
from accelcal_cli.laboratory.simulation import Protocol, in_gauge
from accelcal_cli.laboratory.simulation import run as simulated
from accelcal_cli.pipeline.jobs import no_progress
from tests.cli.run import run
from tests.optimize.oracle import residual

PLAN = CasePlan(18, 0.001)
SIMULATION = ("evaluate", "simulation", "--cases", 3, "--points", 18, "--noise-mg", 1)


@pytest.mark.parametrize("index", range(3))
def test_the_paper_s_numbers_give_what_float64_gives(index: int) -> None:
    points = make_case(PLAN, 1, index).points
    (known,) = methods(("float64:paper",))
    mine, theirs = descent(DescentNumbers()).fit(points), known.fit(points)
    assert np.abs(np.subtract(mine.parameters, theirs.parameters)).max() / ONE < 1e-9
    assert mine.operations == theirs.operations and mine.iterations == theirs.iterations


@pytest.mark.parametrize(
    ("objective", "rates"),
    [("mean", (0.3, 0.8, 0.2)), ("sum", (0.002, 0.005, 0.0013)), ("root", (1.0, 2.5, 0.7))],
)
def test_every_objective_ends_at_its_minimum(objective: Objective, rates: tuple[float, float, float]) -> None:
    """SciPy from the same start."""
    points = make_case(CasePlan(144, 0.005), 1, 4).points

    def cost(p: np.ndarray) -> float:
        squares = residual(np.append(p, [0, 0, 0]), points.xyz_g()) + 1
        off = np.sqrt(squares) - 1 if objective == "root" else squares - 1
        return float((off**2).mean())

    best = minimize(cost, [1.0, 1, 1, 0, 0, 0, 0, 0, 0], method="BFGS", options={"gtol": 1e-10}).x
    end = trace(points, DescentNumbers(objective, rates, 3000))[-1]
    assert np.abs(end - best).max() < 5e-5


def test_the_sum_diverges_with_the_printed_rates() -> None:
    """With the mean none of 20 cases does, with the sum all."""
    points = [make_case(PLAN, 1, index).points for index in range(20)]
    for one in points:
        trace(one, DescentNumbers())
        with pytest.raises(DivergedError):
            trace(one, DescentNumbers("sum"))


def test_it_converges_as_an_independent_implementation_did() -> None:
    """Of that, all nine within 5e-3 of the 50th value: median 22, p90 36; within 1e-3: 38 and 47."""
    found = convergence(PLAN, DescentNumbers(), 200, 1, lambda _done: None)
    assert (found.cases, found.diverged) == (200, 0)
    for limit, median, p90 in ((5e-3, 22, 36), (1e-3, 38, 47)):
        assert found.within[limit]["median"] == pytest.approx(median, abs=2)
        assert found.within[limit]["p90"] == pytest.approx(p90, abs=2)
    ends = [one["misalignment"]["median"] or 0.0 for one in found.left.values()]
    assert ends[0] > ends[3] > ends[-1] > 0


def test_the_command_shows_one_more_method_and_its_convergence(capsys: pytest.CaptureFixture[str]) -> None:
    words = (*SIMULATION, "--optimizer", "gauss-newton")
    plain = json.loads(run(capsys, *words, "--json").out)
    assert "convergence" not in plain and len(plain["tables"][0]["methods"]) == 1
    said = json.loads(run(capsys, *words, "--iterations", 400, "--convergence", "--json").out)
    best, mine = said["tables"][0]["methods"]
    assert mine["method"] == "descent" and mine["iterations"] == 400
    errors = [np.array(list(one["mean_abs_error"].values())) for one in (mine, best)]
    assert np.abs(errors[0] - errors[1]).max() < 2e-4
    (course,) = said["convergence"]
    assert course["cases"] == 3 and "300" in course["left"] and set(course["within"]) == {"0.005", "0.001"}
    shown = run(capsys, *words, "--objective", "sum", "--convergence").out
    assert "It diverges in all cases." in shown and "descent: 3 x" in shown
    assert "All nine stay within 0.005" in run(capsys, *words, "--convergence").out
    assert run(capsys, *words, "--rates", "1,2").code == 2


def test_nine_points_are_enough_to_ask_for(capsys: pytest.CaptureFixture[str]) -> None:
    words = ("evaluate", "simulation", "--cases", 3, "--noise-mg", 1, "--optimizer", "fixed32:paper")
    (table,) = json.loads(run(capsys, *words, "--points", 9, "--json").out)["tables"]
    assert table["points"] == 9 and table["methods"][0]["cases"] == 3
    assert table["methods"][0]["operations"]["additions"] == 50 * (100 * 9 + 3)
    assert table["methods"][0]["predicted_charge_mc"]["ATmega328"] == pytest.approx(
        9.2 * table["methods"][0]["predicted_seconds"]["ATmega328"], rel=1e-3
    )
    assert run(capsys, *words, "--points", 8).code == 2


def test_g_s_symmetric_form_ends_where_the_lower_one_does() -> None:
    lower, symmetric = methods(("gauss-newton", "gauss-newton:symmetric"))
    points = make_case(PLAN, 1, 0).points
    apart = np.subtract(lower.fit(points).parameters, symmetric.fit(points).parameters)
    assert symmetric.label == "gauss-newton:symmetric" and np.abs(apart).max() / ONE < 1e-6


def test_a_gauge_does_not_change_lengths() -> None:
    nine = np.array([1.05, 0.93, 1.01, 0.03, -0.04, 0.02, 0.01, 0.02, 0.03])
    k, s = (np.zeros((3, 3)) for _ in range(2))
    for matrix, values in ((k, nine), (s, in_gauge(nine, "symmetric"))):
        matrix[[0, 1, 2, 1, 2, 2], [0, 1, 2, 0, 0, 1]] = values[:6]
    s += np.tril(s, -1).T
    assert s.T @ s == pytest.approx(k.T @ k)
    assert np.linalg.eigvalsh(s).min() > 0 and (in_gauge(nine, "lower") == nine).all()


@pytest.mark.nightly
def test_errors_in_the_symmetric_gauge_reach_their_own_bound() -> None:
    """Half the misalignment of K stands on either side of the diagonal of S."""
    protocol = Protocol(cases=150, points=(144,), noise_mg=(1.0,))
    lower, symmetric = (
        simulated(replace(protocol, gauge=gauge), methods(("gauss-newton",)), no_progress)[0]
        for gauge in ("lower", "symmetric")
    )
    for table in (lower, symmetric):
        assert table.scores[0].ratio_to_bound == pytest.approx(1, abs=0.08)
    assert symmetric.published is None and lower.published is not None
    assert np.mean(symmetric.bound[3:6]) < 0.7 * np.mean(lower.bound[3:6])
