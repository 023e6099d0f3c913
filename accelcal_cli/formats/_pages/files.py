"""Finds the pages of a file, and takes its bytes as blocks of pages.

A scanner finds the pages in the bytes as they come: pages of one length by counting (`PagedFile`), pages that
differ in length as their format says. Both can be read in blocks, and cut from a file that grows.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Generic, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.formats._bytes import ByteSource

BLOCK_BYTES = 1 << 24
"""Most bytes of a file in one block, unless a page is longer; frames may be far longer than their samples."""


@dataclass(slots=True, kw_only=True)
class Block:
    """Consecutive pages of a file; offsets are those in the (uncompressed) file.

    Attributes:
        first_position: number of the first page within the file.
        end: offset of the first byte after the bytes that were searched.
        end_byte: how far into the file on disk the block reaches, for progress.
        last: nothing follows.
        broken: the compressed data broke off rather than ended; only in the last block.
        undecoded: bytes on the disk that could not be unpacked after it broke off; only in the last block.
    """

    first_position: int = 0
    end: int = 0
    end_byte: int = 0
    last: bool = False
    broken: bool = False
    undecoded: int = 0

    def __len__(self) -> int:
        raise NotImplementedError

    @property
    def next_position(self) -> int:
        """Number of the page after these."""
        return self.first_position + len(self)

    def offset(self, position: int) -> int:
        """Return where a page begins."""
        raise NotImplementedError

    def length(self, position: int, pages: int) -> int:
        """Return the bytes of `pages` pages from `position` on."""
        raise NotImplementedError

    def alone(self, end: int) -> Self:
        """Make this block, which reaches to byte `end`, a recording of its own."""
        self.end = self.end_byte = end
        self.last = True
        return self


AnyBlock = TypeVar("AnyBlock", bound=Block)
AnyBlock_co = TypeVar("AnyBlock_co", bound=Block, covariant=True)


class Scanner(Protocol[AnyBlock_co]):
    """Finds the pages in consecutive bytes of a file, which come in stretches of any length."""

    def feed(self, data: bytes, *, last: bool) -> AnyBlock_co:
        """Return the pages, if any, that can be seen whole with the next bytes, perhaps the last."""


class Cutter(Generic[AnyBlock]):
    """Cuts the bytes from the page at `start_byte` on, which come piece by piece, into blocks."""

    def __init__(self, scanner: Scanner[AnyBlock], start_byte: int, position: int = 0) -> None:
        self._scanner, self._end, self._position = scanner, start_byte, position

    def cut(self, data: bytes, end_byte: int, *, last: bool) -> AnyBlock:
        """Return the pages that end in the next bytes, which reach to `end_byte` of the file on disk."""
        block = self._scanner.feed(data, last=last)
        self._end += len(data)
        block.first_position, block.end, block.end_byte = self._position, self._end, end_byte
        block.last, self._position = last, self._position + len(block)
        return block


@dataclass(frozen=True, slots=True)
class PageFile(Generic[AnyBlock]):
    """A file of pages; if they differ in length, only its format knows where it can be entered.

    Attributes:
        start_byte: where the first page, or the search for it, begins.
        page_bytes: length of a page, or the usual one.
        size: bytes on disk.
        compressed: it is packed; such a file is only read from its beginning.
        scanner: makes a scanner of bytes that begin at a place of the file.
        proved: its pages have checksums of their own.
    """

    path: Path
    start_byte: int
    page_bytes: int
    size: int
    compressed: bool
    scanner: Callable[[int], Scanner[AnyBlock]]
    proved: bool = True

    def amount(self, pages: int) -> int:
        """Return the bytes of about `pages` pages that may be taken at once, at least one."""
        return max(1, min(pages, BLOCK_BYTES // self.page_bytes)) * self.page_bytes

    def blocks(self, amount: int, first_position: int = 0, *, threads: int = 1) -> Generator[AnyBlock]:
        """Yield the pages from a position on, `amount` bytes at a time; the last block may be empty.

        Only pages of one length can be entered after the first one. Raises UnreadableError if the disk fails,
        or a packed file without checksums of its own is damaged inside.
        """
        start = self.start_byte + first_position * self.page_bytes
        cutter, last = Cutter(self.scanner(start), start, first_position), False
        with ByteSource(self.path, threads) as source:
            source.seek(start)
            while not last:
                data = source.read_exact(amount)
                if not self.proved:  # pages without checksums may be wrong anywhere
                    source.refuse_damaged()
                last = len(data) < amount
                block = cutter.cut(data, source.disk_position(), last=last)
                block.broken, block.undecoded = source.broken, source.undecoded()
                yield block

    def pieces(self, amount: int, pieces: int) -> Iterator[AnyBlock]:
        """Yield blocks spread evenly over the file; none if it can only be read from its beginning."""
        return iter(())

    def read(self, offset: int, length: int) -> bytes:
        """Return up to `length` bytes from `offset` on, of an uncompressed file."""
        with ByteSource(self.path) as source:
            source.seek(offset)
            return source.read_exact(length)


@dataclass(slots=True, kw_only=True)
class RawBlock(Block):
    """Consecutive pages (p, page_bytes), from a byte on, and the incomplete page after the last of a file."""

    pages: NDArray[np.uint8]
    start_byte: int
    tail: bytes

    def __len__(self) -> int:
        return len(self.pages)

    def offset(self, position: int) -> int:
        """See Block."""
        return self.start_byte + self.length(0, position - self.first_position)

    def length(self, position: int, pages: int) -> int:
        """See Block."""
        return pages * int(self.pages.shape[1])


class RawScanner:
    """Counts off pages of one length."""

    def __init__(self, page_bytes: int, start_byte: int) -> None:
        self._page_bytes, self._start_byte, self._rest = page_bytes, start_byte, b""

    def feed(self, data: bytes, *, last: bool) -> RawBlock:
        """See Scanner."""
        data = self._rest + data
        whole = len(data) // self._page_bytes
        size, start_byte = whole * self._page_bytes, self._start_byte
        pages = np.frombuffer(data, np.uint8, size).reshape(whole, self._page_bytes)
        self._rest, self._start_byte = data[size:], start_byte + size
        return RawBlock(pages=pages, start_byte=start_byte, tail=self._rest if last else b"")


@dataclass(frozen=True, slots=True)
class PagedFile(PageFile[RawBlock]):
    """A file of pages of one length."""

    @classmethod
    def at(cls, path: Path, start_byte: int, page_bytes: int, *, proved: bool = True) -> Self:
        """Look at a file's size and compression; raises UnreadableError if it cannot be read."""
        with ByteSource(path) as source:
            size, compressed = source.file_bytes, source.compressed
        return cls(path, start_byte, page_bytes, size, compressed, partial(RawScanner, page_bytes), proved)

    @property
    def whole_pages(self) -> int:
        """Number of complete pages of an uncompressed file."""
        return max(0, self.size - self.start_byte) // self.page_bytes

    def offset(self, position: int) -> int:
        """Return where a page begins, bytes from the start of the (uncompressed) file."""
        return self.start_byte + position * self.page_bytes

    def pieces(self, amount: int, pieces: int) -> Iterator[RawBlock]:
        """See PageFile."""
        if self.compressed:
            return
        total = self.data_pages()
        amount = min(amount, max(1, total // max(1, pieces)) * self.page_bytes)
        for piece in range(min(pieces, max(1, total))):
            with closing(self.blocks(amount, piece * total // pieces)) as blocks:
                block = next(blocks)
                block.last = True
                yield block

    def data_pages(self) -> int:
        """Return the number of pages before the erased ones at the end of an uncompressed file."""
        low, high = 0, self.whole_pages
        while low < high:
            middle = (low + high) // 2
            # pages are written in order: the erased ones are all at the end
            erased = is_erased(self.read(self.offset(middle), self.page_bytes))
            low, high = (low, middle) if erased else (middle + 1, high)
        return low

    def last_block(self, pages: int) -> RawBlock:
        """Return the last pages of an uncompressed file before erased ones, about `pages`."""
        amount = self.amount(pages)
        first = max(0, self.data_pages() - amount // self.page_bytes)
        with closing(self.blocks(amount + self.page_bytes, first)) as blocks:
            return next(blocks)


def is_erased(data: bytes) -> bool:
    """Return True if all bytes are 0xFF, as in flash memory that was never written."""
    return not data.strip(b"\xff")


@dataclass(slots=True, kw_only=True)
class ScannedPages(Block):
    """The pages that a scanner found in a stretch of a file; they differ in length.

    A page is a stretch of bytes that the scanner takes for one page, sound or not.

    Attributes:
        status: what each page is: GOOD or a key of BAD_KINDS.
        starts: where each begins, bytes from the start of the (uncompressed) file.
        lengths: bytes of each.
        cut_at: where a page begins that the end of the file cuts off, None if there is none.
    """

    status: list[int] = field(default_factory=list)
    starts: list[int] = field(default_factory=list)
    lengths: list[int] = field(default_factory=list)
    cut_at: int | None = None

    def add(self, status: int, start: int, end: int) -> None:
        """Add a page that reaches from byte `start` to byte `end`."""
        self.status.append(status)
        self.starts.append(start)
        self.lengths.append(end - start)

    def __len__(self) -> int:
        return len(self.status)

    def offset(self, position: int) -> int:
        """See Block."""
        return self.starts[position - self.first_position]

    def length(self, position: int, pages: int) -> int:
        """See Block."""
        first = position - self.first_position
        return sum(self.lengths[first : first + pages])
