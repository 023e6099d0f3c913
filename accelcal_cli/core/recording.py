"""The records that flow from a reader to the rest, and the contracts of readers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import three
from accelcal_cli.core.clock import Clock, JoinedClock, StampClock
from accelcal_cli.core.errors import UnreadableError

Counts = NDArray[np.int16] | NDArray[np.int32]
Three = tuple[float, float, float]
NO_BREAKS: NDArray[np.int64] = np.empty(0, np.int64)

FLOAT_LSB_PER_G = float(1 << 24)
"""Counts per g of values that arrive as decimal fractions: a grid of 0.06 micro-g."""

LARGEST_LSB_PER_G = 1e9
"""Most counts per g that a file may claim: 32 bits would hold no more than 2 g."""

CUT_SHORT = "truncated"
"""Code of the problem that all readers report for a file that breaks off."""

METADATA_KEY = b"accelcal"
"""Key under which our Parquet files describe themselves in their metadata, as JSON."""


class Validity(IntEnum):
    """Origin of a row, as in the Parquet column `validity`."""

    MEASURED = 0
    FILLED = 1
    CLIPPED = 2
    RECOVERED = 3


NOT_CALIBRATED = 4
"""Bit that is added to `validity` in a file with raw values, since its recording was refused."""

CHANNELS: dict[str, np.generic | None] = {
    "counts": None,
    "temperature_mc": None,
    "gyro_counts": None,
    "others": None,
    "validity": np.uint8(Validity.MEASURED),
}
"""Columns of a Chunk with one or three values for each row, which slicing, masking, copying and joining use.
The value here fills the rows of a chunk without the channel when it is joined to one that has it; None: the
joined chunk has no such channel either."""

Channels = dict[str, NDArray[Any]]
"""Channels besides the counts that a recording has, by their name in Chunk."""


@dataclass(frozen=True, slots=True)
class Device:
    """The recording device; None for what the file does not say."""

    model: str | None = None
    serial: str | None = None
    firmware: str | None = None


@dataclass(frozen=True, slots=True)
class OtherColumn:
    """A quantity that a file holds besides motion and temperature, such as light: a column of `others`."""

    name: str
    unit: str


Others = NDArray[np.float32]
"""(n, k) values of other quantities, NaN for rows at which none was recorded."""


def no_others(rows: int, columns: int) -> Others:
    """Return rows at which nothing was recorded, each column contiguous."""
    return np.full((columns, rows), np.nan, np.float32).T


MOTION = ("time", *"xyz", "temperature", "gx", "gy", "gz", "validity")
"""Names of the columns of calibrated data besides other quantities."""


def uniquely_named(columns: Iterable[OtherColumn]) -> tuple[OtherColumn, ...]:
    """Return columns of which the second of a name is called `light_2`, and so on."""
    found: dict[str, OtherColumn] = {}
    for column in columns:
        name, number = column.name, 2
        while name in found or name in MOTION:
            name, number = f"{column.name}_{number}", number + 1
        found[name] = replace(column, name=name)
    return tuple(found.values())


def others_as(chunk: Chunk, found: Sequence[OtherColumn], wanted: Sequence[OtherColumn]) -> Chunk:
    """Return a chunk with other quantities in the columns of a recording that it becomes a part of."""
    if chunk.others is None or found == wanted:
        return chunk
    others = no_others(len(chunk), len(wanted))
    for number, column in enumerate(wanted):
        if column in found:
            others[:, number] = chunk.others[:, found.index(column)]
    return replace(chunk, others=others)


@dataclass(frozen=True, slots=True)
class ThermometerWord:
    """How a format's raw word is read: degrees C = celsius_per_count * word + celsius_at_zero.

    Other tools may read the same word by another line (exports/coefficients.py).
    """

    celsius_per_count: float
    celsius_at_zero: float


@dataclass(frozen=True, slots=True)
class FactoryAcceleration:
    """The maker's calibration of the accelerometer: acceleration [g] = g_per_count (counts - offset_counts).

    Attributes:
        source: the part of the file that holds it.
        method: the maker's number of its kind.
        sample_rate_hz: the rate for which it holds.
        offset_counts: offsets of raw x, y, z.
        g_per_count: 3 x 3, symmetric.
    """

    source: str
    method: int
    sample_rate_hz: int
    offset_counts: Three
    g_per_count: tuple[Three, Three, Three]


@dataclass(frozen=True, slots=True)
class FactoryTemperature:
    """The maker's calibration of the thermometer: the line through two points.

    Attributes:
        source, method: as in FactoryAcceleration.
        counts, celsius: the low and the high point.
    """

    source: str
    method: int
    counts: tuple[float, float]
    celsius: tuple[float, float]


@dataclass(frozen=True, slots=True)
class FactoryCalibration:
    """The calibration that the maker ships with a file, applied by its reader before all else.

    Most devices apply it themselves, and their files hold calibrated counts. If a file holds counts of the
    bare sensor and the maker's numbers, its reader applies these, so that all the rest sees what the maker's
    own software shows. The report says so, since coefficients found after it hold only there.
    """

    acceleration: FactoryAcceleration | None = None
    temperature: FactoryTemperature | None = None

    def notes(self) -> tuple[str, ...]:
        """Return sentences about what was applied."""
        sentences = []
        if self.acceleration is not None:
            part = self.acceleration
            rate = f"for {part.sample_rate_hz} Hz"
            sentences.append(f"the maker's calibration ({part.source}, {rate}) was applied before any other")
        if self.temperature is not None:
            sentences.append(
                f"the maker's calibration of the thermometer ({self.temperature.source}) was applied"
            )
        return tuple(sentences)


@dataclass(frozen=True, slots=True)
class Calibrated:
    """Origin of a recording that accelcal calibrated before; None for what its file does not say.

    Attributes:
        name: name of the raw recording's file.
        outcome: outcome of its calibration.
        held_out_mg: error on postures that were left out of the fit.
    """

    name: str
    outcome: str | None = None
    held_out_mg: float | None = None

    def sentence(self) -> str:
        """Return a sentence such as `calibrated already, from a.cwa (calibrated, 4.4 mg held out)`."""
        error = None if self.held_out_mg is None else f"{self.held_out_mg:.1f} mg held out"
        known = ", ".join(filter(None, (self.outcome and self.outcome.replace("_", " "), error)))
        return f"calibrated already, from {self.name}{f' ({known})' if known else ''}"


@dataclass(frozen=True, slots=True)
class Recording:
    """A recording as it is known before its samples are read.

    Attributes:
        format: name of the format, as in `--format`.
        rate_hz: nominal sampling rate.
        lsb_per_g: raw counts in one g.
        range_g: largest |value| that the sensor measures [g]; None if unknown.
        start_us: time of the first sample, microseconds since 1970 on the device's clock; None
            if the file has none (times then count from 1970-01-01).
        timezone: zone of the times, None if they are local times of an unknown zone. A reader states what
            the file says; `core/local_time.py` decides.
        has_offsets: True if its times had offsets from UTC, and were converted to UTC.
        shown_in: zone in which the file shows times that are moments in UTC; None if it names no other.
        stamped: True if its rows have times of their own, such as a computer writes, whose clock may follow
            daylight saving; the clock of a device does not.
        samples: number of samples, None if only reading everything would show it.
        duration_s: length from headers and first and last pages, None if unknown.
        gyro_dps_per_lsb: deg/s in one count of each gyroscope axis, None without a gyroscope.
        others: further quantities that it recorded, which a reader gives if it is asked for them.
        thermometer: how words are read as temperatures; None where the file states degrees, or none.
        factory: the maker's calibration, if the reader applied one: counts are calibrated by it.
        companion: another file that says how to read the recording, such as a layout.
        calibrated: origin of a file of ours with calibrated values.
        zero_counts: counts of a row whose numbers in the file are all zero; not 0 where its reader takes away
            offsets.
        notes: what a user should know about how the file was understood.
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
    shown_in: str | None = None
    stamped: bool = False
    samples: int | None = None
    duration_s: float | None = None
    has_temperature: bool = False
    gyro_dps_per_lsb: tuple[float, float, float] | None = None
    others: tuple[OtherColumn, ...] = ()
    thermometer: ThermometerWord | None = None
    factory: FactoryCalibration | None = None
    companion: Path | None = None
    calibrated: Calibrated | None = None
    zero_counts: tuple[int, int, int] = (0, 0, 0)
    notes: tuple[str, ...] = ()

    @property
    def of_bare_sensor(self) -> bool:
        """True if the file holds counts of the bare sensor, to which the maker's calibration was applied."""
        return self.factory is not None and self.factory.acceleration is not None


