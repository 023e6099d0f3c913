"""Where the server that workers are forked from listens: a folder that goes with this process.

multiprocessing makes one in the folder for temporary files. A killed process would leave it there for ever,
and where that folder's path is long the name of the socket becomes too long to be one.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from functools import cache
from multiprocessing.util import Finalize
from pathlib import Path

from accelcal_cli.core.processes import host, lives

LONGEST = 40
"""Bytes of the path that leave room for the rest of a socket's name, 108 in all on Linux (unix(7))."""

OTHERS = ("/tmp", "/var/tmp")

AFTER_ALL = -200
"""multiprocessing removes its own folder in ours before (at -100)."""


@contextlib.contextmanager
def short_lived() -> Iterator[None]:
    """In the block, temporary files are made in a folder that is removed when this process ends.

    If it is killed, the next one of this host and user removes it.

    Raises:
        OSError: there is no place for one.
    """
    before = tempfile.tempdir
    tempfile.tempdir = str(_folder())
    try:
        yield
    finally:
        tempfile.tempdir = before


@cache
def _folder() -> Path:
    above = next((path for path in (tempfile.gettempdir(), *OTHERS) if _fits(path)), tempfile.gettempdir())
    start = f"accelcal-{hashlib.sha256(host().encode()).hexdigest()[:6]}-"
    _sweep(Path(above), start)
    made = tempfile.mkdtemp(prefix=f"{start}{os.getpid()}-", dir=above)
    Finalize(None, shutil.rmtree, (made, True), exitpriority=AFTER_ALL)
    return Path(made)


def _fits(path: str) -> bool:
    return len(os.fsencode(path)) <= LONGEST and os.access(path, os.W_OK | os.X_OK)


def _sweep(above: Path, start: str) -> None:
    """Remove the folders of processes that are gone."""
    with contextlib.suppress(OSError), os.scandir(above) as found:
        for one in found:
            owner = one.name.removeprefix(start).split("-")[0]
            if one.name.startswith(start) and owner.isdigit() and not lives(int(owner)):
                shutil.rmtree(one.path, ignore_errors=True)
