"""Priors of a sensor learnt from other recordings, by empirical Bayes.

Each parameter is learnt on its own. A result is a posterior; the estimate of its recording alone is found by
taking the prior out again. Across devices of a model, the values follow a Student's t distribution with the
most probable centre and width (`across_devices`); along one device they are a random walk (`along_device`).

All is additions, multiplications, divisions and roots in a fixed order, and the result is rounded, so that it
is the same bits on every machine.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import fsum, sqrt

from accelcal_cli.core.prior import POPULATION, Prior
from accelcal_cli.judge.posterior import log_ratio

LEAST_SHARE = 0.2
"""Share of the information on a value that must come from the recording itself, not from the prior."""

FEWEST_DEVICES = 5
"""Fewest devices from which the distribution of a model is learnt."""

WIDTH_SPREAD = 0.5
"""Standard deviation of the logarithm of a model's width over the population's, which counts like four
devices. Five devices without any scatter give 0.37 of the population's width, ten a tenth."""

NARROWEST, WIDEST = 0.1, 3.0
"""Bounds of a learnt width, times the population's."""

ROUNDS, HALVINGS = 20, 20
"""Most rounds in which centre and width are found in turn, and steps in which a width is bisected."""

SETTLED = 1e-8
"""Change of a centre below which it has settled; it is rounded to at least ten times as much."""

DECIMALS = (5,) * 9 + (7,) * 3
"""Decimals of a learnt centre and width: 0.01 mg, 0.001 %, and 0.01 mg in 100 degrees C."""

WALK = (0.001,) * 3 + (0.001,) * 3 + (0.001,) * 3 + (0.0001,) * 3
"""Standard deviation of a parameter's change in a month: half of what is a reason for `accelcal devices` to
have a device serviced."""

OCCASION = (0.001,) * 3 + (0.001,) * 3 + (0.002,) * 3 + (0.0001,) * 3
"""Standard deviation of a parameter between recordings of one day, beyond their standard errors. Offsets: the
mean temperature differs by 4 degrees C, and they follow it by 0.5 mg per degree (data sheet of the ADXL345:
0.4 on x and y, typically)."""

UNDATED_MONTHS = 24.0
"""Time assumed between two recordings of which one has no date [months]."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A parameter and its variance, as estimated from one recording or device alone."""

    value: float
    variance: float


@dataclass(frozen=True, slots=True)
class DatedEstimate:
    """The estimate of another recording of a device, and its time [months]; None if unknown."""

    estimate: Estimate
    month: float | None


def own_estimate(value: float, error: float, centre: float, width: float, freedom: float) -> Estimate | None:
    """Take the prior out of a result; None if the recording itself says next to nothing.

    Precisions add up: 1 / error^2 = 1 / variance + that of the prior at the result.

    Args:
        value, error: the result and its standard error.
        centre, width, freedom: those of the prior.
    """
    away = (value - centre) / width
    prior = (freedom + 1) / (freedom + away * away) / (width * width)
    share = 1 - error * error * prior
    if not error > 0 or share < LEAST_SHARE:
        return None
    return Estimate(centre + (value - centre) / share, error * error / share)


def together(parts: Sequence[Estimate]) -> Estimate:
    """Return the mean of at least one estimate, weighted by precision."""
    precision = fsum(1 / part.variance for part in parts)
    return Estimate(fsum(part.value / part.variance for part in parts) / precision, 1 / precision)


def across_devices(devices: Sequence[Estimate], centre: float, width: float, freedom: float) -> Estimate:
    """Return centre and squared width of a parameter's distribution for a further device of a model.

    Centre and scale of the t distribution that fits values with known variances best (as Lange, Little,
    Taylor 1989), with one degree of freedom less for the centre. The population is the prior of both: of the
    centre by its own centre and width, of the logarithm of the width by WIDTH_SPREAD. The variance of the
    centre is added, since the device was not among those given.

    Args:
        centre, width: those of the population.
    """
    scale = width
    middle = together(
        [Estimate(centre, width * width), *_weighted(devices, centre, scale, freedom, flat=True)]
    )
    for _ in range(ROUNDS):
        scale = _scale(devices, middle.value, width, freedom)
        before, weighted = middle, _weighted(devices, middle.value, scale, freedom)
        middle = together([Estimate(centre, width * width), *weighted])
        if abs(middle.value - before.value) < SETTLED:
            break
    return Estimate(middle.value, scale * scale + middle.variance)


