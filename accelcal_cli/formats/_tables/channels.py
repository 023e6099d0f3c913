"""Acceleration and other channels of a table: which tracks hold them, and how numbers become counts.

`CHANNELS` holds what is particular to a channel; all else passes channels on by name. A new one with one
number for each row is one more `ColumnRule` there, and an entry of `opal.LAYOUTS` if Opal files have it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import FLOAT_LSB_PER_G, NOT_CALIBRATED, Counts, Validity
from accelcal_cli.core.thermometers import (
    CELSIUS,
    MILLI,
    UNITS,
    HeatUnit,
    find_thermometer,
    unit_by_values,
)
from accelcal_cli.core.vocabulary import PER_G, TABLES, normalized
from accelcal_cli.formats._tables.table import (
    BLOCK_ROWS,
    READ_ERRORS,
    Group,
    RowSelection,
    RowSource,
    SensorTable,
    Track,
    chosen_axes,
    described,
    find_gyro,
    find_heat,
    good_rows,
    readable,
    shown,
    split_unit,
)

LARGEST_G = 127.0
"""Values beyond this [g] are damage."""

LARGEST_DPS = 32_767.0
"""Values beyond this [deg/s] are damage."""

GYRO_LSB_PER_DPS = 65_536.0
"""Counts per deg/s given to rotation rates that arrive as decimal fractions."""

SHORT_BYTES = 2
"""Bytes of whole numbers whose distances from any zero fit 32 bits."""

EMPTY = -(1 << 63)
"""Stands for an empty cell among whole numbers of 64 bits."""

FAULTS = {
    "missing_value": "rows without a value (NaN) left out",
    "bad_row": "rows whose counts are not whole numbers left out",
    "out_of_range": "rows with values beyond anything the sensor can measure left out",
}
LSB_PER_DPS = ("lsb_per_dps", "counts_per_dps", "gyro_lsb_per_dps", "lsb_per_deg_s")
DPS_PER_LSB = ("dps_per_lsb", "dps_per_count", "gyro_dps_per_lsb")
NOT_READ = "the gyroscope is not read (--gyro-unit none)"


@dataclass(frozen=True, slots=True)
class CountScale:
    """How numbers become counts.

    Attributes:
        lsb: counts in one unit of the result (g or deg/s).
        divisor: the size of one unit of the result in the track; None if its numbers are counts.
        limit: largest believable magnitude, in units of the result; of no use for counts.
        exact: the type that holds all counts of the track, None if some may not fit.
        zero: the number that stands for 0.
    """

    lsb: float
    divisor: float | None = None
    limit: float = 0.0
    exact: type[np.int16] | type[np.int32] | None = None
    zero: int = 0

    def counts(self, values: NDArray[Any]) -> tuple[Counts, dict[str, NDArray[np.bool_]]]:
        """Return counts of rows (n, 3), and by problem code the rows (n,) that have none."""
        if self.zero:
            values = _less(values, self.zero)
        if self.exact is np.int16 and values.dtype.kind != "f":
            return values.astype(np.int16), {}
        if self.exact is np.int32 and values.dtype.kind != "f":
            return values.astype(np.int32), {}
        if values.dtype.kind in "iu":
            return _narrowed(values)
        with np.errstate(over="ignore", invalid="ignore"):
            if values.dtype == np.float32 and self.divisor == 1.0 and self.lsb == FLOAT_LSB_PER_G:
                return self._shifted(values)
            return self._rounded(values.astype(np.float64))

    def _shifted(self, values: NDArray[np.float32]) -> tuple[Counts, dict[str, NDArray[np.bool_]]]:
        """Return the result of `_rounded` in half the time: a power of two moves no bit of a fraction."""
        whole = values * np.float32(self.lsb)
        np.rint(whole, out=whole)
        limit = self.limit * self.lsb
        if len(whole) and not (whole.min() >= -limit and whole.max() <= limit):
            return self._rounded(values.astype(np.float64))
        return whole.astype(np.int32), {}

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
    """Return the rows (n,) with any of three cells true."""
    rows: NDArray[np.bool_] = cells[:, 0] | cells[:, 1] | cells[:, 2]
    return rows


def _less(values: NDArray[Any], zero: int) -> NDArray[Any]:
    """Return numbers less what stands for 0; empty cells stay empty."""
    if values.dtype.kind == "f":
        return values.astype(np.float64) - zero
    wide = values.astype(np.int64)
    return np.where(wide == EMPTY, EMPTY, wide - zero)


def _narrowed(values: NDArray[Any]) -> tuple[Counts, dict[str, NDArray[np.bool_]]]:
    """Return whole numbers as int32, and the rows that do not fit or are empty."""
    beyond, faults = values > 2**31 - 1, {}
    if values.dtype.kind == "i":
        beyond |= values < -(2**31)
        if values.dtype.itemsize == 8:
            faults["missing_value"] = _rows(values == EMPTY)
    faults["out_of_range"] = _rows(beyond)
    return np.where(beyond, 0, values).astype(np.int32), faults


def count_scale(lsb: float, dtype: np.dtype[Any], zero: int = 0) -> CountScale:
    """Return the scale of numbers that are counts already; `zero` stands for 0."""
    if zero:
        fits = dtype.kind in "iu" and dtype.itemsize <= SHORT_BYTES
        return CountScale(lsb, exact=np.int32 if fits else None, zero=zero)
    if dtype.kind == "f" or not np.can_cast(dtype, np.int32):
        return CountScale(lsb)
    return CountScale(lsb, exact=np.int16 if np.can_cast(dtype, np.int16) else np.int32)


def physical_scale(unit: str, dtype: np.dtype[Any]) -> CountScale:
    """Return the scale of numbers in g, mg or m/s2: whole ones are counts, fractions go to a fine grid."""
    if dtype.kind in "iu":
        return count_scale(PER_G[unit], dtype)
    return CountScale(FLOAT_LSB_PER_G, PER_G[unit], LARGEST_G)


def turn_scale(unit: str) -> CountScale | None:
    """Return the scale of rotation rates in a unit, written as decimal fractions; None if it is not known."""
    factor = TABLES.rotations.get(normalized(unit))
    return None if factor is None else CountScale(GYRO_LSB_PER_DPS, factor, LARGEST_DPS)


@dataclass(frozen=True, slots=True)
class Axes:
    """The tracks of x, y and z, one of three columns or three of one, and their scale."""

    tracks: Group
    scale: CountScale

    def values(self, sources: list[RowSource], selection: RowSelection, _before: Any = None) -> Counts:
        """Return counts (n, 3) of all rows of the selection; rows that have none are left out of it."""
        parts = [selection.read(source) for source in sources]
        counts, faults = self.scale.counts(parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1))
        for code, bad in faults.items():
            leave_out = selection.leave_out_empty if code == "missing_value" else selection.leave_out
            leave_out((code, FAULTS[code]), bad)
        return counts


@dataclass(frozen=True, slots=True)
class ValueColumn:
    """A track of one number for each row.

    Attributes:
        unit: of its numbers.
        first: its first value, in steps of the channel.
    """

    rule: ColumnRule
    tracks: Group
    unit: HeatUnit
    first: int

    def values(
        self, sources: list[RowSource], selection: RowSelection, before: NDArray[np.int32] | None
    ) -> NDArray[np.int32]:
        """Return values (n,) of all rows of the selection; where one is missing, the last one before it.

        Args:
            before: the value (1,) of the row before, None at the beginning.
        """
        values = self.rule.steps_of(*sources[0].read(selection.start, selection.stop), self.unit)
        missing = np.isnan(values)
        if missing.any():
            kind = ("missing_value", f"rows without a {self.rule.noun}; the last one before them holds")
            selection.note_as_one(kind, np.flatnonzero(missing))
            latest = np.maximum.accumulate(np.where(missing, -1, np.arange(len(missing))))
            values = np.where(latest < 0, self.first if before is None else before, values[latest])
        return values.astype(np.int32)


@dataclass(frozen=True, slots=True)
class Marks:
    """A track that tells where each row comes from, as `Validity` numbers it."""

    tracks: Group

    def values(
        self, sources: list[RowSource], selection: RowSelection, _before: Any = None
    ) -> NDArray[np.uint8]:
        """Return values (n,) of all rows of the selection; unknown ones count as measured."""
        found = selection.read(sources[0])[:, 0] % NOT_CALIBRATED
        return np.where((found >= 0) & (found <= max(Validity)), found, Validity.MEASURED).astype(np.uint8)


Channel = Axes | ValueColumn | Marks


@dataclass(frozen=True, slots=True)
class ColumnRule:
    """How a channel of one number for each row is found and read.

    Attributes:
        noun: the channel in messages; `unit`: the unit of its limits in messages.
        low, high: values beyond these are not believed.
        steps: of the channel in one unit.
    """

    noun: str
    unit: str
    low: float
    high: float
    steps: int
    width: int = 1

    def candidates(self, tracks: tuple[Track, ...], accel: Track) -> tuple[Group, ...]:
        """Return tracks that may hold it."""
        return find_heat(tracks, accel)[0]

    def find(self, table: SensorTable, group: Group, unit: str | None = None) -> ValueColumn | str:
        """Return the channel in a track, or why it is not used; `unit` outweighs what is stated."""
        stated, rows = unit or table.own(group[0].path).text("units", "unit"), table.rows(group[0])
        found, _ = find_thermometer([(group[0].name, stated)])
        try:
            scale = UNITS.get(normalized(stated)) if stated else None if found is None else found.unit
            if scale is None and not stated and group[0].dtype.kind == "f":
                scale = unit_by_values(self._first_block(rows, group[0].rows))
            if scale is None:
                return f"its unit is not {self.unit}"
            first = self._first(rows, group[0].rows, scale)
        except (UnreadableError, *READ_ERRORS):
            return "it is damaged"
        return f"it holds no {self.noun}" if first is None else ValueColumn(self, group, scale, first)

    def _first_block(self, source: RowSource, rows: int) -> NDArray[np.float64]:
        """Return the first block with values (n,)."""
        values = np.empty(0)
        for start in range(0, rows, BLOCK_ROWS):
            values = good_rows(source, start, min(start + BLOCK_ROWS, rows))[:, 0].astype(np.float64)
            if not np.isnan(values).all():
                break
        return values

    def _first(self, source: RowSource, rows: int, unit: HeatUnit) -> int | None:
        """Return the first value [steps], None if there is none at all."""
        for start in range(0, rows, BLOCK_ROWS):
            values = self.steps_of(*source.read(start, min(start + BLOCK_ROWS, rows)), unit)
            known = values[~np.isnan(values)]
            if len(known):
                return int(known[0])
        return None

    def steps_of(self, rows: NDArray[Any], good: NDArray[np.bool_], unit: HeatUnit) -> NDArray[np.float64]:
        """Return rows (n, 1) as steps of the channel (n,), NaN where there is no believable value."""
        with np.errstate(over="ignore", invalid="ignore"):
            values = unit.celsius(rows[:, 0].astype(np.float64))
            believable = good & (values >= self.low) & (values <= self.high)
            values *= self.steps
            np.rint(values, out=values)
            if not believable.all():
                values[~believable] = np.nan
            return values


@dataclass(frozen=True, slots=True)
class TurnRule:
    """How rotation rates around x, y and z are found and read; see `ColumnRule`."""

    noun: str
    unit: str
    width: int = 3

    def candidates(self, tracks: tuple[Track, ...], accel: Track) -> tuple[Group, ...]:
        """Return tracks that may hold them."""
        return find_gyro(tracks, accel)

    def find(
        self, table: SensorTable, group: Group, unit: str | None = None, lsb: float | None = None
    ) -> Axes | str:
        """Return the channel in tracks, or why it is not used; `unit` and `lsb` outweigh what they state."""
        if lsb is not None:
            scale: CountScale | None = _turn_count_scale(lsb, group)
        else:
            scale = turn_scale(unit) if unit else self._stated_scale(group, table)
        if scale is None:
            return f"its unit is not {self.unit}"
        try:
            for track in group:
                table.rows(track)
        except (UnreadableError, *READ_ERRORS):
            return "it is damaged"
        return Axes(group, scale)

    def _stated_scale(self, group: Group, table: SensorTable) -> CountScale | None:
        """Return the scale by `lsb_per_dps` or `dps_per_lsb`, or by the unit of decimal fractions."""
        stated, own = table.stated(group[0].path), table.own(group[0].path).text("units", "unit")
        per_count, counts = stated.number(*DPS_PER_LSB), stated.number(*LSB_PER_DPS)
        lsb = 1 / per_count if counts is None and per_count else counts
        if lsb is not None and lsb > 0:
            return _turn_count_scale(lsb, group)
        named = own or split_unit(group[0].name)[1] or stated.text("units", "unit")
        return turn_scale(named or "")


def _turn_count_scale(lsb: float, group: Group) -> CountScale:
    """Return the scale of counts, `lsb` of which are 1 deg/s."""
    widest = max((item.dtype for item in group), key=lambda dtype: dtype.itemsize)
    return count_scale(lsb, widest) if widest.kind in "iu" else CountScale(lsb)


CHANNELS: dict[str, TurnRule | ColumnRule] = {
    "gyro_counts": TurnRule(noun="gyroscope", unit="deg/s, rad/s or counts per deg/s"),
    "temperature_mc": ColumnRule(
        noun="temperature",
        unit="degrees Celsius",
        low=-273.15,
        high=1000.0,
        steps=1000,
    ),
}
"""Channels that a table may have, by their name in Chunk."""


def find_channels(
    table: SensorTable, tracks: tuple[Track, ...], accel: Track, options: ReadOptions
) -> tuple[dict[str, Channel], tuple[str, ...]]:
    """Return the channels that are as long as the acceleration, and notes on what is there but not used.

    Raises:
        UsageError: --gyro-columns names nothing.
    """
    channels: dict[str, Channel] = {}
    notes: list[str] = []
    for name, rule in CHANNELS.items():
        groups = _candidates(rule, table, tracks, accel, options)
        if isinstance(rule, TurnRule) and options.gyro_unit == "none":
            notes += [NOT_READ] * bool(groups)
            continue
        if len(groups) > 1:
            paths = shown([group[0].path for group in groups])
            notes.append(f"no {rule.noun} is used: several {table.word}s fit ({paths})")
        if len(groups) != 1:
            continue
        channel: Channel | str
        if isinstance(rule, TurnRule):
            channel = rule.find(table, groups[0], options.gyro_unit, options.lsb_per_dps)
        else:
            channel = rule.find(table, groups[0])
        if isinstance(channel, str):
            notes.append(f"{readable(groups[0][0].path)} is not used: {channel}")
        else:
            channels[name] = channel
            if isinstance(channel, ValueColumn) and channel.unit not in (CELSIUS, MILLI):
                notes.append(f"{readable(groups[0][0].path)} is in {channel.unit.name}")
    like = shown([track.path for track in find_heat(tracks, accel)[1]])
    return channels, (*notes, *([f"not read, though it looks like a temperature: {like}"] if like else []))


def _candidates(
    rule: TurnRule | ColumnRule,
    table: SensorTable,
    tracks: tuple[Track, ...],
    accel: Track,
    options: ReadOptions,
) -> tuple[Group, ...]:
    if not isinstance(rule, TurnRule) or options.gyro_columns is None:
        return rule.candidates(tracks, accel)
    group = chosen_axes(tracks, options.gyro_columns, table, "--gyro-columns")
    if group[0].rows != accel.rows:
        raise UsageError(
            f"--gyro-columns names {described(group)}, and the acceleration has {accel.rows} rows",
            path=table.path,
        )
    return (group,)


def dps_per_lsb(channels: dict[str, Channel]) -> tuple[float, float, float] | None:
    """Return deg/s in one count of each axis of the gyroscope; None without one."""
    gyro = channels.get("gyro_counts")
    if not isinstance(gyro, Axes):
        return None
    step = 1 / gyro.scale.lsb
    return step, step, step
