"""Which optimizers are compared."""

from __future__ import annotations

import importlib.util

import pytest

from accelcal_cli.core.errors import UsageError
from accelcal_cli.laboratory.cases import USUAL, methods
from accelcal_cli.optimize import all_optimizers
from accelcal_cli.optimize.fixed32 import DEFAULT, PAPER


def labels(*asked: str) -> list[str]:
    return [method.label for method in methods(asked)]


def test_without_a_choice_the_usual_ones() -> None:
    assert labels() == list(USUAL) == ["fixed32", "fixed32:paper", "float64:paper", "fixed16", "gauss-newton"]


def test_a_label_chooses_the_settings() -> None:
    assert [method.settings for method in methods(("fixed32", "fixed32:paper"))] == [DEFAULT, PAPER]


def test_each_once_in_the_order_asked_for() -> None:
    assert labels("gauss-newton", "fixed32", "gauss-newton") == ["gauss-newton", "fixed32"]


def test_all_are_all_and_their_paper_settings_where_these_differ() -> None:
    found = labels("all")
    assert {item.name for item in all_optimizers()} <= set(found)
    extra = [label for label in found if ":" in label]
    assert extra == ["fixed32:paper", "float32:paper", "float64:paper"]  # fixed16 has one set of settings


def test_all_without_scipy_leaves_out_what_needs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "accelcal_cli.laboratory.cases.find_spec",
        lambda name: None if name == "scipy" else importlib.util.find_spec(name),
    )
    missing = {item.name for item in all_optimizers()} - set(labels("all"))
    assert missing == {"bfgs", "differential-evolution"}


def test_an_unknown_name_or_profile_is_answered_with_the_known_ones() -> None:
    with pytest.raises(UsageError, match=r"'gradient'.*fixed32"):
        methods(("gradient",))
    with pytest.raises(UsageError, match=r"gauss-newton has no settings of profile 'paper'.*default"):
        methods(("gauss-newton:paper",))
