"""Axivity recordings that are as they should be."""

from __future__ import annotations

import gzip
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.formats import Probe, ReadOptions, probe_file
from accelcal_cli.core.recording import Device, Reader
from accelcal_cli.formats.cwa import FORMAT
from tests.formats.make_cwa import START_US, Sector, header, make, sectors, unpacked_time, written
from tests.formats.reading import breaks
from tests.formats.reading import column as joined
from tests.formats.reading import times as times_of

RNG = np.random.default_rng(1)
REAL = {
    "ax3_100hz_3min.cwa": 17400,
    "ax3_200hz_5min.cwa": 58800,
    "ax3_sacrum_100hz_3h.cwa": 1208160,
    "ax6_100hz_2min.cwa": 11320,
    "ax6_100hz_6min.CWA": 36400,
}


def opened(path: Path) -> Reader:
    return FORMAT.open(path, ReadOptions())


def everything(reader: Reader, chunk_samples: int) -> tuple:
    chunks = list(reader.chunks(chunk_samples))
    return (
        joined(chunks, "counts").tolist(),
        times_of(chunks).tolist(),
        joined(chunks, "temperature_mc").tolist(),
        breaks(chunks),
        [problem for chunk in chunks for problem in chunk.problems],
        [chunk.first_sample for chunk in chunks] == np.cumsum([0, *map(len, chunks[:-1])]).tolist(),
    )


def random_counts(rows: int, axes: int = 3) -> np.ndarray:
    return RNG.integers(-32768, 32768, (rows, axes)).astype(np.int16)


def words_of(page: bytes) -> dict[str, int]:
    names = ("fraction", "session", "sequence", "stamp", "light", "temperature", "events", "battery", "rate")
    values = struct.unpack_from("<HIIIHHBBBBhH", page, 4)
    return dict(zip((*names, "axes", "offset", "count"), values, strict=True))


def anchor_of(page: bytes) -> tuple[int, float]:
    """Sample number within the sector and its time [us], by the format document."""
    word = words_of(page)
    moment = unpacked_time(word["stamp"])
    sixteenth = (word["fraction"] & 0x7FFF) * 2
    rate = int(3200 / 2 ** (15 - (word["rate"] & 15)))
    return word["offset"] + (sixteenth * rate >> 16), (moment.timestamp() + sixteenth / 65536) * 1e6


def pages_of(path: Path) -> list[bytes]:
    data = path.read_bytes()
    return [data[at : at + 512] for at in range(1024, len(data), 512)]


def decoded(page: bytes) -> list[tuple[int, ...]]:
    """Accelerations of a sector, number by number."""
    word = words_of(page)
    if word["axes"] != 0x30:
        width = word["axes"] >> 4
        values = struct.unpack_from(f"<{word['count'] * width}h", page, 30)
        return [values[at : at + width][-3:] for at in range(0, len(values), width)]
    rows = []
    for bits in struct.unpack_from(f"<{word['count']}I", page, 30):
        axes = [bits >> shift & 0x3FF for shift in (0, 10, 20)]
        rows.append(tuple((value - 1024 * (value > 511)) << (bits >> 30) for value in axes))
    return rows


def test_samples_are_exactly_those_written(tmp_path: Path) -> None:
    counts = random_counts(1000)
    expected = make(tmp_path, counts, 100.0, 256.0)
    reader = opened(expected.path)
    chunks = list(reader.chunks(300))
    assert (joined(chunks, "counts") == counts).all()
    assert joined(chunks, "counts").dtype == np.int16
    assert np.abs(times_of(chunks) - expected.times_us).max() <= 31
    assert reader.recording.start_us == START_US
    assert reader.recording.device == Device("AX3", "12345", "47")
    assert (reader.recording.rate_hz, reader.recording.lsb_per_g, reader.recording.range_g) == (100, 256, 8)
    assert reader.recording.duration_s == pytest.approx(10, abs=1e-4)


@pytest.mark.parametrize("rate_hz", [6.25, 12.5, 50.0, 1600.0])
def test_other_rates_and_scales(tmp_path: Path, rate_hz: float) -> None:
    counts = random_counts(500)
    expected = make(tmp_path, counts, rate_hz, 4096.0)
    reader = opened(expected.path)
    chunks = list(reader.chunks(1000))
    assert (reader.recording.rate_hz, reader.recording.lsb_per_g) == (rate_hz, 4096)
    assert (joined(chunks, "counts") / 4096 == expected.counts_g).all()
    assert np.abs(times_of(chunks) - expected.times_us).max() <= 31


