"""Rows of a text file as counts, times and faults, block after block."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.readers._csv.blocks import Block
from accelcal_cli.readers._csv.sheet import Sheet
from accelcal_cli.readers._csv.time import NO_TIME
from accelcal_cli.readers._csv.units import Scale

HOTTEST_C = 1000.0


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

    def then(self, other: Self) -> Rows:
        """These rows and the next ones of the same file."""
        return Rows(
            self.first_row,
            np.concatenate((self.line, other.line)),
            np.concatenate((self.counts, other.counts)),
            np.concatenate((self.fault, other.fault)),
            *(
                None if one is None or two is None else np.concatenate((one, two))
                for one, two in zip(self._spare, other._spare, strict=True)
            ),
        )

    @property
    def _spare(self) -> tuple[NDArray[Any] | None, ...]:
        """The columns that not every file has."""
        return self.time_us, self.temperature_mc, self.filled


class RowMaker:
    """Turns blocks into rows, in the order of the file.

    Args:
        temperature_c: the file's first one, for rows before it; None without a temperature.
    """

    def __init__(self, sheet: Sheet, scale: Scale, temperature_c: float | None) -> None:
        self._sheet = sheet
        self._scale = scale
        self._temperature_c = temperature_c
        self._next_row = 0

    def rows(self, block: Block) -> Rows:
        """The rows of the next block.

        Raises:
            UnreadableError: a line is no row of the file, or counts are not whole.
        """
        cells = self._sheet.cells(block)
        if self._scale.unit == "counts":
            self._refuse_fractions(cells.values, cells.line)
        counts, fault = self._counts(cells.values)
        if cells.time_us is not None:
            fault[cells.time_us == NO_TIME] = Fault.MISSING
        spare = None if self._temperature_c is None else self._held(cells.temperature)
        first, self._next_row = self._next_row, self._next_row + len(counts)
        return Rows(first, cells.line, counts, fault, cells.time_us, spare)

    def _counts(self, values: NDArray[np.float64]) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
        scaled = self._scale.counts(values)
        fault = np.zeros(len(values), np.uint8)
        limit = self._scale.limit
        if len(scaled) and not (scaled.max() <= limit and scaled.min() >= -limit):
            fault[(np.abs(scaled) > limit).any(axis=1)] = Fault.OUT_OF_RANGE
            fault[np.isnan(scaled).any(axis=1)] = Fault.MISSING
            scaled = np.where((fault == Fault.NONE)[:, None], scaled, 0.0)
        return scaled.astype(np.int32), fault

    def _held(self, temperature: NDArray[np.float64] | None) -> NDArray[np.int32] | None:
        """Every row's temperature [mC]: where a cell is empty, the last one that was measured."""
        if temperature is None or self._temperature_c is None:
            return None
        known = np.concatenate(([self._temperature_c], temperature))
        usable = np.abs(known) < HOTTEST_C
        last = np.maximum.accumulate(np.where(usable, np.arange(len(known)), 0))
        held = known[last]
        self._temperature_c = float(held[-1])
        millidegrees: NDArray[np.int32] = np.rint(held[1:] * 1000).astype(np.int32)
        return millidegrees

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
