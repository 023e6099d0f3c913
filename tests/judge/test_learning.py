"""Priors learnt from other recordings: figures by hand, and what an exact model of a walk gives."""

from __future__ import annotations

import numpy as np
import pytest

from accelcal_cli.core.prior import POPULATION
from accelcal_cli.judge.learning import (
    DatedEstimate,
    Estimate,
    across_devices,
    along_device,
    learnt,
    own_estimate,
    together,
)


def test_a_recordings_own_words_are_its_result_without_the_prior() -> None:
    """A normal prior of weight 1 at 0 and a value of weight 4 at 10: 8, with variance 1/5."""
    found = own_estimate(8.0, 0.2**0.5, 0.0, 1.0, freedom=1e12)
    assert found is not None
    assert (found.value, found.variance) == (pytest.approx(10.0), pytest.approx(0.25))


def test_far_out_the_prior_of_heavy_tails_has_little_weight_to_take_out() -> None:
    """At twice the width: (4 + 1) / (4 + 4) of its precision, 0.625; 1 / 0.1 less that is 9.375."""
    found = own_estimate(2.0, 0.1**0.5, 0.0, 1.0, freedom=4.0)
    assert found is not None
    assert (found.value, found.variance) == (pytest.approx(2 / 0.9375), pytest.approx(1 / 9.375))


def test_what_only_the_prior_said_is_not_passed_on() -> None:
    assert own_estimate(0.0, 0.034, 0.0, 0.035, freedom=4.0) is None
    assert own_estimate(0.0, 0.0, 0.0, 0.035, freedom=4.0) is None


def test_precisions_weigh() -> None:
    assert together([Estimate(1.0, 1.0), Estimate(4.0, 0.5)]) == Estimate(3.0, 1 / 3)


def test_devices_that_agree_are_believed_by_their_number() -> None:
    """Without scatter the width solves -(n - 1) = 4 ln(width / 35 mg): for five e^-1 of it; at least 0.1."""
    for number, share in ((5, np.exp(-1)), (7, np.exp(-1.5)), (30, 0.1)):
        found = across_devices([Estimate(0.03, 1e-12)] * number, 0.0, 0.035, 4.0)
        spread = 0.035 * share
        of_centre = 1 / (number * 5 / 4 / spread**2 + 1 / 0.035**2)
        centre = 0.03 * number * 5 / 4 / spread**2 * of_centre
        assert found.value == pytest.approx(centre, rel=1e-2)
        assert found.variance == pytest.approx(spread**2 + of_centre, rel=5e-2)


def test_the_width_is_that_of_the_devices_without_their_own_errors() -> None:
    random = np.random.default_rng(3)
    true, errors = 0.01 + 0.006 * random.standard_t(4, 400), random.uniform(0.001, 0.008, 400)
    devices = [
        Estimate(float(x + e * random.standard_normal()), float(e * e))
        for x, e in zip(true, errors, strict=True)
    ]
    found = across_devices(devices, 0.0, 0.035, 4.0)
    assert found.value == pytest.approx(0.01, abs=0.001)
    assert found.variance**0.5 == pytest.approx(0.006, rel=0.15)


def test_one_device_unlike_the_others_moves_the_model_little() -> None:
    devices = [Estimate(0.03 + 0.001 * (number % 5 - 2), 1e-6) for number in range(10)]
    alone, odd = (
        across_devices(held, 0.0, 0.035, 4.0) for held in (devices, [*devices, Estimate(0.15, 1e-6)])
    )
    assert abs(odd.value - alone.value) < 0.001
    assert odd.variance**0.5 < 0.015


def exactly(
    past: list[DatedEstimate], month: float, base: Estimate, walk: float, occasion: float
) -> Estimate:
    """The same by one multivariate normal: a walk from a start that is not known."""
    times = np.array([one.month for one in past] + [month], float)
    start = times.min()
    walked = walk**2 * np.minimum.outer(times - start, times - start) + 1e6
    noise = np.diag([one.estimate.variance + occasion**2 for one in past])
    weights = np.linalg.solve(walked[:-1, :-1] + noise, walked[:-1, -1])
    value = weights @ [one.estimate.value for one in past]
    variance = walked[-1, -1] - weights @ walked[:-1, -1]
    known = together([base, Estimate(float(value), float(variance))])
    return Estimate(known.value, known.variance + occasion**2)


@pytest.mark.parametrize("month", [-3.0, 2.5, 4.0, 11.0])
def test_along_a_device_it_is_a_random_walk_seen_with_errors(month: float) -> None:
    past = [
        DatedEstimate(Estimate(1.0, 4.0), 0.0),
        DatedEstimate(Estimate(2.0, 1.0), 3.0),
        DatedEstimate(Estimate(1.5, 9.0), 4.0),
        DatedEstimate(Estimate(0.5, 2.0), 7.0),
    ]
    base = Estimate(0.0, 25.0)
    found, right = along_device(past, month, base, 0.7, 0.5), exactly(past, month, base, 0.7, 0.5)
    assert (found.value, found.variance) == (
        pytest.approx(right.value, abs=1e-4),
        pytest.approx(right.variance, rel=1e-4),
    )
    assert along_device(past[::-1], month, base, 0.7, 0.5) == found


def test_long_ago_and_undated_tell_less() -> None:
    """One other recording, variance 1: 0, 100 or (without a date) 24 months of a walk of 1 apart."""
    base = Estimate(0.0, 1e12)
    for month, then, variance in ((5.0, 5.0, 1.0), (105.0, 5.0, 101.0), (5.0, None, 25.0), (None, 5.0, 25.0)):
        found = along_device([DatedEstimate(Estimate(3.0, 1.0), then)], month, base, 1.0, 0.0)
        assert (found.value, found.variance) == (pytest.approx(3.0), pytest.approx(variance))


def test_recordings_that_contradict_each_other_are_believed_less() -> None:
    """0 and 10, each with variance 1 and no walk: a mean of 5, and 50 times its variance of 1/2."""
    past = [DatedEstimate(Estimate(0.0, 1.0), 0.0), DatedEstimate(Estimate(10.0, 1.0), 0.0)]
    assert along_device(past, 0.0, Estimate(5.0, 1e12), 0.0, 0.0).variance == pytest.approx(25.0)
    undated = [DatedEstimate(one.estimate, None) for one in past]
    assert along_device(undated, 0.0, Estimate(5.0, 1e12), 0.0, 0.0).variance == pytest.approx(25.0)


def test_a_device_that_is_far_from_its_model_is_not_drawn_to_it() -> None:
    """At 100, and (4 + 100^2 / 2) / 5 of the model's variance of 1."""
    found = along_device([DatedEstimate(Estimate(100.0, 1.0), 0.0)], 0.0, Estimate(0.0, 1.0), 0.0, 0.0)
    assert found.value == pytest.approx(100 * (1 - 1 / (1 + 1000.8)))


def test_what_is_learnt_is_rounded_and_noise_and_tails_stay() -> None:
    parts = [Estimate(1.00123456, 0.00345678**2)] * 3 + [Estimate(0.0123456, 1e-20)] * 9
    prior = learnt(parts, 30.0)
    assert (prior.centre[0], prior.width[0]) == (1.00123, 0.00346)
    assert (prior.centre[9], prior.width[3], prior.width[9]) == (0.0123456, 1e-5, 1e-7)
    assert (prior.freedom, prior.noise_g) == (POPULATION.freedom, POPULATION.noise_g)
