"""How the HDF5 library stores the chunks of a dataset: which of them exist, and how one is kept unpacked."""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from functools import lru_cache
from math import prod
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from accelcal_cli.formats.hdf5.file import H5PY_ERRORS

CACHE_SLOTS = 521
SPARE_BYTES = 1 << 20
KNOWN_SIZES = 4096
CHECKSUM_BYTES = 4
SAME_SIZE = {h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}
"""Filters that leave the bytes of a chunk as many as they are, but for a checksum behind them."""


@dataclass(frozen=True, slots=True, eq=False)
class Stored:
    """Numbers of chunks along the rows, ascending.

    Attributes:
        written: those of which all columns were written.
        impossible: those of which a column's size is one that its filters cannot have left.
    """

    written: NDArray[np.int64]
    impossible: NDArray[np.int64]


class ChunkSizes:
    """Which sizes the chunks of a dataset can have in the file.

    The HDF5 library (1.14 and 2.0) believes the sizes in the index of chunks. One too short for its checksum
    ends the process; one that no filter made shorter is filled up with what lies in memory.
    """

    def __init__(self, dataset: Any) -> None:
        settings = dataset.id.get_create_plist()
        self._filters = [settings.get_filter(index)[0] for index in range(settings.get_nfilters())]
        self._whole = prod(dataset.chunks) * int(dataset.id.get_type().get_size())

    def possible(self, size: int, left_out: int) -> bool:
        """Whether a chunk can take so many bytes; `left_out` has a bit for each filter that was not used."""
        used = {kind for index, kind in enumerate(self._filters) if not left_out >> index & 1}
        checksum = CHECKSUM_BYTES if h5py.h5z.FILTER_FLETCHER32 in used else 0
        if used - SAME_SIZE:
            return size > checksum
        return size in (self._whole, self._whole + checksum)


def stored_chunks(dataset: Any, axis: int, columns: range) -> Stored | None:
    """What the index of chunks says; None if it is damaged.

    All in one pass: asked for one by one, a dataset of 200 000 small chunks takes half a minute.

    Args:
        columns: first columns of the chunks that lie side by side, all of which must be there.
    """
    number, column, flat = array("q"), array("q"), dataset.ndim == 1
    impossible, possible = set(), lru_cache(KNOWN_SIZES)(ChunkSizes(dataset).possible)

    def see(chunk: Any) -> None:
        number.append(chunk.chunk_offset[axis])
        column.append(0 if flat else chunk.chunk_offset[1 - axis])
        if not possible(chunk.size, chunk.filter_mask):
            impossible.add(number[-1])

    try:
        dataset.id.chunk_iter(see)
    except H5PY_ERRORS:
        return None
    rows, first = np.frombuffer(number, np.int64), np.frombuffer(column, np.int64)
    found, times = np.unique(rows[first < columns.stop], return_counts=True)
    length = dataset.chunks[axis]
    odd = np.array(sorted(impossible), np.int64)
    return Stored(found[times == len(columns)] // length, odd // length)


def refuse_impossible(dataset: Any, axis: int, columns: range, rows: range, stored: Stored | None) -> None:
    """Raise OSError where the library cannot be trusted with the chunks of some rows, as h5py does elsewhere.

    Args:
        stored: what the index says of all chunks; None: each is asked for.
    """
    length = dataset.chunks[axis]
    chunks = range(rows.start // length, -(-rows.stop // length))
    if stored is not None:
        first, last = np.searchsorted(stored.impossible, (chunks.start, chunks.stop))
        sound = first == last
    else:
        sizes = ChunkSizes(dataset)
        found = (chunk_info(dataset, axis, chunk * length, column) for chunk in chunks for column in columns)
        sound = all(i.byte_offset is None or sizes.possible(i.size, i.filter_mask) for i in found)
    if not sound:
        raise OSError("a chunk has a size that its filters cannot have left")


def chunk_info(dataset: Any, axis: int, row: int, column: int) -> Any:
    """What the index says of the chunk that begins at a row and column. Raises as h5py does."""
    place = [column] * dataset.ndim
    place[axis] = row
    return dataset.id.get_chunk_info_by_coord(tuple(place))


def keeping_chunks(file: Any, path: str, size: int) -> Any:
    """A dataset, opened so that chunks of so many bytes stay unpacked until others take their place.

    Rows can then be read a few at a time, without unpacking their chunk for each of them, or holding all of
    it a second time. Where the dataset is open already, it stays as it was opened.
    """
    access = h5py.h5p.create(h5py.h5p.DATASET_ACCESS)
    access.set_chunk_cache(CACHE_SLOTS, size + SPARE_BYTES, 1.0)
    return h5py.Dataset(h5py.h5d.open(file.id, path.encode(), access))
