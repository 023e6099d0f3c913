"""The .cwa writer: its sectors against the vendor's cwa.h, and back through the reader."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.clock import StampClock, UniformClock
from accelcal_cli.core.errors import OutputError, UsageError
from accelcal_cli.core.recording import Chunk, Device
from accelcal_cli.formats.cwa.writer import ENCODER
from tests.formats.writing import START_US, chunks, counts, read_back, recording, times, written

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
RATES = [6.25, 12.5, 25.0, 50.0, 100.0, 200.0, 400.0, 800.0, 1600.0, 3200.0]


@dataclass(frozen=True)
class Sector:
    """Fields of cwa_data_t; `anchor` is the sample that was taken at `seconds` since 1970."""

    sequence: int
    seconds: float
    anchor: int
    temperature: int
    events: int
    rate: int
    axes: int
    rows: list[tuple[int, int, int]]


def packed_time(word: int) -> datetime:
    fields = (word >> 26) + 2000, word >> 22 & 15, word >> 17 & 31, word >> 12 & 31, word >> 6 & 63, word & 63
    return datetime(*fields, tzinfo=UTC)


def sector(data: bytes) -> Sector:
    """One sector, field by field."""
    assert data[:4] == b"AX" + struct.pack("<H", 508)
    assert sum(struct.unpack("<256H", data)) % 65_536 == 0
    fraction, session, sequence, stamp, light, heat = struct.unpack_from("<HIIIHH", data, 4)
    events, battery, rate, axes, offset, count = struct.unpack_from("<BBBBhH", data, 22)
    assert (session, light >> 10, fraction >> 15) == (1, 0, 1)
    assert battery > 0
    ticks = fraction & 0x7FFF
    hz = 3200 // (1 << (15 - (rate & 15)))
    rows = [struct.unpack_from("<hhh", data, 30 + 6 * k) for k in range(count)]
    assert data[30 + 6 * count : 510] == bytes(480 - 6 * count)
    seconds = (packed_time(stamp) - EPOCH).total_seconds() + ticks / 32_768
    return Sector(sequence, seconds, offset + (ticks * hz >> 15), heat, events, rate, axes, rows)


def sectors(path: Path) -> list[Sector]:
    data = path.read_bytes()
    return [sector(data[at : at + 512]) for at in range(1024, len(data), 512)]


@pytest.mark.parametrize("size", [1, 79, 161, 5_000])
def test_the_sectors_are_those_of_the_document(tmp_path: Path, size: int) -> None:
    values = counts(500)
    found = sectors(written(tmp_path, ENCODER, recording(), values, size=size))
    assert [len(one.rows) for one in found] == [80] * 6 + [20]
    assert [one.sequence for one in found] == list(range(7))
    assert np.array_equal(np.concatenate([one.rows for one in found]), values)
    assert {(one.rate, one.axes, one.events, one.temperature) for one in found} == {(0x49, 0x32, 0, 0)}


def test_the_header_is_that_of_the_document(tmp_path: Path) -> None:
    what = recording(device=Device("simulated, a&b", "SIM100042"), range_g=16.0)
    head = written(tmp_path, ENCODER, what, counts(80)).read_bytes()[:1024]
    assert struct.unpack_from("<2sHBHIH", head) == (b"MD", 1020, 0x17, 100_042 & 0xFFFF, 1, 100_042 >> 16)
    assert struct.unpack_from("<III", head, 13) == (0, 0xFFFF_FFFF, 0)
    assert (head[35], head[36]) == (0, 0x09)
    assert packed_time(struct.unpack_from("<I", head, 37)[0]) == EPOCH + timedelta(microseconds=START_US)
    assert head[64:512].strip() == b"_n=simulated%2C+a%26b+SIM100042"
    assert len(head[64:512]) == 448


@pytest.mark.parametrize("rate_hz", RATES)
@pytest.mark.parametrize("start_us", [START_US, START_US + 123_457])
def test_stamps_are_true_to_half_a_tick(tmp_path: Path, rate_hz: float, start_us: int) -> None:
    what = recording(rate_hz=rate_hz, start_us=start_us)
    path = written(tmp_path, ENCODER, what, counts(4_000))
    truth = times(4_000, what)
    for one in sectors(path):
        inside_us = truth[one.sequence * 80 :][:80] % 1_000_000
        off_us = np.abs(inside_us - np.rint(inside_us * 0.032768) / 0.032768)
        assert abs(one.seconds % 1 * 1e6 - inside_us[one.anchor]) <= off_us.min() + 0.3
    found = read_back(path)
    assert np.array_equal(found.counts, counts(4_000))
    assert np.abs(found.times - truth).max() <= (1 if start_us == START_US else 17)
    assert (found.recording.rate_hz, found.problems, found.breaks) == (rate_hz, [], [])


def test_a_tick_may_be_that_of_the_next_second(tmp_path: Path) -> None:
    (found,) = sectors(written(tmp_path, ENCODER, recording(start_us=START_US + 999_990), counts(80)[:1]))
    assert (found.seconds, found.anchor) == (START_US / 1e6 + 1, 0)


@pytest.mark.parametrize("day", ["2000-01-01", "2024-02-29", "2063-12-31"])
def test_dates(tmp_path: Path, day: str) -> None:
    start = datetime.fromisoformat(f"{day}T23:59:59+00:00")
    what = recording(start_us=int(start.timestamp()) * 1_000_000)
    (found,) = sectors(written(tmp_path, ENCODER, what, counts(40)))
    assert EPOCH + timedelta(seconds=found.seconds - found.anchor / 50) == start


def test_the_reader_knows_the_device(tmp_path: Path) -> None:
    heat = np.repeat(np.array([24_950, 25_100, -40_000, 200_000], np.int32), 80)
    path = written(tmp_path, ENCODER, recording(has_temperature=True), counts(320), heat=heat)
    found = read_back(path)
    about = found.recording
    assert (about.device, about.start_us) == (Device("AX3", "42", "47"), START_US)
    assert (about.lsb_per_g, about.range_g, about.timezone) == (256.0, 8.0, None)
    assert [one.temperature for one in sectors(path)] == [303, 304, 1, 1022]
    assert found.temperature_mc is not None
    assert found.temperature_mc[::80].tolist() == [24_950, 25_100, -20_350, 132_800]


def test_a_sector_ends_at_a_break(tmp_path: Path) -> None:
    stamps = START_US + np.arange(300) * 20_000
    stamps[130:] += 5_000_000
    broken = Chunk(0, counts(300), StampClock(stamps), 0, breaks=np.array([130]))
    ENCODER.write(tmp_path / "out.cwa", recording(), [broken])
    assert [(len(one.rows), one.events) for one in sectors(tmp_path / "out.cwa")] == [
        (80, 0), (50, 0), (80, 0x20), (80, 0), (10, 0),
    ]  # fmt: skip
    found = read_back(tmp_path / "out.cwa")
    assert np.array_equal(found.counts, counts(300))
    assert np.abs(found.times - stamps).max() <= 16
    assert (found.breaks, found.problems) == ([130], ["device_overflow", "clock_gap"])


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({"rate_hz": 85.7}, "85.7 Hz; use --rate 100"),
        ({"rate_hz": 100.04}, "100.04 Hz; use --rate 100"),
        ({"lsb_per_g": 512.0}, "512 counts per g over +-8 g; use --lsb-per-g 256 --range-g 16 or"),
        ({"range_g": 6.0}, "256 counts per g over +-6 g; use --lsb-per-g 256 --range-g 16 or"),
        ({"range_g": None}, "an unknown range"),
    ],
)
def test_settings_that_no_ax3_has(tmp_path: Path, told: dict[str, float], words: str) -> None:
    with pytest.raises(UsageError) as caught:
        written(tmp_path, ENCODER, recording(**told), counts(80))
    assert words in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_what_does_not_fit_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="16 bits"):
        written(tmp_path, ENCODER, recording(), counts(80).astype(np.int32) * 17)
    for second in (946_684_799, 2_966_371_200):
        with pytest.raises(OutputError, match="before 2000 or after 2063"):
            written(tmp_path, ENCODER, recording(start_us=second * 1_000_000), counts(80))
    with pytest.raises(OutputError, match="no start time"):
        written(tmp_path, ENCODER, recording(start_us=None), counts(80))
    with pytest.raises(OutputError, match="cannot be written"):
        ENCODER.write(tmp_path, recording(), [])


def test_times_that_leave_the_years_on_the_way(tmp_path: Path) -> None:
    late = UniformClock(2_966_371_199_000_000, 0, 50)
    with pytest.raises(OutputError, match="after 2063"):
        ENCODER.write(tmp_path / "a.cwa", recording(), [Chunk(0, counts(160), late, 0)])


def test_any_chunks_give_the_same_bytes(tmp_path: Path) -> None:
    heat = np.arange(1_000, dtype=np.int32) * 3 + 20_000
    what, files = recording(has_temperature=True), []
    for size in (1, 7, 80, 999, 5_000):
        path = tmp_path / f"{size}.cwa"
        ENCODER.write(path, what, chunks(counts(1_000), what, size, heat))
        files.append(path.read_bytes())
    assert set(files) == {files[0]}
