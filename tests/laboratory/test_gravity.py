"""Table 8 of Grammenos, Mascolo, Crowcroft 2018, from what a wrong gravity must do."""

from __future__ import annotations

from fractions import Fraction

import pytest

from accelcal_cli.core.errors import DivergedError, UsageError
from accelcal_cli.core.gravity import STANDARD_GRAVITY, standard_g
from accelcal_cli.laboratory.cases import CasePlan, methods
from accelcal_cli.laboratory.gravity import Residuals, gravity_residuals, turn_residuals

LOCAL, STANDARD = 9.81676, 9.80665
SHIFT = (LOCAL**2 - STANDARD**2) ** 2
"""(|A|^2 - g^2)^2 where A measures standard gravity and g is the local one: 0.0394 m4/s8."""


def residuals(noise_g: float, *, number: int = 90, cases: int = 20) -> tuple[Residuals, ...]:
    plan = CasePlan(number, noise_g, rest_g=standard_g(LOCAL))
    return gravity_residuals(plan, methods(("gauss-newton",))[0], cases, 1, lambda done: None)


def test_the_shift_by_hand() -> None:
    assert pytest.approx(0.0393, abs=1e-4) == SHIFT  # (96.36878 - 96.17038)^2 = 0.1984^2


def test_without_noise_scale_absorbs_the_wrong_gravity_and_only_the_true_one_shows_it() -> None:
    default, local = residuals(1e-9)
    assert (default.assumed_m_s2, local.assumed_m_s2) == (STANDARD, LOCAL)
    assert default.against_assumed < 1e-9 and local.against_assumed < 1e-9 and local.against_true < 1e-9
    assert default.against_true == pytest.approx(SHIFT, rel=1e-4)
    assert default.norm_error_mg == pytest.approx(1e3 * (LOCAL - STANDARD) / STANDARD, rel=1e-4)  # 1.031 mg
    assert local.norm_error_mg < 1e-3


def test_with_noise_the_residual_is_that_of_the_noise() -> None:
    """|A|^2 - g^2 varies by (2 g sigma)^2; a fit of nine parameters takes 9 / N of it away."""
    default, local = residuals(0.001, cases=60)
    expected = 4 * LOCAL**2 * (0.001 * STANDARD_GRAVITY) ** 2 * (1 - 9 / 90)
    for found in (default.against_assumed, local.against_assumed):
        assert found == pytest.approx(expected, rel=0.05)
    assert local.against_true == local.against_assumed
    assert default.against_true == pytest.approx(expected + SHIFT, rel=0.05)
    assert local.norm_error_mg < 0.5 * default.norm_error_mg


def test_a_wrong_gravity_leaves_directions_and_so_the_gyroscope_as_they_are() -> None:
    plan = CasePlan(90, 0.0005, rest_g=standard_g(LOCAL))
    default, local = turn_residuals(plan, methods(("gauss-newton",))[0], 3, 1)
    assert (default.assumed_m_s2, local.assumed_m_s2) == (STANDARD, LOCAL)
    assert default.fitted == local.fitted == 3
    assert default.holdout_deg is not None and 0.02 < default.holdout_deg < 0.2
    assert default.holdout_deg == pytest.approx(local.holdout_deg, rel=1e-3)
    loud = turn_residuals(plan, methods(("gauss-newton",))[0], 0, 1)
    assert [one.holdout_deg for one in loud] == [None, None]


def test_the_same_seed_gives_the_same_residuals() -> None:
    assert residuals(0.001, cases=3) == residuals(0.001, cases=3)


def test_fits_that_fail_are_left_out_or_refused() -> None:
    plan = CasePlan(18, 0.001, rest_g=Fraction(5))  # beyond the range of fixed point
    with pytest.raises(DivergedError, match="no case could be fitted"):
        gravity_residuals(plan, methods(("fixed32",))[0], 2, 1, lambda done: None)


def test_nine_subsets_must_share_the_points() -> None:
    with pytest.raises(UsageError, match="20 points"):
        residuals(0.001, number=20)
