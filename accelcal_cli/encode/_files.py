"""Files whose failures are told in a user's words."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from accelcal_cli.core.errors import OutputError


@contextmanager
def new_file(path: Path) -> Iterator[BinaryIO]:
    """A file to be written from its beginning.

    Raises:
        OutputError: it cannot be written, or the block fails to.
    """
    try:
        with path.open("wb") as file:
            yield file
    except OSError as error:
        raise OutputError(
            f"cannot be written ({error.strerror or error})", path=path, hint="check the disk"
        ) from error
