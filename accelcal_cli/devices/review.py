"""A verdict on each device of a study, with its reasons; the review as JSON and as rows of recordings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from math import isfinite, isnan, nan, sqrt
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import normal_probability, student_t_probability
from accelcal_cli.core.errors import Reason
from accelcal_cli.core.identity import identity
from accelcal_cli.core.results import Outcome
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
from accelcal_cli.output.sentences import of_device

# Level and drift of each parameter of each device: weighted least squares of all devices at once.
#
# Offsets are first brought to one temperature, so that recordings with and without slopes can be
# compared. `Rules` holds every limit beyond which a device should be serviced, with its source.

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


# Findings on each device of a study: the rules, their findings as codes with values, and the verdict.

PERHAPS = 0.05
"""Probability below which a drift is reported although it is not certain; our choice."""
FEWEST_DEVICES = 5
"""Number of devices of one kind from which on one of them can lie outside; our choice."""
LEAST_SPREAD_MG = 0.5
"""Least spread [mg] of held-out errors between devices of one kind; our choice."""
REPEATED = 2
"""Number of recordings that make a problem repeated."""


class Verdict(StrEnum):
    """Verdict on a device: what to do with it."""

    TWO_SENSORS = "two_sensors"
    """Recordings contradict each other: sort out first which are of which sensor."""
    SERVICE = "service"
    WATCH = "watch"
    UNKNOWN = "unknown"
    """Nothing is wrong, as far as its recordings tell, and they do not tell enough."""
    GOOD = "good"


@dataclass(frozen=True, slots=True)
class Finding:
    """Finding of a rule, and the verdict that it supports."""

    reason: Reason
    verdict: Verdict


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Held-out errors [mg] of some recordings: their number, median, and the median of their low ends."""

    recordings: int
    median_mg: float
    low_mg: float


@dataclass(frozen=True, slots=True)
class DeviceReview:
    """A device.

    Attributes:
        key: serial, model and format, which its recordings share.
        rows: rows of its recordings in `Records`.
        firmware: all versions that its recordings name.
        counts: number of recordings by usage.
        sure: number of recordings whose own uncertainty is small enough to judge the device by.
        blamed: number of recordings that could not be calibrated although enough was recorded.
        damaged: number of recordings that lost bytes to damage.
        begin, end: starts of the first and the last recording that has a date.
        held_out: held-out errors of its own calibrations, of the sure ones if there are any; None without.
        least_high_mg: smallest upper end of the calibration errors of its recordings; None if unknown.
        reference_c: temperature of its offsets; None if no recording has slopes.
        worst_lost_percent: largest share of bytes that one of its recordings lost.
        jumps: recordings that contradict those before them.
    """

    key: table.DeviceKey
    rows: range
    firmware: tuple[str, ...]
    counts: dict[table.Usage, int]
    sure: int
    blamed: int
    damaged: int
    begin: str | None
    end: str | None
    held_out: HeldOut | None
    least_high_mg: float | None
    reference_c: float | None
    worst_lost_percent: float
    trends: tuple[Trend, ...]
    jumps: tuple[Jump, ...] = ()
    findings: tuple[Finding, ...] = field(default=())

    def counted(self, *wanted: table.Usage) -> int:
        """Return the number of recordings with one of these usages."""
        return sum(self.counts.get(use, 0) for use in wanted)

    @property
    def recordings(self) -> int:
        """Number of its recordings, copies counted once."""
        return sum(self.counts.values()) - self.counted(table.Usage.COPY)

    @property
    def refused(self) -> int:
        """Number of recordings that could not be calibrated by themselves."""
        return self.counted(*table.NOT_CALIBRATED)

    @property
    def held_out_mg(self) -> float | None:
        """Median held-out error."""
        return None if self.held_out is None else self.held_out.median_mg

    def fastest_drift(self, *kinds: table.Kind) -> Drift | None:
        """Return the fastest drift of some kinds of parameters; None if there are too few recordings."""
        drifts = [one.drift for one in self.trends if one.drift is not None and one.parameter.kind in kinds]
        return max(drifts, key=lambda drift: abs(drift.per_month), default=None)

    @property
    def verdict(self) -> Verdict:
        """Weightiest verdict that the findings support."""
        return self.findings[0].verdict if self.findings else Verdict.GOOD


