"""A study from beginning to end: lock, find out what is left to do in each round, do it, sum up.

With `--dry-run` it only says what it would do.
"""

from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Callable, Iterator, Sequence, Set
from contextlib import closing
from pathlib import Path
from typing import Any, Protocol

from accelcal_cli.core.errors import LockedError, OutputError, UsageError, counted, printable
from accelcal_cli.core.version import __version__
from accelcal_cli.output.files import disk_errors, looking_at, sweep, sweep_host, sweep_of
from accelcal_cli.pipeline.outputs import withdraw
from accelcal_cli.studies import lock, summary
from accelcal_cli.studies.borrowing import BORROWING
from accelcal_cli.studies.cluster import Cluster, Notify, WorkerRequirements, calibrate_in_user_folder, code
from accelcal_cli.studies.discovery import SUMMARY, as_if_alone, places, refuse_foreign
from accelcal_cli.studies.lock import Lease
from accelcal_cli.studies.pooling import APPLY_POOLS, POOLING, copies_of, remove_pools, said_of_copy
from accelcal_cli.studies.prior import LEARNING, without_prior
from accelcal_cli.studies.process_pool import ProcessPool, sweep_folders
from accelcal_cli.studies.records import (
    OWN,
    Entry,
    Executor,
    Finished,
    Item,
    Ledger,
    ProgressDelta,
    RecordingState,
    TaskFunction,
)
from accelcal_cli.studies.rounds import (
    Plan,
    Round,
    RoundPlanner,
    RoundTask,
    StudyState,
    common_of,
    ledger_of,
    plan,
    workers_of,
)
from accelcal_cli.studies.study import REPLACING, Study
from accelcal_cli.studies.summary import Summary
from accelcal_cli.studies.task import BUG, NO_MEMORY, CalibrationTask, Task, TaskResult, calibrated

PRELOAD = "accelcal_cli.studies.preload"

TABLE_S, TABLE_TIMES = 5.0, 20.0
"""While a study runs, the table is brought up to date after so long, and so many times what that takes."""


class StudyObserver(Protocol):
    """Who is informed while a study runs."""

    def begin(self, items: Sequence[Item]) -> None:
        """Before these recordings are worked on."""

    def advance(self, bytes_done: float) -> None:
        """So many more bytes are done."""

    def finished(self, item: Item, result: TaskResult) -> None:
        """A recording's last result is there: it is done, was done before, or failed."""

    def note(self, text: str) -> None:
        """What a person should know meanwhile."""


def rounds(study: Study) -> tuple[Round, ...]:
    """The rounds after that of the own results; a shard has none, since a device may have several shards."""
    if not study.shard.whole:
        return ()
    wanted = ((POOLING, study.pool), (APPLY_POOLS, study.pool), (BORROWING, study.borrow))
    return tuple(one for one, given in (*wanted, (LEARNING, study.prior is not None)) if given)


def run(study: Study, observer: StudyObserver) -> Summary:
    """Do a study.

    Raises:
        UsageError: see `plan`; or there is nothing to collect.
        LockedError: another run works in the output folder, or has taken this one over.
        OutputError: the folder or the summary cannot be written, or would overwrite what no study wrote.
    """
    places(study.where)
    try:
        study.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot be made ({error.strerror or error})", path=study.out) from error
    base = study.shard.basename
    patience = None if study.takeover_s is None else lock.Patience(study.takeover_s, observer.note)
    with (
        lock.locked(study.lock, lambda: _other_locks(study), patience) as lease,
        closing(ledger_of(study)) as ledger,
    ):
        planned = plan(study, ledger)
        refuse_foreign(study.out, base, planned.sources(), force=study.request.force)
        if study.collect and planned.waiting and not planned.done:
            text = (
                f"none of {counted(len(planned.waiting), 'recording')} has a result made with these options"
            )
            raise UsageError(text, hint="give --collect the options of the parts, or run these first")
        for text in planned.notes:
            observer.note(printable(text))
        _tidy(planned, lease)
        study_run = StudyRun(study, ledger, observer, planned, lease)
        study_run.run()
        result = _summary(study, planned, study_run)
        lease.confirm()
        summary.write(result, study.out, base)
        lease.confirm()
        others = (*planned.left_out, *planned.kept, *_of_waiting(study, planned, ledger))
        ledger.tidy([*study_run.entries(), *others])
        if study.shard.whole and not (planned.waiting or study.where.include):
            remove_pools(study.out, keep=study_run.known.pools)
    return result


