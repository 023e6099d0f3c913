"""A study from beginning to end: locking, doing what is left to do, summing up."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Protocol

from accelcal_cli.core.errors import OutputError
from accelcal_cli.core.names import printable
from accelcal_cli.study import lock, summary
from accelcal_cli.study.engine import Ended
from accelcal_cli.study.engines import engine_of, threads_of, tidy
from accelcal_cli.study.find import check
from accelcal_cli.study.items import Entry, Item
from accelcal_cli.study.ledger import Ledger
from accelcal_cli.study.plan import Plan, Study, ledger_of, plan
from accelcal_cli.study.summary import Summary
from accelcal_cli.study.work import BUG, Answer, Task, failure


class Watch(Protocol):
    """Who is told while a study runs."""

    def begin(self, plan: Plan) -> None:
        """Before the first recording."""

    def moved(self, bytes_done: float) -> None:
        """So many more bytes are done."""

    def ended(self, item: Item, answer: Answer) -> None:
        """A recording is done, was done before, or failed."""

    def said(self, text: str) -> None:
        """What a person should know meanwhile."""


def run(study: Study, watch: Watch) -> Summary:
    """Do a study.

    Raises:
        UsageError: see `plan`.
        LockedError: another run works in the output folder.
        OutputError: the folder or the summary cannot be written.
    """
    check(study.where)
    try:
        study.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot be made ({error.strerror or error})", path=study.out) from error
    base = study.shard.basename
    with lock.held(study.lock, lambda: _other_locks(study)), ledger_of(study) as ledger:
        found = plan(study, ledger)
        entries = _carried_out(study, found, ledger, watch)
        result = Summary(
            rows=[entry.row for entry in entries if entry.row is not None],
            settings=study.settings(),
            waiting=len(found.waiting),
            left_out=len(found.left_out),
            up_to_date=len(found.done),
        )
        summary.write(result, study.out, base)
        ledger.tidy([*entries, *found.left_out])
    return result


def _other_locks(study: Study) -> tuple[Path, ...]:
    """A shard keeps others of the whole study away; shards do not hinder each other."""
    if study.shard.whole:
        return tuple(sorted(study.out.glob("study.*-of-*.lock")))
    return (study.out / "study.lock",)


def _carried_out(study: Study, found: Plan, ledger: Ledger, watch: Watch) -> list[Entry]:
    """Entries of all that is done, by name."""
    watch.begin(found)
    entries = {entry.name: entry for _, entry in found.done}
    for item, entry in found.done:
        watch.ended(item, Answer(entry, up_to_date=True))
    for item, answer in _answers(study, found.todo, watch):
        ledger.add(answer.entry)
        entries[item.name] = answer.entry
        watch.ended(item, answer)
    return [entries[name] for name in sorted(entries)]


def _answers(study: Study, items: list[Item], watch: Watch) -> Iterable[tuple[Item, Answer]]:
    """The largest first, so that the last to end is a small one."""
    asked = study.asked()
    ordered = sorted(items, key=lambda item: (-item.size, item.name))
    request = replace(study.request, threads=threads_of(study, len(ordered)))
    tasks = [Task(item, study.out, request, asked) for item in ordered]
    engine = engine_of(study, len(tasks), lambda task, part: watch.moved(part * task.item.size), watch.said)
    with contextlib.closing(engine.run(tasks)) as ended:
        for one in ended:
            yield one.task.item, _answer(one)


def _answer(ended: Ended) -> Answer:
    if ended.fault is None:
        answer: Answer = ended.answer
        return answer
    task: Task = ended.task
    tidy(task)
    message = f"{printable(task.item.source)}: {ended.fault}"
    return Answer(failure(task, BUG, message, again=ended.again))
