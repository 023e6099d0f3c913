"""What other recordings say of a sensor before it is seen: priors learnt by empirical Bayes.

Each parameter is learnt on its own. A result is a posterior; what its recording alone says is found by
taking the prior out again. Across devices of a model the values are a Student's t distribution whose centre
and width are the most probable ones (`across_devices`); along one device they are a random walk
(`along_device`).

All of it is additions, multiplications, divisions and roots in a fixed order, and what is learnt is rounded:
the same bits on every machine.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import fsum, sqrt

from accelcal_cli.core.prior import POPULATION, Prior
from accelcal_cli.judge.posterior import log_ratio

LEAST_SHARE = 0.2
"""A value of which the recording itself tells less, and the prior the rest, says nothing."""

FEWEST_DEVICES = 5
"""Devices from which the distribution of a model is learnt."""

WIDTH_SPREAD = 0.5
"""Of the logarithm of a model's width over the population's: as if four devices had shown that of all models.
Five devices without any scatter give a third of the population's width, eleven a tenth."""

NARROWEST, WIDEST = 0.1, 3.0
"""Bounds of a learnt width, times the population's."""

ROUNDS, HALVINGS = 20, 20
SETTLED = 1e-8
"""A centre that moves by less has settled; it is rounded to ten times as much, at least."""

DECIMALS = (5,) * 9 + (7,) * 3
"""Of a learnt centre and width: a hundredth of a mg, of 0.1 %, and of a mg in 100 degrees C."""

WALK = (0.001,) * 3 + (0.001,) * 3 + (0.001,) * 3 + (0.0001,) * 3
"""By how much a parameter changes in a month (standard deviation): half of what `accelcal devices` takes for
a reason to service a device."""

OCCASION = (0.001,) * 3 + (0.001,) * 3 + (0.002,) * 3 + (0.0001,) * 3
"""By how much it differs between recordings of one day beyond their standard errors. Offsets: the mean
temperature differs by 4 degrees C, and they follow it by 0.5 mg per degree (data sheet of the ADXL345: 0.4
on x and y, typically)."""

UNDATED_MONTHS = 24.0
"""Between recordings of which one has no date."""


@dataclass(frozen=True, slots=True)
class Told:
    """What one recording, or device, says of a parameter by itself: a value and its variance."""

    value: float
    variance: float


@dataclass(frozen=True, slots=True)
class Past:
    """What another recording of a device says of a parameter, and when [months]; None: not known."""

    told: Told
    month: float | None


def own_words(value: float, error: float, centre: float, width: float, freedom: float) -> Told | None:
    """What a recording says without the prior with which its result was found; None if next to nothing.

    Precisions add up: 1 / error^2 = 1 / variance + that of the prior, where it was found.
    """
    away = (value - centre) / width
    prior = (freedom + 1) / (freedom + away * away) / (width * width)
    share = 1 - error * error * prior
    if not error > 0 or share < LEAST_SHARE:
        return None
    return Told(centre + (value - centre) / share, error * error / share)


def together(parts: Sequence[Told]) -> Told:
    """The mean of at least one, weighted by precision."""
    precision = fsum(1 / part.variance for part in parts)
    return Told(fsum(part.value / part.variance for part in parts) / precision, 1 / precision)


def across_devices(devices: Sequence[Told], centre: float, width: float, freedom: float) -> Told:
    """Centre and squared width of a parameter's distribution over devices of a model.

    Centre and scale of the t distribution that fits values with known variances best (as Lange, Little,
    Taylor 1989), with one degree of freedom less for the centre. The population is the prior of both: of the
    centre by its own centre and width, of the logarithm of the width by WIDTH_SPREAD. What is returned is of
    a device that was not among them: the variance of the centre is added.

    Args:
        centre, width: of the population.
    """
    scale = width
    middle = together([Told(centre, width * width), *_weighted(devices, centre, scale, freedom, flat=True)])
    for _ in range(ROUNDS):
        scale = _scale(devices, middle.value, width, freedom)
        before, weighted = middle, _weighted(devices, middle.value, scale, freedom)
        middle = together([Told(centre, width * width), *weighted])
        if abs(middle.value - before.value) < SETTLED:
            break
    return Told(middle.value, scale * scale + middle.variance)


def _weighted(
    devices: Sequence[Told], centre: float, scale: float, freedom: float, *, flat: bool = False
) -> Iterable[Told]:
    """Devices with the variance that the distribution gives them about its centre: far ones count little."""
    for one in devices:
        spread = scale * scale + one.variance
        away = 0.0 if flat else (one.value - centre) * (one.value - centre) / spread
        yield Told(one.value, spread * (freedom + away) / (freedom + 1))


