"""Gzip-packed HDF5 chunks unpacked without h5py: the oracle is what was written, and h5py itself."""

from __future__ import annotations

import threading
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.parallel import thread_pool
from accelcal_cli.formats._tables import reader as tables
from accelcal_cli.formats._tables.table import Track
from accelcal_cli.formats.hdf5 import HDF5
from accelcal_cli.formats.hdf5 import rows as hdf5_rows
from tests.formats.make_hdf5 import Read, about, joined, write

ROWS, CHUNK = 40_000, 6000


def counts() -> np.ndarray:
    return np.random.default_rng(5).integers(-2048, 2048, (ROWS, 3)).astype(np.int16)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "a.h5"


@pytest.fixture
def done(monkeypatch: pytest.MonkeyPatch) -> list[tuple[range, bool]]:
    """Return what was read by chunks, and whether h5py was not needed for it."""
    seen: list[tuple[range, bool]] = []
    read = hdf5_rows.StoredChunks.read

    def spy(self: hdf5_rows.StoredChunks, rows: range) -> Any:
        values = read(self, rows)
        seen.append((rows, values is not None))
        return values

    monkeypatch.setattr(hdf5_rows.StoredChunks, "read", spy)
    return seen


def streamed(path: Path, threads: int = 1, samples: int = 7000) -> Read:
    with HDF5.open(path, ReadOptions()) as reader:
        reader.threads = threads
        return joined(reader.recording, reader.chunks(samples))


def by_h5py(path: Path, monkeypatch: pytest.MonkeyPatch) -> Read:
    with monkeypatch.context() as patch:
        patch.setattr(hdf5_rows, "LEAST_BYTES", 1 << 40)
        return streamed(path)


OTHERS = [pytest.param(dtype, marks=pytest.mark.nightly) for dtype in ("f8", ">i8", "g")]


@pytest.mark.parametrize("threads", [pytest.param(1, marks=pytest.mark.nightly), 2])
@pytest.mark.parametrize("shuffle", [False, True])
@pytest.mark.parametrize("dtype", ["<i2", ">i4", "<f4", *OTHERS])
@pytest.mark.parametrize("shape", ["wide", "transposed", "columns"])
def test_chunks_are_unpacked_as_they_were_packed(
    path: Path, done: list[tuple[range, bool]], threads: int, shuffle: bool, dtype: str, shape: str
) -> None:
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
    got = streamed(path, threads)
    assert (got.counts == counts()).all()
    assert (got.codes, got.breaks) == ([], [])
    assert all(whole for _, whole in done)
    assert {rows.stop for rows, _ in done} >= {ROWS}


@pytest.mark.parametrize("size", [1, 2, 4, 8])
def test_shuffled_bytes_are_put_together(size: int) -> None:
    raw = np.random.default_rng(size).integers(0, 256, size * 999, np.uint8)
    expected = raw.reshape(size, -1).T.tobytes()
    assert hdf5_rows.unshuffled(raw.tobytes(), size).tobytes() == expected


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


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("change", CHANGES)
def test_a_chunk_that_is_not_plain_gives_what_h5py_gives(
    path: Path, monkeypatch: pytest.MonkeyPatch, change: str, threads: int
) -> None:
    monkeypatch.setattr(hdf5_rows, "STORED_ROWS", 3 * CHUNK)
    write(path, {"accel": counts()}, about(), chunks=(CHUNK, 3), compression="gzip")
    overwrite(path, 2 * CHUNK, CHANGES[change])
    got = streamed(path, threads)
    assert got.same_as(by_h5py(path, monkeypatch))
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


@pytest.mark.parametrize("threads", [1, 2])
def test_chunks_that_were_never_written_are_lost(
    path: Path, monkeypatch: pytest.MonkeyPatch, threads: int
) -> None:
    with h5py.File(path, "w") as file:
        dataset = file.create_dataset(
            "accel", (ROWS, 3), "i2", chunks=(CHUNK, 3), compression="gzip", fillvalue=7
        )
        dataset[: 2 * CHUNK] = counts()[: 2 * CHUNK]
        dataset[4 * CHUNK :] = counts()[4 * CHUNK :]
        dataset.attrs.update(about())
    got = streamed(path, threads)
    assert (got.counts == counts()[np.r_[0 : 2 * CHUNK, 4 * CHUNK : ROWS]]).all()
    assert (got.codes, got.breaks) == (["bad_page"], [2 * CHUNK])
    assert got.same_as(by_h5py(path, monkeypatch))


LEFT_TO_H5PY: dict[str, dict[str, Any]] = {
    "lzf": {"compression": "lzf"},
    "checksums": {"compression": "gzip", "fletcher32": True},
    "only shuffled": {"shuffle": True},
    "part of the columns": {"compression": "gzip", "chunks": (CHUNK * 3, 1)},
    "small chunks": {"compression": "gzip", "chunks": (100, 3)},
    "scaled": {"scaleoffset": 0, "compression": "gzip"},
}


@pytest.mark.parametrize("layout", LEFT_TO_H5PY)
def test_what_is_packed_otherwise_is_left_to_h5py(
    path: Path, done: list[tuple[range, bool]], layout: str
) -> None:
    write(path, {"accel": counts()}, about(), **{"chunks": (CHUNK, 3), **LEFT_TO_H5PY[layout]})
    assert (streamed(path).counts == counts()).all()
    assert done == []


def test_numbers_that_numpy_does_not_know_are_left_to_h5py(
    path: Path, done: list[tuple[range, bool]]
) -> None:
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
    assert done == []


