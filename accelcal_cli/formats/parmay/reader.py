"""An open Matrix file: what is known of the recording, and its rows.

The samples of a packet were taken between its two times. What most of the first packets show, such as how
fast the sensor really is, describes the recording.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, rate_fraction
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions, agreed_rate, probe_file
from accelcal_cli.core.recording import Channels, Chunk, Device, Intake, Problem, Reader, Recording, Validity
from accelcal_cli.formats._pages.pages import GOOD, Decoded, PageBlock, bad_runs
from accelcal_cli.formats._pages.places import Part, PartPlaces, PlaceCutter
from accelcal_cli.formats._pages.reader import PageJoiner, first_time
from accelcal_cli.formats._pages.timeline import CoarseTimeline, Spacing
from accelcal_cli.formats._stamps import nice_rate
from accelcal_cli.formats.parmay import HEADER_BYTES, HEADER_MAGIC, PACKET_MAGIC, REMARKS_BYTES
from accelcal_cli.formats.parmay.packets import USUAL_BYTES, Found, Packet, PacketFile, Scanner

RATES_HZ = (12.5, 25.0, 50.0, 100.0)
"""To which devices are set; their sensors run up to 3 % off."""

POSSIBLE_HZ = (1, 2000)
NEAR = 0.1
LONG_S = 10
RANGES_G = (2, 4, 8, 16)
FULL_SCALE = 1 << 15
UNIT_US = MICROSECONDS
FIRST_ROWS = 1 << 16
TAIL_BYTES = 1 << 18
TENTH_MC = 100
HEADER = struct.Struct("<4sIHH")

COPY_AGAIN = "copy it again from the device"
BROKEN_OFF = "the compressed data is damaged or ends early"
HELD = "missing_value", "packets with samples but no rotation rates, given the last one measured"


@dataclass(frozen=True, slots=True)
class Header:
    """What stands before the first packet; None if it does not.

    Attributes:
        packets: how many it announces.
        range_g, range_dps: of accelerometer and gyroscope, +-.
        damage: what is wrong with it, in plain words.
    """

    packets: int | None = None
    range_g: int | None = None
    range_dps: int | None = None
    damage: str | None = None


def parse_header(head: bytes) -> Header:
    """Read the 12 bytes before the first packet, which belong behind 512 bytes of remarks.

    Args:
        head: the file's first bytes.
    """
    whole = head.startswith(HEADER_MAGIC, REMARKS_BYTES)
    begin = REMARKS_BYTES if whole else head.find(PACKET_MAGIC) - HEADER.size
    if begin < 0 or not head.startswith(HEADER_MAGIC, begin) or len(head) < begin + HEADER.size:
        return Header(damage="the header before the first packet is missing or damaged")
    _, packets, range_g, range_dps = HEADER.unpack_from(head, begin)
    damage = (
        None if whole else f"the header does not lie at byte {REMARKS_BYTES}: bytes before it are missing"
    )
    if range_g not in RANGES_G:
        return Header(packets, None, range_dps, f"the header gives an impossible range of {range_g} g")
    return Header(packets, range_g, range_dps, damage)


@dataclass(frozen=True, slots=True)
class FirstPackets:
    """What the first packets show.

    Attributes:
        rate: samples per second that the sensor really takes.
        nominal_hz: to which it was set.
        rows: samples of most packets.
        temperature_mc: the first one measured, None without any.
        has_gyro: whether there are rotation rates.
    """

    rate: Fraction
    nominal_hz: float
    rows: int
    temperature_mc: int | None
    has_gyro: bool


def look_inside(file: PacketFile, options: ReadOptions) -> FirstPackets | None:
    """Read on until there are packets of enough samples; None if there is none in the whole file.

    Raises:
        UnreadableError: their times do not show the rate, which the user did not give.
    """
    packets: list[Packet] = []
    with closing(file.parts(USUAL_BYTES)) as parts:
        for part in parts:
            packets += part.found.packets
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
    """The sensor's rate and the one it was set to."""
    timed = [packet for packet in packets if _is_timed(packet)]
    timed = [packet for packet in timed if packet.end_s - packet.start_s >= LONG_S] or timed
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


def _is_timed(packet: Packet) -> bool:
    """Whether a packet's times can be right."""
    seconds = packet.end_s - packet.start_s
    return seconds > 0 and POSSIBLE_HZ[0] <= packet.rows / seconds <= POSSIBLE_HZ[1]


def _rate_of(packets: Sequence[Packet]) -> Fraction:
    seconds = sum(packet.end_s - packet.start_s for packet in packets)
    return Fraction(sum(packet.rows for packet in packets), seconds).limit_denominator(10_000)


def _nominal(rate: Fraction) -> float:
    """The rate that a device was probably set to."""
    nearest = min(RATES_HZ, key=lambda nominal: abs(float(rate) / nominal - 1))
    return nearest if abs(float(rate) / nearest - 1) <= NEAR else nice_rate(float(rate))


