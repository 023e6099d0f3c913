"""Small text files that people write for us, such as layouts, lists of poses and options of a study.

What is named may be a pipe or a device that never ends: no more is read than such a file can hold.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import UsageError

LONGEST_LINE = 1000
"""Characters of a line of TOML: the time that reading one takes grows with its square."""


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


def read_toml(path: Path, what: str, most_bytes: int) -> dict[str, Any]:
    """The content of a TOML file; arguments as of `read_text`.

    Raises:
        UsageError: it cannot be read, or is not TOML.
    """
    import tomllib  # few recordings have such a file

    text = read_text(path, what, most_bytes, "utf-8-sig")
    for number, line in enumerate(text.split("\n"), 1):
        if len(line) > LONGEST_LINE:
            raise UsageError(
                f"{what} has a line of more than {LONGEST_LINE} characters", path=path, line=number
            )
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise UsageError(f"{what} is not valid: its brackets are nested too deep", path=path) from error
    except ValueError as error:
        match = re.search(r"at line (\d+)", str(error))
        place = int(match[1]) if match else None
        raise UsageError(f"{what} is not valid TOML ({error})", path=path, line=place) from error
