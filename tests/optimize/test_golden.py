"""The integers of one fixed case, the same on every machine and in every version."""

from __future__ import annotations

import json

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.points import MODELS
from tests.optimize.golden_case import GOLDEN, case, results
from tests.optimize.oracle import least_squares, paper_descent


def golden() -> dict[str, dict[str, object]]:
    assert GOLDEN.is_file(), f"{GOLDEN.name} is missing; `make golden` writes it"
    held: dict[str, dict[str, object]] = json.loads(GOLDEN.read_text("utf-8"))
    return held


def test_the_integers_are_those_on_file() -> None:
    assert results() == golden()


def test_what_is_on_file_is_right() -> None:
    """A golden file written by a broken version fails here."""
    held = golden()
    by_paper = paper_descent(case(warm=False).xyz_g(), 50)[-1]
    expected = {"paper 9": by_paper}
    for model in ("3", "6", "9", "9T"):
        optimum = least_squares(case(warm=model.endswith("T")), MODELS[model].free)
        assert optimum.converged
        expected[f"default {model}"] = optimum.p
    for name, parameters in expected.items():
        found = [value / ONE for value in held[name]["parameters"]]
        tolerance = 5e-5 if name.startswith("paper") else 1e-6
        assert max(abs(a - b) for a, b in zip(found, parameters, strict=True)) < tolerance, name
