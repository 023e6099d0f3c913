"""Level and drift of each parameter of each device, in people's units."""

from __future__ import annotations

from dataclasses import dataclass
from math import isnan

from accelcal_cli.fleet.lines import FEWEST, Line, Mean, Measured, lines, means
from accelcal_cli.fleet.parameters import FACTOR, IDEAL, PARAMETERS, Parameter
from accelcal_cli.fleet.records import Records
from accelcal_cli.fleet.rules import DAYS_A_MONTH, SIGNIFICANT, Rules
from accelcal_cli.fleet.student import normal, two_sided
from accelcal_cli.fleet.use import Use, mask


@dataclass(frozen=True, slots=True)
class Drift:
    """Change of a parameter in a month of 365.25 / 12 days.

    Attributes:
        per_month, error: in the parameter's unit.
        scatter: chi^2 over freedom about the line.
        freedom: recordings less two.
        probability: of so large a drift, or a larger one, by chance (two-sided Student's t).
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
        number: recordings behind it.
        drift: None where there are not enough recordings.
    """

    parameter: Parameter
    value: float
    error: float
    number: int
    drift: Drift | None


def trends(records: Records, found: list[Use], rules: Rules) -> list[tuple[Trend, ...]]:
    """Those of each device, of the parameters that were ever measured.

    Args:
        records: with their offsets at one temperature a device.
    """
    held = Measured((records.values - IDEAL) * FACTOR, records.errors * FACTOR, records.days, records.first)
    level = means(held.where(mask(found, Use.USED, Use.UNDATED)))
    drift = lines(held.where(mask(found, Use.USED)), rules.least_days)
    return [_of_device(*one) for one in zip(level, drift, strict=True)]


def _of_device(level: list[Mean], drift: list[Line]) -> tuple[Trend, ...]:
    tested = sum(not isnan(line.slope) for line in drift)
    cells = zip(PARAMETERS, level, drift, strict=True)
    return tuple(_trend(*cell, tested) for cell in cells if cell[1].number)


def _trend(parameter: Parameter, mean: Mean, line: Line, tested: int) -> Trend:
    if isnan(line.slope):
        return Trend(parameter, mean.value, mean.error, mean.number, None)
    freedom = line.number - FEWEST + 1
    chance = two_sided(line.slope / line.slope_error, freedom)
    certain = chance < normal(SIGNIFICANT) / tested
    slope, error = line.slope * DAYS_A_MONTH, line.slope_error * DAYS_A_MONTH
    drift = Drift(slope, error, line.scatter, freedom, chance, certain)
    return Trend(parameter, line.value, line.error, line.number, drift)
