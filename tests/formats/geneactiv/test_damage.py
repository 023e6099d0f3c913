"""GENEActiv recordings with lost, damaged, repeated and foreign pages, and damaged headers."""

from __future__ import annotations

import gzip
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.recording import Chunk
from tests.formats.geneactiv.test_geneactiv import everything, joined, opened, random_counts, times_of
from tests.formats.make_geneactiv import START_US, Page, digits, header, pages
from tests.formats.reading import breaks, problems

VALUES = random_counts(3000)
PAGE_US = 6_000_000
HEAD = header(pages=10)
Found = list[tuple[str, int | None, int, int]]


def ten() -> list[Page]:
    return pages(VALUES)


def read(path: Path, chunk_samples: int = 900, **options: object) -> tuple[list[Chunk], list[int], Found]:
    chunks = list(opened(path, **options).chunks(chunk_samples))
    return chunks, breaks(chunks), problems(chunks)


def texts() -> list[bytes]:
    return [page.to_bytes() for page in ten()]


def raw_file(path: Path, data: list[bytes], head: bytes = HEAD) -> Path:
    path.write_bytes(head + b"".join(data))
    return path


def begin(data: list[bytes], place: int) -> int:
    """Where a page begins."""
    return len(HEAD) + sum(len(text) for text in data[:place])


def without(*lost: int) -> np.ndarray:
    return np.concatenate([VALUES[300 * k : 300 * k + 300] for k in range(10) if k not in lost])


def spoiled(text: bytes, old: bytes, new: bytes) -> bytes:
    assert old in text
    return text.replace(old, new, 1)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"Recorded Data", b"Recorded_Data"),
        (b"Sequence Number:3", b"Sequence Number:3x"),
        (b"Sequence Number", b"Sequence Mumber"),
        (b"Page Time:2024", b"Page Time:\0\0\0\0"),
        (b"Page Time:20", b"Page Time:99"),
        (b"00:00:18", b"00:61:18"),
        (b"Temperature:", b"Temperature;"),
        (b"Unassigned:\n", b"Unassigned:"),
        (b"Recording\n", b"Recording" + bytes(100) + b"\n"),
    ],
)
def test_a_page_whose_text_is_damaged_is_left_out(tmp_path: Path, old: bytes, new: bytes) -> None:
    data = texts()
    data[3] = spoiled(data[3], old, new)
    chunks, breaks, problems = read(raw_file(tmp_path / "a.bin", data))
    assert (joined(chunks, "counts") == without(3)).all()
    assert breaks == [900]
    assert problems == [("bad_page", begin(data, 3), 900, 1)]
    assert times_of(chunks)[900] == START_US + 4 * PAGE_US


@pytest.mark.parametrize(
    ("old", "new"), [(b"0", b"g"), (b"0", b"\0"), (b"0", b" "), (b"0", b"\xff"), (b"0", b":")]
)
def test_a_character_that_is_no_digit_costs_its_page(tmp_path: Path, old: bytes, new: bytes) -> None:
    data = texts()
    for page in (3, 4, 8):
        data[page] = data[page][:1500] + data[page][1500:].replace(old, new, 1)
    chunks, breaks, problems = read(raw_file(tmp_path / "a.bin", data))
    assert (joined(chunks, "counts") == without(3, 4, 8)).all()
    assert breaks == [900, 1800]
    assert problems == [("bad_page", begin(data, 3), 900, 2), ("bad_page", begin(data, 8), 1800, 1)]


@pytest.mark.parametrize("more", [-3601, -3600, -3599, -1200, -12, -1, 1, 12, 3600, 9000])
def test_a_page_with_too_few_or_too_many_digits_is_left_out(tmp_path: Path, more: int) -> None:
    data = texts()
    body = digits(VALUES[900:1200])
    data[3] = replace(ten()[3], body=(body * 4)[: 3600 + more] if more > -3601 else "").to_bytes()
    chunks, breaks, problems = read(raw_file(tmp_path / "a.bin", data))
    assert (joined(chunks, "counts") == without(3)).all()
    assert breaks == [900]
    assert problems == [("bad_page", begin(data, 3), 900, 1)]


