"""The rows of a table as chunks, once it is known what to read: what all formats of named columns share."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import AbstractContextManager, closing
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core import recording
from accelcal_cli.core.clock import MICROSECONDS, Clock, StampClock, UniformClock, rate_fraction
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.local_time import FOLLOWED
from accelcal_cli.core.recording import Channels, Chunk, Problem, Reader
from accelcal_cli.formats._problems import ProblemLog, Run
from accelcal_cli.formats._stamps import GAP_PERIODS
from accelcal_cli.formats._tables.attributes import readable
from accelcal_cli.formats._tables.description import Plan
from accelcal_cli.formats._tables.table import REFUSE_ABOVE_BYTES, RowSelection, Table
from accelcal_cli.formats._tables.times import RowTimes

SINGLE = 100
"""Problems of a kind that are given one by one."""

PIECE_BYTES = 16 << 20
"""Of the columns' values at a time, however many samples are wanted: wide numbers take memory."""

AHEAD = ("clock_gap", "jumps forward of the times")
BACK = ("clock_back", "jumps back of the times")


class TableReader(Reader):
    """Streams the rows of a plan. The file is open only while a stream runs."""

    repack = "write it again in smaller parts"

    def __init__(self, plan: Plan) -> None:
        self.recording = plan.recording
        self._plan = plan

    def table(self) -> AbstractContextManager[Table]:
        """The file, opened again; raises UnreadableError where it cannot be."""
        raise NotImplementedError

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """Yield all rows in order, from `chunk_samples` rows of the table at a time.

        Raises:
            UnreadableError: no row at all is usable, or the columns cannot be reached.
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
        with self.table() as table, table.explaining():
            raise UnreadableError(
                f"none of the {plan.rows} rows of {readable(plan.accel.tracks[0].path)} is usable",
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

    def _zone_of_stamps(self) -> str | None:
        return self.recording.timezone if self.recording.stamped else None

    def _pieces(self, start: int, stop: int, chunk_samples: int) -> Generator[Chunk, None, None]:
        with self.table() as table:
            with table.explaining(), table.guard(f"{table.word}s"):
                stream = _Stream(table, self._plan, start, self._zone_of_stamps())
                self._refuse_unbounded(stream.kept_bytes, table.word)
            step = max(1, min(chunk_samples, PIECE_BYTES // stream.row_bytes))
            for row in range(start, stop, step):
                yield stream.piece(row, min(row + step, stop), last=row + step >= stop)

    def _refuse_unbounded(self, kept: int, word: str) -> None:
        """Raise UnreadableError for parts that would take too much memory together."""
        if kept > REFUSE_ABOVE_BYTES:
            raise UnreadableError(
                f"its {word}s are packed in parts of {kept >> 20} MB together, too large to unpack at once",
                path=self.recording.path,
                hint=self.repack,
            )


def _message(run: Run) -> str:
    return run.event.text if run.event.code == FOLLOWED else f"{run.count} {run.event.text}"


class _Stream:
    """One run through the rows: what is carried from one chunk to the next."""

    def __init__(self, table: Table, plan: Plan, start: int, zone: str | None) -> None:
        self._plan = plan
        self._rate = rate_fraction(plan.recording.rate_hz)
        self._accel = [*map(table.rows, plan.accel.tracks)]
        self._channels = {name: [*map(table.rows, channel.tracks)] for name, channel in plan.channels.items()}
        self._before: Channels = {}
        stamps = [table.rows(plan.stamps.track)] if plan.stamps else []
        self._times = RowTimes(stamps[0], plan.stamps, start, zone) if plan.stamps else None
        problems = plan.problems if start == 0 else ()
        self._log = ProblemLog(problems, _message, SINGLE, by_end=True)
        self._sample = start
        self._last_row: int | None = None
        self._last_time = 0
        sources = chain(self._accel, *self._channels.values(), stamps)
        read = [*sources]
        self.row_bytes = sum(source.row_bytes for source in read)
        self.kept_bytes = sum(source.kept_bytes for source in read)

    def piece(self, start: int, stop: int, last: bool) -> Chunk:
        """The usable ones among rows start..stop-1 of the table."""
        selection = RowSelection(start, stop, self.row_bytes)
        counts = self._plan.accel.values(self._accel, selection)
        channels = self._channel_values(selection)
        times = None if self._times is None else self._times.next(selection)
        rows = selection.rows()
        clock = self._clock(times, rows, selection)
        breaks, clock_jumps = self._breaks(times, rows, selection)
        for event in selection.events(self._log, self._sample):
            self._log.add(event)
        chunk = Chunk(
            first_sample=self._sample,
            counts=selection.kept(counts),
            clock=clock,
            end_byte=self._plan.recording.total_bytes * stop // self._plan.rows,
            breaks=breaks,
            clock_jumps=clock_jumps,
            problems=self._log.take(None if last else stop) + self._end(last, len(rows)),
            used_bytes=len(rows) * self.row_bytes,
            **{name: selection.kept(values) for name, values in channels.items()},
        )
        self._sample += len(rows)
        return chunk

    def _end(self, last: bool, rows: int) -> tuple[Problem, ...]:
        """With the last rows: that the file was cut short."""
        missing, total = self._plan.missing_bytes, self._plan.recording.total_bytes
        if not missing or not last:
            return ()
        end = f"last {missing} bytes are" if missing > 0 else "end is"
        what = f"the file is cut short: its {end} missing"
        return (Problem("truncated", what, total, self._sample + rows, max(1, missing)),)

    def _channel_values(self, selection: RowSelection) -> Channels:
        """All rows of each channel."""
        channels: Channels = {
            name: channel.values(self._channels[name], selection, self._before.get(name))
            for name, channel in self._plan.channels.items()
        }
        self._before = recording.cut_channels(channels, [-1])
        return channels

    def _clock(
        self, times: NDArray[np.int64] | None, rows: NDArray[np.int64], selection: RowSelection
    ) -> Clock:
        """The times of the kept rows: their own, or by their place in the table."""
        if times is not None:
            return StampClock(selection.kept(times))
        even = UniformClock(self._plan.recording.start_us or 0, selection.start, self._rate)
        if len(rows) == len(selection.keep):
            return even
        return StampClock(selection.kept(even.times(0, len(selection.keep))))

    def _breaks(
        self, times: NDArray[np.int64] | None, rows: NDArray[np.int64], selection: RowSelection
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Where the kept rows do not follow on the ones before them, in place or time; where only in time."""
        if not len(rows):
            return recording.NO_BREAKS, recording.NO_BREAKS
        before = self._last_row
        every = len(rows) == len(selection.keep)
        jumps = np.zeros(len(rows), np.bool_) if every else np.diff(rows, prepend=rows[0]) != 1
        jumps[0] = before is not None and int(rows[0]) + selection.start != before + 1
        in_time = np.zeros(len(rows), np.bool_)
        if times is not None:
            in_time = self._time_jumps(times[rows], rows, jumps, selection)
        self._last_row = int(rows[-1]) + selection.start
        return np.flatnonzero(jumps | in_time), np.flatnonzero(in_time & ~jumps)

    def _time_jumps(
        self,
        times: NDArray[np.int64],
        rows: NDArray[np.int64],
        explained: NDArray[np.bool_],
        selection: RowSelection,
    ) -> NDArray[np.bool_]:
        """Where the times jump; a problem unless lost rows explain it."""
        longest = GAP_PERIODS * MICROSECONDS / self._plan.recording.rate_hz
        steps = np.diff(times, prepend=times[0] if self._last_row is None else self._last_time)
        self._last_time = int(times[-1])
        selection.note(AHEAD, rows[(steps > longest) & ~explained])
        selection.note(BACK, rows[steps < 0])
        return (steps > longest) | (steps < 0)
