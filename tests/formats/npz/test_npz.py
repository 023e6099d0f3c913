"""NumPy archives: arrays of all layouts, packed or not, single values, checksums, and files cut short."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.recording import FLOAT_LSB_PER_G
from accelcal_cli.formats.tables import NPZ as FORMAT
from tests.cli.run import run
from tests.formats.cuts import every_byte, table_cuts
from tests.formats.make_hdf5 import START_US
from tests.formats.make_hdf5 import read as read_of
from tests.formats.make_npz import archive, make, member, write
from tests.formats.make_parquet import make as make_parquet
from tests.formats.table_values import ROWS, TIMES, values
from tests.recordings import LSB_PER_G, RATE_HZ, directions, still_counts

read = partial(read_of, chunk_samples=250, form=FORMAT)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "a.npz"


@pytest.mark.parametrize("packed", [False, True], ids=["stored", "packed"])
@pytest.mark.parametrize(
    "accel",
    [
        values(),
        np.asfortranarray(values()),
        values().T.copy(),
        np.asfortranarray(values().T),
        values().astype(">f8"),
        values().astype("f4"),
    ],
    ids=["rows", "columns", "on end", "on end by columns", "big-endian", "single"],
)
def test_arrays_of_all_layouts(path: Path, accel: np.ndarray, packed: bool) -> None:
    write(path, {"time": TIMES / 1e6, "accel": accel, "fs": 50.0}, packed)
    found = read(path)
    assert (found.g == values()).all()
    assert (found.times == TIMES).all()
    assert (found.recording.rate_hz, found.recording.timezone) == (50.0, "UTC")
    assert found.problems == []
    assert found.same_as(read(path, chunk_samples=7))


@pytest.mark.parametrize("kind", ["f4", "longdouble"])
def test_a_value_that_is_no_double_is_left_out_and_gives_no_warning(path: Path, kind: str) -> None:
    """A signalling NaN, and a number beyond the largest double."""
    accel = values().astype(kind)
    if kind == "f4":
        accel.view("u4")[3] = 0x7FA00000
    else:
        accel[3, 0] = np.finfo(float).max * accel.dtype.type(2)
    write(path, {"time": TIMES / 1e6, "accel": accel, "fs": 50.0}, packed=False)
    found, rest = read(path), np.arange(len(accel)) != 3
    assert (found.g == values()[rest]).all()
    assert [problem.count for problem in found.problems] == [1]


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_what_numpy_writes(path: Path, save: Any) -> None:
    columns = {f"acc_{name}": values()[:, axis] for axis, name in enumerate("xyz")}
    save(
        path, **columns, timestamp=TIMES.astype("M8[us]"), fs=50, serial="A7", temperature=np.full(ROWS, 20.5)
    )
    found = read(path)
    assert (found.g == values()).all()
    assert (found.times == TIMES).all()
    assert (found.recording.timezone, found.recording.device.serial) == (None, "A7")
    assert found.temperature is not None and (found.temperature == 20_500).all()


@pytest.mark.parametrize("version", [(1, 0), (2, 0), (3, 0)])
def test_versions_of_the_head(path: Path, version: tuple[int, int]) -> None:
    members = {"accel": member(values(), version), "fs": member(50.0), "start_time": member("2024-03-04")}
    path.write_bytes(archive(members))
    found = read(path)
    assert (found.g == values()).all()
    assert found.recording.start_us == START_US


def test_units_beside_an_array(path: Path) -> None:
    write(
        path,
        {"accel": values() * 1000, "accel_unit": "mg", "gyro": values(), "gyro_units": "deg/s", "fs": 50},
    )
    found = read(path)
    assert np.abs(found.g - values()).max() <= 0.5 / FLOAT_LSB_PER_G
    assert found.gyro is not None


def test_a_unit_that_is_stated_of_all(path: Path) -> None:
    """Of another quantity, it is no guess whether these are accelerations; an unknown word says nothing."""
    write(path, {"accel": values(), "unit": "deg/s", "fs": 50})
    with pytest.raises(UnreadableError, match="'deg/s', which is stated of it, is not one of acceleration"):
        read(path)
    assert read(path, unit="g").recording.lsb_per_g == FLOAT_LSB_PER_G
    write(path, {"accel": values(), "unit": "furlong", "fs": 50})
    assert "its unit 'furlong' is not known and was not used" in read(path).recording.notes


def test_an_archive_that_we_export_comes_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    raw = make_parquet(tmp_path, still_counts(directions(40)), RATE_HZ, LSB_PER_G).path
    assert run(capsys, "calibrate", raw, "-d", tmp_path, "-q").code == 0
    out = tmp_path / "a.npz"
    assert run(capsys, "export", tmp_path / "made.calibrated.parquet", "--to", "npz", "-o", out).code == 0
    with np.load(out) as stored:
        found = read(out)
        assert np.abs(found.g - stored["accel"]).max() <= 0.5 / FLOAT_LSB_PER_G
        assert np.abs(found.times - stored["time"] * 1e6).max() <= 1
        assert found.recording.rate_hz == stored["fs"]


@pytest.mark.parametrize("packed", [False, True], ids=["stored", "packed"])
def test_a_wrong_checksum_is_told(path: Path, packed: bool) -> None:
    write(path, {"accel": np.rint(values() * 256).astype("i2"), "lsb_per_g": 256.0, "fs": 50.0}, packed)
    whole = bytearray(path.read_bytes())
    whole[2000] ^= 1
    path.write_bytes(whole)
    try:
        assert "checksum" in read(path).codes
    except UnreadableError:
        assert packed


def test_objects_are_never_unpickled(path: Path) -> None:
    np.savez(path, accel=values(), fs=50.0, notes=np.array([{"a": 1}], dtype=object))
    found = read(path)
    assert (found.g == values()).all()
    assert found.codes == ["damaged_header", "no_start_time"] or "no_start_time" in found.codes


def test_a_text_of_what_are_no_characters(path: Path) -> None:
    damaged = member(np.array("g")).removesuffix("g".encode("utf-32-le")) + b"\0\0\0\x7f"
    path.write_bytes(archive({"accel": member(values()), "fs": member(50.0), "unit": damaged}))
    assert "damaged_header" in read(path).codes


def test_an_array_that_claims_more_rows_than_the_file_can_hold(path: Path) -> None:
    head = "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000, 3), }"
    path.write_bytes(archive({"accel": member(values(), head=head), "fs": member(50.0)}))
    with pytest.raises(UnreadableError, match="more than the file can hold"):
        read(path)


def test_rows_that_are_not_there_are_lost(path: Path) -> None:
    head = "{'descr': '<f8', 'fortran_order': False, 'shape': (700, 3), }"
    path.write_bytes(archive({"accel": member(values(), head=head), "fs": member(50.0)}))
    found = read(path)
    assert (found.g == values()).all()
    assert [(one.code, one.count) for one in found.problems if one.code == "bad_page"] == [("bad_page", 100)]


@every_byte
def test_a_file_that_was_cut_short_is_refused_with_a_hint(tmp_path: Path, step: int) -> None:
    data = make(tmp_path, np.rint(values() * 256).astype("i2"), 50.0, 256.0).path.read_bytes()
    path = tmp_path / "cut.npz"
    for size in table_cuts(data, step):
        path.write_bytes(data[:size])
        with pytest.raises(UnreadableError) as failure:
            read(path, format="npz")
        assert failure.value.hint
