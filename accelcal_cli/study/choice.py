"""Which rounds a study has, and what is left to do in each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from accelcal_cli.study.borrow import BORROWING
from accelcal_cli.study.items import Entry
from accelcal_cli.study.ledger import Ledger
from accelcal_cli.study.plan import Study
from accelcal_cli.study.pool import POOLING
from accelcal_cli.study.pooled import POOLED_ONES
from accelcal_cli.study.rounds import Later, Round


def rounds(study: Study) -> tuple[Round, ...]:
    """The rounds after that of the own results; a shard has none, since a device may have several shards."""
    if not study.shard.whole:
        return ()
    return ((POOLING, POOLED_ONES) if study.pool else ()) + ((BORROWING,) if study.borrow else ())


@dataclass(slots=True)
class Choice:
    """What is done in a round, and what stands from an earlier run.

    Attributes:
        untouched: names of recordings that must not be read, since they wait and are not what they were, and
            of all that would be pooled with one.
    """

    study: Study
    ledger: Ledger
    untouched: set[str] = field(default_factory=set)

    def of(self, one: Round, tasks: Sequence[Later]) -> tuple[list[Later], list[tuple[Later, Entry]]]:
        """Tasks to do, and those with an entry to take.

        What is not to be touched keeps what it has: it is never among the first.
        """
        todo, taken = [], []
        for task in tasks:
            waits = not self.untouched.isdisjoint(task.names)
            if waits:
                self.untouched |= set(task.names)
            entry = self._latest(one, task) if waits else self._standing(one, task)
            if entry is not None:
                taken.append((task, entry))
            elif not waits:
                todo.append(task)
        return todo, taken

    def _latest(self, one: Round, task: Later) -> Entry | None:
        return self.ledger.latest(task.item.name, self.study.asked(), one.name)

    def _standing(self, one: Round, task: Later) -> Entry | None:
        """What an earlier run made of a task, if that is what would come of it now."""
        study, entry = self.study, self.ledger.current(task.item, self.study.asked(), one.name)
        if entry is None or entry.again or study.request.force or (study.retry_failed and entry.failed):
            return None
        return entry if task.stands(entry) else None
