"""Collects events of damage into problems: equal ones in a row are one, and their number is bounded."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.recording import Problem

SINGLE = 99
"""Runs of one kind that become problems of their own; one more problem counts all others."""

Kind = tuple[str, str]
"""The code and the text of an event."""


@dataclass(frozen=True, slots=True)
class Event:
    """Something wrong at `position` (a page, a row), reaching over `length` of them.

    Attributes:
        code: as in a Problem; the message is made of the text and the totals (see `ProblemLog`).
        sample: number of the first sample after it.
        count: number of units concerned.
        amount_us: time to sum up, 0 for nothing.
        lost_bytes: as in a Problem.
        line: of a text file, or number of the row in a table, from 1; 0 in other files.
        scattered: it stands for several places, not for one.
        empty_rows: as in a Problem.
    """

    position: int
    length: int
    code: str
    text: str
    byte_offset: int | None
    sample: int
    count: int
    amount_us: int = 0
    lost_bytes: int = 0
    line: int = 0
    scattered: bool = False
    empty_rows: int = 0

    @property
    def kind(self) -> Kind:
        """Key by which events are put together."""
        return self.code, self.text


@dataclass(slots=True)
class Run:
    """Events of one kind: the first one, the position after the last one, and the totals."""

    event: Event
    end: int
    scattered: bool = False
    count: int = 0
    amount_us: int = 0
    lost_bytes: int = 0
    empty_rows: int = 0

    def add(self, event: Event) -> None:
        """Add an event to the totals."""
        self.scattered |= event.scattered or event.position > self.end
        self.end = event.position + event.length
        self.count += event.count
        self.amount_us += event.amount_us
        self.lost_bytes += event.lost_bytes
        self.empty_rows += event.empty_rows


def text_with_count(run: Run) -> str:
    """Return a run's text with its count, and its seconds where there are any."""
    seconds = f" ({run.amount_us / 1e6:.3f} s in all)" if run.amount_us else ""
    places = ", in several places" if run.scattered else ""
    return f"{run.event.text}: {run.count}{places}{seconds}"


class ProblemLog:
    """Collects events as they come; gives problems back in the order in which they began, or ended.

    Runs and their order depend on the positions of the events alone, not on when `take` is called.

    Args:
        first: problems that come before all others.
        describe: makes the message of a run.
        single: runs of a kind that become problems of their own; one more problem counts all others.
        by_end: problems come in the order of their ends, by code and text where they end together; the
            problem of all others comes last and has no place. Else all come in the order of their beginnings.
        place: says where a run is, for people.
    """

    def __init__(
        self,
        first: Iterable[Problem] = (),
        describe: Callable[[Run], str] = text_with_count,
        single: int = SINGLE,
        by_end: bool = False,
        place: Callable[[Run], str] = lambda _run: "",
    ) -> None:
        self._ready = list(first)
        self._describe, self._place, self._single, self._by_end = describe, place, single, by_end
        self._queue: deque[Run] = deque()
        self._open: dict[Kind, Run] = {}
        self._records: Counter[Kind] = Counter()
        self._rest: dict[Kind, Run] = {}

    def add(self, event: Event) -> None:
        """Add an event; positions of one kind ascend."""
        run = self._open.get(event.kind)
        if event.scattered or run is None or event.position > run.end:
            run = self._begin(event)
        run.add(event)

    def _begin(self, event: Event) -> Run:
        """Return a new run for an event, or the common one where there are enough of its kind."""
        run = Run(event, event.position)
        if not event.scattered and self._records[event.kind] < self._single:
            self._records[event.kind] += 1
            self._open[event.kind] = run
        elif event.kind in self._rest:
            return self._rest[event.kind]
        else:
            self._rest[event.kind] = run
            if self._by_end:
                run.event, run.scattered = replace(event, byte_offset=None), True
                return run
        self._queue.append(run)
        return run

    def runs(self, kind: Kind, places: NDArray[np.int64]) -> Iterator[tuple[int, int, bool]]:
        """Yield runs of consecutive places of one kind, which ascend; those beyond `single` as one.

        Yields:
            Index of a run's first place, number of its places, and whether these are scattered.
        """
        if not len(places):
            return
        edges = np.flatnonzero(np.diff(places) != 1) + 1
        first = np.concatenate(([0], edges))
        counts = np.diff(first, append=len(places))
        single = self._single - self._records[kind] + 1
        for index, count in zip(first[:single].tolist(), counts[:single].tolist(), strict=True):
            yield index, count, False
        if len(first) > single:
            yield int(first[single]), int(counts[single:].sum()), len(first) > single + 1

    def take(self, scanned: int | None) -> tuple[Problem, ...]:
        """Return the problems that are complete once everything before `scanned` (None: all) is known."""
        for kind, run in list(self._open.items()):
            if scanned is None or run.end < scanned:
                del self._open[kind]
        ready, self._ready = self._ready, []
        if self._by_end:
            self._queue = deque(sorted(self._queue, key=lambda run: (run.end, run.event.kind)))
        growing = () if scanned is None else (*self._open.values(), *self._rest.values())
        while self._queue and not any(self._queue[0] is run for run in growing):
            ready.append(self._problem(self._queue.popleft()))
        if scanned is None and self._by_end:
            ready += [self._problem(self._rest[kind]) for kind in sorted(self._rest)]
        return tuple(ready)

    def _problem(self, run: Run) -> Problem:
        event = run.event
        return Problem(
            event.code,
            self._describe(run),
            event.byte_offset,
            event.sample,
            run.count,
            run.lost_bytes,
            empty_rows=run.empty_rows,
            place=self._place(run),
        )
