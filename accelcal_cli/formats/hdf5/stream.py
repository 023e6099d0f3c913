"""Rows left out while they stream by, and the problems they make.

Consecutive rows with the same fault are one problem, wherever the chunks begin and end. A kind
of problem is told a hundred times at most; what comes after is one more record, told at the end.

The stream of samples from an HDF5 file whose datasets are known.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import Clock, StampClock, UniformClock, rate_fraction
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.recording import NO_BREAKS, Chunk, Counts, Problem, Reader, Recording
from accelcal_cli.formats.hdf5.datasets import Track
from accelcal_cli.formats.hdf5.file import explaining, h5py_guard, open_hdf5
from accelcal_cli.formats.hdf5.rows import TrackRows, unpackers
from accelcal_cli.formats.hdf5.units import Scale, StampScale, millicelsius

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


GAP_PERIODS = 3
PIECE_BYTES = 16 << 20
"""Of the datasets' values at a time, however many samples are wanted: wide numbers take memory."""

FAULTS = {
    kind.code: kind
    for kind in (
        Kind("missing_value", "rows without a value (NaN) left out"),
        Kind("bad_row", "rows whose counts are not whole numbers left out"),
        Kind("out_of_range", "rows with values beyond anything the sensor can measure left out"),
    )
}
NO_TIME = Kind("missing_value", "rows without a believable time left out")
NO_TEMPERATURE = Kind("missing_value", "rows without a temperature; the last one before them holds", most=0)
AHEAD = Kind("clock_gap", "jumps forward of the times")
BACK = Kind("clock_back", "jumps back of the times")


@dataclass(frozen=True, slots=True)
class Axes:
    """Where x, y and z are: one track of three columns or three of one, and their scale."""

    tracks: tuple[Track, ...]
    scale: Scale

    @property
    def dps_per_lsb(self) -> tuple[float, float, float]:
        """Of a gyroscope: deg/s in one count of each axis."""
        step = 1 / self.scale.lsb
        return step, step, step


@dataclass(frozen=True, slots=True)
class Stamps:
    """A dataset of times. `coarse_us`: how far apart stamps are where several rows share one."""

    track: Track
    scale: StampScale
    coarse_us: int = 0


@dataclass(frozen=True, slots=True)
class Temperature:
    """A dataset of temperatures, `factor` of its units in one degree; `first_mc` is its first value."""

    track: Track
    factor: float
    first_mc: int


@dataclass(frozen=True, slots=True)
class Plan:
    """What to read and how, found out when the recording was opened.

    `problems` are told with the first rows, `missing_bytes` of a file cut short with the last.
    """

    recording: Recording
    rows: int
    accel: Axes
    stamps: Stamps | None = None
    gyro: Axes | None = None
    temperature: Temperature | None = None
    problems: tuple[Problem, ...] = ()
    missing_bytes: int = 0


@dataclass(frozen=True, slots=True)
class Tracks:
    """An open file, and the pool that unpacks its chunks ahead, if there is one."""

    file: Any
    path: Path
    pool: Executor | None

    def opened(self, *tracks: Track) -> list[TrackRows]:
        """Each one's rows, to be read in order."""
        return [TrackRows(self.file, track, self.path, self.pool) for track in tracks]


