"""Slots: memory for the rows of one row group and for its columns encoded, which helpers share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.helpers import shared_memory
from accelcal_cli.core.thrift import Struct
from accelcal_cli.output.column_chunks import ColumnChunk
from accelcal_cli.output.columns import Column

Memory = list[tuple[Column, NDArray[Any]]]
"""Where rows go, column by column."""

Placed = tuple[str, Struct, slice | bytes]
"""An encoded column: its name, what the footer says of it, and where it lies in the slot, or itself."""


class Slot:
    """Memory for so many rows of some columns, and as much again for what becomes of them."""

    def __init__(self, number: int, columns: Sequence[Column], rows: int, *, shared: bool) -> None:
        """Set addresses aside; what is not used of them takes no memory.

        Args:
            number: by which a helper is told this slot.
            shared: whether helpers put encoded columns here.

        Raises:
            MemoryError: there is not enough memory.
        """
        self.number = number
        bytes_of = [rows * np.dtype(column.dtype).itemsize for column in columns]
        held = shared_memory(sum(bytes_of) * (2 if shared else 1))
        starts = np.cumsum([0, *bytes_of]).tolist()
        self._columns = [
            (column, np.frombuffer(held, column.dtype, rows, start))
            for column, start in zip(columns, starts[:-1], strict=True)
        ]
        self._room = memoryview(held)[starts[-1] :]

    def memory(self, start: int, stop: int) -> Memory:
        """For rows start..stop-1."""
        return [(column, held[start:stop]) for column, held in self._columns]

    def stored(self, rows: int) -> dict[str, NDArray[Any]]:
        """The first rows, by the columns' names."""
        return {column.name: held[:rows] for column, held in self._columns}

    def put(self, chunks: Mapping[str, ColumnChunk]) -> list[Placed]:
        """Put encoded columns here, as far as there is room for them."""
        placed: list[Placed] = []
        start = 0
        for name, chunk in chunks.items():
            stop = start + sum(map(len, chunk.parts))
            if stop > len(self._room):
                placed.append((name, chunk.meta, b"".join(chunk.parts)))
                continue
            placed.append((name, chunk.meta, slice(start, stop)))
            for part in chunk.parts:
                self._room[start : start + len(part)] = memoryview(part).cast("B")
                start += len(part)
        return placed

    def chunks(self, placed: Sequence[Placed]) -> dict[str, ColumnChunk]:
        """The encoded columns, where they lie; they are to be used before others are put here."""
        return {
            name: ColumnChunk([at if isinstance(at, bytes) else self._room[at]], meta)
            for name, meta, at in placed
        }