@dataclass(frozen=True, slots=True)
class Problem:
    """Something wrong with a file that did not stop its reading.

    Attributes:
        code: stable lower-case name, such as `checksum` or `truncated`.
        byte_offset: place in the file (in the unpacked stream of a packed one), None if unknown.
        sample: number of the first sample after the problem.
        count: number of units (pages, rows, bytes: as the message says) that are affected.
        lost_bytes: number of bytes of the (uncompressed) file that could not be used because they are
            damaged; 0 for what is missing, repeated or normal.
        missing_bytes: number of bytes that are known to be missing from the file, since its header or its
            parts announce them. A file that breaks off in any other way has 0 and the code CUT_SHORT.
        empty_rows: number of rows without values, which are missing time and no damage.
        place: where in a table, for people: `from line 12 on`; empty in other files.
    """

    code: str
    message: str
    byte_offset: int | None
    sample: int
    count: int = 1
    lost_bytes: int = 0
    missing_bytes: int = 0
    empty_rows: int = 0
    place: str = ""

    def __str__(self) -> str:
        return self.message

    @property
    def told(self) -> str:
        """The message with the place, for people."""
        return f"{self.message}, {self.place}" if self.place else self.message


@dataclass(frozen=True, slots=True, eq=False)
class Chunk:
    """A stretch of consecutive rows, at most a few hundred thousand of them; may be empty.

    Attributes:
        first_sample: number of row 0 within the recording.
        counts: (n, 3) int16 or int32, raw counts of x, y, z.
        clock: the rows' times.
        end_byte: byte of the file up to which this chunk reaches, for progress.
        breaks: rows r in 0..n-1, ascending, before which the recording is not continuous (lost
            data, a jump of the clock); the recording's very first row is not one.
        clock_jumps: those of the breaks where only the clock jumps: in the file, the row directly follows the
            one before. Only a reader whose rows have stamps of their own knows that.
        temperature_mc: (n,) int32, thousandths of a degree Celsius, or None.
        gyro_counts: (n, 3) int16 or int32, or None.
        others: (n, k) of what `Recording.others` names, None if it was not asked for.
        validity: (n,) uint8 of `Validity`, or None if all rows were measured.
        problems: those found while reading these rows.
        used_bytes: number of bytes of the (uncompressed) file that these rows were made of, without
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
    others: Others | None = None
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
        """True if the first row does not continue the chunk before."""
        return len(self.breaks) > 0 and self.breaks[0] == 0

    def part(self, start: int, stop: int) -> Chunk:
        """Return rows start..stop-1 as views; problems and used bytes go with row 0."""
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
        """Return the rows of a mask (n,), with breaks where rows were left out.

        No break is known to be one of the clock alone any more.
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
        """Copy the rows to memory of their own, so that a few do not keep a whole chunk alive."""
        long = isinstance(self.clock, StampClock | JoinedClock)
        return replace(
            self,
            **cut_columns(self, CHANNELS, np.arange(len(self))),
            clock=StampClock(self.time_us.copy()) if long else self.clock,
        )