def test_pages_that_are_not_there_are_a_gap(tmp_path: Path) -> None:
    data = texts()
    chunks, breaks, problems = read(raw_file(tmp_path / "a.bin", data[:2] + data[5:]))
    assert (joined(chunks, "counts") == without(2, 3, 4)).all()
    assert (breaks, problems) == ([600], [("sequence_gap", begin(data, 2), 600, 3)])
    assert (times_of(chunks)[600:] == START_US + 5 * PAGE_US + 20_000 * np.arange(1500)).all()


def test_first_pages_that_are_not_there(tmp_path: Path) -> None:
    data = texts()
    data[4] = spoiled(data[4], b"Temperature:", b"Temperature;")
    chunks, breaks, problems = read(raw_file(tmp_path / "a.bin", data[4:]))
    assert (joined(chunks, "counts") == without(0, 1, 2, 3, 4)).all()
    assert not breaks
    assert problems == [("sequence_gap", len(HEAD), 0, 4), ("bad_page", len(HEAD), 0, 1)]
    assert times_of(chunks)[0] == START_US + 5 * PAGE_US


def test_zeros_over_several_pages(tmp_path: Path) -> None:
    data = b"".join(texts())
    size = len(texts()[0])
    hole = slice(2 * size + 700, 4 * size + 200)
    text = data[: hole.start] + bytes(hole.stop - hole.start) + data[hole.stop :]
    chunks, breaks, problems = read(raw_file(tmp_path / "a.bin", [text]))
    assert (joined(chunks, "counts") == without(2, 3, 4)).all()
    assert breaks == [600]
    place = len(HEAD) + 2 * size
    assert problems == [("bad_page", place, 600, 1), ("sequence_gap", len(HEAD) + 5 * size, 600, 2)]


def test_whole_pages_of_zeros_or_of_anything(tmp_path: Path) -> None:
    data = texts()
    data[4:6] = [bytes(len(data[4])), b"\x00\xffabc\n" * 1000]
    chunks, breaks, problems = read(raw_file(tmp_path / "a.bin", data))
    assert (joined(chunks, "counts") == without(4, 5)).all()
    assert breaks == [1200]
    assert problems == [("bad_page", begin(data, 4), 1200, 1), ("sequence_gap", begin(data, 6), 1200, 1)]


def test_blank_lines_between_pages_are_nothing(tmp_path: Path) -> None:
    data = texts()
    chunks, breaks, problems = read(raw_file(tmp_path / "a.bin", [text + b"\r\n \n" for text in data]))
    assert (joined(chunks, "counts") == VALUES).all()
    assert not breaks and not problems


def test_a_few_strange_characters_between_pages_cost_no_page(tmp_path: Path) -> None:
    data = texts()
    chunks, _, problems = read(raw_file(tmp_path / "a.bin", [*data[:4], b"xyz\n", *data[4:]]))
    assert (joined(chunks, "counts") == VALUES).all()
    assert problems == [("bad_page", begin(data, 4), 1200, 1)]


def test_an_end_with_two_pages_that_are_cut_off(tmp_path: Path) -> None:
    data = texts()
    _, _, problems = read(raw_file(tmp_path / "a.bin", [*data[:9], data[9][:100], data[9][:150]]))
    place = begin(data, 9)
    assert problems == [("bad_page", place, 2700, 1), ("truncated", place + 100, 2700, 300)]


@pytest.mark.parametrize("chunk_samples", [300, 10_000])
@pytest.mark.parametrize(("first", "stop"), [(3, 4), (2, 5), (0, 10)])
def test_repeated_pages_are_used_once(tmp_path: Path, first: int, stop: int, chunk_samples: int) -> None:
    data = texts()
    again = data[:stop] + data[first:stop] + data[stop:]
    chunks, _, problems = read(raw_file(tmp_path / "a.bin", again), chunk_samples)
    assert (joined(chunks, "counts") == VALUES).all()
    assert (times_of(chunks) == START_US + 20_000 * np.arange(3000)).all()
    assert problems == [("repeated_page", begin(data, stop), 300 * stop, stop - first)]


