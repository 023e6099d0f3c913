"""Finding the packets of a Matrix file, damaged or not, a part of the file at a time.

A packet is a signature, a CRC-32 of all that follows, the times of its beginning and its end in whole
seconds, how many readings it holds of accelerometer, gyroscope, thermometers and heart rate, and these
readings as 16-bit integers. All numbers are little-endian. Source: github.com/wadpac/GGIRread,
R/readParmayMatrix.R.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Generator
from dataclasses import dataclass, field
from pathlib import Path

from accelcal_cli.formats._bytes import ByteSource
from accelcal_cli.formats._pages import places
from accelcal_cli.formats._pages.pages import CHECKSUM, GOOD, NO_PAGE
from accelcal_cli.formats._pages.places import Part
from accelcal_cli.formats.parmay import PACKET_MAGIC

HEAD = struct.Struct("<8sIIIIIII")
CHECKED_FROM = 12
READING_BYTES = (6, 6, 4, 4)
"""A reading of three axes, of three rates, of two temperatures, of two heart rates."""

USUAL_BYTES = 72_044
MOST_BYTES = 1 << 20
"""Devices write a packet when 12 000 samples are there; one that claims to be longer than this is damaged."""

PIECE_BYTES = 1 << 12
"""Read at a time at least."""


@dataclass(frozen=True, slots=True)
class Packet:
    """A sound packet.

    Attributes:
        start_s, end_s: seconds since 1970.
        numbers: how many readings of each kind.
        body: the readings.
    """

    start_s: int
    end_s: int
    numbers: tuple[int, int, int, int]
    body: bytes

    @property
    def rows(self) -> int:
        """Samples of the accelerometer."""
        return self.numbers[0]

    def part(self, kind: int) -> bytes:
        """The readings of a kind: 0 accelerometer, 1 gyroscope, 2 temperatures, 3 heart rates."""
        sizes = [number * size for number, size in zip(self.numbers, READING_BYTES, strict=True)]
        begin = sum(sizes[:kind])
        return self.body[begin : begin + sizes[kind]]


@dataclass(slots=True)
class Found(places.Found):
    """Places of a stretch of the file; `packets` are the GOOD ones, all with samples.

    Attributes:
        empty: sound packets without a sample, which are no places.
        cut_bytes: of the packet that the end of the file cuts off.
    """

    packets: list[Packet] = field(default_factory=list)
    empty: int = 0
    cut_bytes: int = 0


class Scanner:
    """Takes a file's bytes in stretches of any length; what is found does not depend on them.

    Every packet begins with its signature, at which the search goes on after damage; it never reaches over
    the next one.

    Args:
        offset: where in the file the bytes begin.
        inside: they may begin within a packet; what comes before the first one is passed over.
    """

    def __init__(self, offset: int, *, inside: bool = False) -> None:
        self._offset = offset
        self._rest = b""
        self._inside = inside
        self._other: int | None = None
        self._blank = b""

    def feed(self, data: bytes, *, last: bool) -> Found:
        """The places that can be seen whole in the bytes so far.

        Args:
            last: nothing follows.
        """
        text, found, index = self._rest + data, Found(), 0
        while True:
            at = text.find(PACKET_MAGIC, index)
            begin = at if at >= 0 else len(text) if last else max(index, len(text) - len(PACKET_MAGIC) + 1)
            self._pass_over(text, index, begin)
            index = begin
            end = None if at < 0 else self._end(text, at, last=last)
            if end is None:
                break
            self._close(at, found)
            self._inside = False
            self._take(text, at, end, found)
            index = min(end, len(text))
        if last:
            self._end_of_file(text, index, found)
        self._rest, self._offset = text[index:], self._offset + index
        return found

    def _end(self, text: bytes, at: int, *, last: bool) -> int | None:
        """Where the packet at `at` ends by its own numbers, or that the next one begins; None: not seen yet.

        Beyond the text for one that the end of the file cuts off.
        """
        begun = len(text) - at >= HEAD.size
        size = packet_bytes(text, at) if begun else HEAD.size
        end = at + (size if size <= MOST_BYTES else HEAD.size)
        reach = end + len(PACKET_MAGIC) - 1
        follower = text.find(PACKET_MAGIC, at + 1, reach)
        if follower >= 0:
            return follower
        return end if last or (begun and reach <= len(text)) else None

    def _take(self, text: bytes, at: int, end: int, found: Found) -> None:
        """Note what lies from `at` to `end`."""
        if end > len(text):
            found.cut, found.cut_bytes = self._offset + at, len(text) - at
            return
        packet = packet_of(text[at:end])
        if packet is None or packet.rows:
            found.place(CHECKSUM if packet is None else GOOD, self._offset + at, self._offset + end)
        if packet is not None and packet.rows:
            found.packets.append(packet)
        found.empty += packet is not None and not packet.rows

    def _pass_over(self, text: bytes, index: int, end: int) -> None:
        """What is no packet, which may be memory that was never written."""
        if index == end:
            return
        if self._other is None:
            self._other, self._blank = self._offset + index, text[index : index + 1]
        if text[index:end].strip(self._blank or b"\0"):
            self._blank = b""

    def _close(self, index: int, found: Found) -> None:
        """What was no packet reaches up to here."""
        if self._other is not None and not self._inside:
            found.place(NO_PAGE, self._other, self._offset + index)
        self._other = None

    def _end_of_file(self, text: bytes, index: int, found: Found) -> None:
        if self._blank not in (b"\0", b"\xff"):
            self._close(index, found)


def packet_bytes(text: bytes, at: int) -> int:
    """How long a packet is by its own numbers."""
    numbers: tuple[int, ...] = HEAD.unpack_from(text, at)[4:]
    return HEAD.size + sum(number * size for number, size in zip(numbers, READING_BYTES, strict=True))


def packet_of(data: bytes) -> Packet | None:
    """A packet, None if its length or checksum is wrong."""
    if len(data) < HEAD.size or packet_bytes(data, 0) != len(data):
        return None
    _, checksum, start_s, end_s, *numbers = HEAD.unpack_from(data)
    if zlib.crc32(memoryview(data)[CHECKED_FROM:]) != checksum:
        return None
    return Packet(start_s, end_s, (numbers[0], numbers[1], numbers[2], numbers[3]), data[HEAD.size :])


@dataclass(frozen=True, slots=True)
class PacketFile:
    """Where the packets lie.

    Attributes:
        start: where the first one begins, or the search for it, bytes.
        size: bytes on disk.
    """

    path: Path
    start: int
    size: int
    compressed: bool

    def parts(self, length: int, threads: int = 1) -> Generator[Part[Found]]:
        """All places of the file, of about `length` bytes at a time; a part may be empty.

        Args:
            threads: how many may work at a time on a gzip file.

        Raises:
            UnreadableError: the disk fails.
        """
        length = max(length, PIECE_BYTES)
        with ByteSource(self.path, threads) as source:
            source.read_exact(self.start)
            scanner, position, end, last = Scanner(self.start), 0, self.start, False
            while not last:
                data = source.read_exact(length)
                last, end = len(data) < length, end + len(data)
                found = scanner.feed(data, last=last)
                yield Part(position, found, end, source.disk_position(), last, source.broken)
                position += len(found.status)

    def piece(self, offset: int, length: int) -> Part[Found]:
        """The packets that lie whole within `length` bytes from `offset` on, in an uncompressed file."""
        with ByteSource(self.path) as source:
            source.seek(offset)
            data = source.read_exact(length)
        found = Scanner(offset, inside=True).feed(data, last=False)
        return Part(0, found, offset + len(data), offset + len(data), True)
