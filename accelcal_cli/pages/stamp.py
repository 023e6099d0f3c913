"""What a page was made of, as a hash within it: one that would come out the same need not be made again."""

from __future__ import annotations

import contextlib
import hashlib
import re
from functools import cache
from importlib.resources import files
from pathlib import Path

from accelcal_cli.core.version import __version__

NAME = "accelcal-made-of"
STAMP = re.compile(rf'<meta name="{NAME}" content="([0-9a-f]{{64}})">')
HEAD_BYTES = 8192
"""Of a page, in which the stamp stands."""
CHARSET = '<meta charset="utf-8">\n'
"""What the stamp follows."""


def made_of(*parts: bytes) -> str:
    """Hash of what a page is made of, and of all that makes pages."""
    return _sha256("".join([_makers(), *map(_sha256, parts)]).encode())


def stamped(text: str, stamp: str) -> str:
    """A page with its stamp."""
    return text.replace(CHARSET, f'{CHARSET}<meta name="{NAME}" content="{stamp}">\n', 1)


def stamp_of(page: Path) -> str | None:
    """The stamp of a page; None if it has none, or is not there."""
    head = b""
    with contextlib.suppress(OSError), page.open("rb") as file:
        head = file.read(HEAD_BYTES)
    found = STAMP.search(head.decode("utf-8", "replace"))
    return found[1] if found else None


@cache
def _makers() -> str:
    """Hash of the version and of all that makes pages: templates, styles, scripts and code."""
    package = files("accelcal_cli.pages")
    held = [one for folder in (package, package / "templates") for one in folder.iterdir() if one.is_file()]
    parts = [one.name + _sha256(one.read_bytes()) for one in sorted(held, key=lambda one: one.name)]
    return _sha256("\n".join([__version__, *parts]).encode())


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
