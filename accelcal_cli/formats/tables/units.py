"""How the numbers of columns become whole counts: acceleration, rotation rates, temperature.

A unit is the user's, else that of the columns' names or attributes, else the vendor's; where nothing states
one, the length of gravity tells it. Values in mg that are whole are counts of 1 mg; other decimal fractions
go to a fine grid (`FLOAT_LSB_PER_G`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import FLOAT_LSB_PER_G, Counts
from accelcal_cli.core.vocabulary import (
    COUNTS,
    GIVE_UNIT,
    PER_G,
    PHYSICAL_UNITS,
    UNIT_CHOICES,
    HeatUnit,
    Quantity,
    acceleration_unit,
    unit_of,
)
from accelcal_cli.formats._gravity import guess_unit, usual_length
from accelcal_cli.formats.tables.header import DECIMAL, FLOAT, Block, Source, readable
from accelcal_cli.formats.tables.roles import Group, Roles

# Counts that are never negative, as converters give them: the count that stands for 0 g.
#
# Rest lies on a sphere around that count, as far from it as 1 g. A converter of n bits has it near
# 2^(n-1), such as 512 or 32768. How far off it is does not matter, since offsets of half a g are
# fitted.

BLOCK, QUIET_SHARES = 8, (0.5, 0.15)
"""Consecutive rows whose mean and range are taken, and shares of such blocks, the quietest, for rest."""

CELLS, LEAST_CELLS = 12, 9
"""Parts of the range of an axis in which rest counts once; orientations of rest that a sphere needs."""

TURNED, OUTSIDE, LARGEST_SCATTER = 1.2, 1.1, 0.08
"""Least range of each axis and distance of 0 from the centre, and largest scatter of rest, in radii."""

NEAR_G, LEAST_RANGE_G = 0.5, 1.25
"""Largest offset [g] from the middle of the range of a converter, and its least range on either side."""

ABOUT_1_G, FAR_FROM_1_G = (0.75, 1.3), (0.5, 2.0)
"""Usual lengths [g] with the right scale and zero, and those between which counts have no other zero."""

MIDDLES, EXACT = tuple(1 << bits for bits in range(6, 31)), 1000
"""Middles of the ranges of converters, and radius [counts] from which on all digits are shown."""

MOST_COUNTS = (1 << 31) - 1
"""Largest count of a converter; a larger number is not a count."""

FOUND_ZERO = "0 g is at {} counts, around which rest lies (-R zero says it)"

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Sphere:
    """The sphere on which rest lies: its centre and radius in counts."""

    centre: tuple[float, float, float]
    radius: float

    def middle(self) -> int | None:
        """Return the middle of the range of a converter that is the centre, within half a g; None if none."""
        off = {middle: max(abs(at - middle) for at in self.centre) for middle in MIDDLES}
        nearest = min(MIDDLES, key=lambda middle: off[middle])
        return nearest if off[nearest] < NEAR_G * self.radius else None


def sphere_of_rest(values: Floats) -> Sphere | None:
    """Return the sphere on which rest lies away from 0; None unless rows (n, 3) are counts that show it."""
    if not are_unsigned(values):
        return None
    values = values[(np.abs(values) <= MOST_COUNTS).all(axis=1) & values.any(axis=1)]
    blocks = values[: len(values) // BLOCK * BLOCK].reshape(-1, BLOCK, 3)
    if not len(blocks):
        return None
    spread, means = np.ptp(blocks, axis=1).max(axis=1), blocks.mean(axis=1)
    spheres = (_sphere_of(means[spread <= np.quantile(spread, share)]) for share in QUIET_SHARES)
    return next((sphere for sphere in spheres if sphere is not None), None)


def _sphere_of(means: Floats) -> Sphere | None:
    """Return the sphere of means of rest (m, 3): the linear least squares of |v|^2 = 2 c v + d.

    None unless they turn on all axes, lie near it, and 0 is far from it.
    """
    low, widest = means.min(axis=0), float(np.ptp(means, axis=0).max())
    if not widest:
        return None
    _, first = np.unique((means - low) // (widest / CELLS), axis=0, return_index=True)
    points, middle = means[first] - low, widest / 2
    if len(points) < LEAST_CELLS:
        return None
    rows = np.column_stack([2 * (points - middle), np.ones(len(points))])
    (x, y, z, rest), *_ = np.linalg.lstsq(rows, ((points - middle) ** 2).sum(axis=1), rcond=None)
    centre = np.array([x, y, z])
    radius = float(np.sqrt(max(rest + centre @ centre, 0.0)))
    off = np.linalg.norm(points - middle - centre, axis=1) - radius
    turned = bool((np.ptp(points, axis=0) > TURNED * radius).all())
    centre += low + middle
    if np.sqrt(np.mean(off**2)) > LARGEST_SCATTER * radius or not turned or (centre < OUTSIDE * radius).any():
        return None
    return Sphere((float(centre[0]), float(centre[1]), float(centre[2])), radius)


def are_unsigned(values: Floats) -> bool:
    """Return True if all values that are not missing are whole, and none is negative."""
    known = values[np.isfinite(values)]
    return bool(len(known) and known.min() >= 0 and (known == np.rint(known)).all())


def zero_of(values: Floats, lsb_per_g: float, path: Path) -> int | None:
    """Return the count of 0 g that counts (n, 3) of a known scale show; None where it is 0, or unknown.

    Raises UnreadableError if rest lies around a count that is not the middle of a converter's range, or the
    scale does not fit.
    """
    length = usual_length(values) / lsb_per_g
    if FAR_FROM_1_G[0] < length < FAR_FROM_1_G[1] or not are_unsigned(values):
        return None
    if (sphere := sphere_of_rest(values)) is not None:
        middle, fits = sphere.middle(), ABOUT_1_G[0] < sphere.radius / lsb_per_g < ABOUT_1_G[1]
        if middle is None or not fits:
            raise _off_zero(sphere, path, lsb_per_g if fits else None)
        return middle
    reaching = [middle for middle in MIDDLES if middle > LEAST_RANGE_G * lsb_per_g]
    lengths = {middle: usual_length(values - middle) / lsb_per_g for middle in reaching}
    near = [middle for middle, one in lengths.items() if ABOUT_1_G[0] < one < ABOUT_1_G[1]]
    return near[0] if len(near) == 1 else None


def scale_hint(values: Floats, zero: int | None) -> str:
    """Return the advice to give the scale of counts, with about what it is where their zero is known."""
    length = 0.0 if zero is None else usual_length(values - zero)
    return "give --lsb-per-g, the counts in one g" + (f", about {length:.3g}" if length else "")


def _off_zero(sphere: Sphere, path: Path, lsb_per_g: float | None = None) -> UnreadableError:
    """Return the error that rest lies around another count than 0, with the options that say so."""
    about = ", ".join(f"{at:.0f}" for at in sphere.centre)
    radius = f"{sphere.radius:.0f}" if sphere.radius >= EXACT else f"{sphere.radius:.3g}"
    scale = radius if lsb_per_g is None else f"{lsb_per_g:.10g}"
    zero = sphere.middle() or round(sum(sphere.centre) / 3)
    return UnreadableError(
        f"its values are counts above 0: at rest they lie {radius} counts from the middle {about}",
        path=path,
        hint=f"give -R zero={zero} --lsb-per-g {scale}, or the counts of 0 g and of 1 g in the data sheet",
    )


# How the numbers of columns become whole counts.

LARGEST_G = 127.0
"""Values beyond this [g] are damage."""

LARGEST_DPS = 32_767.0
"""Values beyond this [deg/s] are damage."""

GYRO_LSB_PER_DPS = 65_536.0
"""Counts per deg/s given to rotation rates that arrive as decimal fractions."""

EMPTY = -(1 << 63)
"""Stands for an empty cell among whole numbers of 64 bits."""

WIDEST = float(np.iinfo(np.int32).max)
LEAST_LSB = 1e-9
"""Smallest believable number of counts in one g."""

USUAL_G = (0.3, 3.0)
"""A recording's usual length of acceleration [g] lies between these, however its wearer moves."""

