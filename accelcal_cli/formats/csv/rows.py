"""Rows of a text file as counts, times and faults, block after block.

`RowParser` makes rows of the parsed columns. `FollowedChanges` makes the times run on where they follow
daylight saving. `SpreadRows` gives every row a time where several rows share a
stamp, such as whole seconds; `IdleFill` marks what a device wrote while it slept. Rows of small blocks are
then joined, since every stretch of rows costs the same afterwards, however short.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.local_time import LocalStamps
from accelcal_cli.core.parallel import parallel_map
from accelcal_cli.core.recording import Channels, cut_channels, cut_columns, joined_channels, joined_columns
from accelcal_cli.core.vocabulary import PHYSICAL_UNITS
from accelcal_cli.formats._rows import RepeatedSamples
from accelcal_cli.formats._stamps import IMPOSSIBLE, NO_TIME, Pace, SharedStamps
from accelcal_cli.formats._tables.units import Scale as TurnScale
from accelcal_cli.formats.csv.cells import Scale
from accelcal_cli.formats.csv.columns import CHANNELS, UNKNOWN
from accelcal_cli.formats.csv.table import Block, ParsedTable, TableParser, lone_block

BLOCK_BYTES = 1 << 21
"""Text that is parsed at a time, however many samples are wanted: its table takes as much again."""

MOST_JOINED = 1 << 18
"""Rows that are joined however many are wanted: more of them are made no faster, and take memory."""


class Fault(IntEnum):
    """Why a row cannot be used."""

    NONE = 0
    MISSING = 1
    OUT_OF_RANGE = 2
    TIME = 3


@dataclass(frozen=True, slots=True)
class Rows:
    """Consecutive rows of a file, good and bad ones.

    first_row: number of the first, from 0. line: (n,) number in the text. counts: (n, 3) int32.
    fault: (n,) uint8 of `Fault`. time_us: (n,) or None. channels: (n,) or (n, 3) int32 each.
    filled: (n,) rows that the device did not measure, or None if none are known.
    """

    first_row: int
    line: NDArray[np.int64]
    counts: NDArray[np.int32]
    fault: NDArray[np.uint8]
    time_us: NDArray[np.int64] | None
    channels: Channels
    filled: NDArray[np.bool_] | None = None

    def __len__(self) -> int:
        return len(self.line)

    @property
    def row(self) -> NDArray[np.int64]:
        """(n,) number of each row within the file, from 0."""
        return self.first_row + np.arange(len(self), dtype=np.int64)

    def part(self, start: int, stop: int) -> Rows:
        """Rows start..stop-1, as views."""
        rows = slice(start, stop)
        columns, channels = cut_columns(self, COLUMNS, rows), cut_channels(self.channels, rows)
        return replace(self, first_row=self.first_row + start, channels=channels, **columns)


COLUMNS = ("line", "counts", "fault", "time_us", "filled")


def joined_rows(parts: list[Rows]) -> Rows:
    """Rows of the same file that follow each other, at least one stretch of them."""
    if len(parts) == 1:
        return parts[0]
    first = parts[0]
    channels = joined_channels([part.channels for part in parts])
    return Rows(first.first_row, channels=channels, **joined_columns(parts, COLUMNS))


class RowParser:
    """Turns blocks into rows, in the order of the file.

    Args:
        first_values: of each channel that is wanted, the file's first value, for rows before it.
        gyro: how rates of turn become counts, None without.
    """

    def __init__(
        self, parser: TableParser, scale: Scale, first_values: dict[str, int], gyro: TurnScale | None = None
    ) -> None:
        self._parser = parser
        self._scale = scale
        self._gyro = gyro
        self._last_values = dict(first_values)
        self._next_row = 0

    def rows(self, blocks: Iterable[Block], threads: int) -> Iterator[tuple[Rows, Block]]:
        """The rows of blocks that follow each other, and each block without its lines.

        Args:
            threads: how many may work at a time.

        Raises:
            UnreadableError: a line is no row of the file, or counts are not whole.
        """
        for rows, block in parallel_map(self._parsed, blocks, threads):
            yield self._placed(rows), block

    def _placed(self, rows: Rows) -> Rows:
        """The next rows, with their number in the file, and values of channels from before them."""
        first, self._next_row = self._next_row, self._next_row + len(rows)
        for name in self._last_values if len(rows) else ():
            values = rows.channels[name]
            np.copyto(values, self._last_values[name], where=values == UNKNOWN)
            self._last_values[name] = int(values[-1])
        return replace(rows, first_row=first)

    def _parsed(self, block: Block) -> tuple[Rows, Block]:
        """The rows of a block by themselves; does not depend on what was done before."""
        cells = self._cells(block)
        self._refuse_fractions(cells)
        counts, fault = self._counts(cells.values)
        if cells.time_us is not None:
            fault[cells.time_us == NO_TIME] = Fault.MISSING
            fault[cells.time_us == IMPOSSIBLE] = Fault.TIME
        channels: Channels = {
            name: CHANNELS[name].channel(cells.channels[name]) for name in self._last_values
        }
        if self._gyro is not None and cells.rates is not None:
            channels["gyro_counts"], faults = self._gyro.counts(cells.rates)
            fault[faults["missing_value"] & (fault == Fault.NONE)] = Fault.MISSING
            fault[faults["out_of_range"] & (fault == Fault.NONE)] = Fault.OUT_OF_RANGE
        return Rows(0, cells.line, counts, fault, cells.time_us, channels), block.without_lines()

    def _cells(self, block: Block) -> ParsedTable:
        """The columns of a block. Of the faults of its lines, the first is the error, however long it is."""
        try:
            return self._parser.cells(block)
        except UnreadableError as error:
            above = block.data.splitlines(keepends=True)[: (error.line or 0) - block.line]
            if above and self._in_counts:
                self._refuse_fractions(
                    self._parser.cells(lone_block(b"".join(above), block.line, block.offset))
                )
            raise

    def _counts(self, values: NDArray[np.float64]) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
        scaled = self._scale.counts(values)
        fault = np.zeros(len(values), np.uint8)
        limit = self._scale.limit
        if len(scaled) and not (scaled.max() <= limit and scaled.min() >= -limit):
            fault[(np.abs(scaled) > limit).any(axis=1)] = Fault.OUT_OF_RANGE
            fault[np.isnan(scaled).any(axis=1)] = Fault.MISSING
            scaled = np.where((fault == Fault.NONE)[:, None], scaled, 0.0)
        return scaled.astype(np.int32), fault

    @property
    def _in_counts(self) -> bool:
        return self._scale.unit == "counts" or (self._gyro is not None and self._gyro.divisor is None)

    def _refuse_fractions(self, cells: ParsedTable) -> None:
        """Raise UnreadableError for the first value that should be a whole number of counts."""
        if self._scale.unit == "counts":
            self._refuse(cells.values, cells.line, f"--unit {PHYSICAL_UNITS}")
        if self._gyro is not None and self._gyro.divisor is None and cells.rates is not None:
            self._refuse(cells.rates, cells.line, "--gyro-unit deg/s or rad/s")

    def _refuse(self, values: NDArray[np.float64], line: NDArray[np.int64], option: str) -> None:
        broken = (np.rint(values) != values) & np.isfinite(values)
        if not broken.any():
            return
        row, axis = np.argwhere(broken)[0]
        raise UnreadableError(
            f"{values[row, axis]:g} is not a whole number of counts",
            path=self._parser.path,
            line=int(line[row]),
            hint=f"give the unit of the values with {option}",
        )


class FollowedChanges:
    """Makes times run on where they follow a change of their zone's offset.

    Attributes:
        rows: numbers of the rows before which they do, from 0.
    """

    def __init__(self, zone: str | None) -> None:
        self._stamps = None if zone is None else LocalStamps(zone)
        self.rows: list[int] = []

    def add(self, rows: Rows, _last: bool) -> Rows:
        """The next rows, with the times of a clock that runs on."""
        if rows.time_us is None or self._stamps is None:
            return rows
        timed = np.flatnonzero(rows.time_us > IMPOSSIBLE)
        running, followed = self._stamps.running_on(rows.time_us[timed])
        self.rows += (rows.first_row + timed[followed]).tolist()
        times = rows.time_us.copy()
        times[timed] = running
        return replace(rows, time_us=times)


class SpreadRows:
    """Gives rows that share a stamp times of their own (see `SharedStamps`)."""

    def __init__(self, pace: Pace) -> None:
        self._stamps = SharedStamps(pace)
        self._waiting: Rows | None = None

    def add(self, rows: Rows, last: bool) -> Rows:
        """Take the next rows; gives those whose times are settled (all, where these are the last)."""
        assert rows.time_us is not None
        times = self._stamps.add(rows.time_us, last)
        rows = rows if self._waiting is None else joined_rows([self._waiting, rows])
        self._waiting = None if last else rows.part(len(times), len(rows))
        return replace(rows.part(0, len(times)), time_us=times)


class IdleFill:
    """Marks rows of zeros, and rows that repeat the one before for long (see `RepeatedSamples`).

    Args:
        least: rows of a run of equal ones from which on all but the first are marked.
    """

    def __init__(self, least: int) -> None:
        self._repeats = RepeatedSamples(least)
        self._waiting: Rows | None = None

    def add(self, rows: Rows, last: bool) -> Rows:
        """Take the next rows; gives those that are settled (all, where these are the last)."""
        rows = rows if self._waiting is None else joined_rows([self._waiting, rows])
        usable = rows.fault == Fault.NONE
        filled = self._repeats.mark(rows.counts, usable, last=last)
        settled = len(filled)
        x, y, z = rows.counts[:settled].T
        filled |= usable[:settled] & ((x | y | z) == 0)
        self._waiting = rows.part(settled, len(rows)) if settled < len(rows) else None
        return replace(rows.part(0, settled), filled=filled)


def block_bytes(samples: int, line_bytes: float) -> int:
    """How much text to parse at a time where so many samples are wanted."""
    return max(1, min(BLOCK_BYTES, int(0.95 * samples * line_bytes)))


def joined(parts: Iterable[tuple[Rows, Block]], samples: int) -> Iterator[tuple[Rows, Block]]:
    """Rows of blocks joined as long as they are no more than `samples`, each with its last block."""
    samples = min(samples, MOST_JOINED)
    stretches: list[Rows] = []
    number, last_block = 0, None
    for rows, block in parts:
        if last_block is not None and number + len(rows) > samples:
            yield _emptied(stretches), last_block
            number = 0
        if len(rows) or not stretches:
            stretches.append(rows)
        number, last_block = number + len(rows), block
    if last_block is not None:
        yield _emptied(stretches), last_block


def _emptied(stretches: list[Rows]) -> Rows:
    """Stretches as one; the list does not keep their memory."""
    rows = joined_rows(stretches)
    stretches.clear()
    return rows
