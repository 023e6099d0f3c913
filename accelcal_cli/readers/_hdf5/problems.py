"""Rows left out while they stream by, and the problems they make.

Consecutive rows with the same fault are one problem, wherever the chunks begin and end. A kind
of problem is told a hundred times at most; what comes after is one more record, told at the end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.recording import Problem
from accelcal_cli.readers._hdf5.rows import TrackRows

MOST_RECORDS = 100

Offset = Callable[[int], int | None]


def nowhere(_row: int) -> None:
    """The byte offset of a fault that lies in values, not in bytes."""


@dataclass(frozen=True, slots=True)
class Kind:
    """A fault: its code, what is true of the rows, how often it is told one by one, bytes lost a row."""

    code: str
    what: str
    most: int = MOST_RECORDS
    row_bytes: int = 0


@dataclass(slots=True)
class Run:
    """`count` rows with one fault, from row `start` to just before row `end` of the dataset."""

    kind: Kind
    start: int
    end: int
    count: int
    sample: int
    offset: int | None

    @property
    def order(self) -> tuple[int, str, str]:
        """Where it stands among others."""
        return self.end, self.kind.code, self.kind.what

    def problem(self) -> Problem:
        """For the report."""
        text, lost = f"{self.count} {self.kind.what}", self.count * self.kind.row_bytes
        return Problem(self.kind.code, text, self.offset, self.sample, self.count, lost)


class ProblemLog:
    """Puts runs together across chunks and keeps their number bounded."""

    def __init__(self) -> None:
        self._open: dict[Kind, Run] = {}
        self._told: dict[Kind, int] = {}
        self._rest: dict[Kind, Run] = {}
        self._ready: list[Run] = []

    def add(self, run: Run) -> None:
        """Take a run, which may carry on from the rows before."""
        before = self._open.get(run.kind)
        if before is not None and before.end == run.start:
            before.count += run.count
            before.end = run.end
            return
        if before is not None:
            self._close(before)
        self._open[run.kind] = run

    def add_rest(self, run: Run) -> None:
        """Take rows of a kind that is told no more one by one."""
        before = self._rest.pop(run.kind, None)
        run.offset = None
        if before is not None:
            first = min(before, run, key=lambda part: part.start)
            run.count += before.count
            run.start, run.sample = first.start, first.sample
        self._rest[run.kind] = run

    def room(self, kind: Kind) -> int:
        """How many more runs of a kind will be told one by one, the open one among them."""
        return max(0, kind.most - self._told.get(kind, 0))

    def _close(self, run: Run) -> None:
        if not self.room(run.kind):
            self.add_rest(run)
            return
        self._told[run.kind] = self._told.get(run.kind, 0) + 1
        self._ready.append(run)

    def take(self, stop: int, last: bool) -> tuple[Problem, ...]:
        """The problems known to end before row `stop`; all of them after the last row."""
        for kind, run in list(self._open.items()):
            if run.end < stop or last:
                self._close(self._open.pop(kind))
        ready = sorted(self._ready, key=lambda run: run.order)
        self._ready = []
        if last:
            ready += sorted(self._rest.values(), key=lambda run: (run.kind.code, run.kind.what))
        return tuple(run.problem() for run in ready)


class Sieve:
    """Which of the rows start..stop-1 of the datasets are kept, and what is wrong with others.

    Args:
        row_bytes: bytes of a row in all datasets together.
    """

    def __init__(self, start: int, stop: int, row_bytes: int) -> None:
        self.start = start
        self.stop = stop
        self.row_bytes = row_bytes
        self.keep = np.ones(stop - start, np.bool_)
        self._found: list[tuple[Kind, NDArray[np.int64], Offset]] = []

    def read(self, source: TrackRows) -> NDArray[Any]:
        """All rows of a dataset (n, width); lost ones are zero and left out."""
        values, good = source.read(self.start, self.stop)
        if not good.all():
            kind = Kind("bad_page", f"rows lost in damaged or missing parts of {source.path}")
            self.leave_out(kind, ~good, source.chunk_offset)
        return values

    def leave_out(self, kind: Kind, bad: NDArray[np.bool_], offset: Offset = nowhere) -> None:
        """Drop rows; those dropped before are not told again."""
        bad = bad & self.keep
        self.note(replace(kind, row_bytes=self.row_bytes), np.flatnonzero(bad), offset)
        self.keep &= ~bad

    def note(self, kind: Kind, rows: NDArray[np.int64], offset: Offset = nowhere) -> None:
        """Tell of rows, given by their numbers within the sieve, without dropping them."""
        if len(rows):
            self._found.append((kind, rows, offset))

    def kept(self, values: Any) -> Any:
        """The kept ones of the rows of an array."""
        return values if self.keep.all() else values[self.keep]

    def rows(self) -> NDArray[np.int64]:
        """Numbers of the kept rows within the sieve, (n,)."""
        return np.arange(len(self.keep)) if self.keep.all() else np.flatnonzero(self.keep)

    def tell(self, log: ProblemLog, first_sample: int) -> None:
        """Hand what was found to the log; `first_sample` is the number of the first kept row."""
        kept = self.rows() if self._found else np.empty(0, np.int64)
        for kind, rows, offset in self._found:
            edges = np.flatnonzero(np.diff(rows) != 1) + 1
            begins = rows[np.concatenate(([0], edges))]
            counts = np.diff(np.concatenate(([0], edges, [len(rows)])))
            samples = first_sample + np.searchsorted(kept, begins)
            single = log.room(kind) + 1
            for begin, count, sample in zip(begins[:single], counts[:single], samples[:single], strict=True):
                start = self.start + int(begin)
                log.add(Run(kind, start, start + int(count), int(count), int(sample), offset(start)))
            if len(begins) > single:
                start, total = self.start + int(begins[single]), int(counts[single:].sum())
                log.add_rest(Run(kind, start, self.stop, total, int(samples[single]), None))
