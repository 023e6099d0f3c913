"""The records that flow from a reader to the rest: Recording, Chunk, Problem."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from enum import IntEnum
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import Clock, JoinedClock, StampClock
from accelcal_cli.core.errors import UnreadableError

Counts = NDArray[np.int16] | NDArray[np.int32]
NO_BREAKS: NDArray[np.int64] = np.empty(0, np.int64)

FLOAT_LSB_PER_G = float(1 << 24)
"""Counts per g given to values that arrive as decimal fractions: a grid of 0.06 micro-g."""

LARGEST_LSB_PER_G = 1e9
"""No file may claim more counts in one g: 32 bits would hold no more than 2 g."""


class Validity(IntEnum):
    """Where a row comes from, as in the Parquet column `validity`."""

    MEASURED = 0
    FILLED = 1
    CLIPPED = 2
    RECOVERED = 3


NOT_CALIBRATED = 4
"""Added to `validity` in a file whose values are raw, since its recording was refused."""

CHANNELS: dict[str, np.generic | None] = {
    "counts": None,
    "temperature_mc": None,
    "gyro_counts": None,
    "validity": np.uint8(Validity.MEASURED),
}
"""Columns of a Chunk with a value or three for each row: all that slicing, masking, copying and joining
need to know of a channel. The value stands for the rows of a chunk without the channel when it is joined
to one that has it; None: the joined chunk is without the channel too."""

Channels = dict[str, NDArray[Any]]
"""Channels beside the counts, by their name in Chunk; only those that a recording has."""


@dataclass(frozen=True, slots=True)
class Device:
    """Who recorded; None if the file does not say."""

    model: str | None = None
    serial: str | None = None
    firmware: str | None = None


METADATA_KEY = b"accelcal"
"""Of the metadata of our Parquet files: what they say of themselves, as JSON."""


@dataclass(frozen=True, slots=True)
class Calibrated:
    """How a recording that accelcal calibrated before came to be; None where its file does not say.

    Attributes:
        name: of the raw recording's file.
        outcome: of its calibration.
        held_out_mg: error of that on postures that were left out of the fit.
    """

    name: str
    outcome: str | None = None
    held_out_mg: float | None = None

    def told(self) -> str:
        """For people, such as `calibrated already, from a.cwa (calibrated, 4.4 mg held out)`."""
        error = None if self.held_out_mg is None else f"{self.held_out_mg:.1f} mg held out"
        known = ", ".join(filter(None, (self.outcome and self.outcome.replace("_", " "), error)))
        return f"calibrated already, from {self.name}{f' ({known})' if known else ''}"


@dataclass(frozen=True, slots=True)
class Recording:
    """What is known of a recording before its samples are read.

    Attributes:
        format: name of the format, as in `--format`.
        rate_hz: nominal sampling rate.
        lsb_per_g: raw counts in one g.
        range_g: the sensor clips at +- this; None if unknown.
        start_us: time of the first sample, microseconds since 1970 on the device's clock; None
            if the file has none (times then count from 1970-01-01).
        timezone: zone of the times, None if they are local times of an unknown zone. A reader states what
            the file says; `core/local_time.py` decides.
        has_offsets: its times had offsets from UTC, and were converted to UTC.
        stamped: its rows have times of their own, such as a computer writes, whose clock may follow daylight
            saving; the clock of a device runs on.
        samples: number of samples, None if only reading everything would show it.
        duration_s: length from headers and first and last pages, None if unknown.
        gyro_dps_per_lsb: deg/s in one count of each gyroscope axis, None without a gyroscope.
        factory: the maker's calibration, where the reader applied one: counts are those that it gives.
        companion: a file beside the recording that says how to read it, such as a layout.
        calibrated: set for a file of ours with calibrated values.
        notes: what a user should know of how the file was understood.
    """

    path: Path
    format: str
    rate_hz: float
    lsb_per_g: float
    total_bytes: int
    device: Device = Device()
    range_g: float | None = None
    start_us: int | None = None
    timezone: str | None = None
    has_offsets: bool = False
    stamped: bool = False
    samples: int | None = None
    duration_s: float | None = None
    has_temperature: bool = False
    gyro_dps_per_lsb: tuple[float, float, float] | None = None
    factory: FactoryCalibration | None = None
    companion: Path | None = None
    calibrated: Calibrated | None = None
    notes: tuple[str, ...] = ()

    @property
    def of_bare_sensor(self) -> bool:
        """Whether its counts are those that the maker's calibration gives of the raw ones."""
        return self.factory is not None and self.factory.acceleration is not None


