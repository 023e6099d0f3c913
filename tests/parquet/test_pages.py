"""Columns as pages of our own: other libraries read the same values, whatever rows and numbers there are."""

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

from accelcal_cli.core.clock import CACHED, steps_of
from accelcal_cli.parquet.pages import (
    DELTA_BLOCK,
    LEVEL,
    MAGIC,
    MOST_VALUES,
    PAGE_ROWS,
    SPLIT_LEVEL,
    ColumnChunk,
    Footer,
    RowGroup,
    delta_chunk,
    dictionary_chunk,
    encode_by_pyarrow,
    float_chunk,
    paired,
    places,
)

DICTIONARY_PAGE, DATA_PAGE = b"\x15\x04", b"\x15\x00"
"""How pages begin: field 1, an integer, is the kind, 2 or 0 (parquet.thrift, zigzag)."""

COUNTER = pa.schema([pa.field("n", pa.int64(), False), pa.field("v", pa.float32(), False)])
VALUES = pa.schema([pa.field("v", pa.float32(), False)])
TIMES = pa.schema([pa.field("time", pa.timestamp("us"), False)])
NOON = 1_772_798_400_000_000
DELTA_LENGTHS = [
    1, 2, 3, 127, DELTA_BLOCK, DELTA_BLOCK + 1, DELTA_BLOCK + 2,
    CACHED, CACHED + 1, CACHED + 2, 3 * CACHED + 5,
]  # fmt: skip
FLOAT_LENGTHS = [0, 1, 63, 65, PAGE_ROWS - 1, PAGE_ROWS, PAGE_ROWS + 1, 2 * PAGE_ROWS + 3]


def file_of(schema: pa.Schema, chunks: list[ColumnChunk], rows: int) -> bytes:
    """A file of one row group."""
    group, footer = RowGroup(chunks, rows), Footer(schema, compression="zstd")
    footer.add(group, len(MAGIC))
    return MAGIC + b"".join(bytes(part) for part in group.parts) + footer.tail()


# --- dictionaries


def counted(made: ColumnChunk, rows: int) -> bytes:
    """A file of a counter and one made column."""
    counter = pa.record_batch([pa.array(np.arange(rows))], schema=pa.schema([COUNTER.field("n")]))
    return file_of(COUNTER, [*encode_by_pyarrow(counter, compression="zstd"), made], rows)


def written(numbers: np.ndarray[Any, Any]) -> bytes:
    found = places(numbers)
    assert found is not None
    kept = (found.present[0] / 8).astype(np.float32)
    return counted(dictionary_chunk("v", found.of_rows, kept), len(numbers))


@pytest.mark.parametrize("values", [255, 256, 257])
@pytest.mark.parametrize("runs", [1, 8])
def test_places_beyond_one_byte_take_two(values: int, runs: int) -> None:
    numbers = np.repeat(np.random.RandomState(1).permutation(values), runs).astype(np.int32)
    found = places(numbers)
    assert found is not None
    assert found.of_rows.dtype == (np.uint8 if values <= 256 else np.uint16)
    assert (found.present[0][found.of_rows] == numbers).all()


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


@pytest.mark.parametrize(
    ("values", "taken"),
    [
        (np.arange(5000) % 4096, True),
        (np.arange(3000) % 700 / 8 - 20, True),
        (np.where(np.arange(4000) % 3, np.nan, np.arange(4000) % 1024), True),
        (np.repeat([3.7, np.nan, 3.9], [9, 500, 900]), True),
        (np.arange(3000) / 7, False),
    ],
)
def test_short_floats_are_found_by_their_bits(values: np.ndarray, taken: bool) -> None:
    bits = values.astype(np.float32).view(np.uint32)
    found = places(bits)
    assert (found is not None) == taken
    if found is not None:
        assert (found.present[0][found.of_rows] == bits).all() and found.present[0].dtype == np.uint32


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
    read = pq.read_table(pa.BufferReader(counted(dictionary_chunk("v", both.of_rows, kept), rows)))["v"]
    assert (read.to_numpy() == kept[both.of_rows]).all()


def test_too_many_pairs_are_not_taken() -> None:
    slow = places(np.repeat(np.arange(2, dtype=np.int32), MOST_VALUES))
    assert slow is not None
    numbers = np.arange(2 * MOST_VALUES, dtype=np.int32)
    assert paired(numbers, slow) is None
    assert paired(numbers * 8, slow) is None


# --- differences of times


def timed(times: np.ndarray[Any, Any]) -> bytes:
    """A file of nothing but times."""
    made = delta_chunk("time", steps_of(times))
    assert made is not None
    return file_of(TIMES, [made], len(times))


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


