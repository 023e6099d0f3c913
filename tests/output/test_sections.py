"""Sections of a report that several documents share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest

from accelcal_cli.core.points import Fit, Model, PointSet
from accelcal_cli.core.settings import DEFAULT
from accelcal_cli.judge.model_ladder import Fitting
from accelcal_cli.judge.verdict import judge
from accelcal_cli.optimize import all_optimizers, named_optimizer
from accelcal_cli.output.report import calibration_json
from accelcal_cli.pipeline.procedures import optimizer_json
from tests.judge.made import NINE, spread


def described(name: str) -> dict[str, Any]:
    """The report's `optimizer` of a sensor with known errors."""
    optimizer = named_optimizer(name)

    def fit(sets: Sequence[PointSet], model: Model) -> list[Fit]:
        return optimizer.fits(sets, model, optimizer.settings["default"])

    found = calibration_json(
        judge(spread(NINE), Fitting(replace(DEFAULT, prior="none"), fit, optimizer.models)),
        optimizer_json(replace(DEFAULT, optimizer=optimizer.name)),
    )
    assert found is not None
    made: dict[str, Any] = found["optimizer"]
    return made


def test_predicted_seconds_are_the_operations_times_table_1() -> None:
    made = described("fixed32")
    additions, multiplications = made["operations"]["additions"], made["operations"]["multiplications"]
    assert made["arithmetic"] == "integer" and additions > 100
    by_hand = {
        "ATmega328": (28 * additions + 97 * multiplications) / 16e6,
        "ARM Cortex-M3": (14 * additions + 14 * multiplications) / 80e6,
        "ARM Cortex-M4": (7 * additions + 6 * multiplications) / 80e6,
    }
    assert made["predicted_seconds"] == pytest.approx(by_hand, rel=1e-3)


def test_what_is_not_counted_has_no_predicted_seconds() -> None:
    made = described("gauss-newton")
    assert made["arithmetic"] == "float"
    assert made["operations"] == {"additions": 0, "multiplications": 0}
    assert made["predicted_seconds"] is None


def test_every_optimizer_says_what_it_computes_with() -> None:
    found = {
        item.name: optimizer_json(replace(DEFAULT, optimizer=item.name))["arithmetic"]
        for item in all_optimizers()
    }
    assert {name for name, kind in found.items() if kind == "integer"} == {"fixed16", "fixed32"}
