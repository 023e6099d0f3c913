"""NumPy and MATLAB files with names, shapes and numbers of entries that nobody writes in good faith."""

from __future__ import annotations

import struct
import time
import tracemalloc
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats import find_format
from accelcal_cli.formats.tables.arrays import Array, ArrayRows, StoredBytes, array_path
from accelcal_cli.formats.tables.tracks import TEXT, Track
from tests.formats import make_mat
from tests.formats.make_hdf5 import read as read_of
from tests.formats.make_npz import archive, member
from tests.formats.reading import Read
from tests.formats.table_values import ROWS, values

MOST_BYTES, MOST_SECONDS = 100_000_000, 2.0


def read(path: Path, **options: Any) -> Read:
    """Read a file twice: within a time, and within a size of memory, which takes longer to tell."""
    form = "npz" if path.suffix == ".npz" else "mat"
    kind = find_format(path, ReadOptions(format=form))
    began = time.process_time()
    with suppress(UnreadableError):
        read_of(path, 250, kind, format=form, **options)
    assert time.process_time() - began < MOST_SECONDS
    tracemalloc.start()
    try:
        return read_of(path, 250, kind, format=form, **options)
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < MOST_BYTES


def npz(path: Path, name: str, more: dict[str, Any]) -> None:
    arrays = {name: values(), "fs": 50.0, "unit": "g", **more}
    path.write_bytes(archive({one: member(value) for one, value in arrays.items()}))


def mat(path: Path, name: str, more: dict[str, Any]) -> None:
    elements = [make_mat.matrix(name, values()), make_mat.matrix("fs", 50.0), make_mat.matrix("unit", "g")]
    path.write_bytes(make_mat.file_of(elements + [make_mat.matrix(*one) for one in more.items()]))


WRITERS = {".npz": npz, ".mat": mat}
Make = Callable[..., Path]


@pytest.fixture(params=WRITERS, ids=lambda suffix: suffix[1:])
def make(request: pytest.FixtureRequest, tmp_path: Path) -> Make:
    """Writes a file whose acceleration has some name."""

    def made(name: str, **more: Any) -> Path:
        path = tmp_path / f"made{request.param}"
        WRITERS[request.param](path, name, more)
        return path

    return made


@pytest.mark.parametrize(
    "name", ["/accel", "//accel", "accel/", "/accel//", "/a/accel", "inner.npz/accel", "\\/accel"]
)
def test_slashes_around_a_name_are_no_part_of_it(make: Make, name: str) -> None:
    found = read(make(name))
    assert (found.g == values()).all()
    assert "damaged_header" not in found.codes


REFUSED = [
    *("..", ".", "../accel", "/../accel", "a/../accel", "./accel", "a/./accel", "accel/.."),
    *("a//accel", "a///b/accel", "/", "//", "/" * 200, "a/" * 2000 + "accel"),
    *("x" * 65_500 + "/accel", "/" * 65_000 + "a//accel", "/".join("x" * 30_000) + "/accel"),
]


@pytest.mark.parametrize("name", REFUSED, ids=lambda name: f"{name[:12]} {len(name)}")
def test_what_is_no_name_is_damage(make: Make, name: str) -> None:
    with pytest.raises(UnreadableError, match="is damaged in 1 places, so that"):
        read(make(name))
    found = read(make(name, accel=-values()))
    assert (found.g == -values()).all()
    assert "damaged_header" in found.codes


@pytest.mark.parametrize("name", ["/accel", "..", "a//accel"])
def test_names_of_the_fields_of_structures(tmp_path: Path, name: str) -> None:
    path = make_mat.write(tmp_path / "a.mat", {"fs": 50.0, "unit": "g", "imu": {name: values()}})
    if name == "/accel":
        assert (read(path).g == values()).all()
    else:
        with pytest.raises(UnreadableError, match="is damaged in 1 places, so that"):
            read(path)


def test_one_name_with_and_without_a_slash_is_the_first_one(make: Make) -> None:
    path = make("/accel", accel=-values())
    assert (read(path).g == values()).all()


