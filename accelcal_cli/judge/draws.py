"""Calibrations in standard g: of a fit, and of sensors that its posterior holds plausible.

What is computed from calibrated values is as uncertain as the calibration: the same computation with each of
many plausible calibrations shows by how much, also where it is far from linear, as ENMO is at rest.
"""

from __future__ import annotations

from dataclasses import dataclass

from accelcal_cli.core.calibration import Calibration, in_standard_g
from accelcal_cli.core.gravity import Gravity
from accelcal_cli.core.points import MODELS, Fit, Model, PointSet
from accelcal_cli.judge.posterior import Posterior, drawn_sensors


@dataclass(frozen=True, slots=True, eq=False)
class DrawnSensors:
    """The sensors of a posterior of points in units of local gravity; see `PlausibleSensors`.

    A bend of the response, which no coefficients correct, takes no part.
    """

    known: Posterior
    points: PointSet
    gravity: Gravity

    def draws(self, number: int, seed: int) -> list[Calibration]:
        """See `PlausibleSensors`."""
        drawn = drawn_sensors(self.known, self.points, number, seed)
        return [_in_standard_units(self.known.model, one, self.points, self.gravity) for one in drawn]


def calibration_of_fit(model: str, fit: Fit, points: PointSet, gravity: Gravity) -> Calibration:
    """Return the calibration of a fit to points in units of local gravity, in standard g."""
    return _in_standard_units(MODELS[model], fit.parameters, points, gravity)


def _in_standard_units(
    model: Model, parameters: tuple[int, ...], points: PointSet, gravity: Gravity
) -> Calibration:
    scale = points.temperature if model.has_temperature else None
    return Calibration(model.name, in_standard_g(parameters, gravity.local_g()), scale, gravity)
