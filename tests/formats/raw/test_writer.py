"""The raw writer: a stream of frames with its layout, against struct and back through the reader."""

from __future__ import annotations

import struct
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.clock import UniformClock
from accelcal_cli.core.errors import OutputError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Chunk, Device, Reader, Recording
from accelcal_cli.formats.raw import FORMAT
from accelcal_cli.formats.raw.writer import ENCODER

START_US = 1_709_510_400_250_000
COUNTS = np.random.default_rng(4).integers(-2048, 2047, (700, 3)).astype(np.int16)


def recording(**more: object) -> Recording:
    known = {"rate_hz": 85.7, "lsb_per_g": 273.15, "range_g": 8.0, "start_us": START_US} | more
    device = Device('W"L', "S\\1", None)
    return Recording(Path("x"), "raw", total_bytes=0, device=device, **known)  # type: ignore[arg-type]


def chunk_of(counts: np.ndarray, first: int = 0, **more: object) -> Chunk:
    clock = UniformClock(START_US, first, Fraction(857, 10))
    return Chunk(first, counts, clock, 0, **more)  # type: ignore[arg-type]


def read_back(folder: Path, what: Recording, *chunks: Chunk) -> Reader:
    ENCODER.write(folder / "out.raw", what, chunks)
    assert ENCODER.companion is not None
    (folder / f"out{ENCODER.companion.suffix}").write_text(ENCODER.companion.text(what))
    return FORMAT.open(folder / "out.raw", ReadOptions())


def test_plain_frames_are_little_endian_int16(tmp_path: Path) -> None:
    reader = read_back(tmp_path, recording(), chunk_of(COUNTS[:300]), chunk_of(COUNTS[300:], 300))
    packed = b"".join(struct.pack("<hhh", *row) for row in COUNTS.tolist())
    assert (tmp_path / "out.raw").read_bytes() == packed
    chunks = list(reader.chunks(10_000))
    counts = np.concatenate([chunk.counts for chunk in chunks])
    times = np.concatenate([chunk.clock.times(0, len(chunk)) for chunk in chunks])
    assert np.array_equal(counts, COUNTS)
    assert np.abs(times - UniformClock(START_US, 0, Fraction(857, 10)).times(0, 700)).max() <= 1


def test_the_layout_tells_all_of_the_recording(tmp_path: Path) -> None:
    found = read_back(tmp_path, recording(), chunk_of(COUNTS)).recording
    assert (found.rate_hz, found.lsb_per_g, found.range_g) == (85.7, 273.15, 8.0)
    assert (found.start_us, found.timezone, found.samples) == (START_US, None, 700)
    assert found.device == Device('W"L', "S\\1", None)


def test_utc_comes_back(tmp_path: Path) -> None:
    found = read_back(tmp_path, recording(timezone="UTC"), chunk_of(COUNTS)).recording
    assert (found.start_us, found.timezone) == (START_US, "UTC")


def test_temperature_and_gyroscope_come_back(tmp_path: Path) -> None:
    heat = np.arange(700, dtype=np.int32) * 125 - 20_000
    what = recording(has_temperature=True, gyro_dps_per_lsb=(0.061, 0.061, 0.0625))
    reader = read_back(tmp_path, what, chunk_of(COUNTS, temperature_mc=heat, gyro_counts=COUNTS[::-1]))
    (chunk,) = reader.chunks(10_000)
    assert chunk.temperature_mc is not None
    assert chunk.gyro_counts is not None
    assert np.array_equal(chunk.temperature_mc, heat)
    assert np.array_equal(chunk.gyro_counts, COUNTS[::-1])
    assert reader.recording.gyro_dps_per_lsb == (0.061, 0.061, 0.0625)


def test_fine_counts_are_written_in_32_bits(tmp_path: Path) -> None:
    wide = COUNTS.astype(np.int32) * 60_000
    what = recording(lsb_per_g=float(1 << 24), range_g=None)
    (chunk,) = read_back(tmp_path, what, chunk_of(wide)).chunks(10_000)
    assert np.array_equal(chunk.counts, wide)


def test_what_a_stream_of_frames_cannot_hold_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="gap"):
        read_back(tmp_path, recording(), chunk_of(COUNTS, breaks=np.array([5])))
    with pytest.raises(OutputError, match="does not fit"):
        read_back(tmp_path, recording(), chunk_of(COUNTS.astype(np.int32) * 100))
    with pytest.raises(OutputError, match="cannot be written"):
        ENCODER.write(tmp_path, recording(), [])
