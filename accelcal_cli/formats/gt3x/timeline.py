"""Rows in the order of time from records of log.bin: consecutive seconds, gaps, idle sleep.

A batch of records is decoded; a `Timeline` makes spans of rows and events for the problem log of it; spans
become chunks.

Idle sleep: an event record with payload 8 says that the device falls asleep, 9 that it wakes
(github.com/actigraph/GT3X-File-Format, README.md, EVENT). Asleep, "the last sampled accelerometer value is
written into memory at the device's preset sample rate" (ActiGraph, "Idle Sleep Mode Explained"); newer
devices leave the writing to the reader.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, PageClock
from accelcal_cli.core.recording import Channels, Chunk, Others, Validity, cut_channels, no_others
from accelcal_cli.formats._problems import Event, Kind
from accelcal_cli.formats.gt3x.records import EVENT, Damage, RecordBatch, Records, Span, payload
from accelcal_cli.formats.gt3x.sensors import Reading, Samples, Sensor, Thermometer, first_rows

FELL_ASLEEP, WOKE = b"\x08", b"\x09"
UNWRITTEN_S = 1
"""Seconds that may be lost when a device falls asleep; the vendor's own export fills them as well."""

LONGEST_SILENCE_S = 86_400
"""Longest silence [s] of a sleeping device; after a longer one its clock jumped.

Asleep, devices write their battery's voltage every minute.
"""

FILLED_FREELY_S, FILLED_PER_RECORD_S = 86_400, 300
"""Seconds of sleep that are filled in any file, and further ones for each record before its end.

Devices write a record each second or, asleep, each minute: a few bytes must not become millions of rows.
"""

JITTER_S, FILL_S = 2, 3600
"""Seconds by which other records may lie before those around them, and longest span of filled rows."""

CHECKSUM: Kind = ("checksum", "records of log.bin with a wrong checksum, left out")
NO_RECORD: Kind = ("bad_bytes", "bytes of log.bin that are not records, left out")
CUT_OFF: Kind = ("truncated", "an incomplete record at the end of log.bin, bytes left out")
LENGTH: Kind = ("record_length", "activity records of more or less than one second")
REPEATED: Kind = ("duplicate_record", "activity records that repeat the one before, left out")
AHEAD: Kind = ("clock_gap", "jumps ahead in the times of activity records, with no sleep recorded")
BACK: Kind = ("clock_back", "steps back in the times of activity records")
UNEXPLAINED_SLEEP: Kind = (
    "idle_unheard",
    "idle sleeps far longer than the records around them explain, left as gaps",
)
UNFINISHED_SLEEP: Kind = ("idle_unfinished", "idle sleeps whose end is not recorded, left as gaps")

FOREVER_S = 1 << 40


@dataclass(frozen=True, slots=True, eq=False)
class RowSpan:
    """Consecutive rows, evenly spread from the beginning of a second on.

    Attributes:
        rows: number of rows.
        second: time of the first one, seconds since 1970.
        per_second: rows in a second.
        broken: the row before does not continue.
        first: number of the first row among the samples of the batch; meaningless for filled rows.
        validity: origin of the rows.
        sample: for filled rows, the sample that the device repeats: one row of each column.
    """

    rows: int
    second: int
    per_second: int
    broken: bool
    first: int = 0
    validity: Validity = Validity.MEASURED
    sample: Channels | None = None


def groups(spans: Sequence[RowSpan], most: int) -> Iterator[list[RowSpan]]:
    """Group spans in order, each group up to about `most` rows."""
    group: list[RowSpan] = []
    rows = 0
    for span in spans:
        if group and rows + span.rows > most:
            yield group
            group, rows = [], 0
        group.append(span)
        rows += span.rows
    if group:
        yield group


def chunk_of(spans: Sequence[RowSpan], samples: Samples, first_sample: int, end_byte: int) -> Chunk:
    """Return the rows of spans in order, still without problems and the bytes that they were made of."""
    rows = np.array([span.rows for span in spans], np.int64)
    first_row = np.cumsum(rows) - rows
    time_us = np.array([span.second for span in spans], np.int64) * MICROSECONDS
    per_second = np.array([span.per_second for span in spans], np.int64)
    broken = np.array([span.broken for span in spans], np.bool_)
    validity = np.array([span.validity for span in spans], np.uint8)
    return Chunk(
        first_sample=first_sample,
        clock=PageClock(first_row, time_us, per_second, np.full(len(spans), MICROSECONDS, np.int64)),
        end_byte=end_byte,
        breaks=first_row[broken],
        validity=np.repeat(validity, rows) if validity.any() else None,
        problems=(),
        used_bytes=0,
        **{name: _column(name, values, spans) for name, values in samples.columns.items()},
    )


