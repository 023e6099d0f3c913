"""Rows of a text file as counts, times and faults, block after block."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.readers._csv.blocks import Block
from accelcal_cli.readers._csv.sheet import Sheet
from accelcal_cli.readers._csv.side_by_side import side_by_side
from accelcal_cli.readers._csv.time import NO_TIME
from accelcal_cli.readers._csv.units import Scale

HOTTEST_C = 1000.0
UNKNOWN_MC = np.iinfo(np.int32).min
"""Stands for a temperature that only rows before can tell."""


class Fault(IntEnum):
    """Why a row cannot be used."""

    NONE = 0
    MISSING = 1
    OUT_OF_RANGE = 2


@dataclass(frozen=True, slots=True)
class Rows:
    """Consecutive rows of a file, good and bad ones.

    first_row: number of the first, from 0. line: (n,) number in the text. counts: (n, 3) int32.
    fault: (n,) uint8 of `Fault`. time_us: (n,) or None. temperature_mc: (n,) int32 or None.
    filled: (n,) rows that the device did not measure, or None where none are known.
    """

    first_row: int
    line: NDArray[np.int64]
    counts: NDArray[np.int32]
    fault: NDArray[np.uint8]
    time_us: NDArray[np.int64] | None
    temperature_mc: NDArray[np.int32] | None
    filled: NDArray[np.bool_] | None = None

    def __len__(self) -> int:
        return len(self.line)

    @property
    def row(self) -> NDArray[np.int64]:
        """(n,) number of each row within the file, from 0."""
        return self.first_row + np.arange(len(self), dtype=np.int64)

    def part(self, start: int, stop: int) -> Rows:
        """Rows start..stop-1, as views."""
        return Rows(
            self.first_row + start,
            self.line[start:stop],
            self.counts[start:stop],
            self.fault[start:stop],
            *(None if item is None else item[start:stop] for item in self._spare),
        )

    def then(self, other: Rows) -> Rows:
        """These rows and the next ones of the same file."""
        return joined_rows([self, other])

    @property
    def _spare(self) -> tuple[NDArray[Any] | None, ...]:
        """The columns that not every file has."""
        return self.time_us, self.temperature_mc, self.filled


def joined_rows(parts: list[Rows]) -> Rows:
    """Rows of the same file that follow each other, at least one stretch of them."""
    if len(parts) == 1:
        return parts[0]
    spare = zip(*(part._spare for part in parts), strict=True)
    return Rows(
        parts[0].first_row,
        np.concatenate([part.line for part in parts]),
        np.concatenate([part.counts for part in parts]),
        np.concatenate([part.fault for part in parts]),
        *(None if any(item is None for item in items) else np.concatenate(items) for items in spare),
    )


class RowMaker:
    """Turns blocks into rows, in the order of the file.

    Args:
        temperature_c: the file's first one, for rows before it; None without a temperature.
    """

    def __init__(self, sheet: Sheet, scale: Scale, temperature_c: float | None) -> None:
        self._sheet = sheet
        self._scale = scale
        self._warm = temperature_c is not None
        self._last_mc = round(1000 * (temperature_c or 0.0))
        self._next_row = 0

    def rows(self, blocks: Iterable[Block], threads: int) -> Iterator[tuple[Rows, Block]]:
        """The rows of blocks that follow each other, and each block without its lines.

        Args:
            threads: how many may work at a time.

        Raises:
            UnreadableError: a line is no row of the file, or counts are not whole.
        """
        for rows, block in side_by_side(self._parsed, blocks, threads):
            yield self._placed(rows), block

    def _placed(self, rows: Rows) -> Rows:
        """The next rows, with their number in the file, and temperatures from before them."""
        first, self._next_row = self._next_row, self._next_row + len(rows)
        warmth = rows.temperature_mc
        if warmth is not None and len(warmth):
            np.copyto(warmth, self._last_mc, where=warmth == UNKNOWN_MC)
            self._last_mc = int(warmth[-1])
        return replace(rows, first_row=first)

    def _parsed(self, block: Block) -> tuple[Rows, Block]:
        """The rows of a block by themselves; does not depend on what was done before."""
        cells = self._sheet.cells(block)
        if self._scale.unit == "counts":
            self._refuse_fractions(cells.values, cells.line)
        counts, fault = self._counts(cells.values)
        if cells.time_us is not None:
            fault[cells.time_us == NO_TIME] = Fault.MISSING
        warmth = cells.temperature if self._warm else None
        spare = None if warmth is None else _millidegrees(warmth)
        return Rows(0, cells.line, counts, fault, cells.time_us, spare), block.without_lines()

    def _counts(self, values: NDArray[np.float64]) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
        scaled = self._scale.counts(values)
        fault = np.zeros(len(values), np.uint8)
        limit = self._scale.limit
        if len(scaled) and not (scaled.max() <= limit and scaled.min() >= -limit):
            fault[(np.abs(scaled) > limit).any(axis=1)] = Fault.OUT_OF_RANGE
            fault[np.isnan(scaled).any(axis=1)] = Fault.MISSING
            scaled = np.where((fault == Fault.NONE)[:, None], scaled, 0.0)
        return scaled.astype(np.int32), fault

    def _refuse_fractions(self, values: NDArray[np.float64], line: NDArray[np.int64]) -> None:
        broken = (np.rint(values) != values) & np.isfinite(values)
        if not broken.any():
            return
        row, axis = np.argwhere(broken)[0]
        raise UnreadableError(
            f"{values[row, axis]:g} is not a whole number of counts",
            path=self._sheet.path,
            line=int(line[row]),
            hint="give the unit of the values with --unit g, mg or m/s2",
        )


def _millidegrees(temperature: NDArray[np.float64]) -> NDArray[np.int32]:
    """Every row's temperature [mC]: where a cell is empty, the last one that was measured, if any was."""
    usable = np.abs(temperature) < HOTTEST_C
    if not usable.all():
        last = np.maximum.accumulate(np.where(usable, np.arange(len(usable)), -1))
        temperature = np.where(last < 0, UNKNOWN_MC / 1000, temperature[last])
    millidegrees: NDArray[np.int32] = np.rint(temperature * 1000).astype(np.int32)
    return millidegrees
