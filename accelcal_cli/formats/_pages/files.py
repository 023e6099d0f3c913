"""Finds the pages of a file, and takes its bytes as blocks of pages.

Pages of one length are cut off by counting bytes (`PagedFile`); pages that differ in length are found by a
scanner of the format (`ScannedFile`). Both can be read in blocks, and cut from a file that grows.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Generic, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.formats._bytes import ByteSource

SKIP_BYTES = 1 << 20
"""Bytes that are read at a time to pass over a stretch of a gzip file."""

BLOCK_BYTES = 1 << 24
"""Most bytes of a file in one block, unless a page is longer; frames may be far longer than their samples."""


@dataclass(slots=True)
class Block:
    """Consecutive pages of a file; offsets are those in the (uncompressed) file.

    Attributes:
        first_position: number of the first page within the file.
        end_byte: how far into the file on disk the block reaches, for progress.
        last: nothing follows.
        broken: the compressed data broke off rather than ended; only in the last block.
        undecoded: bytes on the disk that could not be unpacked after it broke off; only in the last block.
    """

    first_position: int = 0
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

    @property
    def end(self) -> int:
        """Offset of the first byte after the block."""
        raise NotImplementedError

    def offset(self, position: int) -> int:
        """Return where a page begins."""
        raise NotImplementedError

    def length(self, position: int, pages: int) -> int:
        """Return the bytes of `pages` pages from `position` on."""
        raise NotImplementedError


AnyBlock = TypeVar("AnyBlock", bound=Block)


class Cutter(Generic[AnyBlock]):
    """Cuts the bytes after a file's header, which come piece by piece, into blocks."""

    def cut(self, data: bytes, end_byte: int, *, last: bool) -> AnyBlock:
        """Return the pages that end in the next bytes; there may be none.

        Args:
            end_byte: how far into the file on disk these bytes reach.
            last: nothing follows.
        """
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class PageFile(Generic[AnyBlock]):
    """A file of pages.

    Attributes:
        start_byte: where the first page, or the search for it, begins.
        page_bytes: length of a page, or the usual one.
        size: bytes on disk.
        compressed: gzip; such a file is only read from its beginning.
        proved: its pages have checksums of their own.
    """

    path: Path
    start_byte: int
    page_bytes: int
    size: int
    compressed: bool
    proved: bool = field(default=True, kw_only=True)

    def amount(self, pages: int) -> int:
        """Return how much of the file to take at once for about `pages` pages, as `blocks` wants it."""
        raise NotImplementedError

    def blocks(self, amount: int, *, threads: int = 1) -> Generator[AnyBlock]:
        """Yield all pages, about `amount` at a time; the last block may be empty.

        Args:
            threads: how many threads may work at a time on a gzip file.

        Raises:
            UnreadableError: the disk fails, or a gzip file without checksums of its own is damaged inside.
        """
        raise NotImplementedError

    def pieces(self, amount: int, pieces: int) -> Iterator[AnyBlock]:
        """Yield blocks spread evenly over the file; none if it can only be read from its beginning."""
        return iter(())

    def cutter(self) -> Cutter[AnyBlock]:
        """Return a cutter for the bytes from `start_byte` on."""
        raise NotImplementedError


@dataclass(slots=True, kw_only=True)
class RawBlock(Block):
    """Consecutive pages of one length.

    Attributes:
        pages: (p, page_bytes).
        start_byte: where page 0 of the file begins.
        tail: bytes of an incomplete page after these; only in the last block.
    """

    pages: NDArray[np.uint8]
    start_byte: int
    tail: bytes

    def __len__(self) -> int:
        return len(self.pages)

    @property
    def end(self) -> int:
        """See Block."""
        return self.offset(self.next_position) + len(self.tail)

    def offset(self, position: int) -> int:
        """See Block."""
        return self.start_byte + self.length(0, position)

    def length(self, position: int, pages: int) -> int:
        """See Block."""
        page_bytes: int = self.pages.shape[1]
        return pages * page_bytes


