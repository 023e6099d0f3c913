"""Reads sound files by omconvert: the chunks that describe the recording, and its samples.

Metadata are lines of `key: value` in the chunks of a LIST of kind INFO: IART names the device, ICMT has the
first sample's time and the channels, and ICRD that time again.

The samples are not those of the device but resampled to an even rate, and calibrated if omconvert was asked
to. The last channel says of each sample whether it was measured and whether clipped, and now and then holds a
temperature.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions, agreed_rate, probe_file
from accelcal_cli.core.recording import Channels, Chunk, Device, Intake, Problem, Reader, Recording, Validity
from accelcal_cli.core.written_times import iso_start
from accelcal_cli.formats._bytes import ByteSource
from accelcal_cli.formats._frames import AFTER_BYTES, FIRST_ROWS, FrameFile, FrameIntake, FrameReader, Frames
from accelcal_cli.formats._rows import MISSING, first_values

FULL_SCALE, VALUE_BYTES, MOST_CHANNELS, MOST_RATE_HZ = 1 << 15, 2, 16, 48_000
ACCEL = ("Accel-X", "Accel-Y", "Accel-Z")
GYRO = ("Gyro-X", "Gyro-Y", "Gyro-Z")

UNAVAILABLE, CLIPPED = 0x8000, 0x4000
KIND, TEMPERATURE = 0x3C00, 0x0C00
CONTENT = 0x3FF
NO_SENSOR = (0, CONTENT)

NOT_MEASURED = "missing_value", "samples that the file marks as not measured, left out"
NO_START = "the file does not tell its time: times count from its start"
COPY_AGAIN = "convert the recording again with omconvert"
TEMPERATURE_NOTE = "temperature = raw * 75 / 256 - 50 degrees C"
RESAMPLED = "omconvert resampled the recording, and may have calibrated it"
FORM = struct.Struct("<HHIIHH")
PCM, EXTENSIBLE = 1, 0xFFFE
USUAL_START, CHUNK = 1024, struct.Struct("<4sI")
"""Bytes to which omconvert fills up the chunks before the samples, and the head of a chunk."""

_PAIR = re.compile(r"([^:\n]{1,64}):([^\n]*)")
_SCALE = re.compile(r"\d{1,6}(\.\d{1,6})?")


@dataclass(frozen=True, slots=True)
class Header:
    """The content of the chunks before the samples; None or empty for what they lack.

    Attributes:
        data_start, data_bytes: offset and length of the samples according to the header.
        channels: number of values in each sample.
        tag: kind of the samples, by the form.
        labels: what each channel holds, by its number from 0, such as `Accel-X`.
        scales: the physical value of 32768, by the same numbers.
        start_us: time of the first sample [us].
        damage: what is wrong with the chunks, in plain words.
    """

    data_start: int
    data_bytes: int
    channels: int
    rate_hz: int
    bits: int
    tag: int
    labels: dict[int, str]
    scales: dict[int, float]
    start_us: int | None
    device: Device
    damage: str | None


def parse_header(head: bytes) -> Header | None:
    """Read the chunks in a file's first bytes; None without the form of the samples, or without these."""
    chunks, start, size = _chunks(head)
    damage = None
    usual = head[USUAL_START - CHUNK.size : USUAL_START]
    if start is None and len(usual) == CHUNK.size and usual.startswith(b"data"):
        start, size = USUAL_START, CHUNK.unpack(usual)[1]
        damage = "the chunks before the samples are damaged"
    form = chunks.get(b"fmt ", b"")
    if start is None or len(form) < FORM.size:
        return None
    tag, channels, rate_hz, _, _, bits = FORM.unpack_from(form)
    comment = _pairs(chunks.get(b"ICMT", b""))
    names = _pairs(chunks.get(b"IART", b""))
    scales = _numbered(comment, "Scale-")
    texts = (comment.get("Time"), _text(chunks.get(b"ICRD", b"")))
    starts = [one for text in texts if (one := iso_start(text or "")) and one.timezone is None]
    return Header(
        data_start=start,
        data_bytes=size,
        channels=channels,
        rate_hz=rate_hz,
        bits=bits,
        tag=tag,
        labels=_numbered(comment, "Channel-"),
        scales={k: float(text) for k, text in scales.items() if _SCALE.fullmatch(text) and float(text) > 0},
        start_us=starts[0].start_us if starts else None,
        device=Device(names.get("Device"), names.get("Id"), names.get("Firmware")),
        damage=damage,
    )


