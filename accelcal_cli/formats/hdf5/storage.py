"""How the HDF5 library stores the chunks of a dataset: which of them exist, and how one is kept unpacked."""

from __future__ import annotations

from array import array
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from accelcal_cli.formats.hdf5.file import H5PY_ERRORS

CACHE_SLOTS = 521
SPARE_BYTES = 1 << 20


def stored_chunks(dataset: Any, axis: int, columns: range) -> NDArray[np.int64] | None:
    """Numbers along `axis` of the chunks that were written, ascending; None if the index is damaged.

    All in one pass: asked for one by one, a dataset of 200 000 small chunks takes half a minute.

    Args:
        columns: first columns of the chunks that lie side by side, all of which must be there.
    """
    number, column, flat = array("q"), array("q"), dataset.ndim == 1

    def see(chunk: Any) -> None:
        number.append(chunk.chunk_offset[axis])
        column.append(0 if flat else chunk.chunk_offset[1 - axis])

    try:
        dataset.id.chunk_iter(see)
    except H5PY_ERRORS:
        return None
    rows, first = np.frombuffer(number, np.int64), np.frombuffer(column, np.int64)
    found, times = np.unique(rows[first < columns.stop], return_counts=True)
    return np.asarray(found[times == len(columns)] // dataset.chunks[axis])


def keeping_chunks(file: Any, path: str, size: int) -> Any:
    """A dataset, opened so that chunks of so many bytes stay unpacked until others take their place.

    Rows can then be read a few at a time, without unpacking their chunk for each of them, or holding all of
    it a second time. Where the dataset is open already, it stays as it was opened.
    """
    access = h5py.h5p.create(h5py.h5p.DATASET_ACCESS)
    access.set_chunk_cache(CACHE_SLOTS, size + SPARE_BYTES, 1.0)
    return h5py.Dataset(h5py.h5d.open(file.id, path.encode(), access))
