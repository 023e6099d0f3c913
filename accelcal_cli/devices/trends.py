"""Level and drift of each parameter of each device: weighted least squares of all devices at once.

Offsets are first brought to one temperature, so that recordings with and without slopes can be compared.
`Rules` holds every limit beyond which a device should be serviced, with its source.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from math import isnan, nan, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import normal_probability, student_t_probability
from accelcal_cli.core.settings import DEFAULT
from accelcal_cli.devices import table
from accelcal_cli.devices.table import (
    FACTOR,
    IDEAL,
    OFFSETS,
    PARAMETERS,
    SLOPES,
    Floats,
    Indices,
    Mask,
    Parameter,
    Records,
    Usage,
    mask,
)
from accelcal_cli.judge.learning import OCCASION, WALK

SIGNIFICANT = 3.0
"""Number of standard errors beyond which a level is certain; drifts need that probability (0.27 %)."""
SLOPE_SPAN_C = 10.0
"""Temperature span [degrees C] over which a drift of a temperature slope counts; our choice."""
DAYS_A_MONTH = 365.25 / 12
FEWEST = 3
"""Number of recordings from which on a drift is reported: two give a line, but not how good it is."""
TEMPERATURE_DOUBT_C = 4.0
"""Standard deviation [degrees C] of the unknown mean temperature of a recording without slopes about the
reference; our choice, of the order of the spread between people, seasons and bedrooms.
"""


@dataclass(frozen=True, slots=True)
class Rules:
    """Limits beyond which a device has a reason for service.

    Attributes:
        offset_mg: guaranteed limit of x and y of the ADXL345 (Analog Devices, data sheet, table 1: 0 g
            output; z has 250).
        scale_percent: guaranteed limits of the same sensor (230 to 282 LSB/g for 256).
        misalignment_percent: our choice; that data sheet gives 1 % (typical cross-axis sensitivity), but
            three ActiGraph recordings at hand, of as many devices, show 5.1 to 5.6 %.
        slope_mg_per_c: our choice, above 3.9 (19.6 mg in 5 C), the highest that van Hees et al. 2014 report.
        drift_mg: drift a month; our choice: as much as a good calibration leaves on real recordings.
        drift_percent: drift a month; our choice: as much as `drift_mg` at 1 g.
        outlying: robust standard deviations above the other devices' held-out error; our choice.
        certain_mg: upper end of a recording's calibration error from which on it does not judge its device;
            that of a good calibration.
        refused_percent, damaged_percent: share of a device's recordings; our choice.
        least_days: shortest span of time that gives a drift; our choice.
        reference_c: temperature of the offsets; None for each device's own median.
    """

    offset_mg: float = 150.0
    scale_percent: float = 10.0
    misalignment_percent: float = 10.0
    slope_mg_per_c: float = 5.0
    drift_mg: float = 2.0
    drift_percent: float = 0.2
    outlying: float = 5.0
    certain_mg: float = DEFAULT.max_error_mg
    refused_percent: float = 50.0
    damaged_percent: float = 50.0
    least_days: float = 14.0
    reference_c: float | None = None

    def levels(self) -> Floats:
        """Return the largest distance of each parameter from its ideal, in its unit, (12,)."""
        scale, misalignment = self.scale_percent, self.misalignment_percent
        return np.repeat([scale, misalignment, self.offset_mg, self.slope_mg_per_c], 3)

    def drifts(self) -> Floats:
        """Return the largest drift of each parameter, in its unit a month, (12,)."""
        slope = self.drift_mg / SLOPE_SPAN_C
        return np.repeat([self.drift_percent, self.drift_percent, self.drift_mg, slope], 3)


def bounds_of(rule: str) -> tuple[float, float]:
    """Return the lowest and the highest value that one of the rules may have."""
    return (-100.0, 200.0) if rule == "reference_c" else (1e-9, 1e9)


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Values of p parameters in n recordings, by device; NaN for none.

    Attributes:
        values, errors: (n, p) values and their standard errors.
        days: (n,) starts of the recordings [days since 1970].
        first: (d + 1,) first row of each device.
    """

    values: Floats
    errors: Floats
    days: Floats
    first: Indices

    def where(self, kept: Mask) -> Measured:
        """Return the same without the values of other recordings."""
        values = np.where(kept[:, np.newaxis], self.values, nan)
        return Measured(values, self.errors, self.days, self.first)

    def weights(self) -> Floats:
        """Return 1 / SE^2, 0 where there is no value."""
        there = np.isfinite(self.values) & np.isfinite(self.errors)
        return np.divide(1.0, self.errors**2, out=np.zeros_like(self.errors), where=there)

    def total(self, values: Floats) -> Floats:
        """Sum over each device's recordings, (d, p)."""
        return np.asarray(np.add.reduceat(values, self.first[:-1], axis=0) if len(values) else values[:0])

    def spread(self, values: Floats) -> Floats:
        """Repeat the values of the devices for each of their recordings, (n, p)."""
        return np.repeat(values, np.diff(self.first), axis=0)


