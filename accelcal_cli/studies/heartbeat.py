"""Signs of life of a run that holds a lock, and silence as another machine sees it; no clocks are compared.

The holder touches its lock every BEAT_S. Who waits for it counts its own looks at the file that saw nothing
new. A holder that was only held up finds, before it writes what must not be written twice, that its lock is
another run's.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from math import ceil
from pathlib import Path

from accelcal_cli.core.errors import LockedError

BEAT_S = 10.0
LOOK_S = 5.0
LEAST_SILENCE_S = 120.0
"""The shortest silence that may count as an end: twelve beats, and twice as long as NFS keeps attributes by
default (`acregmax` in nfs(5))."""

BLIND_S = 60.0
"""A holder that could not read its lock for so long writes nothing more: it may have been taken over."""

SIGNS = 2
"""Changes after which a run lives: the first may be older than the first look, and shown late by a cache."""


class Lease:
    """A lock that this run holds.

    Args:
        path: the lock.
        loss: says how the lock was lost, or None while it is ours; it may raise OSError.

    Attributes:
        lost: locks that were taken over from runs of other hosts, this one or others, and these hosts.
    """

    def __init__(self, path: Path, loss: Callable[[], LockedError | None]) -> None:
        self.path = path
        self.lost: dict[Path, str] = {}
        self._loss = loss
        self._lost: LockedError | None = None
        self._seen_s = time.monotonic()
        self._ended = threading.Event()

    def check(self) -> None:
        """Raise LockedError if a beat found that the lock is lost; reads nothing."""
        if self._lost is not None:
            raise self._lost

    def confirm(self) -> None:
        """Look whether the lock is still this run's: before each write that two runs must not do.

        Raises:
            LockedError: it is not, or was not to be read for long.
        """
        self.check()
        try:
            self._lost = self._loss()
            self._seen_s = time.monotonic()
        except OSError as error:
            blind_s = time.monotonic() - self._seen_s
            if blind_s > BLIND_S:
                reason = f"cannot be read for {blind_s:.0f} s ({error.strerror or error})"
                hint = "what was done is kept, and the same command does the rest"
                raise LockedError(reason, path=self.path, hint=hint) from error
        self.check()

    @contextlib.contextmanager
    def kept_alive(self) -> Iterator[None]:
        """While the block runs, the lock shows every BEAT_S that this run lives."""
        thread = threading.Thread(target=self._beat, daemon=True, name="heartbeat")
        thread.start()
        try:
            yield
        finally:
            self._ended.set()
            thread.join()

    def _beat(self) -> None:
        while not self._ended.wait(BEAT_S):
            with contextlib.suppress(LockedError):
                self.confirm()
            if self._lost is not None:
                return
            with contextlib.suppress(OSError):
                os.utime(self.path)


def one_that_lives(look: Callable[[], Mapping[Path, object]], silence_s: float) -> Path | None:
    """Watch locks until the run of one shows that it lives; None if all were silent for so long.

    Time in which a disk does not answer counts as one look.

    Args:
        look: what is seen of each lock now; one that is gone is left out.
    """
    last, changes, quiet = look(), Counter[Path](), 0
    while last and quiet < ceil(silence_s / LOOK_S):
        time.sleep(LOOK_S)
        seen = look()
        changes.update(path for path in seen if seen[path] != last.get(path))
        if (alive := next((path for path, number in changes.items() if number >= SIGNS), None)) is not None:
            return alive
        quiet = quiet + 1 if seen == last else 0
        last = seen
    return None