COLDEST_C, WARMEST_C = -273.15, 1000.0
"""Temperatures beyond these are not believed."""

UNKNOWN = int(np.iinfo(np.int32).min)
"""Stands for a temperature that only earlier rows can give."""

LEAST_GYRO_SHARE = 0.99
"""Share of the first rows with an acceleration that must have a rotation rate: rows without are left out."""

LARGEST_GROUP, GROUPED_OFF = 1e6, 1e-6
"""Below this are numbers of two groups of three digits, and how far off whole thousandths may be."""

NO_GYRO_UNIT = "its unit is not known, give -R gyro_unit=deg/s or -R gyro_unit=rad/s"


Numbers = NDArray[np.int64]


class Fault(IntEnum):
    """The reason why a row cannot be used."""

    NONE = 0
    MISSING = 1
    OUT_OF_RANGE = 2
    TIME = 3
    EMPTY = 4
    LINE = 5
    FRACTION = 6
    LOST = 7


@dataclass(frozen=True, slots=True)
class Scale:
    """How numbers become whole counts.

    Attributes:
        unit: of the numbers, or `counts`.
        lsb: counts in one unit of the result, g or deg/s.
        per: the size of one unit of the result in the column; None if its numbers are counts.
        largest: largest believable magnitude, in units of the result.
        zero: the number that stands for 0; found_zero: the values show it, and nothing states it.
        short: the type of the numbers is one that 16 bits hold.
    """

    unit: str
    lsb: float
    per: float | None = None
    largest: float = LARGEST_G
    zero: int = 0
    found_zero: bool = False
    short: bool = False

    @property
    def limit(self) -> float:
        """The largest believable magnitude of a count."""
        return min(self.largest * self.lsb, WIDEST)

    def counts(self, values: NDArray[Any]) -> tuple[Counts, NDArray[np.uint8]]:
        """Return numbers (n, 3) as counts, rounded half to even, and for each row (n,) its `Fault`.

        Rows with a fault have counts of 0.
        """
        if values.dtype.kind in "iu" and self.is_of_whole:
            return self._whole(values)
        with np.errstate(over="ignore", invalid="ignore"):
            if values.dtype == np.float32 and self.per == 1.0 and self.lsb == FLOAT_LSB_PER_G:
                # a power of two moves no bit of a fraction
                scaled: NDArray[Any] = np.rint(values * np.float32(self.lsb))
            else:
                scaled = as_floats(values)
                if self.zero:
                    scaled = scaled - self.zero
                if self.per is not None:
                    scaled = np.rint((scaled if self.per == 1.0 else scaled / self.per) * self.lsb)
        fault = np.zeros(len(values), np.uint8)
        if self.per is None and (broken := (np.rint(scaled) != scaled) & np.isfinite(scaled)).any():
            fault[broken.any(axis=1)] = Fault.FRACTION
        limit = self.limit
        if len(scaled) and not (scaled.max() <= limit and scaled.min() >= -limit):
            fault[(np.abs(scaled) > limit).any(axis=1)] = Fault.OUT_OF_RANGE
            fault[np.isnan(scaled).any(axis=1)] = Fault.EMPTY
        if fault.any():
            scaled = np.where((fault == Fault.NONE)[:, None], scaled, 0.0)
        return scaled.astype(np.int32), fault

    def _whole(self, values: NDArray[Any]) -> tuple[Counts, NDArray[np.uint8]]:
        """Return whole numbers that are counts; those of 16 bits stay as short."""
        fault = np.zeros(len(values), np.uint8)
        if self.zero:
            wide = values.astype(np.int64)
            values = np.where(wide == EMPTY, EMPTY, wide - self.zero)
        limit = int(self.limit)
        if len(values) and not (values.max() <= limit and values.min() >= -limit):
            beyond = values > limit
            if values.dtype.kind == "i":
                beyond |= values < -limit
            fault[beyond.any(axis=1)] = Fault.OUT_OF_RANGE
            if values.dtype.itemsize == np.dtype(np.int64).itemsize:
                fault[(values == EMPTY).any(axis=1)] = Fault.EMPTY
            values = np.where((fault == Fault.NONE)[:, None], values, 0)
        return (values.astype(np.int16) if self.short else values.astype(np.int32)), fault

    @property
    def is_of_whole(self) -> bool:
        """True if its numbers are counts as they are."""
        return self.per in (None, self.lsb)

    def check(self, values: NDArray[np.float64], path: Path) -> None:
        """Check a unit that was inferred from a vendor's layout.

        Raises:
            UnreadableError: in it, values (n, 3) are far from the length of gravity.
        """
        length = usual_length(values - self.zero) / (self.lsb if self.per is None else self.per)
        if length and not USUAL_G[0] < length < USUAL_G[1]:
            what = f"its usual acceleration would be {length:.3g} g, so that its unit is in doubt"
            raise UnreadableError(what, path=path, hint=GIVE_UNIT)


