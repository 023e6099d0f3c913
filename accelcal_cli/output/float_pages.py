"""A column of single precision as Parquet's pages, its values as they are or their bytes side by side.

pyarrow would write the same pages, but copies them several times over on the way.

Source: parquet-format, Encodings.md (PLAIN, BYTE_STREAM_SPLIT).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.output.column_chunks import (
    BYTE_STREAM_SPLIT,
    DATA_PAGE,
    FLOAT,
    PLAIN,
    ColumnChunk,
    chunk_of,
    pages_of,
)

PAGE_ROWS = 1 << 16
"""256 kB, up to which zstd looks for shorter repetitions (zstd, clevels.h)."""

SAMPLED, MOST_DIFFERENT = 64, 0.7
"""Of how many rows one is looked at, and the share of different values up to which they repeat."""

SPLIT_LEVEL = -1
"""Of zstd, for bytes side by side: it gives up sooner on those that do not compress."""


def float_chunk(name: str, values: NDArray[np.float32], level: int) -> ColumnChunk:
    """A column of (n,) values, of which none is missing, packed with zstd.

    Args:
        level: of zstd, for values that repeat.
    """
    repeats = _repeats(values)
    encoding = PLAIN if repeats else BYTE_STREAM_SPLIT
    parts = [values[start : start + PAGE_ROWS] for start in range(0, max(1, len(values)), PAGE_ROWS)]
    data = [(part.view(np.uint8) if repeats else _split(part), len(part)) for part in parts]
    pages = pages_of(DATA_PAGE, encoding, data, level if repeats else SPLIT_LEVEL)
    return chunk_of(name, FLOAT, pages, len(values))


def _repeats(values: NDArray[np.float32]) -> bool:
    """Whether values repeat, which the codec finds; else only their high bytes are alike, and compress better
    side by side.
    """
    sample = np.sort(values.view(np.uint32)[::SAMPLED])  # several times faster than np.unique
    different = 1 + np.count_nonzero(sample[1:] != sample[:-1])
    return bool(different <= MOST_DIFFERENT * len(sample))


def _split(values: NDArray[np.float32]) -> NDArray[np.uint8]:
    """The first bytes of all values, then the second ones, and so on."""
    bits, split = values.view(np.uint32), np.empty((4, len(values)), np.uint8)
    for place, row in enumerate(split):
        np.right_shift(bits, 8 * place, out=row, casting="unsafe")
    return split.reshape(-1)
