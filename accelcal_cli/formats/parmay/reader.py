"""Reads a Matrix file: its header, its packets, and what the first packets show of the recording.

A packet is a signature, a CRC-32 of all that follows, the times of its beginning and its end in whole
seconds, the numbers of its readings of accelerometer, gyroscope, thermometers and heart rate, and these
readings as 16-bit integers. All numbers are little-endian. The samples of a packet were taken between its two
times. Source: github.com/wadpac/GGIRread, R/readParmayMatrix.R.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, rate_fraction
from accelcal_cli.core.errors import COPY_AGAIN, UnreadableError
from accelcal_cli.core.formats import ReadOptions, agreed_rate, probe_file
from accelcal_cli.core.recording import Channels, Chunk, Device, Problem, Reader, Recording, clipped_at
from accelcal_cli.formats._pages.files import PageFile, ScannedPages
from accelcal_cli.formats._pages.pages import CHECKSUM, GOOD, NO_PAGE, Decoded, PageBlock, bad_runs
from accelcal_cli.formats._pages.reader import BROKEN_OFF, PageDecoder, PagedReader, PageScheme
from accelcal_cli.formats._pages.timeline import CoarseTimeline, Spacing
from accelcal_cli.formats._stamps import nice_rate
from accelcal_cli.formats.parmay import HEADER_BYTES, HEADER_MAGIC, PACKET_MAGIC, REMARKS_BYTES

RATES_HZ = (12.5, 25.0, 50.0, 100.0)
"""Rates to which devices are set; their sensors run up to 3 % off."""

POSSIBLE_HZ = (1, 2000)
NEAR, LONG_S = 0.1, 10
"""Share by which a rate is rounded to one of RATES_HZ; time [s] over which seconds show it well."""

RANGES_G = (2, 4, 8, 16)
FULL_SCALE = 1 << 15
FIRST_ROWS, TAIL_BYTES = 1 << 16, 1 << 18
"""Rows that describe the recording, and bytes at the end of the file that hold its last packet."""

TENTH_MC, CHECKED_FROM = 100, 12
"""Thousandths of a degree C in one unit of the thermometer, and where the checked bytes of a packet begin."""

HEADER = struct.Struct("<4sIHH")
HEAD = struct.Struct("<8sIIIIIII")
READING_BYTES = (6, 6, 4, 4)
"""Bytes of a reading of three axes, of three rates, of two temperatures, of two heart rates."""

USUAL_BYTES = 72_044
MOST_BYTES = 1 << 20
"""Longest packet; devices write one when 12 000 samples are there, and a longer one is damaged."""

LEAST_BYTES = 1 << 12
"""Least bytes that are scanned at a time: a packet is scanned again with each piece until it is whole."""

HELD = "missing_value", "packets with samples but no rotation rates, given the last one measured"


@dataclass(frozen=True, slots=True)
class Header:
    """The header before the first packet; a field is None if it is missing.

    Attributes:
        packets: the number that it announces.
        range_g, range_dps: ranges of accelerometer and gyroscope, +-.
        damage: what is wrong with the header, for people.
    """

    packets: int | None = None
    range_g: int | None = None
    range_dps: int | None = None
    damage: str | None = None


def parse_header(head: bytes) -> Header:
    """Read the 12 bytes, in a file's first bytes, between 512 bytes of remarks and the first packet."""
    whole = head.startswith(HEADER_MAGIC, REMARKS_BYTES)
    begin = REMARKS_BYTES if whole else head.find(PACKET_MAGIC) - HEADER.size
    if begin < 0 or not head.startswith(HEADER_MAGIC, begin) or len(head) < begin + HEADER.size:
        return Header(damage="the header before the first packet is missing or damaged")
    _, packets, range_g, range_dps = HEADER.unpack_from(head, begin)
    moved = f"the header does not lie at byte {REMARKS_BYTES}: bytes before it are missing"
    if range_g not in RANGES_G:
        return Header(packets, None, range_dps, f"the header gives an impossible range of {range_g} g")
    return Header(packets, range_g, range_dps, None if whole else moved)