class Hdf5Reader(Reader):
    """Streams the rows of a plan. The file is open only while a stream runs."""

    def __init__(self, plan: Plan) -> None:
        self.recording = plan.recording
        self._plan = plan

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """Yield all rows in order, from `chunk_samples` rows of the datasets at a time.

        Raises:
            UnreadableError: no row at all is usable, or the datasets cannot be reached.
        """
        delivered = 0
        with closing(self._pieces(0, self._plan.rows, chunk_samples)) as pieces:
            for chunk in pieces:
                delivered += len(chunk)
                yield chunk
        if not delivered:
            self._refuse()

    def _refuse(self) -> None:
        plan, path = self._plan, self.recording.path
        with explaining(path, plan.missing_bytes):
            raise UnreadableError(
                f"none of the {plan.rows} rows of {plan.accel.tracks[0].path} is usable",
                path=path,
                hint="copy the file again from its source",
            )

    def preview(self, chunk_samples: int, pieces: int) -> Iterator[Chunk]:
        """Yield up to `pieces` chunks spread evenly over the file."""
        rows = self._plan.rows
        if rows <= pieces * chunk_samples:
            yield from self.chunks(chunk_samples)
            return
        for piece in range(pieces):
            start = piece * rows // pieces
            yield from self._pieces(start, start + chunk_samples, chunk_samples)

    def _pieces(self, start: int, stop: int, chunk_samples: int) -> Generator[Chunk, None, None]:
        path = self.recording.path
        with open_hdf5(path) as file, unpackers(self.threads) as pool:
            with explaining(path, self._plan.missing_bytes), h5py_guard(path, "datasets"):
                stream = _Stream(Tracks(file, path, pool), self._plan, start)
            step = max(1, min(chunk_samples, PIECE_BYTES // stream.row_bytes))
            for row in range(start, stop, step):
                yield stream.piece(row, min(row + step, stop), last=row + step >= stop)


class _Stream:
    """One run through the rows: what is carried from one chunk to the next."""

    def __init__(self, tracks: Tracks, plan: Plan, start: int) -> None:
        self._plan = plan
        self._rate = rate_fraction(plan.recording.rate_hz)
        self._accel = tracks.opened(*plan.accel.tracks)
        self._gyro = tracks.opened(*plan.gyro.tracks) if plan.gyro else []
        self._stamps = tracks.opened(plan.stamps.track) if plan.stamps else []
        self._warm = tracks.opened(plan.temperature.track) if plan.temperature else []
        self._temperature_mc = plan.temperature.first_mc if plan.temperature else 0
        self._log = ProblemLog()
        self._sample = start
        self._last_row: int | None = None
        self._last_time = 0
        self._first = plan.problems if start == 0 else ()
        read = (*self._accel, *self._gyro, *self._stamps, *self._warm)
        self.row_bytes = sum(source.row_bytes for source in read)

    def piece(self, start: int, stop: int, last: bool) -> Chunk:
        """The usable ones among rows start..stop-1 of the datasets."""
        sieve = Sieve(start, stop, self.row_bytes)
        counts = _counts(self._accel, self._plan.accel.scale, sieve)
        gyro = _counts(self._gyro, self._plan.gyro.scale, sieve) if self._plan.gyro else None
        times = self._times(sieve)
        temperature = self._temperatures(sieve)
        rows = sieve.rows()
        clock = self._clock(times, rows, sieve)
        breaks = self._breaks(times, rows, sieve)
        sieve.tell(self._log, self._sample)
        chunk = Chunk(
            first_sample=self._sample,
            counts=sieve.kept(counts),
            clock=clock,
            end_byte=self._plan.recording.total_bytes * stop // self._plan.rows,
            breaks=breaks,
            temperature_mc=None if temperature is None else sieve.kept(temperature),
            gyro_counts=None if gyro is None else sieve.kept(gyro),
            problems=self._first + self._log.take(stop, last) + self._end(last, len(rows)),
            used_bytes=len(rows) * self.row_bytes,
        )
        self._first = ()
        self._sample += len(rows)
        return chunk

    def _end(self, last: bool, rows: int) -> tuple[Problem, ...]:
        """With the last rows: that the file was cut short."""
        missing, total = self._plan.missing_bytes, self._plan.recording.total_bytes
        if not missing or not last:
            return ()
        what = f"the file is cut short: its last {missing} bytes are missing"
        return (Problem("truncated", what, total, self._sample + rows, missing),)

    def _times(self, sieve: Sieve) -> NDArray[np.int64] | None:
        if self._plan.stamps is None:
            return None
        times, believable = self._plan.stamps.scale.times(sieve.read(self._stamps[0])[:, 0])
        sieve.leave_out(NO_TIME, ~believable)
        return times

    def _temperatures(self, sieve: Sieve) -> NDArray[np.int32] | None:
        """Temperatures of all rows; where one is missing, the last one before it holds."""
        if self._plan.temperature is None:
            return None
        values, good = self._warm[0].read(sieve.start, sieve.stop)
        degrees = millicelsius(values, good, self._plan.temperature.factor)
        missing = np.isnan(degrees)
        if missing.any():
            sieve.note(NO_TEMPERATURE, np.flatnonzero(missing))
            latest = np.maximum.accumulate(np.where(missing, -1, np.arange(len(missing))))
            degrees = np.where(latest < 0, self._temperature_mc, degrees[latest])
        self._temperature_mc = int(degrees[-1])
        return degrees.astype(np.int32)

    def _clock(self, times: NDArray[np.int64] | None, rows: NDArray[np.int64], sieve: Sieve) -> Clock:
        """The times of the kept rows: their own, or by their place in the dataset."""
        if times is not None:
            return StampClock(sieve.kept(times))
        even = UniformClock(self._plan.recording.start_us or 0, sieve.start, self._rate)
        if len(rows) == len(sieve.keep):
            return even
        return StampClock(sieve.kept(even.times(0, len(sieve.keep))))

    def _breaks(
        self, times: NDArray[np.int64] | None, rows: NDArray[np.int64], sieve: Sieve
    ) -> NDArray[np.int64]:
        """Where the kept rows do not follow on the ones before them, in place or in time."""
        if not len(rows):
            return NO_BREAKS
        before = self._last_row
        every = len(rows) == len(sieve.keep)
        jumps = np.zeros(len(rows), np.bool_) if every else np.diff(rows, prepend=rows[0]) != 1
        jumps[0] = before is not None and int(rows[0]) + sieve.start != before + 1
        if times is not None:
            jumps |= self._time_jumps(times[rows], rows, jumps, sieve)
        self._last_row = int(rows[-1]) + sieve.start
        return np.flatnonzero(jumps)

    def _time_jumps(
        self,
        times: NDArray[np.int64],
        rows: NDArray[np.int64],
        explained: NDArray[np.bool_],
        sieve: Sieve,
    ) -> NDArray[np.bool_]:
        """Where the times jump; told as a problem unless lost rows explain it."""
        coarse = self._plan.stamps.coarse_us if self._plan.stamps else 0
        longest = GAP_PERIODS * 1_000_000 / self._plan.recording.rate_hz + coarse
        steps = np.diff(times, prepend=times[0] if self._last_row is None else self._last_time)
        self._last_time = int(times[-1])
        sieve.note(AHEAD, rows[(steps > longest) & ~explained])
        sieve.note(BACK, rows[steps < 0])
        return (steps > longest) | (steps < 0)


def _counts(sources: list[TrackRows], scale: Scale, sieve: Sieve) -> Counts:
    """Counts (n, 3) of all rows of the sieve; those that have none are left out of it."""
    parts = [sieve.read(source) for source in sources]
    counts, faults = scale.counts(parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1))
    for code, bad in faults.items():
        sieve.leave_out(FAULTS[code], bad)
    return counts
