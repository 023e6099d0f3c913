"""Simulated sensors, with known errors, on the still windows of a real recording.

The postures of a wrist, their lengths and their order are hard to simulate. They are taken from a recording,
and only its sensor is replaced by one that is drawn, whose true error is known in every direction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.calibration import Calibration
from accelcal_cli.core.points import Windows
from accelcal_cli.core.recording import FLOAT_LSB_PER_G
from accelcal_cli.judge.errors import directions

Floats = NDArray[np.float64]

DIRECTIONS = 1000
"""Number of evenly spread directions over which a true error is averaged."""

LOOK_AHEAD = 1024
"""Number of windows that are searched together for the end of a bout."""


@dataclass(frozen=True, slots=True)
class Population:
    """Distribution of sensors, and of rests on a wrist.

    Attributes:
        gain_percent, misalignment_percent, offset_mg: largest deviation of the entries on and below the
            diagonal of K, and of the offsets, from the ideal ones, drawn evenly.
        one_misalignment_percent: size of one of the misalignments, with either sign; None: as the others.
        bout_mg, window_mg: standard deviation of |a| from bout to bout, and from window to window within one
            (docs/prior.md has those of wrists).
    """

    gain_percent: float = 3.0
    misalignment_percent: float = 2.0
    offset_mg: float = 50.0
    one_misalignment_percent: float | None = None
    bout_mg: float = 1.8
    window_mg: float = 0.6

    def draw(self, random: np.random.Generator) -> WornSensor:
        """Draw a sensor."""
        gain = np.eye(3) + np.diag(random.uniform(-1, 1, 3)) * self.gain_percent / 100
        below = random.uniform(-1, 1, 3) * self.misalignment_percent / 100
        place, side = int(random.integers(3)), int(random.choice((-1, 1)))
        if self.one_misalignment_percent is not None:
            below[place] = side * self.one_misalignment_percent / 100
        gain[1, 0], gain[2, 0], gain[2, 1] = below
        return WornSensor(gain, random.uniform(-1, 1, 3) * self.offset_mg / 1000)


@dataclass(frozen=True, slots=True, eq=False)
class WornSensor:
    """A simulated sensor, by the coefficients that correct it: a = gain (v + offset_g).

    Attributes:
        gain: (3, 3), lower triangular.
        offset_g: (3,).
    """

    gain: Floats
    offset_g: Floats

    def raw(self, true_g: Floats) -> Floats:
        """Return the measured values (n, 3) of true accelerations [g]."""
        return np.asarray(np.linalg.solve(self.gain, true_g.T).T - self.offset_g)


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """The rests of a recording.

    Attributes:
        windows: m still windows.
        directions: (m, 3) unit vectors of the true acceleration.
        bout: (m,) number of each window's bout, a run of windows of one posture.
    """

    windows: Windows
    directions: Floats
    bout: NDArray[np.int64]

    def worn(self, sensor: WornSensor, people: Population, random: np.random.Generator) -> Windows:
        """Return the windows as a sensor would have measured them, in counts of 1/FLOAT_LSB_PER_G g."""
        bouts = random.standard_normal(int(self.bout.max(initial=-1)) + 1)
        each = random.standard_normal(len(self.bout))
        length = 1 + (people.bout_mg * bouts[self.bout] + people.window_mg * each) / 1000
        raw = sensor.raw(self.directions * length[:, np.newaxis])
        counts = raw * FLOAT_LSB_PER_G * self.windows.samples[:, np.newaxis]
        return replace(self.windows, sums=np.rint(counts).astype(np.int64))


def track(windows: Windows, raw_g: Floats, calibration: Calibration, posture_degrees: float) -> Track:
    """Return the rests of a recording whose calibration is known.

    Args:
        raw_g: (m, 3) mean of each window [g].
        posture_degrees: angle from its first window at which a bout ends.
    """
    corrected = raw_g + calibration.offset_g()
    if windows.temperature_sums is not None:
        celsius = windows.temperature_sums / (1000 * windows.samples)
        warmer = celsius - calibration.reference_c()
        corrected = corrected + warmer[:, np.newaxis] * calibration.slope_g_per_c()
    true = corrected @ calibration.gain().T
    unit = true / np.linalg.norm(true, axis=1, keepdims=True)
    return Track(windows, unit, bouts(unit, posture_degrees))


def bouts(directions: Floats, posture_degrees: float) -> NDArray[np.int64]:
    """Return the number of each window's bout, (m,), from unit vectors (m, 3)."""
    nearest = np.cos(np.radians(posture_degrees))
    number = np.zeros(len(directions), np.int64)
    start = bout = 0
    for row in range(0, len(directions), LOOK_AHEAD):
        stop = min(row + LOOK_AHEAD, len(directions))
        number[row:stop] = bout
        begin = row
        while len(away := np.flatnonzero(directions[begin:stop] @ directions[start] < nearest)):
            start = begin = begin + int(away[0])
            bout += 1
            number[start:stop] = bout
    return number


def sphere_error_mg(sensor: WornSensor, gain: Floats, offset_g: Floats, local_g: float = 1.0) -> float:
    """Return the mean | |a| - 1 | of rest in all directions [thousandths of local gravity].

    Args:
        gain, offset_g: calibration, (3, 3) and (3,) in standard g; the identity and 0 for raw data.
        local_g: acceleration at rest.
    """
    raw_g = local_g * sensor.raw(directions(DIRECTIONS))
    deviation = np.linalg.norm((raw_g + offset_g) @ gain.T, axis=1) / local_g - 1
    return 1000 * float(np.abs(deviation).mean())