@dataclass(frozen=True, slots=True)
class PagedFile(PageFile[RawBlock]):
    """A file of pages of one length."""

    @classmethod
    def at(cls, path: Path, start_byte: int, page_bytes: int, *, proved: bool = True) -> Self:
        """Look at a file's size and compression.

        Raises:
            UnreadableError: it cannot be read.
        """
        with ByteSource(path) as source:
            return cls(path, start_byte, page_bytes, source.file_bytes, source.compressed, proved=proved)

    @property
    def whole_pages(self) -> int:
        """Number of complete pages of an uncompressed file."""
        return max(0, self.size - self.start_byte) // self.page_bytes

    def offset(self, position: int) -> int:
        """Return where a page begins, bytes from the start of the (uncompressed) file."""
        return self.start_byte + position * self.page_bytes

    def amount(self, pages: int) -> int:
        """Return the number of pages, of `pages`, that may be taken at once."""
        return max(1, min(pages, BLOCK_BYTES // self.page_bytes))

    def blocks(self, amount: int, first_position: int = 0, *, threads: int = 1) -> Generator[RawBlock]:
        """Yield all pages from `first_position` on, `amount` at a time; see PageFile."""
        size = amount * self.page_bytes
        with ByteSource(self.path, threads) as source:
            self._enter(source, first_position)
            last = False
            while not last:
                data = source.read_exact(size)
                last = len(data) < size
                if not self.proved:  # pages without checksums may be wrong anywhere
                    source.refuse_damaged()
                table, tail = self.table(data)
                yield RawBlock(
                    first_position=first_position,
                    pages=table,
                    start_byte=self.start_byte,
                    end_byte=source.disk_position(),
                    tail=tail,
                    last=last,
                    broken=source.broken,
                    undecoded=source.undecoded(),
                )
                first_position += len(table)

    def table(self, data: bytes) -> tuple[NDArray[np.uint8], bytes]:
        """Return the whole pages of some bytes, (p, page_bytes), and the bytes after them."""
        whole = len(data) // self.page_bytes
        cut = whole * self.page_bytes
        return np.frombuffer(data, np.uint8, cut).reshape(whole, self.page_bytes), data[cut:]

    def _enter(self, source: ByteSource, position: int) -> None:
        left = self.offset(position)
        if not self.compressed:
            source.seek(left)
            return
        while left and (data := source.read_exact(min(left, SKIP_BYTES))):
            left -= len(data)

    def pieces(self, amount: int, pieces: int) -> Iterator[RawBlock]:
        """See PageFile."""
        if self.compressed:
            return
        total = self.data_pages()
        amount = min(amount, max(1, total // max(1, pieces)))
        for piece in range(min(pieces, max(1, total))):
            with closing(self.blocks(amount, piece * total // pieces)) as blocks:
                yield replace(next(blocks), last=True)

    def data_pages(self) -> int:
        """Return the number of pages before the erased ones at the end of an uncompressed file."""
        low, high = 0, self.whole_pages
        with ByteSource(self.path) as source:
            while low < high:
                middle = (low + high) // 2
                source.seek(self.offset(middle))
                page = source.read_exact(self.page_bytes)
                # pages are written in order: the erased ones are all at the end
                low, high = (low, middle) if is_erased(page) else (middle + 1, high)
        return low

    def cutter(self) -> PageCutter:
        """See PageFile."""
        return PageCutter(self)


def is_erased(data: bytes) -> bool:
    """Return True if all bytes are 0xFF, as in flash memory that was never written."""
    return not data.strip(b"\xff")


class PageCutter(Cutter[RawBlock]):
    """Cuts the bytes of a growing file into pages of one length."""

    def __init__(self, file: PagedFile) -> None:
        self._file = file
        self._rest = b""
        self._position = 0

    def cut(self, data: bytes, end_byte: int, *, last: bool) -> RawBlock:
        """See Cutter."""
        table, self._rest = self._file.table(self._rest + data)
        position, self._position = self._position, self._position + len(table)
        return RawBlock(
            first_position=position,
            pages=table,
            start_byte=self._file.start_byte,
            end_byte=end_byte,
            tail=self._rest if last else b"",
            last=last,
        )


@dataclass(slots=True)
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
    end: int = 0

    def add(self, status: int, start: int, end: int) -> None:
        """Add a page that reaches from byte `start` to byte `end`."""
        self.status.append(status)
        self.starts.append(start)
        self.lengths.append(end - start)

    def alone(self, end: int) -> Self:
        """Make this block, which reaches to byte `end`, a recording of its own."""
        self.end = self.end_byte = end
        self.last = True
        return self

    def __len__(self) -> int:
        return len(self.status)

    def offset(self, position: int) -> int:
        """See Block."""
        return self.starts[position - self.first_position]

    def length(self, position: int, pages: int) -> int:
        """See Block."""
        first = position - self.first_position
        return sum(self.lengths[first : first + pages])


AnyPages = TypeVar("AnyPages", bound=ScannedPages)
AnyPages_co = TypeVar("AnyPages_co", bound=ScannedPages, covariant=True)


class PageScanner(Protocol[AnyPages_co]):
    """Finds the pages in consecutive bytes of a file, which come in stretches of any length."""

    def feed(self, data: bytes, *, last: bool) -> AnyPages_co:
        """Return the pages that can be seen whole with the next bytes; there may be none.

        Args:
            last: nothing follows.
        """


@dataclass(frozen=True, slots=True)
class ScannedFile(PageFile[AnyPages]):
    """A file of pages that differ in length; only its format knows where it can be entered.

    Attributes:
        scanner: makes a scanner of bytes that begin at a place of the file.
    """

    scanner: Callable[[int], PageScanner[AnyPages]]

    def amount(self, pages: int) -> int:
        """Return the bytes of about `pages` pages, of at least one."""
        return max(self.page_bytes, min(pages * self.page_bytes, BLOCK_BYTES))

    def blocks(self, amount: int, *, threads: int = 1) -> Generator[AnyPages]:
        """Yield all pages, about `amount` bytes at a time; see PageFile."""
        with ByteSource(self.path, threads) as source:
            if source.compressed:
                source.read_exact(self.start_byte)
            else:
                source.seek(self.start_byte)
            cutter, last = self.cutter(), False
            while not last:
                data = source.read_exact(amount)
                if not self.proved:
                    source.refuse_damaged()
                last = len(data) < amount
                block = cutter.cut(data, source.disk_position(), last=last)
                block.broken, block.undecoded = source.broken, source.undecoded()
                yield block

    def read(self, offset: int, length: int) -> bytes:
        """Return up to `length` bytes from `offset` on, of an uncompressed file."""
        with ByteSource(self.path) as source:
            source.seek(offset)
            return source.read_exact(length)

    def cutter(self) -> ScannedCutter[AnyPages]:
        """See PageFile."""
        return ScannedCutter(self.scanner(self.start_byte), self.start_byte)


class ScannedCutter(Cutter[AnyPages]):
    """Finds the pages in the bytes of a file, piece by piece."""

    def __init__(self, scanner: PageScanner[AnyPages], start_byte: int) -> None:
        self._scanner = scanner
        self._end = start_byte
        self._position = 0

    def cut(self, data: bytes, end_byte: int, *, last: bool) -> AnyPages:
        """See Cutter."""
        self._end += len(data)
        block = self._scanner.feed(data, last=last)
        block.first_position, block.end, block.end_byte, block.last = (
            self._position,
            self._end,
            end_byte,
            last,
        )
        self._position = block.next_position
        return block
