"""Columns of temperatures: their names and units, in tables of all kinds."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.vocabulary import TEMPERATURES, normalized

NEAR = "(?:device|die|chip|sensor|board|imu|mcu|cpu|internal|case|accelerometer|accel|acc)*"
HEAT = re.compile(rf"{NEAR}(temperatur(?:e|es|a)?|temperatuur|temps?|tmp|温度|온도|температура){NEAR}")
"""Normalized names of the temperature of a device."""

WORD = re.compile(r"(?:^|[^a-z])(?:temp|tmp|temperatur\w*|therm\w*)(?:$|[^a-z])")
"""A word for temperature in a name in lower case."""

BARE = "T"
"""The name that actipy gives to temperatures; where it is the only column of times, it is one of these."""


@dataclass(frozen=True, slots=True)
class HeatUnit:
    """A unit of temperature: how many of it are 1 degree, and how many are 0 degrees Celsius."""

    name: str
    per_degree: float
    zero: float = 0.0

    def celsius(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return values (n,) in degrees Celsius."""
        if self == CELSIUS:
            return values
        return (values - self.zero) / self.per_degree


CELSIUS, FAHRENHEIT = HeatUnit("degrees Celsius", 1.0), HeatUnit("degrees Fahrenheit", 1.8, 32.0)
KELVIN, MILLI = HeatUnit("kelvin", 1.0, 273.15), HeatUnit("thousandths of a degree Celsius", 1000.0)

UNITS: dict[str, HeatUnit] = {
    **{
        normalized(name): CELSIUS if size == 1 else MILLI
        for size, names in TEMPERATURES.items()
        for name in names
    },
    "deg": CELSIUS,
    **dict.fromkeys(("f", "degf", "fahrenheit", "degreesfahrenheit", "degreesf", "ºf"), FAHRENHEIT),
    **dict.fromkeys(("k", "degk", "kelvin"), KELVIN),
}
"""Units by their normalized names."""

WHOLE_WORDS = ("celsius", "kelvin", "fahrenheit")
"""Names of units that say by themselves that a column `t_celsius` is a temperature."""

BY_VALUES = ((CELSIUS, -40.0, 60.0), (FAHRENHEIT, 60.0, 120.0), (KELVIN, 263.0, 333.0))
"""Units by the median of values in them; what is beyond Celsius must have decimals: raw counts have none."""


@dataclass(frozen=True, slots=True)
class Thermometer:
    """A column of temperatures.

    Attributes:
        number: of the column among those that were looked at.
        unit: None if only its values can tell.
    """

    number: int
    unit: HeatUnit | None


def find_thermometer(columns: Sequence[tuple[str, str | None]]) -> tuple[Thermometer | None, tuple[int, ...]]:
    """Return the temperature of the device, None if there is none or several, and columns that look like one.

    Args:
        columns: name and stated unit of each, that of times left out.
    """
    known, looking = [], []
    for number, (name, stated) in enumerate(columns):
        found = _named(name)
        if found is not None:
            rank, unit = found
            known.append((rank, number, stated or unit))
        elif WORD.search(re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower()):
            looking.append(number)
    best = [(number, unit) for rank, number, unit in known if rank == min(known)[0]]
    if len(best) != 1:
        return None, tuple(sorted([*looking, *(number for _, number, _ in known)]))
    (number, unit), others = best[0], [one for _, one, _ in known if one != best[0][0]]
    if unit and normalized(unit) not in UNITS and unit.strip():
        return None, tuple(sorted([*looking, number, *others]))
    return Thermometer(number, UNITS.get(normalized(unit or ""))), tuple(sorted([*looking, *others]))


def _named(name: str) -> tuple[int, str | None] | None:
    """Return how far a name is from `temperature`, and the unit in it; None for other names."""
    bracket = re.fullmatch(r"([^\[(]*)[\[(]([^\])]*)[\])]?\s*", name)
    plain, unit = (bracket[1], bracket[2]) if bracket else (name, None)
    text = normalized(_unaccented(plain))
    endings = ["", *sorted(UNITS, key=len, reverse=True)] if unit is None else [""]
    for ending in endings:
        rest = text.removesuffix(ending)
        if ending and not text.endswith(ending):
            continue
        if rest == "t" and (plain.strip().startswith(BARE) or ending in WHOLE_WORDS):
            return 1, unit or ending or None
        if found := HEAT.fullmatch(rest):
            return (0 if found[1] == rest else 2), unit or ending or None
    return None


def _unaccented(name: str) -> str:
    """Return a name without accents and marks: `température` gives `temperature`."""
    return "".join(one for one in unicodedata.normalize("NFD", name) if not unicodedata.combining(one))


def unit_by_values(values: NDArray[np.float64]) -> HeatUnit | None:
    """Return the unit of temperatures (n,) that is the only possible one; None if none is."""
    known = values[np.isfinite(values)]
    if not len(known):
        return None
    middle, whole = float(np.median(known)), bool((known == np.rint(known)).all())
    fitting = [
        unit for unit, low, high in BY_VALUES if low <= middle <= high and not (whole and unit != CELSIUS)
    ]
    return fitting[0] if fitting else None