def test_packed_samples_by_every_exponent_and_sign(tmp_path: Path) -> None:
    words = RNG.integers(0, 1 << 32, 240, dtype=np.uint32)
    pages = [
        Sector(words[at : at + 120].astype("<u4").tobytes(), 120, at // 120, axes=0x30) for at in (0, 120)
    ]
    pages[1] = replace(pages[1], time_us=START_US + 1_200_000)
    path = written(tmp_path / "packed.cwa", pages)
    oracle = [row for page in pages_of(path) for row in decoded(page)]
    assert joined(list(opened(path).chunks(1000)), "counts").tolist() == [list(row) for row in oracle]


@pytest.mark.parametrize(("axes", "width"), [(0x62, 6), (0x92, 9)])
def test_gyroscope_comes_before_the_accelerometer(tmp_path: Path, axes: int, width: int) -> None:
    values = random_counts(200, width)
    pages = sectors(values, axes=axes, scale=4 << 3 | 3, rate_code=0x4A)
    path = written(tmp_path / "six.cwa", pages, header(0x5BBBFA, 0x64, 54))
    reader = opened(path)
    chunks = list(reader.chunks(100))
    assert (joined(chunks, "counts") == values[:, 3:6]).all()
    assert (joined(chunks, "gyro_counts") == values[:, :3]).all()
    assert reader.recording.device == Device("AX6", str(0x5BBBFA), "54")
    assert reader.recording.lsb_per_g == 4096
    assert reader.recording.gyro_dps_per_lsb == (1000 / 32768,) * 3


@pytest.mark.parametrize("name", REAL)
def test_real_files_number_by_number(real_data: Path, name: str) -> None:
    path = real_data / "vendor" / name
    reader = opened(path)
    chunks = list(reader.chunks(50_000))
    counts = joined(chunks, "counts")
    pages = pages_of(path)
    assert len(counts) == REAL[name]
    assert not any(chunk.problems or len(chunk.breaks) for chunk in chunks)
    full = len(counts) // len(pages)
    for number in range(0, len(pages), max(1, len(pages) // 100)):
        assert counts[number * full :][:full].tolist() == [list(row) for row in decoded(pages[number])]


@pytest.mark.parametrize("name", REAL)
def test_real_times_lie_on_lines_between_the_anchors(real_data: Path, name: str) -> None:
    path = real_data / "vendor" / name
    chunks = list(opened(path).chunks(50_000))
    times = times_of(chunks)
    pages = pages_of(path)
    full = len(times) // len(pages)
    anchors = np.array([anchor_of(page) for page in pages])
    rows = anchors[:, 0] + full * np.arange(len(pages))
    inner = slice(int(rows[0]), len(times))
    line = np.interp(np.arange(len(times)), rows, anchors[:, 1])
    off = times - line
    begins = np.arange(len(times)) % full == 0
    assert np.abs(off[inner][begins[inner]]).max() <= 1
    assert np.abs(off[inner]).max() < 3000
    assert np.sqrt(np.mean(off[inner] ** 2)) < 300
    rate = (anchors[31, 1] - anchors[0, 1]) / (rows[31] - rows[0])
    assert times[0] == pytest.approx(anchors[0, 1] - rows[0] * rate, abs=1)
    assert (np.diff(times) > 0).all()


def test_first_samples_run_at_the_rate_of_their_own_run(tmp_path: Path) -> None:
    """A device 2 % slow whose anchors lie 130 samples after the sectors' first ones."""
    period = 10_200
    pages = sectors(random_counts(8000))
    pages = [
        replace(page, anchor=130, time_us=START_US + (80 * k + 130) * period) for k, page in enumerate(pages)
    ]
    times = times_of(list(opened(written(tmp_path / "slow.cwa", pages)).chunks(500)))
    assert np.abs(times - START_US - period * np.arange(8000)).max() <= 35


def test_a_lone_sector_runs_at_the_nominal_rate(tmp_path: Path) -> None:
    page = replace(sectors(random_counts(80))[0], anchor=130, time_us=START_US + 1_300_000)
    times = times_of(list(opened(written(tmp_path / "one.cwa", [page])).chunks(500)))
    assert np.abs(times - START_US - 10_000 * np.arange(80)).max() <= 31


@pytest.mark.parametrize(
    ("hardware", "expected"),
    [
        (0x00, [25_000, 28_223, 32_910, 98]),
        (0x64, [25_000, 28_223, 32_910, 98]),
        (0x17, [17_900, 19_550, 21_950, 5_150]),
    ],
)
def test_temperature_by_the_part_of_the_hardware(tmp_path: Path, hardware: int, expected: list[int]) -> None:
    raw = [256, 267, 283 | 0x8000, 171]
    pages = [replace(page, temperature=t) for page, t in zip(sectors(random_counts(320)), raw, strict=True)]
    path = written(tmp_path / "warm.cwa", pages)
    data = bytearray(path.read_bytes())
    data[4] = hardware
    path.write_bytes(data)
    found = joined(list(opened(path).chunks(100)), "temperature_mc").reshape(4, 80)
    assert found.dtype == np.int32
    assert (found == found[:, :1]).all()
    assert found[:, 0].tolist() == expected


def test_no_temperature_where_nothing_was_measured(tmp_path: Path) -> None:
    reader = opened(written(tmp_path / "none.cwa", sectors(random_counts(160), temperature=0)))
    assert not reader.recording.has_temperature
    assert [chunk.temperature_mc for chunk in reader.chunks(100)] == [None, None]


@pytest.mark.nightly
@pytest.mark.parametrize(
    "chunk_samples", [1, *(pytest.param(n, marks=pytest.mark.nightly) for n in (100, 7000, 10**6))]
)
def test_rows_do_not_depend_on_the_chunk_size(real_data: Path, chunk_samples: int) -> None:
    for name in ("ax3_corrupt_blocks_0_13_14_142_143_144.cwa", "ax6_100hz_2min.cwa"):
        reader = opened(real_data / "vendor" / name)
        assert everything(reader, chunk_samples) == everything(reader, 1000)


def test_chunks_stay_as_they_are_while_reading_goes_on(tmp_path: Path) -> None:
    path = make(tmp_path, random_counts(8000), 100.0, 256.0).path
    chunks = opened(path).chunks(400)
    first = next(chunks)
    before = first.counts.copy(), first.clock.times(0, 400)
    list(chunks)
    assert (first.counts == before[0]).all()
    assert (first.clock.times(0, 400) == before[1]).all()


def test_gzip_and_upper_case_suffix(tmp_path: Path) -> None:
    plain = make(tmp_path, random_counts(3000), 100.0, 256.0).path
    packed = tmp_path / "HAND.CWA.GZ"
    packed.write_bytes(gzip.compress(plain.read_bytes()))
    assert FORMAT.sniff(probe_file(packed, ReadOptions())) == 100
    reader = opened(packed)
    assert everything(reader, 500) == everything(opened(plain), 500)
    assert probe_file(packed, ReadOptions()).suffix in FORMAT.suffixes
    assert len(list(reader.preview(1000, 2))) == 2


def test_preview_enters_the_file_at_spread_places(tmp_path: Path) -> None:
    counts = random_counts(80_000)
    reader = opened(make(tmp_path, counts, 100.0, 256.0).path)
    pieces = list(reader.preview(800, 5))
    assert [piece.first_sample for piece in pieces] == [0, 16_000, 32_000, 48_000, 64_000]
    for piece in pieces:
        rows = slice(piece.first_sample, piece.first_sample + len(piece))
        assert (piece.counts == counts[rows]).all()
        assert len(piece) == 800 and not len(piece.breaks) and not piece.problems
        assert np.abs(piece.clock.times(0, 800) - START_US - 10_000 * np.arange(80_000)[rows]).max() <= 40


def test_what_the_file_begins_with_decides(tmp_path: Path) -> None:
    def score(head: bytes) -> int:
        return FORMAT.sniff(Probe(tmp_path / "x", head, len(head), False, ReadOptions()))

    page = sectors(random_counts(80))[0].to_bytes()
    assert score(header()) == 100
    assert score(bytes(1024) + page) == 97
    assert score(page) == 97
    assert score(bytes(1000) + page) == 0
    assert score(b"MD") == score(b"") == 0


def test_a_header_that_disagrees_is_noted(tmp_path: Path) -> None:
    path = written(tmp_path / "other.cwa", sectors(random_counts(160)), header(rate_code=0x49))
    recording = opened(path).recording
    assert recording.rate_hz == 100
    assert recording.notes[1] == "the header says 50 Hz, the data sectors 100 Hz"


def test_the_user_goes_before_the_file(tmp_path: Path) -> None:
    path = make(tmp_path, random_counts(160), 100.0, 256.0).path
    options = ReadOptions(rate_hz=98.5, lsb_per_g=250.0, timezone="Europe/Budapest")
    recording = FORMAT.open(path, options).recording
    assert (recording.rate_hz, recording.lsb_per_g, recording.timezone) == (98.5, 250.0, "Europe/Budapest")
