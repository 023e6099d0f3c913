"""Probabilities against scipy."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import special

from accelcal_cli.devices.trends import normal, t_test


@given(st.floats(-60, 60), st.integers(1, 400))
def test_student_is_scipys(t: float, freedom: int) -> None:
    assert t_test(t, freedom) == pytest.approx(2 * special.stdtr(freedom, -abs(t)), rel=1e-6, abs=1e-13)


def test_the_tables_of_books() -> None:
    """97.5 % quantiles, as in every table of Student's t."""
    for t, freedom in ((12.706, 1), (4.303, 2), (3.182, 3), (2.776, 4), (2.228, 10), (2.042, 30)):
        assert t_test(t, freedom) == pytest.approx(0.05, rel=1e-3)
    assert (t_test(0, 1), t_test(0, 2)) == (1, 1)


def test_normal() -> None:
    assert normal(3) == pytest.approx(0.0026998, rel=1e-5)
    assert normal(-1.959964) == pytest.approx(0.05, rel=1e-6)