@dataclass(frozen=True, slots=True)
class DeviceGroup:
    """Devices of one kind (model and format).

    Attributes:
        devices: number of devices with a held-out error that is sure.
        held_out_mg: median of their errors; None if there are none.
        spread_mg: 1.4826 times the median distance from it, which is a standard deviation of normal ones.
        recordings, refused, damaged: numbers of recordings of all devices of the kind; those refused are the
            ones in which enough was recorded.
    """

    devices: int
    held_out_mg: float | None
    spread_mg: float
    recordings: int
    refused: int
    damaged: int


def device_group(devices: Iterable[DeviceReview]) -> DeviceGroup:
    """Return the usual held-out error among devices, and its spread."""
    devices = list(devices)
    errors = [one.held_out.median_mg for one in devices if one.held_out is not None and one.sure]
    centre = median(errors) if errors else None
    spread = 0.0 if centre is None else 1.4826 * median(abs(error - centre) for error in errors)
    return DeviceGroup(
        len(errors),
        centre,
        spread,
        sum(device.recordings for device in devices),
        sum(device.blamed for device in devices),
        sum(device.damaged for device in devices),
    )


def findings(
    device: DeviceReview, others: DeviceGroup, rules: Rules, records: table.Records
) -> tuple[Finding, ...]:
    """Return what is found of a device, the weightiest first, by each rule the worst first.

    Args:
        others: the devices of its kind, itself included.
    """
    order = tuple(Verdict)
    listed = [*_jumps(device, records), *_drifts(device, rules), *_levels(device, rules)]
    listed += [*_outlying(device, others, rules), *_repeated(device, others, rules)]
    return tuple(sorted(listed or _unknown(device), key=lambda one: order.index(one.verdict)))


def _found(code: str, *, certain: bool, **values: Any) -> Finding:
    verdict = Verdict.SERVICE if certain else Verdict.WATCH
    return Finding(Reason(code, {**values, "certain": certain}), verdict)


def _jumps(device: DeviceReview, records: table.Records) -> Iterator[Finding]:
    """Yield the jump that shows two sensors, or else the largest one that is not part of a drift."""
    both = [one for one in device.jumps if one.near or one.returns]
    drifting = {one.parameter for one in device.trends if one.drift is not None and one.drift.significant}
    steps = [one for one in device.jumps if one.parameter not in drifting]
    for jump in sorted(both or steps, key=lambda one: -abs(one.change) / one.error)[:1]:
        pair = (jump.before, jump.after)
        values = {
            "parameter": jump.parameter.name, "unit": jump.parameter.unit, "change": jump.change,
            "error": jump.error, "paths": [records.text["path"][row] for row in pair],
            "starts": [records.text["start_time"][row] for row in pair], "returns": jump.returns,
        }  # fmt: skip
        if both:
            yield Finding(Reason("two_sensors", values), Verdict.TWO_SENSORS)
        else:
            yield Finding(Reason("device_step", values), Verdict.SERVICE)


def _drifts(device: DeviceReview, rules: Rules) -> Iterator[Finding]:
    """Yield drifts; where there are jumps, no line that is not certain is drawn through them."""
    limits = dict(zip(table.PARAMETERS, rules.drifts().tolist(), strict=True))
    drifts = [(trend, trend.drift) for trend in device.trends if trend.drift is not None]
    for trend, drift in sorted(drifts, key=lambda one: -abs(one[1].per_month) / limits[one[0].parameter]):
        large = abs(drift.per_month) > limits[trend.parameter]
        if large and (drift.significant or (drift.probability < PERHAPS and not device.jumps)):
            yield _found(
                "device_drift", certain=drift.significant, parameter=trend.parameter.name,
                unit=trend.parameter.unit,
                per_month=drift.per_month, error=drift.error, recordings=trend.number,
                limit=limits[trend.parameter],
            )  # fmt: skip


