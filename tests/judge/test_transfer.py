"""Coefficients judged on points that they were not found from: numbers calculated by hand."""

from __future__ import annotations

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import Calibration, TemperatureScale
from accelcal_cli.core.errors import Reason
from accelcal_cli.core.gravity import Gravity
from accelcal_cli.core.points import WEIGHT_ONE, PointSet
from accelcal_cli.core.results import Holdout
from accelcal_cli.judge.errors import applied, difference_mg, directions, temperatures_c
from accelcal_cli.judge.model_ladder import held_out, of_postures
from accelcal_cli.judge.verdict import SEEN, better, reason_pool_does_not_fit
from tests.optimize.oracle import points

PLAIN = (ONE, ONE, ONE) + (0,) * 9


def parameters(**changed: float) -> tuple[int, ...]:
    names = ("k_xx", "k_yy", "k_zz", "k_yx", "k_zx", "k_zy", "ox", "oy", "oz", "sx", "sy", "sz")
    held = dict(zip(names, PLAIN, strict=True)) | {name: round(v * ONE) for name, v in changed.items()}
    return tuple(held.values())


AXES = np.concatenate([np.eye(3), -np.eye(3)])


def test_all_points_are_judged_and_postures_count_alike() -> None:
    """x measures 1 + 1/16 on its two sides: before 62.5 mg there and 0 on four postures; after, an offset of
    -1/16 leaves 0 at +x and makes 125 mg at -x, and sqrt(1 + 1/256) - 1 = 1.9512 mg on the four others."""
    raw = AXES.copy()
    raw[:, 0] *= 1 + 1 / 16
    found = held_out(points(raw), Calibration("3", parameters(ox=-1 / 16)), Gravity(), 15.0, "told")
    assert found is not None
    assert (found.method, found.points, found.postures) == ("told", 6, 6)
    assert found.before.mean == pytest.approx(2 * 62.5 / 6)
    side = (np.sqrt(1 + 1 / 256) - 1) * 1000
    assert found.after.mean == pytest.approx((0 + 125 + 4 * side) / 6)
    assert found.after.median == pytest.approx(side)


def test_fewer_than_two_postures_tell_nothing() -> None:
    plain = Calibration("0", PLAIN)
    assert held_out(points(AXES[:1]), plain, Gravity(), 15.0, "") is None
    assert held_out(points(np.zeros((0, 3))), plain, Gravity(), 15.0, "") is None
    assert held_out(points(AXES[:2]), plain, Gravity(), 15.0, "") is not None


def test_a_full_gain_and_the_slope_as_calculated_by_hand() -> None:
    """tau = 0.5 of a span of 4 C about 20 C is 22 C, 3 C below the slopes' reference of 25 C."""
    tau = np.array([ONE // 2])
    xyz = np.array([[ONE // 2, ONE, -ONE]])
    one = np.ones(1, np.int64)
    held = PointSet(xyz, WEIGHT_ONE * one, one, tau, TemperatureScale(20_000, 4.0))
    assert temperatures_c(held).tolist() == [22.0]
    numbers = parameters(k_xx=1.25, k_zz=0.75, k_zx=0.5, ox=0.25, oy=-0.5, oz=0.125, sx=1 / 64)
    made = Calibration("12", numbers, TemperatureScale(25_000, 2.0), upper=(ONE // 4, 0, -ONE // 8))
    shift = -3 * (1 / 64) / 2
    expected = [1.25 * (0.75 + shift) + 0.125, 0.5 + 0.109375, 0.5 * (0.75 + shift) - 0.65625]
    assert [float(value[0]) for value in applied(held, made, Gravity())] == expected


def test_offsets_are_in_standard_g_and_errors_in_local_ones() -> None:
    place = Gravity(60.0)
    local = float(place.local_g())
    (x, _, _) = applied(points(AXES[:1]), Calibration("3", parameters(ox=0.125)), place)
    assert float(x[0]) == pytest.approx((local + 0.125) / local, abs=1e-15)


def held(*after_mg: float) -> Holdout:
    return of_postures("", len(after_mg), tuple((9.0, value) for value in after_mg))


def test_better_is_lower_on_the_same_postures_by_more_than_the_uncertainty() -> None:
    """Differences 3, 4, 5: 4 -+ 4.303 / sqrt(3) does not reach 0; 1, 4, 7: 4 -+ 3 * 4.303 / sqrt(3) does."""
    assert better(held(1, 1, 1), held(4, 5, 6))
    assert not better(held(1, 1, 1), held(2, 5, 8))
    assert not better(held(4, 5, 6), held(1, 1, 1))
    assert not better(held(1, 2), held(1, 2))


def test_the_difference_of_two_calibrations_by_hand() -> None:
    """Offsets 3/1024 and 4/1024 apart on two axes: 5/1024 g everywhere."""
    other = Calibration("3", parameters(ox=3 / 1024, oy=4 / 1024))
    largest, mean = difference_mg(Calibration("0", PLAIN), other, directions())
    assert largest == pytest.approx(5000 / 1024)
    assert mean == pytest.approx(5000 / 1024)


def test_calibrations_are_compared_at_one_temperature() -> None:
    """The same line about another reference is the same calibration; another slope is the same there."""
    one = Calibration("3T", parameters(ox=0.0, sx=1 / 128), TemperatureScale(20_000, 1.0))
    moved = Calibration("3T", parameters(ox=4 / 128, sx=1 / 128), TemperatureScale(24_000, 1.0))
    steeper = Calibration("3T", parameters(sx=1 / 32), TemperatureScale(20_000, 1.0))
    assert difference_mg(one, moved, directions())[0] == pytest.approx(0, abs=1e-9)
    assert difference_mg(one, steeper, directions()) == (0, 0)
    assert difference_mg(Calibration("0", PLAIN), moved, directions())[0] == pytest.approx(4000 / 128)


def test_one_bit_of_a_parameter_shows() -> None:
    other = Calibration("9", (ONE + 1, *PLAIN[1:]))
    largest, mean = difference_mg(Calibration("9", PLAIN), other, directions())
    assert 0 < mean < largest <= 1000 / ONE


@pytest.mark.parametrize(
    ("before", "after", "code", "compared"),
    [
        (5.0, 3.9, None, {}),
        (3.0, 3.9, None, {}),
        (3.0, 4.1, "worse_than_usual", {"usual_mg": 1.0}),
        (5.0, 4.1, None, {}),
        (30.0, 9.9, None, {}),
        (30.0, 10.0, "over_limit_here", {"limit_mg": 10.0}),
    ],
)
def test_larger_than_before_and_than_three_times_the_usual_and_a_mg_or_beyond_the_limit(
    before: float, after: float, code: str | None, compared: dict[str, float]
) -> None:
    held = of_postures(SEEN, 4, ((before, after), (before, after)))
    found = reason_pool_does_not_fit(held, usual_mg=1.0, limit_mg=10.0)
    values = {"before_mg": before, "after_mg": after, "orientations": 2, **compared}
    assert found == (None if code is None else Reason(code, values))