@dataclass(frozen=True, slots=True)
class Packet:
    """A sound packet.

    Attributes:
        start_s, end_s: seconds since 1970.
        numbers: of readings of each kind.
        body: the readings.
    """

    start_s: int
    end_s: int
    numbers: tuple[int, int, int, int]
    body: bytes

    @property
    def rows(self) -> int:
        """Number of samples of the accelerometer."""
        return self.numbers[0]

    def part(self, kind: int) -> bytes:
        """Return the readings of a kind: 0 accelerometer, 1 gyroscope, 2 temperatures, 3 heart rates."""
        sizes = [number * size for number, size in zip(self.numbers, READING_BYTES, strict=True)]
        begin = sum(sizes[:kind])
        return self.body[begin : begin + sizes[kind]]

    @property
    def seconds(self) -> int:
        """Time from its beginning to its end."""
        return self.end_s - self.start_s


def packet_bytes(text: bytes, at: int) -> int:
    """Return how long a packet is by its own numbers."""
    numbers: tuple[int, ...] = HEAD.unpack_from(text, at)[4:]
    return HEAD.size + sum(number * size for number, size in zip(numbers, READING_BYTES, strict=True))


def packet_of(data: bytes) -> Packet | None:
    """Return a packet, None if its length or checksum is wrong."""
    if len(data) < HEAD.size or packet_bytes(data, 0) != len(data):
        return None
    _, checksum, start_s, end_s, *numbers = HEAD.unpack_from(data)
    if zlib.crc32(memoryview(data)[CHECKED_FROM:]) != checksum:
        return None
    return Packet(start_s, end_s, (numbers[0], numbers[1], numbers[2], numbers[3]), data[HEAD.size :])


@dataclass(slots=True)
class Packets(ScannedPages):
    """Packets of a stretch of the file, all with samples, and bytes of one that the end cuts off.

    Sound ones without a sample are not pages; those in the file so far are counted.
    """

    packets: list[Packet] = field(default_factory=list)
    empty: int = 0
    cut_bytes: int = 0


class PacketScanner:
    """Finds the packets in the bytes of a file; see Scanner in `_pages/files.py`.

    Every packet begins with its signature, at which the search continues after damage; a packet never reaches
    beyond the next signature.

    Args:
        offset: where in the file the bytes begin.
        inside: they may begin within a packet; what comes before the first one is passed over.
    """

    def __init__(self, offset: int, *, inside: bool = False) -> None:
        self._offset, self._inside, self._empty = offset, inside, 0
        self._rest = self._blank = b""
        self._other: int | None = None

    def feed(self, data: bytes, *, last: bool) -> Packets:
        """See Scanner."""
        text, found, index = self._rest + data, Packets(), 0
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
        if last and self._blank not in (b"\0", b"\xff"):
            self._close(index, found)
        self._rest, self._offset = text[index:], self._offset + index
        found.empty = self._empty
        return found

    def _end(self, text: bytes, at: int, *, last: bool) -> int | None:
        """Return where the packet at `at` ends: by its own numbers, or where the next one begins.

        None if that is not seen yet; beyond the text if the end of the file cuts the packet off.
        """
        begun = len(text) - at >= HEAD.size
        size = packet_bytes(text, at) if begun else HEAD.size
        end = at + (size if size <= MOST_BYTES else HEAD.size)
        reach = end + len(PACKET_MAGIC) - 1
        # a signature within the packet means that its numbers, or bytes of it, are lost
        follower = text.find(PACKET_MAGIC, at + 1, reach)
        if follower >= 0:
            return follower
        return end if last or (begun and reach <= len(text)) else None

    def _take(self, text: bytes, at: int, end: int, found: Packets) -> None:
        """Add what lies from `at` to `end`."""
        if end > len(text):
            found.cut_at, found.cut_bytes = self._offset + at, len(text) - at
            return
        packet = packet_of(text[at:end])
        if packet is None or packet.rows:
            found.add(CHECKSUM if packet is None else GOOD, self._offset + at, self._offset + end)
        if packet is not None and packet.rows:
            found.packets.append(packet)
        self._empty += packet is not None and not packet.rows

    def _pass_over(self, text: bytes, index: int, end: int) -> None:
        """Pass over bytes that are not a packet, which may be memory that was never written."""
        if index == end:
            return
        if self._other is None:
            self._other, self._blank = self._offset + index, text[index : index + 1]
        if text[index:end].strip(self._blank or b"\0"):
            self._blank = b""

    def _close(self, index: int, found: Packets) -> None:
        """End a stretch of bytes that are not a packet."""
        if self._other is not None and not self._inside:
            found.add(NO_PAGE, self._other, self._offset + index)
        self._other = None


