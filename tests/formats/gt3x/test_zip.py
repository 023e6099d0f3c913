"""ActiGraph recordings whose zip file is unusual, cut short or damaged."""

from __future__ import annotations

import struct
import tracemalloc
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import AccelcalError, UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats import find_format, open_recording
from accelcal_cli.formats.gt3x.archive import MemberStream, open_archive
from accelcal_cli.studies.discovery import Where, files
from tests.formats.gt3x.reading import Whole, opened, random_counts, whole
from tests.formats.make_gt3x import (
    ACTIVITY,
    START_S,
    activity,
    encoded,
    info,
    parameters,
    seconds,
    written,
    zipped,
)

RATE = 30
LENGTH = 9 + 135
VALUES = random_counts(300 * RATE)
LOG = b"".join(seconds(VALUES, RATE, ACTIVITY))
PARTS = {"log.bin": LOG, "info.txt": info(RATE)}
LATE = dict(reversed(PARTS.items()))
METHODS = [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED]
NO_DIRECTORY = ("damaged_archive", None, 0, 1)
NO_INFO = ("damaged_header", None, 0, 1)
WRONG_SUM = ("archive_checksum", None, len(VALUES), 1)


def put(folder: Path, data: bytes) -> Path:
    path = folder / "a.gt3x"
    path.write_bytes(data)
    return path


def read(folder: Path, data: bytes) -> Whole:
    return whole(put(folder, data), 400)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("parts", [PARTS, LATE])
def test_parts_in_any_order_stored_or_compressed(
    tmp_path: Path, parts: Mapping[str, bytes | str], method: int
) -> None:
    found = read(tmp_path, zipped({"epoch.bin": b"1", **parts, "z.json": b"{}"}, method))
    assert (found.counts == VALUES).all()
    assert (found.breaks, found.found) == ([], [])


def test_sizes_of_64_bits(tmp_path: Path) -> None:
    path = tmp_path / "a.gt3x"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        with archive.open("log.bin", "w", force_zip64=True) as log:
            log.write(LOG)
        archive.writestr("info.txt", info(RATE))
    assert (whole(path).counts == VALUES).all()
    found = read(tmp_path, path.read_bytes()[:-1])
    assert (found.counts == VALUES).all()
    assert found.found == [NO_DIRECTORY]


@pytest.mark.parametrize("method", METHODS)
def test_without_the_directory_the_parts_are_found_by_their_headers(tmp_path: Path, method: int) -> None:
    data = zipped(LATE, method)
    cut = data.index(b"PK\x01\x02")
    for end in (cut, cut + 10, len(data) - 5):
        found = read(tmp_path, data[:end])
        assert (found.counts == VALUES).all()
        assert (found.breaks, found.found) == ([], [NO_DIRECTORY])


def test_without_the_header_before_it_the_directory_tells_where_a_part_lies(tmp_path: Path) -> None:
    data = zipped(LATE)
    at = data.index(b"log.bin") - 30
    found = read(tmp_path, data[:at] + bytes(4) + data[at + 4 :])
    assert (found.counts == VALUES).all()
    assert found.found == [NO_DIRECTORY]


def test_a_header_without_sizes(tmp_path: Path) -> None:
    """As programs write that do not know them yet."""
    data = bytearray(zipped(LATE))
    at = data.index(b"log.bin") - 30
    data[at + 6] |= 8
    data[at + 14 : at + 26] = bytes(12)
    found = read(tmp_path, bytes(data[: data.index(b"PK\x01\x02")]))
    assert (found.counts == VALUES).all()
    assert found.found == [NO_DIRECTORY]


@pytest.mark.nightly
def test_a_stored_file_cut_anywhere_gives_what_is_left(tmp_path: Path) -> None:
    data = zipped(PARTS, zipfile.ZIP_STORED)
    begin = data.index(b"log.bin") + 7
    for end in [*range(begin + LENGTH - 5, begin + 3 * LENGTH + 3), *range(20_000, begin + len(LOG), 2777)]:
        left, rest = divmod(end - begin, LENGTH)
        path = put(tmp_path, data[:end])
        if not left:
            with pytest.raises(UnreadableError, match="holds no acceleration"):
                opened(path, lsb_per_g=256.0)
            continue
        found = whole(path, lsb_per_g=256.0)
        assert (found.counts == VALUES[: left * RATE]).all()
        tail = [("truncated", left * LENGTH, left * RATE, rest)] if rest else []
        lost = ("truncated", end - begin, left * RATE, len(LOG) - (end - begin))
        assert found.found == [NO_DIRECTORY, NO_INFO, *tail, lost]


def test_a_compressed_file_cut_anywhere_gives_what_is_left(tmp_path: Path) -> None:
    data = zipped(LATE)
    rows = []
    for end in range(data.index(b"log.bin"), data.index(b"PK\x01\x02"), 911):
        try:
            found = read(tmp_path, data[:end])
        except AccelcalError as error:
            assert "a.gt3x" in str(error)
            continue
        assert (found.counts == VALUES[: len(found.counts)]).all()
        assert [code for code, *_ in found.found][:1] + [code for code, *_ in found.found][-1:] == [
            "damaged_archive",
            "truncated",
        ]
        rows.append(len(found.counts))
    assert rows == sorted(rows)
    assert rows[0] < 0.1 * len(VALUES)
    assert rows[-1] > 0.9 * len(VALUES)


