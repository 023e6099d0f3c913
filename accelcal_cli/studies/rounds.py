"""The work of a study: a `Plan` of the own results, then a `RoundPlanner` of later rounds.

All that decides whether an earlier result is valid is here and in the ledger (`records.py`). A worker looks
once more at the report that is there (`pipeline/outputs.py`), for a study whose ledger is lost. A `Round`
gives tasks to workers, and the results of earlier rounds decide which.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import compress
from pathlib import Path
from typing import Any, Protocol

from accelcal_cli.core import system
from accelcal_cli.core.door import is_file, is_there, matching, unreadable
from accelcal_cli.core.errors import UnreadableError, UsageError, printable
from accelcal_cli.core.reasons import Reason
from accelcal_cli.formats import refuse_unused
from accelcal_cli.output.decisions import NAME as DECISIONS
from accelcal_cli.output.decisions import Decisions, Merged, merged, read_decisions
from accelcal_cli.output.files import looking_at
from accelcal_cli.pipeline.jobs import Request
from accelcal_cli.pipeline.options import STUDY_FILE, FolderRules, stated_stamp, with_stated
from accelcal_cli.studies import summary
from accelcal_cli.studies.discovery import Left, below_out, files, without_collisions
from accelcal_cli.studies.left_out import why_left_out
from accelcal_cli.studies.records import Entry, Item, Ledger, RecordingState, TaskFunction
from accelcal_cli.studies.sensors import SENSORS, SensorsTask, in_place_of, wants_each
from accelcal_cli.studies.study import REPLACING, WHOLE, Study
from accelcal_cli.studies.task import Common, Task, TaskResult
from accelcal_cli.studies.upgrades import options_changed, said_last, why_again

MANY = 1 << 20
"""A number of recordings that keeps all workers busy."""


@dataclass(frozen=True, slots=True)
class StudyState:
    """The results that are known when a round begins.

    Attributes:
        recordings: results of recordings, by name.
        pools: result of each pool of recordings, by the pool's name.
    """

    recordings: dict[str, RecordingState] = field(default_factory=dict)
    pools: dict[str, Entry] = field(default_factory=dict)

    def take(self, one: Round, name: str, entry: Entry) -> None:
        """Set the latest result of a recording or of a pool."""
        if one.of_pools:
            self.pools[name] = entry
        else:
            self.recordings[name] = replace(self.recordings[name], last=entry)


class RoundTask(Task, Protocol):
    """A task of a round after the first."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the recordings whose result the task may replace."""

    def is_current(self, entry: Entry) -> bool:
        """Return True if an earlier entry of the round is what the task would give now."""


@dataclass(frozen=True, slots=True)
class Round:
    """A round after that of the own results.

    Attributes:
        name: name in its entries.
        work: the work on a task, which returns a `TaskResult`.
        tasks: returns one task for each recording (or pool) that the round concerns. Its result may depend
            on the task and the recording's files alone.
        of_pools: whether its tasks are of pools, so that it replaces no recording's result.
    """

    name: str
    work: TaskFunction
    tasks: Callable[[Study, StudyState], Sequence[RoundTask]]
    of_pools: bool = False


def common_of(study: Study, recordings: int = MANY) -> Common:
    """Return what the tasks of a study share; how many threads an executor has is its own affair."""
    threads = 1 if study.executor is not None else system.threads(workers_of(study, recordings))
    return Common(study.out, replace(study.request, threads=threads, replaces_gone=True), study.asked())


def workers_of(study: Study, recordings: int) -> int:
    """Return the number of processes of this machine that work on a number of recordings at a time."""
    return min(study.jobs or system.workers(recordings), max(1, recordings))


