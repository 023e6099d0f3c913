"""What a study should do (`Study`; `Shard` for a part of it), what was done before, and what is left."""

from __future__ import annotations

import hashlib
import json
import os
import re
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from accelcal_cli import __version__
from accelcal_cli.core.errors import UsageError, printable
from accelcal_cli.pipeline.jobs import Request
from accelcal_cli.study import summary
from accelcal_cli.study.discovery import Where, below_out, files, is_recording, without_collisions
from accelcal_cli.study.ledger import Ledger
from accelcal_cli.study.records import Entry, Item

SLURM = "slurm"
WRONG_USE = 2
UNREADABLE = 3
POOL, POOLED, BORROW = "pool", "pooled", "borrow"
REPLACING = (POOLED, BORROW)
"""Rounds after that of the own results that may replace one."""


@dataclass(frozen=True, slots=True)
class Shard:
    """Part `index` (from 1) of `number`."""

    index: int = 1
    number: int = 1

    def owns(self, name: str) -> bool:
        """Whether a recording of this name is this shard's; no other recording decides on it."""
        digest = hashlib.sha256(name.encode("utf-8", "surrogateescape")).digest()
        return int.from_bytes(digest[:8], "big") % self.number == self.index - 1

    @property
    def whole(self) -> bool:
        """Whether it is all of the study."""
        return self.number == 1

    @property
    def basename(self) -> str:
        """Of the summary, the ledger and the lock."""
        return "study" if self.whole else f"study.{self.index}-of-{self.number}"


def shard(text: str | None, environment: Mapping[str, str] = os.environ) -> Shard:
    """The shard that `--shard` means: `2/8`, or `slurm` for this task of a job array.

    Raises:
        UsageError: it is neither, or this is no task of a job array whose numbers rise by one.
    """
    if text is None:
        return Shard()
    if text == SLURM:
        return _slurm(environment)
    part = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
    if part is None or not 1 <= int(part[1]) <= int(part[2]):
        raise UsageError(
            f"--shard {text} is not a part such as 2/8", hint="give I/N with I from 1 to N, or slurm"
        )
    return Shard(int(part[1]), int(part[2]))


def _slurm(environment: Mapping[str, str]) -> Shard:
    """Slurm's sbatch(1), "output environment variables": the array's task, its least and how many."""
    names = ("SLURM_ARRAY_TASK_ID", "SLURM_ARRAY_TASK_MIN", "SLURM_ARRAY_TASK_COUNT")
    words = [environment.get(name, "") for name in names]
    if not all(word.isdecimal() for word in words):
        raise UsageError("--shard slurm works only in a job array", hint="submit it with sbatch --array")
    task, least, number = map(int, words)
    if not 0 <= task - least < number:
        raise UsageError("--shard slurm needs an array with consecutive task numbers", hint="use --array=1-N")
    return Shard(task - least + 1, number)


WHOLE = Shard()


