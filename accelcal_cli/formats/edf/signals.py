"""Which signals are x, y and z, and how their digital values become whole counts of one scale.

A physical value is physical_min + (d - digital_min) * gain, with an exact gain from the header's texts. The
common step of all axes is the largest number of which every gain and every value of d = 0 is a multiple:
counts in that step are whole and exact. Where they would need more than 32 bits, values are put on the grid
that decimal fractions have in all formats.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import FLOAT_LSB_PER_G, LARGEST_LSB_PER_G, Counts
from accelcal_cli.core.vocabulary import (
    ACCELERATION,
    ACCELERATION_UNITS,
    ACCELEROMETER,
    GIVE_UNIT,
    GYROSCOPE,
    NOT_RAW,
    ROTATION,
    TEMPERATURE,
    THERMOMETER,
    In,
    UnitNames,
    names_in,
)
from accelcal_cli.formats.edf.header import ANNOTATIONS, Header, Signal, number_in

ACCEL_NAMES = names_in(ACCELEROMETER, In.EDF)
GYRO_NAMES = names_in(GYROSCOPE, In.EDF)
GLUED = re.compile(rf"({'|'.join(sorted(ACCEL_NAMES | GYRO_NAMES))})([xyz])")
MOST_COUNTS = (1 << 31) - 1


@dataclass(frozen=True, slots=True)
class Axes:
    """Three signals, and factor and addend that make whole counts of each one's digital values.

    Attributes:
        step: what one count is, exactly: in g, or in deg/s.
        limits: the counts of each one's digital minimum and maximum; empty if these do not matter.
        on_grid: counts of that step need more than 32 bits, and are rounded to the grid of decimals.
    """

    signals: tuple[Signal, Signal, Signal]
    factors: tuple[int, ...]
    addends: tuple[int, ...]
    step: Fraction
    limits: tuple[int, ...]
    on_grid: bool = False

    def may_fail(self, sample_bytes: int) -> bool:
        """Whether samples beyond the digital limits may have no count."""
        widest, lines = 1 << (8 * sample_bytes - 1), zip(self.factors, self.addends, strict=True)
        return max(abs(factor) * widest + abs(addend) for factor, addend in lines) * self._grid > MOST_COUNTS

    @property
    def _grid(self) -> Fraction:
        """Counts in a step."""
        return self.step * int(FLOAT_LSB_PER_G) if self.on_grid else Fraction(1)

    def counts(self, digital: list[NDArray[Any]], faulty: NDArray[np.bool_] | None) -> Counts:
        """Digital values (n,) of the three signals as counts (n, 3); marks rows (n,) that have none."""
        if self.factors == (1, 1, 1) and self.addends == (0, 0, 0):
            return np.stack(digital, axis=1)
        grid = self._grid
        values = np.empty((len(digital[0]), 3))
        for axis, column in enumerate(digital):
            values[:, axis] = column * float(self.factors[axis] * grid) + float(self.addends[axis] * grid)
        if faulty is not None:
            faulty |= np.any(np.abs(values) > MOST_COUNTS, axis=1)
            values[faulty] = 0
        return np.rint(values).astype(np.int32)

    @property
    def per_unit(self) -> float:
        """Counts in one unit."""
        return FLOAT_LSB_PER_G if self.on_grid else float(1 / self.step)


@dataclass(frozen=True, slots=True)
class Chosen:
    """The signals that are read.

    Attributes:
        temperature: the signal, and thousandths of a degree C in one digital step and at 0.
        range_g: the nearest end of any axis' digital range.
    """

    accel: Axes
    gyro: Axes | None
    temperature: tuple[Signal, float, float] | None
    range_g: float | None


def words(label: str) -> tuple[str, ...]:
    """A label taken apart: `AccX`, `acc_x`, `Accelerometer-X`."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", re.sub(r"[\[(].*", "", label))
    parts: list[str] = []
    for word in re.findall(r"[a-z]+|\d+", spaced.lower()):
        glued = GLUED.fullmatch(word)
        parts += glued.groups() if glued else [word]
    return tuple(parts)


