"""From records to rows in the order of time: seconds that follow each other, gaps, idle sleep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.recording import Validity
from accelcal_cli.readers._gt3x.events import (
    AHEAD,
    BACK,
    LENGTH,
    REPEATED,
    RESTLESS,
    Kind,
    damage_event,
)
from accelcal_cli.readers._gt3x.framing import Batch, Damage
from accelcal_cli.readers._gt3x.idle import Asleep, IdleWatch
from accelcal_cli.readers._gt3x.page import Span
from accelcal_cli.readers._gt3x.pieces import Piece
from accelcal_cli.readers._gt3x.sensor import Samples, Sensor
from accelcal_cli.readers._gt3x.work import Mark, SleepEvent, Work, marks, prepared
from accelcal_cli.readers._pages.problems import Event

FILL_S = 3600
"""Filled rows come in pieces of at most so many seconds."""

FOREVER_S = 1 << 40


@dataclass(frozen=True, slots=True, eq=False)
class _Last:
    """The record of samples before: its second, bytes and last sample."""

    second: int
    data: bytes
    sample: NDArray[np.int16]


@dataclass(frozen=True, slots=True)
class _Where:
    """A record's number among all of the file, and where in log.bin it begins."""

    position: int
    start_byte: int


class Timeline:
    """Takes batches in file order and makes rows and events of them.

    Attributes:
        position: how many records, sound or not, have been seen.
        rows: how many rows have been given.
    """

    def __init__(self, sensor: Sensor, span: Span) -> None:
        self.position = 0
        self._sensor = sensor
        self._idle = IdleWatch(span)
        self._slept: tuple[Asleep, _Where] | None = None
        self._last: _Last | None = None
        self._next_s = 0
        self._apart = False
        self._explained = False
        self.rows = 0
        self._pieces: list[Piece] = []
        self._events: list[Event] = []

    def feed(self, batch: Batch) -> tuple[list[Piece], Samples, list[Event]]:
        """Rows of a batch, the samples that they name, and what is wrong.

        Sleep is given when it is known what follows it.
        """
        self._pieces, self._events = [], []
        work, begin = prepared(batch, self._sensor), 0
        for number, mark in marks(batch):
            self._pass(work, begin, number)
            begin = number
            self._meet(mark)
        self._pass(work, begin, len(batch.records))
        if batch.page.last:
            self._finish(batch.page.base + len(batch.page.data))
        return self._pieces, work.samples, self._events

    def _pass(self, work: Work, begin: int, end: int) -> None:
        """Records begin..end-1 of the batch, among which nothing is marked."""
        low, high = work.between(begin, end)
        if low == high:
            self._idle.hear(work.batch.records.second[begin:end])
        for first, stop in work.runs(low, high) if low < high else ():
            position = self.position - begin + int(work.number[first])
            self._run(work, first, stop, _Where(position, work.start_byte(first)))
        self.position += end - begin

    def _meet(self, mark: Mark) -> None:
        where = _Where(self.position, mark.start_byte)
        if isinstance(mark, Damage):
            self._forget_sleep(where)
            self._events.append(damage_event(mark, self.position, self.rows))
            self._explained = True
            self.position += max(1, mark.records)
        else:
            self._meet_sleep(mark, where)

    def _meet_sleep(self, event: SleepEvent, where: _Where) -> None:
        if not event.wakes:
            self._sleep(FOREVER_S)
            self._idle.fall_asleep(event.second)
        elif (slept := self._idle.wake(event.second, self._next_s)) is not None:
            self._slept = slept, where

    def _finish(self, end_byte: int) -> None:
        """Nothing follows; asleep, it slept at least until the last record."""
        if (slept := self._idle.end(self._next_s)) is not None:
            self._slept = slept, _Where(self.position, end_byte)
        self._sleep(FOREVER_S)

    def _run(self, work: Work, first: int, stop: int, where: _Where) -> None:
        """Records that go on evenly, or a single one."""
        self._forget_sleep(where)
        self._sleep(int(work.records.second[first]))
        if self._repeats(work, first):
            self._note(REPEATED, where)
            first += 1
        if first < stop:
            self._measure(work, first, stop, where)

    def _repeats(self, work: Work, record: int) -> bool:
        last = self._last
        if last is None or last.second != work.records.second[record]:
            return False
        return last.data == work.payload(record)

    def _measure(self, work: Work, first: int, stop: int, where: _Where) -> None:
        whole, rows = bool(work.whole[first]), int(work.samples.rows[first])
        if not whole:
            self._note(LENGTH, where)
        if not rows:
            return
        second, begin = int(work.records.second[first]), int(work.first[first])
        end = int(work.first[stop - 1] + work.samples.rows[stop - 1])
        broken = self._step_to(second, where)
        per_second = rows if whole else max(rows, self._sensor.rate)
        validity = Validity.RECOVERED if work.doubtful[first] else Validity.MEASURED
        self._add(Piece(end - begin, second, per_second, broken, begin, validity))
        self._next_s, self._apart = int(work.records.second[stop - 1]) + 1, not whole
        sample = work.samples.counts[end - 1].copy()
        self._last = _Last(self._next_s - 1, work.payload(stop - 1), sample)

    def _step_to(self, second: int, where: _Where) -> bool:
        """Whether rows from `second` on do not continue those before; notes a jump of the clock."""
        ahead = second - self._next_s
        if self._last is None:
            return False
        if ahead < 0 or (ahead and not self._explained):
            self._note(AHEAD if ahead > 0 else BACK, where, abs(ahead))
        self._explained = False
        return self._apart or ahead != 0

    def _sleep(self, end_s: int) -> None:
        """Rows that the device filled while asleep, as far as nothing else begins at `end_s`."""
        slept, self._slept = self._slept, None
        if slept is None or self._last is None:
            return
        second, end = slept[0].first_s, min(slept[0].end_s, end_s)
        if not self._sensor.fills:
            self._explained = True
        elif second < end:
            broken = self._step_to(second, slept[1])
            self._fill(second, end, self._last.sample, broken)

    def _fill(self, second: int, end: int, sample: NDArray[np.int16], broken: bool) -> None:
        rate = self._sensor.rate
        for start in range(second, end, FILL_S):
            rows = (min(end, start + FILL_S) - start) * rate
            first = broken and start == second
            self._add(Piece(rows, start, rate, first, validity=Validity.FILLED, sample=sample))
        self._next_s, self._apart = end, False

    def _forget_sleep(self, where: _Where) -> None:
        """Asleep as far as known, but something is lost, or samples follow."""
        if self._idle.asleep:
            self._note(RESTLESS, where)
        self._idle.forget()

    def _add(self, piece: Piece) -> None:
        self._pieces.append(piece)
        self.rows += piece.rows

    def _note(self, kind: Kind, where: _Where, seconds: int = 0) -> None:
        amount_us = seconds * MICROSECONDS
        self._events.append(
            Event(where.position, 1, *kind, where.start_byte, self.rows, 1, amount_us=amount_us)
        )
