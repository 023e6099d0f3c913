"""Writes small Parquet recordings with pyarrow."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tests.formats.expected import Expected
from tests.formats.make_hdf5 import even_times

SERIAL = "0042"


def make(folder: Path, counts: np.ndarray, rate_hz: float, lsb_per_g: float) -> Expected:
    """Float columns in g and times in UTC, in row groups of 256."""
    path, times = folder / "made.parquet", even_times(len(counts), rate_hz)
    pq.write_table(table(counts / lsb_per_g, times), path, row_group_size=256)
    return Expected(path, counts / lsb_per_g, rate_hz, times, 0, SERIAL)


def table(
    values: np.ndarray, times: np.ndarray, unit: str | None = "g", zone: str | None = "UTC"
) -> pa.Table:
    """Columns time, x, y, z, with the unit in the metadata of each axis."""
    about = None if unit is None else {"unit": unit}
    fields = [pa.field("time", pa.timestamp("us", zone))]
    fields += [pa.field(name, pa.from_numpy_dtype(values.dtype), metadata=about) for name in "xyz"]
    columns: list[Any] = [pa.array(times).cast(pa.timestamp("us", zone))]
    columns += [pa.array(values[:, axis]) for axis in range(3)]
    return pa.Table.from_arrays(columns, schema=pa.schema(fields, metadata={"serial": SERIAL}))