def choose(header: Header, options: ReadOptions, path: Path) -> Chosen:
    """The signals of the accelerometer, and those that belong to it.

    Raises:
        UnreadableError: there are none, or their scale or rate cannot be used.
        UsageError: an option names no signal, or several sensors fit.
    """
    signals = _named(header, options, path) or _found(header, options, path)
    if len({signal.samples for signal in signals}) > 1 or not signals[0].samples:
        rates = ", ".join(f"{signal.label}: {signal.samples}" for signal in signals)
        raise UnreadableError(f"x, y and z have different rates (samples in a record: {rates})", path=path,
                              hint="name three signals of one rate with --columns")  # fmt: skip
    accel = _in_g(signals, options, path)
    ends = [abs(limit) / accel.per_unit for limit in accel.limits]
    crosses = [low * high < 0 for low, high in zip(accel.limits[::2], accel.limits[1::2], strict=True)]
    range_g = min(ends) if crosses and all(crosses) else None
    return Chosen(accel, _gyro(header, signals, path), _temperature(header, path), range_g)


def _named(header: Header, options: ReadOptions, path: Path) -> tuple[Signal, Signal, Signal] | None:
    if options.columns is None:
        return None
    x, y, z = (_pick(header, wanted.strip(), path) for wanted in options.columns)
    if len({x.number, y.number, z.number}) < 3:
        raise UsageError("--columns names one signal twice", path=path, hint="give x, y and z")
    return x, y, z


def _pick(header: Header, wanted: str, path: Path) -> Signal:
    usable = [signal for signal in header.signals if signal.label not in ANNOTATIONS]
    found = [signal for signal in usable if signal.label.lower() == wanted.lower()]
    if not found and wanted.isdecimal():
        found = [signal for signal in usable if signal.number == int(wanted)]
    if len(found) != 1:
        what = f"--columns {wanted!r} is {'several signals' if found else 'no signal'} of this file"
        raise UsageError(what, path=path, hint=f"its signals are {_labels(header)}")
    return found[0]


def _labels(header: Header) -> str:
    shown = [f"{signal.number} ({signal.label})" for signal in header.signals[:40]]
    return ", ".join(shown) + ", ..." * (len(header.signals) > len(shown))


def _groups(
    header: Header, names: frozenset[str], units: UnitNames[Any]
) -> dict[str, tuple[Signal, Signal, Signal]]:
    """Sensors of a kind by the rest of their labels: such as have one signal for each axis."""
    found: dict[str, dict[str, list[Signal]]] = {}
    for signal in header.signals:
        parts = words(signal.label)
        axes = [part for part in parts if part in ("x", "y", "z")]
        known = names & set(parts) or units.find(signal.dimension.lower(), In.EDF) is not None
        other = ((ACCEL_NAMES | GYRO_NAMES) - names) & set(parts)
        if len(axes) == 1 and known and not other and not NOT_RAW & set(parts):
            rest = " ".join(part for part in parts if part not in (*axes, *names, "axis"))
            found.setdefault(rest, {}).setdefault(axes[0], []).append(signal)
    whole = {name: [axes.get(axis, []) for axis in ("x", "y", "z")] for name, axes in found.items()}
    return {
        name: (xyz[0][0], xyz[1][0], xyz[2][0])
        for name, xyz in whole.items()
        if [len(signals) for signals in xyz] == [1, 1, 1]
    }


def _found(header: Header, options: ReadOptions, path: Path) -> tuple[Signal, Signal, Signal]:
    groups = _groups(header, ACCEL_NAMES, ACCELERATION)
    if options.sensor is not None:
        wanted = " ".join(words(options.sensor))
        groups = {name: group for name, group in groups.items() if name == wanted}
    if len(groups) == 1:
        return next(iter(groups.values()))
    if groups or options.sensor is not None:
        names = ", ".join(name or "(no name)" for name in _groups(header, ACCEL_NAMES, ACCELERATION))
        what = (
            f"no sensor is called {options.sensor!r}" if options.sensor else "it has several accelerometers"
        )
        raise UsageError(
            what, path=path, hint=f"give --sensor NAME ({names}), or --columns with three signals"
        )
    raise UnreadableError(
        f"which signals are x, y and z of an accelerometer cannot be told from {_labels(header)}",
        path=path,
        hint="name them with --columns, by label or number",
    )


