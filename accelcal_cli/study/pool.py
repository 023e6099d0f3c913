"""The round in which all recordings of a device are calibrated as one."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from accelcal_cli.output.pool_report import FORMAT, Member
from accelcal_cli.output.report import load_report
from accelcal_cli.pipeline.existing import refuse_foreign_report, remove
from accelcal_cli.pipeline.identity import same
from accelcal_cli.pipeline.plan import REPORT_SUFFIX, Job
from accelcal_cli.pipeline.pool import pool
from accelcal_cli.pipeline.save import save_report, with_provenance
from accelcal_cli.study.devices import Row, identity, pools
from accelcal_cli.study.engine import Told
from accelcal_cli.study.items import FAILED, Entry, Item, Stamp, Standing, stamp
from accelcal_cli.study.plan import POOL, Study
from accelcal_cli.study.rounds import Known, Round, common_of
from accelcal_cli.study.work import Answer, Common, Parts, guarded

PREFIX = "study.pool."


@dataclass(frozen=True, slots=True)
class Pool:
    """The recordings of one device to be calibrated as one.

    Attributes:
        item: stands for all of them; its report is the pool's.
        names: of the members.
        stamps: of the members' files when their own results were found.
        inputs: identities of the members' own results, by name.
    """

    item: Item
    common: Common
    names: tuple[str, ...]
    members: tuple[Member, ...]
    stamps: tuple[Stamp | None, ...]
    serial: str
    inputs: tuple[str, ...]

    def stands(self, entry: Entry) -> bool:
        """See `Later`."""
        return entry.inputs == self.inputs

    def failure(self, code: int, message: str, *, again: bool) -> Entry:
        """See `Doing`."""
        return self.entry({"outcome": FAILED, "exit_code": code, "message": message}, again=again)

    def entry(self, said: dict[str, Any], *, again: bool = False) -> Entry:
        """What is remembered of the pool."""
        told = {"device_serial": self.serial, "recordings": len(self.members), **said}
        found = stamp(self.item.job.report)
        name = self.item.job.report.name
        outputs = () if found is None or said["outcome"] == FAILED else ((name, found),)
        stamps = self.item.stamps
        return Entry(self.item.name, stamps, self.common.asked, told, outputs, again, POOL, self.inputs)


def pool_tasks(study: Study, known: Known) -> list[Pool]:
    """See `Round`: a task for each pool."""
    return [pool_of(study, known, members) for members in members_of(study, known.standing)]


def members_of(study: Study, standing: Mapping[str, Standing]) -> list[list[str]]:
    """Names of the recordings of each pool."""
    rows = {name: one.own.row for name, one in standing.items() if one.own.row and not one.own.failed}
    return pools(rows, study.request.settings.max_damage_percent)


def pool_of(study: Study, known: Known, names: list[str]) -> Pool:
    """The task of a pool of these members."""
    held = [known.standing[name] for name in names]
    rows: list[Row] = [one.own.row or {} for one in held]
    report = study.out / f"{_name(rows[0])}{REPORT_SUFFIX}"
    stands_for = Item(
        report.name.removesuffix(REPORT_SUFFIX),
        Job(report, report, report),
        ((sum(one.item.size for one in held), 0),),
    )
    members = tuple(Member(one.item.source, line["sha256"]) for one, line in zip(held, rows, strict=True))
    stamps, inputs = tuple(one.item.stamps[0] for one in held), tuple(identity(line) for line in rows)
    return Pool(stands_for, common_of(study), tuple(names), members, stamps, rows[0]["device_serial"], inputs)


def _name(line: Row) -> str:
    """A name of the pool's files that its members have in common, and no other pool has."""
    shared = [line[name] for name in ("device_serial", "device_model", "lsb_per_g", "range_g")]
    digest = hashlib.sha256(json.dumps(shared).encode()).hexdigest()[:8]
    return f"{PREFIX}{re.sub(r'[^A-Za-z0-9_-]', '_', line['device_serial'])[:40]}-{digest}"


def make_pool(task: Pool, told: Told) -> Answer:
    """Fit a pool and write its report; whatever happens is an answer."""
    return guarded(task, lambda: _make_pool(task, told))


def _make_pool(task: Pool, told: Told) -> Answer:
    request = task.common.request
    if not request.force:
        refuse_foreign_report(task.item.job.report)
    report = pool(task.members, request, Parts(told).stage)
    for member, before in zip(task.members, task.stamps, strict=True):
        same(member.path, before)
    save_report(task.item.job.report, with_provenance(report, request.command))
    return Answer(task.entry({"outcome": report["outcome"], "message": report["message"]}))


def remove_pools(out: Path, keep: Collection[str]) -> None:
    """Remove the reports of pools that there are no longer.

    Raises:
        OutputError: one cannot be removed.
    """
    for path in sorted(out.glob(f"{PREFIX}*{REPORT_SUFFIX}")):
        if path.name.removesuffix(REPORT_SUFFIX) not in keep and _of_a_pool(path):
            remove(path)


def _of_a_pool(path: Path) -> bool:
    """Whether a file is the report of a pool; a member's has a section of that name, too."""
    report = load_report(path)
    return report is not None and report["recording"].get("format") == FORMAT


POOLING = Round(POOL, make_pool, pool_tasks, of_pools=True)
