"""A file that is written behind the back of whoever fills it."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from typing import BinaryIO

DEPTH = 2
"""Portions that may wait to be written; each holds memory."""


class Behind:
    """A binary file, open for writing, whose portions a thread of its own hands to the system.

    Copying three hundred megabytes to the system's cache takes half a second and more, in which the
    thread that makes them can go on.
    """

    def __init__(self, file: BinaryIO) -> None:
        """Take over a file; it is closed with this one."""
        self._file = file
        self._taken = 0
        self._waiting: deque[Future[int]] = deque()
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="behind")

    @property
    def closed(self) -> bool:
        """Whether the file is closed."""
        return self._file.closed

    def tell(self) -> int:
        """Bytes that were taken so far."""
        return self._taken

    def write(self, data: bytes) -> int:
        """Take bytes, to be written later.

        Raises:
            OSError: some that were taken before could not be written.
        """
        self._settle(DEPTH - 1)
        self._waiting.append(self._thread.submit(self._file.write, bytes(data)))
        self._taken += len(data)
        return len(data)

    def flush(self) -> None:
        """Wait until the system has all bytes; raises OSError if some could not be written."""
        self._settle(0)
        self._file.flush()

    def _settle(self, most: int) -> None:
        while len(self._waiting) > most:
            self._waiting.popleft().result()

    def close(self) -> None:
        """Write what is left, and close the file even if that fails; raises OSError."""
        try:
            self._settle(0)
        finally:
            self._thread.shutdown()
            self._file.close()