def as_floats(values: NDArray[Any]) -> NDArray[np.float64]:
    """Return numbers as decimal fractions (n,) or (n, 3), NaN for empty ones."""
    if values.dtype == FLOAT:
        return values
    with np.errstate(over="ignore", invalid="ignore"):  # of wider fractions, and of NaN that signal
        found = values.astype(np.float64)
    if values.dtype == np.int64:
        found[values == EMPTY] = np.nan
    return found


def common_dtype(group: Group) -> np.dtype[Any]:
    """Return the type that holds the numbers of all columns."""
    return np.result_type(*(column.dtype for column in group))


def find_scale(
    values: Floats, lines: Numbers, roles: Roles, source: Source, options: ReadOptions
) -> tuple[Scale, bool]:
    """Return the scale of accelerations (n, 3), and whether gravity alone decided the unit.

    Args:
        lines: (m,) of the first of these rows.

    Raises:
        UnreadableError: no unit fits or it is not known, or the values lie around another count than 0.
        UsageError: the unit is not known, or counts come without their scale.
    """
    path, about, dtype = source.path, source.stated, common_dtype(roles.xyz)
    whole = _are_whole(values, dtype)
    refuse_grouped(values, lines, source)
    lsb = about.lsb_per_g if options.lsb_per_g is None else options.lsb_per_g
    unit = _stated_unit(roles.xyz, whole, source, options)
    if about.unit is not None and about.unit_is_inferred and unit in (None, about.unit) and not options.unit:
        scale = _scale_of(about.unit, lsb, about.zero, (dtype, whole))
        scale.check(values, path)
        if about.unit == COUNTS:
            _refuse_fractions(values, lines, source)
        return scale, False
    unit = unit or about.unit
    of_no_scale = lsb is None and options.zero is None and unit in (None, COUNTS)
    if of_no_scale and (sphere := sphere_of_rest(values)) is not None:
        raise _off_zero(sphere, path)
    guessed = unit is None and lsb is None
    unit = guess_unit(values, path) if guessed else unit or COUNTS
    if unit != COUNTS:
        return _scale_of(unit, None, 0, (dtype, whole)), guessed
    return _scale_of_counts(values, lines, (lsb, dtype), source, options), False