def _column(name: str, values: NDArray[Any], spans: Sequence[RowSpan]) -> NDArray[Any]:
    """Return the spans' rows of a column; a view if they are one stretch of it."""
    adjoin = all(after.first == before.first + before.rows for before, after in pairwise(spans))
    if adjoin and all(span.sample is None for span in spans):
        begin = spans[0].first if spans else 0
        return values[begin : begin + sum(span.rows for span in spans)]
    parts = [
        values[span.first : span.first + span.rows]
        if span.sample is None
        else np.broadcast_to(span.sample[name], (span.rows, *values.shape[1:]))
        for span in spans
    ]
    return np.concatenate(parts)


class PlacedReadings:
    """Gives what other sensors recorded in a second to its first row; where there is none, it has no place.

    A device records it while it sleeps, too, and the rows of that time come when it wakes.
    """

    def __init__(self, readings: Sequence[Reading]) -> None:
        self._readings = readings
        self._waiting = np.empty((0, 3))  # second, column, value

    def take(self, batch: RecordBatch) -> None:
        """Take the readings of the next batch."""
        for number, reading in enumerate(self._readings):
            whole = batch.records.size >= reading.least_bytes
            records = batch.records.select((batch.records.kind == reading.kind) & whole)
            values = reading.values(batch.page.buffer, records)
            found = np.stack([records.second, np.full(len(records), number), values], axis=1)
            self._waiting = np.concatenate((self._waiting, found))

    def of(self, spans: Sequence[RowSpan]) -> Others:
        """Return the readings of the next rows."""
        rows, begin, rate = (
            np.array([getattr(span, name) for span in spans], np.int64)
            for name in ("rows", "second", "per_second")
        )
        others = no_others(int(rows.sum()), len(self._readings))
        if not len(rows):
            return others
        second, column, values = self._waiting.T
        order = np.argsort(begin, kind="stable")
        span = order[np.maximum(np.searchsorted(begin[order], second, side="right") - 1, 0)]
        row = (second.astype(np.int64) - begin[span]) * rate[span]
        here = (row >= 0) & (row < rows[span])
        places = (row + (np.cumsum(rows) - rows)[span])[here], column[here].astype(np.int64)
        others[places] = values[here]
        self._waiting = self._waiting[~here & (second >= begin[-1] + rows[-1] / rate[-1])]
        return others


def cut(chunk: Chunk, most: int) -> Iterator[Chunk]:
    """Yield a chunk in parts of at most `most` rows; the problems go with the first."""
    if len(chunk) <= most:
        yield chunk
        return
    for start in range(0, len(chunk), most):
        yield chunk.part(start, min(start + most, len(chunk)))


class SleepSpan(NamedTuple):
    """Seconds first_s..end_s - 1, in which the device sleeps according to the records."""

    first_s: int
    end_s: int


class SleepTracker:
    """Follows the device's sleep, which does not reach beyond a span, record by record."""

    def __init__(self, span: Span) -> None:
        self._span, self._heard = span, 0
        self._since: int | None = None

    @property
    def asleep(self) -> bool:
        """True if the device fell asleep and is not known to have woken."""
        return self._since is not None

    def fall_asleep(self, second: int) -> None:
        """Note that the device falls asleep."""
        self._since = self._heard = second

    def note_times(self, seconds: NDArray[np.int64]) -> None:
        """Note the times of other records, in file order; the clock must continue evenly."""
        if not self.asleep or not len(seconds):
            return
        steps = np.diff(seconds, prepend=self._heard)
        if (steps < -JITTER_S).any() or (steps > LONGEST_SILENCE_S).any():
            self._since = None
        self._heard = int(seconds.max())

    def wake(self, second: int, next_s: int) -> SleepSpan | None:
        """Note that the device woke; return when it slept, not before `next_s`, or None if nothing tells."""
        self.note_times(np.array([second]))
        since, self._since = self._since, None
        if since is None:
            return None
        first, end = max(next_s, since - UNWRITTEN_S), min(second, self._span.last_s)
        return SleepSpan(first, end) if first < end else None

    def end(self, next_s: int) -> SleepSpan | None:
        """End the records: the device slept at least until the last of them."""
        return self.wake(self._heard, next_s)

    def forget(self) -> None:
        """Give up on the current sleep, after damage or samples while asleep."""
        self._since = None


@dataclass(frozen=True, slots=True)
class SleepEvent:
    """The device falls asleep or wakes, as is recorded at a byte of log.bin."""

    second: int
    wakes: bool
    start_byte: int


LogEvent = Damage | SleepEvent