def ledger_of(study: Study) -> Ledger:
    """Return the ledger of a run, with the entries of all shards, and for a shard with those of the whole.

    A shard reads neither the ledgers of its siblings, which have nothing of its own, nor others' entries.

    Raises:
        OutputError: OUT cannot be listed.
    """
    shard = study.shard
    with looking_at(study.out):
        siblings = set() if shard.whole else set(matching(study.out, f"study.*-of-{shard.number}.ledger"))
        others = [*matching(study.out, "study.*-of-*.ledger"), study.out / f"{WHOLE.basename}.ledger"]
    own = study.out / f"{shard.basename}.ledger"
    return Ledger(own, [path for path in others if path not in {own, *siblings}], shard.owns, summary.fits)


@dataclass(slots=True)
class Plan:
    """The recordings of a study by what is to be done with them, and other files that it found.

    Attributes:
        last: what `study.json` says of the last run.
        done: recordings whose earlier result is valid, each with its entry.
        todo: recordings to work on.
        waiting: recordings that are not started.
        left_out: entries of files that are not recordings.
        late: names of the recordings that are left for a later run, done before or not.
        changing: names of late recordings whose file has changed since the earlier result; it may be
            incomplete.
        kept: results of earlier runs with other options, of recordings that this run does not name.
        why: why recordings are calibrated again, by name; before: rows of their earlier results.
        reports: reports of all recordings that were found, whatever is done with them.
        decisions: what people decided about recordings; None without a file of it.
        by_name: why files were left out without a look at their content, by name.
        notes: lines for the user: patterns of `study.toml` that no file fits, links that are not followed.
        sensors: entries of the sensors of files of which each is a recording.
        unlisted: failures of files whose sensors could not be listed, by name.
        whole: files whose sensors are known, by the report of all of their rows.
    """

    last: Mapping[str, Any] = field(default_factory=dict)
    done: list[tuple[Item, Entry]] = field(default_factory=list)
    todo: list[Item] = field(default_factory=list)
    waiting: list[Item] = field(default_factory=list)
    left_out: list[Entry] = field(default_factory=list)
    late: set[str] = field(default_factory=set)
    changing: set[str] = field(default_factory=set)
    kept: list[Entry] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    by_name: Left = field(default_factory=dict)
    reports: set[Path] = field(default_factory=set)
    why: dict[str, str] = field(default_factory=dict)
    before: dict[str, dict[str, Any]] = field(default_factory=dict)
    decisions: Decisions | None = None
    sensors: list[Entry] = field(default_factory=list)
    unlisted: dict[str, Entry] = field(default_factory=dict)
    whole: dict[Path, Path] = field(default_factory=dict)

    def ahead(self) -> int:
        """Return the number of waiting recordings changed in the future, by this machine's clock."""
        now = time.time()
        return sum(item.changed_s > now for item in self.waiting)

    def counts(self) -> str:
        """Return how many recordings there are of each kind, for the log."""
        left = len(self.left_out) + len(self.by_name)
        return f"{len(self.todo)} to do, {len(self.done)} done, {len(self.waiting)} waiting, {left} left out"

    def reasons(self, owns: Callable[[str], bool]) -> Left:
        """Return why files are left out, by name, of those that a shard owns."""
        looked_at = {one.name: Reason(**one.why) for one in self.left_out if one.why}
        by_name = {name: why for name, why in self.by_name.items() if owns(name)}
        return dict(sorted({**by_name, **looked_at}.items()))

    def merged(self, rows: Iterable[Mapping[str, Any]]) -> Merged | None:
        """Put what people decided to the rows of the table; None if nobody did."""
        if self.decisions is None:
            return None
        waiting, left_out = ([one.name for one in ones] for ones in (self.waiting, self.left_out))
        return merged(self.decisions, rows, set(map(printable, (*waiting, *left_out, *self.by_name))))

    def items(self) -> list[Item]:
        """Return all recordings."""
        return [*(item for item, _ in self.done), *self.todo, *self.waiting]


Lister = Callable[[Sequence[SensorsTask]], Iterable[tuple[Item, TaskResult]]]
"""Has the sensors of files listed by workers."""


