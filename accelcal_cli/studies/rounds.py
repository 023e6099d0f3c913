"""The work of a study: a `Plan` of the own results, and of each later `Round`, whose tasks depend on them.

All that decides whether an earlier result is valid is here and in the ledger (`records.py`). A worker looks
once more at the report that is there (`pipeline/outputs.py`), for a study whose ledger is lost.
"""

from __future__ import annotations

import contextlib
import json
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from statistics import median
from typing import Any, Protocol

import numpy as np

from accelcal_cli.core import system
from accelcal_cli.core.errors import OutputError, Reason, UnreadableError, UsageError, counted, printable
from accelcal_cli.core.identity import STUDY, refuse_other
from accelcal_cli.core.paths import is_file, is_there, matching, unreadable
from accelcal_cli.core.settings import Settings, setting_of
from accelcal_cli.core.version import __version__
from accelcal_cli.formats import refuse_unused
from accelcal_cli.output.decisions import NAME as DECISIONS
from accelcal_cli.output.decisions import READ, Decisions, Merged, merged, read_decisions
from accelcal_cli.output.files import NAME as TABLE
from accelcal_cli.output.files import looking_at, read_columns
from accelcal_cli.output.numbers import mg
from accelcal_cli.output.report_reading import load_our_json, section
from accelcal_cli.pipeline.jobs import Request
from accelcal_cli.pipeline.options import STUDY_FILE, FolderRules, sidecar_fingerprint, with_stated
from accelcal_cli.studies import summary
from accelcal_cli.studies.discovery import Left, below_out, files, why_left_out, without_collisions
from accelcal_cli.studies.records import Entry, Item, Ledger, RecordingState, TaskFunction
from accelcal_cli.studies.sensors import SENSORS, SensorsTask, in_place_of, wants_each
from accelcal_cli.studies.study import REPLACING, WHOLE, Study
from accelcal_cli.studies.task import Common, Task, TaskResult

# Why earlier results are made again, as after an upgrade, and by how much coefficients changed by
# that.

AXES = "xyz"
OTHER_OPTIONS = "other options"


def said_last(study: Study, notes: list[str]) -> dict[str, Any]:
    """Return what `study.json` says of the last run; empty if that is not known.

    Args:
        notes: receives a line if it is of a version whose results this one does not read.
    """
    path = study.out / f"{study.shard.basename}.json"
    try:
        if (held := load_our_json(path)) is not None:
            refuse_other(held, STUDY, path)
            return held
    except OutputError:
        pass
    except UnreadableError as error:
        error.hint = "its recordings are calibrated again"
        notes.append(str(error))
    return {}


def options_changed(study: Study, last: Mapping[str, Any]) -> list[str]:
    """Return the options whose values differ between the last run and this one, as far as both know them.

    Args:
        last: what `said_last` found.
    """
    before = last.get("settings")
    if not isinstance(before, dict) or not before:
        return [OTHER_OPTIONS]
    now = json.loads(json.dumps(study.settings(), default=str))
    names = [name for name in now.keys() & before.keys() if name != "prior" and now[name] != before[name]]
    return sorted(map(_option, names))


def _option(name: str) -> str:
    if name in Settings.__dataclass_fields__ and (option := setting_of(Settings, name).option) is not None:
        return option.name
    return f"--{name.replace('_', '-')}" if name != "input" else "how recordings are read"


def why_again(last: Entry | None, item: Item, asked: str, options: list[str]) -> str:
    """Return why a recording is calibrated again: `made by 1.0.0`; empty for a new one.

    Args:
        last: its latest own result.
        asked: hash of the settings and the version now.
        options: what `options_changed` found.
    """
    if last is None or last.row is None:
        return ""
    if last.stamps != item.stamps:
        return "changed"
    version = last.row.get("accelcal_version")
    if version != __version__:
        return ", ".join([f"made by {version}", *(one for one in options if one != OTHER_OPTIONS)])
    if last.asked != asked:
        return " ".join(options) or OTHER_OPTIONS
    return "failed before" if last.failed or last.again else "an output is missing"


def upgrade_notice(why: Mapping[str, str]) -> list[str]:
    """Return a line for each reason why several results are made again: another version, or other options."""
    reasons = Counter(one for one in why.values() if one.startswith(("made by", "--", OTHER_OPTIONS)))
    return [
        f"{counted(number, 'result')} to be made again ({one})" for one, number in sorted(reasons.items())
    ]