def unpackable(data: bytes) -> int:
    """How many bytes zlib gives of damaged data, fed one by one."""
    inflate, size = zlib.decompressobj(-zlib.MAX_WBITS), 0
    try:
        for at in range(len(data)):
            size += len(inflate.decompress(data[at : at + 1]))
    except zlib.error:
        return size
    return size


@pytest.mark.parametrize("filler", [bytes(4000), b"\xff" * 200, b"\x66\x99" * 100])
def test_damaged_compression_gives_what_came_before(tmp_path: Path, filler: bytes) -> None:
    """It ends early, or in a code that means nothing."""
    data = zipped(LATE)
    begin = data.index(b"log.bin") + 7
    middle = begin + (data.index(b"PK\x01\x02") - begin) // 2
    damaged = data[:middle] + filler + data[middle + len(filler) :]
    found = read(tmp_path, damaged)
    assert 0.4 * len(VALUES) < len(found.measured) < 0.6 * len(VALUES)
    assert (found.counts[:RATE] == VALUES[:RATE]).all()
    assert found.found[-1][:3] == ("truncated", unpackable(damaged[begin:]), len(found.counts))


def test_a_byte_that_changed_in_a_stored_file(tmp_path: Path) -> None:
    data = bytearray(zipped(LATE, zipfile.ZIP_STORED))
    data[data.index(b"log.bin") + 7 + 3 * LENGTH + 50] ^= 1
    found = read(tmp_path, bytes(data))
    assert (found.counts == np.delete(VALUES, slice(3 * RATE, 4 * RATE), axis=0)).all()
    checksum = ("checksum", 3 * LENGTH, 3 * RATE, 1)
    assert found.found == [checksum, ("archive_checksum", None, len(VALUES) - RATE, 1)]


def test_a_part_whose_checksum_alone_is_wrong(tmp_path: Path) -> None:
    data = bytearray(zipped(LATE))
    at = data.index(b"PK\x01\x02", data.index(b"PK\x01\x02") + 4)
    assert data[at + 46 : at + 53] == b"log.bin"
    data[at + 16] ^= 1
    found = read(tmp_path, bytes(data))
    assert (found.counts == VALUES).all()
    assert found.found == [WRONG_SUM]


def test_a_damaged_info_txt_is_not_used(tmp_path: Path) -> None:
    log = parameters({(0, 55): encoded(341.0)}) + LOG
    data = zipped({"log.bin": log, "info.txt": info(RATE)}, zipfile.ZIP_STORED)
    path = put(tmp_path, data.replace(b"Scale: 256", b"Scale: 296"))
    assert opened(path).recording.lsb_per_g == 341
    assert opened(path).recording.device.serial is None
    assert whole(path).found == [NO_INFO]


@pytest.mark.parametrize(("field", "value", "text"), [(8, 1, "encrypted"), (10, 12, "unusual way")])
def test_what_cannot_be_unpacked_is_refused(tmp_path: Path, field: int, value: int, text: str) -> None:
    data = bytearray(zipped(LATE))
    at = data.index(b"PK\x01\x02", data.index(b"PK\x01\x02") + 4)
    struct.pack_into("<H", data, at + field, value)
    with pytest.raises(UnreadableError, match=rf"log\.bin in it is .*{text}.*pack it again"):
        opened(put(tmp_path, bytes(data)))


def test_the_file_is_never_unpacked_as_a_whole(tmp_path: Path) -> None:
    """A log of 24 MB, packed to a part of that, in chunks of ten seconds and of everything."""
    one = np.frombuffer(activity(START_S, np.tile(np.array([[3, -4, 255]]), (100, 1))), np.uint8)
    log = np.tile(one, (40_000, 1))
    log[:, 2:6] = np.arange(START_S, START_S + 40_000, dtype="<u4")[:, None].view(np.uint8)
    log[:, -1] = ~np.bitwise_xor.reduce(log[:, :-1], axis=1)
    path = written(tmp_path / "a.gt3x", [log.tobytes()], info(100))
    for size in (1000, 10**9):
        with opened(path) as reader:
            tracemalloc.start()
            rows = sum(len(chunk) for chunk in reader.chunks(size))
            peak = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
        assert rows == 4_000_000
        assert peak < 20_000_000


