"""A study from beginning to end: take the lock, plan, carry out each round, write the summary.

`preview` (`--dry-run`) only says what a run would do.
"""

from __future__ import annotations

import contextlib
import functools
import json
import logging
import time
from collections import ChainMap
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence, Set
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Protocol

from accelcal_cli.core.errors import LockedError, OutputError, UsageError, counted, printable
from accelcal_cli.core.paths import is_folder, is_there, matching
from accelcal_cli.core.results import Outcome
from accelcal_cli.output.decisions import Merged, of_another_name
from accelcal_cli.output.files import disk_errors, looking_at, sweep, sweep_left
from accelcal_cli.output.sentences import clause, copied
from accelcal_cli.pipeline.jobs import sha256
from accelcal_cli.pipeline.outputs import withdraw
from accelcal_cli.studies import executors, findings, lock, orphans, other_recordings, summary
from accelcal_cli.studies.discovery import SUMMARY, Left, job_without_others, places, refuse_foreign
from accelcal_cli.studies.lock import Lease
from accelcal_cli.studies.records import (
    FAILED,
    OWN,
    Entry,
    Finished,
    Item,
    Ledger,
    RecordingState,
    TaskFunction,
    TaskProgress,
    shared_row,
)
from accelcal_cli.studies.rounds import (
    Plan,
    Round,
    RoundTask,
    StudyState,
    changed_coefficients_notice,
    common_of,
    ledger_of,
    plan,
    upgrade_notice,
    workers_of,
)
from accelcal_cli.studies.sensors import SensorsTask, listed
from accelcal_cli.studies.study import REPLACING, Study
from accelcal_cli.studies.summary import Summary
from accelcal_cli.studies.task import BUG, NO_MEMORY, CalibrationTask, Task, TaskResult, calibrated

LOG = logging.getLogger("accelcal")
"""Receives what happens, for `--log` and for programs that listen."""

PRELOAD = "accelcal_cli.studies.preload"

TABLE_S, TABLE_TIMES = 5.0, 20.0
"""Shortest time between updates of the table while a study runs, [s] and as a multiple of an update's."""


class StudyObserver(Protocol):
    """Receives what happens while a study runs."""

    def begin(self, items: Sequence[Item]) -> None:
        """Called before these recordings are worked on."""

    def advance(self, bytes_done: float) -> None:
        """Called with the number of further bytes that are done."""

    def note(self, text: str) -> None:
        """Called with a line for the user."""

    def found(self, line: str, *, new: bool) -> None:
        """Called with what a person must act on, and whether the last run did not say so."""

    def finished(self, item: Item, result: TaskResult) -> None:
        """Called with a recording's last result: it is done, was done before, or failed."""

    def stopped(self, done: int) -> None:
        """Called if the run ends early, with the number of recordings that have their result."""


def rounds(study: Study) -> tuple[Round, ...]:
    """Return the rounds after that of the own results; a shard, which may split a device, has none."""
    if not study.shard.whole:
        return ()
    of = other_recordings
    wanted = ((of.POOLING, study.pool), (of.APPLY_POOLS, study.pool), (of.BORROWING, study.borrow))
    return tuple(one for one, asked in (*wanted, (of.LEARNING, study.prior is not None)) if asked)


def run(study: Study, observer: StudyObserver) -> Summary:
    """Carry out a study.

    Raises:
        UsageError: see `plan`; or OUT holds the results of other folders, there is nothing to collect, or
            `--prune` would remove too much.
        UnreadableError: decisions cannot be read.
        LockedError: another run works in the output folder, or has taken this one over.
        OutputError: the folder or the summary cannot be written, or would overwrite what no study wrote.
    """
    places(study.where)
    try:
        study.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot be made ({error.strerror or error})", path=study.out) from error
    with lock.locked(study.lock, lambda: _other_locks(study)) as lease, closing(ledger_of(study)) as ledger:
        study_run = StudyRun(study, ledger, observer, lease)
        study_run.begin()
        study_run.carry_out()
        return study_run.finish()


def unlock(study: Study) -> lock.Lock | None:
    """Remove the study's lock, whether or not its run has ended; returns it, None if there is none.

    Raises:
        OutputError: it cannot be removed, or is not a lock.
    """
    with disk_errors(study.lock):
        if (found := lock.read_lock(study.lock)) is not None:
            lock.remove(study.lock, found.text)
    return found


def _other_locks(study: Study) -> tuple[Path, ...]:
    """Return the locks that exclude this run: the whole study and its shards exclude each other."""
    if study.shard.whole:
        with looking_at(study.out):
            return tuple(matching(study.out, "study.*-of-*.lock"))
    return (study.out / "study.lock",)