def _are_whole(values: NDArray[np.float64], dtype: np.dtype[Any]) -> bool:
    """Return True if numbers are whole by their type, or all that are known, unless all are 0."""
    known = values[np.isfinite(values)]
    return dtype.kind in "iu" or bool(known.any() and (known == np.rint(known)).all())


def _scale_of(unit: str, lsb: float | None, zero: int, numbers: tuple[np.dtype[Any], bool]) -> Scale:
    """Return the scale of numbers in a unit, by their type and whether they are whole."""
    dtype, whole = numbers
    short = not zero and np.can_cast(dtype, np.int16)
    if unit == COUNTS and lsb is not None:
        return Scale(unit, float(lsb), zero=zero, short=short)
    if unit == "mg" and whole:
        return Scale(unit, PER_G[unit], PER_G[unit], short=short)
    return Scale(unit, FLOAT_LSB_PER_G, PER_G[unit])


def _scale_of_counts(
    values: Floats,
    lines: Numbers,
    known: tuple[float | None, np.dtype[Any]],
    source: Source,
    options: ReadOptions,
) -> Scale:
    """Return the scale of counts; they have decimal fractions where they are averages.

    Args:
        known: counts per g, and their type.

    Raises:
        UnreadableError: fractions are not averages, since their length is not that of gravity.
        UsageError: the counts per g are not known.
    """
    (lsb, dtype), path = known, source.path
    zero = source.stated.zero if options.zero is None else options.zero
    if lsb is None:
        raise UsageError("counts need their scale", path=path, hint=scale_hint(values, options.zero))
    if not LEAST_LSB <= lsb <= FLOAT_LSB_PER_G * LARGEST_G:
        raise UnreadableError(f"{lsb:g} counts per g cannot be right", path=path, hint="give --lsb-per-g N")
    finite = values[np.isfinite(values)]
    if (finite != np.rint(finite)).any():
        if not USUAL_G[0] < usual_length(values - zero) / lsb < USUAL_G[1]:
            _refuse_fractions(values, lines, source)
        return Scale(COUNTS, FLOAT_LSB_PER_G, lsb, zero=zero)
    scale = _scale_of(COUNTS, lsb, zero, (dtype, True))
    if options.zero is None and not zero and (found := zero_of(values, lsb, path)) is not None:
        scale = replace(scale, zero=found, found_zero=True, short=False)
    return scale