@pytest.mark.parametrize("rows", DELTA_LENGTHS)
@pytest.mark.parametrize("clock", ["even", "a third", "jitter", "back", "still"])
def test_pyarrow_reads_the_times_and_their_range(rows: int, clock: str) -> None:
    times = NOON + np.cumsum(clocks(rows)[clock], dtype=np.int64)
    data = timed(times)
    assert (read(data) == times).all()
    column = pq.ParquetFile(pa.BufferReader(data)).metadata.row_group(0).column(0)
    assert column.num_values == rows and set(column.encodings) == {"RLE", "DELTA_BINARY_PACKED"}
    kind = pa.timestamp("us")
    found = [
        pa.scalar(one, kind).cast(pa.int64()).as_py()
        for one in (column.statistics.min, column.statistics.max)
    ]
    assert found == [times.min(), times.max()] and column.statistics.null_count == 0


@pytest.mark.parametrize("rows", DELTA_LENGTHS)
@pytest.mark.parametrize("clock", ["even", "jitter", "back"])
def test_duckdb_and_polars_read_times(rows: int, clock: str, tmp_path: Any) -> None:
    duckdb, polars = pytest.importorskip("duckdb"), pytest.importorskip("polars")
    times, path = NOON + np.cumsum(clocks(rows)[clock], dtype=np.int64), tmp_path / "a.parquet"
    path.write_bytes(timed(times))
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
    assert (read(timed(times)) == times).all()


@pytest.mark.parametrize("at", [0, 5, CACHED - 1, CACHED, 2 * CACHED])
def test_other_differences_are_left_to_pyarrow(at: int) -> None:
    steps = np.full(2 * CACHED + 1, 10_000)
    steps[at] += 255
    times = NOON + np.concatenate([[0], np.cumsum(steps)])
    assert delta_chunk("time", steps_of(times)) is not None
    steps[at] += 1
    assert delta_chunk("time", steps_of(NOON + np.concatenate([[0], np.cumsum(steps)]))) is None


# --- single precision


def single(values: np.ndarray[Any, Any]) -> bytes:
    """A file of nothing but values."""
    return file_of(VALUES, [float_chunk("v", values)], len(values))


def bits(rows: int, repeat: int) -> np.ndarray[Any, Any]:
    """Any values, infinite ones and those that are no number among them."""
    few = np.random.default_rng(rows).integers(0, 1 << 32, rows // repeat + 1, dtype=np.uint32)
    return np.repeat(few, repeat)[:rows]


@pytest.mark.parametrize("rows", FLOAT_LENGTHS)
@pytest.mark.parametrize(("repeat", "encoding"), [(1, "BYTE_STREAM_SPLIT"), (1000, "PLAIN")])
def test_pyarrow_reads_every_bit(rows: int, repeat: int, encoding: str) -> None:
    held = bits(rows, repeat)
    file = pq.ParquetFile(pa.BufferReader(single(held.view(np.float32))))
    assert (file.read()["v"].to_numpy().view(np.uint32) == held).all()
    column = file.metadata.row_group(0).column(0)
    assert column.num_values == rows and column.physical_type == "FLOAT"
    assert rows <= repeat or encoding in column.encodings


@pytest.mark.parametrize(("repeat", "level"), [(1, SPLIT_LEVEL), (1000, LEVEL)])
def test_bytes_side_by_side_have_a_level_of_their_own(repeat: int, level: int) -> None:
    held = bits(PAGE_ROWS, repeat)
    plain = (
        held.tobytes() if repeat > 1 else np.frombuffer(held.tobytes(), np.uint8).reshape(-1, 4).T.tobytes()
    )
    _, packed = float_chunk("v", held.view(np.float32)).parts
    assert bytes(packed) == pa.Codec("zstd", compression_level=level).compress(plain, asbytes=True)


@pytest.mark.parametrize("rows", FLOAT_LENGTHS[1:])
@pytest.mark.parametrize("repeat", [1, 1000])
def test_duckdb_and_polars_read_values(rows: int, repeat: int, tmp_path: Path) -> None:
    duckdb, polars = pytest.importorskip("duckdb"), pytest.importorskip("polars")
    values, path = np.arange(rows, dtype=np.float32) // repeat + np.float32(0.1), tmp_path / "a.parquet"
    path.write_bytes(single(values))
    assert (polars.read_parquet(path)["v"].to_numpy() == values).all()
    assert (duckdb.sql(f"select v from '{path}'").fetchnumpy()["v"] == values).all()


@given(st.lists(st.floats(width=32, allow_nan=False), max_size=300))
def test_any_values(values: list[float]) -> None:
    held = np.array(values, np.float32)
    read = pq.read_table(pa.BufferReader(single(held)))["v"].to_numpy()
    assert (read.view(np.uint32) == held.view(np.uint32)).all()
