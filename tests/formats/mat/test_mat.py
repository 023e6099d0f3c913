"""MATLAB files of level 5, made by hand and by SciPy; those of version 7.3 are HDF5 files."""

from __future__ import annotations

import struct
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from accelcal_cli.core.errors import AccelcalError, UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import FLOAT_LSB_PER_G
from accelcal_cli.formats import find_format
from accelcal_cli.formats.tables import HDF5
from accelcal_cli.formats.tables import MAT as FORMAT
from tests.formats.cuts import every_byte, table_cuts
from tests.formats.make_hdf5 import START_US
from tests.formats.make_hdf5 import read as read_of
from tests.formats.make_mat import CELL, OPAQUE, array, element, file_of, make, matrix, write
from tests.formats.table_values import ROWS, TIMES, values

read = partial(read_of, chunk_samples=250, form=FORMAT)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "a.mat"


@pytest.mark.parametrize("packed", [False, True], ids=["plain", "packed"])
@pytest.mark.parametrize("order", ["<", ">"], ids=["little", "big"])
@pytest.mark.parametrize("shape", ["rows", "on end", "apart", "structure"])
def test_arrays_in_both_orders_of_bytes(path: Path, shape: str, order: str, packed: bool) -> None:
    apart = {f"acc_{name}": values()[:, axis] for axis, name in enumerate("xyz")}
    accel = {"rows": {"accel": values()}, "on end": {"accel": values().T}, "apart": apart}.get(shape, {})
    variables: dict[str, Any] = {**accel, "time": TIMES / 1e6, "fs": 50.0, "unit": "g", "serial": "A7"}
    if shape == "structure":
        variables = {"rec": {"imu": {"accel": values(), "unit": "g", "time": TIMES / 1e6}, "serial": "A7"}}
    write(path, variables, order, packed)
    assert find_format(path, ReadOptions()).name == "mat"
    found = read(path)
    assert (found.g == values()).all()
    assert (found.times == TIMES).all()
    assert (found.recording.rate_hz, found.recording.device.serial) == (50.0, "A7")
    assert found.problems == []
    assert found.same_as(read(path, chunk_samples=7))


@pytest.mark.parametrize("packed", [False, True], ids=["plain", "packed"])
def test_what_scipy_writes(path: Path, packed: bool) -> None:
    scipy = pytest.importorskip("scipy.io")
    days = 719_529 + TIMES / 86_400e6
    data = {
        "accel": values() * 1000,
        "time": days[:, None],
        "serial": "X1",
        "temperature": np.full(ROWS, 20.0),
    }
    scipy.savemat(
        path, {"data": data, "note": "a", "cells": np.array([1, "b"], object)}, do_compression=packed
    )
    found = read(path)
    back = scipy.loadmat(path, simplify_cells=True)["data"]["accel"]
    assert (found.counts == np.rint(back / 1000 * FLOAT_LSB_PER_G)).all()
    assert np.abs(found.times - TIMES).max() <= 10
    assert (found.recording.timezone, found.recording.device.serial) == (None, "X1")
    assert "unit: mg (judged by the length of gravity)" in found.recording.notes
    assert found.temperature is not None and (found.temperature == 20_000).all()


def test_whole_numbers_that_are_stored_as_none_are_lost(path: Path) -> None:
    """The class of the array is int16, and its element holds doubles, two of which no int16 can be."""
    stored = np.round(values() * 100)
    stored[[5, 9], [0, 2]] = np.nan, 1e30
    parts = element(9, stored.astype("<f8").tobytes("F"))
    path.write_bytes(
        file_of([array(10, stored.shape, "acc", parts), matrix("lsb_per_g", 100.0), matrix("fs", 50.0)])
    )
    found = read(path)
    assert [(one.code, one.sample, one.count) for one in found.problems if one.code == "bad_page"] == [
        ("bad_page", 5, 1),
        ("bad_page", 8, 1),
    ]
    assert (found.g == np.delete(stored, [5, 9], axis=0) / 100).all()


def test_doubles_that_are_stored_in_fewer_bytes(path: Path) -> None:
    counts = np.rint(values() * 100)
    path.write_bytes(
        file_of([matrix("acc", counts, stored="i1"), matrix("lsb_per_g", 100.0), matrix("fs", 50.0)])
    )
    assert (read(path).counts == counts).all()


def test_tables_and_cells_are_left_out_with_a_word(path: Path) -> None:
    odd = [array(OPAQUE, (1, 1), "recording", bytes(64)), array(CELL, (1, 1), "c", matrix("", values()))]
    path.write_bytes(file_of(odd))
    with pytest.raises(UnreadableError, match=r"tables, timetables, cells and dates .*posixtime"):
        read(path)
    path.write_bytes(file_of([*odd, matrix("accel", values()), matrix("fs", 50.0)]))
    assert (read(path).g == values()).all()


