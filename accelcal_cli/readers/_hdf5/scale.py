"""From the numbers of a dataset to raw counts, and which rows cannot be."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.gravity import STANDARD_GRAVITY
from accelcal_cli.core.recording import FLOAT_LSB_PER_G, Counts
from accelcal_cli.readers._hdf5.file import normal

LARGEST_G = 127.0
GYRO_LSB_PER_DPS = 65_536.0
"""Counts per deg/s given to rates of turn that arrive as decimal fractions."""
LARGEST_DPS = 32_767.0
COLDEST_C, HOTTEST_C = -273.15, 1000.0

PER_G = {"g": 1.0, "mg": 1000.0, "m/s2": STANDARD_GRAVITY}
_ACCEL_UNITS = {
    "g": "g gs gee grav gravity gravities gforce standardgravity",
    "mg": "mg millig milligs milligee mgravity",
    "m/s2": "ms2 mss ms² mpss mpers2 meterpersecondsquared meterspersecondsquared meterspersecond2 mps2",
    "counts": "count counts lsb lsbs raw adc adccounts adu digit digits bits rawcounts",
}
_PER_DPS = {
    1.0: "degs dps degsec degps degpersec degreespersecond degreess °s degs1 degpersecond",
    math.pi / 180: "rads radsec rps radps radianspersecond radianss rads1 radpersec",
}
_PER_C = {
    1.0: "c degc °c celsius degreescelsius degreesc degreec degreecelsius",
    1000.0: "mc mdegc m°c millidegc millicelsius millidegreescelsius millidegreecelsius",
}


def accel_unit(text: str) -> str | None:
    """One of g, mg, m/s2, counts for what a unit attribute says; None where unknown."""
    name = normal(text.replace("m s-2", "m/s2").replace("s^-2", "s2").replace("s-2", "s2"))
    for unit, names in _ACCEL_UNITS.items():
        if name in names.split():
            return unit
    return None


def per_dps(text: str) -> float | None:
    """What one deg/s is in a unit of turning; None where unknown."""
    return _factor(text, _PER_DPS)


def per_celsius(text: str) -> float | None:
    """What one degree Celsius is in a unit of temperature; None where unknown."""
    return _factor(text, _PER_C)


def _factor(text: str, table: dict[float, str]) -> float | None:
    name = normal(text)
    for factor, names in table.items():
        if name in {normal(item) for item in names.split()}:
            return factor
    return None


@dataclass(frozen=True, slots=True)
class Scale:
    """How numbers become counts.

    Attributes:
        lsb: counts in one unit of the result (g or deg/s).
        divisor: what one unit of the result is in the dataset; None where its numbers are counts.
        limit: largest believable magnitude, in units of the result; of no use for counts.
        exact: the type that holds all counts of the dataset, None where some may not fit.
    """

    lsb: float
    divisor: float | None = None
    limit: float = 0.0
    exact: type[np.int16] | type[np.int32] | None = None

    def counts(self, values: NDArray[Any]) -> tuple[Counts, dict[str, NDArray[np.bool_]]]:
        """Counts of rows (n, 3), and by problem code the rows (n,) that have none."""
        if self.exact is np.int16:
            return values.astype(np.int16), {}
        if self.exact is np.int32:
            return values.astype(np.int32), {}
        if values.dtype.kind in "iu":
            return _narrowed(values)
        with np.errstate(over="ignore", invalid="ignore"):
            return self._rounded(values.astype(np.float64))

    def _rounded(self, values: NDArray[np.float64]) -> tuple[Counts, dict[str, NDArray[np.bool_]]]:
        missing: NDArray[np.bool_] = np.isnan(values)
        if self.divisor is None:
            whole, limit = values, float(2**31 - 1)
            broken = ~missing & np.isfinite(values) & (values != np.rint(values))
        else:
            units = values / self.divisor
            whole, limit = np.rint(units * self.lsb), self.limit * self.lsb
            broken = np.zeros_like(missing)
        beyond: NDArray[np.bool_] = np.abs(whole) > limit
        bad = missing | broken | beyond
        faults: dict[str, NDArray[np.bool_]] = {
            "missing_value": _rows(missing),
            "bad_row": _rows(broken),
            "out_of_range": _rows(beyond),
        }
        return np.where(bad, 0, whole).astype(np.int32), faults


def _rows(cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Rows (n,) with any of three cells true."""
    rows: NDArray[np.bool_] = cells[:, 0] | cells[:, 1] | cells[:, 2]
    return rows


def _narrowed(values: NDArray[Any]) -> tuple[Counts, dict[str, NDArray[np.bool_]]]:
    """Whole numbers as int32, and the rows that do not fit."""
    beyond = values > 2**31 - 1
    if values.dtype.kind == "i":
        beyond |= values < -(2**31)
    return np.where(beyond, 0, values).astype(np.int32), {"out_of_range": _rows(beyond)}


def count_scale(lsb: float, dtype: np.dtype[Any]) -> Scale:
    """Numbers that are counts already."""
    if dtype.kind == "f" or not np.can_cast(dtype, np.int32):
        return Scale(lsb)
    return Scale(lsb, exact=np.int16 if np.can_cast(dtype, np.int16) else np.int32)


def physical_scale(unit: str, dtype: np.dtype[Any]) -> Scale:
    """Numbers in g, mg or m/s2: whole ones are counts of that unit, fractions go to a fine grid."""
    if dtype.kind in "iu":
        return count_scale(PER_G[unit], dtype)
    return Scale(FLOAT_LSB_PER_G, PER_G[unit], LARGEST_G)


def gyro_scale(per_unit: float) -> Scale:
    """Decimal fractions in deg/s (1) or rad/s (pi / 180)."""
    return Scale(GYRO_LSB_PER_DPS, per_unit, LARGEST_DPS)


def millicelsius(values: NDArray[Any], good: NDArray[np.bool_], factor: float) -> NDArray[np.float64]:
    """Thousandths of a degree Celsius (n,), NaN where there is no believable value."""
    with np.errstate(over="ignore", invalid="ignore"):
        degrees = values[:, 0].astype(np.float64)
        if factor != 1:
            degrees /= factor
        believable = good & (degrees >= COLDEST_C) & (degrees <= HOTTEST_C)
        degrees *= 1000
        np.rint(degrees, out=degrees)
        if not believable.all():
            degrees[~believable] = np.nan
        return degrees