def _orphans(
    plan: Plan, rows: Sequence[Mapping[str, Any]], folders: Sequence[orphans.Folder]
) -> orphans.Orphans:
    """Find results whose recording is gone; none for a shard, which does not know all recordings."""
    study = plan.study
    return orphans.Orphans(study.where, plan.reports, rows, plan.whole, folders, plan.met, study.shard.whole)


def _refuse(plan: Plan) -> list[orphans.Folder]:
    """Refuse what must not be done; return the folders of the last run.

    Raises:
        UsageError: OUT holds the results of other folders, there is nothing to collect, or `--prune` would
            remove too much.
        OutputError: what no study wrote would be overwritten.
    """
    study, sources = plan.study, [item.source for item in plan.items()]
    refuse_foreign(study.out, study.shard.basename, sources, force=study.request.force)
    if study.collect and plan.waiting and not plan.done:
        text = f"no results of {counted(len(plan.waiting), 'recording')} were found for these options"
        raise UsageError(text, hint="run the parts first, or give --collect the options used for them")
    return orphans.folders_before(study, plan.listed)


def _say_orphans(left: Sequence[orphans.Orphan], what: str, note: Callable[[str], None]) -> None:
    for one in left:
        note(f"{printable(one.name)} {what}: {clause(one.reason)}")


def _refuse_pruning(plan: Plan, left: Sequence[orphans.Orphan]) -> None:
    """Raise UsageError if `--prune` would remove more results than stay: a disk may be missing."""
    stay = {*(item.name for item in plan.items()), *(entry.name for entry in plan.kept)}
    if plan.study.prune and len(left) > len(stay) and not plan.study.request.force:
        what = f"--prune would remove {counted(len(left), 'result')}, more than the {len(stay)} that stay"
        hint = "check that all disks are there; --force removes them, and calibrates all recordings again"
        raise UsageError(what, hint=hint)


