"""An open file as a table (`Table`), rows of its columns (`RowSource`), and those kept (`RowSelection`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.formats._problems import Event, Kind, ProblemLog
from accelcal_cli.formats._tables.attributes import Attributes, readable
from accelcal_cli.formats._tables.tracks import Track

BLOCK_ROWS = 65_536
REFUSE_ABOVE_BYTES = 128 << 20
"""Of what has to be unpacked whole, of all columns together; at moments it takes three times as much."""

READ_ERRORS = (
    OSError, RuntimeError, ValueError, TypeError, LookupError, ArithmeticError, AttributeError, MemoryError,
    SystemError,
)  # fmt: skip
"""What libraries that read files map their failures to: almost any of Python's own kinds."""

Offset = Callable[[int], int | None]


class RowSource(Protocol):
    """The rows of a track, read in order.

    Attributes:
        path: the track's.
        row_bytes: of one row.
        kept_bytes: of what has to be kept unpacked.
    """

    kept_bytes: int

    @property
    def path(self) -> str: ...

    @property
    def row_bytes(self) -> int: ...

    def read(self, start: int, stop: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Rows start..stop-1, shape (stop - start, width), and which of them are not lost."""

    def chunk_offset(self, row: int) -> int | None:
        """Byte in the file of the part that holds a row; None if that is not known."""


class Table:
    """An open file whose tracks are known.

    Attributes:
        word: what a track is called in messages.
    """

    path: Path
    word = "column"

    def missing_bytes(self) -> int:
        """How many bytes at the end of a file that was cut short are not there; -1 if that is not known."""
        return 0

    def own(self, path: str) -> Attributes:
        """What is stated of a track alone."""
        raise NotImplementedError

    def stated(self, path: str) -> Attributes:
        """What is stated of a track, then of all that is around it, up to the file."""
        raise NotImplementedError

    def rows(self, track: Track) -> RowSource:
        """The rows of a track; raises UnreadableError where they cannot be read in parts."""
        raise NotImplementedError

    def guard(self, what: str) -> AbstractContextManager[None]:
        """Turns what a library raises into an UnreadableError that names the part concerned."""
        return nullcontext()

    def explaining(self, damaged: int = 0) -> AbstractContextManager[None]:
        """Adds to any error of ours that the file is cut short or damaged, if it is."""
        return nullcontext()


def nowhere(_row: int) -> None:
    """The byte offset of a fault that lies in values, not in bytes."""


class RowSelection:
    """Which of the rows start..stop-1 of the datasets are kept, and what is wrong with others.

    Args:
        row_bytes: bytes of a row in all datasets together.
    """

    def __init__(self, start: int, stop: int, row_bytes: int) -> None:
        self.start = start
        self.stop = stop
        self.row_bytes = row_bytes
        self.keep = np.ones(stop - start, np.bool_)
        self._as_one: set[Kind] = set()
        self._faults: dict[tuple[Kind, Offset, int], list[NDArray[np.int64]]] = {}

    def read(self, source: RowSource) -> NDArray[Any]:
        """All rows of a column (n, width); lost ones are zero and left out."""
        values, good = source.read(self.start, self.stop)
        self.lose(source, ~good)
        return values

    def lose(self, source: RowSource, lost: NDArray[np.bool_]) -> None:
        """Drop rows that a column has lost."""
        if lost.any():
            kind = ("bad_page", f"rows lost in damaged or missing parts of {readable(source.path)}")
            self.leave_out(kind, lost, source.chunk_offset)

    def leave_out(self, kind: Kind, bad: NDArray[np.bool_], offset: Offset = nowhere) -> None:
        """Drop rows; those dropped before are not noted again."""
        bad = bad & self.keep
        self.note(kind, np.flatnonzero(bad), offset, self.row_bytes)
        self.keep &= ~bad

    def note(self, kind: Kind, rows: NDArray[np.int64], offset: Offset = nowhere, row_bytes: int = 0) -> None:
        """Note rows, given by their numbers within the selection, without dropping them."""
        if len(rows):
            self._faults.setdefault((kind, offset, row_bytes), []).append(rows)

    def note_as_one(self, kind: Kind, rows: NDArray[np.int64]) -> None:
        """Note rows, all of them in a single record, however many."""
        self._as_one.add(kind)
        self.note(kind, rows)

    def kept(self, values: Any) -> Any:
        """The kept ones of the rows of an array."""
        return values if self.keep.all() else values[self.keep]

    def rows(self) -> NDArray[np.int64]:
        """Numbers of the kept rows within the selection, (n,)."""
        return np.arange(len(self.keep)) if self.keep.all() else np.flatnonzero(self.keep)

    def events(self, log: ProblemLog, first_sample: int) -> Iterator[Event]:
        """What was noted, as the log takes it; `first_sample` is the number of the first kept row.

        Rows with one fault are a run wherever it lies, in the acceleration or in the gyroscope.
        """
        kept = self.rows() if self._faults else np.empty(0, np.int64)
        for (kind, offset, row_bytes), parts in self._faults.items():
            rows = np.sort(np.concatenate(parts))
            runs = [(0, len(rows), True)] if kind in self._as_one else log.runs(kind, rows)
            for index, count, scattered in runs:
                row = int(rows[index])
                start, sample = self.start + row, first_sample + int(np.searchsorted(kept, row))
                amounts = (count, 0, count * row_bytes)
                yield Event(start, count, *kind, offset(start), sample, *amounts, scattered=scattered)
