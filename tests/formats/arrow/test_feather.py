"""Arrow IPC files and streams: writers, packing, batches of any length, and files that were cut short."""

from __future__ import annotations

import errno
import io
import os
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.feather
import pyarrow.parquet as pq
import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions, probe_file
from accelcal_cli.formats import find_format
from accelcal_cli.formats.tables import FEATHER, PARQUET, arrow, tracks
from tests.formats.cuts import every_byte, table_cuts
from tests.formats.make_hdf5 import read as read_of
from tests.formats.make_parquet import table
from tests.formats.table_values import ROWS, TIMES, values

read = partial(read_of, chunk_samples=250, form=FEATHER)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "a.feather"


def write(path: Path, rows: int = 100, compression: str = "uncompressed", stream: bool = False) -> Path:
    """Write a file, or a stream, of the usual table in batches of `rows` rows."""
    made = table(values(), TIMES)
    if not stream:
        pyarrow.feather.write_feather(made, path, compression=compression, chunksize=rows)
        return path
    how = pa.ipc.IpcWriteOptions(compression=None if compression == "uncompressed" else compression)
    with pa.ipc.new_stream(str(path), made.schema, options=how) as writer:
        writer.write_table(made, rows)
    return path


def batches(path: Path) -> list[tuple[int, int]]:
    """The bytes at which the messages of batches begin and end."""
    found = []
    with pa.OSFile(str(path)) as file:
        file.seek(8 if file.read(8) == b"ARROW1\0\0" else 0)
        begin = file.tell()
        for message in pa.ipc.MessageReader.open_stream(file):
            found += [(begin, file.tell())] if message.type == "record batch" else []
            begin = file.tell()
    return found


@pytest.mark.parametrize("compression", ["uncompressed", "lz4", "zstd"])
@pytest.mark.parametrize("stream", [False, True], ids=["file", "stream"])
def test_batches_of_any_length_give_the_same_bits(path: Path, compression: str, stream: bool) -> None:
    found = []
    for rows in (1, 77, ROWS):
        write(path, rows, compression, stream)
        assert find_format(path, ReadOptions()).name == "feather"
        found.append(read(path))
    assert (found[0].g == values()).all()
    assert (found[0].times == TIMES).all()
    assert (found[0].recording.timezone, found[0].recording.device.serial) == ("UTC", "0042")
    assert found[0].problems == []
    assert all(one.same_as(found[0]) for one in found)


