"""Which recordings of one device may use whose coefficients: decided from their rows alone.

The round in which recordings that cannot be calibrated well borrow coefficients of their device.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import printable
from accelcal_cli.core.results import Outcome
from accelcal_cli.core.settings import DEFAULT
from accelcal_cli.pipeline.apply import borrow
from accelcal_cli.pipeline.calibrate import calibrate
from accelcal_cli.pipeline.jobs import Result
from accelcal_cli.study import summary
from accelcal_cli.study.plan import BORROW, Study
from accelcal_cli.study.records import Entry, Item, Stamp, Told, stamp
from accelcal_cli.study.rounds import Known, Round, common_of
from accelcal_cli.study.task import Answer, Common, Parts, guarded, outputs_of, problems_of, row_of

Row = Mapping[str, Any]

LENDERS = 3
"""So many are tried before a recording keeps its own result."""

GOOD = (Outcome.CALIBRATED, Outcome.REDUCED_MODEL, Outcome.ALREADY_GOOD)
POORER_TIMES = 2.0
POORER_MG = 1.0
"""A calibration is looked at again where its held-out error is at least so many times that of the device's
best recording, and so many mg more; otherwise a study of good recordings would be read twice."""


def pools(rows: Mapping[str, Row], max_damage_percent: float) -> list[list[str]]:
    """Names of the recordings that are calibrated as one, by device and name; each pool has two at least.

    They agree in serial, model, counts per g and range, and are not too damaged.

    Args:
        rows: own results by name.
    """
    alike: dict[tuple[Any, ...], list[str]] = {}
    for serial, device in _devices(rows).items():
        for name, row in device.items():
            if row["outcome"] in GOOD or not _damaged(row, max_damage_percent):
                key = (serial, row["device_model"] or "", row["lsb_per_g"], row["range_g"] or 0.0)
                alike.setdefault(key, []).append(name)
    return [sorted(alike[key]) for key in sorted(alike) if len(alike[key]) > 1]


def _damaged(row: Row, max_percent: float) -> bool:
    """Whether a recording was refused because of what damage took."""
    return bool(row["outcome"] == Outcome.REFUSED and row["lost_percent"] > max_percent)


def lenders(
    rows: Mapping[str, Row],
    max_damage_percent: float,
    *,
    compare: bool,
    settled: Collection[str] = (),
) -> dict[str, list[str]]:
    """For each recording that should borrow, by name, whom it may ask: the nearest in time first.

    Who should borrow does not lend, so that nothing is lent on.

    Args:
        rows: results by name.
        settled: names of those that do not ask, since a result is not their own.
        compare: whether calibrated recordings may borrow, too, if they are poorer than others.
    """
    found: dict[str, list[str]] = {}
    for device in _devices(rows).values():
        asking = {
            name
            for name in device.keys() - set(settled)
            if _asks(name, device, max_damage_percent, compare=compare)
        }
        lending = [name for name in device if name not in asking and device[name]["outcome"] in GOOD]
        for name in sorted(asking):
            near = sorted((_apart_s(device[name], rows[one]), one) for one in _alike(name, lending, device))
            if near:
                found[name] = [one for _, one in near[:LENDERS]]
    return found


def _devices(rows: Mapping[str, Row]) -> dict[str, dict[str, Row]]:
    """Rows by name, by serial; recordings without one belong to no device."""
    found: dict[str, dict[str, Row]] = {}
    for name, row in rows.items():
        if row["device_serial"]:
            found.setdefault(row["device_serial"], {})[name] = row
    return found


def _alike(name: str, others: list[str], rows: Mapping[str, Row]) -> list[str]:
    """Of other recordings of the same serial those whose model is not another one."""
    model = rows[name]["device_model"]
    return [
        one for one in others if one != name and (not model or rows[one]["device_model"] in (model, None, ""))
    ]


def _asks(name: str, device: Mapping[str, Row], max_damage_percent: float, *, compare: bool) -> bool:
    row = device[name]
    if row["outcome"] == Outcome.REFUSED:
        return not _damaged(row, max_damage_percent)
    if not compare or row["outcome"] not in GOOD:
        return False
    others = [device[one] for one in _alike(name, list(device), device)]
    best = min((one["after_mg"] for one in others if one["outcome"] in GOOD), default=row["after_mg"])
    return bool(row["after_mg"] >= POORER_TIMES * best and row["after_mg"] - best >= POORER_MG)


def _apart_s(one: Row, other: Row) -> float:
    """Time between two recordings by the device's clock [s]; 0 where they overlap, endless if not known."""
    spans = [_span(row) for row in (one, other)]
    if spans[0] is None or spans[1] is None:
        return float("inf")
    (start, end), (begin, close) = spans[0], spans[1]
    return max(0.0, (start - close).total_seconds(), (begin - end).total_seconds())


