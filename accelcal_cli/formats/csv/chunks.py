"""Equal problems of neighbouring rows as one record, and never too many records.

The last step from rows to chunks: bad rows left out, breaks and problems found.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, Clock, StampClock, UniformClock, rate_fraction
from accelcal_cli.core.recording import Chunk, Problem, Validity
from accelcal_cli.formats.csv.rows import Fault, Rows
from accelcal_cli.formats.csv.times import GAP_PERIODS, Pace

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


def _rows(count: int) -> str:
    return "1 row" if count == 1 else f"{count} rows"


def _missing(count: int, line: int, _: float) -> str:
    return f"{_rows(count)} from line {line} on left out: a value is missing"


def _out_of_range(count: int, line: int, _: float) -> str:
    return f"{_rows(count)} from line {line} on left out: a value is beyond any sensor's range"


def _asleep(count: int, line: int, _: float) -> str:
    return f"{_rows(count)} from line {line} on not measured: the device slept, and repeated a value"


def _ahead(count: int, line: int, size: float) -> str:
    jump = f" by {size / MICROSECONDS:g} s" if size else ""
    return f"the time jumps ahead{jump} before line {line}" + _times(count)


def _back(count: int, line: int, size: float) -> str:
    jump = f" by {-size / MICROSECONDS:g} s" if size else ""
    return f"the time goes back{jump} before line {line}" + _times(count)


def _times(count: int) -> str:
    return f", and so on for {count} rows" if count > 1 else ""


@dataclass(frozen=True, slots=True)
class _Kept:
    """The good rows of a stretch: their numbers, lines and times (times None for a uniform clock)."""

    keep: NDArray[np.bool_] | None
    row: NDArray[np.int64]
    line: NDArray[np.int64]
    time_us: NDArray[np.int64] | None

    def of(self, values: NDArray[Any] | None) -> NDArray[Any] | None:
        """The entries of these rows in a column of the stretch."""
        return values if values is None or self.keep is None else values[self.keep]


class Assembler:
    """Makes chunks of all rows of a file, in order.

    Args:
        pace: how the rows follow each other.
        stamped: rows carry times; else they are counted at the pace.
        start_us: time of the first row where they are counted.
        row_bytes: about how long a line is.
    """

    def __init__(self, pace: Pace, stamped: bool, start_us: int, row_bytes: int) -> None:
        self._row_bytes = row_bytes
        self._stamped = stamped
        self._start_us = start_us
        self._pace = pace
        self._rate = rate_fraction(pace.rate_hz)
        self._faults = {
            Fault.MISSING: RunLog("missing_value", _missing, row_bytes),
            Fault.OUT_OF_RANGE: RunLog("out_of_range", _out_of_range, row_bytes),
        }
        self._asleep = RunLog("idle_sleep", _asleep)
        self._clocks = (RunLog("clock_gap", _ahead), RunLog("clock_back", _back))
        self._last_row = -1
        self._last_us = 0
        self.samples = 0
        self.rows = 0

    def chunks(self, rows: Rows, end_byte: int, chunk_samples: int) -> Iterator[Chunk]:
        """The good ones of the next rows, at most `chunk_samples` to a chunk."""
        found = self._fault_problems(rows)
        kept = self._kept(rows)
        counts, spare, validity = rows.counts, kept.of(rows.temperature_mc), kept.of(_validity(rows))
        if kept.keep is not None:
            counts = counts[kept.keep]
        breaks, jumps = self._breaks(kept)
        problems = tuple(problem for _, problem in sorted((*found, *jumps), key=_by_row))
        pieces = max(1, -(-len(counts) // chunk_samples))
        borders = [len(counts) * piece // pieces for piece in range(pieces + 1)]
        for start, stop in pairwise(borders):
            part = slice(start, stop)
            yield Chunk(
                self.samples,
                counts[part],
                self._clock(kept, start, stop),
                end_byte,
                breaks=breaks[(breaks >= start) & (breaks < stop)] - start,
                temperature_mc=None if spare is None else spare[part],
                validity=None if validity is None else validity[part],
                problems=problems if start == 0 else (),
                used_bytes=(stop - start) * self._row_bytes,
            )
            self.samples += stop - start
        self.rows += len(rows)

    def finish(self) -> list[Problem]:
        """Problems that were still open at the end of the file."""
        logs = (*self._faults.values(), self._asleep, *self._clocks)
        return [problem for log in logs for problem in log.finish()]

    def _fault_problems(self, rows: Rows) -> list[tuple[int, Problem]]:
        flags = [(log, rows.fault == fault) for fault, log in self._faults.items()]
        if rows.filled is not None:
            flags.append((self._asleep, rows.filled))
        if not any(log.concerned(flag) for log, flag in flags):
            return []
        good, row = rows.fault == Fault.NONE, rows.row
        sample = self.samples + np.cumsum(good) - good
        return [item for log, flag in flags for item in log.add(Marks(flag, row, rows.line, sample))]

    def _kept(self, rows: Rows) -> _Kept:
        if not rows.fault.any():
            return _Kept(None, rows.row, rows.line, rows.time_us)
        keep = rows.fault == Fault.NONE
        stamps = rows.time_us
        if stamps is None:
            stamps = UniformClock(self._start_us, rows.first_row, self._rate).times(0, len(rows))
        return _Kept(keep, rows.row[keep], rows.line[keep], stamps[keep])

    def _clock(self, kept: _Kept, start: int, stop: int) -> Clock:
        if kept.time_us is not None:
            return StampClock(kept.time_us[start:stop])
        first = int(kept.row[start]) if len(kept.row) else 0
        return UniformClock(self._start_us, first, self._rate)

    def _breaks(self, kept: _Kept) -> tuple[NDArray[np.int64], list[tuple[int, Problem]]]:
        """Rows before which the recording is not continuous, and the jumps of the clock."""
        if not len(kept.row):
            return np.empty(0, np.int64), []
        first = self._last_row < 0
        rows = self._strides(kept)
        broken = rows > 1
        self._last_row = int(kept.row[-1])
        if kept.time_us is None or not self._stamped:
            return np.flatnonzero(broken), []
        steps = np.diff(kept.time_us, prepend=kept.time_us[0] if first else self._last_us)
        self._last_us = int(kept.time_us[-1])
        ahead = steps > (rows + GAP_PERIODS - 1) * self._pace.period_us
        jumps = self._jumps(kept, steps, (ahead, steps < 0))
        return np.flatnonzero(broken | ahead | (steps < 0)), jumps

    def _strides(self, kept: _Kept) -> NDArray[np.int64]:
        """How many rows of the file each is after the good one before: (n,), or (1,) where all are alike."""
        before = int(kept.row[0]) - 1 if self._last_row < 0 else self._last_row
        if kept.keep is None and kept.row[0] == before + 1:
            return np.ones(1, np.int64)
        return np.diff(kept.row, prepend=before)

    def _jumps(
        self, kept: _Kept, steps: NDArray[np.int64], flags: tuple[NDArray[np.bool_], NDArray[np.bool_]]
    ) -> list[tuple[int, Problem]]:
        if not any(log.concerned(flag) for flag, log in zip(flags, self._clocks, strict=True)):
            return []
        sample = self.samples + np.arange(len(kept.row), dtype=np.int64)
        size = steps.astype(np.float64)
        found: list[tuple[int, Problem]] = []
        for flag, log in zip(flags, self._clocks, strict=True):
            found += log.add(Marks(flag, kept.row, kept.line, sample, size))
        return found


def _validity(rows: Rows) -> NDArray[np.uint8] | None:
    """Of every row; None where all were measured."""
    if rows.filled is None or not rows.filled.any():
        return None
    return np.where(rows.filled, np.uint8(Validity.FILLED), np.uint8(Validity.MEASURED))


def _by_row(item: tuple[int, Problem]) -> tuple[int, str]:
    return item[0], item[1].code
