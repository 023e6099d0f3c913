"""When a device is to be serviced: every number, with its source."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from accelcal_cli.fleet.parameters import PARAMETERS, Kind
from accelcal_cli.fleet.records import Floats

SIGNIFICANT = 3.0
"""Standard errors beyond which a thing is certain; of drifts, their two-sided probability (0.27 %)."""
PERHAPS = 0.05
"""A drift that is not certain is told if it is less probable than this by chance; our choice."""
SLOPE_SPAN_C = 10.0
"""A drift of a temperature slope counts by what it does over so many degrees; our choice."""
FEWEST_DEVICES = 5
"""Devices of one kind among which one can lie outside; our choice."""
LEAST_SPREAD_MG = 0.5
"""A smaller spread of held-out errors between devices is taken for this; our choice."""
DAMAGED_FROM_PERCENT = 0.1
"""Share of a recording's bytes from which damage counts; our choice."""
REPEATED = 2
"""Recordings that make a thing repeated."""
DAYS_A_MONTH = 365.25 / 12


@dataclass(frozen=True, slots=True)
class Rules:
    """Limits; what is beyond is a reason.

    Attributes:
        offset_mg: guaranteed limit of x and y of the ADXL345 (Analog Devices, data sheet, table 1: 0 g
            output; z has 250).
        scale_percent: guaranteed limits of the same sensor (230 to 282 LSB/g for 256).
        misalignment_percent: our choice; that data sheet gives 1 % (typical cross-axis sensitivity), but
            three ActiGraph recordings at hand, of as many devices, show 5.1 to 5.6 %.
        slope_mg_per_c: our choice, above 3.9 (19.6 mg in 5 C), the highest that van Hees et al. 2014 report.
        drift_mg: a month; our choice: as much as a good calibration leaves on real recordings.
        drift_percent: a month; our choice: as much as `drift_mg` at 1 g.
        outlying: robust standard deviations above the other devices' held-out error; our choice.
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
    refused_percent: float = 50.0
    damaged_percent: float = 50.0
    least_days: float = 14.0
    reference_c: float | None = None

    def levels(self) -> Floats:
        """Largest distance of each parameter from its ideal, in its unit, (12,)."""
        limit = {
            Kind.SCALE: self.scale_percent,
            Kind.MISALIGNMENT: self.misalignment_percent,
            Kind.OFFSET: self.offset_mg,
            Kind.SLOPE: self.slope_mg_per_c,
        }
        return np.array([limit[parameter.kind] for parameter in PARAMETERS])

    def drifts(self) -> Floats:
        """Largest drift of each parameter, in its unit a month, (12,)."""
        limit = {
            Kind.SCALE: self.drift_percent,
            Kind.MISALIGNMENT: self.drift_percent,
            Kind.OFFSET: self.drift_mg,
            Kind.SLOPE: self.drift_mg / SLOPE_SPAN_C,
        }
        return np.array([limit[parameter.kind] for parameter in PARAMETERS])