class StudyRun:
    """A study while it is carried out.

    Attributes:
        lease: the lock that allows it to write in OUT, confirmed before each write that two runs must not do.
        plan: the plan at its beginning.
        known: what is known of the recordings by now.
        worked: names of the recordings that were given to a worker.
    """

    def __init__(self, study: Study, ledger: Ledger, observer: StudyObserver, lease: Lease) -> None:
        self.study = study
        self.lease = lease
        self.known = StudyState()
        self._ledger = ledger
        self._observer = observer
        self._rounds = rounds(study)
        self._pending: dict[str, TaskResult] = {}
        self.plan = plan(study, ledger, self._list_sensors)
        self._table_due = time.monotonic() + TABLE_S
        self.worked = {*self.plan.unlisted}

    def _list_sensors(self, tasks: Sequence[SensorsTask]) -> Iterator[tuple[Item, TaskResult]]:
        """Have the sensors of files listed, and keep them."""
        for item, result in results(self.study, listed, tasks, self._observer):
            if not result.entry.failed:
                self._remember(result.entry)
            yield item, result

    def begin(self) -> None:
        """Refuse what must not be done, say what there is to do, and remove what killed runs left.

        Raises UsageError and OutputError; see `run`.
        """
        study, plan = self.study, self.plan
        self._folders = _refuse(plan)
        for text in (*plan.notes, *upgrade_notice(plan.why)):
            self._observer.note(printable(text))
        if study.prune:
            _refuse_pruning(plan, _orphans(plan, (), self._folders).found)
        counts = [len(plan.todo), len(plan.done), len(plan.waiting), len(plan.left_out) + len(plan.by_name)]
        LOG.info("planned: %d to do, %d done, %d waiting, %d left out", *counts)
        executors.sweep_folders()  # of runs that were killed, on this machine or another
        outputs = [path for item in (*plan.todo, *plan.waiting) for path in item.job.outputs]
        sweep_left([*outputs, *map(study.lock.with_suffix, (".lock", ".ledger", *SUMMARY))])

    def carry_out(self) -> None:
        """Carry out all rounds; if they fail, the table has what is done so far."""
        try:
            self._carry_out()
        except BaseException:
            self._write_table()
            self._observer.stopped(len(self.known.recordings))
            raise

    def finish(self) -> Summary:
        """Say what became of earlier results, remove what does not hold any more, and write the summary.

        Raises UsageError, LockedError and OutputError; see `run`.
        """
        study, plan = self.study, self.plan
        rows, decisions = self._rows(plan.kept)
        made = {name: one.last.row or {} for name, one in self.known.recordings.items()}
        if (change := changed_coefficients_notice(plan.before, made)) is not None:
            self._observer.note(printable(change))
        gone = _orphans(plan, rows, self._folders)
        left = gone.found
        _refuse_pruning(plan, left)
        if study.prune:
            orphans.prune(left)
            _say_orphans(left, "removed", self._observer.note)
        found = [
            *findings.of_orphans(gone, pruned=study.prune),
            *findings.of_rows(rows),
            *findings.of_pools(self._pools()),
            *findings.of_times(rows),
            *findings.of_decisions(decisions, plan.last),  # of which there may be most
        ]
        for line, new in findings.lines(found, plan.last):
            self._observer.found(line, new=new)
        states, now = self.known.recordings, time.time()
        now_in = orphans.folders_now(study.where, self._folders, plan.met)
        result = Summary(
            rows=rows,
            decisions=decisions,
            settings=_settings(study),
            waiting=len(plan.waiting),
            ahead=sum(item.changed_s > now for item in plan.waiting),
            left_out=len(plan.left_out),
            files_left_out=plan.reasons(),
            kept=len({entry.name for entry in plan.kept}),
            orphans=[] if study.prune else [one.as_json() for one in left],
            up_to_date=sum(states[name].item.refusal is None for name in set(states) - self.worked),
            pools=self._pools(),
            findings=findings.as_json(found),
            provenance={orphans.FOLDERS: [asdict(one) for one in now_in]},
        )
        LOG.info("outcomes: %s; unchanged: %d", json.dumps(result.outcomes()), result.up_to_date)
        self.lease.confirm()
        summary.write(result, study.out, study.shard.basename)
        self.lease.confirm()
        self._ledger.tidy(self._entries())
        if study.shard.whole and not (plan.waiting or study.where.include):
            other_recordings.remove_pools(study.out, keep=self.known.pools)
        return result

    def _pools(self) -> dict[str, dict[str, Any]]:
        return {name: one.row or {} for name, one in sorted(self.known.pools.items())}

    def _entries(self) -> Iterator[Entry]:
        """Yield the entries to keep; those of waiting recordings may serve a run with other options."""
        for state in self.known.recordings.values():
            yield state.own
            if state.last is not state.own:
                yield state.last
        yield from (*self.known.pools.values(), *self.plan.sensors, *self.plan.left_out, *self.plan.kept)
        for item in self.plan.waiting:
            for name in (OWN, *REPLACING):
                last = self._ledger.entries(item.name, name)[-1:]
                yield from (entry for entry in last if entry.asked == self.plan.asked)

    def _rows(self, kept: Sequence[Entry]) -> tuple[list[Mapping[str, Any]], Merged | None]:
        """Return the rows of the table by name, and what people decided about them; None if nobody did.

        Those of `kept` stand where there is no newer result. Rows of copies name the recording that counts,
        and what a person decided is in its place.
        """
        last = {entry.name: entry.row for entry in kept}
        last |= {name: one.last.row for name, one in self.known.recordings.items()}
        rows = {name: row for name, row in sorted(last.items()) if row is not None}
        decided = self.plan.merged(rows.values())
        changes, excluded = ({}, set()) if decided is None else (decided.changes, decided.excluded)
        more: dict[str, dict[str, Any]] = {
            name: dict(changes.get(row["path"], {})) for name, row in rows.items()
        }
        for name, first in summary.copies(rows, excluded).items():
            more[name]["copy_of"] = printable(first)
        # a row of a hundred columns is not copied for some of them
        return [ChainMap(more[name], row) if more[name] else row for name, row in rows.items()], decided

    def _write_table_if_due(self) -> None:
        """Update `study.csv` while the study runs, if the last update is long enough ago."""
        began = time.monotonic()
        if began >= self._table_due:
            self._write_table()
            now = time.monotonic()
            self._table_due = now + max(TABLE_S, TABLE_TIMES * (now - began))

    def _write_table(self) -> None:
        """Update `study.csv`; a failure is reported at the end of the study only."""
        rows, _ = self._rows(self._before)
        with contextlib.suppress(OutputError, LockedError):
            if rows:
                self.lease.confirm()
                summary.write_csv(rows, self.study.out, self.study.shard.basename)

    @functools.cached_property
    def _before(self) -> list[Entry]:
        """Earlier results of the recordings that are not done yet."""
        left = (*self.plan.todo, *self.plan.waiting)
        return [*self.plan.kept, *(entry for item in left for entry in self.plan.with_other_options(item))]

    def _carry_out(self) -> None:
        plan = self.plan
        for item, entry in plan.done:
            known, refused = self._ledger.known(item, entry.asked), item.name in plan.unlisted
            # an earlier run reported the same, but a refusal by place or name may be new
            reported = not (refused or item.refusal) or (known is not None and known.row == entry.row)
            self._own(item, TaskResult(entry, up_to_date=reported))
        self.lease.confirm()
        for item in plan.todo:
            if item.job != (alone := job_without_others(item)):
                withdraw(alone, item.sensor)
        self._calibrate(plan.todo)
        copies = summary.copies(self.known.own_rows()).items()
        again = [pair for pair in copies if not of_another_name(*pair)]  # the others are findings
        self.known.silent.update(_silent(plan, self.known))
        notes = other_recordings.without_prior(self.study, self.known)
        for text in (*(printable(f"{name}: {copied(first)}") for name, first in again), *notes):
            self._observer.note(text)
        for one in self._rounds:
            tasks = list(one.tasks(self.study, self.known))
            if one is self._rounds[-1]:
                self._restore({task.item.name for task in tasks})
            self._later(one, tasks)
        if self._rounds:
            self._restore(frozenset())
            for name in sorted(self._pending):
                self._report(self.known.recordings[name].item, self._pending[name])

    def _calibrate(self, items: Sequence[Item]) -> None:
        common = common_of(self.study, len(items))
        tasks = [CalibrationTask(item, common) for item in items]
        for item, result in results(self.study, calibrated, tasks, self._observer):
            self.worked.add(item.name)
            self._remember(result.entry)
            self._own(item, result)
            self._write_table_if_due()

    def _remember(self, entry: Entry) -> None:
        self.lease.confirm()
        self._ledger.add(entry)

    def _own(self, item: Item, result: TaskResult) -> None:
        """Set an own result, and report it if no later round can replace it."""
        self.known.recordings[item.name] = RecordingState(item, result.entry, result.entry)
        self._pending.pop(item.name, None)
        if self._rounds and not result.entry.failed:
            self._pending[item.name] = result
        else:
            self._report(item, result)

    def _report(self, item: Item, result: TaskResult) -> None:
        """Report a result; one of a recording that `--include` does not name only if it is new."""
        if not (item.aside and result.up_to_date):
            self._observer.finished(item, result)

    def _restore(self, concerned: Set[str]) -> None:
        """Put own results back that an earlier run replaced and this one does not.

        This is done once all replacements are known, and before other recordings' reports are read.
        """
        left_alone = concerned | self.plan.untouched
        others = [one for name, one in sorted(self.known.recordings.items()) if name not in left_alone]
        own = [one for one in others if one.last is one.own]
        self._calibrate([one.item for one in own if not self._ledger.in_place(one.own)])

    def _later(self, one: Round, tasks: Sequence[RoundTask]) -> None:
        todo, taken = self.plan.tasks_of(one, tasks)
        for task, entry in taken:
            self._take(one, task.item, TaskResult(entry, up_to_date=True))
        for item, result in results(self.study, one.work, todo, self._observer):
            self._remember(result.entry)
            self._take(one, item, result)
            self.worked |= set() if one.of_pools else {item.name}
            self._write_table_if_due()

    def _take(self, one: Round, item: Item, result: TaskResult) -> None:
        self.known.take(one, item.name, result.entry)
        if not one.of_pools:
            self._pending[item.name] = result