def changed_coefficients_notice(
    before: Mapping[str, Mapping[str, Any]], after: Mapping[str, Mapping[str, Any]]
) -> str | None:
    """Return a line on how results changed that were made again; None if there are none.

    Args:
        before, after: rows of the table by name.
    """
    both = [(name, before[name], after[name]) for name in before if name in after]
    if not both:
        return None
    sizes = {name: size for name, old, new in both if (size := distance_mg(old, new)) is not None}
    other = sum(old.get("outcome") != new.get("outcome") for _, old, new in both)
    text = f"{counted(len(both), 'result')} made again by {__version__}, {other} with another outcome"
    if not sizes:
        return text
    most = max(sizes, key=lambda name: sizes[name])
    middle = median(sizes.values())
    return f"{text}; coefficients changed by {mg(middle)} mg (median), {mg(sizes[most])} mg at most ({most})"


def distance_mg(old: Mapping[str, Any], new: Mapping[str, Any]) -> float | None:
    """Return how far two calibrations of a sensor differ, over all orientations at rest (RMS)."""
    pairs = [_equation(row) for row in (old, new)]
    if pairs[0] is None or pairs[1] is None:
        return None
    (gain, offset), (other, shifted) = pairs[0], pairs[1]
    try:
        turned = other @ np.linalg.inv(gain) - np.eye(3)
    except np.linalg.LinAlgError:
        return None
    moved = other @ (shifted - offset)
    return 1000 * float(np.sqrt((turned**2).sum() / 3 + moved @ moved))


def _equation(row: Mapping[str, Any]) -> tuple[Any, Any] | None:
    """Return gain and offset [g] of a row; None without a calibration."""
    gain = [[row.get(f"k_{one}{other}") for other in AXES] for one in AXES]
    offset = [row.get(f"offset_{axis}_g") for axis in AXES]
    if None in (*offset, *(value for line in gain for value in line)):
        return None
    return np.array(gain, float), np.array(offset, float)


# The work of a study.

MANY = 1 << 20
"""A number of recordings that keeps all workers busy."""


@dataclass(frozen=True, slots=True)
class StudyState:
    """The results that are known when a round begins.

    Attributes:
        recordings: results of recordings, by name.
        pools: result of each pool of recordings, by the pool's name.
        silent: names of the recordings that lend, pool and teach nothing, since people excluded them.
    """

    recordings: dict[str, RecordingState] = field(default_factory=dict)
    pools: dict[str, Entry] = field(default_factory=dict)
    silent: set[str] = field(default_factory=set)

    def own_rows(self) -> dict[str, dict[str, Any]]:
        """Return the rows of the own results that have a report, by name."""
        own = {name: one.own for name, one in self.recordings.items()}
        return {name: entry.row for name, entry in own.items() if entry.row and not entry.failed}

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
    return Common(
        study.out, replace(study.request, threads=threads, may_replace_result_of_deleted=True), study.asked()
    )


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


Lister = Callable[[Sequence[SensorsTask]], Iterable[tuple[Item, TaskResult]]]
"""Has the sensors of files listed by workers."""


