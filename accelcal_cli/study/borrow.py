"""The round in which recordings that cannot be calibrated well borrow coefficients of their device."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from accelcal_cli.core.judgement import Outcome
from accelcal_cli.core.names import printable
from accelcal_cli.core.settings import DEFAULT
from accelcal_cli.pipeline.borrow import borrow
from accelcal_cli.pipeline.calibrate import calibrate
from accelcal_cli.pipeline.request import Result
from accelcal_cli.study import row
from accelcal_cli.study.devices import identity, lenders
from accelcal_cli.study.engine import Told
from accelcal_cli.study.items import Entry, Item, Stamp, stamp
from accelcal_cli.study.plan import BORROW, Study
from accelcal_cli.study.rounds import Known, Round, common_of
from accelcal_cli.study.work import Answer, Common, Parts, guarded, outputs_of, problems_of, row_of


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
        return self.entry(row.failed(self.item, code, message), (), self.inputs, again=True)

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
    return {"borrowed_from": printable(lender.name), **row.own(own)}


BORROWING = Round(BORROW, borrowed, tasks)