@dataclass(frozen=True, slots=True)
class Study:
    """What is asked for.

    Attributes:
        jobs: workers; None for as many as CPUs and memory allow, or as the cluster has.
        timeout_s: the longest one recording may take.
        settle_s: files modified within this many seconds are skipped for now.
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
            **self.request.effective_settings(self.request.options.layout).as_json(),
            "integers": self.request.integers,
        }

    @property
    def replacing(self) -> tuple[str, ...]:
        """The later rounds whose results may replace a recording's own."""
        return ((POOLED,) if self.pool else ()) + ((BORROW,) if self.borrow else ())

    def asked(self) -> str:
        """A hash of settings and version: an earlier entry with another no longer stands."""
        text = json.dumps([__version__, self.settings()], sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def ledger_of(study: Study) -> Ledger:
    """What is remembered: the run's own entries, those of the shards, and for a shard those of the whole."""
    others = [*sorted(study.out.glob("study.*-of-*.ledger")), study.out / f"{WHOLE.basename}.ledger"]
    own = study.out / f"{study.shard.basename}.ledger"
    return Ledger(own, [path for path in others if path != own])


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
        UsageError: one of the folders is not a folder, or they hold no recording.
    """
    planning = _Planning(study, ledger, study.asked(), Plan())
    items = [planning.as_it_counts(item) for item in files(study.where)]
    recordings = without_collisions([item for item in items if not item.aside and planning.keeps(item)])
    if not recordings:
        raise UsageError(
            "no recording was found",
            path=study.where.folders[0],
            hint="give --format, or name files with --include",
        )
    for item in recordings:
        if study.shard.owns(item.name):
            planning.place(item)
    for item in items:
        if item.aside and study.shard.owns(item.name):
            planning.place_aside(item)
    return planning.plan


@dataclass(frozen=True, slots=True)
class _Planning:
    """A plan in the making."""

    study: Study
    ledger: Ledger
    asked: str
    plan: Plan

    def as_it_counts(self, now: Item) -> Item:
        """A file as it is; one that is left for later as it was when it was worked on."""
        if not (now.aside or _left_for_later(self.study, now)):
            return now
        item = self.ledger.as_it_was(now, self.asked)
        self.plan.late.add(now.name)
        if item.stamps != now.stamps:
            self.plan.changing.add(now.name)
        return item

    def keeps(self, item: Item) -> bool:
        """Whether a file is one of the study's recordings; those that are not are remembered too."""
        entry, named = self.ledger.known(item, self.asked), bool(self.study.where.include)
        if entry is not None and not entry.failed and (entry.row is not None or not named):
            recording = entry.row is not None
        else:
            options = self.study.request.options
            recording = item.refusal is not None or is_recording(item, options, asked_for=named)
        if not recording:
            self.plan.left_out.append(Entry(item.name, item.stamps, self.asked, None))
        return recording

    def place(self, item: Item) -> None:
        """Put a recording where it belongs."""
        study, entry = self.study, self._standing(item)
        begin = not study.collect and item.name not in self.plan.late
        again = (
            entry is not None
            and item.refusal is None
            and (study.request.force or entry.again or (study.retry_failed and entry.failed))
        )
        if entry is not None and not (again and begin):
            self.plan.done.append((item, entry))
        else:
            (self.plan.todo if begin else self.plan.waiting).append(item)

    def place_aside(self, item: Item) -> None:
        """A recording that `--include` does not name keeps the result that it has, if any."""
        known = self.ledger.known(item, self.asked)
        if known is not None and known.row is None:
            self.plan.left_out.append(known)
        elif (entry := self._standing(item)) is not None:
            self.plan.done.append((item, entry))

    def _standing(self, item: Item) -> Entry | None:
        """The entry of a recording's own result; what a later round made of it may lie in its place."""
        if item.refusal is None:
            own = self.ledger.known(item, self.asked)
            stands = own is not None and (self.ledger.in_place(own) or self._replaced(item))
            return own if stands else None
        code = WRONG_USE if item.source.is_file() else UNREADABLE
        row = summary.failed(item, code, f"{printable(item.source)}: {item.refusal}")
        return Entry(item.name, item.stamps, self.asked, row, again=True)

    def _replaced(self, item: Item) -> bool:
        """Whether the outputs are those of a later round, which can be taken back if the file is the same."""
        rounds = self.study.replacing
        if rounds and item.name not in self.plan.changing:
            rounds = REPLACING
        later = [self.ledger.current(item, self.asked, name) for name in rounds]
        return any(entry is not None and not entry.failed for entry in later)


def overlooked(study: Study) -> int:
    """How many recordings are no part of the study because they lie below OUT.

    Raises:
        UsageError: one of the folders is not a folder.
    """
    options = study.request.options
    return sum(is_recording(item, options, asked_for=False) for item in below_out(study.where))


def _left_for_later(study: Study, item: Item) -> bool:
    """Whether a recording is too new to be begun, or too old; an earlier result of it stands meanwhile."""
    too_new = study.settle_s > 0 and time.time() - item.changed_s < study.settle_s
    return too_new or (study.newer_than_s is not None and item.changed_s < study.newer_than_s)
