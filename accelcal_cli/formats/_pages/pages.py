"""Fixed-size pages of a file, a block at a time: the valid ones as columns, the others as runs.

Unusable rows are taken out of chunks here, and a value of a channel that was not measured, such as a
temperature, repeats the last one.
"""

from __future__ import annotations

import zlib
from collections.abc import Generator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Protocol

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
from accelcal_cli.formats._bytes import ByteSource

SKIP_BYTES = 1 << 20

BLOCK_BYTES = 1 << 24
"""At most so much of a file is taken at once, or one page: frames may be much longer than their samples."""

CRC16_POLYNOMIAL = 0x1021
CRC16_START = 0xFFFF

GOOD, ERASED, CHECKSUM, NONSENSE, FOREIGN, RATE, REPEATED, TEXT, LENGTH, DIGITS, NO_PAGE = range(11)
BAD_KINDS = {
    ERASED: ("bad_page", "erased pages between pages with data, left out"),
    CHECKSUM: ("checksum", "pages with a wrong checksum, left out"),
    NONSENSE: ("bad_page", "pages without sensible content, left out"),
    FOREIGN: ("bad_page", "pages of another recording, left out"),
    RATE: ("rate_change", "pages recorded at another rate than the others, left out"),
    REPEATED: ("repeated_page", "pages that the file holds a second time, left out"),
    TEXT: ("bad_page", "pages whose own text is damaged, left out"),
    LENGTH: ("bad_page", "pages with too few or too many digits, left out"),
    DIGITS: ("bad_page", "pages with characters that are no digits among the samples, left out"),
    NO_PAGE: ("bad_page", "stretches of the file that are no page, left out"),
}

DAMAGED = (ERASED, CHECKSUM, NONSENSE, TEXT, LENGTH, DIGITS, NO_PAGE)
"""Kinds whose bytes are lost; a page of another recording or rate is sound, and so is a repeated one."""

PER_PAGE = ("position", "rows", "sequence", "time_us", "fresh")
PER_ROW = ("counts", "faulty")


@dataclass(frozen=True, slots=True)
class RawBlock:
    """Consecutive pages as they lie in the file.

    Attributes:
        first_position: number of the first page.
        pages: (p, page_bytes).
        end_byte: how far into the file on disk the block reaches, for progress.
        tail: bytes of an incomplete page after these, only in the last block.
        broken: the stream broke off (damaged gzip) rather than ended; only in the last block.
        last: nothing follows.
        undecoded: bytes on the disk that could not be unpacked after it broke off; only in the last block.
    """

    first_position: int
    pages: NDArray[np.uint8]
    end_byte: int
    tail: bytes
    broken: bool
    last: bool
    undecoded: int = 0

    @property
    def next_position(self) -> int:
        """Number of the page after these."""
        return self.first_position + len(self.pages)


class Block(Protocol):
    """What is asked of consecutive pages after they are decoded; the attributes are as in RawBlock."""

    @property
    def next_position(self) -> int:
        """Number of the page after these."""

    @property
    def end_byte(self) -> int: ...
    @property
    def tail(self) -> bytes: ...
    @property
    def broken(self) -> bool: ...
    @property
    def last(self) -> bool: ...
    @property
    def undecoded(self) -> int: ...


class Places(Protocol):
    """Knows where pages lie, and about how long they are."""

    @property
    def page_bytes(self) -> int: ...

    def offset(self, position: int) -> int:
        """Where page `position` begins, bytes from the start of the (uncompressed) file."""

    def length(self, position: int, pages: int) -> int:
        """Bytes of so many pages from `position` on."""