@pytest.mark.parametrize("flags", [0x08, 0x02], ids=["complex", "logical"])
def test_arrays_of_other_numbers_are_left_out(path: Path, flags: int) -> None:
    parts = element(9, values().tobytes("F"))
    path.write_bytes(file_of([array(6, (ROWS, 3), "accel", parts, flags=flags), matrix("fs", 50.0)]))
    with pytest.raises(UnreadableError, match="no column of numbers"):
        read(path)


def test_structures_within_structures_end(path: Path) -> None:
    deep: Any = {"accel": values()}
    for _ in range(20):
        deep = {"a": deep}
    write(path, {"deep": deep, "accel": values(), "fs": 50.0})
    found = read(path)
    assert (found.g == values()).all()
    assert "damaged_header" in found.codes


def test_a_shape_that_is_not_that_of_the_numbers(path: Path) -> None:
    parts = element(9, values().tobytes("F"))
    path.write_bytes(file_of([array(6, (1 << 30, 3), "accel", parts), matrix("fs", 50.0)]))
    with pytest.raises(UnreadableError, match="damaged in 1 places"):
        read(path)


@every_byte
@pytest.mark.parametrize("packed", [False, True], ids=["plain", "packed"])
def test_what_was_cut_short_is_told(tmp_path: Path, step: int, packed: bool) -> None:
    variables = {"fs": 50.0, "unit": "g", "accel": values()}
    data = write(tmp_path / "whole.mat", variables, packed=packed).read_bytes()
    path, lengths = tmp_path / "cut.mat", set()
    for size in table_cuts(data, step):
        path.write_bytes(data[:size])
        try:
            found = read(path, format="mat")
        except AccelcalError as error:
            assert error.hint
            continue
        rows = len(found.counts)
        assert (found.g == values()[:rows]).all()
        assert "truncated" in found.codes
        lengths.add(rows)
    assert len(lengths) > 3


def test_damage_in_what_is_packed_is_not_believed(path: Path) -> None:
    data = bytearray(write(path, {"fs": 50.0, "unit": "g", "accel": values()}, packed=True).read_bytes())
    data[-1000:-900] = bytes(100)
    path.write_bytes(data)
    with pytest.raises(UnreadableError, match="not what was packed"):
        read(path)


def test_the_contract_file_is_what_scipy_reads(tmp_path: Path) -> None:
    scipy = pytest.importorskip("scipy.io")
    counts = np.rint(values() * 256).astype("i2")
    made = make(tmp_path, counts, 50.0, 256.0)
    back = scipy.loadmat(made.path, simplify_cells=True)["recording"]
    assert (back["accel"] == counts).all()
    assert (back["lsb_per_g"], back["serial"]) == (256.0, "0042")


def letters(group: Any, name: str, text: str) -> None:
    made = group.create_dataset(name, data=np.array([[ord(letter)] for letter in text], "u2"))
    made.attrs["MATLAB_class"] = np.bytes_("char")


def test_version_7_3_with_its_structures_texts_and_references(path: Path) -> None:
    with h5py.File(path, "w", userblock_size=512) as file:
        file["#refs#/a"] = np.zeros((3, 100))
        group = file.create_group("recording")
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        group["accel"] = values().T
        group["time"] = TIMES.reshape(1, -1) / 86_400e6 + 719_529
        group["fs"] = np.array([[50.0]])
        group["gyro"] = np.array([0, 0], "u8")
        group["gyro"].attrs["MATLAB_empty"] = np.uint8(1)
        letters(group, "unit", "g")
        letters(group, "serial", "AB12")
    head = b"MATLAB 7.3 MAT-file".ljust(116) + bytes(8) + b"\x00\x02IM"
    with path.open("r+b") as plain:
        plain.write(head)
    assert find_format(path, ReadOptions()).name == "hdf5"
    found = read_of(path, 250, HDF5)
    assert (found.g == values()).all()
    assert np.abs(found.times - TIMES).max() <= 10
    assert found.recording.start_us is not None and abs(found.recording.start_us - START_US) <= 10
    assert (found.recording.rate_hz, found.recording.device.serial) == (50.0, "AB12")
    assert found.problems == []


def test_an_older_file_is_refused_with_a_way_on(path: Path) -> None:
    path.write_bytes(struct.pack("<5i", 0, ROWS, 3, 0, 6) + b"accel\0" + values().tobytes("F"))
    with pytest.raises(UnreadableError, match="-v7"):
        read(path)
