"""The calibration that a device's maker ships with its files: what a reader applied before all else.

Most devices apply it themselves, and their files hold calibrated counts. Where a file holds counts of the
bare sensor and the maker's numbers beside them, a reader applies these, so that everything behind it sees
what the maker's own software shows. The report says so, since coefficients found behind it hold only there.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

Three = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class FactoryAcceleration:
    """Acceleration [g] = g_per_count (counts - offset_counts).

    Attributes:
        source: the part of the file that holds it.
        method: the maker's number of its kind.
        sample_rate_hz: the rate for which it holds.
        offset_counts: of raw x, y, z.
        g_per_count: 3 x 3, symmetric.
    """

    source: str
    method: int
    sample_rate_hz: int
    offset_counts: Three
    g_per_count: tuple[Three, Three, Three]


@dataclass(frozen=True, slots=True)
class FactoryTemperature:
    """Temperature on the line through two points, at which the thermometer gave so many counts.

    Attributes:
        source, method: as above.
        counts, celsius: the low and the high point.
    """

    source: str
    method: int
    counts: tuple[float, float]
    celsius: tuple[float, float]


@dataclass(frozen=True, slots=True)
class FactoryCalibration:
    """What was applied; None where there was nothing to apply."""

    acceleration: FactoryAcceleration | None = None
    temperature: FactoryTemperature | None = None

    def as_json(self) -> dict[str, Any]:
        """The report's `recording.factory_calibration`."""
        values: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        return values

    def notes(self) -> tuple[str, ...]:
        """For people."""
        told = []
        if self.acceleration is not None:
            part = self.acceleration
            rate = f"for {part.sample_rate_hz} Hz"
            told.append(f"the maker's calibration ({part.source}, {rate}) was applied before any other")
        if self.temperature is not None:
            told.append(f"the maker's calibration of the thermometer ({self.temperature.source}) was applied")
        return tuple(told)
