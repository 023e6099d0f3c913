"""Arrow columns as numpy arrays. Arrow's own ways load pandas, which takes a third of a second."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray


def filled(column: Any, kind: type[np.generic], null: float) -> NDArray[Any]:
    """A chunked column of numbers of eight bytes, (n,), with `null` where a cell is empty."""
    parts = [_filled(chunk, kind, null) for chunk in column.chunks if len(chunk)]
    if len(parts) == 1:
        return parts[0]
    return np.concatenate(parts) if parts else np.empty(0, kind)


def _filled(chunk: Any, kind: type[np.generic], null: float) -> NDArray[Any]:
    held = np.frombuffer(chunk.buffers()[1], kind, len(chunk), 8 * chunk.offset)
    if not chunk.null_count:
        return held
    empty = np.from_dlpack(chunk.is_null().cast(pa.uint8())) > 0
    return np.where(empty, np.asarray(null, kind), held)


def floats(column: Any) -> NDArray[np.float64]:
    """A chunked column of doubles, nulls as NaN, (n,)."""
    return filled(column, np.float64, np.nan)