@dataclass(frozen=True, slots=True)
class Problem:
    """Something wrong with a file that did not stop its reading.

    Attributes:
        code: stable lower-case name, such as `checksum` or `truncated`.
        byte_offset: where in the file (in the uncompressed stream for .gz), None if unknown.
        sample: number of the first sample after the problem.
        count: how many units (pages, rows, bytes: as the message says) are concerned.
        lost_bytes: how many bytes of the (uncompressed) file could not be used because they are
            damaged; 0 for what is missing, repeated or normal.
    """

    code: str
    message: str
    byte_offset: int | None
    sample: int
    count: int = 1
    lost_bytes: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Chunk:
    """A stretch of consecutive rows, at most a few hundred thousand of them; may be empty.

    Attributes:
        first_sample: number of row 0 within the recording.
        counts: (n, 3) int16 or int32, raw counts of x, y, z.
        clock: the rows' times.
        end_byte: how far into the file this chunk reaches, for progress.
        breaks: rows r in 0..n-1, ascending, before which the recording is not continuous (lost
            data, a jump of the clock); the recording's very first row is not one.
        clock_jumps: those of the breaks where nothing but the clock jumps: of the file, the row follows
            directly on the one before. Only a reader whose rows have stamps of their own knows that.
        temperature_mc: (n,) int32, thousandths of a degree Celsius, or None.
        gyro_counts: (n, 3) int16 or int32, or None.
        validity: (n,) uint8 of `Validity`, or None if all rows were measured.
        problems: what was found wrong while reading these rows.
        used_bytes: how many bytes of the (uncompressed) file these rows were made of, without
            headers and unused memory.
    """

    first_sample: int
    counts: Counts
    clock: Clock
    end_byte: int
    breaks: NDArray[np.int64] = field(default_factory=lambda: NO_BREAKS)
    clock_jumps: NDArray[np.int64] = field(default_factory=lambda: NO_BREAKS)
    temperature_mc: NDArray[np.int32] | None = None
    gyro_counts: Counts | None = None
    validity: NDArray[np.uint8] | None = None
    problems: tuple[Problem, ...] = ()
    used_bytes: int = 0

    def __len__(self) -> int:
        return len(self.counts)

    @property
    def time_us(self) -> NDArray[np.int64]:
        """(n,) times of all rows [us since 1970, device clock]."""
        return self.clock.times(0, len(self))

    @property
    def is_fresh(self) -> bool:
        """Whether the first row does not continue the chunk before."""
        return len(self.breaks) > 0 and self.breaks[0] == 0

    def part(self, start: int, stop: int) -> Chunk:
        """Rows start..stop-1, as views; problems and used bytes go with row 0."""
        low, high = np.searchsorted(self.breaks, (start, stop))
        first, last = np.searchsorted(self.clock_jumps, (start, stop))
        return replace(
            self,
            **cut_columns(self, CHANNELS, slice(start, stop)),
            first_sample=self.first_sample + start,
            clock=self.clock.part(start, stop),
            breaks=self.breaks[low:high] - start,
            clock_jumps=self.clock_jumps[first:last] - start,
            problems=() if start else self.problems,
            used_bytes=0 if start else self.used_bytes,
        )

    def keep(self, mask: NDArray[np.bool_]) -> Chunk:
        """The rows of a mask (n,), which do not continue across those left out.

        After that, no break is known to be of the clock alone.
        """
        broken = ~mask
        broken[self.breaks] = True
        return replace(
            self,
            **cut_columns(self, CHANNELS, mask),
            clock=StampClock(self.time_us[mask]),
            breaks=np.flatnonzero(np.diff(np.cumsum(broken)[mask], prepend=0)),
            clock_jumps=NO_BREAKS,
        )

    def copy(self) -> Chunk:
        """The same rows in memory of their own, so that a few do not keep a whole chunk alive."""
        long = isinstance(self.clock, StampClock | JoinedClock)
        return replace(
            self,
            **cut_columns(self, CHANNELS, np.arange(len(self))),
            clock=StampClock(self.time_us.copy()) if long else self.clock,
        )