def _levels(device: DeviceReview, rules: Rules) -> Iterator[Finding]:
    limits = dict(zip(table.PARAMETERS, rules.levels().tolist(), strict=True))
    for trend in sorted(device.trends, key=lambda one: -abs(one.value) / limits[one.parameter]):
        beyond = abs(trend.value) - limits[trend.parameter]
        if beyond > 0:
            yield _found(
                "device_level", certain=beyond > SIGNIFICANT * trend.error, parameter=trend.parameter.name,
                unit=trend.parameter.unit, value=trend.value, error=trend.error,
                limit=limits[trend.parameter],
            )  # fmt: skip


def _outlying(device: DeviceReview, others: DeviceGroup, rules: Rules) -> Iterator[Finding]:
    """Yield an error beyond that of the other devices by more than the recordings' own intervals."""
    held_out = device.held_out
    if held_out is None or not device.sure or others.held_out_mg is None or others.devices < FEWEST_DEVICES:
        return
    spread = max(others.spread_mg, LEAST_SPREAD_MG)
    if held_out.low_mg > others.held_out_mg + rules.outlying * spread:
        yield _found(
            "device_held_out", certain=held_out.recordings >= REPEATED, held_out_mg=held_out.median_mg,
            low_mg=held_out.low_mg, usual_mg=others.held_out_mg, recordings=held_out.recordings,
        )  # fmt: skip


def _repeated(device: DeviceReview, others: DeviceGroup, rules: Rules) -> Iterator[Finding]:
    """Yield what happened twice, in a share of the recordings, and twice as often as to other devices."""
    number, elsewhere = device.recordings, others.recordings - device.recordings
    for code, count, all_of_kind, percent, more in (
        ("device_refused", device.blamed, others.refused, rules.refused_percent, {}),
        ("device_damaged", device.damaged, others.damaged, rules.damaged_percent,
         {"lost_percent": device.worst_lost_percent}),
    ):  # fmt: skip
        rest = all_of_kind - count
        often = count >= REPEATED and 100 * count >= percent * number
        if often and (elsewhere == 0 or count * elsewhere >= 2 * rest * number):
            usual = 100 * rest / elsewhere if elsewhere else None
            values = {"number": count, "recordings": number, "elsewhere_percent": usual, **more}
            yield Finding(Reason(code, values), Verdict.SERVICE)


def _unknown(device: DeviceReview) -> Iterator[Finding]:
    """Yield that no recording is sure enough to judge the device by, and how near the best of them comes."""
    if not device.sure:
        values = {
            "recordings": device.recordings, "refused": device.refused,
            "shared": device.counted(table.Usage.SHARED), "least_high_mg": device.least_high_mg,
        }  # fmt: skip
        yield Finding(Reason("device_not_known", values), Verdict.UNKNOWN)


DAMAGED_FROM_PERCENT = 0.1
"""Share of a recording's bytes [%] from which damage counts; our choice."""

DEVICE = ("serial", "device_model", "format", "device_firmware")
TEMPERATURES = ("reference_c", "one_temperature_c")
RESULT = ("path", "start_time", "outcome")
ERRORS = ("before_mg", "after_mg", "ci95_low_mg", "ci95_high_mg", "lost_percent")
AT_ONE = tuple(f"{parameter.column}_at_one_temperature" for parameter in table.PARAMETERS[table.OFFSETS])


@dataclass(frozen=True, slots=True, eq=False)
class Review:
    """All devices of a study.

    Attributes:
        records: as in the table.
        referred: the same recordings with offsets at one temperature a device.
        usage: usage of each recording.
        devices: all devices, those to service first.
        kinds: usual values among devices of a model and format.
    """

    records: table.Records
    referred: Referred
    usage: list[table.Usage]
    devices: tuple[DeviceReview, ...]
    kinds: dict[tuple[str, str], DeviceGroup]
    rules: Rules