def _chunks(head: bytes) -> tuple[dict[bytes, bytes], int | None, int]:
    """Return the chunks by name, also those of lists; and the offset and length of the samples."""
    found: dict[bytes, bytes] = {}
    at, end = 12, len(head)
    while at + CHUNK.size <= end:
        name, size = CHUNK.unpack_from(head, at)
        at += CHUNK.size
        if name == b"data":
            return found, at, size
        if name == b"LIST":
            at += 4
            continue
        found.setdefault(name, head[at : at + size])
        at += size + size % 2
    return found, None, 0


def _text(data: bytes) -> str:
    return data.split(b"\0")[0].decode("ascii", "replace")


def _pairs(data: bytes) -> dict[str, str]:
    """Return the lines of `key: value`."""
    return {match[1].strip(): match[2].strip() for match in _PAIR.finditer(_text(data))}


def _numbered(pairs: dict[str, str], prefix: str) -> dict[int, str]:
    """Return the values of keys such as `Channel-1`, by their numbers from 0."""
    keys = {key: key.removeprefix(prefix) for key in pairs if key.startswith(prefix)}
    return {int(number) - 1: pairs[key] for key, number in keys.items() if re.fullmatch(r"\d{1,2}", number)}


@dataclass(frozen=True, slots=True)
class Layout:
    """Which channels hold what, by their numbers from 0; `aux` is the last, with marks and temperatures.

    `gyro` is None without a gyroscope, or without its scale.
    """

    channels: int
    accel: tuple[int, ...]
    gyro: tuple[int, ...] | None
    aux: int | None

    def __call__(self, table: NDArray[np.uint8], _first: int = 0) -> Frames:
        """Decode samples (n, bytes) to rows."""
        values = table.view("<i2").astype(np.int16, copy=False)
        channels: Channels = {}
        if self.gyro is not None:
            channels["gyro_counts"] = values[:, self.gyro]
        xyz = values[:, self.accel]
        clipped = ((xyz == FULL_SCALE - 1) | (xyz == -FULL_SCALE)).any(axis=1)
        faulty = None
        if self.aux is not None:
            aux = np.ascontiguousarray(values[:, self.aux]).view(np.uint16)
            channels["temperature_mc"] = temperatures_mc(aux)
            clipped |= (aux & CLIPPED) != 0
            faulty = (aux & UNAVAILABLE) != 0
        validity = np.where(clipped, Validity.CLIPPED, Validity.MEASURED).astype(np.uint8)
        return Frames(xyz, faulty, validity if clipped.any() else None, channels)


def temperatures_mc(aux: NDArray[np.uint16]) -> NDArray[np.int32]:
    """Return thousandths of a degree C if the last channel holds a temperature, else MISSING, (n,)."""
    raw = aux & CONTENT
    measured = ((aux & KIND) == TEMPERATURE) & ~np.isin(raw, NO_SENSOR)
    scaled = (raw.astype(np.int32) * 75_000 + 128) // 256 - 50_000
    return np.where(measured, scaled, MISSING).astype(np.int32)


def layout_of(header: Header, path: Path) -> Layout:
    """Return the channels of the axes; raises UnreadableError if they are not samples by omconvert."""
    possible = 3 <= header.channels <= MOST_CHANNELS and 1 <= header.rate_hz <= MOST_RATE_HZ
    if header.tag not in (PCM, EXTENSIBLE) or header.bits != 8 * VALUE_BYTES or not possible:
        form = f"{header.channels} channels of {header.bits} bits at {header.rate_hz} Hz, kind {header.tag}"
        what = f"its samples ({form}) are not by omconvert"
        raise UnreadableError(what, path=path, byte_offset=12, hint=COPY_AGAIN)
    number = {label: k for k, label in header.labels.items() if k < header.channels}
    if not all(axis in number for axis in ACCEL):
        what = "its comment does not tell the channels of x, y and z"
        raise UnreadableError(what, path=path, byte_offset=12, hint=COPY_AGAIN)
    gyro = tuple(number[axis] for axis in GYRO if number.get(axis) in header.scales)
    last = header.channels - 1
    aux = number.get("Aux", last if last not in header.labels else None)
    accel = tuple(number[axis] for axis in ACCEL)
    return Layout(header.channels, accel, gyro if len(gyro) == len(GYRO) else None, aux)


class WavIntake(FrameIntake):
    """Reads a sound file as it grows."""

    def take(self, data: bytes, *, last: bool) -> Iterator[Chunk]:
        """See `Intake`; raises UnreadableError if more samples follow than the header announces."""
        yield from super().take(data, last=last)
        if len(self.after) == AFTER_BYTES and not self.after[:4].isalnum():
            what = "more samples follow than its header states"
            raise UnreadableError(what, byte_offset=4, hint="use accelcal calibrate when it is complete")


