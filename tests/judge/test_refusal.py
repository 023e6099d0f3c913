"""What refusals say of rest that no wrist and no sensor gives: unit, scale, columns and fields."""

from __future__ import annotations

from dataclasses import replace

import pytest

from accelcal_cli.core.results import Rest
from accelcal_cli.judge.refusal import odd_rest

SOUND = Rest(
    windows=100,
    median_g=1.02,
    p5_g=0.9,
    p95_g=1.1,
    axis_min_g=(-1.0, -0.9, -1.1),
    axis_max_g=(1.0, 1.1, 0.9),
    samples_median_g=1.0,
)


def seen(lsb_per_g: float = 256.0, *, decimal: bool = False, **changed: object) -> str | None:
    return odd_rest(replace(SOUND, **changed), lsb_per_g, decimal=decimal)


def test_nothing_is_odd_about_a_sensor_with_large_errors() -> None:
    assert seen() is None
    assert seen(median_g=0.75, p5_g=0.6, p95_g=1.05) is None
    assert seen(windows=0) is None


@pytest.mark.parametrize(
    ("median_g", "said"),
    [
        (9.7, "as if values in m/s2 were read as g"),
        (1010.0, "as if values in mg were read as g"),
        (0.1, "as if values in g were read as m/s2"),
        (0.001, "as if values in g were read as mg"),
    ],
)
def test_a_wrong_unit_is_named(median_g: float, said: str) -> None:
    text = seen(decimal=True, median_g=median_g)
    assert text is not None
    assert text.startswith(f"rest measures {median_g:.3g} g instead of 1 g, {said}; check the unit")


def test_counts_per_g_that_would_fit_are_named() -> None:
    text = seen(128.0, median_g=2.0)
    assert text is not None and "256 counts per g would fit instead of 128" in text
    assert "counts per g" not in (seen(2.0**24, decimal=True, median_g=2.0) or "")


def test_without_a_still_window_all_samples_are_looked_at() -> None:
    text = seen(windows=0, samples_median_g=14.5)
    assert text is not None and text.startswith("the median of |a| is 14.5 g instead of 1 g")
    assert seen(windows=0, samples_median_g=None) is None


def test_axes_of_one_column_and_an_axis_that_stays() -> None:
    assert (seen(alike=("x", "y")) or "").startswith("x and y hold the same values throughout")
    text = seen(axis_min_g=(0.03, -0.9, -1.1), axis_max_g=(0.04, 1.1, 0.9))
    assert text is not None
    assert text.startswith(
        "x stays at 0.03 g at rest while gravity moves y by 2.00 g and z by 2.00 g: check that x"
    )


def test_rest_of_any_length_is_said_with_its_range() -> None:
    text = seen(p5_g=0.36, p95_g=1.05)
    assert text is not None and text.startswith("rest measures anything from 0.36 to 1.05 g, more than")
