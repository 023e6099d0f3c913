"""Rows of a column whose file holds them in parts: the row groups of Parquet, the batches of Arrow."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from accelcal_cli.formats._tables.table import BLOCK_ROWS, READ_ERRORS
from accelcal_cli.formats._tables.tracks import Track

ARROW_ERRORS = (pa.ArrowException, *READ_ERRORS)


@dataclass(frozen=True, slots=True)
class Portion:
    """Consecutive rows from `start` on, (n, width); None for rows that are lost, `rows` of them."""

    start: int
    rows: int
    values: NDArray[Any] | None


class PartRows:
    """Reads rows of a track in order, each part once; parts that cannot be read are lost, and no others.

    Args:
        first_rows: (parts + 1,) first rows of the parts, and the number of all rows.
        batches: gives the values of parts first..end-1 in portions (n, width) of any length. Raises as
            pyarrow does.
        offset: byte in the file at which a part begins.
        pool: takes portions ahead; None if one thread does all.
    """

    def __init__(
        self,
        track: Track,
        first_rows: NDArray[np.int64],
        batches: Callable[[int, int], Iterator[NDArray[Any]]],
        offset: Callable[[int], int | None],
        pool: Executor | None = None,
    ) -> None:
        self._track, self._first_rows, self._batches = track, first_rows, batches
        self._offset, self._pool = offset, pool
        self._portion = Portion(0, 0, None)
        self._portions: Iterator[Portion] = iter(())
        self._ahead: Future[Portion | None] | None = None
        self.kept_bytes = 0

    @property
    def path(self) -> str:
        """The track's path."""
        return self._track.path

    @property
    def row_bytes(self) -> int:
        """Bytes of one row."""
        return self._track.width * self._track.dtype.itemsize

    def chunk_offset(self, row: int) -> int | None:
        """Byte in the file of the part that holds a row; None if that is not known."""
        return self._offset(self._part(row))

    def _part(self, row: int) -> int:
        return int(np.searchsorted(self._first_rows, row, "right")) - 1

    def read(self, start: int, stop: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Rows start..stop-1, shape (stop - start, width), and which of them are not lost."""
        parts: list[NDArray[Any]] = []
        good = np.ones(stop - start, np.bool_)
        row = start
        while row < stop:
            portion = self._portion_with(row)
            end = min(stop, portion.start + portion.rows)
            if portion.values is None:
                parts.append(np.zeros((end - row, self._track.width), self._track.dtype))
                good[row - start : end - start] = False
            else:
                parts.append(portion.values[row - portion.start : end - portion.start])
            row = end
        return (parts[0] if len(parts) == 1 else np.concatenate(parts)), good

    def _portion_with(self, row: int) -> Portion:
        """The portion that holds a row; begins again at the row's part unless it comes soon."""
        here = self._portion
        end = here.start + here.rows
        if here.start <= row < end:
            return here
        part = self._part(row)
        if here.rows == 0 or row < here.start or self._first_rows[part] > end:
            self._begin(part)
        while not self._portion.start <= row < self._portion.start + self._portion.rows:
            self._portion = self._next()
        return self._portion

    def _begin(self, part: int) -> None:
        if self._ahead is not None:
            self._ahead.result()
        self._ahead, self._portions = None, self._all(part)
        self._portion = Portion(0, 0, None)

    def _next(self) -> Portion:
        """The next portion; the one after it is begun."""
        found = next(self._portions, None) if self._ahead is None else self._ahead.result()
        self._ahead = None if self._pool is None else self._pool.submit(next, self._portions, None)
        assert found is not None
        return found

    def _all(self, part: int) -> Iterator[Portion]:
        """Portions from the beginning of a part on: of small parts several at a time."""
        last = len(self._first_rows) - 1
        while part < last:
            most = int(self._first_rows[part]) + BLOCK_ROWS
            end = max(part + 1, int(np.searchsorted(self._first_rows, most, "right")) - 1)
            yield from self._run(part, min(end, last))
            part = min(end, last)

    def _run(self, part: int, end: int) -> Iterator[Portion]:
        """Portions of parts part..end-1; of several together all at once, or of each alone if one fails."""
        start, stop = int(self._first_rows[part]), int(self._first_rows[end])
        if end - part > 1:
            values = self._together(part, end)
            if values is not None and len(values) == stop - start:
                yield Portion(start, stop - start, values)
                return
            for one in range(part, end):
                yield from self._run(one, one + 1)
            return
        row = start
        try:
            for values in self._batches(part, end):
                rows = min(len(values), stop - row)
                if rows:
                    yield Portion(row, rows, values[:rows])
                row += rows
        except ARROW_ERRORS:
            pass
        yield from self._lost(row, stop)

    def _together(self, part: int, end: int) -> NDArray[Any] | None:
        try:
            return joined([*self._batches(part, end)])
        except ARROW_ERRORS:
            return None

    @staticmethod
    def _lost(start: int, stop: int) -> Iterator[Portion]:
        for row in range(start, stop, BLOCK_ROWS):
            yield Portion(row, min(BLOCK_ROWS, stop - row), None)


def joined(parts: Sequence[NDArray[Any]]) -> NDArray[Any] | None:
    """Arrays (n, width) one after the other; None of no arrays."""
    if len(parts) < 2:
        return parts[0] if parts else None
    return np.concatenate(parts)
