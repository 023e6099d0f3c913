"""Holds decoded pages, the valid ones as columns, the others as runs; checks many pages at once."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.recording import (
    Channels,
    Counts,
    cut_channels,
    cut_columns,
    joined_channels,
    joined_columns,
)

CRC16_POLYNOMIAL = 0x1021
CRC16_START = 0xFFFF

GOOD, ERASED, CHECKSUM, NONSENSE, FOREIGN, RATE, REPEATED, TEXT, LENGTH, DIGITS, NO_PAGE = range(11)
"""Kinds of pages; all but GOOD are unusable."""

BAD_KINDS = {
    ERASED: ("bad_page", "erased pages between pages with data, left out"),
    CHECKSUM: ("checksum", "pages with a wrong checksum, left out"),
    NONSENSE: ("bad_page", "pages without sensible content, left out"),
    FOREIGN: ("bad_page", "pages of another recording, left out"),
    RATE: ("rate_change", "pages recorded at another rate than the others, left out"),
    REPEATED: ("repeated_page", "pages that the file holds a second time, left out"),
    TEXT: ("bad_page", "pages whose own text is damaged, left out"),
    LENGTH: ("bad_page", "pages with too few or too many digits, left out"),
    DIGITS: ("bad_page", "pages with characters that are not digits among the samples, left out"),
    NO_PAGE: ("bad_page", "stretches of the file that are not pages, left out"),
}
"""Code and text of the problem for each kind of unusable page."""

DAMAGED = (ERASED, CHECKSUM, NONSENSE, TEXT, LENGTH, DIGITS, NO_PAGE)
"""Kinds whose bytes are lost; pages of another recording or rate and repeated pages are sound."""

PER_PAGE = ("position", "rows", "sequence", "time_us", "fresh")
PER_ROW = ("counts", "faulty")


@dataclass(frozen=True, slots=True)
class BadRun:
    """`pages` unusable pages in a row from `position` on; `kind` is a key of BAD_KINDS."""

    position: int
    pages: int
    kind: int


@dataclass(frozen=True, slots=True, eq=False)
class PageBlock:
    """Valid pages in file order: p pages with n samples in all.

    Attributes:
        position: (p,) int64, page number within the file.
        rows: (p,) int64, samples in each, at least 1.
        counts: (n, 3).
        sequence: (p,) int64, or None if pages carry none.
        time_us: (p,) int64 stamp of the first sample [us since 1970], or None.
        fresh: (p,) bool, the page itself says that it does not continue the one before; or None.
        faulty: (n,) bool, rows whose values are unusable, or None if every row is good.
        channels: of n rows each; one of single values may hold MISSING.
    """

    position: NDArray[np.int64]
    rows: NDArray[np.int64]
    counts: Counts
    sequence: NDArray[np.int64] | None = None
    time_us: NDArray[np.int64] | None = None
    fresh: NDArray[np.bool_] | None = None
    faulty: NDArray[np.bool_] | None = None
    channels: Channels = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.position)

    @property
    def usable_rows(self) -> NDArray[np.int64]:
        """Rows of each page that are not faulty, (p,)."""
        return self.rows if self.faulty is None else self.rows - self.count_per_page(self.faulty)

    def count_per_page(self, marks: NDArray[np.bool_] | None) -> NDArray[np.int64]:
        """Return the number of marked rows of each page, (p,)."""
        if marks is None or not marks.any():
            return np.zeros(len(self), np.int64)
        return np.add.reduceat(marks, np.cumsum(self.rows) - self.rows, dtype=np.int64)

    def followed_by(self, second: PageBlock) -> PageBlock:
        """Return the pages of both blocks, in order."""
        if not len(self) or not len(second):
            return second if len(second) else self
        channels = joined_channels((self.channels, second.channels))
        return PageBlock(**joined_columns((self, second), PER_PAGE + PER_ROW), channels=channels)

    def chosen(self, pages: slice | NDArray[np.bool_], rows: slice | NDArray[np.bool_]) -> PageBlock:
        """Return some pages and the rows that they hold."""
        columns = cut_columns(self, PER_PAGE, pages) | cut_columns(self, PER_ROW, rows)
        return PageBlock(**columns, channels=cut_channels(self.channels, rows))

    def split(self, pages: int) -> tuple[PageBlock, PageBlock]:
        """Return the first `pages` pages, and the rest."""
        row = int(self.rows[:pages].sum())
        above = self.chosen(slice(None, pages), slice(None, row))
        return above, self.chosen(slice(pages, None), slice(row, None))


@dataclass(frozen=True, slots=True, eq=False)
class Decoded:
    """A block of the file after decoding: its valid pages and the others.

    Bytes may be left over at the end, perhaps after frames that were never written; None if the decoder
    itself reports what is missing there.
    """

    block: PageBlock
    bad: list[BadRun]
    leftover: bytes | None = None
    unused_end: bool = False


def bad_runs(status: NDArray[np.uint8], first_position: int) -> list[BadRun]:
    """Return the runs of equal pages that are not GOOD, by the status of each, (p,)."""
    if (status == GOOD).all():
        return []
    starts = np.flatnonzero(np.diff(status, prepend=status[0] + 1))
    lengths = np.diff(starts, append=len(status))
    runs = zip(starts.tolist(), lengths.tolist(), status[starts].tolist(), strict=True)
    return [BadRun(first_position + start, length, kind) for start, length, kind in runs if kind != GOOD]


def erased_pages(pages: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Mark the pages (p, page_bytes) that hold nothing but 0xFF, (p,)."""
    erased: NDArray[np.bool_] = (pages[:, 0] == 0xFF) & (pages[:, -1] == 0xFF)
    candidates = np.flatnonzero(erased)
    erased[candidates] = (pages[candidates] == 0xFF).all(axis=1)
    return erased


