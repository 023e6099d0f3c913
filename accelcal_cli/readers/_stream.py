"""The only way readers take bytes from a file."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path
from typing import BinaryIO, cast

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import GZIP_MAGIC


def open_bytes(path: Path) -> BinaryIO:
    """Open a file for reading, through gzip where its content is gzip.

    Raises:
        UnreadableError: the file cannot be opened.
    """
    try:
        raw = path.open("rb")
        head = raw.read(2)
        raw.seek(0)
    except OSError as error:
        raise UnreadableError(f"cannot be read ({error.strerror or error})", path=path) from error
    return cast(BinaryIO, gzip.open(raw)) if head == GZIP_MAGIC else raw


def read_exact(stream: BinaryIO, count: int, path: Path) -> tuple[bytes, bool]:
    """Read `count` bytes, fewer only at the end of the data.

    Returns:
        the bytes, and whether the stream broke (a truncated or damaged gzip) rather than ended.

    Raises:
        UnreadableError: the disk fails.
    """
    parts: list[bytes] = []
    left = count
    try:
        while left and (part := stream.read(left)):
            parts.append(part)
            left -= len(part)
    except (EOFError, zlib.error, gzip.BadGzipFile):
        return b"".join(parts), True
    except OSError as error:
        raise UnreadableError(f"cannot be read ({error.strerror or error})", path=path) from error
    return b"".join(parts), False