@dataclass(slots=True)
class Plan:
    """The recordings of a study by what is to be done with them, and other files that it found.

    Attributes:
        ledger: what is known of earlier results; asked: `study.asked()`, with which alone an entry is valid.
        last: what `study.json` says of the last run.
        changed: options whose values differ from those of the last run.
        done: recordings whose earlier result is valid, each with its entry.
        todo: recordings to work on.
        waiting: recordings that are not started.
        left_out: entries of files that are not recordings.
        late: names of the recordings that are left for a later run, done before or not.
        untouched: names of recordings that must not be read, since they wait and have changed, and of all
            that would be pooled with one.
        kept: results of earlier runs with other options, of recordings that this run does not name.
        why: why recordings are calibrated again, by name; before: rows of their earlier results.
        reports: reports of all recordings that were found, whatever is done with them.
        listed: all files that were found, except those left out by their names.
        met: recordings that an earlier run found too, or all if OUT held the results of none.
        decisions: what people decided about recordings; None without a file of it.
        by_name: why files were left out without a look at their content, by name.
        notes: lines for the user: patterns of `study.toml` that no file fits, links that are not followed.
        sensors: entries of the sensors of files of which each is a recording.
        unlisted: failures of files whose sensors could not be listed, by name.
        whole: files whose sensors are known, by the report of all of their rows.
    """

    study: Study
    ledger: Ledger
    asked: str
    last: Mapping[str, Any]
    changed: list[str]
    decisions: Decisions | None
    notes: list[str]
    done: list[tuple[Item, Entry]] = field(default_factory=list)
    todo: list[Item] = field(default_factory=list)
    waiting: list[Item] = field(default_factory=list)
    left_out: list[Entry] = field(default_factory=list)
    late: set[str] = field(default_factory=set)
    untouched: set[str] = field(default_factory=set)
    kept: list[Entry] = field(default_factory=list)
    by_name: Left = field(default_factory=dict)
    reports: set[Path] = field(default_factory=set)
    listed: list[Item] = field(default_factory=list)
    met: set[Path] = field(default_factory=set)
    why: dict[str, str] = field(default_factory=dict)
    before: dict[str, dict[str, Any]] = field(default_factory=dict)
    sensors: list[Entry] = field(default_factory=list)
    unlisted: dict[str, Entry] = field(default_factory=dict)
    whole: dict[Path, Path] = field(default_factory=dict)

    def reasons(self) -> Left:
        """Return why files are left out, by name, of those that the shard owns."""
        looked_at = {one.name: Reason(**one.why) for one in self.left_out if one.why}
        by_name = {name: why for name, why in self.by_name.items() if self.study.shard.owns(name)}
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

    def wants(self, item: Item) -> bool:
        """Return True for a file that no `study.toml` excludes; of others, remember that one does."""
        excluded = any(one.excludes(item.source) for one in self.study.request.rules)
        if excluded:
            self.by_name[item.name] = Reason.of("excluded", by=STUDY_FILE)
        return not excluded

    def split(self, items: Sequence[Item], lister: Lister) -> list[Item]:
        """Return the items, in place of each file whose sensors are wanted those of its sensors.

        A file that is left for later has the sensors that it had.
        """
        found, unlisted = {}, []
        for item in items:
            if item.refusal is not None or not wants_each(item, self.study.request):
                continue
            if (own := self.ledger.known(item, self.asked)) is not None and own.row is None:
                continue  # it is not a recording
            waits = item.aside or self.study.collect or _left_for_later(self.study, item)
            if (entry := self._sensors_of(item, waits=waits)) is not None:
                found[item.name] = entry
            elif not waits:
                unlisted.append(SensorsTask(item, common_of(self.study)))
        found |= {item.name: result.entry for item, result in lister(unlisted)}
        return [one for item in items for one in self._recordings_of(item, found.get(item.name))]

    def _sensors_of(self, item: Item, *, waits: bool) -> Entry | None:
        """Return the entry of a file's sensors; of one that waits the last, even if the file has changed."""
        known = self.ledger.known(item, self.asked, SENSORS)
        if known is None and waits:
            last = next(reversed(self.ledger.entries(item.name, SENSORS)), None)
            return last if last is not None and last.asked == self.asked else None
        return known

    def _recordings_of(self, item: Item, entry: Entry | None) -> list[Item]:
        """Return the recordings of an item, by the entry of its sensors."""
        if entry is None:
            return [item]
        if entry.failed:
            self.unlisted[item.name] = entry
            return [item]
        self.sensors.append(entry)
        if entry.stamps == item.stamps:
            self.whole[item.job.report] = item.source
        recordings = in_place_of(item, entry.inputs)
        self.reports |= {one.job.report for one in recordings}
        return recordings

    def looked_at(self, item: Item) -> Item:
        """Return an item; one left for later has the stamps of its last own result."""
        if not (item.aside or _left_for_later(self.study, item)):
            return item
        self.late.add(item.name)
        own = [one for one in self.ledger.entries(item.name) if one.asked == self.asked and one.row]
        if not own or own[-1].stamps == item.stamps:
            return item
        self.untouched.add(item.name)
        return replace(item, stamps=own[-1].stamps)

    def recordings(self, items: Sequence[Item]) -> list[Item]:
        """Return the items that are the study's recordings and may be begun."""
        return [item for item in items if not item.aside and self.keeps(item)]

    def keeps(self, item: Item) -> bool:
        """Return True for a recording; of other files, remember that they are not recordings."""
        if item.sensor is not None:
            return True
        entry, named = self.ledger.known(item, self.asked), bool(self.study.where.include)
        if entry is not None and not entry.failed and (entry.row is not None or not named):
            recording, why = entry.row is not None, entry.why
        else:
            choices = {one.field: one for one in item.choices}
            options = with_stated(self.study.request.options, choices, item.source)
            reason = None if item.refusal is not None else why_left_out(item, options, asked_for=named)
            recording, why = reason is None, None if reason is None else reason.as_json()
        if not recording and self.study.shard.owns(item.name):
            self.left_out.append(Entry(item.name, item.stamps, self.asked, None, why=why))
        return recording

    def place(self, item: Item) -> None:
        """Put a recording of the shard into the list where it belongs; keep why it is calibrated again."""
        if not self.study.shard.owns(item.name):
            return
        if (fault := self.unlisted.get(item.name)) is not None:
            self.done.append((item, fault))
            return
        entry = self._valid_entry(item)
        begin = not self.study.collect and item.name not in self.late
        redo = entry is not None and item.refusal is None and _is_redone(self.study, entry)
        if entry is not None and not (redo and begin):
            self.done.append((item, entry))
            return
        (self.todo if begin else self.waiting).append(item)
        last = next(reversed(self.ledger.entries(item.name)), None)
        if why := why_again(last, item, self.asked, self.changed):
            self.why[item.name] = why
            if why.startswith("made by") and last is not None and last.row is not None:
                self.before[item.name] = last.row

    def place_aside(self, item: Item) -> None:
        """Let a recording of the shard that `--include` does not name keep the result that it has, if any."""
        if not (item.aside and self.study.shard.owns(item.name)):
            return
        known = self.ledger.known(item, self.asked)
        if known is not None and known.row is None:
            self.left_out.append(known)
        elif (entry := self._valid_entry(item)) is not None:
            self.done.append((item, entry))
        else:
            self.kept += self.with_other_options(item)

    def with_other_options(self, item: Item) -> list[Entry]:
        """Return the own result that a run with other options left, then the one that replaced it.

        The list is empty if the outputs of its last entry are not there."""
        own = [one for one in self.ledger.entries(item.name) if one.row is not None][-1:]
        later = [one for name in REPLACING for one in self.ledger.entries(item.name, name)[-1:]]
        there = [one for one in later if own and one.asked == own[0].asked and self.ledger.in_place(one)]
        last = (own + there)[-1:]
        return own + there[-1:] if last and self.ledger.in_place(last[0]) else []

    def _valid_entry(self, item: Item) -> Entry | None:
        """Return the valid entry of the own result, even if a later round has replaced its outputs.

        What a later round replaced can be undone if the file is unchanged.
        """
        if item.refusal is not None:
            kind = UsageError if is_file(item.source) else UnreadableError
            row = summary.failed(item, kind.exit_code, item.refusal)
            return Entry(item.name, item.stamps, self.asked, row, again=True)
        own, rounds = self.ledger.known(item, self.asked), self.study.replacing
        if own is None or own.row is None:  # it was left out, but --include names it now
            return None
        if rounds and item.name not in self.untouched:
            rounds = REPLACING
        later = (self.ledger.known(item, self.asked, name) for name in rounds)
        held = chain((own,), (one for one in later if one is not None and not one.failed))
        outputs = {self.study.out / name for name, _ in own.outputs}  # of a job that may have other names now
        return own if any(map(self.ledger.in_place, held)) and outputs <= set(item.job.outputs) else None

    def tasks_of(
        self, one: Round, tasks: Sequence[RoundTask]
    ) -> tuple[list[RoundTask], list[tuple[RoundTask, Entry]]]:
        """Return the tasks of a later round to do, and those whose earlier entry is taken.

        Recordings that must not be read keep what they have: they are never among the tasks to do.
        """
        todo, taken = [], []
        for task in tasks:
            if self.untouched.isdisjoint(task.names):
                entry = self.ledger.known(task.item, self.asked, one.name)
                if entry is None or _is_redone(self.study, entry) or not self.ledger.in_place(entry):
                    entry = None
                if entry is not None and task.is_current(entry):
                    taken.append((task, entry))
                else:
                    todo.append(task)
            else:
                self.untouched |= set(task.names)
                earlier = reversed(self.ledger.entries(task.item.name, one.name))
                good = (entry for entry in earlier if entry.asked == self.asked and not entry.failed)
                if (last := next(filter(self.ledger.in_place, good), None)) is not None:
                    taken.append((task, last))
        return todo, taken