def in_columns(chunk: Chunk) -> Chunk:
    """The same rows, the counts of each axis one behind the other: that is how most are read."""
    counts: Any = np.asfortranarray(chunk.counts)
    return replace(chunk, counts=counts)


def joined(chunks: Sequence[Chunk]) -> Chunk:
    """Chunks that follow one another, at least one, as a single one."""
    if len(chunks) == 1:
        return chunks[0]
    with_rows = [chunk for chunk in chunks if len(chunk)] or chunks
    lengths = np.array([len(chunk) for chunk in chunks])
    first_rows = np.cumsum(lengths) - lengths
    placed = [*zip(chunks, first_rows.tolist(), strict=True)]
    return replace(
        chunks[-1],
        **{name: _joined_channel(with_rows, name) for name in CHANNELS},
        first_sample=chunks[0].first_sample,
        clock=_joined_clock(chunks),
        breaks=np.concatenate([chunk.breaks + row for chunk, row in placed]),
        clock_jumps=np.concatenate([chunk.clock_jumps + row for chunk, row in placed]),
        problems=tuple(problem for chunk in chunks for problem in chunk.problems),
        used_bytes=sum(chunk.used_bytes for chunk in chunks),
    )


def _joined_clock(chunks: Sequence[Chunk]) -> Clock:
    """Two plain clocks are asked for times when these are wanted; more of them at once."""
    first, *others = (chunk.clock for chunk in chunks)
    if len(others) == 1 and not any(isinstance(clock, JoinedClock) for clock in (first, others[0])):
        return JoinedClock(first, len(chunks[0]), others[0])
    return StampClock(np.concatenate([chunk.time_us for chunk in chunks]))


def _joined_channel(chunks: Sequence[Chunk], name: str) -> Any:
    """A channel of all chunks; where only some have it, filled up or left out as CHANNELS says."""
    columns, missing = [getattr(chunk, name) for chunk in chunks], CHANNELS[name]
    known = [column is not None for column in columns]
    if not (all(known) if missing is None else any(known)):
        return None
    pairs = zip(chunks, columns, strict=True)
    return np.concatenate([np.full(len(c), missing) if column is None else column for c, column in pairs])


def clipped_at(chunk: Chunk, low: Any, high: Any) -> Chunk:
    """The chunk with measured rows marked that reach the ends of what the sensor can tell.

    Args:
        low, high: counts of all axes, or (3,) of each.
    """
    counts = chunk.counts
    if not len(chunk) or (counts.min() > np.max(low) and counts.max() < np.min(high)):
        return chunk
    clipped = ((counts <= low) | (counts >= high)).any(axis=1)
    validity = np.zeros(len(chunk), np.uint8) if chunk.validity is None else chunk.validity.copy()
    validity[clipped & (validity == Validity.MEASURED)] = Validity.CLIPPED
    return replace(chunk, validity=validity)


def cut_columns(record: Any, names: Iterable[str], rows: Any) -> dict[str, Any]:
    """Some rows (a slice, a mask or numbers) of the columns that a record has, by name."""
    cut = {}
    for name in names:
        column = getattr(record, name)
        if column is not None:
            cut[name] = column[rows]
    return cut


def cut_channels(channels: Channels, rows: Any) -> Channels:
    """Some rows (a slice, a mask or numbers) of all channels."""
    return {name: values[rows] for name, values in channels.items()}


def joined_columns(records: Sequence[Any], names: Iterable[str]) -> dict[str, Any]:
    """Columns of records one after the other, by name; None if one of the records has none."""
    parts = {name: [getattr(record, name) for record in records] for name in names}
    return {
        name: None if any(column is None for column in columns) else np.concatenate(columns)
        for name, columns in parts.items()
    }


def joined_channels(parts: Sequence[Channels]) -> Channels:
    """Channels one after the other; one that a part does not have is left out."""
    names = [name for name in parts[0] if all(name in part for part in parts)]
    return {name: np.concatenate([part[name] for part in parts]) for name in names}


