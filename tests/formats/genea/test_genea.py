"""GENEA files: slots, their checksums and times, the factory's calibration, and damage anywhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Chunk, Recording, Validity
from accelcal_cli.formats import find_format, open_recording
from tests.formats.cuts import cuts, every_byte
from tests.formats.make_genea import START_S, battery, crc8, header, pages, sample, slots, time
from tests.formats.reading import breaks, check_same, rows, times, told

COUNTS = np.random.RandomState(3).randint(-2000, 2000, (1600, 3))
MADE = slots(COUNTS, 80)
START = len(header())
RAW = ReadOptions(lsb_per_g=340.0)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "a.bin"


def written(path: Path, body: bytes, head: bytes = header()) -> Path:
    path.write_bytes(head + body)
    return path


def read(path: Path, options: ReadOptions = RAW, size: int = 400) -> tuple[Recording, list[Chunk]]:
    with open_recording(path, options) as reader:
        return reader.recording, list(reader.chunks(size))


def test_slots_of_a_real_file() -> None:
    """The first sample, a time and a voltage of GGIRread's genea_testfile.bin."""
    known = [bytes.fromhex(text) for text in ("ce0000001e9b", "e540710a1ecf", "130fff000e95", "250000000e96")]
    assert [crc8(slot[1:]) for slot in known] == [slot[0] for slot in known]
    assert sample(np.array([0, 1, 0x165])) == known[0]


def test_the_header_tells_rate_device_and_calibration(path: Path) -> None:
    head = header(gains="8144 8132 8004", offsets="1 -3 -13")
    recording, chunks = read(written(path, pages(MADE), head), ReadOptions())
    assert (recording.rate_hz, recording.range_g) == (80.0, 2048 / 340)
    assert (recording.device.model, recording.device.serial) == ("GENEA", "01275")
    assert (recording.start_us, recording.timezone) == (START_S * 1_000_000, None)
    assert recording.lsb_per_g == 8192 * 340 / 4
    assert (rows(chunks) == (COUNTS + np.array([1, -3, -13])) * np.array([2036, 2033, 2001])).all()
    assert recording.duration_s == 20.0
    assert (told(chunks), breaks(chunks)) == ([], [])
    assert sum(chunk.used_bytes for chunk in chunks) == 6 * 1600


def test_samples_before_the_first_time_and_a_faster_sensor(path: Path) -> None:
    _, chunks = read(written(path, pages(slots(COUNTS, 80, ahead=48))))
    assert times(chunks)[0] == START_S * 1_000_000 - 600_000
    assert (np.diff(times(chunks)) == 12_500).all()
    many = np.tile(COUNTS, (5, 1))
    _, chunks = read(written(path, pages(slots(many, 82))))
    assert breaks(chunks) == []
    seconds = START_S + np.arange(8000) / 82
    assert np.abs(times(chunks) / 1e6 - seconds).max() < 1.02


@pytest.mark.parametrize("number", [0, 1, 5, 82, 340, 341, 700])
def test_a_wrong_bit_loses_one_slot(path: Path, number: int) -> None:
    made = list(MADE)
    made[number] = made[number][:3] + bytes([made[number][3] ^ 4]) + made[number][4:]
    _, chunks = read(written(path, pages(made)))
    held = [k for k, slot in enumerate(MADE) if slot[1] >> 4 == 0]
    kept = [index for index, k in enumerate(held) if k != number]
    assert (rows(chunks) == COUNTS[kept]).all()
    (only,) = told(chunks)
    assert (only[0], only[3:]) == ("missing_value", (1, 6))


def test_an_erased_page_is_a_gap(path: Path) -> None:
    body = bytearray(pages(MADE))
    body[2048:4096] = b"\xff" * 2048
    _, chunks = read(written(path, bytes(body)))
    before = sum(slot[1] >> 4 == 0 for slot in MADE[:341])
    after = sum(slot[1] >> 4 == 0 for slot in MADE[682:])
    assert (rows(chunks) == np.concatenate([COUNTS[:before], COUNTS[-after:]])).all()
    assert breaks(chunks) == [before]
    assert told(chunks) == [("bad_page", START + 2048, before, 1, 2048)]
    exact = START_S * 1_000_000 + np.arange(1600) * 12_500
    assert (times(chunks)[:before] == exact[:before]).all()
    assert np.abs(times(chunks)[before:] - exact[-after:]).max() <= 1_000_000


@pytest.mark.parametrize("blank", [b"\0", b"\xff"])
@pytest.mark.parametrize("more", [0, 1000, 2048 * 5 + 7])
def test_unused_memory_at_the_end_is_no_damage(path: Path, blank: bytes, more: int) -> None:
    _, chunks = read(written(path, pages(MADE, blank) + blank * more))
    assert (rows(chunks) == COUNTS).all()
    assert told(chunks) == []


