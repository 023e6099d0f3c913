"""Columns of single precision: other libraries read every bit back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.output.column_chunks import MAGIC
from accelcal_cli.output.float_pages import PAGE_ROWS, float_chunk
from accelcal_cli.output.row_groups import Footer, RowGroup

SCHEMA = pa.schema([pa.field("v", pa.float32(), False)])
LENGTHS = [0, 1, 63, 65, PAGE_ROWS - 1, PAGE_ROWS, PAGE_ROWS + 1, 2 * PAGE_ROWS + 3]


def file_of(values: np.ndarray[Any, Any]) -> bytes:
    """A file of nothing but values."""
    group, footer = RowGroup([float_chunk("v", values, 1)], len(values)), Footer(SCHEMA, compression="zstd")
    footer.add(group, len(MAGIC))
    return MAGIC + b"".join(bytes(part) for part in group.parts) + footer.tail()


def bits(rows: int, repeat: int) -> np.ndarray[Any, Any]:
    """Any values, infinite ones and those that are no number among them."""
    few = np.random.default_rng(rows).integers(0, 1 << 32, rows // repeat + 1, dtype=np.uint32)
    return np.repeat(few, repeat)[:rows]


@pytest.mark.parametrize("rows", LENGTHS)
@pytest.mark.parametrize(("repeat", "encoding"), [(1, "BYTE_STREAM_SPLIT"), (1000, "PLAIN")])
def test_pyarrow_reads_every_bit(rows: int, repeat: int, encoding: str) -> None:
    held = bits(rows, repeat)
    file = pq.ParquetFile(pa.BufferReader(file_of(held.view(np.float32))))
    assert (file.read()["v"].to_numpy().view(np.uint32) == held).all()
    column = file.metadata.row_group(0).column(0)
    assert column.num_values == rows and column.physical_type == "FLOAT"
    assert rows <= repeat or encoding in column.encodings


@pytest.mark.parametrize(("repeat", "level"), [(1, -1), (1000, 3)])
def test_bytes_side_by_side_have_a_level_of_their_own(repeat: int, level: int) -> None:
    held = bits(PAGE_ROWS, repeat)
    plain = (
        held.tobytes() if repeat > 1 else np.frombuffer(held.tobytes(), np.uint8).reshape(-1, 4).T.tobytes()
    )
    _, packed = float_chunk("v", held.view(np.float32), 3).parts
    assert bytes(packed) == pa.Codec("zstd", compression_level=level).compress(plain, asbytes=True)


@pytest.mark.parametrize("rows", LENGTHS[1:])
@pytest.mark.parametrize("repeat", [1, 1000])
def test_duckdb_and_polars_read_them(rows: int, repeat: int, tmp_path: Path) -> None:
    duckdb, polars = pytest.importorskip("duckdb"), pytest.importorskip("polars")
    values, path = np.arange(rows, dtype=np.float32) // repeat + np.float32(0.1), tmp_path / "a.parquet"
    path.write_bytes(file_of(values))
    assert (polars.read_parquet(path)["v"].to_numpy() == values).all()
    assert (duckdb.sql(f"select v from '{path}'").fetchnumpy()["v"] == values).all()


@given(st.lists(st.floats(width=32, allow_nan=False), max_size=300))
def test_any_values(values: list[float]) -> None:
    held = np.array(values, np.float32)
    read = pq.read_table(pa.BufferReader(file_of(held)))["v"].to_numpy()
    assert (read.view(np.uint32) == held.view(np.uint32)).all()
