"""HDF5 chunks of all packings, sound, damaged, absent and large: the oracle is what was written."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats.tables import HDF5
from accelcal_cli.formats.tables import hdf5 as hdf5_reader
from accelcal_cli.formats.tables import tracks as tables
from accelcal_cli.formats.tables.hdf5 import Hdf5Source, TrackRows
from accelcal_cli.formats.tables.header import As
from accelcal_cli.formats.tables.tracks import Track
from tests.formats.make_hdf5 import about, write
from tests.formats.reading import Read, joined

ROWS, CHUNK = 40_000, 6000


def counts() -> np.ndarray:
    return np.random.default_rng(5).integers(-2048, 2048, (ROWS, 3)).astype(np.int16)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "a.h5"


def streamed(path: Path, samples: int = 7000) -> Read:
    with HDF5.open(path, ReadOptions()) as reader:
        return joined(reader.recording, reader.chunks(samples))


def rows_of(source: Hdf5Source, rows: int = ROWS, dtype: str = "i2") -> TrackRows:
    """The rows of `accel`; the source is open."""
    return TrackRows(source, Track("/accel", rows, 3, 0, np.dtype(dtype)))


OTHERS = [pytest.param(dtype, marks=pytest.mark.nightly) for dtype in ("f8", ">i8", "g")]


@pytest.mark.parametrize("shuffle", [False, True])
@pytest.mark.parametrize("dtype", ["<i2", ">i4", "<f4", *OTHERS])
@pytest.mark.parametrize("shape", ["wide", "transposed", "columns"])
@pytest.mark.parametrize("block", [1000, 65_536], ids=["in parts", "whole"])
def test_chunks_are_unpacked_as_they_were_packed(
    path: Path, monkeypatch: pytest.MonkeyPatch, shuffle: bool, dtype: str, shape: str, block: int
) -> None:
    monkeypatch.setattr(hdf5_reader, "BLOCK_ROWS", block)
    packed: dict[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": shuffle}
    values = counts().astype(dtype)
    if shape == "columns":
        with h5py.File(path, "w") as file:
            for name, column in zip("xyz", values.T, strict=True):
                file.create_dataset(name, data=column, chunks=(9000,), **packed).attrs.update(about())
    elif shape == "transposed":
        write(path, {"accel": values.T}, about(), chunks=(3, CHUNK), **packed)
    else:
        write(path, {"accel": values}, about(), chunks=(CHUNK, 3), **packed)
    got = streamed(path)
    assert (got.counts == counts()).all()
    assert (got.codes, got.breaks) == ([], [])


def overwrite(path: Path, row: int, change: Callable[[bytes], tuple[int, bytes]]) -> None:
    """Store another chunk in the place of the one that begins with a row."""
    with h5py.File(path, "r+") as file:
        dataset = file["accel"].id
        mask, data = change(dataset.read_direct_chunk((row, 0))[1])
        dataset.write_direct_chunk((row, 0), data, mask)


def turned(data: bytes) -> bytes:
    return data[:200] + bytes([data[200] ^ 255]) + data[201:]


CHANGES: dict[str, Callable[[bytes], tuple[int, bytes]]] = {
    "a byte turned": lambda data: (0, turned(data)),
    "cut": lambda data: (0, data[:500]),
    "checksum": lambda data: (0, data[:-1] + bytes([data[-1] ^ 1])),
    "longer than a chunk": lambda data: (0, zlib.compress(zlib.decompress(data) + bytes(601))),
    "followed by something": lambda data: (0, data + bytes(9)),
    "not packed": lambda data: (1, zlib.decompress(data)),
    "not packed, though it looks so": lambda data: (1, zlib.compress(bytes(6 * CHUNK)).ljust(6 * CHUNK)),
}


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("block", [1000, 65_536], ids=["in parts", "whole"])
def test_a_chunk_that_is_not_as_the_others_gives_what_it_holds_or_is_lost(
    path: Path, monkeypatch: pytest.MonkeyPatch, change: str, block: int
) -> None:
    monkeypatch.setattr(hdf5_reader, "BLOCK_ROWS", block)
    write(path, {"accel": counts()}, about(lsb_per_g=4096.0), chunks=(CHUNK, 3), compression="gzip")
    overwrite(path, 2 * CHUNK, CHANGES[change])
    got = streamed(path)
    kept = np.r_[0 : 2 * CHUNK, 3 * CHUNK : ROWS]
    damaged = change in ("a byte turned", "cut", "checksum")
    assert got.codes == ["bad_page"] * damaged
    assert ((got.counts if damaged else got.counts[kept]) == counts()[kept]).all()


@pytest.mark.parametrize(("beside", "first"), [("a byte turned", CHUNK), ("not packed", 0)])
def test_a_chunk_that_holds_too_little_is_lost_whatever_is_beside_it(
    path: Path, beside: str, first: int
) -> None:
    """h5py would give what lies behind it in memory."""
    write(path, {"accel": counts()}, about(), chunks=(CHUNK, 3), compression="gzip")
    overwrite(path, 0, CHANGES[beside])
    overwrite(path, 2 * CHUNK, lambda _: (0, zlib.compress(bytes(600))))
    got = streamed(path)
    assert (got.counts == counts()[np.r_[first : 2 * CHUNK, 3 * CHUNK : ROWS]]).all()
    assert set(got.codes) == {"bad_page"}


def test_chunks_that_were_never_written_are_lost(path: Path) -> None:
    with h5py.File(path, "w") as file:
        dataset = file.create_dataset(
            "accel", (ROWS, 3), "i2", chunks=(CHUNK, 3), compression="gzip", fillvalue=7
        )
        dataset[: 2 * CHUNK] = counts()[: 2 * CHUNK]
        dataset[4 * CHUNK :] = counts()[4 * CHUNK :]
        dataset.attrs.update(about())
    got = streamed(path)
    assert (got.counts == counts()[np.r_[0 : 2 * CHUNK, 4 * CHUNK : ROWS]]).all()
    assert (got.codes, got.breaks) == (["bad_page"], [2 * CHUNK])


PACKINGS: dict[str, dict[str, Any]] = {
    "lzf": {"compression": "lzf"},
    "checksums": {"compression": "gzip", "fletcher32": True},
    "only shuffled": {"shuffle": True},
    "part of the columns": {"compression": "gzip", "chunks": (CHUNK * 3, 1)},
    "small chunks": {"compression": "gzip", "chunks": (100, 3)},
    "scaled": {"scaleoffset": 0, "compression": "gzip"},
}


@pytest.mark.parametrize("layout", PACKINGS)
def test_other_packings_are_unpacked(path: Path, layout: str) -> None:
    write(path, {"accel": counts()}, about(), **{"chunks": (CHUNK, 3), **PACKINGS[layout]})
    assert (streamed(path).counts == counts()).all()


def test_numbers_that_numpy_does_not_know_are_read(path: Path) -> None:
    """Twelve bits in the upper part of two bytes: HDF5 shifts them."""
    kind = h5py.h5t.STD_I16LE.copy()
    kind.set_precision(12)
    kind.set_offset(4)
    with h5py.File(path, "w") as file:
        settings = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        settings.set_chunk((CHUNK, 3))
        settings.set_deflate(1)
        space = h5py.h5s.create_simple((ROWS, 3))
        h5py.h5d.create(file.id, b"accel", kind, space, settings).write(h5py.h5s.ALL, h5py.h5s.ALL, counts())
        file["accel"].attrs.update(about())
    assert (streamed(path).counts == counts()).all()


def test_rows_may_be_asked_for_in_any_order(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hdf5_reader, "BLOCK_ROWS", CHUNK)
    write(path, {"accel": counts()}, chunks=(CHUNK, 3), compression="gzip")
    source = Hdf5Source(path)
    with source.opened():
        rows = rows_of(source)
        for start in (0, 3 * CHUNK, 100, CHUNK - 100):
            values, good = rows.read(start, start + 200)
            assert (values == counts()[start : start + 200]).all()
            assert good.all()


def test_wide_rows_come_in_fewer_at_a_time(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "PIECE_BYTES", 24_000)
    write(path, {"accel": counts().astype("f8")}, about())
    source = Hdf5Source(path)
    source.settle(source.columns, (), ReadOptions())
    assert {piece.rows for piece in source.pieces({0: As.NUMBER}, 1 << 20)} == {1000}
    assert (streamed(path, 1 << 20).counts == counts()).all()


def test_chunks_never_written_are_found_in_one_pass(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """14. of the hostile run: 210 000 chunks, asked for one by one, took half a minute."""
    with h5py.File(path, "w") as file:
        data = file.create_dataset("accel", (6000, 3), "i2", chunks=(10, 2), compression="gzip")
        data.attrs.update(about())
        for row in (*range(0, 6000, 200), 10):
            data[row : row + 10] = counts()[row : row + 10]
        data[400:410, :2] = 7
        data[50:60, :2] = 7
    asked: list[int] = []
    offset = TrackRows.chunk_offset

    def counted(self: TrackRows, row: int) -> int | None:
        asked.append(row)
        return offset(self, row)

    monkeypatch.setattr(TrackRows, "chunk_offset", counted)
    got = streamed(path)
    rows = [row + k for row in sorted((*range(0, 6000, 200), 10)) for k in range(10)]
    expected = counts()[rows]
    expected[[rows.index(400 + k) for k in range(10)], :2] = 7
    assert (got.counts == expected).all()
    assert len(asked) < 100


def test_small_chunks_are_read_a_few_thousand_at_a_time(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """14. of the hostile run: the HDF5 library's notes on 65 536 chunks took 700 MB."""
    monkeypatch.setattr(hdf5_reader, "MOST_CHUNKS", 300)
    read: list[int] = []
    fetch = TrackRows.fetch

    def counted(self: TrackRows, start: int, stop: int) -> np.ndarray:
        read.append(stop - start)
        return fetch(self, start, stop)

    monkeypatch.setattr(TrackRows, "fetch", counted)
    write(path, {"accel": counts()[:5000]}, about(), chunks=(5, 1))
    assert (streamed(path).counts == counts()[:5000]).all()
    assert max(read) == 500


