"""Columns made of whole numbers: read back by other libraries, whatever rows and numbers there are."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.output.column_chunks import MAGIC, ColumnChunk
from accelcal_cli.output.dictionary_pages import MOST_VALUES, dictionary_chunk, paired, places
from accelcal_cli.output.row_groups import Footer, RowGroup, by_pyarrow

DICTIONARY_PAGE, DATA_PAGE = b"\x15\x04", b"\x15\x00"
"""How pages begin: field 1, an integer, is the kind, 2 or 0 (parquet.thrift, zigzag)."""

SCHEMA = pa.schema([pa.field("n", pa.int64(), False), pa.field("v", pa.float32(), False)])


def in_file(made: ColumnChunk, rows: int) -> bytes:
    """A file of a counter and one made column."""
    counter = pa.record_batch([pa.array(np.arange(rows))], schema=pa.schema([SCHEMA.field("n")]))
    group = RowGroup([*by_pyarrow(counter, compression="zstd"), made], rows)
    footer = Footer(SCHEMA, compression="zstd")
    footer.add(group, len(MAGIC))
    return MAGIC + b"".join(bytes(part) for part in group.parts) + footer.tail()


def written(numbers: np.ndarray[Any, Any]) -> bytes:
    found = places(numbers)
    assert found is not None
    kept = (found.present[0] / 8).astype(np.float32)
    return in_file(dictionary_chunk("v", found.of_rows, kept, 1), len(numbers))


@given(
    st.lists(st.integers(-(1 << 19), (1 << 19) - 1), min_size=1, max_size=300),
    st.integers(1, 12),
    st.sampled_from([np.int32, np.int64, np.float32]),
)
def test_pyarrow_reads_what_was_written(numbers: list[int], times: int, kind: type) -> None:
    rows: np.ndarray[Any, Any] = np.repeat(np.array(numbers, kind), times)
    data = written(rows)
    assert (pq.read_table(pa.BufferReader(data))["v"].to_numpy() == (rows / 8).astype(np.float32)).all()
    column = pq.ParquetFile(pa.BufferReader(data)).metadata.row_group(0).column(1)
    kinds = [data[at : at + 2] for at in (column.dictionary_page_offset, column.data_page_offset)]
    assert kinds == [DICTIONARY_PAGE, DATA_PAGE]


@pytest.mark.parametrize("rows", [1, 7, 8, 9, 524_288])
@pytest.mark.parametrize("spread", [3, 300, 60_000])
def test_duckdb_reads_what_was_written(rows: int, spread: int) -> None:
    duckdb = pytest.importorskip("duckdb")
    numbers = np.random.default_rng(rows).integers(0, spread, rows).astype(np.int32)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.parquet"
        path.write_bytes(written(numbers))
        read = duckdb.execute(f"select v from '{path}' order by n").fetchnumpy()["v"]
    assert (read == (numbers / 8).astype(np.float32)).all()


def test_more_values_than_places_of_two_bytes_are_not_taken() -> None:
    numbers = np.arange(MOST_VALUES + 1, dtype=np.int32)
    assert places(numbers) is None
    found = places(numbers[1:])
    assert found is not None
    assert found.of_rows.tolist() == list(range(MOST_VALUES))
    assert places(numbers[:0]) is None


def test_numbers_far_apart_or_beyond_all_bounds_are_not_taken() -> None:
    low, high = np.iinfo(np.int32).min, np.iinfo(np.int32).max
    assert places(np.array([low, high] * 9, np.int32)) is None
    assert places(np.array([0.0, np.inf] * 9, np.float32)) is None


@pytest.mark.parametrize("span", [9, 32_767, 32_768, 65_535, 65_536, 100_000])
@pytest.mark.parametrize("others", [[500], [500, -3]])
def test_pairs_have_one_place_each(span: int, others: list[int]) -> None:
    rows = 60_000
    slow = places(np.repeat(np.array(others, np.int32), rows // len(others)))
    assert slow is not None
    numbers = np.random.default_rng(span).integers(-7, span - 7, rows).astype(np.int32)
    numbers[:2] = -7, span - 8
    both = paired(numbers, slow)
    assert both is not None
    assert (both.present[0][both.of_rows] == numbers).all()
    assert (both.present[1][both.of_rows] == slow.present[0][slow.of_rows]).all()
    kept = (both.present[0] / 8 + both.present[1]).astype(np.float32)
    read = pq.read_table(pa.BufferReader(in_file(dictionary_chunk("v", both.of_rows, kept, 1), rows)))["v"]
    assert (read.to_numpy() == kept[both.of_rows]).all()


def test_too_many_pairs_are_not_taken() -> None:
    slow = places(np.repeat(np.arange(2, dtype=np.int32), MOST_VALUES))
    assert slow is not None
    numbers = np.arange(2 * MOST_VALUES, dtype=np.int32)
    assert paired(numbers, slow) is None
    assert paired(numbers * 8, slow) is None
