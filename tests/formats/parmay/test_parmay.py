"""Matrix files: packets, their checksums and times, temperatures, rotation, and damage anywhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Chunk, Recording, Validity
from accelcal_cli.formats import find_format, open_recording
from tests.formats.cuts import cuts, every_byte
from tests.formats.make_parmay import START_S, header, packet, packets, sealed
from tests.formats.reading import breaks, check_same, rows, times, told

COUNTS = np.random.RandomState(3).randint(-9000, 9000, (1500, 3))
PACKETS = packets(COUNTS)
SIZE = len(PACKETS[0])
OPTIONS = ReadOptions()


def written(path: Path, parts: list[bytes], announced: int | None = None) -> Path:
    path.write_bytes(header(len(parts) if announced is None else announced) + b"".join(parts))
    return path


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "a.BIN"


def read(path: Path, options: ReadOptions = OPTIONS, size: int = 300) -> tuple[Recording, list[Chunk]]:
    with open_recording(path, options) as reader:
        return reader.recording, list(reader.chunks(size))


def test_the_header_gives_ranges_and_the_packets_the_rest(path: Path) -> None:
    recording, chunks = read(written(path, PACKETS))
    assert (recording.lsb_per_g, recording.range_g, recording.rate_hz) == (4096.0, 8.0, 50.0)
    assert (recording.start_us, recording.timezone) == (START_S * 1_000_000, "UTC")
    assert recording.duration_s == 30.0
    assert not recording.has_temperature
    assert recording.gyro_dps_per_lsb is None
    assert (rows(chunks) == COUNTS).all()
    assert (told(chunks), breaks(chunks)) == ([], [])
    assert sum(chunk.used_bytes for chunk in chunks) == 6 * 1500


def test_a_sensor_faster_than_nominal_keeps_to_the_times_of_its_packets(path: Path) -> None:
    many = np.tile(COUNTS, (8, 1))
    parts = [packet(START_S + 117 * k, START_S + 117 * (k + 1), many) for k in range(3)]
    recording, chunks = read(written(path, parts))
    assert recording.rate_hz == 100.0
    assert breaks(chunks) == []
    exact = START_S * 1_000_000 + np.arange(36_000) * 117e6 / 12_000
    assert np.abs(times(chunks) - exact).max() <= 1


def test_skin_temperatures_are_spread_over_their_packet_and_held_until_the_next(path: Path) -> None:
    first, second, third = (COUNTS[at : at + 300] for at in (0, 300, 600))
    parts = [
        packet(START_S, START_S + 6, first),
        packet(START_S + 6, START_S + 12, second, warm=((281, 220), (-283, 210)), heart=((0, 74),)),
        packet(START_S + 12, START_S + 18, third, heart=((1, 2), (3, 4))),
    ]
    recording, chunks = read(written(path, parts))
    warm = np.concatenate([chunk.temperature_mc for chunk in chunks])
    assert recording.has_temperature
    assert (warm == np.repeat([28_100, 28_100, -28_300, -28_300], [300, 150, 150, 300])).all()
    assert (rows(chunks) == COUNTS[:900]).all()


def test_rotation_rates_of_each_sample(path: Path) -> None:
    turn = COUNTS[::-1][:300]
    parts = [
        packet(START_S, START_S + 6, COUNTS[:300], gyro=turn),
        packet(START_S + 6, START_S + 12, COUNTS[300:600], gyro=turn[:150]),
        packet(START_S + 12, START_S + 18, COUNTS[600:900]),
    ]
    recording, chunks = read(written(path, parts))
    gyro = np.concatenate([chunk.gyro_counts for chunk in chunks])
    assert recording.gyro_dps_per_lsb == (2000 / 32_768,) * 3
    assert (gyro[:300] == turn).all()
    assert (gyro[300:600] == np.repeat(turn[:150], 2, axis=0)).all(), "at half the rate, each for two rows"
    assert (gyro[600:] == turn[149]).all()
    assert told(chunks) == [("missing_value", None, 900, 1, 0)]


def test_without_a_gyroscope_s_range_there_are_no_rates(path: Path) -> None:
    whole = packet(START_S, START_S + 6, COUNTS[:300], gyro=COUNTS[:300])
    path.write_bytes(header(1, range_dps=0) + whole)
    recording, chunks = read(path)
    assert recording.gyro_dps_per_lsb is None
    assert chunks[0].gyro_counts is None


@pytest.mark.parametrize("at", [0, 7, 9, 12, 20, 25, 36, 100, SIZE - 1])
def test_a_bit_wrong_anywhere_loses_one_packet_and_is_told(path: Path, at: int) -> None:
    spoilt = bytearray(PACKETS[2])
    spoilt[at] ^= 1
    _, chunks = read(written(path, [*PACKETS[:2], bytes(spoilt), *PACKETS[3:]]))
    assert (rows(chunks) == np.delete(COUNTS, slice(600, 900), axis=0)).all()
    assert breaks(chunks) == [600]
    assert times(chunks)[600] == (START_S + 18) * 1_000_000
    lost = [(code, sample, lost) for code, _, sample, _, lost in told(chunks)]
    assert lost[0][0] in ("checksum", "bad_page")
    assert sum(lost for *_, lost in lost) == SIZE
    assert {sample for _, sample, _ in lost} == {600}


def test_bytes_between_packets_and_after_a_lost_beginning(path: Path) -> None:
    parts = [PACKETS[0], b"rubbish", PACKETS[1], bytes(50), PACKETS[2][100:], PACKETS[3]]
    _, chunks = read(written(path, parts, 4))
    assert (rows(chunks) == np.concatenate([COUNTS[:600], COUNTS[900:1200]])).all()
    first = 524 + SIZE
    assert told(chunks) == [
        ("bad_page", first, 300, 1, 7),
        ("bad_page", first + 7 + SIZE, 600, 1, 50 + SIZE - 100),
    ]


@pytest.mark.parametrize("blank", [b"\0", b"\xff"])
def test_unused_memory_at_the_end_is_no_damage(path: Path, blank: bytes) -> None:
    _, chunks = read(written(path, [*PACKETS, blank * 5000], 5))
    assert (rows(chunks) == COUNTS).all()
    assert told(chunks) == []


def test_a_pause_is_a_gap_of_its_length(path: Path) -> None:
    later = [packet(START_S + 12 + 40, START_S + 18 + 40, COUNTS[600:900])]
    _, chunks = read(written(path, [*PACKETS[:2], *later]))
    assert breaks(chunks) == [600]
    assert times(chunks)[600] - times(chunks)[599] == 40_020_000


def test_a_second_between_packets_is_rounding(path: Path) -> None:
    later = [packet(START_S + 13, START_S + 19, COUNTS[600:900])]
    _, chunks = read(written(path, [*PACKETS[:2], *later]))
    assert breaks(chunks) == []
    assert np.diff(times(chunks)).max() < 25_000


def test_packets_without_samples_are_passed_over(path: Path) -> None:
    empty = packet(START_S + 6, START_S + 6, COUNTS[:0], warm=((281, 220),))
    _, chunks = read(written(path, [PACKETS[0], empty, *PACKETS[1:]]))
    assert (rows(chunks) == COUNTS).all()
    assert (told(chunks), breaks(chunks)) == ([], [])


def test_packets_that_never_came_are_told(path: Path) -> None:
    _, chunks = read(written(path, PACKETS, 7))
    assert told(chunks) == [("truncated", path.stat().st_size, 1500, 2, 0)]


@every_byte
def test_cut_anywhere(path: Path, step: int) -> None:
    data = header(3) + b"".join(packets(COUNTS[:60], rows=20, rate_hz=20))
    size = (len(data) - 524) // 3
    for length in cuts(data, step):
        path.write_bytes(data[:length])
        whole = max(0, length - 524) // size
        if not whole:
            with pytest.raises(UnreadableError, match=r"a\.BIN"):
                read(path, ReadOptions(format="parmay"))
            continue
        _, chunks = read(path)
        assert (rows(chunks) == COUNTS[: 20 * whole]).all()
        left = (length - 524) % size
        part = [("truncated", 524 + whole * size, 20 * whole, 1, left)] if left >= 8 else []
        part = [("bad_page", 524 + whole * size, 20 * whole, 1, left)] if 0 < left < 8 else part
        missing = 3 - whole - (left > 0)
        assert told(chunks)[: len(part)] == part
        assert len(told(chunks)) == len(part) + (missing > 0)


def test_the_pieces_do_not_depend_on_the_length_of_what_is_read(path: Path) -> None:
    long = np.tile(COUNTS, (9, 1))
    made = packets(long, rows=1350)
    made[3] = made[3][:2000]
    made[6] = made[6][:100] + b"?" + made[6][101:]
    written(path, [*made, b"MDTCPA"])
    found = [read(path, size=size)[1] for size in (1, 700, 5000, 10**6)]
    check_same(*found)
    assert len({len(chunks) for chunks in found}) > 1


def test_a_header_without_its_first_bytes(path: Path) -> None:
    path.write_bytes(written(path, PACKETS).read_bytes()[2:])
    recording, chunks = read(path)
    assert recording.range_g == 8.0
    assert (rows(chunks) == COUNTS).all()
    assert told(chunks) == [("damaged_header", 0, 0, 1, 0)]


@pytest.mark.parametrize("head", [b"", bytes(524), header(5, range_g=0)])
def test_without_a_header_the_scale_must_be_given(path: Path, head: bytes) -> None:
    path.write_bytes(head + b"".join(PACKETS))
    assert find_format(path, OPTIONS).name == "parmay"
    with pytest.raises(UnreadableError, match="--lsb-per-g"):
        read(path)
    recording, chunks = read(path, ReadOptions(lsb_per_g=4096.0))
    assert (recording.lsb_per_g, recording.range_g) == (4096.0, None)
    assert (rows(chunks) == COUNTS).all()
    assert told(chunks)[0][0] == "damaged_header"


def test_without_times_the_rate_must_be_given(path: Path) -> None:
    stopped = [packet(START_S, START_S, COUNTS[:300])]
    with pytest.raises(UnreadableError, match="--rate"):
        read(written(path, stopped))
    recording, chunks = read(path, ReadOptions(rate_hz=50.0))
    assert recording.rate_hz == 50.0
    assert times(chunks)[-1] == START_S * 1_000_000 + 299 * 20_000


def test_a_rate_that_contradicts_the_packets_is_refused(path: Path) -> None:
    with pytest.raises(UsageError, match="50 Hz, not 25"):
        read(written(path, PACKETS), ReadOptions(rate_hz=25.0))


def test_the_ends_of_16_bits_are_clipped(path: Path) -> None:
    ends = COUNTS[:300].copy()
    ends[10, 1], ends[20, 2] = -32_768, 32_767
    _, chunks = read(written(path, [packet(START_S, START_S + 6, ends)]))
    assert np.flatnonzero(chunks[0].validity == Validity.CLIPPED).tolist() == [10, 20]


def test_a_packet_that_claims_too_much_is_left_out(path: Path) -> None:
    absurd = sealed(np.array([START_S, START_S, 1 << 31, 1 << 31, 0, 0], "<u4").tobytes())
    _, chunks = read(written(path, [PACKETS[0], absurd, *PACKETS[1:]]))
    assert (rows(chunks) == COUNTS).all()
    assert told(chunks) == [("checksum", 524 + SIZE, 300, 1, 36)]


def test_a_preview_enters_a_long_file_anywhere(path: Path) -> None:
    long = np.tile(COUNTS, (200, 1))
    with open_recording(written(path, packets(long, rows=3000)), OPTIONS) as reader:
        pieces = list(reader.preview(300, 4))
    assert len(pieces) == 4
    assert len({int(piece.time_us[0]) for piece in pieces}) == 4
    assert not any(piece.problems for piece in pieces)