@pytest.mark.parametrize("packing", ["gzip", "lzf"])
def test_chunks_larger_than_a_block_are_unpacked_once_and_read_in_parts(
    path: Path, monkeypatch: pytest.MonkeyPatch, packing: str
) -> None:
    monkeypatch.setattr(hdf5_reader, "BLOCK_ROWS", 1000)
    write(path, {"accel": counts()}, about(), chunks=(CHUNK, 3), compression=packing)
    assert (streamed(path).counts == counts()).all()
    source = Hdf5Source(path)
    with source.opened():
        held = rows_of(source)
        assert held.kept_bytes == 6 * CHUNK
        assert held.dataset.id.get_access_plist().get_chunk_cache()[1] > 6 * CHUNK
        assert held.block(2500) == (2000, 3000)


def test_attributes_do_not_keep_a_dataset_open_with_a_small_cache(path: Path) -> None:
    """A dataset that is open already keeps its cache: its chunk would be unpacked for each of its parts."""
    size = 200_000
    values = np.zeros((size, 3))
    write(path, {"accel": values}, about(), chunks=(size, 3), compression="gzip")
    source = Hdf5Source(path)
    with source.opened():
        stated = source.around("/accel"), source.own("/accel")
        rows = rows_of(source, size, "f8")
        assert [one.number("lsb_per_g") for one in stated] == [256.0, 256.0]
        assert rows.kept_bytes == values.nbytes
        assert rows.dataset.id.get_access_plist().get_chunk_cache()[1] > values.nbytes