def plan(study: Study, ledger: Ledger, lister: Lister = lambda _tasks: ()) -> Plan:
    """Look at all files and decide what there is to do; writes nothing.

    Raises:
        UsageError: one of the folders is not a folder, or they hold no recording, or none for which an option
            means anything; or there is no file of decisions of the name that was given.
        UnreadableError: decisions cannot be read; exclusions must not be lost in silence.
    """
    notes: list[str] = []
    last = said_last(study, notes)
    found = Plan(
        study, ledger, study.asked(), last, options_changed(study, last), _decisions(study, last), notes
    )
    listed = found.listed = files(study.where, notes, found.by_name)
    if not (listed or found.by_name):
        hint = "check the path, and that its disk is mounted"
        raise UsageError("holds no file that may be a recording", path=study.where.folders[0], hint=hint)
    notes += unfit_patterns(study.request.rules, listed)
    found.reports |= {item.job.report for item in listed}
    wanted = [item for item in listed if found.wants(item)]
    # a shard looks at its own files, and at those that share their outputs
    owned = {item.job.report for item in wanted if study.shard.owns(item.name)}
    concerned = [as_stated(item, study.request) for item in wanted if item.job.report in owned]
    items = [found.looked_at(item) for item in found.split(concerned, lister)]
    recordings = without_collisions(found.recordings(items))
    try:
        _require_use(study, recordings)
    except UsageError:  # which other shards' recordings may have
        others = [as_stated(item, study.request) for item in wanted if item.job.report not in owned]
        _require_use(study, [*recordings, *found.recordings([found.looked_at(item) for item in others])])
    met = {item.source for item in items if any(one.row for one in ledger.entries(item.name))}
    found.met = met or {item.source for item in recordings}
    for item in recordings:
        found.place(item)
    for item in items:
        found.place_aside(item)
    return found


