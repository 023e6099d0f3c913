"""Cells of orientation and temperature, and the sums of what was measured in each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

Key = tuple[int, ...]
"""Of a cell: x, y, z and degree C; then whether its windows never changed, and the block of time."""

TEMPERATURE, CONSTANT, BLOCK = 3, 4, 5

Value = list[int]
"""Of a cell: windows, samples, sums of x, y, z, of temperature, and of x, y, z in the posture before."""


@dataclass(frozen=True, slots=True)
class Grid:
    """Where cells of orientation and temperature end.

    Attributes:
        lsb_per_g: counts in 1 g.
        cells_per_g: cells in 1 g on each axis.
        degrees: of temperature that a cell is wide [degrees C], a power of two; 0: all of them.
    """

    lsb_per_g: Fraction
    cells_per_g: int
    degrees: int

    def keys(self, samples: NDArray[Any], sums: NDArray[Any], heat: NDArray[Any]) -> NDArray[np.int64]:
        """Of means, the cells that they lie in, (m, 4).

        Args:
            samples: (m,) of each mean; sums: (m, 3) of counts; heat: (m,) of thousandths of a degree C; whole
                numbers, which may be objects if they are large.
        """
        keys = np.zeros((len(samples), TEMPERATURE + 1), np.int64)
        g = samples[:, np.newaxis] * self.lsb_per_g.numerator
        keys[:, :TEMPERATURE] = sums * (self.cells_per_g * self.lsb_per_g.denominator) // g
        if self.degrees:
            keys[:, TEMPERATURE] = heat // (samples * 1000 * self.degrees)
        return keys


class Cells(dict[Key, Value]):
    """Sums by cell; none is ever taken away."""

    def __init__(self, grid: Grid) -> None:
        super().__init__()
        self.grid = grid
        self._groups: set[Key] = set()
        self._grouped = 0

    def orientations(self) -> int:
        """How many groups of 2 x 2 x 2 cells hold windows; cells that were looked at before are not again."""
        self._groups.update(map(group_of, islice(self, self._grouped, None)))
        self._grouped = len(self)
        return len(self._groups)

    def with_blocks(self, number: Callable[[int], int]) -> Cells:
        """The same by other blocks of time, without those whose new number is below 0."""
        made = Cells(self.grid)
        for key, value in self.items():
            if (block := number(key[BLOCK])) >= 0:
                add_sums(made, (*key[:BLOCK], block), value)
        return made

    def with_degrees(self, degrees: int) -> Cells:
        """The same by cells that are as wide in temperature or wider; 0: all of it in one."""
        made = Cells(replace(self.grid, degrees=degrees))
        for key, value in self.items():
            degree = key[TEMPERATURE] * self.grid.degrees // degrees if degrees else 0
            add_sums(made, (*key[:TEMPERATURE], degree, *key[CONSTANT:]), value)
        return made


def add_sums(cells: dict[Key, Value], key: Key, value: Value) -> None:
    """Add a value to that of a cell."""
    total = cells.get(key)
    cells[key] = list(value) if total is None else [a + b for a, b in zip(total, value, strict=True)]


def group_of(key: Key) -> Key:
    """The 2 x 2 x 2 cells that a cell is one of."""
    return tuple(part >> 1 for part in key[:TEMPERATURE])
