"""Arrow IPC files and streams: writers, packing, batches of any length, and files that were cut short."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.feather
import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions, probe_file
from accelcal_cli.formats import find_format
from accelcal_cli.formats.arrow import FEATHER
from accelcal_cli.formats.arrow.ipc import scan
from tests.formats.cuts import every_byte, table_cuts
from tests.formats.make_hdf5 import Read
from tests.formats.make_hdf5 import read as read_of
from tests.formats.make_parquet import table
from tests.formats.table_values import ROWS, TIMES, values


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "a.feather"


def read(path: Path, chunk_samples: int = 250, **options: Any) -> Read:
    return read_of(path, chunk_samples, FEATHER, **options)


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
    frame.write_ipc(path, compression=compression)
    assert (read(path).g == values()).all()
    frame.write_ipc_stream(path, compression=compression)
    found = read(path)
    assert (found.g == values()).all()
    assert (found.times == TIMES).all()


@pytest.mark.parametrize("stream", [False, True], ids=["file", "stream"])
def test_the_batches_that_are_found_are_those_of_pyarrow(path: Path, stream: bool) -> None:
    write(path, 77, "zstd", stream)
    found = scan(path)
    assert [batch.rows for batch in found.batches] == [77] * 7 + [61]
    assert all(batch.packed for batch in found.batches)
    assert found.missing == 0
    for batch in found.batches:
        with path.open("rb") as file:
            file.seek(batch.offset)
            message = pa.ipc.read_message(file)
        assert (message.type, message.body.size) == ("record batch", batch.body_bytes)


@every_byte
@pytest.mark.parametrize("stream", [False, True], ids=["file", "stream"])
def test_what_was_cut_short_is_read_as_far_as_it_goes(tmp_path: Path, stream: bool, step: int) -> None:
    data = write(tmp_path / "whole.feather", 100, stream=stream).read_bytes()
    ends = [batch.offset for batch in scan(tmp_path / "whole.feather").batches]
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


def test_a_damaged_batch_loses_its_own_rows_alone(path: Path) -> None:
    write(path, 100, "zstd")
    batch = scan(path).batches[2]
    whole = bytearray(path.read_bytes())
    start = batch.offset + 8 + int.from_bytes(whole[batch.offset + 4 : batch.offset + 8], "little")
    whole[start : start + batch.body_bytes] = b"\xff" * batch.body_bytes
    path.write_bytes(whole)
    found = read(path)
    assert (found.g == np.delete(values(), np.arange(200, 300), axis=0)).all()
    assert [(one.code, one.sample, one.count, one.byte_offset) for one in found.problems] == [
        ("bad_page", 200, 100, batch.offset)
    ]
    assert found.breaks == [200]


def test_packed_batches_that_are_too_long_are_refused(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from accelcal_cli.formats._tables import reader
    from accelcal_cli.formats.arrow import ipc

    monkeypatch.setattr(reader, "REFUSE_ABOVE_BYTES", 4000)
    monkeypatch.setattr(ipc, "BLOCK_ROWS", 64)
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