def test_a_chunk_wider_than_its_dataset_is_kept_as_well(path: Path) -> None:
    """Its rows are few enough for a block, but not its bytes."""
    with h5py.File(path, "w") as file:
        more: dict[str, Any] = {"maxshape": (None, None), "chunks": (CHUNK, 600), "compression": "gzip"}
        file.create_dataset("accel", data=counts(), **more).attrs.update(about())
    assert (streamed(path).counts == counts()).all()
    source = Hdf5Source(path)
    with source.opened():
        assert rows_of(source).kept_bytes == 2 * 600 * CHUNK


@pytest.mark.parametrize(("limit", "what"), [(5, "its columns are packed in parts"), (1, "column /x is")])
def test_chunks_that_are_too_large_together_are_refused(
    path: Path, monkeypatch: pytest.MonkeyPatch, limit: int, what: str
) -> None:
    monkeypatch.setattr(hdf5_reader, "BLOCK_ROWS", 1000)
    monkeypatch.setattr(tables, "REFUSE_ABOVE_BYTES", limit * CHUNK)
    monkeypatch.setattr(hdf5_reader, "REFUSE_ABOVE_BYTES", limit * CHUNK)
    with h5py.File(path, "w") as file:
        for name, column in zip("xyz", counts().T, strict=True):
            file.create_dataset(name, data=column, chunks=(CHUNK,), compression="gzip").attrs.update(about())
    with pytest.raises(UnreadableError, match=f"{what}.*too large to unpack at once") as error:
        streamed(path)
    assert "h5repack" in str(error.value.hint)


def test_a_damaged_index_still_tells_of_the_chunks_before_its_damage(path: Path) -> None:
    with h5py.File(path, "w") as file:
        dataset = file.create_dataset("accel", (ROWS, 3), "i2", chunks=(50, 3), fletcher32=True)
        dataset.attrs.update(about())
        dataset[:5000], dataset[5100:] = counts()[:5000], counts()[5100:]
    whole = streamed(path)
    assert (whole.counts == np.delete(counts(), np.s_[5000:5100], axis=0)).all()
    data = bytearray(path.read_bytes())
    # A leaf of the index, "TREE", kind 1, level 0, with the number of chunks and the row of the first.
    leaves = [found.start() for found in re.finditer(rb"TREE\x01\x00", data)]
    first = {struct.unpack_from("<Q", data, at + 32)[0]: at for at in leaves}
    row = sorted(first)[len(first) // 2]
    data[first[row]] ^= 0xFF
    absurd = data.index(struct.pack("<QQQ", 6000, 0, 0)) - 8
    struct.pack_into("<I", data, absurd, 3)
    path.write_bytes(data)
    got = streamed(path)
    lost = np.r_[5000:5100, 6000:6050, row:ROWS]
    assert 6050 < row < ROWS - 6000
    assert (got.counts == np.delete(counts(), lost, axis=0)).all()
    assert got.codes == ["bad_page"] * 3