@dataclass(frozen=True, slots=True, eq=False)
class DecodedBatch:
    """A batch and its k records with samples.

    Attributes:
        number: (k,) number of each among all records of the batch.
        whole: (k,) bool, one second of samples.
        first: (k,) int64, first row of each.
        doubtful: (k,) bool, no record follows this one.
        joined: (k,) bool, continues evenly from the record before it in the batch.
    """

    batch: RecordBatch
    records: Records
    samples: Samples
    number: NDArray[np.int64]
    whole: NDArray[np.bool_]
    first: NDArray[np.int64]
    doubtful: NDArray[np.bool_]
    joined: NDArray[np.bool_]

    def payload(self, record: int) -> bytes:
        """Return a record's payload."""
        return payload(self.batch, int(self.number[record]))

    def runs(self, low: int, high: int) -> Iterator[tuple[int, int]]:
        """Split records low..high-1 with samples into stretches that continue evenly."""
        starts = low + np.flatnonzero(~self.joined[low + 1 : high]) + 1
        return pairwise([low, *starts.tolist(), high])


def decode_batch(batch: RecordBatch, sensor: Sensor, thermometer: Thermometer | None = None) -> DecodedBatch:
    """Decode a batch, with the temperatures that a thermometer of its own recorded among the samples."""
    holds = sensor.holds(batch)
    records = batch.records.select(holds)
    samples, whole = sensor.decode(batch, records), sensor.whole(records)
    if thermometer is not None:
        heat = thermometer.temperatures_of(batch, records, samples.rows)
        samples = replace(samples, channels=samples.channels | {"temperature_mc": heat})
    doubtful = batch.doubtful[holds]
    even = whole & (samples.rows == sensor.rate) & ~doubtful
    joined = even.copy()
    joined[:1] = False
    joined[1:] &= even[:-1] & (np.diff(records.second) == 1)
    first = first_rows(samples.rows)
    return DecodedBatch(batch, records, samples, np.flatnonzero(holds), whole, first, doubtful, joined)


def log_events(batch: RecordBatch) -> list[tuple[int, LogEvent]]:
    """Return damage and sleep in file order, with the number of the record that each is or precedes."""
    events: list[tuple[int, LogEvent]] = [(damage.before, damage) for damage in batch.damage]
    records = batch.records
    for number in np.flatnonzero((records.kind == EVENT) & (records.size == 1)).tolist():
        if (data := payload(batch, number)) in (FELL_ASLEEP, WOKE):
            byte = batch.page.base + int(records.start[number])
            events.append((number, SleepEvent(int(records.second[number]), data == WOKE, byte)))
    return sorted(events, key=lambda item: (item[0], isinstance(item[1], SleepEvent)))


@dataclass(frozen=True, slots=True, eq=False)
class _LastRecord:
    """The previous record of samples: its second, bytes and last sample, one row of each column."""

    second: int
    data: bytes
    sample: Channels


class _RecordPlace(NamedTuple):
    """The number of a record in the whole file, and where in log.bin it begins."""

    position: int
    start_byte: int