def _refuse_fractions(
    values: Floats, lines: Numbers, source: Source, option: str = f"--unit {PHYSICAL_UNITS}"
) -> None:
    """Raise UnreadableError, which advises an option, if any value (n, 3) is not a whole number of counts."""
    fractions = np.argwhere(np.isfinite(values) & (values != np.rint(values)))
    if len(fractions):
        row, axis = fractions[0].tolist()
        line = int(lines[row]) if source.first_line is not None and row < len(lines) else None
        what = f"{values[row, axis]:g} is not a whole number of counts"
        hint = f"give the unit of the values with {option}"
        raise UnreadableError(what, path=source.path, line=line, hint=hint)


def _stated_unit(xyz: Group, whole: bool, source: Source, options: ReadOptions) -> str | None:
    """Return the unit that the user or the columns state, None if neither does.

    Args:
        whole: the values are whole, and so counts if the counts per g are stated.
    """
    if options.unit is not None:
        unit = acceleration_unit(options.unit)
        if unit is None:
            one_of = f"--unit is one of {', '.join(UNIT_CHOICES)}"
            raise UsageError(f"unknown unit {options.unit!r}", hint=one_of)
        if unit != COUNTS and options.zero is not None:
            raise UsageError(f"-R zero is for counts, not for values in {unit}", hint="omit -R zero")
        return unit
    by_attribute = source.stated.lsb_per_g is not None and not source.stated.unit_is_inferred
    if options.zero is not None or (whole and (options.lsb_per_g is not None or by_attribute)):
        return COUNTS
    for column in xyz:
        if column.unit and acceleration_unit(column.unit) is None:
            what = f"the unit {readable(column.unit)!r} of {column.described} is not known"
            hint = f"give --unit {PHYSICAL_UNITS}, or --unit counts"
            raise UnreadableError(what, path=source.path, hint=hint)
    units = {acceleration_unit(column.name.stated) for column in xyz} - {None}
    if len(units) > 1:
        what, hint = "the axes have different units", "give them one unit, or say it with --unit"
        raise UnreadableError(what, path=source.path, line=source.names_line, hint=hint)
    return next(iter(units), None)


