"""Fixed-size pages of a file, a block of them at a time."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import GZIP_MAGIC
from accelcal_cli.readers._stream import ByteSource

SKIP_BYTES = 1 << 20


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

    def blocks(self, pages: int, first_position: int = 0) -> Generator[RawBlock]:
        """Yield all pages from `first_position` on, `pages` at a time; the last block may be empty.

        Raises:
            UnreadableError: the disk fails, or the file is shorter than its header.
        """
        with ByteSource(self.path) as stream:
            self._enter(stream, first_position)
            last = False
            while not last:
                data = stream.read_exact(pages * self.page_bytes)
                last = len(data) < pages * self.page_bytes
                if not self.proved:
                    stream.refuse_untrue()
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


def paged_file(path: Path, start_byte: int, page_bytes: int, *, proved: bool = True) -> PagedFile:
    """Look at a file's size and compression.

    Raises:
        UnreadableError: it cannot be read.
    """
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            compressed = file.read(2) == GZIP_MAGIC
    except OSError as error:
        raise UnreadableError(f"cannot be read ({error.strerror or error})", path=path) from error
    return PagedFile(path, start_byte, page_bytes, size, compressed, proved)


def is_erased(data: bytes) -> bool:
    """Whether all bytes are 0xFF, as in flash memory that was never written."""
    return not data.strip(b"\xff")


def erased_pages(pages: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Which pages hold nothing but 0xFF, shape (p,)."""
    erased: NDArray[np.bool_] = (pages[:, 0] == 0xFF) & (pages[:, -1] == 0xFF)
    candidates = np.flatnonzero(erased)
    erased[candidates] = (pages[candidates] == 0xFF).all(axis=1)
    return erased