def test_paths_of_arrays() -> None:
    assert [array_path(name) for name in ("a", "/a", "a/b/")] == ["/a", "/a", "/a/b"]
    assert array_path("b", "/a") == "/a/b"
    for name in ("", "/", "a//b", "..", "a/..", "a" * 1025):
        with pytest.raises(ValueError, match="no name of an array"):
            array_path(name)


def directory(entries: int, name: bytes) -> bytes:
    """A zip file whose directory lists one member again and again."""
    data = member(values())
    sizes = struct.pack("<III", zlib.crc32(data), len(data), len(data))
    local = (
        b"PK\3\4" + struct.pack("<5H", 20, 0, 0, 0, 0x21) + sizes + struct.pack("<HH", len(name), 0) + name
    )
    entry = b"PK\1\2" + struct.pack("<6H", 20, 20, 0, 0, 0, 0x21) + sizes
    entry += struct.pack("<5H2I", len(name), 0, 0, 0, 0, 0, 0) + name
    begin, size = len(local) + len(data), len(entry) * entries
    end = b"PK\5\6" + struct.pack("<4H2IH", 0, 0, min(entries, 65535), min(entries, 65535), size, begin, 0)
    return local + data + entry * entries + end


def test_a_million_members(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    path.write_bytes(directory(1_000_000, b"accel.npy"))
    with pytest.raises(UnreadableError, match=r"list of arrays cannot be read .*too long"):
        read(path)
    path.write_bytes(directory(1, b"accel.npy"))
    assert (read(path, rate_hz=50.0).g == values()).all()


def test_more_members_than_are_read_are_told(tmp_path: Path) -> None:
    data = {"accel": member(values()), "fs": member(50.0)}
    path = tmp_path / "a.npz"
    path.write_bytes(archive(data | {f"m{number}": member(number) for number in range(5000)}))
    found = read(path)
    assert (found.g == values()).all()
    assert next(one.count for one in found.problems if one.code == "damaged_header") == 906


@pytest.mark.parametrize("packed", [False, True], ids=["stored", "packed"])
@pytest.mark.parametrize(
    ("descr", "shape"),
    [
        *(("<f8", f"({rows}, 3)") for rows in (10**18, 10**400, -5)),
        *(("<f8", f"(3, {2**63})"), ("<f8", f"({'1, ' * 3000})"), ("|V999999999", "(600,)")),
        *(("<U1000000000", "(5,)"), ("<U0", "(600,)"), ("<U0", "()"), ("|S100000000", "(2,)")),
        *((kind, f"({10**15},)") for kind in ("<U4", "<M8[us]", "|u1")),
    ],
    ids=lambda one: one[:24],
)
def test_claims_of_size(tmp_path: Path, descr: str, shape: str, packed: bool) -> None:
    head = f"{{'descr': {descr!r}, 'fortran_order': False, 'shape': {shape}, }}"
    path = tmp_path / "a.npz"
    sound = {"accel": member(values()), "fs": member(50.0)}
    path.write_bytes(archive({"odd": member(values(), head=head)} | sound, packed))
    try:
        assert (read(path).g == values()).all()
    except UnreadableError as error:
        assert "more than the file can hold" in str(error)


def test_wide_texts_are_no_column(tmp_path: Path) -> None:
    head = "{'descr': '<U25000', 'fortran_order': False, 'shape': (600,), }"
    path = tmp_path / "a.npz"
    odd = member(np.zeros(0), head=head) + bytes(600 * 100_000)
    path.write_bytes(archive({"accel": member(values()), "fs": member(50.0), "sensor": odd}, packed=True))
    assert (read(path).g == values()).all()


@pytest.mark.parametrize("place", [20, 24], ids=["packed", "whole"])
def test_a_directory_that_claims_other_sizes(tmp_path: Path, place: int) -> None:
    data = bytearray(archive({"accel": member(values()), "fs": member(50.0)}))
    at = data.index(b"PK\1\2") + place
    data[at : at + 4] = struct.pack("<I", 0xFFFFFFF0)
    path = tmp_path / "a.npz"
    path.write_bytes(data)
    assert (read(path).g == values()).all()


def test_an_archive_within_an_archive(tmp_path: Path) -> None:
    inner = archive({"accel": member(-values())})
    path = tmp_path / "a.npz"
    path.write_bytes(archive({"inner": inner, "accel": member(values()), "fs": member(50.0)}))
    found = read(path)
    assert (found.g == values()).all()
    assert "damaged_header" in found.codes


def test_a_single_value_with_a_wrong_checksum_is_not_believed(tmp_path: Path) -> None:
    data = archive({"accel": member(values()), "fs": member(50.0)})
    path = tmp_path / "a.npz"
    path.write_bytes(data.replace(struct.pack("<d", 50.0) + b"PK", struct.pack("<d", 25.0) + b"PK"))
    with pytest.raises(UnreadableError, match="is damaged in 1 places, so that"):
        read(path)


@pytest.mark.parametrize("letter", [0xD800, 0xDFFF, 0x110000, 0x7F000000], ids=hex)
@pytest.mark.parametrize("order", ["<", ">"])
def test_a_column_of_what_are_no_characters(tmp_path: Path, letter: int, order: str) -> None:
    texts = np.full(ROWS, "left", f"{order}U5")
    texts.view(f"{order}u4")[0] = letter
    path = tmp_path / "a.npz"
    path.write_bytes(archive({"accel": member(values()), "fs": member(50.0), "sensor": member(texts)}))
    assert (read(path, sensor="left").g == values()[1:]).all()


@pytest.mark.parametrize(
    "element",
    [bytes(8), struct.pack("<II", 15, 0), struct.pack("<II", 14, 0), struct.pack("<II", 14, 8) + bytes(8)],
    ids=["nothing", "packed nothing", "no array", "array of nothing"],
)
def test_very_many_elements(tmp_path: Path, element: bytes) -> None:
    path = tmp_path / "a.mat"
    sound = [make_mat.matrix("accel", values()), make_mat.matrix("fs", 50.0), make_mat.matrix("unit", "g")]
    path.write_bytes(make_mat.file_of([*sound, element * 300_000]))
    found = read(path)
    assert (found.g == values()).all()
    assert "damaged_header" in found.codes


def test_a_structure_of_very_many_fields(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    names = make_mat.element(5, struct.pack("<i", 2)) + make_mat.element(1, b"a\0" * 30_000)
    odd = make_mat.array(make_mat.STRUCTURE, (1, 1), "s", names + make_mat.matrix("", 1.0) * 30_000)
    sound = [make_mat.matrix("accel", values()), make_mat.matrix("fs", 50.0), make_mat.matrix("unit", "g")]
    path.write_bytes(make_mat.file_of([*sound, odd]))
    found = read(path)
    assert (found.g == values()).all()
    assert "damaged_header" in found.codes


@pytest.mark.parametrize(
    "texts", [["a", "", "ü\0", " b "], [b"a", b"", "ü".encode(), b"\xff b"]], ids=["U", "S"]
)
def test_texts_as_cells(tmp_path: Path, texts: list[Any]) -> None:
    data = np.array(texts)
    (tmp_path / "data").write_bytes(data.tobytes())
    source = StoredBytes(tmp_path / "data", data.nbytes - 1)
    rows = ArrayRows(Array(Track("/a", 4, 1, 0, TEXT), data.dtype, False, source, 0))
    cells, good = rows.read(1, 4)
    assert cells.to_pylist() == [None, "ü", None]
    assert good.tolist() == [True, True, False]
    last = "b" if data.dtype.kind == "U" else "\ufffd b"
    whole = ArrayRows(
        Array(Track("/a", 4, 1, 0, TEXT), data.dtype, False, StoredBytes(tmp_path / "data", data.nbytes), 0)
    )
    assert whole.read(0, 4)[0].to_pylist() == ["a", None, "ü", last]
