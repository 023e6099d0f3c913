"""The identity of an input, and copies of inputs that can be read only once."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import BinaryIO

from accelcal_cli.core.errors import OutputError, UnreadableError


def sha256(path: Path) -> str:
    """SHA-256 of a file, hexadecimal.

    Raises:
        UnreadableError: it cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise UnreadableError(f"cannot be read ({error.strerror or error})", path=path) from error


Seen = tuple[int, int]
"""Size [bytes] and time of the last change [ns since 1970] of a file."""


def seen(path: Path) -> Seen | None:
    """How a file is found; None where it cannot be looked at."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_size, found.st_mtime_ns


def same(path: Path, before: Seen | None) -> None:
    """Raise UnreadableError if a file changed, or went, since it was seen: what was read does not agree."""
    if before is not None and seen(path) != before:
        raise UnreadableError(
            "changed while it was read",
            path=path,
            hint="try again when it is complete (study --settle SECONDS leaves it until then)",
        )


@contextlib.contextmanager
def hashing(path: Path) -> Iterator[Future[str]]:
    """The hash of a file, computed beside the work in the block."""
    with ThreadPoolExecutor(1, thread_name_prefix="sha256") as pool:
        yield pool.submit(sha256, path)


@contextlib.contextmanager
def spooled(stream: BinaryIO) -> Iterator[Path]:
    """A temporary file with all of a stream, for the two passes; removed at the end.

    Raises:
        OutputError: there is no room for it.
    """
    import shutil  # few runs read standard input
    import tempfile

    with tempfile.TemporaryDirectory(prefix="accelcal-") as folder:
        path = Path(folder) / "stdin"
        try:
            with path.open("wb") as file:
                shutil.copyfileobj(stream, file, 1 << 20)
        except OSError as error:
            raise OutputError(
                f"standard input cannot be stored ({error.strerror or error})",
                path=path,
                hint="set TMPDIR to a disk with more room",
            ) from error
        yield path