def test_large_chunks_are_left_to_h5py(
    path: Path, monkeypatch: pytest.MonkeyPatch, done: list[tuple[range, bool]]
) -> None:
    monkeypatch.setattr(hdf5_rows, "MOST_BYTES", 6 * CHUNK - 1)
    write(path, {"accel": counts()}, about(), chunks=(CHUNK, 3), compression="gzip")
    assert (streamed(path).counts == counts()).all()
    assert done == []


def test_what_was_unpacked_ahead_is_not_taken_for_other_rows(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hdf5_rows, "STORED_ROWS", CHUNK)
    write(path, {"accel": counts()}, chunks=(CHUNK, 3), compression="gzip")
    track = Track("/accel", ROWS, 3, 0, np.dtype("i2"))
    with h5py.File(path) as file, thread_pool(2, "hdf5") as pool:
        rows = hdf5_rows.TrackRows(file, track, path, pool)
        for start in (0, 3 * CHUNK, 100, CHUNK):
            assert (rows.read(start, start + 200)[0] == counts()[start : start + 200]).all()


@pytest.mark.parametrize("threads", [1, 2])
def test_only_where_several_may_work_is_anything_unpacked_ahead(
    path: Path, monkeypatch: pytest.MonkeyPatch, threads: int
) -> None:
    monkeypatch.setattr(hdf5_rows, "STORED_ROWS", CHUNK)
    begun: list[tuple[int, str]] = []
    unshuffled = hdf5_rows.unshuffled
    first_row = {counts()[row : row + CHUNK].tobytes(): row for row in range(0, ROWS - CHUNK + 1, CHUNK)}

    def spy(raw: bytes, size: int) -> np.ndarray:
        begun.append((first_row[raw], threading.current_thread().name))
        return unshuffled(raw, size)

    write(path, {"accel": counts()}, about(), chunks=(CHUNK, 3), compression="gzip")
    with HDF5.open(path, ReadOptions()) as reader:
        monkeypatch.setattr(hdf5_rows, "unshuffled", spy)
        reader.threads = threads
        stream = reader.chunks(CHUNK)
        next(stream)
        stream.close()
    assert {row for row, _ in begun} == ({0} if threads == 1 else {0, CHUNK})
    assert all(name.startswith("hdf5") == (threads > 1) for _, name in begun)
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("hdf5")]


def test_wide_rows_come_in_fewer_at_a_time(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "PIECE_BYTES", 24_000)
    write(path, {"accel": counts().astype("f8")}, about())
    with HDF5.open(path, ReadOptions()) as reader:
        parts = [chunk.counts for chunk in reader.chunks(1 << 20)]
    assert max(map(len, parts)) == 1000
    assert (np.concatenate(parts) == counts()).all()


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
    offset = hdf5_rows.TrackRows.chunk_offset

    def counted(self: hdf5_rows.TrackRows, row: int) -> int | None:
        asked.append(row)
        return offset(self, row)

    monkeypatch.setattr(hdf5_rows.TrackRows, "chunk_offset", counted)
    got = streamed(path)
    rows = [row + k for row in sorted((*range(0, 6000, 200), 10)) for k in range(10)]
    expected = counts()[rows]
    expected[[rows.index(400 + k) for k in range(10)], :2] = 7
    assert (got.counts == expected).all()
    assert len(asked) < 100


def test_small_chunks_are_read_a_few_thousand_at_a_time(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """14. of the hostile run: the HDF5 library's notes on 65 536 chunks took 700 MB."""
    monkeypatch.setattr(hdf5_rows, "MOST_CHUNKS", 300)
    read: list[int] = []
    fetch = hdf5_rows.TrackRows.fetch

    def counted(self: hdf5_rows.TrackRows, start: int, stop: int) -> np.ndarray:
        read.append(stop - start)
        return fetch(self, start, stop)

    monkeypatch.setattr(hdf5_rows.TrackRows, "fetch", counted)
    write(path, {"accel": counts()[:5000]}, about(), chunks=(5, 1))
    assert (streamed(path).counts == counts()[:5000]).all()
    assert max(read) == 500


def test_large_chunks_of_other_filters_are_unpacked_once_and_read_in_parts(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hdf5_rows, "STREAM_ABOVE_BYTES", 1000)
    monkeypatch.setattr(hdf5_rows, "BLOCK_ROWS", 1000)
    write(path, {"accel": counts()}, about(), chunks=(CHUNK, 3), compression="lzf")
    assert (streamed(path).counts == counts()).all()
    with h5py.File(path) as file:
        held = hdf5_rows.TrackRows(file, Track("/accel", ROWS, 3, 0, np.dtype("i2")), path)
        assert held.kept_bytes == 6 * CHUNK
        assert held.dataset.id.get_access_plist().get_chunk_cache()[1] > 6 * CHUNK
        assert held.block(2500) == (2000, 3000)


def test_chunks_that_are_too_large_together_are_refused(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hdf5_rows, "STREAM_ABOVE_BYTES", 1000)
    monkeypatch.setattr(tables, "REFUSE_ABOVE_BYTES", 5 * CHUNK)
    with h5py.File(path, "w") as file:
        for name, column in zip("xyz", counts().T, strict=True):
            file.create_dataset(name, data=column, chunks=(CHUNK,), compression="lzf").attrs.update(about())
    with pytest.raises(UnreadableError, match="too large to unpack at once") as error:
        streamed(path)
    assert "h5repack" in str(error.value.hint)
