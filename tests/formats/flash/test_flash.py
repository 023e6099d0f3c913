"""Flash pages: every rule of docs/flash-format.md, on pages built by hand."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import AccelcalError, UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions, probe_file
from accelcal_cli.core.recording import Reader
from accelcal_cli.formats.flash import FORMAT
from tests.formats.cuts import cuts, every_byte
from tests.formats.make_flash import START_US, header, make, page, pages
from tests.formats.reading import all_of, check_same, problems

PAGE_US = 800_000
RNG = np.random.default_rng(5)
COUNTS = RNG.integers(-2048, 2047, (400, 3)).astype(np.int16)


def opened(folder: Path, data: bytes, options: ReadOptions | None = None) -> Reader:
    path = folder / "a.bin"
    path.write_bytes(data)
    return FORMAT.open(path, options or ReadOptions())


def at(sequence: int, shift_us: int = 0) -> int:
    return START_US + sequence * PAGE_US + shift_us


def five_pages() -> list[bytes]:
    return pages(COUNTS)


def test_header_and_samples_are_read(tmp_path: Path) -> None:
    expected = make(tmp_path, COUNTS[:333], 85.7, 273.15)
    reader = FORMAT.open(expected.path, ReadOptions())
    counts, times, breaks, chunks = all_of(reader)
    recording = reader.recording
    assert np.array_equal(counts / recording.lsb_per_g, expected.counts_g)
    assert np.abs(times - expected.times_us).max() <= 1
    assert breaks == [] and problems(chunks) == []
    assert (recording.rate_hz, recording.lsb_per_g, recording.range_g) == (85.7, 273.15, 8.0)
    device = recording.device
    assert (device.serial, device.model, device.firmware) == ("WL-00042", "Wrist Logger", "2.1.0")
    assert (recording.samples, recording.timezone, recording.start_us) == (333, None, START_US)
    assert recording.duration_s == pytest.approx(333 / 85.7, abs=2e-6)


@pytest.mark.parametrize("chunk_samples", [1, 80, 161, 240, 10_000])
def test_rows_times_breaks_and_problems_do_not_depend_on_the_chunk_size(
    tmp_path: Path, chunk_samples: int
) -> None:
    wrong = five_pages()
    wrong[1] = wrong[1][:100] + b"?" + wrong[1][101:]
    more = [page(sequence, at(sequence, 5_000_000), COUNTS[:33]) for sequence in (9, 10, 12, 11)]
    data = header() + b"".join(wrong) + b"\xff" * 512 + b"".join(more) + b"\xff" * 1024
    one, other = opened(tmp_path, data), opened(tmp_path, data)
    again = (list(other.chunks(chunk_samples)) for _ in range(2))
    check_same(list(one.chunks(1 << 20)), *again)


def test_samples_are_spread_evenly_between_stamps(tmp_path: Path) -> None:
    data = header() + page(0, at(0), COUNTS[:80]) + page(1, at(1, 40_000), COUNTS[80:160])
    _, times, breaks, _ = all_of(opened(tmp_path, data))
    assert np.array_equal(times[:80] - START_US, np.arange(80) * 10_500)
    assert np.array_equal(times[80:] - times[80], np.arange(80) * 10_000)
    assert breaks == []


def test_erased_pages_at_the_end_are_no_problem(tmp_path: Path) -> None:
    data = header() + b"".join(five_pages()) + b"\xff" * (512 * 9 + 17)
    reader = opened(tmp_path, data)
    counts, _, _, chunks = all_of(reader)
    assert len(counts) == 400 == reader.recording.samples
    assert problems(chunks) == []


def test_erased_pages_between_data_are_a_gap(tmp_path: Path) -> None:
    one, two, three, *_ = five_pages()
    _, _, breaks, chunks = all_of(opened(tmp_path, header() + one + b"\xff" * 1024 + two + three))
    assert breaks == [80]
    assert problems(chunks) == [("bad_page", 1024, 80, 2)]


def test_a_page_with_a_wrong_checksum_is_dropped_and_reported(tmp_path: Path) -> None:
    data = five_pages()
    for bad in (1, 2):
        data[bad] = bytes([data[bad][0] ^ 1]) + data[bad][1:]
    counts, times, breaks, chunks = all_of(opened(tmp_path, header() + b"".join(data)))
    assert np.array_equal(counts, np.concatenate((COUNTS[:80], COUNTS[240:])))
    assert times[80] == at(3)
    assert breaks == [80]
    assert problems(chunks) == [("checksum", 1024, 80, 2)]


def test_missing_pages_are_counted(tmp_path: Path) -> None:
    one, _, _, four, five = five_pages()
    _, times, breaks, chunks = all_of(opened(tmp_path, header() + one + four + five))
    assert breaks == [80]
    assert problems(chunks) == [("sequence_gap", 1024, 80, 2)]
    assert times[79] - START_US == 790_000
    assert times[80] == at(3)


def test_the_sequence_number_wraps(tmp_path: Path) -> None:
    data = header() + page(0xFFFFFFFF, at(0), COUNTS[:80]) + page(0, at(1), COUNTS[80:160])
    _, _, breaks, chunks = all_of(opened(tmp_path, data))
    assert (breaks, problems(chunks)) == ([], [])


def test_a_lower_sequence_number_is_a_break(tmp_path: Path) -> None:
    data = header() + page(5, at(0), COUNTS[:80]) + page(5, at(1), COUNTS[:80]) + page(2, at(2), COUNTS[:80])
    _, _, breaks, chunks = all_of(opened(tmp_path, data))
    assert breaks == [80, 160]
    assert problems(chunks) == [("sequence_back", 1024, 80, 2)]


@pytest.mark.parametrize(("shift_us", "code"), [(3_600_000_000, "clock_gap"), (-3_600_000_000, "clock_back")])
def test_a_clock_that_jumps_is_a_break(tmp_path: Path, shift_us: int, code: str) -> None:
    data = header() + page(0, at(0), COUNTS[:80]) + page(1, at(1, shift_us), COUNTS[80:160])
    _, times, breaks, chunks = all_of(opened(tmp_path, data))
    assert breaks == [80]
    assert problems(chunks) == [(code, 1024, 80, 1)]
    assert "3600.000 s" in chunks[0].problems[0].message
    assert np.array_equal(times[:80] - START_US, np.arange(80) * 10_000)
    assert times[80] == at(1, shift_us)


@pytest.mark.parametrize(
    ("shift_us", "broken"), [(94_000, False), (96_000, True), (-94_000, False), (-96_000, True)]
)
def test_a_tenth_of_the_page_and_one_and_a_half_samples_are_tolerated(
    tmp_path: Path, shift_us: int, broken: bool
) -> None:
    data = header() + page(0, at(0), COUNTS[:80]) + page(1, at(1, shift_us), COUNTS[80:160])
    _, _, breaks, _ = all_of(opened(tmp_path, data))
    assert bool(breaks) == broken


def test_a_page_that_says_so_is_a_break_without_a_problem(tmp_path: Path) -> None:
    data = header() + page(0, at(0), COUNTS[:40]) + page(1, START_US + 400_000, COUNTS[40:80], flags=1)
    _, _, breaks, chunks = all_of(opened(tmp_path, data))
    assert (breaks, problems(chunks)) == ([40], [])


def test_times_rise_across_a_break_of_a_fast_sensor(tmp_path: Path) -> None:
    data = header() + page(0, at(0), COUNTS[:80]) + page(1, at(1, -48_000), COUNTS[80:160], flags=1)
    _, times, _, _ = all_of(opened(tmp_path, data))
    assert (np.diff(times) > 0).all()


def test_the_temperature_is_repeated_until_it_is_measured_again(tmp_path: Path) -> None:
    heat = [-32768, 25 * 128, -32768, -128 * 3 - 64]
    data = [page(k, at(k), COUNTS[:80], temperature=value) for k, value in enumerate(heat)]
    reader = opened(tmp_path, header(flags=1) + b"".join(data))
    for chunk_samples in (80, 1000):
        chunks = list(reader.chunks(chunk_samples))
        found = np.concatenate([chunk.temperature_mc for chunk in chunks])
        assert found[::80].tolist() == [25_000, 25_000, 25_000, -3_500]
        assert problems(chunks) == [("missing_value", 512, 80, 80), ("missing_value", 1536, 240, 80)]
    assert reader.recording.has_temperature


def test_without_the_flag_there_is_no_temperature(tmp_path: Path) -> None:
    reader = opened(tmp_path, header() + page(0, at(0), COUNTS[:80], temperature=3200))
    assert not reader.recording.has_temperature
    assert next(iter(reader.chunks(100))).temperature_mc is None


def test_pages_of_an_older_recording_are_left_out(tmp_path: Path) -> None:
    old = page(2, at(2), COUNTS[:80], recording_id=6)
    counts, _, breaks, chunks = all_of(opened(tmp_path, header() + b"".join(five_pages()[:2]) + old * 3))
    assert (len(counts), breaks) == (160, [])
    assert problems(chunks) == [("bad_page", 512 * 3, 160, 3)]


@pytest.mark.parametrize("samples", [0, 81, 65535])
def test_a_page_with_an_impossible_count_is_left_out(tmp_path: Path, samples: int) -> None:
    strange = page(1, at(1), COUNTS[:80], samples=samples)
    one, _, three, *_ = five_pages()
    counts, _, _, chunks = all_of(opened(tmp_path, header() + one + strange + three))
    assert len(counts) == 160
    assert problems(chunks) == [("bad_page", 1024, 80, 1)]


@pytest.mark.parametrize(("zone", "name"), [(0, "UTC"), (-210, "-03:30"), (60, "+01:00"), (-32768, None)])
def test_the_time_zone_is_an_offset_or_unknown(tmp_path: Path, zone: int, name: str | None) -> None:
    assert opened(tmp_path, header(zone=zone) + five_pages()[0]).recording.timezone == name


def test_a_clock_that_was_never_set_gives_no_start_time(tmp_path: Path) -> None:
    reader = opened(tmp_path, header(flags=2) + page(0, 5_000_000, COUNTS[:80]))
    _, times, _, chunks = all_of(reader)
    assert reader.recording.start_us is None
    assert times[0] == 5_000_000
    assert [code for code, *_ in problems(chunks)] == ["no_start_time"]


def test_a_damaged_header_is_an_error_with_a_way_out(tmp_path: Path) -> None:
    broken = b"\0" * 512
    data = broken + b"".join(five_pages())
    with pytest.raises(UnreadableError, match="--rate and --lsb-per-g"):
        opened(tmp_path, data)
    reader = opened(tmp_path, data, ReadOptions(rate_hz=100, lsb_per_g=256))
    counts, times, _, chunks = all_of(reader)
    assert np.array_equal(counts, COUNTS)
    assert times[-1] == START_US + 3_990_000
    assert [code for code, *_ in problems(chunks)] == ["damaged_header"]
    assert FORMAT.sniff(probe_file(tmp_path / "a.bin", ReadOptions())) == 90


FASTEST = (4_000_000_000, 1)


@pytest.mark.parametrize(
    "bad", [header(version=2), header(rate=(0, 1)), header(rate=(1, 0)), header(rate=FASTEST), header()[:511]]
)
def test_an_impossible_header_is_an_error(tmp_path: Path, bad: bytes) -> None:
    with pytest.raises(UnreadableError):
        opened(tmp_path, bad)


def test_a_file_without_one_valid_page_is_an_error(tmp_path: Path) -> None:
    for data in (header(), header() + b"\xff" * 5120, header() + b"\0" * 5120):
        with pytest.raises(UnreadableError, match="no valid data page"):
            opened(tmp_path, data)


def test_what_the_user_says_goes_before_the_header(tmp_path: Path) -> None:
    options = ReadOptions(rate_hz=101, lsb_per_g=128, timezone="UTC")
    recording = opened(tmp_path, header() + five_pages()[0], options).recording
    assert (recording.rate_hz, recording.lsb_per_g, recording.timezone) == (101, 128, "UTC")


def test_a_rate_that_contradicts_the_header_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="100 Hz, not 50"):
        opened(tmp_path, header() + five_pages()[0], ReadOptions(rate_hz=50))


@every_byte
def test_cut_at_every_byte_it_is_shorter_or_unreadable(tmp_path: Path, step: int) -> None:
    data = header(flags=1) + b"".join(five_pages()[:3])
    for size in cuts(data, step, 1):
        try:
            counts, _, _, chunks = all_of(opened(tmp_path, data[:size]))
        except UnreadableError:
            assert size < 1024
            continue
        whole, rest = divmod(size - 512, 512)
        assert np.array_equal(counts, COUNTS[: 80 * whole])
        truncated = [("truncated", 512 + 512 * whole, 80 * whole, rest)] if rest else []
        assert [found for found in problems(chunks) if found[0] == "truncated"] == truncated


def test_a_gzip_file_cut_short_does_not_know_its_length(tmp_path: Path) -> None:
    plain = header() + b"".join(pages(np.tile(COUNTS, (20, 1))))
    packed = gzip.compress(plain)
    reader = opened(tmp_path, packed[: len(packed) * 2 // 3])
    counts, _, _, chunks = all_of(reader)
    assert 0 < len(counts) < 8000
    assert [code for code, *_ in problems(chunks)] == ["truncated"]
    assert (reader.recording.samples, reader.recording.duration_s) == (None, None)
    assert chunks[-1].end_byte <= reader.recording.total_bytes


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in range(2, 5))]
)
def test_a_gzip_file_damaged_within_ends_at_the_same_sample_for_any_chunk_size(
    tmp_path: Path, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    packed = bytearray(gzip.compress(header() + b"".join(pages(rng.integers(-2048, 2047, (8000, 3))))))
    middle = int(rng.integers(len(packed) // 4, len(packed) // 2))
    packed[middle : middle + 1000] = rng.bytes(1000)
    reader = opened(tmp_path, bytes(packed))
    sizes = {len(all_of(reader, chunk_samples)[0]) for chunk_samples in (1, 100, 3000, 1 << 20)}
    assert len(sizes) == 1 and 0 < sizes.pop() < 8000


def test_random_damage_leaves_ascending_times_or_an_error_of_ours(tmp_path: Path) -> None:
    data = header(flags=1) + b"".join(five_pages())
    for seed in range(20):
        rng = np.random.default_rng(seed)
        table = np.frombuffer(data, np.uint8).copy()
        table[rng.integers(0, len(table), rng.integers(1, 40))] = rng.integers(0, 256)
        try:
            _, times, _, _ = all_of(opened(tmp_path, table.tobytes()), 100)
        except AccelcalError:
            continue
        assert (np.diff(times) > 0).all()


def test_many_damaged_places_give_a_bounded_number_of_problems(tmp_path: Path) -> None:
    good = [page(k, at(k), COUNTS[k % 300 : k % 300 + 2]) for k in range(1200)]
    for k in range(1, 1200, 3):
        good[k] = b"\1" + good[k][1:]
    chunks = list(opened(tmp_path, header() + b"".join(good)).chunks(4000))
    found = [entry for entry in problems(chunks) if entry[0] == "checksum"]
    assert len(found) == 100
    assert sum(count for *_, count in found) == 400
    assert len(problems(chunks)) <= 300


def test_preview_enters_the_file_at_evenly_spread_pages(tmp_path: Path) -> None:
    counts = np.tile(COUNTS, (10, 1))
    data = header() + b"".join(pages(counts)) + b"\xff" * 51_200
    pieces = list(opened(tmp_path, data).preview(160, 5))
    assert [(piece.first_sample, len(piece)) for piece in pieces] == [(800 * k, 160) for k in range(5)]
    for piece in pieces:
        assert np.array_equal(piece.counts, counts[piece.first_sample :][:160])
        assert piece.clock.times(0, 1)[0] == START_US + 10_000 * piece.first_sample


def test_sniff_knows_its_signature_alone(tmp_path: Path) -> None:
    for data, score in ((header(), 100), (b"AX" + b"\0" * 3000, 0), (b"\xff" * 3000, 0), (b"x", 0)):
        (tmp_path / "s.bin").write_bytes(data)
        assert FORMAT.sniff(probe_file(tmp_path / "s.bin", ReadOptions())) == score


def documented_page(block: str, fill: int) -> bytes:
    """A page from the lines `offset  bytes` of the specification."""
    data = bytearray([fill]) * 512
    for line in block.strip().splitlines():
        offset, _, text = line.partition("  ")
        data[int(offset, 16) : int(offset, 16) + 16] = bytes.fromhex(text)
    return bytes(data)


def test_the_example_of_the_specification_is_what_the_reader_reads(tmp_path: Path) -> None:
    text = (Path(__file__).parents[3] / "docs" / "flash-format.md").read_text(encoding="utf-8")
    head, first = (part.split("```")[0] for part in text.split("```text\n")[1:3])
    reader = opened(tmp_path, documented_page(head, 0) + documented_page(first, 0xFF))
    (chunk,) = reader.chunks(100)
    assert chunk.counts.tolist() == [[12, -5, 256], [13, -6, 255]]
    assert chunk.clock.times(0, 2).tolist() == [1_709_510_400_250_000, 1_709_510_400_260_000]
    assert chunk.temperature_mc is not None
    assert chunk.temperature_mc.tolist() == [31_500, 31_500]
    recording = reader.recording
    assert (recording.rate_hz, recording.lsb_per_g, recording.range_g) == (100.0, 256.0, 8.0)
    assert (recording.timezone, recording.device.serial) == ("+01:00", "WL-00042")