def unlock(study: Study) -> lock.Lock | None:
    """Remove the study's lock, whether or not its run has ended; returns it, None if there is none.

    Raises:
        OutputError: it cannot be removed, or is no lock.
    """
    with disk_errors(study.lock):
        if (found := lock.read_lock(study.lock)) is not None:
            lock.remove(study.lock, found.text)
    return found


def _tidy(planned: Plan, lease: Lease) -> None:
    """Remove what killed runs left for their workers, and what those left that were taken over."""
    sweep_folders()
    outputs = [path for item in (*planned.todo, *planned.waiting) for path in item.job.outputs]
    for path, lost in lease.lost.items():
        sweep_host([*outputs, *map(path.with_suffix, (".lock", ".ledger", *SUMMARY))], lost)


def _of_waiting(study: Study, planned: Plan, ledger: Ledger) -> list[Entry]:
    """What is known of recordings that are not begun: a run with other options may build on it."""
    rounds = (OWN, *REPLACING)
    return [entry for item in planned.waiting for entry in ledger.held(item.name, study.asked(), rounds)]


def _other_locks(study: Study) -> tuple[Path, ...]:
    """A shard keeps others of the whole study away; shards do not hinder each other."""
    if study.shard.whole:
        with looking_at(study.out):
            return tuple(sorted(study.out.glob("study.*-of-*.lock")))
    return (study.out / "study.lock",)


def _summary(study: Study, planned: Plan, study_run: StudyRun) -> Summary:
    standing, pools = study_run.known.standing, study_run.known.pools
    return Summary(
        rows=study_run.rows(planned.kept),
        settings=_settings(study),
        waiting=len(planned.waiting),
        ahead=planned.ahead(),
        left_out=len(planned.left_out),
        kept=len({entry.name for entry in planned.kept}),
        up_to_date=len(set(standing) - study_run.worked),
        pools={name: pools[name].row or {} for name in sorted(pools)},
    )


def _settings(study: Study) -> dict[str, Any]:
    """All that decides the results but the recordings."""
    own, rules = study.settings(), study.request.rules
    several = len({one.folder for one in rules}) > 1
    stated = {(f"{one.folder.name}/" if several else "") + one.path.name: one.as_json() for one in rules}
    later = {"prior": study.prior or own["prior"], "pool": study.pool, "borrow": study.borrow}
    return {**own, **later, **({"stated": stated} if stated else {})}


