"""Parquet files written by threads and read back, for columns whose values often follow from whole numbers.

`ParquetSink` takes rows of `Column`s, `ParquetSource` gives them back. Nothing outside this package imports
its modules, and importing it loads pyarrow, which takes as long as all of accelcal.
"""

from accelcal_cli.parquet.pages import row_group_offsets
from accelcal_cli.parquet.sink import Axes, Column, ColumnValues, Memory, Numbers, ParquetSink
from accelcal_cli.parquet.source import ParquetSource, read_schema

__all__ = [
    "Axes", "Column", "ColumnValues", "Memory", "Numbers", "ParquetSink", "ParquetSource", "read_schema",
    "row_group_offsets",
]  # fmt: skip
