"""What is there of a study, what was done before, and what is left to do."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path

from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.names import printable
from accelcal_cli.study import row
from accelcal_cli.study.find import below_out, files, is_recording, without_collisions
from accelcal_cli.study.items import Entry, Item
from accelcal_cli.study.ledger import Ledger
from accelcal_cli.study.plan import REPLACING, Study

WRONG_USE = 2
UNREADABLE = 3


@dataclass(slots=True)
class Plan:
    """What a study found, before it does anything.

    Attributes:
        done: recordings whose entry stands.
        todo: recordings to work on.
        waiting: recordings that are not begun.
        left_out: entries of files that are no recordings.
        late: names of all that is left for a later run, done before or not.
        changing: of these the ones whose file is not that of the earlier result; it may be half there.
    """

    done: list[tuple[Item, Entry]] = field(default_factory=list)
    todo: list[Item] = field(default_factory=list)
    waiting: list[Item] = field(default_factory=list)
    left_out: list[Entry] = field(default_factory=list)
    late: set[str] = field(default_factory=set)
    changing: set[str] = field(default_factory=set)

    def sources(self) -> list[Path]:
        """The files of all recordings."""
        return [item.source for item in (*(item for item, _ in self.done), *self.todo, *self.waiting)]


def plan(study: Study, ledger: Ledger) -> Plan:
    """Look at all files; nothing is written.

    Raises:
        UsageError: a folder is none, or there is no recording in them.
    """
    looking = _Looking(study, ledger, study.asked(), Plan())
    looked = [looking.as_it_counts(item) for item in files(study.where)]
    recordings = without_collisions([item for item in looked if not item.aside and looking.keeps(item)])
    if not recordings:
        raise UsageError(
            "no recording was found", path=study.where.folders[0], hint="name its --format or --include it"
        )
    for item in recordings:
        if study.shard.owns(item.name):
            looking.place(item)
    for item in looked:
        if item.aside and study.shard.owns(item.name):
            looking.place_aside(item)
    return looking.found


@dataclass(frozen=True, slots=True)
class _Looking:
    """A plan in the making."""

    study: Study
    ledger: Ledger
    asked: str
    found: Plan

    def as_it_counts(self, now: Item) -> Item:
        """A file as it is; one that is left for later as it was when it was worked on."""
        if not (now.aside or _left_for_later(self.study, now)):
            return now
        item = self.ledger.as_it_was(now, self.asked)
        self.found.late.add(now.name)
        if item.stamps != now.stamps:
            self.found.changing.add(now.name)
        return item

    def keeps(self, item: Item) -> bool:
        """Whether a file is one of the study's recordings; which are none is remembered, too."""
        entry, named = self.ledger.known(item, self.asked), bool(self.study.where.include)
        if entry is not None and not entry.failed and (entry.row is not None or not named):
            recording = entry.row is not None
        else:
            options = self.study.request.options
            recording = item.refusal is not None or is_recording(item, options, asked_for=named)
        if not recording:
            self.found.left_out.append(Entry(item.name, item.stamps, self.asked, None))
        return recording

    def place(self, item: Item) -> None:
        """Put a recording where it belongs."""
        study, entry = self.study, self._standing(item)
        begin = not study.collect and item.name not in self.found.late
        again = (
            entry is not None
            and item.refusal is None
            and (study.request.force or entry.again or (study.retry_failed and entry.failed))
        )
        if entry is not None and not (again and begin):
            self.found.done.append((item, entry))
        else:
            (self.found.todo if begin else self.found.waiting).append(item)

    def place_aside(self, item: Item) -> None:
        """What `--include` does not name keeps what it has; of what has nothing there is nothing to say."""
        known = self.ledger.known(item, self.asked)
        if known is not None and known.row is None:
            self.found.left_out.append(known)
        elif (entry := self._standing(item)) is not None:
            self.found.done.append((item, entry))

    def _standing(self, item: Item) -> Entry | None:
        """The entry of a recording's own result; what a later round made of it may lie in its place."""
        if item.refusal is None:
            own = self.ledger.known(item, self.asked)
            there = own is not None and (self.ledger.in_place(own) or self._replaced(item))
            return own if there else None
        code = WRONG_USE if item.source.is_file() else UNREADABLE
        said = row.failed(item, code, f"{printable(item.source)}: {item.refusal}")
        return Entry(item.name, item.stamps, self.asked, said, again=True)

    def _replaced(self, item: Item) -> bool:
        """Whether the outputs are those of a later round, which can be taken back if the file is the same."""
        rounds = self.study.replacing
        if rounds and item.name not in self.found.changing:
            rounds = REPLACING
        later = [self.ledger.current(item, self.asked, name) for name in rounds]
        return any(entry is not None and not entry.failed for entry in later)


def overlooked(study: Study) -> int:
    """How many recordings are no part of the study because they lie below OUT.

    Raises:
        UsageError: a folder is none.
    """
    options = study.request.options
    return sum(is_recording(item, options, asked_for=False) for item in below_out(study.where))


def _left_for_later(study: Study, item: Item) -> bool:
    """Whether a recording is too new to be begun, or too old; an earlier result of it stands meanwhile."""
    too_new = study.settle_s > 0 and time.time() - item.changed_s < study.settle_s
    return too_new or (study.newer_than_s is not None and item.changed_s < study.newer_than_s)