def _silent(plan: Plan, known: StudyState) -> set[str]:
    """Return the names of the recordings that lend, pool and teach nothing, since people excluded them."""
    rows = {name: one.own.row for name, one in known.recordings.items() if one.own.row is not None}
    if plan.study.keep_teaching or not rounds(plan.study) or (found := plan.merged(rows.values())) is None:
        return set()
    return {name for name, row in rows.items() if row["path"] in found.excluded}


def _settings(study: Study) -> dict[str, Any]:
    """Return all settings that decide the results."""
    own, rules = study.settings(), study.request.rules
    several = len({one.folder for one in rules}) > 1
    stated = {(f"{one.folder.name}/" if several else "") + one.path.name: one.as_json() for one in rules}
    later = {"prior": study.prior or own["prior"], "pool": study.pool, "borrow": study.borrow}
    later |= {"keep_teaching": True} if study.keep_teaching else {}
    return {**own, **later, **({"stated": stated} if stated else {})}


def results(
    study: Study, work: TaskFunction, tasks: Sequence[Any], observer: StudyObserver | None = None
) -> Iterator[tuple[Item, TaskResult]]:
    """Have tasks done, the largest first, so that the last to end is a small one."""
    if not tasks:
        return
    if observer is not None:
        observer.begin([task.item for task in tasks])
    texts: dict[str, str] = {}
    began: dict[str, float] = {}
    reached: dict[str, float] = {}
    ordered = sorted(tasks, key=lambda task: (-task.item.size, task.item.name))

    def moved(task: Task, part: float) -> None:
        name = task.item.name
        if part < 1 and name not in began:
            began[name] = time.monotonic()
            LOG.info("begun: %s (%d bytes)", name, task.item.size)
        if observer is not None:
            observer.advance((part - reached.get(name, 0.0)) * task.item.size)
        reached[name] = part

    with contextlib.closing(_done(study, work, ordered, moved)) as ended:
        for one in ended:
            result = _result(one)
            _log_end(one.task.item.name, result, began)
            yield one.task.item, replace(result, entry=shared_row(result.entry, texts))


