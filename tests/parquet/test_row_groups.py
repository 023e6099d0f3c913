"""Row groups that `parquet/pages.py` encodes apart: byte for byte the file that pyarrow writes at once."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.parquet.pages import MAGIC, Footer, RowGroup, encode_by_pyarrow

COLUMNS = [
    pa.field("time", pa.timestamp("us", "UTC"), False),
    *(pa.field(axis, pa.float32(), False, metadata={b"unit": b"g"}) for axis in "xyz"),
    pa.field("validity", pa.uint8(), False),
]
SCHEMA = pa.schema(COLUMNS, metadata={b"accelcal": b"{}" * 300})
OPTIONS: dict[str, Any] = {
    "compression": "zstd",
    "compression_level": 1,
    "use_dictionary": False,
    "column_encoding": {
        "time": "DELTA_BINARY_PACKED", "x": "BYTE_STREAM_SPLIT",
        "y": "PLAIN", "z": "PLAIN", "validity": "PLAIN",
    },
    "write_statistics": ["time"],
    "store_schema": True,
}  # fmt: skip


def batch(rows: int, seed: int) -> pa.RecordBatch:
    random = np.random.default_rng(seed)
    times = pa.array(10_000 * np.arange(rows) + seed, pa.int64()).cast(COLUMNS[0].type)
    xyz = [pa.array(random.normal(size=rows).astype(np.float32)) for _ in range(3)]
    return pa.record_batch([times, *xyz, pa.array(np.zeros(rows, np.uint8))], schema=SCHEMA)


def at_once(batches: list[pa.RecordBatch], **options: Any) -> bytes:
    sink = pa.BufferOutputStream()
    with pq.ParquetWriter(sink, SCHEMA, **options) as writer:
        for one in batches:
            writer.write_batch(one, max(1, one.num_rows))
    whole: bytes = sink.getvalue().to_pybytes()
    return whole


def apart(batches: list[pa.RecordBatch], **options: Any) -> bytes:
    data, footer = bytearray(MAGIC), Footer(SCHEMA, **options)
    for one in batches:
        group = RowGroup(encode_by_pyarrow(one, **options), one.num_rows)
        footer.add(group, len(data))
        data += b"".join(bytes(part) for part in group.parts)
    return bytes(data) + footer.tail()


@given(st.lists(st.integers(1, 5000), min_size=1, max_size=40), st.booleans())
def test_the_bytes_are_those_of_one_writer(rows: list[int], dictionary: bool) -> None:
    options = OPTIONS if not dictionary else {"compression": "snappy", "use_dictionary": ["x", "validity"]}
    batches = [batch(number, seed) for seed, number in enumerate(rows)]
    assert apart(batches, **options) == at_once(batches, **options)


@pytest.mark.nightly
def test_so_they_are_where_places_need_many_bytes() -> None:
    batches = [batch(1 << 20, seed) for seed in range(12)]
    assert apart(batches, **OPTIONS) == at_once(batches, **OPTIONS)