def plan(study: Study, ledger: Ledger, lister: Lister = lambda _tasks: ()) -> Plan:
    """Look at all files and decide what there is to do; writes nothing.

    Raises:
        UsageError: one of the folders is not a folder, or they hold no recording, or none for which an option
            means anything; or there is no file of decisions of the name that was given.
        UnreadableError: decisions cannot be read; exclusions must not be lost in silence.
    """
    notes: list[str] = []
    last = said_last(study, notes)
    planning = _Planning(study, ledger, study.asked(), Plan(last, notes=notes), options_changed(study, last))
    planning.plan.decisions = _decisions(study)
    by_name = planning.plan.by_name
    listed, rules = files(study.where, planning.plan.notes, by_name), study.request.rules
    planning.plan.notes += unfit_patterns(rules, listed)
    planning.plan.reports |= {item.job.report for item in listed}
    wanted = [item for item in listed if not any(one.excludes(item.source) for one in rules)]
    by_name |= {item.name: Reason.of("excluded", by=STUDY_FILE) for item in set(listed) - set(wanted)}
    concerned, others = _concerned(study, wanted)
    items = planning.split([as_stated(item, study.request) for item in concerned], lister)
    items = [planning.looked_at(item) for item in items]
    recordings = without_collisions(planning.recordings(items))
    try:
        _require_use(study, recordings)
    except UsageError:  # which other shards' recordings may have
        more = planning.recordings([planning.looked_at(as_stated(item, study.request)) for item in others])
        _require_use(study, [*recordings, *more])
    for item in recordings:
        planning.place(item)
    for item in items:
        planning.place_aside(item)
    return planning.plan


def _decisions(study: Study) -> Decisions | None:
    """Return what people decided; nothing for a shard, whose table nobody decides by."""
    path = study.decisions or study.out / DECISIONS
    if not study.shard.whole or (study.decisions is None and not is_there(path)):
        return None
    try:
        return read_decisions(path)
    except FileNotFoundError as error:
        raise UsageError("there is no such file", path=path, hint="correct or omit --decisions") from error
    except OSError as error:
        raise unreadable(error, path) from error


def _concerned(study: Study, items: list[Item]) -> tuple[list[Item], list[Item]]:
    """Return the items that a shard looks at, its own and those that share their outputs, and the others."""
    if study.shard.whole:
        return items, []
    reports = {item.job.report for item in items if study.shard.owns(item.name)}
    near = [item.job.report in reports for item in items]
    return list(compress(items, near)), [item for item, one in zip(items, near, strict=True) if not one]


def _require_use(study: Study, recordings: list[Item]) -> None:
    """Raise UsageError if there are no recordings, or none for which an option means anything."""
    if not recordings:
        raise UsageError(
            "no recording was found",
            path=study.where.folders[0],
            hint="give --format, or name files with --include",
        )
    refuse_unused([item.source for item in recordings], study.request.options)


def as_stated(item: Item, request: Request) -> Item:
    """Return an item with the options that files state for it; refused if they make no sense."""
    try:
        choices = request.choices_of(item.source)
        with_stated(request.options, choices, item.source)
    except (UsageError, UnreadableError) as error:
        if item.refusal is None and why_left_out(item, request.options, asked_for=False) is None:
            why = str(error).removeprefix(f"{printable(item.source)}: ")
            return replace(item, refusal=why)
        return item
    if not choices:
        return item
    return replace(item, stamps=(*item.stamps, stated_stamp(choices)), choices=tuple(choices.values()))


def unfit_patterns(rules: Sequence[FolderRules], items: Sequence[Item]) -> list[str]:
    """Return a note for each pattern of `study.toml` that fits no file."""
    fitting = {(one.path, pattern) for one in rules for item in items for pattern in one.fitting(item.source)}
    every = dict.fromkeys((one.path, pattern) for one in rules for pattern in one.patterns)
    unfit = [one for one in every if one not in fitting]
    return [f'no file fits "{pattern}" of {path}' for path, pattern in unfit]