def _line(signal: Signal, path: Path) -> tuple[Fraction, Fraction, int, int]:
    """Physical value of one digital step and of 0, and the digital limits.

    Raises:
        UnreadableError: the limits are no numbers, or equal.
    """
    low, high, first, last = map(number_in, signal.limits)
    if low is None or high is None or first is None or last is None or low == high or first >= last:
        limits = ", ".join(map(str.strip, signal.limits))
        raise UnreadableError(
            f"the range of signal {signal.label!r} is not usable ({limits})",
            path=path,
            byte_offset=signal.byte_offset,
            hint="name other signals with --columns, or give --unit counts with --lsb-per-g",
        )
    gain = (high - low) / (last - first)
    return gain, low - first * gain, math.floor(first), math.ceil(last)


def _in_g(signals: tuple[Signal, Signal, Signal], options: ReadOptions, path: Path) -> Axes:
    """The acceleration.

    Raises:
        UnreadableError: its unit is not known, or its scale impossible.
        UsageError: counts without their scale.
    """
    if options.unit == "counts" or (options.unit is None and options.lsb_per_g is not None):
        if options.lsb_per_g is None:
            raise UsageError(
                "counts need their scale", path=path, hint="give --lsb-per-g, the counts in one g"
            )
        step = 1 / Fraction(options.lsb_per_g)
        return Axes(signals, (1, 1, 1), (0, 0, 0), step, ())
    units = {options.unit or ACCELERATION.find(signal.dimension.lower(), In.EDF) for signal in signals}
    unit = units.pop()
    if units or unit is None:
        written = ", ".join(repr(signal.dimension) for signal in signals)
        raise UnreadableError(
            f"the unit of the acceleration is not known ({written})",
            path=path,
            hint=GIVE_UNIT,
        )
    axes = _axes(signals, ACCELERATION_UNITS[unit].per_g, path)
    if not 1 <= axes.per_unit <= LARGEST_LSB_PER_G:
        raise UnreadableError(
            f"{axes.per_unit:g} counts in one g are impossible",
            path=path,
            byte_offset=signals[0].byte_offset,
            hint="give --unit, or --unit counts with --lsb-per-g",
        )
    return axes


def _axes(signals: tuple[Signal, Signal, Signal], per_unit: Fraction, path: Path) -> Axes:
    """Counts of the largest step that all values are multiples of."""
    lines = [_line(signal, path) for signal in signals]
    step = _common_step([value / per_unit for line in lines for value in line[:2]])
    factors, addends = (tuple(int(line[place] / per_unit / step) for line in lines) for place in (0, 1))
    ends = tuple(
        int(line[place]) * factor + addend
        for line, factor, addend in zip(lines, factors, addends, strict=True)
        for place in (2, 3)
    )
    fine = max(map(abs, ends)) > MOST_COUNTS or 1 / step > LARGEST_LSB_PER_G
    if fine:
        grid = step * int(FLOAT_LSB_PER_G)
        ends = tuple(int(end * grid) for end in ends)
    return Axes(signals, factors, addends, step, ends, fine)


def _common_step(values: list[Fraction]) -> Fraction:
    """The largest number of which all are multiples; not all are 0."""
    denominator = math.lcm(*(value.denominator for value in values))
    return Fraction(math.gcd(*(int(value * denominator) for value in values)), denominator)


def _gyro(header: Header, accel: tuple[Signal, Signal, Signal], path: Path) -> Axes | None:
    """The one gyroscope of the same rate in deg/s; None if there is none whose scale is usable."""
    groups = _groups(header, GYRO_NAMES, ROTATION)
    fitting = [
        group
        for group in groups.values()
        if all(
            ROTATION.find(one.dimension.lower(), In.EDF) is not None and one.samples == accel[0].samples
            for one in group
        )
    ]
    if len(fitting) != 1:
        return None
    try:
        axes = _axes(fitting[0], Fraction(1), path)
    except UnreadableError:
        return None
    return None if axes.on_grid else axes


def _temperature(header: Header, path: Path) -> tuple[Signal, float, float] | None:
    found = [
        signal
        for signal in header.signals
        if names_in(THERMOMETER, In.EDF) & set(words(signal.label))
        and TEMPERATURE.find(signal.dimension.lower(), In.EDF) is not None
        and signal.samples
    ]
    if len(found) != 1:
        return None
    try:
        gain, zero, _, _ = _line(found[0], path)
    except UnreadableError:
        return None
    return found[0], float(1000 * gain), float(1000 * zero)
