"""Bytes lost to damage and bytes used, of every format, counted by hand."""

from __future__ import annotations

import gzip
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats import open_recording
from tests.formats import (
    make_csv,
    make_cwa,
    make_edf,
    make_embraceplus,
    make_flash,
    make_geneactiv,
    make_gt3x,
    make_hdf5,
    make_opal,
    make_raw,
)

OPTIONS = ReadOptions()


def counts(rows: int = 1200) -> np.ndarray:
    return np.random.RandomState(11).randint(-500, 500, (rows, 3)).astype(np.int16)


def bytes_of(path: Path, options: ReadOptions = OPTIONS) -> tuple[int, int]:
    """Lost and used ones, the same for any size of the chunks."""
    found = set()
    with open_recording(path, options) as reader:
        for size in (1, 170, 10**6):
            chunks = list(reader.chunks(size))
            lost = sum(problem.lost_bytes for chunk in chunks for problem in chunk.problems)
            found.add((lost, sum(chunk.used_bytes for chunk in chunks)))
    assert len(found) == 1
    return found.pop()


def changed(path: Path, at: int, data: bytes) -> Path:
    whole = bytearray(path.read_bytes())
    whole[at : at + len(data)] = data
    path.write_bytes(whole)
    return path


def test_flash_pages(tmp_path: Path) -> None:
    path = make_flash.make(tmp_path, counts(), 100.0, 256.0).path
    assert bytes_of(path) == (0, 15 * 512), "neither the header nor the erased end"
    changed(path, 512 * 3 + 40, b"?")
    changed(path, 512 * 6, bytes(1024))
    changed(path, 512 * 9, b"\xff" * 512)
    changed(path, 512 * 11, make_flash.page(10, make_flash.START_US, counts(80), recording_id=8))
    assert bytes_of(path) == (4 * 512, 10 * 512), "a sound page of another recording is not lost"
    path.write_bytes(path.read_bytes()[: 512 * 14 + 100])
    assert bytes_of(path) == (4 * 512 + 100, 8 * 512)


def test_a_flash_dump_in_a_damaged_gzip(tmp_path: Path) -> None:
    path = make_flash.make(tmp_path, counts(12_000), 100.0, 256.0).path
    packed = bytearray(gzip.compress(path.read_bytes(), mtime=0))
    half = len(packed) // 2
    packed[half : half + 200] = bytes(200)
    path.write_bytes(packed)
    lost, used = bytes_of(path)
    assert len(packed) // 4 < lost < len(packed), "what is left on the disk cannot be unpacked"
    assert 0 < used < 150 * 512


def test_cwa_sectors(tmp_path: Path) -> None:
    path = make_cwa.make(tmp_path, counts(), 100.0, 256.0).path
    assert bytes_of(path) == (0, 15 * 512)
    changed(path, 1024 + 512 * 2 + 60, b"?!?")
    changed(path, 1024 + 512 * 5, bytes(512))
    changed(path, 1024 + 512 * 7, b"X")
    whole = path.read_bytes()
    light = b"UB" + bytes(510)
    path.write_bytes(whole[: 1024 + 512 * 9] + light + whole[1024 + 512 * 9 : -12] + b"")
    assert bytes_of(path) == (3 * 512 + 500, 11 * 512)
    path.write_bytes(whole + b"\xff" * 51200)
    assert bytes_of(path) == (3 * 512, 12 * 512)


def test_geneactiv_pages(tmp_path: Path) -> None:
    path = make_geneactiv.make(tmp_path, counts(3000), 50.0, 256.0).path
    whole = path.read_bytes()
    assert bytes_of(path)[0] == 0
    third = whole.index(b"Sequence Number:2")
    begin, end = whole.rindex(b"Recorded Data", 0, third), whole.index(b"Recorded Data", third)
    path.write_bytes(whole[: third + 200] + b"?" + whole[third + 201 :])
    assert bytes_of(path)[0] == end - begin
    path.write_bytes(whole[:begin] + bytes(end - begin) + whole[end:])
    assert bytes_of(path)[0] == end - begin
    path.write_bytes(whole[:begin] + bytes(4 * (end - begin)) + whole[begin + 4 * (end - begin) :])
    assert bytes_of(path)[0] > 3.9 * (end - begin)


