"""A column as Parquet's dictionary pages, made from whole numbers that its values follow from.

Many columns hold few values: an axis that depends on one raw count, a temperature, a flag. pyarrow finds
them by hashing every row, and packs their places in the dictionary into as few bits as they need, across the
limits of bytes, so that the codec finds nothing in them. Here the numbers, less the smallest, are the
places, one or two bytes each: that needs no search, and packs better than the values' own bytes.

Source: parquet-format, Encodings.md (RLE_DICTIONARY: the width in bits, then runs; any width that holds the
places is allowed) and parquet.thrift (PageHeader, ColumnMetaData).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core import thrift
from accelcal_cli.output.column_chunks import (
    DATA_PAGE,
    DICTIONARY_PAGE,
    FLOAT,
    INT32,
    PLAIN,
    RLE_DICTIONARY,
    ColumnChunk,
    chunk_of,
    pages_of,
)

MOST_VALUES = 1 << 16
"""Of a dictionary: places take two bytes."""

MOST_UNUSED = 1 << 11
"""A dictionary of so many numbers may hold some that no row has; in a longer one they are left out."""

MOST_SPAN = 1 << 20
"""From the smallest number to the largest; those between are looked at one by one."""

LEAST_RUN = 8
"""Rows, in the mean, that numbers stay the same for, so that runs are looked at instead of rows."""

PHYSICAL = {"float32": (FLOAT, "<f4"), "uint8": (INT32, "<i4")}
"""Parquet's type of the values of a type of numpy, and how PLAIN stores them."""


@dataclass(frozen=True, slots=True)
class Places:
    """Where the rows of a column find their numbers.

    Attributes:
        present: whole numbers that rows may have, and no others; two arrays where a row has a pair of them.
        of_rows: the place of each row's among them, in one or two bytes.
    """

    present: tuple[NDArray[Any], ...]
    of_rows: NDArray[Any]


def places(numbers: NDArray[Any]) -> Places | None:
    """The places of (n,) whole numbers, of integers or floats; None if there are too many, or no rows."""
    if not len(numbers):
        return None
    starts = np.flatnonzero(numbers[1:] != numbers[:-1]) + 1
    if len(starts) * LEAST_RUN < len(numbers):
        return _of_runs(numbers, np.concatenate([[0], starts, [len(numbers)]]))
    low, high = numbers.min(), numbers.max()
    span = float(high) - float(low) + 1
    if not span <= MOST_SPAN:
        return None
    if span <= MOST_UNUSED:
        return Places(
            (_up_from(low, int(span)),), _above(low, numbers, np.uint8 if span <= 256 else np.uint16)
        )
    return _without_unused(low, _above(low, numbers, np.intp), int(span))


def _of_runs(numbers: NDArray[Any], edges: NDArray[Any]) -> Places | None:
    """Of numbers that stay the same from edge to edge."""
    present, at = np.unique(numbers[edges[:-1]], return_inverse=True)
    if len(present) > MOST_VALUES:
        return None
    return Places((present,), np.repeat(_narrow(at, len(present)), np.diff(edges)))


def _without_unused(low: Any, above: NDArray[np.intp], span: int) -> Places | None:
    """Of numbers that lie so far above the lowest."""
    has = np.zeros(span, bool)
    has[above] = True
    present = np.flatnonzero(has)
    if len(present) > MOST_VALUES:
        return None
    rank = np.zeros(span, np.uint16)
    rank[present] = np.arange(len(present))
    return Places((low + present.astype(low.dtype),), _narrow(rank, len(present))[above])


def _narrow(of_rows: NDArray[Any], number: int) -> NDArray[Any]:
    return of_rows.astype(np.uint8 if number <= 256 else np.uint16)


def paired(numbers: NDArray[Any], slow: Places) -> Places | None:
    """The places of pairs: each row's number, and the one that it has in another column, of few.

    None if there would be too many.
    """
    low, high = numbers.min(), numbers.max()
    (others,) = slow.present
    span = float(high) - float(low) + 1
    if not span * len(others) <= MOST_SPAN:
        return None
    width = int(span)
    if width * len(others) < MOST_VALUES:
        of_rows = _above(low, numbers, np.uint16)
        of_rows += np.multiply(slow.of_rows, width, dtype=np.uint16)
        return Places((np.tile(_up_from(low, width), len(others)), np.repeat(others, width)), of_rows)
    above = _above(low, numbers, np.intp)
    above += np.multiply(slow.of_rows, width, dtype=np.intp)
    found = _without_unused(np.intp(0), above, width * len(others))
    if found is None:
        return None
    row, column = np.divmod(found.present[0], width)
    return Places((low + column.astype(low.dtype), others[row]), found.of_rows)


def _above(low: Any, numbers: NDArray[Any], kind: type) -> NDArray[Any]:
    """How far numbers lie above the lowest, without a copy of them all in their own type."""
    above: NDArray[Any] = np.empty(len(numbers), kind)
    np.subtract(numbers, low, out=above, casting="unsafe")
    return above


def _up_from(low: Any, number: int) -> NDArray[Any]:
    return np.asarray(low + np.arange(number, dtype=low.dtype))


def dictionary_chunk(name: str, of_rows: NDArray[Any], kept: NDArray[Any], level: int) -> ColumnChunk:
    """A column without missing values, packed with zstd.

    Args:
        of_rows: (n,) the place of each row's value, of one or two bytes.
        kept: the values, in single precision, or as bytes.
        level: of zstd.
    """
    physical, stored = PHYSICAL[kept.dtype.name]
    values = kept.astype(stored).tobytes(), len(kept)
    first = pages_of(DICTIONARY_PAGE, PLAIN, [values], level)
    second = pages_of(DATA_PAGE, RLE_DICTIONARY, [(_bit_packed(of_rows), len(of_rows))], level)
    return chunk_of(name, physical, first + second, len(of_rows))


def _bit_packed(of_rows: NDArray[Any]) -> NDArray[np.uint8]:
    """The width of a place in bits, and all of them in one run; a run has a multiple of 8."""
    groups = -(-len(of_rows) // 8)
    width = of_rows.itemsize
    head = bytes([8 * width]) + thrift.varint(groups << 1 | 1)
    page = np.zeros(len(head) + 8 * groups * width, np.uint8)
    page[: len(head)] = list(head)
    rows = page[len(head) : len(head) + len(of_rows) * width]
    rows[:] = of_rows.astype(of_rows.dtype.newbyteorder("<"), copy=False).view(np.uint8)
    return page
