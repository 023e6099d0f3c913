"""GENEActiv recordings that are as they should be."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.formats import Probe, ReadOptions, probe_file
from accelcal_cli.core.recording import Device, Reader
from accelcal_cli.formats.geneactiv import FORMAT
from tests.formats.geneactiv.oracle import factory, raw_values
from tests.formats.make_geneactiv import START_US, header, make, pages, written
from tests.formats.reading import breaks
from tests.formats.reading import column as joined
from tests.formats.reading import times as times_of

RNG = np.random.default_rng(3)
REAL = {
    "geneactiv_66hz_22min.bin": (87_900, "GENEActiv 1.2", "000030", "Vex06.16 12June23a", 66.7, "+01:00"),
    "geneactiv_85hz_1min.bin": (5_031, "GENEActiv 1.1", "012967", "Ver1.30 date 05Aug11", 85.7, "+01:00"),
    "geneactiv_sample.bin": (900, "GENEActiv 1.1", "051386", "Ver4.08a date14Jul14", 50, "-04:00"),
}


def random_counts(samples: int) -> np.ndarray:
    return RNG.integers(-2048, 2048, (samples, 3))


def opened(path: Path, **options: object) -> Reader:
    return FORMAT.open(path, ReadOptions(**options))


def everything(reader: Reader, chunk_samples: int) -> tuple:
    chunks = list(reader.chunks(chunk_samples))
    problems = [problem for chunk in chunks for problem in chunk.problems]
    columns = [joined(chunks, name).tolist() for name in ("counts", "temperature_mc")]
    return (*columns, times_of(chunks).tolist(), breaks(chunks), problems)


@pytest.mark.parametrize("ending", [b"\n", b"\r\n"])
def test_samples_are_exactly_those_written(tmp_path: Path, ending: bytes) -> None:
    counts = random_counts(3000)
    path = written(tmp_path / "a.bin", pages(counts), header(pages=10), ending)
    reader = opened(path)
    chunks = list(reader.chunks(700))
    assert (joined(chunks, "counts") == counts).all()
    assert joined(chunks, "counts").dtype == np.int16
    assert (times_of(chunks) == START_US + 20_000 * np.arange(3000)).all()
    assert not any(chunk.problems or len(chunk.breaks) for chunk in chunks)
    recording = reader.recording
    assert recording.device == Device("GENEActiv 1.1", "012345", "Ver4.08a date14Jul14")
    assert (recording.rate_hz, recording.lsb_per_g, recording.range_g) == (50, 256, 8)
    assert (recording.start_us, recording.duration_s, recording.timezone) == (START_US, 60, "+01:00")
    assert recording.has_temperature and not recording.notes


def test_light_button_and_spare_bits_do_not_touch_the_axes(tmp_path: Path) -> None:
    page = pages(np.zeros((300, 3), int))[0]
    body = "7FF800FFF" + "FFF" + "001FFE800" + "FFF"
    path = written(tmp_path / "a.bin", [type(page)(**{**vars(page), "body": body * 150})])
    assert joined(list(opened(path).chunks(300)), "counts")[:2].tolist() == [
        [2047, -2048, -1],
        [1, -2, -2048],
    ]


def test_digits_may_be_small_letters(tmp_path: Path) -> None:
    counts = random_counts(300)
    path = written(tmp_path / "a.bin", pages(counts))
    text = path.read_bytes()
    start = text.rindex(b"\r\n", 0, len(text) - 2)
    path.write_bytes(text[:start] + text[start:].lower())
    assert (joined(list(opened(path).chunks(300)), "counts") == counts).all()


def test_numbers_of_any_length_and_commas_for_points(tmp_path: Path) -> None:
    counts = random_counts(1200)
    warm = ["25", "-1,25", "+", "100.125"]
    content = [
        type(page)(**{**vars(page), "temperature": text, "sequence": 9998 + k, "rate": "50,0"})
        for k, (page, text) in enumerate(zip(pages(counts), warm, strict=True))
    ]
    chunks = list(opened(written(tmp_path / "a.bin", content, header(rate="50,0"))).chunks(300))
    assert (joined(chunks, "counts") == counts).all()
    assert joined(chunks, "temperature_mc")[::300].tolist() == [25_000, -1_250, -1_250, 100_125]
    problems = [problem for chunk in chunks for problem in chunk.problems]
    assert [(p.code, p.count) for p in problems] == [("sequence_gap", 9998), ("missing_value", 300)]


def test_notes_of_several_lines(tmp_path: Path) -> None:
    counts = random_counts(600)
    told = {"notes": "first\nRecorded Data here\nx gain:1\nTime Zone:GMT +09:00", "pages": 2}
    reader = opened(written(tmp_path / "a.bin", pages(counts), header(**told)))
    assert (joined(list(reader.chunks(300)), "counts") == counts).all()
    assert (reader.recording.lsb_per_g, reader.recording.timezone) == (256, "+01:00")


@pytest.mark.parametrize(
    ("text", "zone"),
    [
        ("GMT +00:00", "UTC"),
        ("GMT -04:00", "-04:00"),
        ("GMT +05:45", "+05:45"),
        ("GMT +5:30", "+05:30"),
        ("GMT +99:00", None),
        ("", None),
    ],
)
def test_the_zone_of_the_header(tmp_path: Path, text: str, zone: str | None) -> None:
    path = written(tmp_path / "a.bin", pages(random_counts(300)), header(zone=text))
    recording = opened(path).recording
    assert recording.timezone == zone
    noted = [note for note in recording.notes if "time zone" in note]
    assert len(noted) == (zone is None and text != "")
    forced = opened(path, timezone="Europe/Paris", force_timezone=True)
    assert forced.recording.timezone == "Europe/Paris"


def test_the_rate_of_the_pages_wins_and_must_agree_with_the_user(tmp_path: Path) -> None:
    path = written(tmp_path / "a.bin", pages(random_counts(600)), header(rate="100", pages=2))
    recording = opened(path).recording
    assert recording.rate_hz == 50
    assert recording.notes == ("the header says 100 Hz, the pages 50 Hz",)
    assert opened(path, rate_hz=49.5).recording.rate_hz == 49.5
    with pytest.raises(UsageError, match="made at 50 Hz, not 100"):
        opened(path, rate_hz=100.0)


def test_a_clock_drift_is_noted(tmp_path: Path) -> None:
    head = header(extract="(device clock drift -1.459s) at the clinic")
    notes = opened(written(tmp_path / "a.bin", pages(random_counts(300)), head)).recording.notes
    assert notes == ("the header notes a clock drift of -1.459 s; the times are the device's own",)


def test_gzip_and_upper_case_suffix(tmp_path: Path) -> None:
    plain = make(tmp_path, random_counts(3000), 50.0, 256.0).path
    packed = tmp_path / "HAND.BIN.GZ"
    packed.write_bytes(gzip.compress(plain.read_bytes()))
    assert FORMAT.sniff(probe_file(packed, ReadOptions())) == 100
    assert probe_file(packed, ReadOptions()).suffix in FORMAT.suffixes
    reader = opened(packed)
    assert everything(reader, 900) == everything(opened(plain), 900)
    assert reader.recording.duration_s is None
    assert len(list(reader.preview(300, 2))) == 2


def test_preview_enters_the_file_at_spread_places(tmp_path: Path) -> None:
    counts = random_counts(90_000)
    reader = opened(make(tmp_path, counts, 50.0, 256.0).path)
    pieces = list(reader.preview(900, 5))
    assert len(pieces) == 5
    for number, piece in enumerate(pieces):
        assert abs(piece.first_sample - number * 18_000) <= 600
        rows = slice(piece.first_sample, piece.first_sample + len(piece))
        assert (piece.counts == counts[rows]).all()
        assert 600 <= len(piece) <= 1200 and not len(piece.breaks) and not piece.problems
        assert (piece.clock.times(0, len(piece)) == START_US + 20_000 * np.arange(90_000)[rows]).all()


def test_what_the_file_begins_with_decides(tmp_path: Path) -> None:
    def score(head: bytes) -> int:
        return FORMAT.sniff(Probe(tmp_path / "x", head, len(head), False, ReadOptions()))

    page = pages(random_counts(300))[0].to_bytes()
    assert score(header()) == 100
    assert score(bytes(1000) + page) == score(page[100:] + page) == 97
    assert score(b"Device Type,GENEActiv\n") == score(b"Recorded Data\r\n") == score(b"") == 0


@pytest.mark.parametrize("name", REAL)
def test_real_files_number_by_number(real_data: Path, name: str) -> None:
    path = real_data / "vendor" / name
    reader = opened(path)
    chunks = list(reader.chunks(50_000))
    rows, model, serial, firmware, rate_hz, zone = REAL[name]
    recording = reader.recording
    assert recording.device == Device(model, serial, firmware)
    assert (recording.rate_hz, recording.timezone, recording.range_g) == (rate_hz, zone, 8)
    raw, (gain, offset) = raw_values(path), factory(path)
    counts = joined(chunks, "counts")
    assert counts.shape == raw.shape == (rows, 3)
    found_g = counts / recording.lsb_per_g
    np.testing.assert_allclose(found_g, (raw * 100 - offset) / gain, rtol=0, atol=0.5 / recording.lsb_per_g)
    assert (np.rint((found_g * gain + offset) / 100) == raw).all()


@pytest.mark.nightly
@pytest.mark.parametrize(
    "chunk_samples", [1, *(pytest.param(n, marks=pytest.mark.nightly) for n in (1000, 10**6))]
)
def test_rows_do_not_depend_on_the_chunk_size(real_data: Path, chunk_samples: int) -> None:
    for name in REAL:
        reader = opened(real_data / "vendor" / name)
        assert everything(reader, chunk_samples) == everything(reader, 30_000)