@dataclass(frozen=True, slots=True)
class FirstPackets:
    """Properties of the recording that the first packets show.

    Attributes:
        rate: samples per second that the sensor really takes; it was set to `nominal_hz`.
        rows: samples of most packets.
        temperature_mc: the first measured temperature, None without any.
    """

    rate: Fraction
    nominal_hz: float
    rows: int
    temperature_mc: int | None
    has_gyro: bool

    @property
    def row_bytes(self) -> int:
        """Bytes of the file for each row."""
        return 12 if self.has_gyro else 6


def look_inside(file: PageFile[Packets], options: ReadOptions) -> FirstPackets | None:
    """Read on until there are packets of enough samples; return None if the file has no packet.

    Raises UnreadableError if their times do not show the rate and the user did not give it.
    """
    packets: list[Packet] = []
    with closing(file.blocks(USUAL_BYTES)) as blocks:
        for block in blocks:
            packets += block.packets
            if sum(packet.rows for packet in packets) >= FIRST_ROWS:
                break
    if not packets:
        return None
    rate, nominal_hz = _rates(packets, options, file.path)
    warm = (packet for packet in packets if packet.numbers[2])
    first = next((int(temperatures_mc(packet)[0]) for packet in warm), None)
    rows = Counter(packet.rows for packet in packets).most_common(1)[0][0]
    return FirstPackets(rate, nominal_hz, rows, first, any(packet.numbers[1] for packet in packets))


def _rates(packets: Sequence[Packet], options: ReadOptions, path: Path) -> tuple[Fraction, float]:
    """Return the sensor's rate, and the one to which it was set; the times or the user have to show it."""
    low, high = POSSIBLE_HZ
    timed = [one for one in packets if one.seconds > 0 and low <= one.rows / one.seconds <= high]
    timed = [packet for packet in timed if packet.seconds >= LONG_S] or timed
    if not timed:
        if options.rate_hz is None:
            what = "the times of its packets do not show the sampling rate"
            raise UnreadableError(what, path=path, byte_offset=HEADER_BYTES, hint="give it with --rate")
        return rate_fraction(options.rate_hz), options.rate_hz
    votes = Counter[float]()
    for packet in timed:
        votes[_nominal(_rate_of([packet]))] += packet.rows
    nominal = votes.most_common(1)[0][0]
    agreeing = [packet for packet in timed if _nominal(_rate_of([packet])) == nominal]
    return _rate_of(agreeing), nominal


def _rate_of(packets: Sequence[Packet]) -> Fraction:
    seconds = sum(packet.seconds for packet in packets)
    return Fraction(sum(packet.rows for packet in packets), seconds).limit_denominator(10_000)


def _nominal(rate: Fraction) -> float:
    """Return the rate to which a device was probably set."""
    nearest = min(RATES_HZ, key=lambda nominal: abs(float(rate) / nominal - 1))
    return nearest if abs(float(rate) / nearest - 1) <= NEAR else nice_rate(float(rate), 0.005)


def temperatures_mc(packet: Packet) -> NDArray[np.int32]:
    """Return a packet's skin temperatures [thousandths of a degree C], (n,), without those of the air."""
    pairs = np.frombuffer(packet.part(2), "<i2").reshape(-1, 2)
    return pairs[:, 0].astype(np.int32) * np.int32(TENTH_MC)


