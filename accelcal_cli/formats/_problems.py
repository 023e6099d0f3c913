"""Problems of a paged file: equal ones in a row are one record, and their number stays bounded."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass

from accelcal_cli.core.recording import Problem

PLACES_OF_A_KIND = 100


@dataclass(frozen=True, slots=True)
class Event:
    """Something wrong at page `position`, reaching over `pages` pages.

    Attributes:
        code, text: as in a Problem; the count is appended to the text.
        sample: number of the first sample after it.
        count: how many units are concerned.
        amount_us: what to sum up as seconds, 0 for nothing.
        lost_bytes: as in a Problem.
    """

    position: int
    pages: int
    code: str
    text: str
    byte_offset: int
    sample: int
    count: int
    amount_us: int = 0
    lost_bytes: int = 0


@dataclass(slots=True)
class _Run:
    event: Event
    last: int
    count: int
    amount_us: int
    lost_bytes: int = 0
    closed: bool = False
    scattered: bool = False


class ProblemLog:
    """Collects events in page order; gives problems back in the order in which they began.

    What is merged depends on the pages alone, not on when `take` is called.
    """

    def __init__(self, first: Iterable[Problem] = ()) -> None:
        self._ready = list(first)
        self._queue: deque[_Run] = deque()
        self._open: dict[tuple[str, str], _Run] = {}
        self._places: Counter[tuple[str, str]] = Counter()

    def add(self, event: Event) -> None:
        """Note an event; positions of one kind ascend."""
        kind = (event.code, event.text)
        run = self._open.get(kind)
        full = self._places[kind] >= PLACES_OF_A_KIND
        if run is None or not (full or event.position <= run.last + 1):
            run = self._begin(kind, event, run)
        run.scattered |= event.position > run.last + 1
        run.last = event.position + event.pages - 1
        run.count += event.count
        run.amount_us += event.amount_us
        run.lost_bytes += event.lost_bytes

    def _begin(self, kind: tuple[str, str], event: Event, before: _Run | None) -> _Run:
        if before is not None:
            before.closed = True
        self._places[kind] += 1
        run = _Run(event, event.position, 0, 0)
        self._open[kind] = run
        self._queue.append(run)
        return run

    def take(self, scanned: int | None) -> tuple[Problem, ...]:
        """Problems that are complete now that all pages before `scanned` (None: all) are known."""
        for kind, run in list(self._open.items()):
            if scanned is None or (run.last + 1 < scanned and self._places[kind] < PLACES_OF_A_KIND):
                run.closed = True
                del self._open[kind]
        done, self._ready = self._ready, []
        while self._queue and self._queue[0].closed:
            done.append(as_problem(self._queue.popleft()))
        return tuple(done)


def as_problem(run: _Run) -> Problem:
    """The record of a run, with its totals in the message."""
    event = run.event
    seconds = f" ({run.amount_us / 1e6:.3f} s in all)" if run.amount_us else ""
    scattered = ", in several places" if run.scattered else ""
    message = f"{event.text}: {run.count}{scattered}{seconds}"
    return Problem(event.code, message, event.byte_offset, event.sample, run.count, run.lost_bytes)