@dataclass(frozen=True, slots=True)
class PlacedFile:
    """One file of a session of several, each of which is a recording of its own.

    Attributes:
        name: within the session.
        first_sample, samples: its rows within the whole.
        first_us: time of its first row there, on the device's clock.
        moved_us: what was added to its own times.
        dated: whether these have a date.
        problems, lost_bytes: its damage.
    """

    name: str
    first_sample: int
    samples: int
    first_us: int
    moved_us: int
    dated: bool
    problems: int
    lost_bytes: int


class Closing:
    """Closed at the end of a `with` block."""

    def close(self) -> None:
        """Release the file."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_failure: object) -> None:
        self.close()


class Intake:
    """Takes the bytes of one recording as they come, and gives its rows as `Reader.chunks` would.

    The rows do not depend on the pieces in which the bytes come. It holds no open file: a copy by
    `copy.deepcopy` goes on from the same byte.
    """

    def take(self, data: bytes, *, last: bool) -> Iterator[Chunk]:
        """The rows that are settled by these bytes, which follow on those before.

        Args:
            last: nothing follows.

        Raises:
            UnreadableError: the bytes cannot be read on at all.
        """
        raise NotImplementedError


class Reader(Closing):
    """An open recording: its description, and its samples as a stream that can be run again.

    A format subclasses this. `chunks` may be called several times; each call starts from the
    beginning, and the rows do not depend on `chunk_samples`. Problems travel with the chunks.

    Attributes:
        threads: how many may work at a time; a format may leave them unused.
        files: those of a session, once all its rows were read; of any other recording none.
    """

    recording: Recording
    threads: int = 1
    files: tuple[PlacedFile, ...] = ()

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """Yield all rows in order, about `chunk_samples` at a time (whole pages, at least one).

        Raises:
            UnreadableError: the file cannot be read on at all.
        """
        raise NotImplementedError

    def intake(self) -> Intake:
        """Takes the recording's bytes from the first one on, of a format that can be read as it grows.

        Raises:
            UnreadableError: it cannot be.
        """
        raise UnreadableError(
            f"recordings of format {self.recording.format} are not read while they grow",
            path=self.recording.path,
            hint="use accelcal calibrate when it is complete",
        )

    def preview(self, chunk_samples: int, pieces: int) -> Iterator[Chunk]:
        """Yield up to `pieces` chunks spread over the file where it can be entered anywhere.

        Each begins anew: rows of different pieces are not continuous. The default reads the
        first chunks.
        """
        for _, chunk in zip(range(pieces), self.chunks(chunk_samples), strict=False):
            yield chunk


def as_json_device(device: Device) -> dict[str, Any]:
    """The report's `device` object."""
    return {"model": device.model, "serial": device.serial, "firmware": device.firmware}


Three = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class FactoryAcceleration:
    """Acceleration [g] = g_per_count (counts - offset_counts).

    Attributes:
        source: the part of the file that holds it.
        method: the maker's number of its kind.
        sample_rate_hz: the rate for which it holds.
        offset_counts: of raw x, y, z.
        g_per_count: 3 x 3, symmetric.
    """

    source: str
    method: int
    sample_rate_hz: int
    offset_counts: Three
    g_per_count: tuple[Three, Three, Three]


@dataclass(frozen=True, slots=True)
class FactoryTemperature:
    """Temperature on the line through two points, at which the thermometer gave so many counts.

    Attributes:
        source, method: as above.
        counts, celsius: the low and the high point.
    """

    source: str
    method: int
    counts: tuple[float, float]
    celsius: tuple[float, float]


@dataclass(frozen=True, slots=True)
class FactoryCalibration:
    """What was applied; None where there was nothing to apply."""

    acceleration: FactoryAcceleration | None = None
    temperature: FactoryTemperature | None = None

    def as_json(self) -> dict[str, Any]:
        """The report's `recording.factory_calibration`."""
        values: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        return values

    def notes(self) -> tuple[str, ...]:
        """For people."""
        told = []
        if self.acceleration is not None:
            part = self.acceleration
            rate = f"for {part.sample_rate_hz} Hz"
            told.append(f"the maker's calibration ({part.source}, {rate}) was applied before any other")
        if self.temperature is not None:
            told.append(f"the maker's calibration of the thermometer ({self.temperature.source}) was applied")
        return tuple(told)
