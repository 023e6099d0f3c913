"""A batch of records prepared for the timeline: its samples, and what stands between them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.readers._gt3x.framing import Batch, Damage
from accelcal_cli.readers._gt3x.idle import FELL_ASLEEP, WOKE
from accelcal_cli.readers._gt3x.layout import EVENT, Records
from accelcal_cli.readers._gt3x.parameters import payload
from accelcal_cli.readers._gt3x.sensor import Samples, Sensor, first_rows


@dataclass(frozen=True, slots=True)
class SleepEvent:
    """The device falls asleep or wakes.

    Attributes:
        start_byte: where in log.bin it is recorded.
    """

    second: int
    wakes: bool
    start_byte: int


Mark = Damage | SleepEvent


@dataclass(frozen=True, slots=True, eq=False)
class Work:
    """A batch and its k records with samples.

    Attributes:
        number: (k,) of each among all records of the batch.
        whole: (k,) bool, one second of samples.
        first: (k,) int64, first row of each.
        doubtful: (k,) bool, what follows the record is no record.
        joined: (k,) bool, goes on evenly from the record before it in the batch.
    """

    batch: Batch
    records: Records
    samples: Samples
    number: NDArray[np.int64]
    whole: NDArray[np.bool_]
    first: NDArray[np.int64]
    doubtful: NDArray[np.bool_]
    joined: NDArray[np.bool_]

    def payload(self, record: int) -> bytes:
        """A record's bytes."""
        return payload(self.batch, int(self.number[record]))

    def start_byte(self, record: int) -> int:
        """Where in log.bin a record begins."""
        return self.batch.page.base + int(self.records.start[record])

    def between(self, begin: int, end: int) -> tuple[int, int]:
        """Which of the records with samples are among records begin..end-1 of the batch."""
        low, high = np.searchsorted(self.number, (begin, end)).tolist()
        return low, high

    def runs(self, low: int, high: int) -> Iterator[tuple[int, int]]:
        """Records low..high-1 with samples, in stretches that go on evenly."""
        starts = low + np.flatnonzero(~self.joined[low + 1 : high]) + 1
        bounds = [low, *starts.tolist(), high]
        return pairwise(bounds)


def prepared(batch: Batch, sensor: Sensor) -> Work:
    """Decode a batch."""
    buffer = batch.page.buffer
    holds = sensor.holds(buffer, batch.records)
    records = batch.records.select(holds)
    samples, whole = sensor.decode(buffer, records), sensor.whole(records)
    doubtful = batch.doubtful[holds]
    even = whole & (samples.rows == sensor.rate) & ~doubtful
    joined = even.copy()
    joined[:1] = False
    joined[1:] &= even[:-1] & (np.diff(records.second) == 1)
    first = first_rows(samples.rows)
    return Work(batch, records, samples, np.flatnonzero(holds), whole, first, doubtful, joined)


def marks(batch: Batch) -> list[tuple[int, Mark]]:
    """Damage and events of sleep in file order, each with the number of the record that it is or precedes."""
    found: list[tuple[int, Mark]] = [(damage.before, damage) for damage in batch.damage]
    records = batch.records
    for number in np.flatnonzero((records.kind == EVENT) & (records.size == 1)).tolist():
        if (data := payload(batch, number)) in (FELL_ASLEEP, WOKE):
            byte = batch.page.base + int(records.start[number])
            found.append((number, SleepEvent(int(records.second[number]), data == WOKE, byte)))
    return sorted(found, key=lambda item: (item[0], isinstance(item[1], SleepEvent)))