def first_row(counts: Counts) -> tuple[int, int, int]:
    """Return the first row of counts (n, 3)."""
    return three(counts[0].tolist())


def in_columns(chunk: Chunk) -> Chunk:
    """Return the rows with the counts of each axis contiguous, as most are read."""
    counts: Any = np.asfortranarray(chunk.counts)
    return replace(chunk, counts=counts)


def joined(chunks: Sequence[Chunk]) -> Chunk:
    """Join chunks that follow one another, at least one."""
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
    """Join clocks: two plain ones give times on demand, others are asked at once."""
    first, *others = (chunk.clock for chunk in chunks)
    if len(others) == 1 and not any(isinstance(clock, JoinedClock) for clock in (first, others[0])):
        return JoinedClock(first, len(chunks[0]), others[0])
    return StampClock(np.concatenate([chunk.time_us for chunk in chunks]))


def _joined_channel(chunks: Sequence[Chunk], name: str) -> Any:
    """Join a channel of chunks; if only some have it, fill it up or leave it out as CHANNELS says."""
    columns, missing = [getattr(chunk, name) for chunk in chunks], CHANNELS[name]
    known = [column is not None for column in columns]
    if not (all(known) if missing is None else any(known)):
        return None
    pairs = zip(chunks, columns, strict=True)
    return np.concatenate([np.full(len(c), missing) if column is None else column for c, column in pairs])