@pytest.mark.parametrize("compression", ["uncompressed", "lz4", "zstd"])
def test_files_of_polars(path: Path, compression: Any) -> None:
    frame = pl.DataFrame({"time": TIMES, **{name: values()[:, axis] for axis, name in enumerate("xyz")}})
    frame = frame.with_columns(pl.col("time").cast(pl.Datetime("us")))
    sides = frame.with_columns(pl.Series("sensor", ["left", "right"] * (ROWS // 2)))
    for write_it in (pl.DataFrame.write_ipc, pl.DataFrame.write_ipc_stream):
        write_it(frame, path, compression=compression)
        found = read(path)
        assert (found.g == values()).all()
        assert (found.times == TIMES).all()
        write_it(sides, path, compression=compression)  # its texts are views
        with pytest.raises(UnreadableError, match="several sensors"):
            read(path)
        assert (read(path, sensor="left").g == values()[::2]).all()


@every_byte
@pytest.mark.parametrize("stream", [False, True], ids=["file", "stream"])
def test_what_was_cut_short_is_read_as_far_as_it_goes(tmp_path: Path, stream: bool, step: int) -> None:
    data = write(tmp_path / "whole.feather", 100, stream=stream).read_bytes()
    ends = [begin for begin, _ in batches(tmp_path / "whole.feather")]
    path, seen = tmp_path / "cut.feather", set()
    for size in table_cuts(data, step, *ends, len(data) - 8):
        path.write_bytes(data[:size])
        try:
            found = read(path, format="feather")
        except UnreadableError as error:
            assert error.hint
            assert size < ends[1] + 8 or len(data) - size < 2
            continue
        rows = len(found.counts)
        assert rows % 100 == 0
        assert (found.g == values()[:rows]).all()
        at_border = stream and size in (*ends, len(data) - 8)
        assert found.codes == ([] if at_border else ["truncated"])
        seen.add(rows)
    assert seen >= {100, 200, 300, 400, 500}


@pytest.mark.parametrize("part", [2, 5], ids=["middle", "last"])
def test_a_damaged_batch_loses_its_own_rows_alone(path: Path, part: int) -> None:
    write(path, 100, "zstd")
    begin, end = batches(path)[part]
    whole = bytearray(path.read_bytes())
    start = begin + 8 + int.from_bytes(whole[begin + 4 : begin + 8], "little")
    whole[start:end] = b"\xff" * (end - start)
    path.write_bytes(whole)
    found = read(path)
    first = 100 * part
    assert (found.g == np.delete(values(), np.arange(first, first + 100), axis=0)).all()
    assert [(one.code, one.sample, one.count, one.byte_offset) for one in found.problems] == [
        ("bad_page", first, 100, begin)
    ]
    assert found.breaks == [200] * (part == 2)


def test_a_batch_whose_head_is_damaged_is_named_and_hides_no_other(path: Path) -> None:
    begin, _ = batches(write(path, 100))[2]
    whole = bytearray(path.read_bytes())
    whole[begin + 8 : begin + 40] = b"\xff" * 32
    path.write_bytes(whole)
    found = read(path)
    assert (found.g == np.delete(values(), np.arange(200, 300), axis=0)).all()
    assert [(one.code, one.count) for one in found.problems] == [("damaged_header", 1), ("clock_gap", 1)]


@pytest.mark.parametrize("stream", [False, True], ids=["file", "stream"])
@pytest.mark.parametrize("packed", [False, True], ids=["offsets", "indices"])
def test_places_beyond_the_texts_of_a_column_of_times_cost_a_batch(
    path: Path, stream: bool, packed: bool
) -> None:
    texts = pa.array([f"2024-03-04T00:00:{row // 50:02d}.{row % 50 * 20:03d}Z" for row in range(ROWS)])
    times = texts.dictionary_encode() if packed else texts
    made = pa.table({"time": times, **{name: values()[:, axis] for axis, name in enumerate("xyz")}})
    with (pa.ipc.new_stream if stream else pa.ipc.new_file)(str(path), made.schema) as writer:
        writer.write_table(made, 100)
    whole = bytearray(path.read_bytes())
    for part in (0, 3):
        begin, _ = batches(path)[part]
        start = begin + 8 + int.from_bytes(whole[begin + 4 : begin + 8], "little")
        whole[start + 160 : start + 164] = b"\xff\xff\xff\x7f"
    path.write_bytes(whole)
    found = read(path)
    assert (found.g == np.delete(values(), [*range(100), *range(300, 400)], axis=0)).all()
    assert [(one.code, one.count) for one in found.problems] == [("bad_page", 100), ("bad_page", 100)]


@pytest.mark.parametrize("cut", [False, True], ids=["file", "cut"])
@pytest.mark.parametrize("name", ["a.parquet", "a.feather", "a.arrows"])
def test_texts_of_dictionaries_that_change(tmp_path: Path, name: str, cut: bool) -> None:
    """Dictionaries may grow within a file, and be replaced within a stream."""
    path, parts = tmp_path / name, [["left", " wrist\0", ""], [None, "right", "left"], ["ankle", "hip", " "]]
    texts = [text for part in parts for text in part * (ROWS // 9)]
    step = len(texts) // 3
    tables = [
        pa.table({"place": pa.array(texts[row : row + step]).dictionary_encode(), **axes(row, row + step)})
        for row in range(0, len(texts), step)
    ]
    if name == "a.parquet":
        pq.write_table(pa.concat_tables(tables), path, row_group_size=step)
    else:
        new = pa.ipc.new_stream if name == "a.arrows" else pa.ipc.new_file
        made = tables if name == "a.arrows" else pa.concat_tables(tables).unify_dictionaries().to_batches()
        with new(str(path), tables[0].schema) as writer:
            for part in made:
                writer.write(part)
    if cut and name != "a.parquet":
        path.write_bytes(path.read_bytes()[: batches(path)[2][1]])
    for place in ("left", "wrist", "right", "ankle", "hip"):
        own = [row for row, text in enumerate(texts) if (text or "").strip(" \0") == place]
        kind = PARQUET if name == "a.parquet" else FEATHER
        found = read_of(path, 250, kind, sensor=place, rate_hz=50.0)
        assert (found.g == values()[own]).all()


def axes(start: int, stop: int) -> dict[str, np.ndarray]:
    return {name: values()[start:stop, axis] for axis, name in enumerate("xyz")}


def test_what_the_disk_cannot_read_is_not_taken_for_damage(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Failing(io.FileIO):
        def read(self, size: int | None = -1) -> bytes:
            if self.tell() > 8000:
                raise OSError(errno.EIO, os.strerror(errno.EIO))
            return super().read(size)

    write(path, 100)
    with FEATHER.open(path, ReadOptions()) as reader:
        monkeypatch.setattr(Path, "open", lambda path, mode: Failing(path))
        with pytest.raises(UnreadableError, match=r"cannot be read \(Input/output error\)"):
            list(reader.chunks(100))


def test_packed_batches_that_are_too_long_are_refused(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracks, "REFUSE_ABOVE_BYTES", 4000)
    monkeypatch.setattr(arrow, "BLOCK_ROWS", 64)
    assert len(read(write(path, ROWS)).counts) == ROWS
    with pytest.raises(UnreadableError, match="65 536 rows"):
        read(write(path, ROWS, "zstd"))


@pytest.mark.parametrize(
    ("data", "match"),
    [
        (b"FEA1" + bytes(60), "version 1"),
        (b"ARROW1\0\0" + bytes(60), "footer|schema"),
        (b"abc", "not an Arrow"),
    ],
)
def test_what_is_none_is_refused(path: Path, data: bytes, match: str) -> None:
    path.write_bytes(data)
    with pytest.raises(UnreadableError, match=match):
        read(path)


def test_bytes_like_those_of_an_erased_dump_are_no_stream(path: Path) -> None:
    path.write_bytes(b"\xff" * 4096)
    assert FEATHER.sniff(probe_file(path, ReadOptions())) == 0
