"""Records of log.bin: their form, cutting log.bin into them, and going on after damage.

A record has a header of eight bytes (separator 0x1E, kind, seconds since 1970, size of the payload,
little-endian), the payload, and one byte that makes the exclusive or over the whole record 0xFF. Source:
github.com/actigraph/GT3X-File-Format, README.md, "Log Record Format"; kinds 27 to 30 are named in pygt3x.

Records that describe the recording are read here too: LogRecords/Parameters.md (pairs of key and value,
floats of 24 bits with an exponent of 8) and LogRecords/Metadata.md ("Files Initialized in UTC").
"""

from __future__ import annotations

import json
from collections.abc import Generator, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.formats.gt3x.archive import MemberStream

HEADER_BYTES, SEPARATOR, SOUND = 8, 0x1E, 0xFF
FRAME_BYTES = HEADER_BYTES + 1
"""Length of header and checksum, the shortest record."""

LONGEST_BYTES = FRAME_BYTES + 0xFFFF
ACTIVITY, BATTERY, EVENT, HEART_RATE, LUX, METADATA, CAPSENSE = 0, 2, 3, 4, 5, 6, 13
PARAMETERS, SENSOR_SCHEMA, SENSOR_DATA = 21, 24, 25
ACTIVITY2, ACTIVITY3, TEMPERATURE = 26, 27, 30

_FIXED = {
    **{ACTIVITY: (1, 1152), BATTERY: (2, 2), EVENT: (1, 16), HEART_RATE: (1, 1), LUX: (2, 2)},
    **{7: (15, 15), CAPSENSE: (6, 6)},
    **{ACTIVITY2: (1, 1536), ACTIVITY3: (1, 1152)},
}
"""Shortest and longest payload of kinds whose size tells a record from other bytes; samples up to 256 Hz."""

_LOOSE = (METADATA, 17, 18, 20, PARAMETERS, 22, 23, SENSOR_SCHEMA, SENSOR_DATA)
_KINDS, _SHORT, _LONG = 31, 255, 4096
LONGEST_BELIEVED = FRAME_BYTES + _LONG

SEPARATOR_BYTE = bytes([SEPARATOR])
PADDING_BYTES = FRAME_BYTES - 1
"""Most zeros between records that are padding, as the format's document allows; more hide a record."""

FIRST_WALK, LONGEST_WALK = 64, 1 << 20
ALIKE, TOGETHER = 16, 256
"""Number of records of one length after which further ones are compared with it, and how many at a time."""

LOOK_AHEAD = 2 * LONGEST_BELIEVED

Key = tuple[int, int]
"""Address space and number of a parameter."""

IMU_TEMPERATURE_OFFSET = (0, 58)
ACCEL_SCALE, SAMPLE_RATE, START_TIME = (0, 55), (1, 10), (1, 12)
SENSOR_CONFIGURATION = (1, 44)

_PAIR = np.dtype([("space", "<u2"), ("number", "<u2"), ("value", "<u4")])

PIECE_BYTES = 3 << 20
"""Length of the pieces in which log.bin is read, so that nothing depends on the size of the chunks."""


