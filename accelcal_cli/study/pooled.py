"""The round in which the recordings of each pool get its coefficients."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from accelcal_cli.core.names import printable
from accelcal_cli.output.document import read_document
from accelcal_cli.pipeline.calibrate import calibrate
from accelcal_cli.pipeline.pooled import apply_pool
from accelcal_cli.pipeline.request import Result
from accelcal_cli.study import row
from accelcal_cli.study.devices import GOOD, identity
from accelcal_cli.study.engine import Told
from accelcal_cli.study.items import Entry, Item, stamp
from accelcal_cli.study.plan import POOLED, Study
from accelcal_cli.study.pool import members_of, pool_of
from accelcal_cli.study.rounds import Known, Round, common_of
from accelcal_cli.study.work import Answer, Common, Parts, guarded, outputs_of, problems_of, row_of


@dataclass(frozen=True, slots=True)
class Pooled:
    """One recording that gets its pool's coefficients.

    Attributes:
        own: its own result.
        inputs: identities of its own result and of the pool.
    """

    item: Item
    common: Common
    own: Entry
    report: Path
    inputs: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """See `Later`."""
        return (self.item.name,)

    def stands(self, entry: Entry) -> bool:
        """See `Later`."""
        return entry.inputs == self.inputs

    def failure(self, code: int, message: str, *, again: bool) -> Entry:
        """See `Doing`: the own result stays, if it is still there."""
        if all(stamp(self.common.out / name) == held for name, held in self.own.outputs):
            return self.entry(self.kept(message), self.own.outputs, again=again)
        return self.entry(row.failed(self.item, code, message), (), again=True)

    def entry(
        self, line: dict[str, Any], outputs: tuple[tuple[str, tuple[int, int]], ...], *, again: bool = False
    ) -> Entry:
        """What is remembered of the round."""
        item = self.item
        return Entry(item.name, item.stamps, self.common.asked, line, outputs, again, POOLED, self.inputs)

    def kept(self, why: str) -> dict[str, Any]:
        """The own result's row, and why it stays."""
        assert self.own.row is not None
        return {**self.own.row, "message": f"{self.own.row['message']}; not pooled: {why}"}


def pooled_tasks(study: Study, known: Known) -> list[Pooled]:
    """See `Round`: a task for each member of a pool that has coefficients."""
    found, common = [], common_of(study)
    for members in members_of(study, known.standing):
        one = pool_of(study, known, members)
        entry = known.pools.get(one.item.name)
        if entry is None or entry.row is None or entry.row["outcome"] not in GOOD:
            continue
        together = hashlib.sha256("".join(one.inputs).encode()).hexdigest()[:16]
        for name in members:
            own = known.standing[name].own
            inputs = (identity(own.row or {}), together)
            found.append(Pooled(known.standing[name].item, common, own, one.item.job.report, inputs))
    return found


def pooled(task: Pooled, told: Told) -> Answer:
    """Apply a pool's coefficients to one of its recordings; whatever happens is an answer."""
    return guarded(task, lambda: _pooled(task, told))


def _pooled(task: Pooled, told: Told) -> Answer:
    item, request, shown = task.item, task.common.request, Parts(told).stage
    found = apply_pool(item.job, request, read_document(task.report), shown, item.stamps[0])
    if isinstance(found, str):
        return _answer(task, calibrate(item.job, request, shown), task.kept(printable(found)))
    return _answer(task, found, row_of(item, task.common, found) | _instead(task, found))


def _answer(task: Pooled, result: Result, line: dict[str, Any]) -> Answer:
    outputs = outputs_of(task.item, task.common, result)
    return Answer(task.entry(line, outputs), result.up_to_date, problems_of(result))


def _instead(task: Pooled, result: Result) -> dict[str, Any]:
    """Columns that say of which pool a row's coefficients are, and what they do to its own windows."""
    said, windows = result.report["pool"], result.report["pool"]["own_windows"]
    told = {"pool": task.report.name, "pool_recordings": len(said["recordings"])}
    if windows is not None:
        told |= {f"windows_{when}_mg": windows[f"{when}_mg"]["mean"] for when in ("before", "after")}
    return told | row.own(task.own.row or {})


POOLED_ONES = Round(POOLED, pooled, pooled_tasks)