def review(out: Path, rules: Rules, now_s: float) -> Review:
    """Judge the devices of the study in a folder.

    Args:
        now_s: the time [s since 1970].

    Raises:
        UsageError, UnreadableError: see `table.read`.
    """
    return judged(table.read(out, now_s), rules)


def judged(records: table.Records, rules: Rules) -> Review:
    """Judge the devices of recordings."""
    usage = table.usages(records)
    provisional = np.array([outcome == Outcome.PROVISIONAL for outcome in records.text["outcome"]], bool)
    small = ~(records.number[table.HIGH] > rules.certain_mg)  # also where it is not known
    sure = np.asarray(table.mask(usage, *table.OWN) & small & ~provisional)
    referred = at_one_temperature(records, table.mask(usage, *table.COUNTED), rules.reference_c)
    levels = trends(referred.records, usage, rules)
    known = _Known(records, referred, usage, sure)
    devices = [_reviewed(known, index, one) for index, one in enumerate(levels)]
    kinds = {
        kind: device_group(one for one in devices if one.key.kind == kind)
        for kind in sorted({one.key.kind for one in devices})
    }
    devices = [replace(one, findings=findings(one, kinds[one.key.kind], rules, records)) for one in devices]
    order = tuple(Verdict)
    devices.sort(key=lambda one: order.index(one.verdict))
    return Review(records, referred, usage, tuple(devices), kinds, rules)


@dataclass(frozen=True, slots=True, eq=False)
class _Known:
    """All recordings of a study, and the known facts about each.

    Attributes:
        sure: (n,) whether it has a calibration of its own that is certain enough to judge its device by.
    """

    records: table.Records
    referred: Referred
    usage: list[table.Usage]
    sure: table.Mask


def _reviewed(known: _Known, index: int, of_device: tuple[Trend, ...]) -> DeviceReview:
    records, rows = known.records, known.records.rows(index)
    uses = {row: known.usage[row] for row in rows}

    def used(*wanted: table.Usage) -> list[int]:
        return [row for row, use in uses.items() if use in wanted]

    single, own = used(*(use for use in table.Usage if use is not table.Usage.COPY)), used(*table.OWN)
    sure = [row for row in own if known.sure[row]]
    starts = [records.text["start_time"][row] for row in single if np.isfinite(records.days[row])] or [None]
    lost = np.nan_to_num(records.number["lost_percent"][single])
    highs = records.number[table.HIGH][own]
    enough = records.number["orientations"][used(*table.NOT_CALIBRATED)] >= DEFAULT.min_postures
    return DeviceReview(
        key=records.devices[index],
        rows=rows,
        firmware=tuple(sorted({*filter(None, records.text["device_firmware"][rows.start : rows.stop])})),
        counts=dict(Counter(uses.values())),
        sure=len(sure),
        blamed=int(np.count_nonzero(enough)),
        damaged=int(np.count_nonzero(lost >= DAMAGED_FROM_PERCENT)),
        begin=starts[0],
        end=starts[-1],
        held_out=_held_out(records, sure or own),
        least_high_mg=float(np.nanmin(highs)) if np.isfinite(highs).any() else None,
        reference_c=_number(known.referred.temperature_c, index),
        worst_lost_percent=float(lost.max(initial=0.0)),
        trends=of_device,
        jumps=jumps(known.referred.records, used(table.Usage.USED)),
    )


def _held_out(records: table.Records, rows: Sequence[int]) -> HeldOut | None:
    """Summarize held-out errors; one without an interval is treated as exact."""
    error, low = (records.number[name] for name in ("after_mg", "ci95_low_mg"))
    pairs = [
        (error[row], error[row] if isnan(low[row]) else low[row]) for row in rows if isfinite(error[row])
    ]
    if not pairs:
        return None
    return HeldOut(len(pairs), *(float(median(values)) for values in zip(*pairs, strict=True)))