class StudyRun:
    """A study under way.

    Attributes:
        planned: what there was to do.
        lease: what allows it to write in OUT; it is confirmed before each write that two runs must not do.
        worked: names of recordings that were given to a worker.
    """

    def __init__(
        self, study: Study, ledger: Ledger, observer: StudyObserver, planned: Plan, lease: Lease
    ) -> None:
        self.study = study
        self.lease = lease
        self.known = StudyState()
        self.worked: set[str] = set()
        self.planned = planned
        self._table = _TableOnTheWay(self, ledger)
        self._ledger = ledger
        self._observer = observer
        self._rounds = rounds(study)
        self._planner = RoundPlanner(study, ledger)
        self._pending: dict[str, TaskResult] = {}

    def run(self) -> None:
        """All rounds; the table of what is done so far is there, however they end."""
        try:
            self._run(self.planned)
        except BaseException:
            self._table.write()
            raise

    def rows(self, kept: Sequence[Entry]) -> list[dict[str, Any]]:
        """Rows of the table, by name: of what is done now, and of earlier results that stand in its place."""
        last = {entry.name: entry.row for entry in kept}
        last |= {name: one.last.row for name, one in self.known.standing.items()}
        return [row for _, row in sorted(last.items()) if row is not None]

    def _run(self, planned: Plan) -> None:
        self._planner.untouched |= planned.changing
        for item, entry in planned.done:
            self._own(item, TaskResult(entry, up_to_date=self._was_told(item, entry)))
        self.lease.confirm()
        for item in planned.todo:
            if item.job != (alone := as_if_alone(item)):
                withdraw(alone)
        self._calibrate(planned.todo)
        for name, first in copies_of(self.known.standing).items() if self.study.pool else ():
            self._observer.note(printable(f"{name}: {said_of_copy(first)}"))
        for text in without_prior(self.study, self.known):
            self._observer.note(text)
        for one in self._rounds:
            tasks = list(one.tasks(self.study, self.known))
            if one is self._rounds[-1]:
                self._restore({task.item.name for task in tasks})
            self._later(one, tasks)
        if self._rounds:
            self._restore(frozenset())
            for name in sorted(self._pending):
                self._report(self.known.standing[name].item, self._pending[name])

    def _was_told(self, item: Item, entry: Entry) -> bool:
        """Whether an earlier run said the same of a file; what is refused by its place or name may be new."""
        known = self._ledger.known(item, entry.asked)
        return item.refusal is None or (known is not None and known.row == entry.row)

    def entries(self) -> list[Entry]:
        """What is to be remembered."""
        standing = self.known.standing.values()
        later = [one.last for one in standing if one.last is not one.own]
        return [*(one.own for one in standing), *later, *self.known.pools.values()]

    def _calibrate(self, items: Sequence[Item]) -> None:
        common = common_of(self.study, len(items))
        tasks = [CalibrationTask(item, common) for item in items]
        for item, result in results(self.study, calibrated, tasks, self._observer, self.lease.check):
            self.worked.add(item.name)
            self._remember(result.entry)
            self._own(item, result)
            self._table.write_if_due()

    def _remember(self, entry: Entry) -> None:
        self.lease.confirm()
        self._ledger.add(entry)

    def _own(self, item: Item, result: TaskResult) -> None:
        """An own result; it is reported at once if no later round can replace it."""
        self.known.standing[item.name] = RecordingState(item, result.entry, result.entry)
        self._pending.pop(item.name, None)
        if self._rounds and not result.entry.failed:
            self._pending[item.name] = result
        else:
            self._report(item, result)

    def _report(self, item: Item, result: TaskResult) -> None:
        """Report a result; of a recording that `--include` does not name, only a new one."""
        if not (item.aside and result.up_to_date):
            self._observer.finished(item, result)

    def _restore(self, concerned: Set[str]) -> None:
        """Put own results back in place where an earlier run replaced them and this one does not.

        It is done once all that is replaced is known, and before others' reports are read.
        """
        left_alone = concerned | self._planner.untouched
        standing = [one for name, one in sorted(self.known.standing.items()) if name not in left_alone]
        own = [one for one in standing if one.last is one.own]
        self._calibrate([one.item for one in own if not self._ledger.in_place(one.own)])

    def _later(self, one: Round, tasks: Sequence[RoundTask]) -> None:
        todo, taken = self._planner.of(one, tasks)
        for task, entry in taken:
            self._take(one, task.item, TaskResult(entry, up_to_date=True))
        for item, result in results(self.study, one.work, todo, self._observer, self.lease.check):
            self._remember(result.entry)
            self._take(one, item, result)
            self.worked |= set() if one.of_pools else {item.name}
            self._table.write_if_due()

    def _take(self, one: Round, item: Item, result: TaskResult) -> None:
        self.known.take(one, item.name, result.entry)
        if not one.of_pools:
            self._pending[item.name] = result


class _TableOnTheWay:
    """`study.csv` while a study runs: what is done, and of the rest what an earlier run made of it."""

    def __init__(self, study_run: StudyRun, ledger: Ledger) -> None:
        self._run, self._ledger = study_run, ledger
        self._due = time.monotonic() + TABLE_S

    def write_if_due(self) -> None:
        """Bring it up to date now and then."""
        began = time.monotonic()
        if began >= self._due:
            self.write()
            now = time.monotonic()
            self._due = now + max(TABLE_S, TABLE_TIMES * (now - began))

    def write(self) -> None:
        """Bring it up to date; what cannot be written is told at the end."""
        study, rows = self._run.study, self._run.rows(self._before)
        with contextlib.suppress(OutputError, LockedError):
            if rows:
                self._run.lease.confirm()
                summary.write_csv(rows, study.out, study.shard.basename)

    @functools.cached_property
    def _before(self) -> list[Entry]:
        planned = self._run.planned
        left = (*planned.todo, *planned.waiting)
        return [*planned.kept, *(entry for item in left for entry in self._ledger.of_others(item, REPLACING))]