def _weighted(
    devices: Sequence[Estimate], centre: float, scale: float, freedom: float, *, flat: bool = False
) -> Iterable[Estimate]:
    """Yield devices with their variance about the distribution's centre: distant ones count little."""
    for one in devices:
        spread = scale * scale + one.variance
        away = 0.0 if flat else (one.value - centre) * (one.value - centre) / spread
        yield Estimate(one.value, spread * (freedom + away) / (freedom + 1))


def _scale(devices: Sequence[Estimate], centre: float, width: float, freedom: float) -> float:
    """Return the scale of the distribution about a centre, between bounds: the most probable one."""
    low, high, fewer = NARROWEST * width, WIDEST * width, (len(devices) - 1) / len(devices)
    for _ in range(HALVINGS):
        scale, slopes = sqrt(low * high), []
        for one in devices:
            spread = scale * scale + one.variance
            away = (one.value - centre) * (one.value - centre) / spread
            slopes.append(((freedom + 1) * away / (freedom + away) - fewer) * scale * scale / spread)
        if fsum(slopes) > log_ratio(scale, width) / (WIDTH_SPREAD * WIDTH_SPREAD):
            low = scale
        else:
            high = scale
    return sqrt(low * high)


def along_device(
    others: Sequence[DatedEstimate], month: float | None, base: Estimate, walk: float, occasion: float
) -> Estimate:
    """Return a parameter of a device at a time, from its other recordings: a random walk seen with errors.

    Estimates before and after that time are filtered towards it (Kalman), then combined with what is known
    without them, which counts less if the device is far from it. Recordings that contradict each other widen
    the result, by Birge's ratio.

    Args:
        others: at least one.
        month: the time; None if unknown.
        base: centre and squared width of the model's devices, or of the population.
        walk: standard deviation of a month's change.
        occasion: standard deviation between recordings of one day.
    """
    all_dated = [
        (one.month, Estimate(one.estimate.value, one.estimate.variance + occasion * occasion))
        for one in others
    ]
    dated = [(when, estimate) for when, estimate in all_dated if when is not None]
    seen = sorted(dated, key=lambda one: (one[0], one[1].value, one[1].variance))
    undated = [(0.0, estimate) for when, estimate in all_dated if when is None]
    parts = [(seen, UNDATED_MONTHS), (undated, UNDATED_MONTHS)]
    if month is not None:
        parts[:1] = _until(seen, month)
    device = together([_later(part, walk, months) for part, months in parts if part])
    squares = [*_filtered(seen, walk)[1], *_filtered(undated, walk)[1]]
    birge = max(1.0, fsum(squares) / len(squares)) if squares else 1.0
    device = Estimate(device.value, device.variance * birge)
    # a model's distribution has heavy tails: what is known of it is widened for a device that is far from it
    away = (device.value - base.value) * (device.value - base.value) / (base.variance + device.variance)
    loose = max(1.0, (POPULATION.freedom + away) / (POPULATION.freedom + 1))
    known = together([Estimate(base.value, base.variance * loose), device])
    return Estimate(known.value, known.variance + occasion * occasion)


def _until(
    seen: list[tuple[float, Estimate]], month: float
) -> list[tuple[list[tuple[float, Estimate]], float]]:
    """Return estimates before a time and, as if time ran backwards, after it; and the time that is left."""
    before = [one for one in seen if one[0] <= month]
    after = [(-when, estimate) for when, estimate in reversed(seen) if when > month]
    return [(part, now - part[-1][0]) for part, now in ((before, month), (after, -month)) if part]


def _later(seen: Sequence[tuple[float, Estimate]], walk: float, months: float) -> Estimate:
    """Return the estimate some months after the last of the times."""
    state, _ = _filtered(seen, walk)
    assert state is not None
    return Estimate(state.value, state.variance + walk * walk * months)


def _filtered(seen: Sequence[tuple[float, Estimate]], walk: float) -> tuple[Estimate | None, list[float]]:
    """Filter estimates up to the last of the times; also return squared steps over their variances."""
    state: Estimate | None = None
    squares, last = [], 0.0
    for when, estimate in seen:
        if state is not None:
            state = Estimate(state.value, state.variance + walk * walk * (when - last))
            away = estimate.value - state.value
            squares.append(away * away / (state.variance + estimate.variance))
        state = estimate if state is None else together([state, estimate])
        last = when
    return state, squares


def learnt(parts: Sequence[Estimate], reference_c: float | None) -> Prior:
    """Return the prior of twelve centres and squared widths, rounded; noise and tails of the population."""
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