def _scale(devices: Sequence[Told], centre: float, width: float, freedom: float) -> float:
    """The scale of the distribution about a centre, between bounds."""
    low, high = NARROWEST * width, WIDEST * width
    for _ in range(HALVINGS):
        middle = sqrt(low * high)
        if _too_narrow(devices, centre, middle, width, freedom):
            low = middle
        else:
            high = middle
    return sqrt(low * high)


def _too_narrow(devices: Sequence[Told], centre: float, scale: float, width: float, freedom: float) -> bool:
    """Whether devices and population speak for a larger scale: the slope of their log probability."""
    fewer = (len(devices) - 1) / len(devices)
    slopes = []
    for one in devices:
        spread = scale * scale + one.variance
        away = (one.value - centre) * (one.value - centre) / spread
        slopes.append(((freedom + 1) * away / (freedom + away) - fewer) * scale * scale / spread)
    return fsum(slopes) > log_ratio(scale, width) / (WIDTH_SPREAD * WIDTH_SPREAD)


def along_device(
    others: Sequence[Past], month: float | None, base: Told, walk: float, occasion: float
) -> Told:
    """A parameter of a device at a time, from its other recordings: a random walk seen with errors.

    What lies before and what lies after are filtered towards that time (Kalman), then put together with what
    is known without them, which gives way where the device is far from it. Recordings that contradict each
    other make it wider, by Birge's ratio.

    Args:
        others: at least one.
        month: when; None if it is not known.
        base: centre and squared width of the model's devices, or of the population.
        walk: standard deviation of a month's change.
        occasion: of the difference between two recordings of one day.
    """
    dated = sorted((one.month, one.told.value, one.told.variance) for one in others if one.month is not None)
    seen = [(when, Told(value, variance + occasion * occasion)) for when, value, variance in dated]
    undated = [
        (0.0, Told(one.told.value, one.told.variance + occasion * occasion))
        for one in others
        if one.month is None
    ]
    far = UNDATED_MONTHS
    if month is None:
        ends = [(seen, far)]
    else:
        before = [one for one in seen if one[0] <= month]
        after = [(-when, told) for when, told in reversed(seen) if when > month]
        ends = [
            (part, now - part[-1][0] if part else 0.0) for part, now in ((before, month), (after, -month))
        ]
    parts = [_later(part, walk, months) for part, months in (*ends, (undated, far)) if part]
    device = together(parts)
    ratio = _contradiction([*_filtered(seen, walk)[1], *_filtered(undated, walk)[1]])
    device = Told(device.value, device.variance * ratio)
    known = together([_loosened(base, device), device])
    return Told(known.value, known.variance + occasion * occasion)


def _loosened(base: Told, device: Told) -> Told:
    """What is known of the model, for a device that is far from it: its distribution has heavy tails."""
    away = (device.value - base.value) * (device.value - base.value) / (base.variance + device.variance)
    loose = max(1.0, (POPULATION.freedom + away) / (POPULATION.freedom + 1))
    return Told(base.value, base.variance * loose)


def _later(seen: Sequence[tuple[float, Told]], walk: float, months: float) -> Told:
    """What is known so many months after the last of some times."""
    state, _ = _filtered(seen, walk)
    assert state is not None
    return Told(state.value, state.variance + walk * walk * months)


def _filtered(seen: Sequence[tuple[float, Told]], walk: float) -> tuple[Told | None, list[float]]:
    """What is known at the last of some times; squared distances from those before, over their variance."""
    state: Told | None = None
    squares, last = [], 0.0
    for when, told in seen:
        if state is not None:
            state = Told(state.value, state.variance + walk * walk * (when - last))
            away = told.value - state.value
            squares.append(away * away / (state.variance + told.variance))
        state = told if state is None else together([state, told])
        last = when
    return state, squares


def _contradiction(squares: Sequence[float]) -> float:
    """By how much recordings differ more than is usual, as a ratio of variances; 1 where they do not."""
    return max(1.0, fsum(squares) / len(squares)) if squares else 1.0


def learnt(parts: Sequence[Told], reference_c: float | None) -> Prior:
    """The prior of twelve centres and squared widths, rounded; noise and tails are the population's."""
    rounded = [
        (round(one.value, digits), max(round(sqrt(one.variance), digits), 10.0**-digits))
        for one, digits in zip(parts, DECIMALS, strict=True)
    ]
    return Prior(
        centre=tuple(centre for centre, _ in rounded),
        width=tuple(width for _, width in rounded),
        freedom=POPULATION.freedom,
        noise_g=POPULATION.noise_g,
        noise_spread=POPULATION.noise_spread,
        noise_freedom=POPULATION.noise_freedom,
        reference_c=reference_c,
    )
