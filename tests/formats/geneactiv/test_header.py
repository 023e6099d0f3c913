"""GENEActiv headers that are damaged, wrong or absent, and what the pages tell in their place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from accelcal_cli.core.errors import UnreadableError
from tests.formats.geneactiv.test_damage import (
    HEAD,
    PAGE_US,
    VALUES,
    raw_file,
    read,
    spoiled,
    ten,
    texts,
    without,
)
from tests.formats.geneactiv.test_geneactiv import joined, opened
from tests.formats.make_geneactiv import START_US, header, pages, written


def test_a_damaged_first_page_is_not_taken_for_header(tmp_path: Path) -> None:
    data = texts()
    data[0] = spoiled(data[0], b"Recorded Data", b"Recorded_Data")
    chunks, _, problems = read(raw_file(tmp_path / "a.bin", data))
    assert (joined(chunks, "counts") == without(0)).all()
    assert [(code, count) for code, _, _, count in problems] == [("bad_page", 1)]


def test_pages_that_the_header_announces_are_missed(tmp_path: Path) -> None:
    _, _, problems = read(raw_file(tmp_path / "a.bin", texts(), header(pages=15)))
    assert [(code, count) for code, _, _, count in problems] == [("truncated", 5)]


@pytest.mark.parametrize(
    ("old", "new", "missing"),
    [
        (b"Accelerometer Range:-8 to 8", b"Accelerometer Range:", "range"),
        (b"Measurement Frequency:50", b"Measurement Fre\0", "measurement frequency"),
        (b"Device Unique Serial Code:012345", b"", "serial number"),
        (b"Device Identity", bytes(15), None),
        (b"Calibration Data", b"", None),
    ],
)
def test_what_a_damaged_header_does_not_tell_the_pages_do(
    tmp_path: Path, old: bytes, new: bytes, missing: str | None
) -> None:
    reader = opened(raw_file(tmp_path / "a.bin", texts(), spoiled(HEAD, old, new)))
    chunks = list(reader.chunks(900))
    assert (joined(chunks, "counts") == VALUES).all()
    assert (reader.recording.rate_hz, reader.recording.device.serial) == (50, "012345")
    problems = [problem for chunk in chunks for problem in chunk.problems]
    assert [problem.code for problem in problems] == ["damaged_header"] * (missing is not None)
    assert missing is None or missing in problems[0].message


def test_without_any_header_the_raw_values_are_read_on_request(tmp_path: Path) -> None:
    path = raw_file(tmp_path / "a.bin", texts(), b"")
    with pytest.raises(UnreadableError, match="--lsb-per-g"):
        opened(path)
    chunks, _, problems = read(path, lsb_per_g=256.0)
    assert (joined(chunks, "counts") == VALUES).all()
    assert [code for code, *_ in problems] == ["damaged_header"]


@pytest.mark.parametrize("head", [HEAD, b""])
def test_nothing_of_the_format_is_an_error_with_a_place(tmp_path: Path, head: bytes) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(head or bytes(5000))
    what = "holds no intact page" if head else "is not a GENEActiv .bin recording"
    with pytest.raises(UnreadableError, match=rf"a\.bin, byte \d+: {what}"):
        opened(path)


def test_another_serial_number_in_the_header_is_noted(tmp_path: Path) -> None:
    recording = opened(raw_file(tmp_path / "a.bin", texts(), header(serial="054321", pages=10))).recording
    assert recording.device.serial == "012345"
    assert recording.notes == ("the header names device 054321, the pages 012345",)


def test_a_page_that_is_no_end_of_the_header_counts_from_its_place(tmp_path: Path) -> None:
    """A header longer than is looked through: the search for pages begins with the file."""
    reader = opened(raw_file(tmp_path / "a.bin", texts(), HEAD + b"x" * 70_000 + b"\n"), lsb_per_g=256.0)
    chunks = list(reader.chunks(900))
    assert (joined(chunks, "counts") == VALUES).all()
    assert [problem.code for chunk in chunks for problem in chunk.problems] == ["damaged_header", "bad_page"]


def test_pages_of_which_no_two_agree(tmp_path: Path) -> None:
    content = [replace(page, serial=f"{k:06d}", rate=f"5{k}.0") for k, page in enumerate(pages(VALUES[:900]))]
    reader = opened(written(tmp_path / "a.bin", content))
    assert (joined(list(reader.chunks(900)), "counts") == VALUES[:300]).all()
    assert reader.recording.device.serial == "000000"


def test_first_pages_that_disagree_are_outvoted(tmp_path: Path) -> None:
    content = ten()
    content[0] = replace(content[0], serial="099999")
    content[1] = replace(content[1], rate="05.0")
    reader = opened(written(tmp_path / "a.bin", content))
    assert (joined(list(reader.chunks(900)), "counts") == without(0, 1)).all()
    assert reader.recording.device.serial == "012345"
    assert reader.recording.start_us == START_US + 2 * PAGE_US
