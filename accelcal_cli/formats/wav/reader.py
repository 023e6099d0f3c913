"""An open sound file by omconvert: what is known of the recording, and its rows.

Its samples are not those of the device but resampled to an even rate, and calibrated if omconvert was told
so. The last channel says of each sample whether it was measured and whether clipped, and now and then what a
thermometer measured.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions, agreed_rate, probe_file
from accelcal_cli.core.recording import Channels, Chunk, Intake, Problem, Reader, Recording, Validity
from accelcal_cli.formats._bytes import ByteSource
from accelcal_cli.formats._frames import AFTER_BYTES, FIRST_ROWS, FrameFile, FrameIntake, FrameReader, Frames
from accelcal_cli.formats._rows import MISSING, first_values
from accelcal_cli.formats.wav.header import CHUNK, EXTENSIBLE, PCM, Header, parse_header

FULL_SCALE = 1 << 15
VALUE_BYTES = 2
MOST_CHANNELS = 16
MOST_RATE_HZ = 48_000
ACCEL = ("Accel-X", "Accel-Y", "Accel-Z")
GYRO = ("Gyro-X", "Gyro-Y", "Gyro-Z")

UNAVAILABLE, CLIPPED = 0x8000, 0x4000
KIND, TEMPERATURE = 0x3C00, 0x0C00
CONTENT = 0x3FF
NO_SENSOR = (0, CONTENT)

NOT_MEASURED = "missing_value", "samples that the file marks as not measured, left out"
NO_START = "the file does not tell its time: times count from its start"
COPY_AGAIN = "convert the recording again with omconvert"
WARM = "temperature = raw * 75 / 256 - 50 degrees C"
RESAMPLED = "omconvert resampled the recording, and may have calibrated it"


@dataclass(frozen=True, slots=True)
class Layout:
    """Which channels hold what, by their numbers from 0.

    Attributes:
        gyro: None without one, or without its scale.
        aux: the last channel, None without it.
    """

    channels: int
    accel: tuple[int, ...]
    gyro: tuple[int, ...] | None
    aux: int | None

    def __call__(self, table: NDArray[np.uint8], _first: int = 0) -> Frames:
        """Samples (n, bytes) as rows."""
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
    """Thousandths of a degree C where the last channel holds a temperature, else MISSING, (n,)."""
    raw = aux & CONTENT
    measured = ((aux & KIND) == TEMPERATURE) & ~np.isin(raw, NO_SENSOR)
    scaled = (raw.astype(np.int32) * 75_000 + 128) // 256 - 50_000
    return np.where(measured, scaled, MISSING).astype(np.int32)


def layout_of(header: Header, path: Path) -> Layout:
    """Where the axes are.

    Raises:
        UnreadableError: the form is not that of omconvert's samples, or an axis has no channel.
    """
    if (
        header.tag not in (PCM, EXTENSIBLE)
        or header.bits != 8 * VALUE_BYTES
        or not 3 <= header.channels <= MOST_CHANNELS
        or not 1 <= header.rate_hz <= MOST_RATE_HZ
    ):
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
    """Takes a sound file as it grows."""

    def take(self, data: bytes, *, last: bool) -> Iterator[Chunk]:
        """See `Intake`; raises UnreadableError where more samples follow than the header tells of."""
        yield from super().take(data, last=last)
        if len(self.after) == AFTER_BYTES and not self.after[:4].isalnum():
            what = "more samples follow than its header tells of"
            raise UnreadableError(what, byte_offset=4, hint="use accelcal calibrate when it is complete")


class WavReader(FrameReader):
    """Streams the samples, from a file that may be growing."""

    def intake(self) -> Intake:
        """See `Reader`."""
        return WavIntake(self.recording, self._file, self._problems)


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a recording.

    Raises:
        UnreadableError: the form, the samples, the channels or their scale are not told, or there are none.
        UsageError: the user's rate contradicts the file's.
    """
    probe = probe_file(path, options)
    header = parse_header(probe.head)
    if header is None:
        what = "its chunks do not tell the form of its samples, or where they are"
        raise UnreadableError(what, path=path, byte_offset=12, hint=COPY_AGAIN)
    layout = layout_of(header, path)
    frame_bytes = layout.channels * VALUE_BYTES
    announced, damage = announced_bytes(header, path, None if probe.compressed else probe.size)
    file = FrameFile(
        path,
        header.data_start,
        frame_bytes,
        None if announced is None else announced // frame_bytes,
        probe.compressed,
        header.start_us or 0,
        layout,
        left_out=NOT_MEASURED,
        damaged=False,
    )
    file = replace(file, first_values=first_of(file))
    problems = [Problem("damaged_header", text, 0, 0) for text in (header.damage, damage) if text]
    if header.start_us is None:
        problems.append(Problem("no_start_time", NO_START, 0, 0))
    reader = WavReader(describe(file, layout, header, options, probe.size), file, tuple(problems))
    first_us = reader.first_us()
    if first_us is None:
        what = "holds no sample that was measured"
        raise UnreadableError(what, path=path, byte_offset=file.start_byte, hint=COPY_AGAIN)
    start_us = None if header.start_us is None else first_us
    reader.recording = replace(reader.recording, start_us=start_us)
    return reader