def temperatures_mc(packet: Packet) -> NDArray[np.int32]:
    """A packet's readings of the thermometer on the skin [thousandths of a degree C], (n,).

    Beside each stands one of the air.
    """
    pairs = np.frombuffer(packet.part(2), "<i2").reshape(-1, 2)
    return pairs[:, 0].astype(np.int32) * np.int32(TENTH_MC)


def rates(packet: Packet) -> NDArray[np.int16]:
    """Rotation rates of a packet, (n, 3)."""
    return np.frombuffer(packet.part(1), "<i2").reshape(-1, 3).astype(np.int16)


def spread_over(rows: int, readings: int) -> NDArray[np.int64]:
    """Which of so many evenly spread readings each row takes, (rows,)."""
    return np.arange(rows, dtype=np.int64) * readings // rows


class Decoder:
    """Decodes the packets of a file in their order; keeps the last temperature and rotation rate.

    Attributes:
        held: packets without rotation rates so far, in a recording that has them.
    """

    def __init__(self, first: FirstPackets) -> None:
        self._first = first
        self._temperature = first.temperature_mc
        self._rotation = np.zeros((1, 3), np.int16)
        self._end_s: int | None = None
        self.held = 0

    def __call__(self, found: Found, first_position: int) -> Decoded:
        """The packets that are right, and the others.

        Args:
            first_position: number of the first place within the file.
        """
        status = np.array(found.status, np.uint8)
        packets = found.packets
        rows = np.array([packet.rows for packet in packets], np.int64)
        xyz = b"".join(packet.part(0) for packet in packets)
        block = PageBlock(
            position=first_position + np.flatnonzero(status == GOOD),
            rows=rows,
            counts=np.frombuffer(xyz, "<i2").reshape(-1, 3).astype(np.int16),
            time_us=np.array([packet.start_s for packet in packets], np.int64) * MICROSECONDS,
            fresh=np.array([self._is_fresh(packet) for packet in packets], np.bool_),
            channels=self._channels(packets),
        )
        return Decoded(block, bad_runs(status, first_position), b"")

    def _is_fresh(self, packet: Packet) -> bool:
        """Whether a packet begins later or earlier than the one before ended, by more than rounding."""
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
        """Of each row: the reading of its share of the packet, or the last one before."""
        readings = temperatures_mc(packet)
        if not len(readings):
            return np.full(packet.rows, self._temperature, np.int32)
        self._temperature = int(readings[-1])
        return readings[spread_over(packet.rows, len(readings))]

    def _rotations(self, packet: Packet) -> NDArray[np.int16]:
        readings = rates(packet)
        self.held += not len(readings)
        readings = readings if len(readings) else self._rotation
        self._rotation = readings[-1:]
        return readings if len(readings) == packet.rows else readings[spread_over(packet.rows, len(readings))]


@dataclass(frozen=True, slots=True)
class Scheme:
    """How to read the packets of one file."""

    file: PacketFile
    first: FirstPackets
    announced: int | None
    problems: tuple[Problem, ...] = ()

    @property
    def spacing(self) -> Spacing:
        """Of the samples, at the sensor's own rate."""
        return Spacing(self.first.rate, self.first.rows)

    @property
    def row_bytes(self) -> int:
        """Of the file for each row."""
        return 12 if self.first.has_gyro else 6

    def stream(self, chunk_samples: int, threads: int = 1) -> Generator[Chunk]:
        """All rows of the file, whole packets; so many threads may work on a gzip file."""
        assembler = Assembler(self, 0, self.problems)
        with closing(self.file.parts(chunk_samples * self.row_bytes, threads)) as parts:
            for part in parts:
                chunk = assembler.feed_file(part)
                if len(chunk) or chunk.problems:
                    yield chunk


class Assembler:
    """Takes the parts of a file in order and gives a chunk for each."""

    def __init__(self, scheme: Scheme, sample: int, problems: tuple[Problem, ...]) -> None:
        self._scheme = scheme
        self._places = PartPlaces(USUAL_BYTES)
        self._decode = Decoder(scheme.first)
        timeline = CoarseTimeline(scheme.spacing, UNIT_US)
        self._joiner = PageJoiner(self._places, scheme.spacing, timeline, sample, {}, problems)
        self._empty = 0

    def feed(self, part: Part[Found]) -> Chunk:
        """Add a part; the last one releases everything."""
        self._places.part = part
        self._empty += part.found.empty
        chunk = self._joiner.feed(part, self._decode(part.found, part.first_position))
        return marked(replace(chunk, used_bytes=len(chunk) * self._scheme.row_bytes))

    def feed_file(self, part: Part[Found]) -> Chunk:
        """The same of a whole file, whose end may be told."""
        chunk = self.feed(part)
        return replace(chunk, problems=chunk.problems + self._ending(part, chunk)) if part.last else chunk

    def _ending(self, part: Part[Found], chunk: Chunk) -> tuple[Problem, ...]:
        """What is missing at the end of the file, and in packets."""
        sample, found, problems = chunk.first_sample + len(chunk), part.found, []
        if part.broke_off:
            problems.append(Problem("truncated", BROKEN_OFF, part.end, sample))
        if found.cut is not None:
            text = f"the file ends within a packet, of which it has {found.cut_bytes} bytes; left out"
            problems.append(Problem("truncated", text, found.cut, sample, 1, found.cut_bytes))
        seen = part.next_position + self._empty + (found.cut is not None)
        lost = (self._scheme.announced or 0) - seen
        if lost > 0:
            text = f"packets that the header announces are missing: {lost}"
            problems.append(Problem("truncated", text, part.end, sample, lost))
        if self._decode.held:
            code, text = HELD
            problems.append(Problem(code, f"{text}: {self._decode.held}", None, sample, self._decode.held))
        return tuple(problems)


