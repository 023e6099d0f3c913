"""How readers take bytes from a file, plain or gzip, and checksums of many equally long pages at once."""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import GZIP_MAGIC
from accelcal_cli.core.parallel import prefetch
from accelcal_cli.core.recording import Closing
from accelcal_cli.formats._inflate import GzipFault, Piece, gunzipped

CRC16_POLYNOMIAL = 0x1021
CRC16_START = 0xFFFF


class ByteSource(Closing):
    """The (uncompressed) bytes of a file, from its beginning.

    A damaged gzip file ends at the same byte however much is asked for at a time, and whatever unpacks it.

    Attributes:
        compressed: whether the file is gzip.
        file_bytes: length of the file itself.
        broken: whether its bytes broke off (a truncated or damaged gzip) rather than ended.
        untrue: whether they did so because the gzip data are damaged within, not only cut short.

    Args:
        threads: how many may work at a time; a gzip file is unpacked ahead by one of its own.
    """

    def __init__(self, path: Path, threads: int = 1) -> None:
        """Open a file.

        Raises:
            UnreadableError: it cannot be opened.
        """
        self.path = path
        self._fault: GzipFault | None = None
        self._ahead = b""
        self._unpacked_to = 0
        try:
            self._file = path.open("rb")
            self.file_bytes = os.fstat(self._file.fileno()).st_size
            self.compressed = self._file.read(len(GZIP_MAGIC)) == GZIP_MAGIC
            self._file.seek(0)
        except OSError as error:
            raise self._unreadable(error) from error
        self._pieces = prefetch(gunzipped(self._file), threads) if self.compressed else None

    @property
    def broken(self) -> bool:
        """See the class."""
        return self._fault is not None

    @property
    def untrue(self) -> bool:
        """See the class."""
        return self._fault is GzipFault.DAMAGED

    def read(self, count: int) -> bytes:
        """Up to `count` bytes; none only at the end.

        Raises:
            UnreadableError: the disk fails.
        """
        try:
            return self._file.read1(count) if self._pieces is None else self._unpacked(self._pieces, count)
        except OSError as error:
            raise self._unreadable(error) from error

    def read_exact(self, count: int) -> bytes:
        """`count` bytes, fewer only at the end of the data.

        Raises:
            UnreadableError: the disk fails.
        """
        parts: list[bytes] = []
        while count > 0 and (part := self.read(count)):
            parts.append(part)
            count -= len(part)
        return b"".join(parts)

    def refuse_untrue(self) -> None:
        """For data without checksums of their own: what was unpacked may be wrong anywhere.

        Raises:
            UnreadableError: the gzip data are damaged within, not only cut short.
        """
        if self.untrue:
            raise UnreadableError(
                "the gzip data is damaged: some values are not what was compressed",
                path=self.path,
                byte_offset=self.disk_position(),
                hint="copy it again from its source",
            )

    def seek(self, offset: int) -> None:
        """Go to a byte of a file that is not compressed."""
        self._file.seek(offset)

    def read_into(self, buffer: memoryview) -> int:
        """Fill a buffer from a file that is not compressed; gives the bytes, fewer at the end.

        Raises:
            UnreadableError: the disk fails.
        """
        size = 0
        try:
            while size < len(buffer) and (more := self._file.readinto(buffer[size:])):
                size += more
        except OSError as error:
            raise self._unreadable(error) from error
        return size

    def disk_position(self) -> int:
        """How far the file on the disk has been read."""
        return self._unpacked_to if self.compressed else self._file.tell()

    def undecoded(self) -> int:
        """Bytes on the disk behind the place where a damaged gzip could not be unpacked any more."""
        return max(0, os.fstat(self._file.fileno()).st_size - self._unpacked_to) if self.broken else 0

    def close(self) -> None:
        """Release the file; that this fails costs nothing that was read."""
        with suppress(OSError):
            if self._pieces is not None:
                self._pieces.close()
            self._file.close()

    def _unpacked(self, pieces: Iterator[Piece], count: int) -> bytes:
        if not self._ahead and (piece := next(pieces, None)) is not None:
            self._ahead, self._unpacked_to, self._fault = piece.data, piece.end_byte, piece.fault
        part, self._ahead = self._ahead[:count], self._ahead[count:]
        return part

    def _unreadable(self, error: OSError) -> UnreadableError:
        return UnreadableError(f"cannot be read ({error.strerror or error})", path=self.path)


class ShortReads:
    """A file of which zipfile reads no directory that is too long, as it reads one at once."""

    def __init__(self, file: BinaryIO, most_bytes: int) -> None:
        """Stand for a file that is open for reading."""
        self.seek, self.tell, self.seekable = file.seek, file.tell, file.seekable
        self._file, self._most = file, most_bytes

    def read(self, count: int = -1) -> bytes:
        """Bytes of the file, which up to its near end; raises OSError for too many."""
        if count > self._most:
            raise OSError("the directory is too long")
        return self._file.read(count)


def crc32_pages(pages: NDArray[np.uint8], start: int, stop: int) -> NDArray[np.uint32]:
    """CRC-32 (IEEE 802.3, as in zlib) of bytes start..stop-1 of each page.

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
    """CRC-16/CCITT-FALSE (polynomial 0x1021, start 0xFFFF, not reflected) of each page's bytes.

    A CRC is linear over GF(2): that of a page is the XOR of what each byte alone contributes, so
    one table row per position lets all pages go through together.

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
    """What byte value v at position i of `length` adds: table[i, v]; and what the start value adds."""
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
    """The checksum states after one more zero byte."""
    return np.asarray((state << np.uint16(8)) ^ crc16_table()[state >> np.uint16(8)])


@cache
def crc16_table() -> NDArray[np.uint16]:
    """The checksum of each byte value alone, from state 0."""
    state = np.arange(256, dtype=np.uint32) << 8
    for _ in range(8):
        state = (state << 1) ^ np.where(state & 0x8000, CRC16_POLYNOMIAL, 0).astype(np.uint32)
    table: NDArray[np.uint16] = (state & 0xFFFF).astype(np.uint16)
    return table
