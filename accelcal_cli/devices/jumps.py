"""Jumps of a device's parameters between recordings: a sensor that changed, or a second sensor.

What is known of the parameters is followed from recording to recording, as `judge/learning.py` expects
sensors to behave: they walk a little in a month, and differ a little between occasions. A recording that lies
far outside of that, by its own standard errors, contradicts those before it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import sqrt

import numpy as np

from accelcal_cli.devices.table import FACTOR, IDEAL, PARAMETERS, Floats, Parameter, Records
from accelcal_cli.devices.trends import DAYS_A_MONTH, SIGNIFICANT
from accelcal_cli.judge.learning import OCCASION, WALK

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
