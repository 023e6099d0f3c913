"""Small text files that people write for us, such as layouts and lists of poses.

What is named may be a pipe or a device that never ends: no more is read than such a file can hold.
"""

from __future__ import annotations

from pathlib import Path

from accelcal_cli.core.errors import UsageError


def read_text(path: Path, what: str, most_bytes: int, encoding: str = "utf-8") -> str:
    """The text of a file, its lines ended by `\\n`.

    Args:
        what: what to call it in errors, such as `the layout`.
        most_bytes: the longest that it may be.

    Raises:
        UsageError: it cannot be read, is longer, or is not UTF-8.
    """
    try:
        with path.open("rb") as file:
            data = file.read(most_bytes + 1)
    except OSError as error:
        raise UsageError(f"{what} cannot be read ({error.strerror or error})", path=path) from error
    if len(data) > most_bytes:
        raise UsageError(f"{what} is too large, more than {most_bytes} bytes", path=path)
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as error:
        raise UsageError(f"{what} is not UTF-8 text", path=path, byte_offset=error.start) from error
    return text.replace("\r\n", "\n").replace("\r", "\n")
