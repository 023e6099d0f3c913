"""What a single cell is (a number, a time, nothing or other text), and the units that names and headers
mention.

`Scale` makes values of a unit whole counts.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import FLOAT_LSB_PER_G
from accelcal_cli.core.vocabulary import (
    ACCELERATION,
    GIVE_UNIT,
    PER_G,
    PER_SECOND,
    ROTATION,
    TEMPERATURE,
    TIME,
    UNIT_CHOICES,
    In,
)
from accelcal_cli.formats._gravity import usual_length

MISSING = (
    *("", "NaN", "nan", "NAN", "-nan", "-NaN", "NA", "N/A", "n/a", "na", "#N/A", "#NA", "NULL", "null"),
    *("None", "none", "1.#QNAN", "-1.#QNAN", "1.#IND", "-1.#IND"),
)
"""Cells that stand for a missing value; the same list is given to pyarrow."""

NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?|[+-]?(inf|infinity)", re.IGNORECASE)
POINT_NUMBER = re.compile(r"[+-]?\d*\.\d*([eE][+-]?\d+)?")
COMMA_NUMBER = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
DATE = re.compile(r"\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}([T ].*)?")
DATE_ALONE = re.compile(r"\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}")
TIME_OF_DAY = re.compile(r"\d{1,2}:\d\d(:\d\d.*)?( ?[AaPp][Mm])?")
BRACKET = re.compile(r"[\[(]")
OTHER_UNITS = (
    *("-", "", "deg_c", "no units", "no_units", "n/a", "local_flux", "ut", "µt", "hz", "v", "mv", "lux"),
    *("pa", "kpa", "cal"),
)
LARGEST_G = 127.0
USUAL_G = (0.3, 3.0)
"""A recording's usual length of acceleration lies between, however its wearer moves."""


class Kind(Enum):
    """The kind of a cell, or of a column whose cells are nearly all of it."""

    NUMBER = "number"
    TIME = "time"
    MISSING = "missing"
    TEXT = "text"


def cell_kind(cell: str, decimal_comma: bool) -> Kind:
    """The kind of one cell, blanks around it ignored."""
    cell = cell.strip()
    if cell in MISSING:
        return Kind.MISSING
    if NUMBER.fullmatch(cell) or (decimal_comma and COMMA_NUMBER.fullmatch(cell)):
        return Kind.NUMBER
    return Kind.TIME if DATE.fullmatch(cell) or TIME_OF_DAY.fullmatch(cell) else Kind.TEXT


def column_kind(cells: Sequence[str], decimal_comma: bool, share: float) -> Kind:
    """The kind that this share of the cells are or miss; text where there is none."""
    kinds = [cell_kind(cell, decimal_comma) for cell in cells]
    missing = kinds.count(Kind.MISSING)
    if missing == len(kinds):
        return Kind.MISSING
    for kind in (Kind.NUMBER, Kind.TIME):
        if kind in kinds and kinds.count(kind) + missing >= share * len(kinds):
            return kind
    return Kind.TEXT


def number_of(cell: str) -> float | None:
    """The cell as a number, None if it is not one."""
    cell = cell.strip().replace(",", ".")
    return float(cell) if NUMBER.fullmatch(cell) else None


def acceleration_unit(text: str) -> str | None:
    """One of g, mg, m/s2, counts for a word such as `m/s^2`; None for any other."""
    return ACCELERATION.find(text.strip().lower(), In.CSV)


def microseconds_in(text: str) -> float | None:
    """Microseconds in a unit of time such as `ms`; None for any other word."""
    unit = TIME.find(text.strip().lower(), In.CSV)
    return None if unit is None else MICROSECONDS / PER_SECOND[unit]


def is_unit_cell(text: str) -> bool:
    """Whether a cell below a column's name can be its unit."""
    text = text.strip().strip("[]()").lower()
    known = acceleration_unit(text) is not None or microseconds_in(text) is not None
    others = (*OTHER_UNITS, *ROTATION.names(In.CSV), *TEMPERATURE.names(In.CSV))
    return known or text in others


def name_and_hint(name: str) -> tuple[str, str | None]:
    """A column's name without its bracketed unit, and the words in the brackets."""
    name = name.strip()
    match = BRACKET.search(name, 0, len(name) - 1)
    if match is None or name[-1] not in "])":
        return name, None
    return name[: match.start()].strip(), name[match.end() : -1].strip()


@dataclass(frozen=True, slots=True)
class Scale:
    """How values of one unit become whole counts; `zero` is what stands for 0 g among counts."""

    unit: str
    lsb_per_g: float
    zero: int = 0

    @property
    def limit(self) -> float:
        """Counts beyond this are damage."""
        return min(LARGEST_G * self.lsb_per_g, float(np.iinfo(np.int32).max))

    def counts(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values (n,) as counts (n,), rounded half to even; NaN stays NaN."""
        if self.unit == "counts":
            return values - self.zero if self.zero else values
        in_g = values if self.per_g == 1.0 else values / self.per_g
        with np.errstate(over="ignore"):
            return np.rint(in_g * self.lsb_per_g)

    @property
    def per_g(self) -> float:
        """How much one g is in the unit."""
        return PER_G.get(self.unit, self.lsb_per_g)


def scale_for(unit: str, lsb_per_g: float | None, zero: int = 0) -> Scale:
    """The scale of a unit; `zero` is that of counts.

    Raises:
        UsageError: counts whose number in one g is not known.
    """
    if unit != "counts":
        return Scale(unit, FLOAT_LSB_PER_G)
    if lsb_per_g is None:
        raise UsageError("counts need their scale", hint="give --lsb-per-g, the counts in one g")
    return Scale(unit, float(lsb_per_g), zero)


def stated_unit(options: ReadOptions, hints: set[str]) -> str | None:
    """The unit that the user or the column names give, None if neither does."""
    if options.unit is not None:
        unit = acceleration_unit(options.unit)
        if unit is None:
            raise UsageError(
                f"unknown unit {options.unit!r}", hint=f"--unit is one of {', '.join(UNIT_CHOICES)}"
            )
        return unit
    if len(hints) == 1:
        return next(iter(hints))
    return "counts" if options.lsb_per_g is not None else None


def check_unit(values: NDArray[np.float64], scale: Scale, path: Path) -> None:
    """Check a unit that was inferred from a vendor's layout.

    Raises:
        UnreadableError: in it, values (n, 3) are far from the length of gravity.
    """
    length = usual_length(values - scale.zero) / scale.per_g
    if length and not USUAL_G[0] < length < USUAL_G[1]:
        raise UnreadableError(
            f"its usual acceleration would be {length:.3g} g, so that its unit is in doubt",
            path=path,
            hint=GIVE_UNIT,
        )