def as_json(review: Review, devices: tuple[DeviceReview, ...]) -> dict[str, Any]:
    """Return the review of some devices as JSON; null for unknown values."""
    return {
        **identity("devices"),
        "recordings": len(review.records) + review.records.nameless,
        "without_serial": review.records.nameless,
        "failed_without_serial": review.records.failed,
        "rules": asdict(review.rules),
        "kinds": [
            {"model": model or None, "format": name or None, **asdict(known)}
            for (model, name), known in review.kinds.items()
        ],
        "devices": [_device(review, device) for device in devices],
    }


def _device(review: Review, device: DeviceReview) -> dict[str, Any]:
    return {
        "serial": device.key.serial,
        "model": device.key.model or None,
        "format": device.key.format or None,
        "firmware": list(device.firmware),
        "verdict": str(device.verdict),
        "reasons": [
            one.reason.as_json() | {"verdict": str(one.verdict), "text": of_device(one.reason)}
            for one in device.findings
        ],
        "recordings": device.recordings,
        "sure": device.sure,
        "uses": {str(use): number for use, number in sorted(device.counts.items())},
        "damaged": device.damaged,
        "first": device.begin,
        "last": device.end,
        "held_out_mg": device.held_out_mg,
        "reference_c": device.reference_c,
        "parameters": {
            trend.parameter.name: {
                "unit": trend.parameter.unit,
                "value": trend.value,
                "standard_error": trend.error,
                "recordings": trend.number,
                "drift": None if trend.drift is None else asdict(trend.drift),
            }
            for trend in device.trends
        },
        "history": [row(review, device, position) for position in device.rows],
    }


def row(review: Review, device: DeviceReview, position: int) -> dict[str, Any]:
    """Return one recording of a device: a row of the CSV, in the study's units."""
    records = review.records
    return {
        "serial": device.key.serial,
        "device_model": device.key.model or None,
        "format": device.key.format or None,
        "device_firmware": records.text["device_firmware"][position],
        "verdict": str(device.verdict),
        **{name: records.text[name][position] for name in RESULT},
        "use": str(review.usage[position]),
        "model": records.text["model"][position],
        **{name: _number(records.number[name], position) for name in ERRORS},
        **_parameters(review, position),
        "reason": records.text["reason"][position],
        "message": records.text["message"][position],
        "copy_of": records.copied(position),
    }


def columns() -> list[str]:
    """Return the names of a row's columns, in their order."""
    values = [name for one in table.PARAMETERS for name in (one.column, f"se_{one.column}")]
    moved = [name for one in AT_ONE for name in (one, f"se_{one}")]
    last = ("reason", "message", "copy_of")
    return [*DEVICE, "verdict", *RESULT, "use", "model", *ERRORS, *values, *TEMPERATURES, *moved, *last]


def _parameters(review: Review, position: int) -> dict[str, float | None]:
    """Return the parameters with their standard errors, and the offsets at the device's one temperature."""
    records, moved = review.records, review.referred.records
    columns: dict[str, float | None] = {}
    for index, parameter in enumerate(table.PARAMETERS):
        columns[parameter.column] = _number(records.values[:, index], position)
        columns[f"se_{parameter.column}"] = _number(records.errors[:, index], position)
    columns["reference_c"] = _number(records.number["reference_c"], position)
    device = int(records.first.searchsorted(position, side="right")) - 1
    columns["one_temperature_c"] = _number(review.referred.temperature_c, device)
    for name, index in zip(AT_ONE, range(12)[table.OFFSETS], strict=True):
        columns[name] = _number(moved.values[:, index], position)
        columns[f"se_{name}"] = _number(moved.errors[:, index], position)
    return columns


def _number(numbers: table.Floats, position: int) -> float | None:
    value = float(numbers[position])
    return value if isfinite(value) else None
