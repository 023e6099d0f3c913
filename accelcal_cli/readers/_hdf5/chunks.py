"""Gzip-packed HDF5 chunks, taken as they are stored and unpacked beside other threads' work.

h5py lets nothing else run while it unpacks; zlib and numpy do. Whatever is not plain here (a chunk that
is missing, damaged or packed in another way than its dataset says) is left to h5py.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from accelcal_cli.readers._hdf5.file import H5PY_ERRORS

STORED_ROWS, STORED_BYTES = 1 << 20, 6 << 20
"""At most so much is unpacked together, about what is asked for; one chunk if that has more rows."""
LEAST_BYTES, MOST_BYTES = 1 << 14, 1 << 22
"""Of smaller chunks h5py unpacks many in the time that one takes here; of larger ones few fit in memory."""


def unpackers(threads: int) -> AbstractContextManager[Executor | None]:
    """A pool that unpacks ahead; none where only one thread may work."""
    return nullcontext() if threads < 2 else ThreadPoolExecutor(threads, thread_name_prefix="hdf5")


def gzip_shuffled(dataset: Any, axis: int, width: int) -> bool | None:
    """Of chunks that are nothing but gzip of all `width` columns of some rows: are their bytes shuffled?

    None for any other dataset, and for numbers that are not stored as numpy knows them.
    """
    try:
        settings = dataset.id.get_create_plist()
        filters = [settings.get_filter(index) for index in range(settings.get_nfilters())]
        plain = dataset.id.get_type().equal(h5py.h5t.py_create(dataset.dtype))
        whole = dataset.ndim == 1 or dataset.chunks[1 - axis] == width
    except H5PY_ERRORS:
        return None
    kinds = [item[0] for item in filters]
    shuffled = kinds == [h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_DEFLATE]
    if shuffled and filters[0][2] != (dataset.dtype.itemsize,):
        return None
    known = shuffled or kinds == [h5py.h5z.FILTER_DEFLATE]
    return shuffled if known and plain and whole else None


class StoredChunks:
    """Rows of a dataset, along its axis `axis`, whose chunks `gzip_shuffled` knows.

    Args:
        pool: unpacks several chunks at a time, and those that come next; None: one by one.
    """

    def __init__(self, dataset: Any, axis: int, width: int, shuffled: bool, pool: Executor | None) -> None:
        self._id = dataset.id
        self._dtype = dataset.dtype
        self._ndim = dataset.ndim
        self._axis = axis
        self._width = width
        self._rows = int(dataset.chunks[axis])
        self._bytes = self._rows * width * self._dtype.itemsize
        self._bytes_apart = self._dtype.itemsize if shuffled else 1
        self._pool = pool
        self._begun: tuple[range, NDArray[Any], Iterator[bool]] | None = None

    def begin(self, start: int, stop: int) -> None:
        """Have the pool unpack rows that will be read next."""
        if self._pool is not None:
            self._begun = self._unpacking(range(start, stop))

    def read(self, rows: range) -> NDArray[Any] | None:
        """Rows (n, width), from the first one of a chunk; None where h5py has to read them.

        Raises:
            OSError: a chunk holds too little; h5py would make it up from what lies in memory.
        """
        begun, self._begun = self._begun, None
        _, values, done = begun if begun is not None and begun[0] == rows else self._unpacking(rows)
        return values if all(list(done)) else None

    def _unpacking(self, rows: range) -> tuple[range, NDArray[Any], Iterator[bool]]:
        """The rows' values, and what makes each chunk of them true when it is asked for."""
        values = np.empty((len(rows), self._width), self._dtype)
        places = range(0, len(rows), self._rows)
        parts = [values[place : place + self._rows] for place in places]
        each = map if self._pool is None else self._pool.map
        return rows, values, each(self._unpack, rows[:: self._rows], parts)

    def _unpack(self, row: int, into: NDArray[Any]) -> bool:
        """Put the chunk that begins with a row in its place, without what lies beyond the dataset's end."""
        raw = self._raw(row)
        if raw is None or len(raw) > self._bytes:
            return False
        if len(raw) < self._bytes:
            raise OSError("a chunk holds too little")
        values = together(raw, self._bytes_apart).view(self._dtype)
        rows = values.reshape(self._width, -1).T if self._axis else values.reshape(-1, self._width)
        into[:] = rows[: len(into)]
        return True

    def _raw(self, row: int) -> bytes | None:
        """A chunk by its first row, unpacked; None where it is absent, damaged or packed otherwise."""
        place = [0] * self._ndim
        place[self._axis] = row
        try:
            filters_left_out, packed = self._id.read_direct_chunk(tuple(place))
            return None if filters_left_out else zlib.decompress(packed, bufsize=self._bytes)
        except (zlib.error, *H5PY_ERRORS):
            return None


def together(raw: bytes, size: int) -> NDArray[Any]:
    """Undo the shuffle filter: all first bytes of numbers of `size`, then all second ones, ...

    Neighbours are put together two by two, so that each step works on whole numbers.
    """
    parts: NDArray[Any] = np.frombuffer(raw, np.uint8).reshape(size, -1)
    while len(parts) > 1:
        wide = parts[1::2].astype(f"<u{2 * parts.itemsize}")
        wide <<= 8 * parts.itemsize
        wide |= parts[::2]
        parts = wide
    return parts.reshape(-1)