def announced_bytes(header: Header, path: Path, size: int | None) -> tuple[int | None, str | None]:
    """How long the samples should be, None for up to the end of the file; and what contradicts that.

    Of a recording of more than 4 GiB the header tells only the rest.
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
    return (
        None,
        f"the header tells of {header.data_bytes} bytes of samples; {left} more follow, which are read",
    )


def first_of(file: FrameFile) -> dict[str, int | None]:
    """The first temperature, None if there is none among the first samples."""
    with closing(ByteSource(file.path)) as source:
        file.enter(source, 0)
        data = source.read_exact(FIRST_ROWS * file.frame_bytes)
    whole = len(data) // file.frame_bytes * file.frame_bytes
    if not whole:
        raise UnreadableError("holds no sample", path=file.path, byte_offset=file.start_byte, hint=COPY_AGAIN)
    table = np.frombuffer(data, np.uint8, whole).reshape(-1, file.frame_bytes)
    return first_values(file.decode(table, 0).channels)


def describe(file: FrameFile, layout: Layout, header: Header, options: ReadOptions, size: int) -> Recording:
    """What is known of the recording.

    Raises:
        UnreadableError: the axes' scale is not told or not the same, and `lsb_per_g` not given.
        UsageError: the user's rate contradicts the file's.
    """
    scales = {header.scales.get(axis) for axis in layout.accel}
    scale = scales.pop() if len(scales) == 1 else None
    if scale is None and options.lsb_per_g is None:
        hint = f"give --lsb-per-g (for a scale of 8: {FULL_SCALE // 8})"
        what = "its comment does not tell one scale of x, y and z"
        raise UnreadableError(what, path=file.path, byte_offset=12, hint=hint)
    dps = tuple(header.scales[axis] / FULL_SCALE for axis in layout.gyro or ())
    frames = None if file.compressed else file.whole_frames()
    return Recording(
        path=file.path,
        format="wav",
        rate_hz=agreed_rate(options, float(header.rate_hz), file.path),
        lsb_per_g=options.lsb_per_g or FULL_SCALE / (scale or 1),
        total_bytes=size,
        device=header.device,
        range_g=scale,
        duration_s=None if frames is None else frames / header.rate_hz,
        has_temperature=file.first_values.get("temperature_mc") is not None,
        gyro_dps_per_lsb=(dps[0], dps[1], dps[2]) if dps else None,
        notes=(RESAMPLED, *((WARM,) if file.first_values.get("temperature_mc") is not None else ())),
    )
