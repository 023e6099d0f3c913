"""ActiGraph recordings whose log.bin has lost, damaged or foreign bytes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.recording import Validity
from tests.formats.cuts import cuts, every_byte
from tests.formats.gt3x.reading import Whole, opened, random_counts, whole
from tests.formats.make_gt3x import (
    ACTIVITY,
    START_S,
    START_US,
    battery,
    encoded,
    info,
    parameters,
    record,
    seconds,
    written,
)

RATE = 30
VALUES = random_counts(20 * RATE)
LENGTH = 9 + 135
FIRST = parameters({(1, 10): RATE, (0, 55): encoded(256.0)})
HEAD = len(FIRST)


def log() -> list[bytes]:
    """Twenty seconds of packed samples after a record of parameters."""
    return [FIRST, *seconds(VALUES, RATE, ACTIVITY)]


def read(folder: Path, data: bytes) -> Whole:
    return whole(written(folder / "a.gt3x", [data], info(RATE)), 100)


def without(*lost: int) -> np.ndarray:
    return np.delete(VALUES.reshape(20, RATE, 3), lost, axis=0).reshape(-1, 3)


def spoiled(one: bytes, at: int = 50, bits: int = 4) -> bytes:
    return one[:at] + bytes([one[at] ^ bits]) + one[at + 1 :]


@pytest.mark.parametrize("at", [1, 3, 8, 50, LENGTH - 1])
def test_records_with_a_wrong_checksum_are_left_out_and_counted(tmp_path: Path, at: int) -> None:
    records = log()
    for k in (3, 4, 9):
        records[1 + k] = spoiled(records[1 + k], at)
    found = read(tmp_path, b"".join(records))
    assert (found.counts == without(3, 4, 9)).all()
    assert found.breaks == [3 * RATE, 7 * RATE]
    assert found.found == [
        ("checksum", HEAD + 3 * LENGTH, 3 * RATE, 2),
        ("checksum", HEAD + 9 * LENGTH, 7 * RATE, 1),
    ]
    kept = np.delete(np.arange(20), (3, 4, 9))
    assert (found.times[::RATE] == START_US + 1_000_000 * kept).all()


def test_a_wrong_checksum_at_either_end_is_not_the_end_of_the_file(tmp_path: Path) -> None:
    records = log()
    records[0], records[1], records[-1] = (spoiled(records[k], 10) for k in (0, 1, -1))
    found = read(tmp_path, b"".join(records))
    assert (found.counts == without(0, 19)).all()
    assert found.found == [("checksum", 0, 0, 2), ("checksum", HEAD + 19 * LENGTH, 18 * RATE, 1)]


def test_damage_to_a_record_without_samples_breaks_nothing(tmp_path: Path) -> None:
    records = log()
    records[5:5] = [spoiled(battery(START_S + 3), 8)]
    found = read(tmp_path, b"".join(records))
    assert (found.counts == VALUES).all()
    assert (found.breaks, found.found) == ([], [("checksum", HEAD + 4 * LENGTH, 4 * RATE, 1)])


@pytest.mark.parametrize("value", [0x00, 0x1F, 0xFF])
@pytest.mark.parametrize(("byte", "code"), [(0, "checksum"), (6, "bad_bytes"), (7, "bad_bytes")])
def test_a_damaged_separator_or_size_loses_one_record(
    tmp_path: Path, byte: int, code: str, value: int
) -> None:
    records = log()
    records[8] = records[8][:byte] + bytes([value]) + records[8][byte + 1 :]
    found = read(tmp_path, b"".join(records))
    if records[8] == log()[8]:
        assert (found.measured == VALUES).all()
        return
    assert (found.measured == without(7)).all()
    lost = 1 if code == "checksum" else LENGTH
    assert found.found == [(code, HEAD + 7 * LENGTH, 7 * RATE, lost)]


@pytest.mark.parametrize("filler", [b"\0", b"\xff", b"\x1e"])
@pytest.mark.parametrize("size", [9, 100, 500, 100_000])
def test_foreign_bytes_between_records_are_passed_over(tmp_path: Path, filler: bytes, size: int) -> None:
    records = log()
    found = read(tmp_path, b"".join([*records[:8], filler * size, *records[8:]]))
    assert (found.counts == VALUES).all()
    assert found.breaks == []
    assert found.found == [("bad_bytes", HEAD + 7 * LENGTH, 7 * RATE, size)]


def test_a_zeroed_block_loses_what_lies_in_it(tmp_path: Path) -> None:
    data = bytearray(b"".join(log()))
    begin = HEAD + 5 * LENGTH + 70
    data[begin : begin + 512] = bytes(512)
    found = read(tmp_path, bytes(data))
    assert (found.counts == without(5, 6, 7, 8, 9)[: len(found.counts)]).all()
    assert (found.measured == without(5, 6, 7, 8, 9)).all()
    assert found.breaks == [5 * RATE]
    assert sum(count for *_, count in found.found) == 5 * LENGTH or found.found[0][0] == "checksum"


def test_missing_bytes_lose_the_records_they_were_taken_from(tmp_path: Path) -> None:
    data = b"".join(log())
    for size in (1, 8, 77, LENGTH, LENGTH + 1, 1000):
        found = read(tmp_path, data[: HEAD + 1000] + data[HEAD + 1000 + size :])
        lost = range(1000 // LENGTH, (1000 + size - 1) // LENGTH + 1)
        assert (found.counts == without(*lost)).all()
        assert found.breaks == [lost[0] * RATE]
        assert found.found


def test_what_lies_right_before_lost_bytes_is_marked_unless_its_end_is_sure(tmp_path: Path) -> None:
    records = log()
    found = read(tmp_path, b"".join([*records[:8], b"\xaa" * 40, *records[8:]]))
    assert np.flatnonzero(found.validity == Validity.RECOVERED).tolist() == list(range(6 * RATE, 7 * RATE))
    assert (found.counts == VALUES).all()
    padded = read(tmp_path, b"".join([*records[:8], bytes(8), *records[8:], bytes(8)]))
    assert (not padded.validity.any(), padded.found) == (True, [])


def test_a_record_among_foreign_bytes_is_believed_if_its_time_is_the_recordings(tmp_path: Path) -> None:
    noise, records, bytes_lost = b"\xaa" * 40, log(), [("bad_bytes", HEAD + 7 * LENGTH, 7 * RATE)]
    for second, lost in ((START_S + 7, [40, 40]), (START_S + 400 * 86_400, [91]), (7, [91])):
        middle = noise + battery(second) + noise
        found = read(tmp_path, b"".join([*records[:8], middle, *records[8:]]))
        assert [count for *_, count in found.found] == lost
        assert [tuple(item[:3]) for item in found.found][:1] == bytes_lost
        assert (found.counts == VALUES).all()


@pytest.mark.parametrize(
    "piece", [pytest.param(size, marks=pytest.mark.nightly) for size in (500, 997, 1009, 2000, 3001)]
)
def test_the_pieces_in_which_it_is_read_change_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, piece: int
) -> None:
    records = log()
    records[3] = spoiled(records[3])
    records[5:5] = [b"\xaa" * 99]
    path = written(tmp_path / "a.gt3x", [b"".join(records) + records[4][:50]], info(RATE))
    expected = whole(path)
    for size in range(piece, piece + 150):
        monkeypatch.setattr("accelcal_cli.formats.gt3x.records.PIECE_BYTES", size)
        assert whole(path).same_as(expected)


def test_repeated_and_exchanged_blocks_step_back_in_time(tmp_path: Path) -> None:
    records = log()
    found = read(tmp_path, b"".join(records[:11] + records[6:]))
    assert (found.counts == np.concatenate((VALUES[: 10 * RATE], VALUES[5 * RATE :]))).all()
    assert found.found == [("clock_back", HEAD + 10 * LENGTH, 10 * RATE, 1)]
    found = read(tmp_path, b"".join(records[:6] + records[11:] + records[6:11]))
    assert [code for code, *_ in found.found] == ["clock_gap", "clock_back"]
    assert found.breaks == [5 * RATE, 15 * RATE]


@every_byte
def test_truncation_at_every_byte_gives_fewer_rows_or_a_plain_error(tmp_path: Path, step: int) -> None:
    data = b"".join(log()[:3])
    for size in [*cuts(data, step), len(data)]:
        left, rest = divmod(max(0, size - HEAD), LENGTH)
        if not left:
            with pytest.raises(UnreadableError, match=r"a\.gt3x: holds no acceleration.*copy it again"):
                read(tmp_path, data[:size])
            continue
        found = read(tmp_path, data[:size])
        assert (found.counts == VALUES[: left * RATE]).all()
        tail = [("truncated", HEAD + left * LENGTH, left * RATE, rest)] if rest else []
        assert (found.breaks, found.found) == ([], tail)


@pytest.mark.nightly
def test_nothing_depends_on_the_size_of_chunks_or_where_pieces_end(tmp_path: Path) -> None:
    """Damage at many places of a file of several pieces, some of it across their ends."""
    values = random_counts(7000 * RATE, 3)
    data = bytearray(b"".join(seconds(values, RATE, ACTIVITY)))
    for at in range(5000, len(data), 40_009):
        data[at : at + 3000 * (at % 2) + 7] = bytes(3000 * (at % 2) + 7)
    data[786_432 - 70_000 : 786_432 + 70_000] = b"\x1e" * 140_000
    path = written(tmp_path / "a.gt3x", [bytes(data)], info(RATE))
    found = whole(path, 1 << 17)
    assert found.same_as(whole(path, 1))
    assert found.same_as(whole(path, 10**9))
    second = (found.times - START_US) // 1_000_000
    assert (found.counts.reshape(-1, RATE, 3) == values.reshape(-1, RATE, 3)[second[::RATE]]).all()
    assert len(found.measured) > 0.8 * len(values)


def test_many_problems_are_few_records(tmp_path: Path) -> None:
    records = seconds(random_counts(2000 * 10), 10, ACTIVITY)
    records[1::2] = [spoiled(one, 20) for one in records[1::2]]
    found = whole(written(tmp_path / "a.gt3x", records, info(10)))
    assert len(found.problems) <= 101
    assert sum(count for *_, count in found.found) == 1000
    assert len(found.breaks) == 999


def test_a_file_without_a_sound_record_is_refused(tmp_path: Path) -> None:
    for data in (b"", bytes(5000), b"\x1e" * 5000, record(77, START_S, b"abc") * 100):
        with pytest.raises(UnreadableError, match="holds no acceleration"):
            opened(written(tmp_path / "a.gt3x", [data]))
