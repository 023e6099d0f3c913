"""The scale of a text file's accelerations: their unit, or the counts of 1 g and of 0 g."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import FLOAT_LSB_PER_G
from accelcal_cli.core.vocabulary import COUNTS, UNIT_CHOICES
from accelcal_cli.formats._gravity import guess_unit
from accelcal_cli.formats._unsigned import refuse_other_zero, scale_hint, zero_of
from accelcal_cli.formats.csv.cells import AccelScale, acceleration_unit
from accelcal_cli.formats.csv.vendors import ExportDescription


def find_scale(
    values: NDArray[np.float64],
    hints: frozenset[str],
    export: ExportDescription,
    options: ReadOptions,
    path: Path,
) -> tuple[AccelScale, bool]:
    """Return the scale of accelerations (n, 3), and whether gravity alone decided the unit.

    Args:
        hints: units in the names of x, y and z.

    Raises:
        UnreadableError: no unit fits, or the values lie around another count than 0.
        UsageError: the unit is not known, or counts come without their scale.
    """
    stated = _stated_unit(options, hints)
    zero = export.zero if options.zero is None else options.zero
    if stated is None and export.unit is not None:
        scale = _scale_of(export.unit, export.lsb_per_g, zero)
        scale.check(values, path)
        return scale, False
    if options.lsb_per_g is None and options.zero is None and stated in (None, COUNTS):
        refuse_other_zero(values, path)
    unit = stated or guess_unit(values, path)
    if unit == COUNTS and options.lsb_per_g is None:
        raise UsageError("counts need their scale", hint=scale_hint(values, options.zero))
    scale = _scale_of(unit, options.lsb_per_g, zero)
    if unit == COUNTS and options.zero is None and not zero:
        found = zero_of(values, scale.lsb_per_g, path)
        scale = scale if found is None else replace(scale, zero=found, found_zero=True)
    return scale, stated is None


def _scale_of(unit: str, lsb_per_g: float | None, zero: int) -> AccelScale:
    if unit == COUNTS and lsb_per_g is not None:
        return AccelScale(unit, float(lsb_per_g), zero)
    return AccelScale(unit, FLOAT_LSB_PER_G)


def _stated_unit(options: ReadOptions, hints: frozenset[str]) -> str | None:
    """Return the unit that the user or the column names give, None if neither does."""
    if options.unit is not None:
        unit = acceleration_unit(options.unit)
        if unit is None:
            one_of = f"--unit is one of {', '.join(UNIT_CHOICES)}"
            raise UsageError(f"unknown unit {options.unit!r}", hint=one_of)
        if unit != COUNTS and options.zero is not None:
            raise UsageError(f"--zero is for counts, not for values in {unit}", hint="omit --zero")
        return unit
    if len(hints) == 1 and options.zero is None:
        return next(iter(hints))
    return COUNTS if options.lsb_per_g is not None or options.zero is not None else None
