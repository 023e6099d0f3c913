"""What is asked of a study, what is there, and what is left to do."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from accelcal_cli import __version__
from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.names import printable
from accelcal_cli.pipeline.request import Request
from accelcal_cli.study import row
from accelcal_cli.study.find import Where, files, is_recording, without_collisions
from accelcal_cli.study.items import Entry, Item
from accelcal_cli.study.ledger import Ledger
from accelcal_cli.study.shard import Shard

WRONG_USE = 2
UNREADABLE = 3
WHOLE = Shard()
POOL, POOLED, BORROW = "pool", "pooled", "borrow"
REPLACING = (POOLED, BORROW)
"""Rounds after that of the own results that may replace one."""


@dataclass(frozen=True, slots=True)
class Study:
    """What is asked for.

    Attributes:
        jobs: workers; None for as many as CPUs and memory allow, or as the cluster has.
        timeout_s: the longest one recording may take.
        settle_s: what was changed within so many seconds is left for later.
        newer_than_s: what was last changed before [s since 1970] is not begun.
        retry_failed: try again what failed and has not changed.
        collect: begin nothing; sum up what the shards have done.
        dask: address or scheduler file of the cluster that does the work; None for processes here.
        pool: recordings of one device are calibrated as one.
        borrow: what cannot be calibrated well may use coefficients of its device's other recordings.
    """

    where: Where
    request: Request
    jobs: int | None = None
    timeout_s: float | None = None
    settle_s: float = 0.0
    newer_than_s: float | None = None
    retry_failed: bool = False
    shard: Shard = WHOLE
    collect: bool = False
    dask: str | None = None
    pool: bool = False
    borrow: bool = False

    @property
    def out(self) -> Path:
        """Folder of the outputs."""
        return self.where.out

    @property
    def lock(self) -> Path:
        """What one run at a time holds."""
        return self.out / f"{self.shard.basename}.lock"

    def settings(self) -> dict[str, Any]:
        """All that decides the recordings' own results but the recordings and their layout files."""
        return {
            **self.request.effective_settings(self.request.options.layout),
            "integers": self.request.integers,
        }

    def all_settings(self) -> dict[str, Any]:
        """All that decides the results but the recordings and their layout files."""
        return {**self.settings(), "pool": self.pool, "borrow": self.borrow}

    @property
    def replacing(self) -> tuple[str, ...]:
        """The later rounds whose results may replace a recording's own."""
        return ((POOLED,) if self.pool else ()) + ((BORROW,) if self.borrow else ())

    def asked(self) -> str:
        """A hash of settings and version: an earlier entry with another no longer stands."""
        text = json.dumps([__version__, self.settings()], sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


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
    asked, found = study.asked(), Plan()
    recordings = without_collisions(list(_recordings(study, ledger, asked, found)))
    if not recordings:
        raise UsageError(
            "no recording was found", path=study.where.folders[0], hint="name its --format or --include it"
        )
    for item in recordings:
        if study.shard.owns(item.name):
            begin = not study.collect and item.name not in found.late
            names = study.replacing if item.name in found.changing else REPLACING if study.replacing else ()
            _place(study, item, _standing(study, ledger, item, names), found, begin=begin)
    return found


def _recordings(study: Study, ledger: Ledger, asked: str, found: Plan) -> Iterator[Item]:
    """The recordings among the files; which are none is remembered, too."""
    for now in files(study.where):
        item = now
        if _left_for_later(study, now):
            found.late.add(now.name)
            item = ledger.as_it_was(now, asked)
            found.changing |= {now.name} if item.stamps != now.stamps else set()
        entry = ledger.known(item, asked)
        if entry is not None and not entry.failed and (entry.row is not None or not study.where.include):
            recording = entry.row is not None
        else:
            recording = item.refusal is not None or is_recording(
                item, study.request.options, asked_for=bool(study.where.include)
            )
        if recording:
            yield item
        else:
            found.left_out.append(Entry(item.name, item.stamps, asked, None))


def _standing(study: Study, ledger: Ledger, item: Item, replacing: tuple[str, ...]) -> Entry | None:
    """The entry of a recording's own result; what one of these rounds made of it may lie in its place."""
    asked = study.asked()
    if item.refusal is None:
        own = ledger.known(item, asked)
        there = own is not None and (ledger.in_place(own) or _replaced(ledger, item, asked, replacing))
        return own if there else None
    code = WRONG_USE if item.source.is_file() else UNREADABLE
    said = row.failed(item, code, f"{printable(item.source)}: {item.refusal}")
    return Entry(item.name, item.stamps, asked, said, again=True)


def _replaced(ledger: Ledger, item: Item, asked: str, replacing: tuple[str, ...]) -> bool:
    """Whether the outputs are those of a later round."""
    later = [ledger.current(item, asked, name) for name in replacing]
    return any(entry is not None and not entry.failed for entry in later)


def _place(study: Study, item: Item, entry: Entry | None, found: Plan, *, begin: bool) -> None:
    again = (
        entry is not None
        and item.refusal is None
        and (study.request.force or entry.again or (study.retry_failed and entry.failed))
    )
    if entry is not None and not (again and begin):
        found.done.append((item, entry))
    else:
        (found.todo if begin else found.waiting).append(item)


def _left_for_later(study: Study, item: Item) -> bool:
    """Whether a recording is too new to be begun, or too old; an earlier result of it stands meanwhile."""
    too_new = study.settle_s > 0 and time.time() - item.changed_s < study.settle_s
    return too_new or (study.newer_than_s is not None and item.changed_s < study.newer_than_s)


def ledger_of(study: Study) -> Ledger:
    """What is remembered: the run's own entries, those of the shards, and for a shard those of the whole."""
    others = [*sorted(study.out.glob("study.*-of-*.ledger")), study.out / f"{WHOLE.basename}.ledger"]
    own = study.out / f"{study.shard.basename}.ledger"
    return Ledger(own, [path for path in others if path != own])
