"""Acceleration, and channels beside it: where a file has them, in which unit, and their rows as values.

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
from accelcal_cli.core.recording import NOT_CALIBRATED, Counts, Validity
from accelcal_cli.core.vocabulary import (
    ROTATION,
    TEMPERATURE,
    THERMOMETER,
    In,
    UnitNames,
    names_in,
)
from accelcal_cli.formats._tables import tracks as tracks_of
from accelcal_cli.formats._tables.attributes import readable
from accelcal_cli.formats._tables.table import BLOCK_ROWS, READ_ERRORS, RowSelection, RowSource, Table
from accelcal_cli.formats._tables.tracks import Group, Track, chosen_axes, described, split_unit
from accelcal_cli.formats._tables.units import Scale, count_scale

FAULTS = {
    "missing_value": "rows without a value (NaN) left out",
    "bad_row": "rows whose counts are not whole numbers left out",
    "out_of_range": "rows with values beyond anything the sensor can measure left out",
}
LSB_PER_DPS = ("lsb_per_dps", "counts_per_dps", "gyro_lsb_per_dps", "lsb_per_deg_s")
DPS_PER_LSB = ("dps_per_lsb", "dps_per_count", "gyro_dps_per_lsb")
NOT_READ = "the gyroscope is not read (--gyro-unit none)"
GYRO_LSB_PER_DPS = 65_536.0
"""Counts per deg/s given to rates of turn that arrive as decimal fractions."""

LARGEST_DPS = 32_767.0


@dataclass(frozen=True, slots=True)
class Axes:
    """Where x, y and z are: one track of three columns or three of one, and their scale."""

    tracks: Group
    scale: Scale

    def values(self, sources: list[RowSource], selection: RowSelection, _before: Any = None) -> Counts:
        """Counts (n, 3) of all rows of the selection; those that have none are left out of it."""
        parts = [selection.read(source) for source in sources]
        counts, faults = self.scale.counts(parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1))
        for code, bad in faults.items():
            selection.leave_out((code, FAULTS[code]), bad)
        return counts


@dataclass(frozen=True, slots=True)
class Column:
    """A track of one number for each row, with `factor` of its units in one of the rule's.

    `first` is its first value, in steps of the channel.
    """

    rule: ColumnRule
    tracks: Group
    factor: float
    first: int

    def values(
        self, sources: list[RowSource], selection: RowSelection, before: NDArray[np.int32] | None
    ) -> NDArray[np.int32]:
        """Values (n,) of all rows of the selection; where one is missing, the last one before it holds.

        Args:
            before: the value (1,) of the row before, None at the beginning.
        """
        values = self.rule.steps_of(*sources[0].read(selection.start, selection.stop), self.factor)
        missing = np.isnan(values)
        if missing.any():
            kind = ("missing_value", f"rows without a {self.rule.noun}; the last one before them holds")
            selection.note_as_one(kind, np.flatnonzero(missing))
            latest = np.maximum.accumulate(np.where(missing, -1, np.arange(len(missing))))
            values = np.where(latest < 0, self.first if before is None else before, values[latest])
        return values.astype(np.int32)


@dataclass(frozen=True, slots=True)
class Marks:
    """Where each row comes from, as `Validity` numbers it."""

    tracks: Group

    def values(
        self, sources: list[RowSource], selection: RowSelection, _before: Any = None
    ) -> NDArray[np.uint8]:
        """Values (n,) of all rows of the selection; those of no meaning are those of measured rows."""
        found = selection.read(sources[0])[:, 0] % NOT_CALIBRATED
        return np.where((found >= 0) & (found <= max(Validity)), found, Validity.MEASURED).astype(np.uint8)


Channel = Axes | Column | Marks


@dataclass(frozen=True, slots=True)
class ColumnRule:
    """How a channel of one number for each row is found and read.

    Attributes:
        noun: what it is, in messages; `unit`: of its limits, in messages.
        names: of its track, as `normal` leaves them.
        units: find how much one such unit is in others.
        endings: of names that state the unit; decimal fractions that state nothing have it too.
        low, high: values beyond these are not believed.
        steps: of the channel in one unit.
    """

    noun: str
    unit: str
    names: frozenset[str]
    units: UnitNames[float]
    endings: tuple[str, ...]
    low: float
    high: float
    steps: int
    width: int = 1

    def candidates(self, tracks: tuple[Track, ...], accel: Track) -> tuple[Group, ...]:
        """Tracks that may hold it."""
        return tracks_of.find_named(tracks, accel, self.names)

    def find(self, table: Table, group: Group, unit: str | None = None) -> Column | str:
        """The channel in a track, or why it is not used; `unit` outweighs what is stated."""
        factor = self.units.find_in_table(unit) if unit else self._stated_factor(table, group[0])
        if factor is None:
            return f"its unit is not {self.unit}"
        try:
            first = self._first(table.rows(group[0]), group[0].rows, factor)
        except (UnreadableError, *READ_ERRORS):
            return "it is damaged"
        return f"it holds no {self.noun}" if first is None else Column(self, group, factor, first)

    def _stated_factor(self, table: Table, track: Track) -> float | None:
        unit = table.own(track.path).text("units", "unit")
        if unit is not None:
            return self.units.find_in_table(unit)
        return 1.0 if track.name.lower().endswith(self.endings) or track.dtype.kind == "f" else None

    def _first(self, source: RowSource, rows: int, factor: float) -> int | None:
        """The first value [steps], None if there is none at all."""
        for start in range(0, rows, BLOCK_ROWS):
            values = self.steps_of(*source.read(start, min(start + BLOCK_ROWS, rows)), factor)
            known = values[~np.isnan(values)]
            if len(known):
                return int(known[0])
        return None

    def steps_of(self, rows: NDArray[Any], good: NDArray[np.bool_], factor: float) -> NDArray[np.float64]:
        """Rows (n, 1) as steps of the channel (n,), NaN where there is no believable value."""
        with np.errstate(over="ignore", invalid="ignore"):
            values = rows[:, 0].astype(np.float64)
            if factor != 1:
                values /= factor
            believable = good & (values >= self.low) & (values <= self.high)
            values *= self.steps
            np.rint(values, out=values)
            if not believable.all():
                values[~believable] = np.nan
            return values


@dataclass(frozen=True, slots=True)
class TurnRule:
    """How rates of turn around x, y and z are found and read; see `ColumnRule`."""

    noun: str
    unit: str
    width: int = 3

    def candidates(self, tracks: tuple[Track, ...], accel: Track) -> tuple[Group, ...]:
        """Tracks that may hold them."""
        return tracks_of.find_gyro(tracks, accel)

    def find(
        self, table: Table, group: Group, unit: str | None = None, lsb: float | None = None
    ) -> Axes | str:
        """The channel in tracks, or why it is not used; `unit` and `lsb` outweigh what they state."""
        if lsb is not None:
            scale: Scale | None = _in_counts(lsb, group)
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

    def _stated_scale(self, group: Group, table: Table) -> Scale | None:
        """From `lsb_per_dps` or `dps_per_lsb` for counts, from the unit for decimal fractions."""
        stated, own = table.stated(group[0].path), table.own(group[0].path).text("units", "unit")
        per_count, counts = stated.number(*DPS_PER_LSB), stated.number(*LSB_PER_DPS)
        lsb = 1 / per_count if counts is None and per_count else counts
        if lsb is not None and lsb > 0:
            return _in_counts(lsb, group)
        named = own or split_unit(group[0].name)[1] or stated.text("units", "unit")
        return turn_scale(named or "")


def turn_scale(unit: str) -> Scale | None:
    """Return the scale of rotation rates in a unit, written as decimal fractions; None if it is not known."""
    factor = ROTATION.find_in_table(unit)
    return None if factor is None else Scale(GYRO_LSB_PER_DPS, factor, LARGEST_DPS)


def _in_counts(lsb: float, group: Group) -> Scale:
    """Counts of which so many are 1 deg/s."""
    widest = max((item.dtype for item in group), key=lambda dtype: dtype.itemsize)
    return count_scale(lsb, widest) if widest.kind in "iu" else Scale(lsb)


CHANNELS: dict[str, TurnRule | ColumnRule] = {
    "gyro_counts": TurnRule(noun="gyroscope", unit="deg/s, rad/s or counts per deg/s"),
    "temperature_mc": ColumnRule(
        noun="temperature",
        unit="degrees Celsius",
        names=names_in(THERMOMETER, In.TABLES),
        units=TEMPERATURE,
        endings=("_c", "_degc"),
        low=-273.15,
        high=1000.0,
        steps=1000,
    ),
}
"""Channels that a table may have, by their name in Chunk."""


def find_channels(
    table: Table, tracks: tuple[Track, ...], accel: Track, options: ReadOptions
) -> tuple[dict[str, Channel], tuple[str, ...]]:
    """The channels that are as long as the acceleration, and notes: what is there but not used, and why.

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
            paths = ", ".join(readable(group[0].path) for group in groups)
            notes.append(f"no {rule.noun} is used: several {table.word}s fit ({paths})")
        if len(groups) != 1:
            continue
        channel = _found(rule, table, groups[0], options)
        if isinstance(channel, str):
            notes.append(f"{readable(groups[0][0].path)} is not used: {channel}")
        else:
            channels[name] = channel
    return channels, tuple(notes)


def _candidates(
    rule: TurnRule | ColumnRule, table: Table, tracks: tuple[Track, ...], accel: Track, options: ReadOptions
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


def _found(rule: TurnRule | ColumnRule, table: Table, group: Group, options: ReadOptions) -> Channel | str:
    if isinstance(rule, TurnRule):
        return rule.find(table, group, options.gyro_unit, options.lsb_per_dps)
    return rule.find(table, group)


def dps_per_lsb(channels: dict[str, Channel]) -> tuple[float, float, float] | None:
    """deg/s in one count of each axis of the gyroscope; None without one."""
    gyro = channels.get("gyro_counts")
    if not isinstance(gyro, Axes):
        return None
    step = 1 / gyro.scale.lsb
    return step, step, step