def test_raw_frames(tmp_path: Path) -> None:
    path = make_raw.make(tmp_path, counts(), 100.0, 256.0).path
    assert bytes_of(path)[0] == 0
    path.write_bytes(path.read_bytes()[:-2])
    assert bytes_of(path)[0] == 4


def test_csv_rows(tmp_path: Path) -> None:
    lines = [f"{make_csv.stamp(10_000 * row)},0.{row + 100},0.25,0.955" for row in range(100)]
    row_bytes = len(lines[0]) + 1
    path = make_csv.written(tmp_path, "\n".join(["time,x,y,z", *lines]) + "\n")
    assert bytes_of(path) == (0, 100 * row_bytes)
    lines[20:25] = [line.replace("0.25", "    ") for line in lines[20:25]]
    lines[50] = lines[50].replace("0.25", "1e30")
    path = make_csv.written(tmp_path, "\n".join(["time,x,y,z", *lines]) + "\n2024-03")
    lost, used = bytes_of(path)
    assert (lost, used) == (row_bytes + 7, 94 * row_bytes), "rows without values are not lost"


def test_gt3x_records(tmp_path: Path) -> None:
    records = make_gt3x.seconds(counts(1000), 50)
    size = len(records[0])
    log = [make_gt3x.battery(make_gt3x.START_S), *records]
    path = make_gt3x.written(tmp_path / "a.gt3x", log, method=zipfile.ZIP_STORED)
    assert bytes_of(path) == (0, sum(map(len, log)))
    log[4] = log[4][:30] + bytes([log[4][30] ^ 1]) + log[4][31:]
    log[8] = bytes(len(log[8]) - 100) + b"?" * 100
    path = make_gt3x.written(tmp_path / "b.gt3x", log)
    lost, used = bytes_of(path)
    assert lost + used <= sum(map(len, log))
    assert size + 100 <= lost <= 2 * size, "padding with zeros is no damage"


def test_gt3x_that_cannot_be_unpacked_to_its_end(tmp_path: Path) -> None:
    log = make_gt3x.seconds(counts(60_000), 50)
    path = make_gt3x.written(tmp_path / "a.gt3x", log)
    changed(path, path.stat().st_size // 2, bytes(500))
    lost, used = bytes_of(path)
    assert 0 <= lost + used - sum(map(len, log)) < 1000, "zeros may unpack to more than there was"
    assert lost > used / 2


def test_hdf5_rows(tmp_path: Path) -> None:
    path = make_hdf5.make(tmp_path, counts(), 100.0, 256.0).path
    with h5py.File(path) as file:
        accel = next(item for item in file.values() if item.shape == (1200, 3))
        row_bytes = 3 * accel.dtype.itemsize
    assert bytes_of(path) == (0, 1200 * row_bytes)


@pytest.mark.nightly
def test_opal_rows_without_a_value(tmp_path: Path) -> None:
    made = make_opal.make(tmp_path, counts(), 128.0, 256.0)
    lost, used = bytes_of(made.path, made.options)
    assert lost == 0
    with h5py.File(made.path, "r+") as file:
        found: list[h5py.Dataset] = []
        file.visititems(lambda name, node: found.append(node) if name.endswith("Accelerometer") else None)
        for node in found:
            node[100:110] = np.nan
    assert bytes_of(made.path, made.options) == (0, 1190 * used // 1200), "rows without values are not lost"


def test_edf_records(tmp_path: Path) -> None:
    path = make_edf.make(tmp_path, counts(), 50.0, 256.0).path
    record = 2 * (3 * 50 + 16)
    assert bytes_of(path) == (0, 24 * record)
    path.write_bytes(path.read_bytes()[: 256 * 5 + 20 * record + 33])
    assert bytes_of(path) == (33, 20 * record)


def test_embraceplus_is_used_as_a_whole(tmp_path: Path) -> None:
    path = make_embraceplus.make(tmp_path, counts(), 50.0, 256.0).path
    assert bytes_of(path) == (0, path.stat().st_size)