@dataclass(frozen=True, slots=True)
class _Planning:
    """Fills a plan."""

    study: Study
    ledger: Ledger
    asked: str
    plan: Plan
    changed: list[str]

    def split(self, items: Sequence[Item], lister: Lister) -> list[Item]:
        """Return the items, in place of each file whose sensors are wanted those of its sensors.

        A file that is left for later has the sensors that it had.
        """
        asked, found, unlisted = self.asked, {}, []
        for item in items:
            if item.refusal is not None or not wants_each(item, self.study.request):
                continue
            own = self.ledger.known(item, asked)
            if own is not None and own.row is None:  # not a recording
                continue
            waits = item.aside or self.study.collect or _left_for_later(self.study, item)
            known = self.ledger.known(item, asked, SENSORS)
            last = self.ledger.latest_of(item.name, asked, (SENSORS,)) if waits else []
            if known is not None or last:
                found[item.name] = known or last[-1]
            elif not waits:
                unlisted.append(SensorsTask(item, common_of(self.study)))
        for item, result in lister(unlisted):
            found[item.name] = result.entry
        return [one for item in items for one in self._in_place_of(item, found.get(item.name))]

    def _in_place_of(self, item: Item, entry: Entry | None) -> list[Item]:
        """Return the recordings of an item, by the entry of its sensors."""
        if entry is None:
            return [item]
        if entry.failed:
            self.plan.unlisted[item.name] = entry
            return [item]
        self.plan.sensors.append(entry)
        if entry.stamps == item.stamps:
            self.plan.whole[item.job.report] = item.source
        recordings = in_place_of(item, entry.inputs)
        self.plan.reports |= {one.job.report for one in recordings}
        return recordings

    def looked_at(self, now: Item) -> Item:
        """Return an item; one left for later has the stamps of its last result."""
        if not (now.aside or _left_for_later(self.study, now)):
            return now
        item = self.ledger.as_it_was(now, self.asked)
        self.plan.late.add(now.name)
        if item.stamps != now.stamps:
            self.plan.changing.add(now.name)
        return item

    def recordings(self, items: Sequence[Item]) -> list[Item]:
        """Return the items that are the study's recordings and may be begun."""
        return [item for item in items if not item.aside and self.keeps(item)]

    def keeps(self, item: Item) -> bool:
        """Return True for a recording; of other files, remember that they are not recordings."""
        if item.sensor is not None:
            return True
        entry, named = self.ledger.known(item, self.asked), bool(self.study.where.include)
        request = self.study.request
        if entry is not None and not entry.failed and (entry.row is not None or not named):
            recording, why = entry.row is not None, entry.why
        else:
            options = with_stated(request.options, {one.field: one for one in item.choices}, item.source)
            reason = None if item.refusal is not None else why_left_out(item, options, asked_for=named)
            recording, why = reason is None, None if reason is None else reason.as_json()
        if not recording and self.study.shard.owns(item.name):
            self.plan.left_out.append(Entry(item.name, item.stamps, self.asked, None, why=why))
        return recording

    def place(self, item: Item) -> None:
        """Put a recording of the shard into the list where it belongs."""
        if not self.study.shard.owns(item.name):
            return
        if (fault := self.plan.unlisted.get(item.name)) is not None:
            self.plan.done.append((item, fault))
            return
        study, entry = self.study, self._valid_entry(item)
        begin = not study.collect and item.name not in self.plan.late
        redo = entry is not None and item.refusal is None and _is_redone(study, entry)
        if entry is not None and not (redo and begin):
            self.plan.done.append((item, entry))
        else:
            (self.plan.todo if begin else self.plan.waiting).append(item)
            self._say_why(item)

    def _say_why(self, item: Item) -> None:
        """Keep why a recording is calibrated again, and what it had before."""
        last = self.ledger.latest_own(item.name)
        if why := why_again(last, item, self.asked, self.changed):
            self.plan.why[item.name] = why
            if why.startswith("made by") and last is not None and last.row is not None:
                self.plan.before[item.name] = last.row

    def place_aside(self, item: Item) -> None:
        """Let a recording of the shard that `--include` does not name keep the result that it has, if any."""
        if not (item.aside and self.study.shard.owns(item.name)):
            return
        known = self.ledger.known(item, self.asked)
        if known is not None and known.row is None:
            self.plan.left_out.append(known)
        elif (entry := self._valid_entry(item)) is not None:
            self.plan.done.append((item, entry))
        else:
            self.plan.kept += self.ledger.with_other_options(item, REPLACING)

    def _valid_entry(self, item: Item) -> Entry | None:
        """Return the valid entry of the own result, even if a later round has replaced its outputs."""
        if item.refusal is None:
            own = self.ledger.known(item, self.asked)
            if own is None or not (self.ledger.in_place(own) or self._replaced(item)):
                return None
            outputs = {self.study.out / name for name, _ in own.outputs}
            return own if outputs <= set(item.job.outputs) else None  # else they would get other names now
        kind = UsageError if is_file(item.source) else UnreadableError
        row = summary.failed(item, kind.exit_code, item.refusal)
        return Entry(item.name, item.stamps, self.asked, row, again=True)

    def _replaced(self, item: Item) -> bool:
        """Return True for outputs of a later round, which can be undone if the file is unchanged."""
        rounds = self.study.replacing
        if rounds and item.name not in self.plan.changing:
            rounds = REPLACING
        later = [self.ledger.current(item, self.asked, name) for name in rounds]
        return any(entry is not None and not entry.failed for entry in later)


