"""Axivity recordings with lost, damaged and foreign sectors, and clocks that jump."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.recording import Chunk, Device
from tests.formats.cuts import cuts, every_byte
from tests.formats.cwa.test_cwa import joined, opened, random_counts, times_of
from tests.formats.make_cwa import START_US, Sector, header, sectors, with_checksum, written
from tests.formats.reading import breaks, problems

VALUES = random_counts(800)
SAMPLE_US = 10_000
Found = list[tuple[str, int | None, int, int]]


def pages() -> list[Sector]:
    return sectors(VALUES)


def read(path: Path, chunk_samples: int = 300) -> tuple[list[Chunk], list[int], Found]:
    chunks = list(opened(path).chunks(chunk_samples))
    return chunks, breaks(chunks), problems(chunks)


def without(*lost: int) -> np.ndarray:
    return np.concatenate([VALUES[80 * k : 80 * k + 80] for k in range(10) if k not in lost])


def raw_file(path: Path, data: list[bytes], head: bytes | None = None) -> Path:
    path.write_bytes((header() if head is None else head) + b"".join(data))
    return path


def spoiled(page: bytes) -> bytes:
    return page[:100] + bytes([page[100] ^ 1]) + page[101:]


def test_sectors_with_a_wrong_checksum_are_left_out_and_counted(tmp_path: Path) -> None:
    data = [page.to_bytes() for page in pages()]
    for k in (3, 4, 7):
        data[k] = spoiled(data[k])
    chunks, breaks, problems = read(raw_file(tmp_path / "a.cwa", data))
    assert (joined(chunks, "counts") == without(3, 4, 7)).all()
    assert breaks == [240, 400]
    assert problems == [("checksum", 1024 + 3 * 512, 240, 2), ("checksum", 1024 + 7 * 512, 400, 1)]
    truth = START_US + SAMPLE_US * np.arange(800)
    kept = np.r_[0:240, 400:560, 640:800]
    assert np.abs(times_of(chunks) - truth[kept]).max() <= 31


def test_real_damage_leaves_the_other_sectors_as_in_the_healthy_file(real_data: Path) -> None:
    folder = real_data / "vendor"
    healthy = joined(list(opened(folder / "ax3_100hz_3min.cwa").chunks(1000)), "counts").reshape(145, 120, 3)
    chunks, breaks, problems = read(folder / "ax3_corrupt_blocks_0_13_14_142_143_144.cwa")
    kept = np.delete(healthy, [0, 13, 14, 142, 143, 144], axis=0).reshape(-1, 3)
    assert (joined(chunks, "counts") == kept).all()
    assert breaks == [12 * 120]
    assert problems == [
        ("checksum", 1024, 0, 1),
        ("checksum", 1024 + 13 * 512, 1440, 2),
        ("checksum", 1024 + 142 * 512, 16680, 3),
    ]
    whole = times_of(list(opened(folder / "ax3_100hz_3min.cwa").chunks(1000))).reshape(145, 120)
    known = np.delete(whole, [0, 13, 14, 142, 143, 144], axis=0).reshape(-1)
    assert np.abs(times_of(chunks) - known)[120:].max() < 3000


def test_missing_sequence_numbers_are_a_gap(tmp_path: Path) -> None:
    kept = [page for page in pages() if page.sequence not in (2, 3, 4)]
    chunks, breaks, problems = read(written(tmp_path / "a.cwa", kept))
    assert (breaks, problems) == ([160], [("sequence_gap", 2048, 160, 3)])
    assert np.diff(times_of(chunks))[159] == pytest.approx(241 * SAMPLE_US, abs=62)


def test_a_long_gap_begins_a_new_run_without_a_jump_of_the_clock(tmp_path: Path) -> None:
    later = [
        replace(page, sequence=page.sequence + 5000, time_us=page.time_us + 5000 * 80 * 10_100)
        for page in pages()[5:]
    ]
    chunks, breaks, problems = read(written(tmp_path / "a.cwa", pages()[:5] + later))
    assert (breaks, problems) == ([400], [("sequence_gap", 1024 + 5 * 512, 400, 5000)])
    assert np.abs(np.diff(times_of(chunks)[400:]) - SAMPLE_US).max() <= 2


def test_a_restart_of_the_logging_is_a_break(tmp_path: Path) -> None:
    again = [
        replace(page, time_us=page.time_us + 60_000_000, events=1 * (k == 0))
        for k, page in enumerate(pages())
    ]
    chunks, breaks, problems = read(written(tmp_path / "a.cwa", pages() + again))
    assert breaks == [800]
    assert problems == [("sequence_back", 6144, 800, 1), ("clock_gap", 6144, 800, 1)]
    assert times_of(chunks)[800] == START_US + 60_000_000
    assert times_of(chunks)[799] == pytest.approx(START_US + 7_990_000, abs=62)


@pytest.mark.parametrize(
    ("name", "values", "first", "code"),
    [
        pytest.param("events", [1] * 10, 0, None, id="a resume flag alone"),
        pytest.param("events", [0, 0, 0, 0, 0x20, 0, 0, 0, 0, 0], 4, "device_overflow", id="overflow"),
        pytest.param("session", [777] * 6 + [778] * 4, 6, "session_change", id="a new session"),
    ],
)
def test_what_sectors_say_of_themselves_may_be_a_break(
    tmp_path: Path, name: str, values: list[int], first: int, code: str | None
) -> None:
    said = [replace(page, **{name: value}) for page, value in zip(pages(), values, strict=True)]
    expected = ([80 * first], [(code, 1024 + first * 512, 80 * first, 1)]) if code else ([], [])
    assert read(written(tmp_path / "a.cwa", said))[1:] == expected


@pytest.mark.parametrize(
    ("shift", "code"), [(300_000, "clock_gap"), (-300_000, "clock_back"), (-9_000_000, "clock_back")]
)
def test_jumps_of_the_clock_are_breaks(tmp_path: Path, shift: int, code: str) -> None:
    jumping = [replace(page, time_us=page.time_us + shift * (page.sequence >= 5)) for page in pages()]
    chunks, breaks, problems = read(written(tmp_path / "a.cwa", jumping))
    assert (breaks, problems) == ([400], [(code, 1024 + 5 * 512, 400, 1)])
    truth = START_US + SAMPLE_US * np.arange(800) + shift * (np.arange(800) >= 400)
    assert np.abs(times_of(chunks) - truth).max() <= 40


def test_a_small_excursion_of_the_clock_is_none(tmp_path: Path) -> None:
    late = [replace(page, time_us=page.time_us + 200_000 * (page.sequence == 5)) for page in pages()]
    assert read(written(tmp_path / "a.cwa", late))[1:] == ([], [])


def test_a_hole_after_a_sector_that_is_not_full_is_told(tmp_path: Path) -> None:
    """Its few samples would otherwise lie 42 ms apart, as if the sensor had been slow."""
    few = [
        replace(page, count=5, data=page.data[: 5 * 6]) if page.sequence == 5 else page for page in pages()
    ]
    early = [replace(page, time_us=page.time_us - 590_000 * (page.sequence > 5)) for page in few]
    chunks, breaks, problems = read(written(tmp_path / "a.cwa", early))
    assert (breaks, problems) == ([405], [("clock_gap", 1024 + 6 * 512, 405, 1)])
    steps = np.diff(times_of(chunks))
    assert np.abs(np.delete(steps, 404) - SAMPLE_US).max() <= 40
    assert steps[404] == pytest.approx(170_000, abs=80)


def test_a_hole_between_stamps_of_neighbouring_samples_is_told(tmp_path: Path) -> None:
    """The last sample of one sector and the first of the next are stamped: 19 samples fit between them."""
    late = [replace(page, time_us=page.time_us + 190_000 * (page.sequence > 5)) for page in pages()]
    moved = 79 - late[5].anchor
    late[5] = replace(late[5], anchor=79, time_us=late[5].time_us + moved * SAMPLE_US)
    late[6] = replace(late[6], anchor=0, time_us=late[6].time_us - late[6].anchor * SAMPLE_US)
    _, breaks, problems = read(written(tmp_path / "a.cwa", late))
    assert (breaks, problems) == ([480], [("clock_gap", 1024 + 6 * 512, 480, 1)])


def test_sectors_of_another_rate_or_range_are_left_out(tmp_path: Path) -> None:
    mixed = pages()
    mixed[4] = replace(mixed[4], rate_code=0x49)
    mixed[5] = replace(mixed[5], rate_code=0x49)
    mixed[8] = replace(mixed[8], rate_code=0x8A)
    chunks, breaks, problems = read(written(tmp_path / "a.cwa", mixed))
    assert (joined(chunks, "counts") == without(4, 5, 8)).all()
    assert breaks == [320, 480]
    assert problems == [("rate_change", 1024 + 4 * 512, 320, 2), ("settings_change", 1024 + 8 * 512, 480, 1)]


@pytest.mark.parametrize("count", [0, 81, 65535])
def test_impossible_counts_are_bad_sectors(tmp_path: Path, count: int) -> None:
    wrong = [replace(page, count=count) if page.sequence == 4 else page for page in pages()]
    chunks, breaks, problems = read(written(tmp_path / "a.cwa", wrong))
    assert (joined(chunks, "counts") == without(4)).all()
    assert (breaks, problems) == ([320], [("bad_page", 1024 + 4 * 512, 320, 1)])


def test_short_sectors_give_their_samples(tmp_path: Path) -> None:
    short = [replace(page, count=50) if page.sequence == 4 else page for page in pages()]
    chunks, _, _ = read(written(tmp_path / "a.cwa", short))
    assert (joined(chunks, "counts") == np.delete(VALUES, np.s_[370:400], axis=0)).all()


@pytest.mark.parametrize("filler", [b"\0", b"\xff"])
def test_empty_sectors_end_the_data_but_are_bad_in_the_middle(tmp_path: Path, filler: bytes) -> None:
    data = [page.to_bytes() for page in pages()]
    at_end = data + [filler * 512] * 9 + [filler * 100]
    chunks, breaks, problems = read(raw_file(tmp_path / "a.cwa", at_end))
    assert (len(joined(chunks, "counts")), breaks, problems) == (800, [], [])
    inside = data[:4] + [filler * 512] * 2 + data[6:]
    chunks, breaks, problems = read(raw_file(tmp_path / "b.cwa", inside))
    assert (joined(chunks, "counts") == without(4, 5)).all()
    assert (breaks, problems) == ([320], [("bad_page", 1024 + 4 * 512, 320, 2)])


def test_usage_blocks_are_no_damage(tmp_path: Path) -> None:
    data = [page.to_bytes() for page in pages()]
    data[5:5] = [with_checksum(b"UB" + data[5][2:])]
    assert read(raw_file(tmp_path / "a.cwa", data))[1:] == ([], [])


@pytest.mark.parametrize("head", [bytes(1024), b"\xff" * 1024, b"", bytes(512)])
def test_a_damaged_header_does_not_prevent_reading(tmp_path: Path, head: bytes) -> None:
    path = raw_file(tmp_path / "a.cwa", [page.to_bytes() for page in pages()], head)
    chunks, breaks, problems = read(path)
    assert (joined(chunks, "counts") == VALUES).all()
    assert (breaks, problems) == ([], [("damaged_header", 0, 0, 1)])
    recording = opened(path).recording
    assert (recording.rate_hz, recording.range_g, recording.device) == (100, 8, Device("AX3"))


def test_sectors_tell_the_device_where_the_header_is_lost(tmp_path: Path) -> None:
    coarse = [replace(page, fractional=False, scale=4 << 3) for page in sectors(VALUES, rate_code=0x47)]
    recording = opened(written(tmp_path / "a.cwa", coarse, bytes(1024))).recording
    assert recording.device == Device("AX6", "12345")


def test_sectors_without_a_time_are_placed_by_counting(tmp_path: Path) -> None:
    untimed = [replace(page, stamp=0) if page.sequence in (4, 5) else page for page in pages()]
    chunks, breaks, problems = read(written(tmp_path / "a.cwa", untimed))
    assert (breaks, problems) == ([], [("missing_value", 1024 + 4 * 512, 320, 2)])
    assert np.abs(times_of(chunks) - START_US - SAMPLE_US * np.arange(800)).max() <= 62


def test_a_clock_that_was_never_set_counts_from_1970(tmp_path: Path) -> None:
    path = written(tmp_path / "a.cwa", [replace(page, stamp=0) for page in pages()])
    chunks, breaks, problems = read(path)
    assert opened(path).recording.start_us is None
    assert breaks == []
    assert problems == [("no_start_time", 1024, 0, 1), ("missing_value", 1024, 0, 10)]
    assert times_of(chunks).tolist() == (SAMPLE_US * np.arange(800)).tolist()


def test_the_oldest_format_has_no_checksum_and_its_rate_in_hertz(tmp_path: Path) -> None:
    data = []
    for page in pages():
        raw = bytearray(replace(page, time_us=START_US + page.sequence * 1_000_000).to_bytes())
        raw[24], raw[26:28] = 0, (80).to_bytes(2, "little")
        data.append(bytes(raw))
    path = raw_file(tmp_path / "old.cwa", data)
    chunks, breaks, problems = read(path)
    assert (joined(chunks, "counts") == VALUES).all()
    assert (opened(path).recording.rate_hz, opened(path).recording.range_g) == (80, 16)
    assert (breaks, problems) == ([], [])
    assert times_of(chunks).tolist() == (START_US + 12_500 * np.arange(800)).tolist()


def test_a_sector_in_the_place_of_half_the_header_is_read_and_told(tmp_path: Path) -> None:
    """Found by `make fuzz`: 512 bytes of the header lost, and with them, in silence, the first sector."""
    half, data = header()[:512], [page.to_bytes() for page in pages()]
    chunks, breaks, problems = read(raw_file(tmp_path / "a.cwa", data, half))
    assert (joined(chunks, "counts") == VALUES).all()
    assert (breaks, problems) == ([], [("damaged_header", 512, 0, 1)])
    assert np.abs(times_of(chunks) - (START_US + SAMPLE_US * np.arange(800))).max() <= 31
    whole = opened(raw_file(tmp_path / "whole.cwa", data)).recording
    found = opened(tmp_path / "a.cwa").recording
    assert (found.device, found.notes, found.start_us) == (whole.device, whole.notes, whole.start_us)


def test_a_damaged_sector_in_the_place_of_half_the_header_is_told(tmp_path: Path) -> None:
    data = [page.to_bytes() for page in pages()]
    chunks, _, problems = read(raw_file(tmp_path / "a.cwa", [spoiled(data[0]), *data[1:]], header()[:512]))
    assert (joined(chunks, "counts") == without(0)).all()
    assert problems == [("damaged_header", 512, 0, 1), ("checksum", 512, 0, 1)]


@every_byte
def test_truncation_at_every_byte_gives_fewer_rows_or_a_plain_error(tmp_path: Path, step: int) -> None:
    whole = written(tmp_path / "whole.cwa", pages()[:3]).read_bytes()
    path = tmp_path / "cut.cwa"
    for size in [*cuts(whole, step, 1), len(whole)]:
        path.write_bytes(whole[:size])
        sectors_left, rest = divmod(size - 1024, 512)
        if sectors_left < 1:
            with pytest.raises(UnreadableError, match=r"cut\.cwa, byte .*copy it again"):
                opened(path)
            continue
        chunks, breaks, problems = read(path)
        assert (joined(chunks, "counts") == VALUES[: 80 * sectors_left]).all()
        tail = [("truncated", 1024 + 512 * sectors_left, 80 * sectors_left, rest)] if rest else []
        assert (breaks, problems) == ([], tail)


def test_many_problems_are_few_records(tmp_path: Path) -> None:
    data = [page.to_bytes() for page in sectors(random_counts(48_000))]
    data[1::2] = [spoiled(page) for page in data[1::2]]
    chunks, breaks, problems = read(raw_file(tmp_path / "a.cwa", data), 1000)
    assert len(problems) <= 101
    assert sum(count for _, _, _, count in problems) == 300
    assert len(breaks) == 299
    assert np.abs(np.diff(times_of(chunks)[:80]) - SAMPLE_US).max() <= 1


def test_nothing_of_the_format_is_an_error_with_a_place(tmp_path: Path) -> None:
    path = tmp_path / "a.cwa"
    path.write_bytes(bytes(5000))
    with pytest.raises(UnreadableError, match=r"a\.cwa, byte 1024: is not an Axivity .cwa recording"):
        opened(path)
    raw_file(path, [spoiled(page.to_bytes()) for page in pages()])
    with pytest.raises(UnreadableError, match="holds no intact data sector"):
        opened(path)


@pytest.mark.parametrize("word", [0, 1023])
def test_a_thermometer_at_the_end_of_its_converter_measures_nothing(tmp_path: Path, word: int) -> None:
    """5. of the hostile run: such words became 250 C, whose slopes were then fitted for half a minute."""
    whole = [replace(page, temperature=270 + k) for k, page in enumerate(pages())]
    glitched = [replace(page, temperature=word) if k in (3, 4, 7) else page for k, page in enumerate(whole)]
    warm = joined(read(written(tmp_path / "whole.cwa", whole))[0], "temperature_mc")
    for chunk_samples in (80, 300, 8000):
        chunks, breaks, problems = read(written(tmp_path / "a.cwa", glitched), chunk_samples)
        assert (joined(chunks, "counts") == VALUES).all() and not breaks
        expected = [warm[80 * k] for k in (0, 1, 2, 2, 2, 5, 6, 6, 8, 9)]
        assert (joined(chunks, "temperature_mc") == np.repeat(expected, 80)).all()
        assert [(code, offset, count) for code, offset, _, count in problems] == [
            ("missing_value", 1024 + 3 * 512, 160),
            ("missing_value", 1024 + 7 * 512, 80),
        ]
