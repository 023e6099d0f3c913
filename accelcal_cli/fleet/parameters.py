"""The twelve parameters of a device, as columns of a study's table and as people read them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from math import floor, log10

import numpy as np

from accelcal_cli.study.row import PARAMETERS as COLUMNS


class Kind(StrEnum):
    """What a parameter is."""

    SCALE = "scale"
    MISALIGNMENT = "misalignment"
    OFFSET = "offset"
    SLOPE = "slope"


UNITS = {Kind.SCALE: "%", Kind.MISALIGNMENT: "%", Kind.OFFSET: "mg", Kind.SLOPE: "mg/C"}
FACTORS = {Kind.SCALE: 100.0, Kind.MISALIGNMENT: 100.0, Kind.OFFSET: 1000.0, Kind.SLOPE: 1000.0}


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter.

    Attributes:
        name: its kind and its axis (of K: row and column).
        column: in a study's table; its standard error is in `se_` of that.
        ideal: what a sensor without error has, in the table's unit.
        factor: from the table's unit to `unit`.
    """

    name: str
    kind: Kind
    column: str
    ideal: float
    unit: str
    factor: float

    @property
    def label(self) -> str:
        """For people."""
        return self.name.replace("_", " ")


def with_error(value: float, error: float) -> str:
    """A value and its standard error, this to two significant digits."""
    digits = 2 if error <= 0 else min(6, max(0, 1 - floor(log10(error))))
    return f"{value:+.{digits}f} +- {error:.{digits}f}"


def _parameter(index: int, axes: str) -> Parameter:
    kind = tuple(Kind)[index // 3]
    ideal = 1.0 if kind is Kind.SCALE else 0.0
    return Parameter(f"{kind}_{axes}", kind, COLUMNS[index], ideal, UNITS[kind], FACTORS[kind])


AXES = ("x", "y", "z", "yx", "zx", "zy", "x", "y", "z", "x", "y", "z")
PARAMETERS = tuple(_parameter(index, axes) for index, axes in enumerate(AXES))
"""In the order of the core's PARAMETER_NAMES."""

SCALES, OFFSETS, SLOPES = slice(0, 3), slice(6, 9), slice(9, 12)
IDEAL = np.array([parameter.ideal for parameter in PARAMETERS])
FACTOR = np.array([parameter.factor for parameter in PARAMETERS])