def _decisions(study: Study, last: dict[str, Any]) -> Decisions | None:
    """Return what people decided; nothing for a shard, whose table nobody decides by.

    Args:
        last: what `study.json` says of the last run.
    """
    path = study.decisions or study.out / DECISIONS
    if not study.shard.whole or (study.decisions is None and not is_there(path)):
        return None
    gone = section(last, "decisions", "gone").items()
    table, known = (
        [],
        {
            name: tuple(one)
            for name, one in gone
            if isinstance(one, list) and all(isinstance(part, str | None) for part in one)
        },
    )
    with contextlib.suppress(UnreadableError):  # of another version, which names the recordings again
        table = read_columns(study.out / TABLE, READ).to_pylist()
    try:
        return replace(read_decisions(path), last=table, gone=known)
    except FileNotFoundError as error:
        raise UsageError("there is no such file", path=path, hint="correct or omit --decisions") from error
    except OSError as error:
        raise unreadable(error, path) from error


def _require_use(study: Study, recordings: list[Item]) -> None:
    """Raise UsageError if there are no recordings, or none for which an option means anything."""
    if not recordings:
        hint = "give --format, or name files with --include"
        raise UsageError("no recording was found", path=study.where.folders[0], hint=hint)
    refuse_unused([item.source for item in recordings], study.request.options)


def as_stated(item: Item, request: Request) -> Item:
    """Return an item with the options that files state for it; refused if they make no sense."""
    try:
        choices = request.choices_of(item.source)
        with_stated(request.options, choices, item.source)
    except (UsageError, UnreadableError) as error:
        if item.refusal is None and why_left_out(item, request.options, asked_for=False) is None:
            return replace(item, refusal=str(error).removeprefix(f"{printable(item.source)}: "))
        return item
    if not choices:
        return item
    return replace(item, stamps=(*item.stamps, sidecar_fingerprint(choices)), choices=tuple(choices.values()))


def unfit_patterns(rules: Sequence[FolderRules], items: Sequence[Item]) -> list[str]:
    """Return a note for each pattern of `study.toml` that fits no file."""
    fitting = {(one.path, pattern) for one in rules for item in items for pattern in one.fitting(item.source)}
    every = dict.fromkeys((one.path, pattern) for one in rules for pattern in one.patterns)
    return [
        f'no file fits "{pattern}" of {path}' for path, pattern in every if (path, pattern) not in fitting
    ]


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