def _log_end(name: str, result: TaskResult, began: Mapping[str, float]) -> None:
    """Log what became of a recording or a pool, how long it took if that is known, and its problems."""
    row = result.entry.row or {}
    seconds = f" after {time.monotonic() - began[name]:.1f} s" if name in began else ""
    code = "" if row.get("exit_code") is None else f", exit code {row['exit_code']}"
    LOG.info("ended: %s: %s%s%s", name, row.get("outcome", "sensors listed"), code, seconds)
    if row.get("outcome") in (FAILED, Outcome.REFUSED):
        LOG.info("why: %s: %s: %s", name, row.get("reason") or row["outcome"], row.get("message"))
    for problem in result.problems:
        LOG.info("problem: %s: %s", name, problem)


def _result(ended: Finished) -> TaskResult:
    if ended.fault is None:
        result: TaskResult = ended.result
        return result
    task: Task = ended.task
    for path in task.item.job.outputs:
        with contextlib.suppress(OSError):
            sweep(path)
    code = NO_MEMORY if ended.lacking else BUG
    return TaskResult(task.failure(code, ended.fault, again=ended.retry))


def _done(
    study: Study, work: TaskFunction, tasks: list[Any], on_progress: TaskProgress
) -> Generator[Finished, None, None]:
    """Have tasks done, several at a time; the failure of one does not affect the others.

    An executor finds the own results only: later rounds, which compare recordings, are done on this machine.
    """
    if study.executor is not None and work is calibrated:
        with study.executor() as executor:
            yield from executors.done_by(executor, executors.work_for(study), tasks, on_progress)
    elif study.in_process or executors.may_not_start_processes():
        yield from executors.done_here(work, tasks, on_progress)
    else:
        number = workers_of(study, len(tasks))
        yield from executors.ProcessPool(work, number, study.timeout_s, PRELOAD, on_progress).run(tasks)


def preview(study: Study, note: Callable[[str], None]) -> tuple[dict[Item, str], Left, dict[str, str]]:
    """Return what a run would do with each recording: `todo`, `waiting`, or the outcome that it has.

    The tasks of later rounds are decided by what is known now; nothing is locked or written. The second part
    says which files are left out, and why; the third why recordings are calibrated again.

    Args:
        note: called with each line for the user.

    Raises:
        UsageError: see `plan`.
        OutputError: a file is where the output folder should be.
    """
    places(study.where)
    existing = next(path for path in (study.out, *study.out.absolute().parents) if is_there(path))
    if not is_folder(existing):
        raise OutputError("cannot be made: a file is in its place", path=existing)
    planned = plan(study, ledger_of(study), lambda tasks: results(study, listed, tasks))
    for text in planned.notes:
        note(printable(text))
    folders = _refuse(planned)
    known = StudyState({item.name: RecordingState(item, entry, entry) for item, entry in planned.done})
    known.silent.update(_silent(planned, known))
    states = dict.fromkeys(planned.todo, "todo") | dict.fromkeys(planned.waiting, "waiting")
    for one in rounds(study):
        todo, taken = planned.tasks_of(one, one.tasks(study, known))
        states |= {known.recordings[name].item: "todo" for task in todo for name in task.names}
        for task, entry in taken:
            known.take(one, task.item.name, entry)
    rows = {one.item: one.last.row or {} for one in known.recordings.values()}
    sizes = _orphans(planned, (), folders).sizes
    new = [item for item in planned.todo if item.size in sizes and item.refusal is None]
    named = [{"path": item.name, "sha256": sha256(item.source), "sensor": item.sensor} for item in new]
    left = _orphans(planned, [*rows.values(), *named], folders).found
    _say_orphans(left, "would be removed" if study.prune else findings.STAYS, note)
    _refuse_pruning(planned, left)
    of_now = {item: row["outcome"] for item, row in rows.items() if not item.aside} | states
    return of_now, planned.reasons(), planned.why