@dataclass(frozen=True, slots=True)
class PagedFile:
    """Where the pages of a file lie.

    Attributes:
        size: bytes on disk.
        compressed: gzip; such a file is only read from its beginning.
        proved: its pages have checksums of their own.
    """

    path: Path
    start_byte: int
    page_bytes: int
    size: int
    compressed: bool
    proved: bool

    @property
    def whole_pages(self) -> int:
        """Number of complete pages of an uncompressed file."""
        return max(0, self.size - self.start_byte) // self.page_bytes

    def offset(self, position: int) -> int:
        """Where page `position` begins, bytes from the start of the (uncompressed) file."""
        return self.start_byte + position * self.page_bytes

    def length(self, position: int, pages: int) -> int:
        """Bytes of so many pages from `position` on."""
        return pages * self.page_bytes

    def fitting(self, pages: int) -> int:
        """How many of so many pages may be read at once."""
        return max(1, min(pages, BLOCK_BYTES // self.page_bytes))

    def blocks(self, pages: int, first_position: int = 0, threads: int = 1) -> Generator[RawBlock]:
        """Yield all pages from `first_position` on, `pages` at a time; the last block may be empty.

        Args:
            threads: how many may work at a time on a gzip file.

        Raises:
            UnreadableError: the disk fails, or the file is shorter than its header.
        """
        with ByteSource(self.path, threads) as stream:
            self._enter(stream, first_position)
            last = False
            while not last:
                data = stream.read_exact(pages * self.page_bytes)
                last = len(data) < pages * self.page_bytes
                if not self.proved:
                    stream.refuse_damaged()
                whole = len(data) // self.page_bytes
                cut = whole * self.page_bytes
                table = np.frombuffer(data, np.uint8, cut).reshape(whole, self.page_bytes)
                yield RawBlock(
                    first_position,
                    table,
                    stream.disk_position(),
                    data[cut:],
                    stream.broken,
                    last,
                    stream.undecoded(),
                )
                first_position += whole

    def _enter(self, stream: ByteSource, position: int) -> None:
        if not self.compressed:
            stream.seek(self.offset(position))
            return
        left = self.offset(position)
        while left:
            data = stream.read_exact(min(left, SKIP_BYTES))
            if not data:
                return
            left -= len(data)

    def data_pages(self) -> int:
        """Whole pages before the erased ones at the end, found by bisection (uncompressed files)."""
        low, high = 0, self.whole_pages
        with ByteSource(self.path) as stream:
            while low < high:
                middle = (low + high) // 2
                stream.seek(self.offset(middle))
                page = stream.read_exact(self.page_bytes)
                low, high = (low, middle) if is_erased(page) else (middle + 1, high)
        return low


class PageCutter:
    """Cuts the bytes of a growing file into whole pages."""

    def __init__(self, file: PagedFile) -> None:
        self._page_bytes, self._skip = file.page_bytes, file.start_byte
        self._rest = b""
        self._position = self._taken = 0

    def cut(self, data: bytes, *, last: bool) -> RawBlock:
        """The whole pages that end in the next bytes; there may be none."""
        self._taken += len(data)
        skipped = min(self._skip, len(data))
        self._skip -= skipped
        data = self._rest + data[skipped:]
        whole = len(data) // self._page_bytes
        cut, position = whole * self._page_bytes, self._position
        table = np.frombuffer(data, np.uint8, cut).reshape(whole, self._page_bytes)
        self._rest, self._position = data[cut:], position + whole
        return RawBlock(position, table, self._taken, self._rest if last else b"", False, last)


def paged_file(path: Path, start_byte: int, page_bytes: int, *, proved: bool = True) -> PagedFile:
    """Look at a file's size and compression.

    Raises:
        UnreadableError: it cannot be read.
    """
    with ByteSource(path) as source:
        return PagedFile(path, start_byte, page_bytes, source.file_bytes, source.compressed, proved)


def is_erased(data: bytes) -> bool:
    """Whether all bytes are 0xFF, as in flash memory that was never written."""
    return not data.strip(b"\xff")


def erased_pages(pages: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Which pages hold nothing but 0xFF, shape (p,)."""
    erased: NDArray[np.bool_] = (pages[:, 0] == 0xFF) & (pages[:, -1] == 0xFF)
    candidates = np.flatnonzero(erased)
    erased[candidates] = (pages[candidates] == 0xFF).all(axis=1)
    return erased


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


@dataclass(frozen=True, slots=True, eq=False)
class Decoded:
    """A block of the file after decoding: its valid pages and the others.

    Attributes:
        leftover: bytes at the end that fill no page or frame.
        unused_end: the frames before these were never written.
    """

    block: PageBlock
    bad: list[BadRun]
    leftover: bytes
    unused_end: bool = False


def joined(first: PageBlock, second: PageBlock) -> PageBlock:
    """The pages of both, in order."""
    if not len(first) or not len(second):
        return second if len(second) else first
    channels = joined_channels((first.channels, second.channels))
    return PageBlock(**joined_columns((first, second), PER_PAGE + PER_ROW), channels=channels)


def chosen(block: PageBlock, pages: slice | NDArray[np.bool_], rows: slice | NDArray[np.bool_]) -> PageBlock:
    """Some pages, and the rows that they hold."""
    columns = cut_columns(block, PER_PAGE, pages) | cut_columns(block, PER_ROW, rows)
    return PageBlock(**columns, channels=cut_channels(block.channels, rows))


def split(block: PageBlock, pages: int) -> tuple[PageBlock, PageBlock]:
    """The first `pages` pages, and the rest."""
    row = int(block.rows[:pages].sum())
    above = chosen(block, slice(None, pages), slice(None, row))
    return above, chosen(block, slice(pages, None), slice(row, None))


def bad_runs(status: NDArray[np.uint8], first_position: int) -> list[BadRun]:
    """Runs of equal pages that are not GOOD.

    Args:
        status: (p,) of GOOD and the keys of BAD_KINDS.
    """
    if (status == GOOD).all():
        return []
    starts = np.flatnonzero(np.diff(status, prepend=status[0] + 1))
    lengths = np.diff(starts, append=len(status))
    return [
        BadRun(first_position + start, length, kind)
        for start, length, kind in zip(
            starts.tolist(), lengths.tolist(), status[starts].tolist(), strict=True
        )
        if kind != GOOD
    ]


def page_rows(block: PageBlock) -> NDArray[np.int64]:
    """Usable rows of each page, (p,)."""
    return block.rows if block.faulty is None else block.rows - per_page(block, block.faulty)


def per_page(block: PageBlock, marks: NDArray[np.bool_] | None) -> NDArray[np.int64]:
    """How many of each page's rows are marked, (p,)."""
    if marks is None or not marks.any():
        return np.zeros(len(block), np.int64)
    starts = np.cumsum(block.rows) - block.rows
    return np.add.reduceat(marks, starts, dtype=np.int64)


def crc32_pages(pages: NDArray[np.uint8], start: int, stop: int) -> NDArray[np.uint32]:
    """Return the CRC-32 (IEEE 802.3, as in zlib) of bytes start..stop-1 of each page.

    Args:
        pages: (p, page_bytes), rows contiguous.

    Returns:
        (p,) checksums.
    """
    if not len(pages):
        return np.empty(0, np.uint32)
    view = np.ascontiguousarray(pages).data.cast("B")
    size = pages.shape[1]
    return np.array(
        [zlib.crc32(view[page + start : page + stop]) for page in range(0, len(view), size)], dtype=np.uint32
    )


def crc16_pages(pages: NDArray[np.uint8], start: int, stop: int) -> NDArray[np.uint16]:
    """Return the CRC-16/CCITT-FALSE (polynomial 0x1021, start 0xFFFF, not reflected) of each page's bytes.

    A CRC is linear over GF(2): the checksum of a page is the XOR of what each byte alone contributes, so one
    table row for each position lets all pages go through together.

    Args:
        pages: (p, page_bytes).

    Returns:
        (p,) checksums.
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
    one = crc16_table()
    table = np.empty((length, 256), np.uint16)
    here = one
    for position in range(length - 1, -1, -1):
        table[position] = here
        here = shift_byte(here)
    state = np.array([CRC16_START], np.uint16)
    for _ in range(length):
        state = shift_byte(state)
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
    table: NDArray[np.uint16] = (state & 0xFFFF).astype(np.uint16)
    return table
