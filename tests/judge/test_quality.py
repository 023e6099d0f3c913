"""Errors by block of time and whether a calibration holds, on observations made here."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import Calibration, Correction
from accelcal_cli.core.gravity import STANDARD
from accelcal_cli.core.points import TimedMeans
from accelcal_cli.core.results import Change
from accelcal_cli.judge.change import ChangeSearch, ComparedErrors
from accelcal_cli.judge.quality import Period, QualityCheck, by_block, check, deviations_mg
from tests.judge.test_change import HOUR_SAMPLES, HOURS, calibration, constant, device, drift, means, step
from tests.judge.test_change import Course as Raw

LIMIT_MG = 10.0


def checked(course: Raw, found: Calibration, *, hours: int = HOURS, seed: int = 1) -> QualityCheck:
    observed = means(course, hours=hours, seed=seed)
    search = ChangeSearch(observed)
    change = search.find(found)
    compared = search.compared()
    assert compared is not None
    return check(compared, change, observed.blocks(), LIMIT_MG)


def off(found: Calibration, offset_g: tuple[float, float, float]) -> Calibration:
    """A calibration whose offsets are wrong by so much."""
    wrong = [value + round(one * ONE) for value, one in zip(found.parameters[6:9], offset_g, strict=True)]
    return replace(found, parameters=(*found.parameters[:6], *wrong, *found.parameters[9:]))


def test_errors_of_a_block_count_windows_alike() -> None:
    deviations = np.array([-3.0, 1.0, 2.0, -4.0, 9.0])
    windows, block = np.array([1, 18, 1, 30, 1]), np.array([0, 0, 0, 2, 2])
    found = by_block(deviations, windows, block)
    assert found[0].mean == float(Fraction(3 + 18 + 2, 20)) and found[0].p95 == 2.0  # 19 of 20 are no larger
    assert found[2].mean == pytest.approx((4 * 30 + 9) / 31) and found[2].p95 == 4.0
    assert sorted(found) == [0, 2]
    assert found[0].off == (-3.0, 1.0, 1.0)  # 1 of 20 is no larger than -3, and 19 of 20 no larger than 1
    assert found[2].off == (-4.0, -4.0, -4.0)


def test_deviations_are_those_of_the_definition() -> None:
    """By matrices, with slopes, in a place with its own gravity, and along a course."""
    observed, found = means(constant, warm=True, hours=20), calibration(slopes=1)
    local_g = float(STANDARD.local_g())
    assert observed.celsius is not None
    slope = np.outer(observed.celsius - 30, found.slope_g_per_c())
    a = (observed.mean_g + found.offset_g() + slope) @ found.gain().T
    expected = 1000 * (np.linalg.norm(a, axis=1) / local_g - 1)
    assert deviations_mg(observed, found, STANDARD) == pytest.approx(expected, abs=1e-9)
    raw = 1000 * (np.linalg.norm(observed.mean_g, axis=1) / local_g - 1)
    assert deviations_mg(observed, None, STANDARD) == pytest.approx(raw, abs=1e-9)
    moved = Correction(
        (0, 10 * HOUR_SAMPLES), ((ONE,) * 3,) * 2, ((0, 0, 0), (ONE // 100, 0, 0)), lines=False
    )
    shifted = observed.mean_g + np.outer(observed.block >= 10, [0.01 - 0.01 % 2**-29, 0, 0])
    a = (shifted + found.offset_g() + slope) @ found.gain().T
    along = deviations_mg(observed, replace(found, correction=moved), STANDARD)
    assert along == pytest.approx(1000 * (np.linalg.norm(a, axis=1) / local_g - 1), abs=1e-4)


def test_no_observations_have_no_errors() -> None:
    empty = TimedMeans(
        np.zeros(0, np.int64), np.zeros((0, 3)), None, HOUR_SAMPLES, 1.0, np.zeros(0, np.int64)
    )
    assert not len(deviations_mg(empty, calibration(), STANDARD))
    assert by_block(np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.int64)) == {}


@pytest.mark.parametrize("seed", range(1, 9))
def test_the_true_coefficients_hold(seed: int) -> None:
    found = checked(constant, calibration(), seed=seed)
    assert len(found.periods) == 1 and not found.degraded
    assert found.periods[0].given_mg == pytest.approx(found.periods[0].unseen_mg, abs=0.2)


def test_small_errors_are_no_degradation() -> None:
    """2 mg on an axis: less than what an alarm needs, though clearly seen."""
    (only,) = checked(constant, off(calibration(), (0.002, 0, 0))).periods
    assert not only.degraded and only.fall_mg[0] > 0


def test_coefficients_that_never_fitted_have_degraded_before() -> None:
    (only,) = checked(constant, off(calibration(), (0.012, -0.010, 0.012))).periods
    assert only.degraded and (only.first, only.end) == (0, HOURS)
    assert only.given_mg > 6 and only.unseen_mg < 2 and 3 < only.fall_mg[0] < only.fall_mg[1] < 10


def test_a_step_ends_what_held() -> None:
    before, after = checked(step, calibration()).periods
    assert (before.first, before.end, after.first, after.end) == (0, 23, 23, HOURS)
    assert not before.degraded and after.degraded
    assert before.given_mg < 1.6 and before.fall_mg[0] < 0
    assert after.given_mg > 6 and after.unseen_mg < 2


def test_coefficients_of_after_the_step_did_not_hold_before_it() -> None:
    """Found with the sensor as it was later."""
    later = off(calibration(), (-0.012, 0.010, -0.012))
    before, after = checked(step, later).periods
    assert before.degraded and not after.degraded


@pytest.mark.parametrize(
    ("hours", "size_g", "first", "degraded", "rises"),
    [
        (8, 0.012, 52, True, False),
        (6, 0.030, 54, True, True),  # found as a walk, whose parts would be a quarter of the recording
        (6, 0.012, 54, True, True),  # not found, but the error is beyond the limit
        (5, 0.012, 54, False, True),
        (2, 0.012, 0, False, False),
    ],
)
def test_a_step_at_the_end(hours: int, size_g: float, first: int, *, degraded: bool, rises: bool) -> None:
    """With few hours left it is too short to be a change of the sensor for sure."""

    def late(raw: np.ndarray, block: np.ndarray) -> np.ndarray:
        return raw + np.outer(block >= HOURS - hours, np.array([1, -1, 1]) * size_g)

    found = checked(late, calibration())
    assert (found.periods[-1].first, found.periods[-1].degraded, found.rises) == (first, degraded, rises)
    assert not found.periods[0].degraded


def test_a_drift_is_looked_at_in_four_parts() -> None:
    def fast(raw: np.ndarray, block: np.ndarray) -> np.ndarray:
        return raw + 2 * (drift(raw, block) - raw)

    periods = checked(fast, calibration()).periods
    assert [one.first for one in periods] == [0, 15, 30, 45]
    assert not periods[0].degraded and periods[-1].degraded
    falls = [one.given_mg - one.unseen_mg for one in periods]
    assert falls == sorted(falls)


def test_another_device_is_beyond_the_limit() -> None:
    before, after = checked(device, calibration()).periods
    assert not before.degraded and after.degraded and after.given_mg > LIMIT_MG


def test_an_error_beyond_the_limit_needs_no_better_one() -> None:
    """A sensor that no calibration makes good, as one whose axis is broken."""
    observed = means(constant, noise_g=0.016)
    search = ChangeSearch(observed)
    change = search.find(calibration())
    compared = search.compared()
    assert compared is not None
    (only,) = check(compared, change, observed.blocks(), LIMIT_MG).periods
    assert only.degraded and only.given_mg - only.unseen_mg < 1
    (only,) = check(compared, change, observed.blocks(), 20).periods
    assert not only.degraded


def test_at_a_sudden_change_all_stretches_together_may_be_clear() -> None:
    """Two stretches after it, with falls of 2 and 8 mg, say little by themselves."""
    falls = np.array([1.5] * 8 + [2.0, 8.0])
    number, unseen = np.arange(10), np.ones(10)
    compared = ComparedErrors(number, number, unseen + falls, unseen)
    before, after = check(compared, Change("step", at_block=8), 10, LIMIT_MG).periods
    assert (before.degraded, after.degraded) == (False, True) and after.fall_mg[0] < 0
    falls[:8] = 0.5
    compared = ComparedErrors(number, number, unseen + falls, unseen)
    before, after = check(compared, Change("step", at_block=8), 10, LIMIT_MG).periods
    assert (before.degraded, after.degraded) == (False, False)


def test_short_recordings_cannot_be_compared() -> None:
    search = ChangeSearch(means(step, hours=7))
    search.find(calibration())
    assert search.compared() is None
    assert QualityCheck((Period(0, 7, 1, 1, (0, 0), degraded=False),)).degraded == ()