def test_pages_in_another_order_are_all_used(tmp_path: Path) -> None:
    data = texts()
    data[3], data[6] = data[6], data[3]
    chunks, breaks, problems = read(raw_file(tmp_path / "a.bin", data))
    order = [0, 1, 2, 6, 4, 5, 3, 7, 8, 9]
    assert (
        joined(chunks, "counts") == np.concatenate([VALUES[300 * k : 300 * k + 300] for k in order])
    ).all()
    assert breaks == [900, 1200, 1800, 2100]
    assert {code for code, *_ in problems} == {"sequence_gap", "sequence_back", "clock_back"}


def test_pages_of_another_device_or_rate_are_left_out(tmp_path: Path) -> None:
    content = ten()
    content[2] = replace(content[2], serial="099999")
    content[6] = replace(content[6], rate="100.0")
    data = [page.to_bytes() for page in content]
    chunks, breaks, problems = read(raw_file(tmp_path / "a.bin", data))
    assert (joined(chunks, "counts") == without(2, 6)).all()
    assert breaks == [600, 1500]
    assert problems == [("bad_page", begin(data, 2), 600, 1), ("rate_change", begin(data, 6), 1500, 1)]


def test_an_end_within_a_page_keeps_its_whole_samples(tmp_path: Path) -> None:
    data = texts()
    body = len(data[9]) - 3601
    for digits_left, whole in ((0, 0), (11, 0), (12, 1), (1210, 100), (3599, 299)):
        cut = raw_file(tmp_path / "a.bin", [*data[:9], data[9][: body + digits_left]])
        chunks, breaks, problems = read(cut)
        assert (joined(chunks, "counts") == VALUES[: 2700 + whole]).all()
        assert not breaks
        assert problems == [("truncated", begin(data, 9), 2700 + whole, 300 - whole)]


def test_a_gzip_file_damaged_within_is_refused(tmp_path: Path) -> None:
    packed = tmp_path / "a.bin.gz"
    data = bytearray(gzip.compress(HEAD + b"".join(texts()), 1))
    data[len(data) // 2] ^= 255
    packed.write_bytes(data)
    with pytest.raises(UnreadableError, match="gzip data is damaged"):
        read(packed)


def test_many_problems_are_few_records(tmp_path: Path) -> None:
    data = [page.to_bytes() for page in pages(random_counts(75_000))]
    data[1::2] = [spoiled(text, b"Battery", b"Bottery") for text in data[1::2]]
    path = raw_file(tmp_path / "a.bin", data, header(pages=250))
    _, breaks, problems = read(path, 5000)
    assert len(problems) <= 101
    assert sum(count for *_, count in problems) == 125
    assert len(breaks) == 124
    assert everything(opened(path), 300) == everything(opened(path), 10**6)


@pytest.mark.parametrize("old", [b"\n", b"\nSequence", b"Recorded Data\n"])
def test_a_first_page_with_odd_line_ends_is_not_a_part_of_the_header(tmp_path: Path, old: bytes) -> None:
    """It was passed over without a word."""
    data = texts()
    data[0] = data[0].replace(old, old.replace(b"\n", b"\r")) + b"\n"
    chunks, _, problems = read(raw_file(tmp_path / "a.bin", data))
    assert np.array_equal(joined(chunks, "counts"), without(0))
    assert [(code, offset) for code, offset, *_ in problems] == [("bad_page", len(HEAD))]


@pytest.mark.parametrize(
    "before",
    [
        b"Recorded Data\n",
        b"Accelerometer Resolution:0.0039Recorded Data\n",
        b"\xff" * 700 + b"Recorded Data\n",
    ],
)
def test_a_page_that_begins_within_the_last_line_of_the_header_is_told(tmp_path: Path, before: bytes) -> None:
    data = texts()
    chunks, _, problems = read(raw_file(tmp_path / "a.bin", [before + data[0], *data[1:]]))
    assert np.array_equal(joined(chunks, "counts"), without())
    begun = len(HEAD) + before.index(b"Recorded")
    assert [(code, offset) for code, offset, *_ in problems] == [("bad_page", begun)]