class WavReader(FrameReader):
    """Streams the samples of a file that may be growing."""

    def intake(self) -> Intake:
        """See `Reader`."""
        return WavIntake(self.recording, self._file, self._problems)


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a recording; `Format.open` says what is raised."""
    probe = probe_file(path, options)
    header = parse_header(probe.head)
    if header is None:
        what = "its chunks do not tell the form of its samples, or where they are"
        raise UnreadableError(what, path=path, byte_offset=12, hint=COPY_AGAIN)
    layout = layout_of(header, path)
    frame_bytes = layout.channels * VALUE_BYTES
    announced, damage = announced_bytes(header, path, None if probe.compressed else probe.size)
    frames, origin_us = None if announced is None else announced // frame_bytes, header.start_us or 0
    file = FrameFile(path, header.data_start, frame_bytes, frames, probe.compressed, origin_us, layout)
    file = replace(file, left_out=NOT_MEASURED, damaged=False, first_values=first_channel_values(file))
    problems = [Problem("damaged_header", text, 0, 0) for text in (header.damage, damage) if text]
    if header.start_us is None:
        problems.append(Problem("no_start_time", NO_START, 0, 0))
    reader = WavReader(describe(file, layout, header, options, probe.size), file, tuple(problems))
    first_us = reader.first_us()
    if first_us is None:
        what = "holds no sample that was measured"
        raise UnreadableError(what, path=path, byte_offset=file.start_byte, hint=COPY_AGAIN)
    if header.start_us is not None:
        reader.recording = replace(reader.recording, start_us=first_us)
    return reader


def announced_bytes(header: Header, path: Path, size: int | None) -> tuple[int | None, str | None]:
    """Return the length of the samples, None for up to the end of the file; and a contradiction.

    The header of a recording of more than 4 GiB only gives the remainder.
    """
    if size is None or header.data_start + header.data_bytes >= size:
        return header.data_bytes or None, None
    with ByteSource(path) as source:
        source.seek(header.data_start + header.data_bytes)
        after = source.read_exact(CHUNK.size)
    left = size - header.data_start - header.data_bytes
    if len(after) < CHUNK.size or (after[:4].isalnum() and CHUNK.unpack(after)[1] <= left):
        return header.data_bytes, None
    if left % (1 << 32) == 0:
        return None, None
    return None, f"the header states {header.data_bytes} bytes of samples; {left} more follow, which are read"


def first_channel_values(file: FrameFile) -> dict[str, int | None]:
    """Return the first temperature; None if the first samples have none."""
    with closing(ByteSource(file.path)) as source:
        source.seek(file.start_byte)
        data = source.read_exact(FIRST_ROWS * file.frame_bytes)
    whole = len(data) // file.frame_bytes * file.frame_bytes
    if not whole:
        raise UnreadableError("holds no sample", path=file.path, byte_offset=file.start_byte, hint=COPY_AGAIN)
    table = np.frombuffer(data, np.uint8, whole).reshape(-1, file.frame_bytes)
    return first_values(file.decode(table, 0).channels)


def describe(file: FrameFile, layout: Layout, header: Header, options: ReadOptions, size: int) -> Recording:
    """Return the description of the recording, whose axes need one scale unless the user gives it."""
    scales = {header.scales.get(axis) for axis in layout.accel}
    scale = scales.pop() if len(scales) == 1 else None
    if scale is None and options.lsb_per_g is None:
        hint = f"give --lsb-per-g (for a scale of 8: {FULL_SCALE // 8})"
        what = "its comment does not tell one scale of x, y and z"
        raise UnreadableError(what, path=file.path, byte_offset=12, hint=hint)
    dps = tuple(header.scales[axis] / FULL_SCALE for axis in layout.gyro or ())
    frames = None if file.compressed else file.whole_frames()
    has_temperature = file.first_values.get("temperature_mc") is not None
    return Recording(
        path=file.path,
        format="wav",
        rate_hz=agreed_rate(options, float(header.rate_hz), file.path),
        lsb_per_g=options.lsb_per_g or FULL_SCALE / (scale or 1),
        total_bytes=size,
        device=header.device,
        range_g=scale,
        duration_s=None if frames is None else frames / header.rate_hz,
        has_temperature=has_temperature,
        gyro_dps_per_lsb=(dps[0], dps[1], dps[2]) if dps else None,
        notes=(RESAMPLED, TEMPERATURE_NOTE) if has_temperature else (RESAMPLED,),
    )