def marked(chunk: Chunk) -> Chunk:
    """The chunk with rows marked that lie at the end of what 16 bits can tell."""
    ends = np.iinfo(np.int16)
    clipped = ((chunk.counts == ends.min) | (chunk.counts == ends.max)).any(axis=1)
    if not clipped.any():
        return chunk
    return replace(chunk, validity=np.where(clipped, Validity.CLIPPED, Validity.MEASURED).astype(np.uint8))


class ParmayIntake(Intake):
    """Takes a recording as it grows."""

    def __init__(self, scheme: Scheme) -> None:
        start = scheme.file.start
        self._cutter = PlaceCutter(Scanner(start), start)
        self._assembler = Assembler(scheme, 0, scheme.problems)

    def take(self, data: bytes, *, last: bool) -> Iterator[Chunk]:
        """See `Intake`."""
        part = self._cutter.cut(data, last=last)
        if part.found.status or part.found.empty or last:
            yield self._assembler.feed_file(part)


class ParmayReader(Reader):
    """Streams the packets; each call of `chunks` reads the file from its beginning."""

    def __init__(self, recording: Recording, scheme: Scheme) -> None:
        self.recording = recording
        self._scheme = scheme

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """Yield all rows in order, whole packets."""
        return self._scheme.stream(chunk_samples, self.threads)

    def intake(self) -> Intake:
        """See `Reader`."""
        return ParmayIntake(self._scheme)

    def preview(self, chunk_samples: int, pieces: int) -> Iterator[Chunk]:
        """Enter the file at evenly spread bytes; a short or gzip file gives its first chunks."""
        file = self._scheme.file
        length = max(chunk_samples * self._scheme.row_bytes, 2 * USUAL_BYTES)
        if file.compressed or file.size < pieces * length:
            yield from super().preview(chunk_samples, pieces)
            return
        for piece in range(pieces):
            part = file.piece(file.start + piece * (file.size - file.start) // pieces, length)
            chunk = Assembler(self._scheme, 0, ()).feed(part)
            if len(chunk) or chunk.problems:
                yield chunk


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a recording.

    Raises:
        UnreadableError: no packet is sound; the header is damaged and `lsb_per_g` not given; or the packets'
            times do not show the rate, which is not given either.
        UsageError: the user's rate contradicts that of the packets.
    """
    probe = probe_file(path, options)
    header = parse_header(probe.head)
    start = HEADER_BYTES if header.damage is None else max(0, probe.head.find(PACKET_MAGIC))
    file = PacketFile(path, start, probe.size, probe.compressed)
    first = look_inside(file, options)
    if first is None:
        raise UnreadableError("holds no sound packet", path=path, byte_offset=start, hint=COPY_AGAIN)
    if header.range_g is None and options.lsb_per_g is None:
        hint = f"give --lsb-per-g to read it without (for a range of 8 g: {FULL_SCALE // 8})"
        raise UnreadableError(header.damage or "", path=path, byte_offset=start, hint=hint)
    problems = () if header.damage is None else (Problem("damaged_header", header.damage, 0, 0),)
    first = replace(first, has_gyro=first.has_gyro and bool(header.range_dps))
    scheme = Scheme(file, first, header.packets, problems)
    return ParmayReader(describe(scheme, header, options), scheme)


def describe(scheme: Scheme, header: Header, options: ReadOptions) -> Recording:
    """What is known of the recording."""
    first, path = scheme.first, scheme.file.path
    start_us = first_time(scheme.stream(FIRST_ROWS))
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
        duration_s=duration_s(scheme, start_us),
        has_temperature=first.temperature_mc is not None,
        gyro_dps_per_lsb=(gyro, gyro, gyro) if gyro else None,
    )


def duration_s(scheme: Scheme, start_us: int) -> float | None:
    """From the first sample to the end of the last packet [s], None if that is not found."""
    file = scheme.file
    if file.compressed:
        return None
    offset = max(file.start, file.size - TAIL_BYTES)
    with closing(PacketFile(file.path, offset, file.size, file.compressed).parts(TAIL_BYTES)) as parts:
        packets = [packet for part in parts for packet in part.found.packets]
    lasted_us = packets[-1].end_s * MICROSECONDS - start_us if packets else 0
    return lasted_us / MICROSECONDS if lasted_us > 0 else None