def test_a_pause_between_times(path: Path) -> None:
    made = MADE[:81] + slots(COUNTS[80:160], 80)[1:]
    made[81:81] = [time(START_S + 40)]
    _, chunks = read(written(path, pages(made)))
    assert breaks(chunks) == [80]
    assert times(chunks)[80] == (START_S + 40) * 1_000_000
    assert [code for code, *_ in told(chunks)] == ["clock_gap"]


def test_without_times_they_count_from_the_beginning(path: Path) -> None:
    many = np.tile(COUNTS, (4, 1))
    made = [sample(row) for row in many]
    found = [read(written(path, pages(made)), size=size) for size in (1, 900, 10**6)]
    for recording, chunks in found:
        assert recording.start_us is None
        assert (rows(chunks) == many).all()
        assert (times(chunks) == np.arange(len(many)) * 12_500).all()
        assert [code for code, *_ in told(chunks)] == ["no_start_time"]


@every_byte
def test_cut_anywhere(path: Path, step: int) -> None:
    data = header() + pages(MADE[:700])[: 2 * 2048 + 18 * 6]
    for length in cuts(data, step):
        path.write_bytes(data[:length])
        page, left = divmod(max(0, length - START), 2048)
        whole = MADE[: page * 341 + min(left // 6, 341)]
        samples = sum(slot[1] >> 4 == 0 for slot in whole)
        if not samples:
            with pytest.raises(UnreadableError, match=r"a\.bin"):
                read(path, ReadOptions(format="genea", lsb_per_g=340.0))
            continue
        _, chunks = read(path)
        assert (rows(chunks) == COUNTS[:samples]).all()
        codes = ["truncated"] if left else []
        assert [code for code, *_ in told(chunks) if code != "no_start_time"] == codes


def test_the_pieces_do_not_depend_on_the_length_of_what_is_read(path: Path) -> None:
    made = slots(np.tile(COUNTS, (8, 1)), 80)
    body = bytearray(pages(made))
    for at, size in ((3000, 5), (9000, 2500), (30_000, 1), (40_960, 6000)):
        body[at : at + size] = b"\xff" * size
    written(path, bytes(body))
    found = [read(path, size=size)[1] for size in (1, 700, 5000, 10**6)]
    check_same(*found)
    assert len({len(chunks) for chunks in found}) > 1


@pytest.mark.parametrize(
    "head",
    [header(gains="0 0 0"), header(offsets="1 2"), header(gains="8192 8192 99999"), header(offsets="")],
)
def test_without_the_factory_s_calibration_the_scale_must_be_given(path: Path, head: bytes) -> None:
    written(path, pages(MADE), head)
    assert find_format(path, RAW).name == "genea"
    with pytest.raises(UnreadableError, match=r"--lsb-per-g .*340"):
        read(path, ReadOptions())
    assert (rows(read(path)[1]) == COUNTS).all()


def test_without_a_rate_it_must_be_given(path: Path) -> None:
    written(path, pages(MADE), header("fast"))
    with pytest.raises(UnreadableError, match="--rate"):
        read(path)
    assert read(path, ReadOptions(lsb_per_g=340.0, rate_hz=80.0))[0].rate_hz == 80.0
    with pytest.raises(UsageError, match="80 Hz, not 25"):
        read(written(path, pages(MADE)), ReadOptions(rate_hz=25.0))


def test_a_header_without_an_end_is_refused(path: Path) -> None:
    with pytest.raises(UnreadableError, match="empty line"):
        read(written(path, pages(MADE), header()[:-3] + b"?"))


def test_the_ends_of_12_bits_are_clipped(path: Path) -> None:
    ends = COUNTS[:80].copy()
    ends[10, 1], ends[20, 1] = -2048, 2047
    _, chunks = read(written(path, pages(slots(ends, 80))))
    validity = np.concatenate([chunk.validity for chunk in chunks if chunk.validity is not None])
    assert np.flatnonzero(validity == Validity.CLIPPED).tolist() == [10, 20]


def test_other_slots_are_passed_over(path: Path) -> None:
    made = [*MADE[:40], battery(), battery(), *MADE[40:]]
    assert (rows(read(written(path, pages(made)))[1]) == COUNTS).all()


def test_a_preview_enters_the_file_anywhere(path: Path) -> None:
    with open_recording(written(path, pages(slots(np.tile(COUNTS, (8, 1)), 80))), RAW) as reader:
        pieces = list(reader.preview(500, 4))
    assert len({int(piece.time_us[0]) for piece in pieces}) == 4
