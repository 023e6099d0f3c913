"""Times as differences of a byte: other readers find the same ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.core.clock import CACHED, steps_of
from accelcal_cli.output.column_chunks import MAGIC
from accelcal_cli.output.delta_pages import BLOCK, delta_chunk
from accelcal_cli.output.row_groups import Footer, RowGroup

SCHEMA = pa.schema([pa.field("time", pa.timestamp("us"), False)])
OPTIONS: dict[str, Any] = {"compression": "zstd"}
NOON = 1_772_798_400_000_000
LENGTHS = [1, 2, 3, 127, BLOCK, BLOCK + 1, BLOCK + 2, CACHED, CACHED + 1, CACHED + 2, 3 * CACHED + 5]


def file_of(times: np.ndarray[Any, Any]) -> bytes:
    """A file of nothing but times."""
    made = delta_chunk("time", steps_of(times), 1)
    assert made is not None
    group, footer = RowGroup([made], len(times)), Footer(SCHEMA, **OPTIONS)
    footer.add(group, len(MAGIC))
    return MAGIC + b"".join(bytes(part) for part in group.parts) + footer.tail()


def read(data: bytes) -> np.ndarray[Any, Any]:
    held: np.ndarray[Any, Any] = pq.read_table(pa.BufferReader(data))["time"].cast(pa.int64()).to_numpy()
    return held


def clocks(rows: int) -> dict[str, np.ndarray[Any, Any]]:
    random = np.random.default_rng(rows)
    return {
        "even": np.full(rows, 10_000),
        "a third": np.where(np.arange(rows) % 3 == 0, 33_334, 33_333),
        "jitter": random.integers(9_900, 10_156, rows),
        "back": random.integers(-200, 50, rows),
        "still": np.zeros(rows, np.int64),
    }


@pytest.mark.parametrize("rows", LENGTHS)
@pytest.mark.parametrize("clock", ["even", "a third", "jitter", "back", "still"])
def test_pyarrow_reads_the_times_and_their_range(rows: int, clock: str) -> None:
    times = NOON + np.cumsum(clocks(rows)[clock], dtype=np.int64)
    data = file_of(times)
    assert (read(data) == times).all()
    column = pq.ParquetFile(pa.BufferReader(data)).metadata.row_group(0).column(0)
    assert column.num_values == rows and set(column.encodings) == {"RLE", "DELTA_BINARY_PACKED"}
    kind = pa.timestamp("us")
    found = [
        pa.scalar(one, kind).cast(pa.int64()).as_py()
        for one in (column.statistics.min, column.statistics.max)
    ]
    assert found == [times.min(), times.max()] and column.statistics.null_count == 0


@pytest.mark.parametrize("rows", LENGTHS)
@pytest.mark.parametrize("clock", ["even", "jitter", "back"])
def test_duckdb_and_polars_read_them(rows: int, clock: str, tmp_path: Any) -> None:
    duckdb, polars = pytest.importorskip("duckdb"), pytest.importorskip("polars")
    times, path = NOON + np.cumsum(clocks(rows)[clock], dtype=np.int64), tmp_path / "a.parquet"
    path.write_bytes(file_of(times))
    assert (polars.read_parquet(path)["time"].cast(polars.Int64).to_numpy() == times).all()
    found = duckdb.sql(f"select epoch_us(time) as t from '{path}'").fetchnumpy()["t"]
    assert (np.asarray(found) == times).all()
    later = f"select count(*) from '{path}' where time > make_timestamp({times[rows // 2]})"
    assert duckdb.sql(later).fetchall()[0][0] == (times > times[rows // 2]).sum()


@given(
    st.integers(-(1 << 55), 1 << 55),
    st.integers(-(1 << 40), 1 << 40),
    st.lists(st.integers(0, 255), max_size=300),
)
def test_any_differences_within_a_byte(first: int, least: int, above: list[int]) -> None:
    times = first + np.cumsum([0, *(least + one for one in above)], dtype=np.int64)
    assert (read(file_of(times)) == times).all()


@pytest.mark.parametrize("at", [0, 5, CACHED - 1, CACHED, 2 * CACHED])
def test_other_differences_are_left_to_pyarrow(at: int) -> None:
    steps = np.full(2 * CACHED + 1, 10_000)
    steps[at] += 255
    times = NOON + np.concatenate([[0], np.cumsum(steps)])
    assert delta_chunk("time", steps_of(times), 1) is not None
    steps[at] += 1
    assert delta_chunk("time", steps_of(NOON + np.concatenate([[0], np.cumsum(steps)])), 1) is None