@dataclass(frozen=True, slots=True, eq=False)
class Records:
    """Records of a buffer in file order, (k,) each.

    Attributes:
        start: where each begins in the buffer.
        second: seconds since 1970 on the device's clock.
        size: bytes of payload.
    """

    start: NDArray[np.int64]
    kind: NDArray[np.uint8]
    second: NDArray[np.int64]
    size: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.start)

    def select(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> Records:
        """Return some of the records, by a mask or by numbers."""
        return Records(self.start[which], self.kind[which], self.second[which], self.size[which])


def records_at(buffer: NDArray[np.uint8], start: NDArray[np.int64]) -> Records:
    """Return the headers of records that begin at `start` (k,); their eight bytes must lie in the buffer."""
    header = buffer[start[:, None] + np.arange(HEADER_BYTES)]
    second = np.ascontiguousarray(header[:, 2:6]).view("<u4")[:, 0].astype(np.int64)
    size = np.ascontiguousarray(header[:, 6:8]).view("<u2")[:, 0].astype(np.int64)
    return Records(start, header[:, 1], second, size)


def _limits() -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    low, high = np.zeros(256, np.int64), np.full(256, -1, np.int64)
    high[:_KINDS] = _SHORT
    fixed = np.zeros(256, np.bool_)
    high[list(_LOOSE)] = _LONG
    for kind, (shortest, longest) in _FIXED.items():
        low[kind], high[kind], fixed[kind] = shortest, longest, True
    return low, high, fixed


_LOW, _HIGH, _IS_FIXED = _limits()


def fits(records: Records) -> NDArray[np.bool_]:
    """Return whether kind and size go together, (k,)."""
    return np.asarray((records.size >= _LOW[records.kind]) & (records.size <= _HIGH[records.kind]))


@dataclass(frozen=True, slots=True)
class Span:
    """Seconds since 1970 between which a recording's records are expected."""

    first_s: int
    last_s: int


ANY_TIME = Span(0, 1 << 32)


@dataclass(frozen=True, eq=False)
class Page:
    """A piece of log.bin, from byte `base` on; `end_byte` is how far the file on the disk has been read."""

    data: bytes
    base: int
    last: bool
    span: Span
    end_byte: int = 0

    @cached_property
    def buffer(self) -> NDArray[np.uint8]:
        """The bytes, (n,)."""
        return np.frombuffer(self.data, np.uint8)

    @cached_property
    def believable(self) -> NDArray[np.int64]:
        """Where records begin that can be believed without knowing what comes before them.

        Their checksum is right, kind and size go together, and either the next such record
        follows or both time and size are those of a recording.
        """
        begin_before = max(0, len(self.data) - FRAME_BYTES + 1)
        records = records_at(self.buffer, np.flatnonzero(self.buffer[:begin_before] == SEPARATOR))
        inside = records.start + records.size + FRAME_BYTES <= len(self.data)
        records = records.select(inside & fits(records))
        end = records.start + records.size + FRAME_BYTES
        so_far = np.bitwise_xor.accumulate(self.buffer)
        before = np.where(records.start > 0, so_far[records.start - 1], 0)
        sound = (so_far[end - 1] ^ before) == SOUND
        records, end = records.select(sound), end[sound]
        near = (records.second >= self.span.first_s) & (records.second <= self.span.last_s)
        followed = np.isin(end, records.start) | (self.last & (end == len(self.data)))
        return np.asarray(records.start[followed | (near & _IS_FIXED[records.kind])])

    def incomplete(self, index: int) -> bool:
        """Return True if the bytes at `index` could be a record that continues beyond the piece."""
        left = len(self.data) - index
        return left < FRAME_BYTES or (self.data[index] == SEPARATOR and left < self.length(index))

    def length(self, index: int) -> int:
        """Return the length of the record at `index`, by its header."""
        return FRAME_BYTES + (self.data[index + 6] | self.data[index + 7] << 8)

    def after_padding(self, index: int) -> int:
        """Return where a record or the end of the data follows after a few zeros; else `index`."""
        ahead = self.data[index : index + FRAME_BYTES]
        zeros = len(ahead) - len(ahead.lstrip(b"\0"))
        ends = self.last and index + zeros == len(self.data) and zeros <= PADDING_BYTES
        return index + zeros if ends or ahead[zeros : zeros + 1] == SEPARATOR_BYTE else index

    def follow(self, index: int, most: int) -> tuple[list[int], int]:
        """Return sound records in a row from `index` on, up to `most`; and where the next should be."""
        starts, end = walk(self.data, index, most)
        if not starts:
            return starts, index
        start = np.array(starts, np.int64)
        sound = np.bitwise_xor.reduceat(self.buffer[:end], start) == SOUND
        goes_on = end == len(self.data) or self.data[end] == SEPARATOR
        sound[-1] &= goes_on or bool(fits(records_at(self.buffer, start[-1:]))[0])
        good = len(starts) if sound.all() else int(np.argmin(sound))
        return starts[:good], end if good == len(starts) else starts[good]


def walk(data: bytes, index: int, most: int) -> tuple[list[int], int]:
    """Return where complete records begin, by their sizes alone, and where the last of them ends."""
    starts: list[int] = []
    last, length, alike = len(data) - FRAME_BYTES, 0, 0
    while index <= last and data[index] == SEPARATOR and len(starts) < most:
        before, length = length, FRAME_BYTES + (data[index + 6] | data[index + 7] << 8)
        if index + length > len(data):
            break
        starts.append(index)
        index += length
        alike = alike + 1 if length == before else 0
        if alike == ALIKE:
            end = index + length * _as_long(data, index, length, most - len(starts))
            starts += range(index, end, length)
            index, alike = end, 0
    return starts, index


def _as_long(data: bytes, index: int, length: int, most: int) -> int:
    """Return how many complete records in a row, from `index` on, have this length, up to `most`."""
    number = min(most, TOGETHER, (len(data) - index) // length)
    rows = np.frombuffer(data, np.uint8, number * length, index).reshape(number, length)
    size = length - FRAME_BYTES
    fits = (rows[:, 0] == SEPARATOR) & (rows[:, 6] == size & 0xFF) & (rows[:, 7] == size >> 8)
    return number if fits.all() else int(fits.argmin())


def spoiled_records(data: bytes) -> int:
    """Return how many records the bytes are by their sizes, or 0; the first may lack its separator."""
    starts, reached = walk(SEPARATOR_BYTE + data[1:], 0, len(data))
    return len(starts) if reached == len(data) and any(data) else 0


@dataclass(frozen=True, slots=True)
class Damage:
    """Bytes that gave no record.

    Attributes:
        start_byte: where they begin in log.bin.
        size: number of bytes.
        records: number of records with a wrong checksum; 0 if the bytes are something else.
        before: number of sound records of the batch before them.
        cut_off: they are the beginning of a record at the end of the data.
    """

    start_byte: int
    size: int
    records: int
    before: int
    cut_off: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class RecordBatch:
    """Sound records of a piece of log.bin, and the damage between them.

    No record follows a doubtful one, (k,): with a damaged length it may be sound by chance.
    """

    page: Page
    records: Records
    doubtful: NDArray[np.bool_]
    damage: tuple[Damage, ...]


@dataclass(slots=True)
class _Framed:
    starts: list[int] = field(default_factory=list)
    doubtful: list[int] = field(default_factory=list)
    damage: list[Damage] = field(default_factory=list)


class Framer:
    """Cuts log.bin into records, in equal pieces; the records depend on nothing else."""

    def __init__(self, span: Span) -> None:
        self._span, self._rest, self._base = span, b"", 0
        self._lost: int | None = None
        self._most = FIRST_WALK

    def feed(self, data: bytes, *, last: bool, end_byte: int = 0) -> RecordBatch:
        """Return the records for which it is clear what follows them."""
        page = Page(self._rest + data, self._base, last, self._span, end_byte)
        framed, index = _Framed(), 0
        while index < len(page.data) and (more := self._step(page, index, framed)) is not None:
            index = more
        index = self._kept(page, index, framed)
        self._rest, self._base = page.data[index:], page.base + index
        doubtful = np.zeros(len(framed.starts), np.bool_)
        doubtful[framed.doubtful] = True
        records = records_at(page.buffer, np.array(framed.starts, np.int64))
        return RecordBatch(page, records, doubtful, tuple(framed.damage))

    def _step(self, page: Page, index: int, framed: _Framed) -> int | None:
        """Continue from `index`; return the next index, or None if more bytes are needed."""
        if self._lost is not None:
            return self._search(page, index, framed)
        starts, end = page.follow(index, self._most)
        framed.starts += starts
        if len(starts) == self._most:
            self._most = min(2 * self._most, LONGEST_WALK)
            return end
        if (after := page.after_padding(end)) > end:
            return after
        if end < len(page.data) and (page.last or not page.incomplete(end)):
            self._lost, self._most = page.base + end, FIRST_WALK  # there is no sound record
            if framed.starts and page.data[end] != SEPARATOR:
                framed.doubtful.append(len(framed.starts) - 1)
            return end
        return end if starts else None

    def _search(self, page: Page, index: int, framed: _Framed) -> int | None:
        """Find the next record after damage; note what lies before it: records, if their sizes lead there."""
        assert self._lost is not None
        place = np.searchsorted(page.believable, max(index, self._lost - page.base + 1))
        if place == len(page.believable) and not page.last:
            return None
        end = int(page.believable[place]) if place < len(page.believable) else len(page.data)
        lost, before = self._lost - page.base, len(framed.starts)
        records, cut_off = 0, False
        if lost >= 0:
            cut_off = page.last and end == len(page.data) and page.incomplete(lost)
            records = spoiled_records(page.data[lost:end])
        if records:
            framed.doubtful = [record for record in framed.doubtful if record != before - 1]
        framed.damage.append(Damage(self._lost, end - lost, records, before, cut_off))
        self._lost = None
        return end

    def _kept(self, page: Page, index: int, framed: _Framed) -> int:
        """Return where the bytes begin that are still needed: the last record, or those of two while lost."""
        if page.last:
            return len(page.data)
        if self._lost is not None:
            return max(index, len(page.data) - LOOK_AHEAD)
        return framed.starts.pop() if framed.starts else index


def batches(stream: MemberStream, span: Span, threads: int = 1) -> Generator[RecordBatch]:
    """Yield all records of log.bin; with several threads one of its own unpacks the pieces that follow."""
    framer = Framer(span)
    with closing(stream.pieces(PIECE_BYTES, threads)) as pieces:
        for piece in pieces:
            yield framer.feed(piece.data, last=piece.last, end_byte=piece.end_byte)


def payload(batch: RecordBatch, number: int) -> bytes:
    """Return the bytes of a record's payload."""
    start = int(batch.records.start[number]) + HEADER_BYTES
    return batch.page.data[start : start + int(batch.records.size[number])]


def payloads(batch: RecordBatch, kind: int) -> list[bytes]:
    """Return the payloads of all records of a kind."""
    return [payload(batch, number) for number in np.flatnonzero(batch.records.kind == kind).tolist()]


def parameters_in(batch: RecordBatch) -> dict[Key, int]:
    """Return parameters as 32-bit words; the last word of each counts."""
    values: dict[Key, int] = {}
    for data in payloads(batch, PARAMETERS):
        pairs = np.frombuffer(data, _PAIR, len(data) // _PAIR.itemsize).tolist()
        values |= {(space, number): value for space, number, value in pairs}
    return values


def number_of(parameters: Mapping[Key, int], key: Key) -> float | None:
    """Return a parameter that is a float; None if it is missing or 0."""
    word = parameters.get(key)
    return float_of(word) if word else None


def float_of(word: int) -> float:
    """Decode a float of the Simple Serial Protocol: fraction / 2^23 * 2^exponent, both signed."""
    fraction, exponent = word & 0xFFFFFF, word >> 24
    fraction -= (fraction & 0x800000) << 1
    exponent -= (exponent & 0x80) << 1
    return float(fraction / (1 << 23) * 2.0**exponent)


def in_utc(batch: RecordBatch) -> bool:
    """Return True if a metadata record says that the device's clock was set to UTC."""
    found: list[Any] = []
    for data in payloads(batch, METADATA):
        with suppress(ValueError, RecursionError):
            found.append(json.loads(data))
    logs = [one for one in found if isinstance(one, dict) and one.get("MetadataType") == "LocalTimeLog"]
    return any(one.get("UsedUtc") is True for one in logs)