def results(
    study: Study,
    work: TaskFunction,
    tasks: Sequence[Any],
    observer: StudyObserver,
    check: Callable[[], None],
) -> Iterator[tuple[Item, TaskResult]]:
    """Have tasks done, the largest first, so that the last to end is a small one.

    Args:
        check: called whenever a task is further; what it raises ends the work.
    """
    if not tasks:
        return
    observer.begin([task.item for task in tasks])
    ordered = sorted(tasks, key=lambda task: (-task.item.size, task.item.name))

    def moved(task: Task, part: float) -> None:
        check()
        observer.advance(part * task.item.size)

    executor = executor_for(study, work, len(tasks), moved, observer.note)
    with contextlib.closing(executor.run(ordered)) as ended:
        for one in ended:
            yield one.task.item, _result(one)


def _result(ended: Finished) -> TaskResult:
    if ended.fault is None:
        result: TaskResult = ended.result
        return result
    task: Task = ended.task
    tidy(task)
    message = f"{printable(task.item.source)}: {ended.fault}"
    return TaskResult(task.failure(NO_MEMORY if ended.lacking else BUG, message, again=ended.retry))


def executor_for(
    study: Study,
    work: TaskFunction,
    recordings: int,
    on_progress: ProgressDelta,
    notify: Notify,
) -> Executor:
    """Processes of this machine for so many recordings, or the cluster that was named.

    A cluster finds the own results; what a device's recordings have in common is found here.
    """
    if study.dask is None or work is not calibrated:
        return ProcessPool(work, workers_of(study, recordings), study.timeout_s, PRELOAD, on_progress)
    cwd = Path.cwd()
    calibrate, requirements = functools.partial(calibrate_in_user_folder, cwd), _requirements(study, cwd)
    return Cluster(
        study.dask, calibrate, requirements, study.jobs, study.timeout_s, on_progress, notify, tidy
    )


def _requirements(study: Study, cwd: Path) -> WorkerRequirements:
    """The lock is the mark: it is there while the study runs, and no other run's is like it."""
    mark = cwd / study.lock
    folders = tuple(cwd / folder for folder in study.where.folders)
    return WorkerRequirements(__version__, code(), folders, mark, mark.read_text("utf-8"))


def tidy(task: Task, lost: str | None = None) -> None:
    """Remove what killed processes of this machine left, and one of another that is known to be gone."""
    for path in task.item.job.outputs:
        with contextlib.suppress(OSError):
            sweep(path)
            if lost is not None:
                sweep_of(path, lost)


def preview(study: Study, note: Callable[[str], None]) -> dict[Item, str]:
    """What a run would do with each recording: `todo`, `waiting`, or the outcome that it has.

    What a later round does is decided by what is known now; nothing is locked or written.

    Args:
        note: is told what a person should know.

    Raises:
        UsageError: see `plan`.
        OutputError: a file is where the output folder should be.
    """
    places(study.where)
    existing = next(path for path in (study.out, *study.out.absolute().parents) if path.exists())
    if not existing.is_dir():
        raise OutputError("cannot be made: a file is in its place", path=existing)
    ledger = ledger_of(study)
    planned = plan(study, ledger)
    for text in planned.notes:
        note(printable(text))
    known = StudyState({item.name: RecordingState(item, entry, entry) for item, entry in planned.done})
    states = dict.fromkeys(planned.todo, "todo") | dict.fromkeys(planned.waiting, "waiting")
    planner = RoundPlanner(study, ledger, planned.changing)
    for one in rounds(study):
        todo, taken = planner.of(one, one.tasks(study, known))
        states |= {known.standing[name].item: "todo" for task in todo for name in task.names}
        for task, entry in taken:
            known.take(one, task.item.name, entry)
    named = [one for one in known.standing.values() if not one.item.aside]
    return {one.item: (one.last.row or {})["outcome"] for one in named} | states