def refuse_grouped(values: NDArray[Any], lines: Numbers, source: Source, scale: Scale | None = None) -> None:
    """Raise UnreadableError for a fraction such as 1.033 among whole numbers, which may stand for 1033.

    Args:
        values: (n, 3) of some rows; lines: (m,) of the first of these.
        scale: of whole numbers; None for the first rows, which show whether most numbers are whole.
    """
    if values.dtype.kind != "f":
        return
    with np.errstate(over="ignore", invalid="ignore"):
        broken = np.isfinite(values) & (values != np.rint(values))
        if not broken.any():
            return
        thousands, whole = np.abs(values[broken]) * 1000, values[np.isfinite(values) & ~broken]
    limit, hundredths = LARGEST_GROUP if scale is None else scale.limit, thousands / 10
    alike = (
        (thousands >= 1000) & (thousands <= limit) & (np.abs(thousands - np.rint(thousands)) < GROUPED_OFF)
    )
    sure = alike & (np.abs(hundredths - np.rint(hundredths)) > GROUPED_OFF)  # 2.5 shows no third decimal
    if scale is None:
        reach = float(np.abs(whole).max(initial=0.0))
        sure &= len(whole) > len(thousands) and 100 <= reach < 1000 and alike.all()
    if not sure.any():
        return
    row, axis = np.argwhere(broken)[int(np.flatnonzero(sure)[0])].tolist()
    line = int(lines[row]) if source.first_line is not None and row < len(lines) else None
    value = float(values[row, axis])
    written = f"{value:.3f}".replace(".", "," if source.comma == DECIMAL else ".")
    plain = f"{value * 1000:.0f}"
    what = f"holds {written} among whole numbers: a fraction, or {plain} with a mark between thousands"
    hint = f"write {plain} without the mark, or the other numbers with decimals, too"
    raise UnreadableError(what, path=source.path, line=line, hint=hint)


def find_turn_scale(gyro: Group, block: Block, source: Source, options: ReadOptions) -> Scale | None:
    """Return the scale of rotation rates by the user, the columns or the header; None if none states it.

    Args:
        block: of the first rows.

    Raises:
        UnreadableError: they are stated to be counts and are not whole.
    """
    stated_lsb = source.stated.lsb_per_dps if options.gyro_unit is None else None
    lsb = options.lsb_per_dps if options.lsb_per_dps is not None else stated_lsb
    if lsb is not None:
        rates = as_floats(group_values(block.values, gyro))
        _refuse_fractions(rates, block.line, source, "-R gyro_unit=deg/s or -R gyro_unit=rad/s")
        return Scale(COUNTS, lsb, None, LARGEST_DPS, short=np.can_cast(common_dtype(gyro), np.int16))
    named = {column.name.stated for column in gyro if unit_of(column.name.stated, Quantity.TIME) is None}
    own = named.pop() if len(named) == 1 else ""
    unit = unit_of(options.gyro_unit or own or source.stated.gyro_unit or "", Quantity.ROTATION)
    return None if unit is None else Scale("deg/s", GYRO_LSB_PER_DPS, unit.per, LARGEST_DPS)


def why_not_read(values: NDArray[np.float64], rates: NDArray[np.float64]) -> str | None:
    """Return the reason not to read a gyroscope whose rates (n, 3) are missing in many rows, or None."""
    rows = ~np.isnan(values).any(axis=1)
    missing = int((rows & np.isnan(rates).any(axis=1)).sum())
    if missing <= (1 - LEAST_GYRO_SHARE) * rows.sum():
        return None
    return f"the gyroscope is not read: {missing} of the first {rows.sum()} rows have no value of it"


def millidegrees(values: NDArray[Any], unit: HeatUnit) -> NDArray[np.int32]:
    """Return temperatures (n,) in thousandths of a degree Celsius, UNKNOWN where there is none."""
    with np.errstate(over="ignore", invalid="ignore"):
        celsius = unit.celsius(as_floats(values))
        believable = (celsius >= COLDEST_C) & (celsius < WARMEST_C)
        steps = np.rint(celsius * 1000)
    return np.where(believable, np.where(believable, steps, 0), UNKNOWN).astype(np.int32)


def held(values: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return temperatures (n,) with the last one before where one is missing, UNKNOWN before any."""
    missing = values == UNKNOWN
    if not missing.any():
        return values
    last = np.maximum.accumulate(np.where(missing, -1, np.arange(len(values))))
    return np.where(last < 0, UNKNOWN, values[last]).astype(np.int32)


def group_values(block_values: Any, group: Group) -> NDArray[Any]:
    """Return the numbers of three columns, or of one of three, as (n, 3)."""
    parts = [block_values[column.number] for column in group]
    return parts[0] if len(parts) == 1 else np.stack(parts, axis=1)