def clipped_at(chunk: Chunk, low: Any, high: Any) -> Chunk:
    """Return the chunk with measured rows marked that reach the limits of the sensor.

    Args:
        low, high: limits in counts, one for all axes or (3,).
    """
    counts = chunk.counts
    if not len(chunk) or (counts.min() > np.max(low) and counts.max() < np.min(high)):
        return chunk
    clipped = ((counts <= low) | (counts >= high)).any(axis=1)
    validity = np.zeros(len(chunk), np.uint8) if chunk.validity is None else chunk.validity.copy()
    validity[clipped & (validity == Validity.MEASURED)] = Validity.CLIPPED
    return replace(chunk, validity=validity)


def cut_columns(record: Any, names: Iterable[str], rows: Any) -> dict[str, Any]:
    """Return some rows (a slice, a mask or numbers) of the columns that a record has, by name."""
    cut = {}
    for name in names:
        column = getattr(record, name)
        if column is not None:
            cut[name] = column[rows]
    return cut


def cut_channels(channels: Channels, rows: Any) -> Channels:
    """Return some rows (a slice, a mask or numbers) of all channels."""
    return {name: values[rows] for name, values in channels.items()}


def joined_columns(records: Sequence[Any], names: Iterable[str]) -> dict[str, Any]:
    """Join columns of records, by name; None for a column that one of the records lacks."""
    parts = {name: [getattr(record, name) for record in records] for name in names}
    return {
        name: None if any(column is None for column in columns) else np.concatenate(columns)
        for name, columns in parts.items()
    }


def joined_channels(parts: Sequence[Channels]) -> Channels:
    """Join channels; a channel that one of the parts lacks is left out."""
    names = [name for name in parts[0] if all(name in part for part in parts)]
    return {name: np.concatenate([part[name] for part in parts]) for name in names}


@dataclass(frozen=True, slots=True)
class PlacedFile:
    """A file of a session of several, each of which is a recording of its own.

    Attributes:
        name: its name within the session.
        first_sample, samples: its first row within the whole, and the number of its rows.
        first_us: time of its first row in the session, on the device's clock.
        moved_us: time that was added to its own times.
        dated: True if its own times have a date.
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
    """Something that is closed at the end of a `with` block."""

    def close(self) -> None:
        """Release the file."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_failure: object) -> None:
        self.close()


class Intake:
    """Takes the bytes of one recording as they come, and gives its rows as `Reader.chunks` would.

    The rows do not depend on the pieces in which the bytes come. It holds no open file: a copy by
    `copy.deepcopy` continues from the same byte.
    """

    def take(self, data: bytes, *, last: bool) -> Iterator[Chunk]:
        """Yield the rows that are complete with these bytes, which follow those before.

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
        threads: number that may work at a time; a format may leave them unused.
        with_others: chunks hold `others`; to be set only where the recording has any.
        files: those of a session, once all its rows were read; empty for other recordings.
        may_hold_several: False where it is known that no later row is of another sensor.
    """

    recording: Recording
    threads: int = 1
    with_others: bool = False
    files: tuple[PlacedFile, ...] = ()
    may_hold_several: bool = True

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """Yield all rows in order, about `chunk_samples` at a time (whole pages, at least one).

        Raises:
            UnreadableError: the file cannot be read on at all.
        """
        raise NotImplementedError

    def intake(self) -> Intake:
        """Return what reads the recording's bytes from the first one on, as they come.

        Raises:
            UnreadableError: the format cannot be read as it grows.
        """
        raise UnreadableError(
            f"recordings of format {self.recording.format} are not read while they grow",
            path=self.recording.path,
            hint="use accelcal calibrate when it is complete",
        )

    def preview(self, chunk_samples: int, pieces: int) -> Iterator[Chunk]:
        """Yield up to `pieces` chunks spread over the file where it can be entered anywhere.

        Each begins again: rows of different pieces are not continuous. The default reads the
        first chunks.
        """
        for _, chunk in zip(range(pieces), self.chunks(chunk_samples), strict=False):
            yield chunk