def spread_over(rows: int, readings: int) -> NDArray[np.int64]:
    """Return which of evenly spread readings each row takes, (rows,)."""
    return np.arange(rows, dtype=np.int64) * readings // rows


class PacketDecoder(PageDecoder[Packets]):
    """Decodes packets, of which a number is announced; repeats the last values where there are none."""

    def __init__(self, first: FirstPackets, announced: int) -> None:
        self._first, self._announced = first, announced
        self._temperature = first.temperature_mc
        self._rotation, self._held = np.zeros((1, 3), np.int16), 0
        self._end_s: int | None = None

    def decode(self, found: Packets) -> Decoded:
        """See PageDecoder."""
        status, packets = np.array(found.status, np.uint8), found.packets
        xyz = b"".join(packet.part(0) for packet in packets)
        block = PageBlock(
            position=found.first_position + np.flatnonzero(status == GOOD),
            rows=np.array([packet.rows for packet in packets], np.int64),
            counts=np.frombuffer(xyz, "<i2").reshape(-1, 3).astype(np.int16),
            time_us=np.array([packet.start_s for packet in packets], np.int64) * MICROSECONDS,
            fresh=np.array([self._is_fresh(packet) for packet in packets], np.bool_),
            channels=self._channels(packets),
        )
        return Decoded(block, bad_runs(status, found.first_position))

    def finish(self, chunk: Chunk) -> Chunk:
        """Mark rows that lie at the end of what 16 bits can tell."""
        chunk = replace(chunk, used_bytes=len(chunk) * self._first.row_bytes)
        return clipped_at(chunk, -FULL_SCALE, FULL_SCALE - 1)

    def ending(self, found: Packets, sample: int) -> tuple[Problem, ...]:
        """Return what is missing at the end of the file, and in packets."""
        problems = []
        if found.broken:
            problems.append(Problem("truncated", BROKEN_OFF, found.end, sample))
        if found.cut_at is not None:
            text = f"the file ends within a packet, of which it has {found.cut_bytes} bytes; left out"
            problems.append(Problem("truncated", text, found.cut_at, sample, 1, found.cut_bytes))
        lost = self._announced - found.next_position - found.empty - (found.cut_at is not None)
        if lost > 0:
            text = f"packets that the header announces are missing: {lost}"
            missing = lost * self._first.rows * self._first.row_bytes
            problems.append(Problem("truncated", text, found.end, sample, lost, 0, missing))
        if self._held:
            code, text = HELD
            problems.append(Problem(code, f"{text}: {self._held}", None, sample, self._held))
        return tuple(problems)

    def _is_fresh(self, packet: Packet) -> bool:
        """Return True if a packet begins more than rounding away from where the one before ended."""
        before, self._end_s = self._end_s, packet.end_s
        return before is not None and abs(packet.start_s - before) > 1

    def _channels(self, packets: Sequence[Packet]) -> Channels:
        channels: Channels = {}
        if self._first.temperature_mc is not None:
            warm = [self._temperatures(packet) for packet in packets]
            channels["temperature_mc"] = np.concatenate([np.empty(0, np.int32), *warm])
        if self._first.has_gyro:
            turn = [self._rotations(packet) for packet in packets]
            channels["gyro_counts"] = np.concatenate([np.empty((0, 3), np.int16), *turn])
        return channels

    def _temperatures(self, packet: Packet) -> NDArray[np.int32]:
        """Return for each row the reading of its share of the packet, or the last one before."""
        readings = temperatures_mc(packet)
        if not len(readings):
            return np.full(packet.rows, self._temperature, np.int32)
        self._temperature = int(readings[-1])
        return readings[spread_over(packet.rows, len(readings))]

    def _rotations(self, packet: Packet) -> NDArray[np.int16]:
        readings = np.frombuffer(packet.part(1), "<i2").reshape(-1, 3).astype(np.int16)
        self._held += not len(readings)
        readings = readings if len(readings) else self._rotation
        self._rotation = readings[-1:]
        return readings if len(readings) == packet.rows else readings[spread_over(packet.rows, len(readings))]


