"""The round in which recordings that cannot be calibrated well borrow coefficients of their device.

The rows of the table alone decide which recording may use whose coefficients.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, ClassVar

from accelcal_cli.core.errors import printable
from accelcal_cli.core.results import Outcome
from accelcal_cli.core.settings import DEFAULT
from accelcal_cli.output.words import explained
from accelcal_cli.pipeline.apply import borrow
from accelcal_cli.pipeline.calibrate import calibrate
from accelcal_cli.studies import summary
from accelcal_cli.studies.records import Entry, ProgressCallback
from accelcal_cli.studies.rounds import Round, StudyState, common_of
from accelcal_cli.studies.study import BORROW, Study
from accelcal_cli.studies.task import ReplacementTask, StageProgress, TaskResult, guarded, row_of

Row = Mapping[str, Any]

MOST_DONORS = 3
"""Number of donors that are tried before a recording keeps its own result."""

GOOD = (Outcome.CALIBRATED, Outcome.REDUCED_MODEL, Outcome.ALREADY_GOOD)
OPEN = (Outcome.REFUSED, Outcome.PROVISIONAL)
"""Outcomes of recordings that borrow wherever they can: their own stillness does not determine enough."""

POORER_TIMES, POORER_MG = 2.0, 1.0
"""A calibrated recording borrows only if its held-out error is at least POORER_TIMES that of the device's
best recording and POORER_MG [mg] more; otherwise a study of good recordings would be read twice."""


def pools(rows: Mapping[str, Row]) -> list[list[str]]:
    """Return the names of the recordings that are calibrated as one, by device and name, at least two each.

    They agree in serial, model, counts per g and range, are not too damaged, have a result of their own, and
    their sensor did not change while it recorded. If several files have the same content, only the first is
    named.

    Args:
        rows: own results by name.
    """
    alike: dict[tuple[Any, ...], list[str]] = {}
    for serial, device in _devices(rows).items():
        for name, row in device.items():
            if _sensor_changed(row):
                continue
            if row["outcome"] in (*GOOD, *OPEN) and not _damaged(row):
                key = (serial, row["device_model"] or "", row["lsb_per_g"], row["range_g"] or 0.0)
                alike.setdefault(key, []).append(name)
    again = summary.copies(rows)
    once = [sorted(name for name in alike[key] if name not in again) for key in sorted(alike)]
    return [names for names in once if len(names) > 1]


def _sensor_changed(row: Row) -> bool:
    """Return True if the sensor changed while it recorded, so that no one set of coefficients fits."""
    return row.get("change") not in (None, "none")


def _damaged(row: Row) -> bool:
    return bool(row.get("reason") == "damaged")


def donors(rows: Mapping[str, Row], *, compare: bool, settled: Collection[str] = ()) -> dict[str, list[str]]:
    """Return the possible donors of each recording that should borrow, the nearest in time first.

    A recording that should borrow does not lend, so that nothing is lent on.

    Args:
        rows: results by name.
        settled: names of the recordings that do not borrow, since their result is not their own.
        compare: whether calibrated recordings may borrow, too, if they are poorer than others.
    """
    found: dict[str, list[str]] = {}
    for device in _devices(rows).values():
        recipients = {
            name for name in device.keys() - set(settled) if _borrows(name, device, compare=compare)
        }
        good = [name for name in device if name not in recipients and device[name]["outcome"] in GOOD]
        sound = {name: device[name] for name in good if not _sensor_changed(device[name])}
        again = summary.copies(sound)  # which would take the places of other donors
        lending = [name for name in sound if name not in again]
        for name in sorted(recipients):
            near = sorted(
                (_seconds_between(device[name], rows[one]), one) for one in _same_model(name, lending, device)
            )
            if near:
                found[name] = [one for _, one in near[:MOST_DONORS]]
    return found


def _devices(rows: Mapping[str, Row]) -> dict[str, dict[str, Row]]:
    """Return rows by name, by serial; recordings without one belong to no device."""
    found: dict[str, dict[str, Row]] = {}
    for name, row in rows.items():
        if row["device_serial"]:
            found.setdefault(row["device_serial"], {})[name] = row
    return found


def _same_model(name: str, others: list[str], rows: Mapping[str, Row]) -> list[str]:
    """Return the other recordings of the same serial whose model is not a different one."""
    model = rows[name]["device_model"]
    return [
        one for one in others if one != name and (not model or rows[one]["device_model"] in (model, None, ""))
    ]


def _borrows(name: str, device: Mapping[str, Row], *, compare: bool) -> bool:
    row = device[name]
    if row["outcome"] in OPEN:
        return not _damaged(row)
    if not compare or row["outcome"] not in GOOD:
        return False
    others = [device[one] for one in _same_model(name, list(device), device)]
    best = min((one["after_mg"] for one in others if one["outcome"] in GOOD), default=row["after_mg"])
    return bool(row["after_mg"] >= POORER_TIMES * best and row["after_mg"] - best >= POORER_MG)


def _seconds_between(one: Row, other: Row) -> float:
    """Return the time between two recordings [s]; 0 where they overlap, infinite if not known.

    Times are those of the device's clock, unless both state their offset from UTC.
    """
    if one["start_time"] is None or other["start_time"] is None:
        return float("inf")
    start, begin = (datetime.fromisoformat(row["start_time"]) for row in (one, other))
    if start.tzinfo is None or begin.tzinfo is None:
        start, begin = start.replace(tzinfo=None), begin.replace(tzinfo=None)
    later = (begin - start).total_seconds()
    return float(max(0.0, later - one["duration_s"], -later - other["duration_s"]))


def identity(row: Row) -> str:
    """Return a hash of a result: with the same settings and version, a row determines its report."""
    return hashlib.sha256(json.dumps(row, sort_keys=True).encode()).hexdigest()[:16]


@dataclass(frozen=True, slots=True)
class BorrowTask(ReplacementTask):
    """One recording that should borrow.

    Attributes:
        donors: recordings whose coefficients it may try, in this order: name of the item, and its report.
    """

    donors: tuple[tuple[str, Path], ...]
    round: ClassVar[str] = BORROW
    refusal: ClassVar[str] = "borrowed_nothing"

    def is_current(self, entry: Entry) -> bool:
        """See `RoundTask`; if nothing was accepted, all donors must have been tried."""
        tried = len(entry.inputs)
        assert entry.row is not None
        done = entry.row["outcome"] == Outcome.BORROWED or tried == len(self.inputs)
        return done and entry.inputs == self.inputs[:tried]


def tasks(study: Study, known: StudyState) -> list[BorrowTask]:
    """Return the tasks (see `Round`); a pooled recording lends, but does not borrow."""
    settings, common, states = study.request.settings, common_of(study), known.recordings
    rows = {name: one.last.row for name, one in states.items() if one.last.row and not one.last.failed}
    settled = [name for name, one in states.items() if one.last is not one.own]
    compare = settings.profile == DEFAULT.profile
    found = donors(rows, compare=compare, settled=settled)

    def task(name: str, names: list[str]) -> BorrowTask:
        own = states[name].own
        inputs = (identity(own.row or {}), *(identity(rows[one]) for one in names))
        lending = tuple((one, states[one].item.job.report) for one in names)
        return BorrowTask(states[name].item, common, own, inputs, lending)

    return [task(*pair) for pair in found.items()]


@guarded
def borrowed(task: BorrowTask, report_progress: ProgressCallback) -> TaskResult:
    """Try one donor after another."""
    item, progress = task.item, StageProgress(report_progress).stage
    request = task.common.request_for(item)
    poorer = task.own_row["outcome"] not in OPEN
    reports = [report for _, report in task.donors]
    loan = borrow(item.job, request, reports, progress, must_be_better=poorer, before=item.stamps[0])
    if loan.result is None:
        own = calibrate(item.job, request, progress)
        return task.result(own, task.kept(explained(loan.reasons[0], loan.reasons[1:])))
    number = len(loan.reasons)
    lender, _ = task.donors[number]
    accepted = {"borrowed_from": printable(lender), **summary.own(task.own_row)}
    row = row_of(item, task.common, loan.result) | accepted
    return task.result(loan.result, row, task.inputs[: number + 2])


BORROWING = Round(BORROW, borrowed, tasks)
