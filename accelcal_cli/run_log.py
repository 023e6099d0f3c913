"""The log of a run (`--log`): plain lines with times, in which the story of a night can be read.

Lines are added, never changed, each by one write, so that a killed run leaves at most half a line. A log that
cannot be written is said once, and the run continues.
"""

from __future__ import annotations

import contextlib
import logging
import os
import re
from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path
from typing import IO

from accelcal_cli.core.errors import AccelcalError, OutputError, UsageError, printable
from accelcal_cli.core.paths import stat_or_none as look
from accelcal_cli.core.system import host
from accelcal_cli.core.version import __version__
from accelcal_cli.output.files import looking_at, open_plain
from accelcal_cli.studies.task import BUG, INTERRUPTED

LOG = logging.getLogger("accelcal")
FIRST = re.compile(rb"\s*\d{4}-\d\d-\d\dT[\d:.]+[+-]\d\d:\d\d \[\d+\] ")
"""Beginning of a log; nothing is added to any other file."""
HEAD_BYTES = 80


class RunLog(logging.Handler):
    """Adds lines with times to a file; `say` takes the one that it cannot be written.

    Attributes:
        code: exit code of the run, once it is known.
    """

    def __init__(self, path: Path, say: Callable[[str], None]) -> None:
        super().__init__(logging.INFO)
        self.path, self._say = path, say
        self.code: int | None = None
        self._file: IO[str] | None = None
        self._failed = False
        self._write(b"" if _is_empty(path) else b"\n")

    def emit(self, record: logging.LogRecord) -> None:
        """Add a line; see `logging.Handler`."""
        now = datetime.fromtimestamp(record.created).astimezone().isoformat(timespec="milliseconds")
        line = f"{now} [{os.getpid()}] {printable(record.getMessage())}\n"
        self._write((b"\n" if self._failed else b"") + line.encode())

    def _write(self, data: bytes) -> None:
        """Write all at once; the first failure is said, and later lines are tried all the same."""
        try:
            self._file = self._file or open_plain(self.path, "a")
            if os.write(self._file.fileno(), data) == len(data):
                return
            why = "no space left"
        except (OSError, OutputError) as error:
            why = getattr(error, "strerror", None) or str(error)
        if not self._failed:
            self._say(f"{printable(self.path)}: the log cannot be written ({why}), and lines are missing")
        self._failed = True

    def close(self) -> None:
        """Close the file."""
        with contextlib.suppress(OSError):
            if self._file is not None:
                self._file.close()
        super().close()


def _is_empty(path: Path) -> bool:
    """Return True if there is no log yet.

    Raises:
        UsageError: there is a file that is not a log; nothing is added to it.
        OutputError: it cannot be read.
    """
    with looking_at(path):
        found = look(path)
        if found is None or found.st_size == 0:
            return True
        with open_plain(path, "rb") as file:
            if FIRST.match(file.read(HEAD_BYTES)) is None:
                raise UsageError("is not a log of accelcal", path=path, hint="give --log another name")
    return False


@contextlib.contextmanager
def run_log(path: Path | None, what: str, say: Callable[[str], None]) -> Iterator[RunLog | None]:
    """Write a log of the block: who, what, where, and how it ended."""
    if path is None:
        yield None
        return
    handler = RunLog(path, say)
    LOG.addHandler(handler)
    LOG.setLevel(logging.INFO)
    LOG.info("begins: accelcal %s on %s: %s", __version__, host(), what)
    code, why = BUG, ""
    try:
        yield handler
        code = handler.code or 0
    except AccelcalError as error:
        code, why = error.exit_code, f": {error}"
        raise
    except Exception as error:
        why = f": {type(error).__name__}: {error}"
        raise
    except BaseException:
        code, why = INTERRUPTED, ": interrupted"
        raise
    finally:
        LOG.info("ends with exit code %s%s", code, why)
        LOG.removeHandler(handler)
        LOG.setLevel(logging.NOTSET)
        handler.close()