class Mean(NamedTuple):
    """The weighted mean of a parameter of a device; NaN without values.

    Attributes:
        number: number of values.
        scatter: chi^2 over freedom, NaN for a single value.
    """

    number: int
    value: float
    error: float
    scatter: float


class Line(NamedTuple):
    """A parameter of a device as a straight line over time; NaN where there are not enough recordings.

    Attributes:
        number: recordings with a value and a date.
        slope, slope_error: change in a day and its standard error.
        value, error: value of the line at the last of them, and its standard error.
        scatter: chi^2 over freedom.
    """

    number: int
    slope: float
    slope_error: float
    value: float
    error: float
    scatter: float


def means(measured: Measured) -> list[list[Mean]]:
    """Return weighted means, p of each device.

    Errors are f / sqrt(sum w), f^2 = chi^2 / (n - 1) if above 1, else 1.
    """
    weights = measured.weights()
    number, total = measured.total((weights > 0).astype(float)), measured.total(weights)
    values = np.where(weights > 0, measured.values, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        value = measured.total(weights * values) / total
        freedom = _masked(number - 1, number > 1)
        scatter = measured.total(weights * (values - measured.spread(value)) ** 2) / freedom
        error = _inflation(scatter) / np.sqrt(total)
    columns = (value, _masked(error, number > 0), scatter)
    return [[Mean(*cell) for cell in device] for device in _cells(number.astype(np.int64), *columns)]


def lines(measured: Measured, least_days: float) -> list[list[Line]]:
    """Fit y = a + b (t - t0) with weights w = 1 / SE^2, t0 the weighted mean of the times; p of each device.

    b = sum w (t - t0) y / S, S = sum w (t - t0)^2; SE(b) = f / sqrt(S); at a time t the line's error is
    f sqrt(1 / sum w + (t - t0)^2 / S); f^2 = chi^2 / (n - 2) where that is above 1, else 1 (Birge, Physical
    Review 40, 207, 1932; the scale factor of the Particle Data Group).
    """
    measured = measured.where(np.isfinite(measured.days))
    there = measured.weights() > 0
    number = measured.total(there.astype(float))
    begin, end = _extremes(measured, there)
    enough = (number >= FEWEST) & (end - begin >= least_days)
    with np.errstate(divide="ignore", invalid="ignore"):
        columns = [_masked(one, enough) for one in _fitted(measured, there, number, end)]
    return [[Line(*cell) for cell in device] for device in _cells(number.astype(np.int64), *columns)]


def _cells(*columns: NDArray[Any]) -> Iterator[Iterator[tuple[Any, ...]]]:
    """Turn columns (d, p) into the tuples of each device's parameters, as plain numbers."""
    for device in zip(*(column.tolist() for column in columns), strict=True):
        yield zip(*device, strict=True)


def _fitted(measured: Measured, there: Mask, number: Floats, last_day: Floats) -> tuple[Floats, ...]:
    """Return slope, its error, value and error at the last day (d, p), scatter; see `lines`."""
    weights, days = measured.weights(), measured.days[:, np.newaxis]
    total = measured.total(weights)
    centre, middle = (
        measured.total(weights * np.where(there, column, 0.0)) / total for column in (days, measured.values)
    )
    away = np.where(there, days - measured.spread(centre), 0.0)
    off = np.where(there, measured.values - measured.spread(middle), 0.0)
    square = measured.total(weights * away**2)
    slope = measured.total(weights * away * off) / square
    residual = np.where(there, off - measured.spread(slope) * away, 0.0)
    scatter = measured.total(weights * residual**2) / (number - 2)
    inflation, late = _inflation(scatter), last_day - centre
    error = inflation * np.sqrt(1 / total + late**2 / square)
    return slope, inflation / np.sqrt(square), middle + slope * late, error, scatter


def _inflation(scatter: Floats) -> Floats:
    return np.sqrt(np.where(scatter > 1, scatter, 1.0))


def _masked(values: Floats, kept: Mask) -> Floats:
    """Replace values that are not kept by NaN."""
    return np.asarray(np.where(kept, values, nan), np.float64)


def _extremes(measured: Measured, there: Mask) -> tuple[Floats, Floats]:
    """Return the first and last day of each device's values, (d, p); NaN where there are none."""
    if not len(there):
        return measured.values[:0], measured.values[:0]
    days = measured.days[:, np.newaxis]
    first = np.minimum.reduceat(np.where(there, days, np.inf), measured.first[:-1], axis=0)
    last = np.maximum.reduceat(np.where(there, days, -np.inf), measured.first[:-1], axis=0)
    return _masked(first, np.isfinite(first)), _masked(last, np.isfinite(last))


@dataclass(frozen=True, slots=True, eq=False)
class Referred:
    """Recordings with their offsets at one temperature a device.

    Attributes:
        temperature_c: (d,) of each device; NaN where none of its recordings has slopes.
    """

    records: Records
    temperature_c: Floats


def at_one_temperature(records: Records, counted: Mask, temperature_c: float | None = None) -> Referred:
    """Move the offsets of recordings with slopes to one temperature, and widen the errors.

    With slopes: o + s (T - Tref), variance SE(o)^2 + (T - Tref)^2 SE(s)^2; Tref is the mean temperature of
    the recording's points, about which offset and slope are nearly uncorrelated. Without: the offset is that
    at a mean temperature which is not known; its variance grows by (TEMPERATURE_DOUBT_C s)^2, s the
    weighted mean slope of the device.

    Args:
        counted: (n,) True for the recordings that decide the temperature.
        temperature_c: temperature for all devices; None for the median of each one's reference temperatures.
    """
    sloped = np.isfinite(records.values[:, SLOPES]).all(axis=1) & np.isfinite(records.number["reference_c"])
    chosen, slope = _of_devices(records, sloped & counted, temperature_c)
    target_c, mean = chosen[records.device_of()], slope[records.device_of()]
    away = np.where(sloped, target_c - records.number["reference_c"], nan)[:, np.newaxis]
    values, errors = records.values.copy(), records.errors.copy()
    moved = values[:, OFFSETS] + away * values[:, SLOPES]
    spread = np.where(sloped[:, np.newaxis], away * errors[:, SLOPES], TEMPERATURE_DOUBT_C * mean)
    known = np.isfinite(target_c)[:, np.newaxis]
    values[:, OFFSETS] = np.where(known & np.isfinite(away), moved, values[:, OFFSETS])
    widened = np.hypot(errors[:, OFFSETS], np.nan_to_num(spread))
    errors[:, OFFSETS] = np.where(known, widened, errors[:, OFFSETS])
    return Referred(replace(records, values=values, errors=errors), chosen)


def _of_devices(records: Records, sloped: Mask, temperature_c: float | None) -> tuple[Floats, Floats]:
    """Return temperature (d,) and weighted mean slope (d, 3) of each device that has slopes."""
    chosen = np.full(len(records.devices), nan)
    slope = np.full((len(records.devices), 3), nan)
    for device in range(len(records.devices)):
        rows = [row for row in records.rows(device) if sloped[row]]
        if not rows:
            continue
        own = float(np.median(records.number["reference_c"][rows]))
        chosen[device] = own if temperature_c is None else temperature_c
        weights = np.nan_to_num(1 / records.errors[rows, SLOPES] ** 2)
        total = weights.sum(axis=0)
        weighted = (weights * records.values[rows, SLOPES]).sum(axis=0)
        slope[device] = np.divide(weighted, total, out=np.zeros(3), where=total > 0)
    return chosen, slope


@dataclass(frozen=True, slots=True)
class Drift:
    """Change of a parameter in a month of 365.25 / 12 days.

    Attributes:
        per_month, error: in the parameter's unit.
        scatter: chi^2 over freedom about the line.
        freedom: number of recordings less two.
        probability: probability of such a drift, or a larger one, by chance (two-sided Student's t).
        significant: the probability is below that of 3 standard errors over the device's number of drifts.
    """

    per_month: float
    error: float
    scatter: float
    freedom: int
    probability: float
    significant: bool


@dataclass(frozen=True, slots=True)
class Trend:
    """A parameter of a device.

    Attributes:
        value: distance from the ideal, in the parameter's unit: where there is a drift at the last
            recording by the line, else the weighted mean.
        error: its standard error.
        number: number of recordings behind it.
        drift: None if there are not enough recordings.
    """

    parameter: Parameter
    value: float
    error: float
    number: int
    drift: Drift | None


def trends(records: Records, usage: list[Usage], rules: Rules) -> list[tuple[Trend, ...]]:
    """Return the trends of each device, of the parameters that were ever measured.

    Args:
        records: recordings with their offsets at one temperature a device.
    """
    values, errors = (records.values - table.IDEAL) * table.FACTOR, records.errors * table.FACTOR
    measured = Measured(values, errors, records.days, records.first)
    level = means(measured.where(mask(usage, *table.COUNTED)))
    drift = lines(measured.where(mask(usage, Usage.USED)), rules.least_days)
    found = []
    for device, fitted in zip(level, drift, strict=True):
        tested = sum(not isnan(line.slope) for line in fitted)
        cells = zip(table.PARAMETERS, device, fitted, strict=True)
        found.append(tuple(_trend(*cell, tested) for cell in cells if cell[1].number))
    return found


def _trend(parameter: Parameter, mean: Mean, line: Line, tested: int) -> Trend:
    if isnan(line.slope):
        return Trend(parameter, mean.value, mean.error, mean.number, None)
    freedom = line.number - FEWEST + 1
    chance = student_t_probability(line.slope / line.slope_error, freedom)
    certain = chance < normal_probability(SIGNIFICANT) / tested
    slope, error = line.slope * DAYS_A_MONTH, line.slope_error * DAYS_A_MONTH
    drift = Drift(slope, error, line.scatter, freedom, chance, certain)
    return Trend(parameter, line.value, line.error, line.number, drift)


# Jumps of a device's parameters between recordings: a sensor that changed, or a second sensor.
#
# What is known of the parameters is followed from recording to recording, as `judge/learning.py`
# expects sensors to behave: they walk a little in a month, and differ a little between occasions. A
# recording that lies far outside of that, by its own standard errors, contradicts those before it.

CONTRADICTS = 5.0
"""Number of standard deviations from which on a recording contradicts others; our choice. Steps of an offset
are found from some 15 mg on, since an offset differs by 2 mg between occasions."""
NEAR_DAYS = 2.0
"""Days between the starts of two recordings that are near in time; so are recordings that overlap."""

MONTHLY: Floats = np.square(np.array(WALK) * FACTOR)
OCCASIONAL: Floats = np.square(np.array(OCCASION) * FACTOR)


@dataclass(frozen=True, slots=True)
class Jump:
    """A recording that contradicts the one before it.

    Attributes:
        parameter: the one that contradicts most.
        change, error: its change and the standard deviation of that, in the parameter's unit.
        before, after: rows of the two recordings.
        near: they are near in time.
        returns: the later one agrees with recordings before an earlier jump.
    """

    parameter: Parameter
    change: float
    error: float
    before: int
    after: int
    near: bool
    returns: bool


@dataclass(frozen=True, slots=True)
class _State:
    """Estimate of a sensor's parameters (12,) from the recordings up to a row; NaN where nothing is known."""

    value: Floats
    variance: Floats
    row: int

    def after(self, months: float) -> Floats:
        """Return the variances some months later."""
        return self.variance + MONTHLY * months

    def distances(self, other: _State, months: float) -> Floats:
        """Return by how many standard deviations another state differs; 0 where either is unknown."""
        spread = np.sqrt(self.after(months) + other.variance)
        return np.asarray(np.nan_to_num(np.abs(other.value - self.value) / spread), np.float64)

    def with_recording(self, recording: _State, months: float) -> _State:
        """Return what is known with one more recording."""
        variance = self.after(months)
        share = variance / (variance + recording.variance)
        known, seen = np.isfinite(self.value), np.isfinite(recording.value)
        value = np.where(known & seen, self.value + share * (recording.value - self.value), self.value)
        spread = np.where(known & seen, (1 - share) * variance, variance)
        return _State(
            np.where(known, value, recording.value),
            np.where(known, spread, recording.variance),
            recording.row,
        )


def jumps(records: Records, rows: Iterable[int]) -> tuple[Jump, ...]:
    """Return the jumps of a device, in the order of time.

    Args:
        records: recordings with their offsets at one temperature a device.
        rows: the device's recordings that count, each with a date, in the order of time.
    """
    states: list[_State] = []
    found = []
    for row in rows:
        recording = _State(
            (records.values[row] - IDEAL) * FACTOR, (records.errors[row] * FACTOR) ** 2 + OCCASIONAL, row
        )
        if not states:
            states.append(recording)
            continue
        months = _months(records, states[-1], row)
        distances = states[-1].distances(recording, months)
        if distances.max() > CONTRADICTS:
            found.append(_jump(records, states, recording, int(distances.argmax())))
            states.append(recording)
        else:
            states[-1] = states[-1].with_recording(recording, months)
    return tuple(found)


def _months(records: Records, state: _State, row: int) -> float:
    return float(records.days[row] - records.days[state.row]) / DAYS_A_MONTH


def _jump(records: Records, states: list[_State], recording: _State, index: int) -> Jump:
    last, row = states[-1], recording.row
    months = [_months(records, state, row) for state in states]
    returns = any(
        state.distances(recording, later).max() < SIGNIFICANT
        for state, later in zip(states[:-1], months, strict=False)
    )
    lasted = float(np.nan_to_num(records.number["duration_s"][last.row])) / 86_400
    apart = float(records.days[row] - records.days[last.row])
    error = sqrt(last.after(months[-1])[index] + recording.variance[index])
    change = float(recording.value[index] - last.value[index])
    near = apart <= max(NEAR_DAYS, lasted)
    return Jump(PARAMETERS[index], change, error, last.row, row, near, returns)