@pytest.mark.parametrize("size", [0, 1, (1 << 19) - 1, 1 << 19, (1 << 19) + 1, 1 << 20, 3_000_000])
@pytest.mark.parametrize("filler", [b"\0", b"\0\1\2 repeated \xfe\xff"])
@pytest.mark.parametrize("method", METHODS)
def test_a_part_comes_back_whole(tmp_path: Path, size: int, filler: bytes, method: int) -> None:
    """However well it was packed."""
    data = (filler * (size // len(filler) + 1))[:size]
    archive = open_archive(put(tmp_path, zipped({"log.bin": data}, method)))
    with MemberStream(archive, archive.members["log.bin"]) as stream:
        assert b"".join(iter(lambda: stream.read(99_991), b"")) == data
        assert stream.fault is None


def test_a_preview_reads_the_beginning_only(tmp_path: Path) -> None:
    path = written(tmp_path / "a.gt3x", seconds(random_counts(2000 * 100), 100), info(100))
    with opened(path) as reader:
        pieces = list(reader.preview(5000, 4))
    assert 5000 <= sum(map(len, pieces)) <= 20_000
    assert pieces[-1].end_byte < path.stat().st_size


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_two_parts_of_one_name_are_reported(tmp_path: Path) -> None:
    other = b"".join(seconds(VALUES[: 5 * RATE], RATE, ACTIVITY))
    path = tmp_path / "a.gt3x"
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in (("log.bin", other), *PARTS.items()):
            archive.writestr(name, data)
    found = whole(path)
    assert (found.counts == VALUES).all()
    assert found.found == [("repeated_part", None, 0, 1)]
    assert found.problems[0].message == "holds 2 parts named log.bin: the last one was read"
    without = read(tmp_path, path.read_bytes()[:-1])
    assert (without.counts == VALUES[: 5 * RATE]).all()
    assert without.found == [NO_DIRECTORY, ("repeated_part", None, 0, 1)]


def test_a_directory_of_very_many_parts_is_not_loaded(tmp_path: Path) -> None:
    data = zipped(PARTS)
    start, end = data.index(b"PK\x01\x02"), data.index(b"PK\x05\x06")
    entry = data[start : data.index(b"PK\x01\x02", start + 1)]
    listed = entry * 200_000
    tail = struct.pack("<4s4HIIH", b"PK\x05\x06", 0, 0, 60_000, 60_000, len(listed), start, 0)
    path = put(tmp_path, data[:start] + listed + tail)
    assert len(data) > end
    tracemalloc.start()
    try:
        archive = open_archive(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert [problem.code for problem in archive.problems] == ["damaged_archive"]
    assert set(archive.members) == {"log.bin", "info.txt"}
    assert peak < 8 << 20


SPELT = [
    ("LOG.BIN", "INFO.TXT"),
    ("Log.bin", "Info.txt"),
    ("night/LOG.BIN", "night/info.txt"),
    ("log.bin", "INFO.txt"),
]


@pytest.mark.parametrize("lost", [0, 40])
@pytest.mark.parametrize(("log", "about"), SPELT)
def test_t12_names_of_parts_in_any_case(tmp_path: Path, log: str, about: str, lost: int) -> None:
    data = zipped({log: LOG, about: info(RATE, scale=341.0)})
    cut = data.index(b"PK\x01\x02") if lost else len(data)
    found = read(tmp_path, data[:cut])
    assert (found.counts == VALUES).all() and found.recording.lsb_per_g == 341
    assert found.found == ([NO_DIRECTORY] if lost else [])


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-8-sig", "utf-32"])
def test_t12_info_in_any_unicode(tmp_path: Path, encoding: str) -> None:
    marked = {"utf-16-be": "\ufeff"}.get(encoding, "")
    data = zipped({"log.bin": LOG, "info.txt": (marked + info(RATE, scale=341.0)).encode(encoding)})
    found = read(tmp_path, data).recording
    assert found.lsb_per_g == 341 and found.device == read(tmp_path, zipped(PARTS)).recording.device


@pytest.mark.parametrize(
    "names", [("log.bin", "info.txt"), ("LOG.BIN", "INFO.TXT"), ("activity.bin", "info.txt"), ("log.bin",)]
)
def test_t12_parts_of_an_unzipped_recording_are_told_with_the_command(
    tmp_path: Path, names: tuple[str, ...]
) -> None:
    folder = tmp_path / "P 7"
    folder.mkdir()
    for name in names:
        (folder / name).write_bytes(LOG if name.endswith(("bin", "BIN")) else info(RATE).encode())
    for name in names:
        with pytest.raises(UnreadableError) as caught:
            open_recording(folder / name, ReadOptions())
        said = str(caught.value)
        assert "is a part of an unzipped .gt3x" in said and f"zip -j 'P 7.gt3x' '{folder}/" in said
        assert all(f"{folder}/{one}'" in said for one in names)
    items = files(Where((folder,), tmp_path / "out"), [], left := {})
    assert [item.name for item in items] == [name for name in names if name.lower() != "info.txt"]
    assert set(left) == set(names) - {item.name for item in items}


def test_t12_other_files_of_these_names_are_none(tmp_path: Path) -> None:
    (tmp_path / "info.txt").write_text(
        "time,x,y,z\n" + "".join(f"{n / 50},0.1,0.2,0.97\n" for n in range(99))
    )
    (tmp_path / "calibration.json").write_text("{}")
    assert find_format(tmp_path / "info.txt", ReadOptions()).name == "csv"
