"""The flash writer: its bytes against the tables of docs/flash-format.md, and back through the reader."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.clock import StampClock, UniformClock
from accelcal_cli.core.errors import OutputError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Chunk, Device, Recording
from accelcal_cli.formats.flash import FORMAT
from accelcal_cli.formats.flash.writer import ENCODER
from tests.formats.make_flash import START_US, header, page

COUNTS = np.random.default_rng(3).integers(-2048, 2047, (500, 3)).astype(np.int16)


def recording(rate_hz: float = 100.0, lsb_per_g: float = 256.0, **more: object) -> Recording:
    device = Device("Wrist Logger", "WL-00042", "2.1.0")
    known = {"device": device, "range_g": 8.0, "start_us": START_US} | more
    return Recording(Path("x"), "flash", rate_hz, lsb_per_g, 0, **known)  # type: ignore[arg-type]


def chunks_of(counts: np.ndarray, size: int, rate: Fraction = Fraction(100)) -> Iterator[Chunk]:
    for start in range(0, len(counts), size):
        yield Chunk(start, counts[start : start + size], UniformClock(START_US, start, rate), 0)


def written(folder: Path, what: Recording, chunks: Iterable[Chunk]) -> bytes:
    ENCODER.write(folder / "out.bin", what, chunks)
    return (folder / "out.bin").read_bytes()


@pytest.mark.parametrize("size", [1, 79, 80, 161, 1000])
def test_the_bytes_are_those_of_the_specification(tmp_path: Path, size: int) -> None:
    starts = range(0, 500, 80)
    pages = [page(k, START_US + at * 10_000, COUNTS[at : at + 80]) for k, at in enumerate(starts)]
    expected = (header() + b"".join(pages)).replace(struct.pack("<I", 7), struct.pack("<I", 1))
    data = written(tmp_path, recording(), chunks_of(COUNTS, size))
    assert len(data) == len(expected)
    for at in range(0, len(data), 512):
        assert data[at : at + 508] == expected[at : at + 508]
        assert data[at + 508 : at + 512] == struct.pack("<I", zlib.crc32(data[at : at + 508]))


@pytest.mark.parametrize("rate", [100.0, 85.7, 30.0, 1.56, 204.8, 66.66666666666667])
@pytest.mark.parametrize("lsb_per_g", [256.0, 273.15, 341.3, 16384.0, 1 / 0.0039])
def test_rate_and_scale_come_back_exactly(tmp_path: Path, rate: float, lsb_per_g: float) -> None:
    exact = Fraction(rate).limit_denominator(10_000)
    written(tmp_path, recording(rate, lsb_per_g), chunks_of(COUNTS, 100, exact))
    reader = FORMAT.open(tmp_path / "out.bin", ReadOptions())
    assert reader.recording.rate_hz == rate
    assert reader.recording.lsb_per_g == lsb_per_g
    (chunk,) = reader.chunks(1000)
    assert np.array_equal(chunk.counts, COUNTS)
    truth = UniformClock(START_US, 0, exact).times(0, 500)
    assert np.abs(chunk.clock.times(0, 500) - truth).max() <= 1


def test_a_page_ends_at_a_break(tmp_path: Path) -> None:
    times = START_US + np.arange(500) * 10_000
    times[130:] += 5_000_000
    breaks = np.array([130, 300])
    heat = np.repeat(np.array([20_000, 25_500], np.int32), 250)
    chunk = Chunk(0, COUNTS, StampClock(times), 0, breaks=breaks, temperature_mc=heat)
    data = written(tmp_path, recording(has_temperature=True), [chunk])
    assert [struct.unpack_from("<H", data, at + 22)[0] for at in range(512, len(data), 512)] == [
        80, 50, 80, 80, 10, 80, 80, 40,
    ]  # fmt: skip
    reader = FORMAT.open(tmp_path / "out.bin", ReadOptions())
    (found,) = reader.chunks(1000)
    assert np.array_equal(found.counts, COUNTS)
    assert np.array_equal(found.clock.times(0, 500), times)
    assert found.breaks.tolist() == [130, 300]
    assert [problem.code for problem in found.problems] == ["clock_gap"]
    assert found.temperature_mc is not None
    assert (found.temperature_mc[0], found.temperature_mc[-1]) == (20_000, 25_500)


def test_the_temperature_of_a_page_is_the_mean_of_its_samples(tmp_path: Path) -> None:
    heat = np.arange(80, dtype=np.int32) * 100 - 3950
    chunk = Chunk(0, COUNTS[:80], UniformClock(0, 0, Fraction(100)), 0, temperature_mc=heat)
    data = written(tmp_path, recording(has_temperature=True), [chunk])
    assert struct.unpack_from("<h", data, 512 + 20) == (0,)


@pytest.mark.parametrize("zone", ["UTC", "+01:00", "-03:30", None])
def test_a_fixed_time_zone_comes_back(tmp_path: Path, zone: str | None) -> None:
    written(tmp_path, recording(timezone=zone), chunks_of(COUNTS, 500))
    assert FORMAT.open(tmp_path / "out.bin", ReadOptions()).recording.timezone == zone


def test_a_recording_without_start_time_comes_back_without(tmp_path: Path) -> None:
    chunk = Chunk(0, COUNTS, UniformClock(0, 0, Fraction(100)), 0)
    written(tmp_path, recording(start_us=None), [chunk])
    assert FORMAT.open(tmp_path / "out.bin", ReadOptions()).recording.start_us is None


def test_what_does_not_fit_is_refused(tmp_path: Path) -> None:
    wide = COUNTS.astype(np.int32) * 100
    with pytest.raises(OutputError, match="16 bits"):
        written(tmp_path, recording(), [Chunk(0, wide, UniformClock(0, 0, Fraction(100)), 0)])
    with pytest.raises(OutputError, match="before 1970"):
        written(tmp_path, recording(), [Chunk(0, COUNTS, UniformClock(-1, 0, Fraction(100)), 0)])
    with pytest.raises(OutputError, match="counts per g"):
        written(tmp_path, recording(lsb_per_g=2.0**40), [])
    with pytest.raises(OutputError, match="cannot be written"):
        ENCODER.write(tmp_path, recording(), [])


def test_wide_integers_that_fit_are_written(tmp_path: Path) -> None:
    chunk = Chunk(0, COUNTS.astype(np.int32), UniformClock(0, 0, Fraction(100)), 0)
    written(tmp_path, recording(), [chunk])
    (found,) = FORMAT.open(tmp_path / "out.bin", ReadOptions()).chunks(1000)
    assert np.array_equal(found.counts, COUNTS)