@dataclass(slots=True)
class RoundPlanner:
    """Decides what is done in a round, and what is taken from an earlier run.

    Attributes:
        untouched: names of recordings that must not be read, since they wait and have changed, and of all
            that would be pooled with one.
    """

    study: Study
    ledger: Ledger
    untouched: set[str] = field(default_factory=set)

    def of(
        self, one: Round, tasks: Sequence[RoundTask]
    ) -> tuple[list[RoundTask], list[tuple[RoundTask, Entry]]]:
        """Return the tasks to do, and those whose earlier entry is taken.

        Recordings that must not be read keep what they have: they are never among the tasks to do.
        """
        todo, taken = [], []
        latest, asked = self.ledger.latest, self.study.asked()
        for task in tasks:
            waits = not self.untouched.isdisjoint(task.names)
            if waits:
                self.untouched |= set(task.names)
            entry = latest(task.item.name, asked, one.name) if waits else self._valid_entry(one, task)
            if entry is not None:
                taken.append((task, entry))
            elif not waits:
                todo.append(task)
        return todo, taken

    def _valid_entry(self, one: Round, task: RoundTask) -> Entry | None:
        """Return the earlier entry of a task if it is what the task would give now."""
        study, entry = self.study, self.ledger.current(task.item, self.study.asked(), one.name)
        if entry is None or _is_redone(study, entry):
            return None
        return entry if task.is_current(entry) else None


def overlooked(study: Study) -> int:
    """Return the number of recordings that are ignored because they lie below OUT.

    Raises:
        UsageError: one of the folders is not a folder.
    """
    options = study.request.options
    return sum(why_left_out(item, options, asked_for=False) is None for item in below_out(study.where))


def _left_for_later(study: Study, item: Item) -> bool:
    """Return True if a recording is too new or too old to be started; an earlier result stays valid.

    One that was changed further in the future than `settle_s` has a wrong time: it would wait for years.
    """
    too_new = study.settle_s > 0 and abs(time.time() - item.changed_s) < study.settle_s
    return too_new or (study.newer_than_s is not None and item.changed_s < study.newer_than_s)


def _is_redone(study: Study, entry: Entry) -> bool:
    """Return True if a recording is done again although neither it nor the settings have changed."""
    return study.request.force or entry.again or (study.retry_failed and entry.failed)