@dataclass(frozen=True, slots=True)
class PacketScheme(PageScheme[Packets]):
    """Describes how the packets of one file are read."""

    file: PageFile[Packets]

    def amount(self, chunk_samples: int) -> int:
        """Return the bytes of `chunk_samples` rows, whether these are whole packets or not."""
        return max(LEAST_BYTES, chunk_samples * self.file.page_bytes // self.spacing.rows)

    def pieces(self, chunk_samples: int, pieces: int) -> Iterator[tuple[int, Packets]]:
        """Enter at evenly spread bytes, if the file is long enough."""
        file = self.file
        length = max(self.amount(chunk_samples), 2 * USUAL_BYTES)
        if file.compressed or file.size < pieces * length:
            return
        for piece in range(pieces):
            offset = file.start_byte + piece * (file.size - file.start_byte) // pieces
            data = file.read(offset, length)
            yield 0, PacketScanner(offset, inside=True).feed(data, last=False).alone(offset + len(data))


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a recording; `Format.open` says what is raised."""
    probe = probe_file(path, options)
    header = parse_header(probe.head)
    start = HEADER_BYTES if header.damage is None else max(0, probe.head.find(PACKET_MAGIC))
    file = PageFile(path, start, USUAL_BYTES, probe.size, probe.compressed, PacketScanner)
    first = look_inside(file, options)
    if first is None:
        raise UnreadableError("holds no sound packet", path=path, byte_offset=start, hint=COPY_AGAIN)
    if header.range_g is None and options.lsb_per_g is None:
        hint = f"give --lsb-per-g to read it without (for a range of 8 g: {FULL_SCALE // 8})"
        raise UnreadableError(header.damage or "", path=path, byte_offset=start, hint=hint)
    first = replace(first, has_gyro=first.has_gyro and bool(header.range_dps))
    spacing = Spacing(first.rate, first.rows)
    scheme = PacketScheme(
        replace(file, page_bytes=first.rows * first.row_bytes),
        spacing,
        decoder=lambda: PacketDecoder(first, header.packets or 0),
        timeline=lambda: CoarseTimeline(spacing, MICROSECONDS),
        problems=() if header.damage is None else (Problem("damaged_header", header.damage, 0, 0),),
    )
    return PagedReader(describe(scheme, first, header, options), scheme)


def describe(scheme: PacketScheme, first: FirstPackets, header: Header, options: ReadOptions) -> Recording:
    """Describe the recording."""
    path, start_us = scheme.file.path, scheme.first_time_us()
    gyro = (header.range_dps or 0) / FULL_SCALE if first.has_gyro else 0.0
    return Recording(
        path=path,
        format="parmay",
        rate_hz=agreed_rate(options, first.nominal_hz, path),
        lsb_per_g=options.lsb_per_g or FULL_SCALE / (header.range_g or 1),
        total_bytes=scheme.file.size,
        device=Device(model="Matrix"),
        range_g=None if header.range_g is None else float(header.range_g),
        start_us=start_us,
        timezone="UTC",
        duration_s=duration_s(scheme.file, start_us),
        has_temperature=first.temperature_mc is not None,
        gyro_dps_per_lsb=(gyro, gyro, gyro) if gyro else None,
    )


def duration_s(file: PageFile[Packets], start_us: int) -> float | None:
    """Return the time from the first sample to the end of the last packet [s], None if that is not found."""
    if file.compressed:
        return None
    end = replace(file, start_byte=max(file.start_byte, file.size - TAIL_BYTES))
    with closing(end.blocks(TAIL_BYTES)) as blocks:
        packets = [packet for block in blocks for packet in block.packets]
    lasted_us = packets[-1].end_s * MICROSECONDS - start_us if packets else 0
    return lasted_us / MICROSECONDS if lasted_us > 0 else None
