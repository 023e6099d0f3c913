"""Equal problems of neighbouring rows as one record, and never too many records."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.recording import Problem

LIMIT = 50
"""Records of one code in one file; what comes after is counted in one more."""

Describe = Callable[[int, int, float], str]


@dataclass(slots=True)
class Run:
    """Neighbouring rows with one problem: how many, the first one's line, a size, the sample after."""

    count: int
    line: int
    size: float
    sample: int
    single: bool


@dataclass(frozen=True, slots=True)
class Marks:
    """Which rows of a stretch have a problem; all arrays have shape (n,).

    row: number within the file. line: in the text. sample: number of the next good sample.
    size: how bad it is, for the message.
    """

    flag: NDArray[np.bool_]
    row: NDArray[np.int64]
    line: NDArray[np.int64]
    sample: NDArray[np.int64]
    size: NDArray[np.float64] | None = None


class RunLog:
    """Collects the rows with one problem over all blocks. Its records do not depend on the blocks.

    Args:
        row_bytes: bytes that are lost with each row.
    """

    def __init__(self, code: str, describe: Describe, row_bytes: int = 0) -> None:
        self._code = code
        self._row_bytes = row_bytes
        self._describe = describe
        self._seen = 0
        self._open: Run | None = None
        self._rest = Run(0, 0, 0.0, 0, False)

    def concerned(self, flag: NDArray[np.bool_]) -> bool:
        """Whether rows with these flags change anything."""
        return self._open is not None or bool(flag.any())

    def add(self, marks: Marks) -> list[tuple[int, Problem]]:
        """Take the next rows; gives the runs that ended, each with the row that ended it."""
        if not self.concerned(marks.flag):
            return []
        done = []
        edges = np.flatnonzero(np.diff(marks.flag.astype(np.int8), prepend=np.int8(self._open is not None)))
        for begin, end in zip([0, *edges.tolist()], [*edges.tolist(), len(marks.flag)], strict=True):
            if begin == end:
                continue
            if marks.flag[begin]:
                self._extend(marks, begin, end)
            elif self._open is not None:
                done += self._close(int(marks.row[begin]))
            if self._seen > LIMIT and self._open is not None and end < len(marks.flag):
                return done + self._count_on(marks, end)
        return done

    def finish(self) -> list[Problem]:
        """What is left at the end of the file."""
        done = [problem for _, problem in self._close(0)] if self._open else []
        if self._rest.count:
            text = f"and more of the same: {self._describe(self._rest.count, self._rest.line, 0.0)}"
            done.append(self._problem(text, self._rest))
        return done

    def _extend(self, marks: Marks, begin: int, end: int) -> None:
        if self._open is None:
            self._seen += 1
            size = 0.0 if marks.size is None else float(marks.size[begin])
            self._open = Run(0, int(marks.line[begin]), size, int(marks.sample[begin]), self._seen <= LIMIT)
        self._open.count += end - begin

    def _close(self, row: int) -> list[tuple[int, Problem]]:
        run, self._open = self._open, None
        if run is None:
            return []
        if run.single:
            text = self._describe(run.count, run.line, run.size)
            return [(row, self._problem(text, run))]
        self._add_rest(run.count, run.line, run.sample)
        return []

    def _problem(self, text: str, run: Run) -> Problem:
        return Problem(self._code, text, None, run.sample, run.count, run.count * self._row_bytes)

    def _count_on(self, marks: Marks, begin: int) -> list[tuple[int, Problem]]:
        """Only count the rows from `begin` on, which ends a run; the last may stay open."""
        done = self._close(int(marks.row[begin]))
        flag = marks.flag[begin:]
        self._add_rest(int(flag.sum()), 0, 0)
        if flag[-1]:
            self._open = Run(0, 0, 0.0, 0, False)
        return done

    def _add_rest(self, count: int, line: int, sample: int) -> None:
        if self._rest.count == 0:
            self._rest.line, self._rest.sample = line, sample
        self._rest.count += count