def _span(row: Row) -> tuple[datetime, datetime] | None:
    if row["start_time"] is None:
        return None
    start = datetime.fromisoformat(row["start_time"]).replace(tzinfo=None)
    try:
        return start, start + timedelta(seconds=row["duration_s"])
    except OverflowError:
        return None


def identity(row: Row) -> str:
    """A hash of a result: for the same settings and version a row says all that decides its report."""
    return hashlib.sha256(json.dumps(row, sort_keys=True).encode()).hexdigest()[:16]


@dataclass(frozen=True, slots=True)
class Lender:
    """A recording whose coefficients may be borrowed.

    Attributes:
        name: as that of its item.
        identity: of its result.
    """

    name: str
    report: Path
    identity: str


@dataclass(frozen=True, slots=True)
class Borrowing:
    """One recording that should borrow.

    Attributes:
        own: its own result.
        lenders: whom it may ask, in this order.
    """

    item: Item
    common: Common
    own: Entry
    lenders: tuple[Lender, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """See `Later`."""
        return (self.item.name,)

    @property
    def inputs(self) -> tuple[str, ...]:
        """On what the result depends, in the order in which it is looked at."""
        assert self.own.row is not None
        return (identity(self.own.row), *(one.identity for one in self.lenders))

    def stands(self, entry: Entry) -> bool:
        """See `Later`: all that was looked at is as it was, and where nothing was lent, all were asked."""
        asked = len(entry.inputs)
        assert entry.row is not None
        done = entry.row["outcome"] == Outcome.BORROWED or asked == len(self.inputs)
        return done and entry.inputs == self.inputs[:asked]

    def failure(self, code: int, message: str, *, again: bool) -> Entry:
        """See `Doing`: the own result stays, if it is still there."""
        if all(stamp(self.common.out / name) == held for name, held in self.own.outputs):
            return self.entry(self.kept(message), self.own.outputs, self.inputs, again=again)
        return self.entry(summary.failed(self.item, code, message), (), self.inputs, again=True)

    def entry(
        self,
        line: dict[str, Any],
        outputs: tuple[tuple[str, Stamp], ...],
        inputs: tuple[str, ...],
        *,
        again: bool = False,
    ) -> Entry:
        """What is remembered of the round."""
        item = self.item
        return Entry(item.name, item.stamps, self.common.asked, line, outputs, again, BORROW, inputs)

    def kept(self, why: str) -> dict[str, Any]:
        """The own result's row, and why it stays."""
        assert self.own.row is not None
        return {**self.own.row, "message": f"{self.own.row['message']}; borrowed nothing: {why}"}


def tasks(study: Study, known: Known) -> list[Borrowing]:
    """See `Round`; what was pooled lends, but does not ask."""
    settings, common, standing = study.request.settings, common_of(study), known.standing
    rows = {name: one.last.row for name, one in standing.items() if one.last.row and not one.last.failed}
    settled = [name for name, one in standing.items() if one.last is not one.own]
    compare = settings.profile == DEFAULT.profile
    found = lenders(rows, settings.max_damage_percent, compare=compare, settled=settled)

    def lender(name: str) -> Lender:
        return Lender(name, standing[name].item.job.report, identity(rows[name]))

    return [
        Borrowing(standing[name].item, common, standing[name].own, tuple(map(lender, names)))
        for name, names in found.items()
    ]


def borrowed(task: Borrowing, told: Told) -> Answer:
    """Ask one lender after another; whatever happens is an answer."""
    return guarded(task, lambda: _borrowed(task, told))


def _borrowed(task: Borrowing, told: Told) -> Answer:
    assert task.own.row is not None
    item, request, shown = task.item, task.common.request, Parts(told).stage
    poorer = task.own.row["outcome"] != Outcome.REFUSED
    reports = [one.report for one in task.lenders]
    loan = borrow(item.job, request, reports, shown, must_be_better=poorer, before=item.stamps[0])
    if loan.result is None:
        held = calibrate(item.job, request, shown)
        line = task.kept("; ".join(loan.reasons))
        return _answer(task, held, line, task.inputs)
    number = len(loan.reasons)
    line = row_of(item, task.common, loan.result) | _instead(task.own.row, task.lenders[number])
    return _answer(task, loan.result, line, task.inputs[: number + 2])


def _answer(task: Borrowing, result: Result, line: dict[str, Any], inputs: tuple[str, ...]) -> Answer:
    outputs = outputs_of(task.item, task.common, result)
    return Answer(task.entry(line, outputs, inputs), result.up_to_date, problems_of(result))


def _instead(own: dict[str, Any], lender: Lender) -> dict[str, Any]:
    """Columns that say whose coefficients a row has, and what the recording's own were worth."""
    return {"borrowed_from": printable(lender.name), **summary.own(own)}


BORROWING = Round(BORROW, borrowed, tasks)
