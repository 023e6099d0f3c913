"""The two rounds of pools: a device's recordings are calibrated as one, then each gets the coefficients."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from accelcal_cli.core.door import matching
from accelcal_cli.core.reasons import Reason
from accelcal_cli.output.files import looking_at
from accelcal_cli.output.report_kinds import FORMAT, Member
from accelcal_cli.output.report_reading import load_report, read_document
from accelcal_cli.output.words import sentence
from accelcal_cli.pipeline.calibrate import calibrate
from accelcal_cli.pipeline.jobs import REPORT_SUFFIX, FileStamp, Job, check_unchanged, file_stamp
from accelcal_cli.pipeline.outputs import refuse_foreign_report, remove, save_report, with_provenance
from accelcal_cli.pipeline.pool import apply_pool, pool
from accelcal_cli.studies import summary
from accelcal_cli.studies.borrowing import GOOD, Row, identity, pools
from accelcal_cli.studies.records import FAILED, Entry, Item, ProgressCallback
from accelcal_cli.studies.rounds import Round, StudyState, common_of
from accelcal_cli.studies.study import POOL, POOLED, Study
from accelcal_cli.studies.task import Common, ReplacementTask, StageProgress, TaskResult, guarded, row_of

PREFIX = "study.pool."


@dataclass(frozen=True, slots=True)
class PoolTask:
    """The recordings of one device that are calibrated as one.

    Attributes:
        item: represents all of them; its report is the pool's.
        names: names of the members.
        stamps: stamps of the members' files when their own results were found.
        inputs: hashes of the members' own results, by name; then names of the copies.
        copies: recordings with the content of a member, which do not count.
    """

    item: Item
    common: Common
    names: tuple[str, ...]
    members: tuple[Member, ...]
    stamps: tuple[FileStamp | None, ...]
    serial: str
    inputs: tuple[str, ...]
    copies: tuple[Member, ...] = ()

    def is_current(self, entry: Entry) -> bool:
        """See `RoundTask`."""
        return entry.inputs == self.inputs

    @property
    def sources(self) -> tuple[Path, ...]:
        """See `Task`: a failure of several recordings names the one that it is about."""
        return ()

    def failure(self, code: int, message: str, *, again: bool) -> Entry:
        """See `Task`."""
        return self.entry({"outcome": FAILED, "exit_code": code, "message": message}, again=again)

    def entry(self, result: dict[str, Any], *, again: bool = False) -> Entry:
        """Return the entry of the pool."""
        row = {"device_serial": self.serial, "recordings": len(self.members), **result}
        written = file_stamp(self.item.job.report)
        name = self.item.job.report.name
        outputs = () if written is None or result["outcome"] == FAILED else ((name, written),)
        stamps = self.item.stamps
        return Entry(self.item.name, stamps, self.common.asked, row, outputs, again, POOL, self.inputs)


def pool_tasks(study: Study, known: StudyState) -> list[PoolTask]:
    """Return a task for each pool (see `Round`)."""
    return [pool_of(study, known, members) for members in pools(known.own_rows())]


def pool_of(study: Study, known: StudyState, names: list[str]) -> PoolTask:
    """Return the task of a pool of these members."""
    states = [known.recordings[name] for name in names]
    rows: list[Row] = [one.own.row or {} for one in states]
    shared = [rows[0][name] for name in ("device_serial", "device_model", "lsb_per_g", "range_g")]
    serial, digest = shared[0], hashlib.sha256(json.dumps(shared).encode()).hexdigest()[:8]
    report = study.out / f"{PREFIX}{re.sub(r'[^A-Za-z0-9_-]', '_', serial)[:40]}-{digest}{REPORT_SUFFIX}"
    stands_for = Item(
        report.name.removesuffix(REPORT_SUFFIX),
        Job(report, report, report),
        ((sum(one.item.size for one in states), 0),),
        sensor=states[0].item.sensor,
    )
    more = sorted(name for name, first in summary.copies(known.own_rows()).items() if first in names)

    def member(name: str) -> Member:
        return Member(known.recordings[name].item.source, (known.recordings[name].own.row or {})["sha256"])

    return PoolTask(
        stands_for,
        common_of(study),
        tuple(names),
        tuple(map(member, names)),
        stamps=tuple(one.item.stamps[0] for one in states),
        serial=serial,
        inputs=(*(identity(line) for line in rows), *more),
        copies=tuple(map(member, more)),
    )


@guarded
def make_pool(task: PoolTask, report_progress: ProgressCallback) -> TaskResult:
    """Fit a pool and write its report."""
    request = task.common.request_for(task.item)
    if not request.force:
        refuse_foreign_report(task.item.job.report)
    report = pool(task.members, request, StageProgress(report_progress).stage, task.copies)
    for member, before in zip(task.members, task.stamps, strict=True):
        check_unchanged(member.path, before)
    save_report(task.item.job.report, with_provenance(report, request.command))
    return TaskResult(task.entry({name: report[name] for name in ("outcome", "reason", "message")}))


def remove_pools(out: Path, keep: Collection[str]) -> None:
    """Remove the reports of pools that no longer exist.

    Raises:
        OutputError: one cannot be removed, or OUT cannot be listed.
    """
    with looking_at(out):
        found = matching(out, f"{PREFIX}*{REPORT_SUFFIX}")
    for path in found:
        if path.name.removesuffix(REPORT_SUFFIX) in keep or (report := load_report(path)) is None:
            continue
        if report["recording"].get("format") == FORMAT:  # else a member's, which has a pool section too
            remove(path)


POOLING = Round(POOL, make_pool, pool_tasks, of_pools=True)


@dataclass(frozen=True, slots=True)
class PooledTask(ReplacementTask):
    """One recording that gets the coefficients in its pool's report."""

    report: Path
    round: ClassVar[str] = POOLED
    refusal: ClassVar[str] = "not_pooled"


def pooled_tasks(study: Study, known: StudyState) -> list[PooledTask]:
    """Return a task for each member of a pool that has coefficients (see `Round`)."""
    tasks, common, rows = [], common_of(study), known.own_rows()
    again = summary.copies(rows)
    for members in pools(rows):
        one = pool_of(study, known, members)
        entry = known.pools.get(one.item.name)
        if entry is None or entry.row is None or entry.row["outcome"] not in GOOD:
            continue
        together = hashlib.sha256("".join(one.inputs).encode()).hexdigest()[:16]
        for name in (*members, *(name for name, first in again.items() if first in members)):
            state = known.recordings[name]
            inputs = (identity(state.own.row or {}), together)
            tasks.append(PooledTask(state.item, common, state.own, inputs, one.item.job.report))
    return tasks


@guarded
def pooled(task: PooledTask, report_progress: ProgressCallback) -> TaskResult:
    """Apply a pool's coefficients to one of its recordings."""
    item, progress = task.item, StageProgress(report_progress).stage
    request = task.common.request_for(item)
    result = apply_pool(item.job, request, read_document(task.report), progress, item.stamps[0])
    if isinstance(result, Reason):
        return task.result(calibrate(item.job, request, progress), task.kept(sentence(result)))
    section = result.view.pool
    assert section is not None
    row = row_of(item, task.common, result) | summary.own(task.own_row)
    row |= {"pool": task.report.name, "pool_recordings": len(section.recordings)}
    if (windows := section.own_windows) is not None:
        means = {"windows_before_mg": windows.before_mg.mean, "windows_after_mg": windows.after_mg.mean}
        row |= means
    return task.result(result, row)


APPLY_POOLS = Round(POOLED, pooled, pooled_tasks)