def crc32_pages(pages: NDArray[np.uint8], start: int, stop: int) -> NDArray[np.uint32]:
    """Return the CRC-32 (IEEE 802.3, as in zlib) of bytes start..stop-1 of pages (p, page_bytes), (p,)."""
    if not len(pages):
        return np.empty(0, np.uint32)
    view = np.ascontiguousarray(pages).data.cast("B")
    begins = range(0, len(view), pages.shape[1])
    return np.array([zlib.crc32(view[page + start : page + stop]) for page in begins], dtype=np.uint32)


def crc16_pages(pages: NDArray[np.uint8], start: int, stop: int) -> NDArray[np.uint16]:
    """Return the CRC-16/CCITT-FALSE (polynomial 0x1021, start 0xFFFF, not reflected) of pages' bytes, (p,).

    A CRC is linear over GF(2): the checksum of a page is the XOR of what each byte alone contributes, so one
    table row for each position lets all pages go through together.
    """
    table, start_part = crc16_positions(stop - start)
    total = np.full(len(pages), start_part, np.uint16)
    columns = np.ascontiguousarray(pages[:, start:stop].T)
    for row, column in zip(table, columns, strict=True):
        total ^= row[column]
    return total


@cache
def crc16_positions(length: int) -> tuple[NDArray[np.uint16], int]:
    """Return what byte value v at position i of `length` adds, table[i, v], and what the start value adds."""
    table, here = np.empty((length, 256), np.uint16), crc16_table()
    state = np.array([CRC16_START], np.uint16)
    for position in range(length - 1, -1, -1):
        table[position] = here
        here, state = shift_byte(here), shift_byte(state)
    return table, int(state[0])


def shift_byte(state: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Return checksum states after one more zero byte."""
    return np.asarray((state << np.uint16(8)) ^ crc16_table()[state >> np.uint16(8)])


@cache
def crc16_table() -> NDArray[np.uint16]:
    """Return the checksum of each byte value alone, from state 0."""
    state = np.arange(256, dtype=np.uint32) << 8
    for _ in range(8):
        state = (state << 1) ^ np.where(state & 0x8000, CRC16_POLYNOMIAL, 0).astype(np.uint32)
    return np.asarray((state & 0xFFFF).astype(np.uint16))