class Timeline:
    """Makes rows and events from batches in file order.

    Attributes:
        position: number of records seen so far, sound or not.
        rows: number of rows made so far.
    """

    def __init__(self, sensor: Sensor, span: Span, thermometer: Thermometer | None = None) -> None:
        self.position = self.rows = self._next_s = self._filled_s = 0
        self._sensor, self._thermometer, self._idle = sensor, thermometer, SleepTracker(span)
        self._slept: tuple[SleepSpan, _RecordPlace] | None = None
        self._last: _LastRecord | None = None
        self._apart = self._explained = False
        self._spans: list[RowSpan] = []
        self._events: list[Event] = []

    def feed(self, batch: RecordBatch) -> tuple[list[RowSpan], Samples, list[Event]]:
        """Return the rows of a batch, their samples, and events; sleep comes with the first later record."""
        self._spans, self._events = [], []
        decoded, begin = decode_batch(batch, self._sensor, self._thermometer), 0
        for number, log_event in log_events(batch):
            self._add_records(decoded, begin, number)
            begin = number
            self._add_log_event(log_event)
        self._add_records(decoded, begin, len(batch.records))
        if batch.page.last:
            if (slept := self._idle.end(self._next_s)) is not None:  # at least until the last record
                end_byte = batch.page.base + len(batch.page.data)
                self._slept = slept, _RecordPlace(self.position, end_byte)
            self._sleep(FOREVER_S)
        return self._spans, decoded.samples, self._events

    def _add_records(self, decoded: DecodedBatch, begin: int, end: int) -> None:
        """Add records begin..end-1 of the batch, among which there is no event."""
        low, high = np.searchsorted(decoded.number, (begin, end)).tolist()
        if low == high:
            self._idle.note_times(decoded.batch.records.second[begin:end])
        for first, stop in decoded.runs(low, high) if low < high else ():
            position = self.position - begin + int(decoded.number[first])
            start_byte = decoded.batch.page.base + int(decoded.records.start[first])
            self._run(decoded, first, stop, _RecordPlace(position, start_byte))
        self.position += end - begin

    def _add_log_event(self, log_event: LogEvent) -> None:
        where = _RecordPlace(self.position, log_event.start_byte)
        if isinstance(log_event, Damage):
            self._forget_sleep(where)
            kind, count = CUT_OFF if log_event.cut_off else NO_RECORD, log_event.size
            if log_event.records:
                kind, count = CHECKSUM, log_event.records
            lost = log_event.size
            self._events.append(
                Event(self.position, 1, *kind, where.start_byte, self.rows, count, lost_bytes=lost)
            )
            self._explained = True
            self.position += max(1, log_event.records)
        elif not log_event.wakes:
            self._sleep(FOREVER_S)
            self._idle.fall_asleep(log_event.second)
        elif (slept := self._idle.wake(log_event.second, self._next_s)) is not None:
            self._slept = slept, where

    def _run(self, decoded: DecodedBatch, first: int, stop: int, where: _RecordPlace) -> None:
        """Add records that continue evenly, or a single one."""
        self._forget_sleep(where)
        self._sleep(int(decoded.records.second[first]))
        last, second = self._last, decoded.records.second[first]
        if last is not None and last.second == second and last.data == decoded.payload(first):
            self._note(REPEATED, where)
            first += 1
        if first < stop:
            self._measure(decoded, first, stop, where)

    def _measure(self, decoded: DecodedBatch, first: int, stop: int, where: _RecordPlace) -> None:
        whole, rows = bool(decoded.whole[first]), int(decoded.samples.rows[first])
        if not whole:
            self._note(LENGTH, where)
        if not rows:
            return
        second, begin = int(decoded.records.second[first]), int(decoded.first[first])
        end = int(decoded.first[stop - 1] + decoded.samples.rows[stop - 1])
        broken = self._step_to(second, where)
        per_second = rows if whole else max(rows, self._sensor.rate)
        validity = Validity.RECOVERED if decoded.doubtful[first] else Validity.MEASURED
        self._add(RowSpan(end - begin, second, per_second, broken, begin, validity))
        self._next_s, self._apart = int(decoded.records.second[stop - 1]) + 1, not whole
        sample = cut_channels(decoded.samples.columns, [end - 1])
        self._last = _LastRecord(self._next_s - 1, decoded.payload(stop - 1), sample)

    def _step_to(self, second: int, where: _RecordPlace) -> bool:
        """Return True if rows from `second` on do not continue those before; note a jump of the clock."""
        ahead = second - self._next_s
        if self._last is None:
            return False
        if ahead < 0 or (ahead and not self._explained):
            self._note(AHEAD if ahead > 0 else BACK, where, abs(ahead))
        self._explained = False
        return self._apart or ahead != 0

    def _sleep(self, end_s: int) -> None:
        """Add the rows that the device filled while asleep, up to `end_s` at most."""
        slept, self._slept = self._slept, None
        if slept is None or self._last is None:
            return
        second, end = slept[0].first_s, min(slept[0].end_s, end_s)
        if not self._sensor.fills:
            self._explained = True
        elif self._filled_s + end - second > FILLED_FREELY_S + FILLED_PER_RECORD_S * slept[1].position:
            self._note(UNEXPLAINED_SLEEP, slept[1], end - second)
            self._explained = True
        elif second < end:
            broken = self._step_to(second, slept[1])
            self._fill(second, end, self._last.sample, broken)

    def _fill(self, second: int, end: int, sample: Channels, broken: bool) -> None:
        rate = self._sensor.rate
        self._filled_s += end - second
        for start in range(second, end, FILL_S):
            rows = (min(end, start + FILL_S) - start) * rate
            first = broken and start == second
            self._add(RowSpan(rows, start, rate, first, validity=Validity.FILLED, sample=sample))
        self._next_s, self._apart = end, False

    def _forget_sleep(self, where: _RecordPlace) -> None:
        """Give up on a sleep, if there is one: something is lost, or samples follow."""
        if self._idle.asleep:
            self._note(UNFINISHED_SLEEP, where)
        self._idle.forget()

    def _add(self, span: RowSpan) -> None:
        self._spans.append(span)
        self.rows += span.rows

    def _note(self, kind: Kind, where: _RecordPlace, seconds: int = 0) -> None:
        amount_us = seconds * MICROSECONDS
        self._events.append(
            Event(where.position, 1, *kind, where.start_byte, self.rows, 1, amount_us=amount_us)
        )
