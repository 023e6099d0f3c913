"""What `judge/verdict.py` says of rest that no wrist and no sensor gives: unit, scale, columns and fields."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from accelcal_cli.core.errors import Reason
from accelcal_cli.core.results import Rest
from accelcal_cli.judge.verdict import odd_rest

SOUND = Rest(
    windows=100, median_g=1.02, p5_g=0.9, p95_g=1.1, axis_min_g=(-1.0, -0.9, -1.1),
    axis_max_g=(1.0, 1.1, 0.9), samples_median_g=1.0,
)  # fmt: skip


def seen(lsb_per_g: float = 256.0, *, decimal: bool = False, **changed: Any) -> Reason | None:
    return odd_rest(replace(SOUND, **changed), lsb_per_g, decimal=decimal)


def test_nothing_is_odd_about_a_sensor_with_large_errors() -> None:
    assert seen() is None
    assert seen(median_g=0.75, p5_g=0.6, p95_g=1.05) is None
    assert seen(windows=0) is None


@pytest.mark.parametrize(
    ("median_g", "unit", "read_as"),
    [(9.7, "m/s2", "g"), (1010.0, "mg", "g"), (0.1, "g", "m/s2"), (0.001, "g", "mg")],
)
def test_a_wrong_unit_is_named(median_g: float, unit: str, read_as: str) -> None:
    assert seen(decimal=True, median_g=median_g) == Reason.of(
        "wrong_unit", of="rest", median_g=median_g, unit=unit, read_as=read_as
    )


def test_counts_per_g_that_would_fit_are_named() -> None:
    assert seen(128.0, median_g=2.0) == Reason.of(
        "wrong_counts_per_g", of="rest", median_g=2.0, lsb_per_g=128.0, fits=256.0
    )
    assert seen(2.0**24, decimal=True, median_g=2.0) == Reason.of("not_1_g", of="rest", median_g=2.0)


def test_without_a_still_window_all_samples_are_looked_at() -> None:
    found = seen(windows=0, samples_median_g=14.5)
    assert found is not None and (found.values["of"], found.values["median_g"]) == ("samples", 14.5)
    assert seen(windows=0, samples_median_g=0.0) == Reason.of("gravity_is_zero", of="samples")
    assert seen(windows=0, samples_median_g=None) is None


def test_axes_of_one_column_and_an_axis_that_stays() -> None:
    assert seen(alike=("x", "y")) == Reason.of("axes_alike", axes=["x", "y"])
    found = seen(axis_min_g=(0.03, -0.9, -1.1), axis_max_g=(0.04, 1.1, 0.9))
    assert found == Reason.of("axis_stuck", axis="x", at_g=0.03, others=["y", "z"], by_g=[2.0, 2.0])


def test_rest_of_any_length_is_said_with_its_range() -> None:
    assert seen(p5_g=0.36, p95_g=1.05) == Reason.of("rest_scatters", low_g=0.36, high_g=1.05)
