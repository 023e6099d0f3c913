"""Local gravity against the published formula's own figures and a hand calculation."""

from __future__ import annotations

from fractions import Fraction

import pytest

from accelcal_cli.core.gravity import Gravity, local_gravity


@pytest.mark.parametrize(
    ("latitude", "metres_per_s2"),
    [
        (0.0, 9.780327),
        (90.0, 9.780327 * 1.0053024),
        (-90.0, 9.780327 * 1.0053024),
        (45.0, 9.780327 * (1 + 0.0053024 / 2 - 0.0000058)),
        (30.0, 9.780327 * (1 + 0.0053024 / 4 - 0.0000058 * 3 / 4)),
    ],
)
def test_gravity_at_sea_level_where_the_sines_are_known(latitude: float, metres_per_s2: float) -> None:
    assert local_gravity(latitude) == pytest.approx(metres_per_s2, abs=1e-12)


def test_a_kilometre_up_takes_three_thousandths() -> None:
    assert local_gravity(20.0) - local_gravity(20.0, 1000.0) == pytest.approx(0.003086, abs=1e-12)


def test_without_a_place_rest_measures_exactly_one_g() -> None:
    assert Gravity().local_g() == 1
    assert Gravity(altitude_m=500.0).local_g() == 1


def test_local_g_has_nine_decimals_so_that_it_is_the_same_everywhere() -> None:
    assert Gravity(0.0, 0.0).local_g() == Fraction(997_315_801, 10**9)
    assert Gravity(90.0).local_g().denominator <= 10**9
