"""The only way readers take bytes from a file, plain or gzip."""

from __future__ import annotations

import gzip
import os
import zlib
from pathlib import Path
from types import TracebackType
from typing import Self

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import GZIP_MAGIC

GZIP_STEP = 1 << 13
TRAILING_WORDS = "Not a gzipped file"
"""What gzip says of bytes after its data; the data before them were checked and are right."""


class ByteSource:
    """The (uncompressed) bytes of a file, from its beginning.

    A gzip file is taken in equal steps, so that a damaged one ends at the same byte however much
    is asked for at a time.

    Attributes:
        compressed: whether the file is gzip.
        broken: whether its bytes broke off (a truncated or damaged gzip) rather than ended.
    """

    def __init__(self, path: Path) -> None:
        """Open a file.

        Raises:
            UnreadableError: it cannot be opened.
        """
        self.path = path
        self.broken = False
        self._untrue = False
        self._ahead = b""
        try:
            self._file = path.open("rb")
            self.compressed = self._file.read(len(GZIP_MAGIC)) == GZIP_MAGIC
            self._file.seek(0)
        except OSError as error:
            raise self._unreadable(error) from error
        self._gzip = gzip.GzipFile(fileobj=self._file) if self.compressed else None

    def read(self, count: int) -> bytes:
        """Up to `count` bytes; none only at the end.

        Raises:
            UnreadableError: the disk fails.
        """
        try:
            return self._file.read1(count) if self._gzip is None else self._step(self._gzip, count)
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            self.broken = True
            self._untrue = not isinstance(error, EOFError) and TRAILING_WORDS not in str(error)
            return b""
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
        if self._untrue:
            raise UnreadableError(
                "the gzip data are damaged: somewhere its values are not what was packed",
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
        return self._file.tell()

    def undecoded(self) -> int:
        """Bytes on the disk behind the place where a damaged gzip could not be unpacked any more."""
        return max(0, os.fstat(self._file.fileno()).st_size - self._file.tell()) if self.broken else 0

    def close(self) -> None:
        """Release the file."""
        if self._gzip is not None:
            self._gzip.close()
        self._file.close()

    def _step(self, stream: gzip.GzipFile, count: int) -> bytes:
        if not self._ahead and not self.broken:
            self._ahead = stream.read1(GZIP_STEP)
        part, self._ahead = self._ahead[:count], self._ahead[count:]
        return part

    def _unreadable(self, error: OSError) -> UnreadableError:
        return UnreadableError(f"cannot be read ({error.strerror or error})", path=self.path)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
