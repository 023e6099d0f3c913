"""Later rounds of a study, in which a recording takes what others say: borrowing, pools, learnt priors."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from math import hypot
from pathlib import Path
from typing import Any, ClassVar

from accelcal_cli.core.errors import Reason, counted, printable
from accelcal_cli.core.paths import matching
from accelcal_cli.core.prior import POPULATION, LearntPrior, Prior, Source
from accelcal_cli.core.results import Outcome
from accelcal_cli.core.settings import DEFAULT, DEVICE_PRIOR, STUDY_PRIOR
from accelcal_cli.judge.learning import (
    FEWEST_DEVICES,
    OCCASION,
    WALK,
    DatedEstimate,
    Estimate,
    across_devices,
    along_device,
    learnt,
    own_estimate,
    together,
)
from accelcal_cli.output.coefficients import prior_json
from accelcal_cli.output.decisions import Content, content
from accelcal_cli.output.files import looking_at
from accelcal_cli.output.report import FORMAT, Member
from accelcal_cli.output.report_reading import load_report, read_document
from accelcal_cli.output.sentences import explained, sentence
from accelcal_cli.pipeline.apply import borrow
from accelcal_cli.pipeline.calibrate import calibrate, calibrate_with
from accelcal_cli.pipeline.jobs import REPORT_SUFFIX, FileStamp, Job, check_unchanged, file_stamp
from accelcal_cli.pipeline.outputs import refuse_foreign_report, remove, save_report, with_provenance
from accelcal_cli.pipeline.pool import apply_pool, pool
from accelcal_cli.studies import summary
from accelcal_cli.studies.columns import PARAMETERS
from accelcal_cli.studies.records import FAILED, Entry, Item, ProgressCallback
from accelcal_cli.studies.rounds import Round, StudyState, common_of
from accelcal_cli.studies.study import BORROW, POOL, POOLED, PRIOR, Study
from accelcal_cli.studies.task import Common, ReplacementTask, StageProgress, TaskResult, guarded, row_of

# The round in which recordings that cannot be calibrated well borrow coefficients of their device.
#
# The rows of the table alone decide which recording may use whose coefficients.

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


def donors(
    rows: Mapping[str, Row], *, compare: bool, settled: Collection[str] = (), silent: Collection[str] = ()
) -> dict[str, list[str]]:
    """Return the possible donors of each recording that should borrow, the nearest in time first.

    A recording that should borrow does not lend, so that nothing is lent on.

    Args:
        rows: results by name.
        settled: names of the recordings that do not borrow, since their result is not their own.
        compare: whether calibrated recordings may borrow, too, if they are poorer than others.
        silent: names of the recordings that do not lend, since people excluded them.
    """
    found: dict[str, list[str]] = {}
    for device in _devices(rows).values():
        heard = {name: row for name, row in device.items() if name not in silent}
        recipients = {
            name
            for name in device.keys() - set(settled)
            if _borrows(name, heard | {name: device[name]}, compare=compare)
        }
        good = [name for name in heard if name not in recipients and device[name]["outcome"] in GOOD]
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


def borrowing_tasks(study: Study, known: StudyState) -> list[BorrowTask]:
    """Return the tasks (see `Round`); a pooled recording lends, but does not borrow."""
    settings, common, states = study.request.settings, common_of(study), known.recordings
    rows = {name: one.last.row for name, one in states.items() if one.last.row and not one.last.failed}
    settled = [name for name, one in states.items() if one.last is not one.own]
    compare = settings.profile == DEFAULT.profile
    found = donors(rows, compare=compare, settled=settled, silent=known.silent)

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


BORROWING = Round(BORROW, borrowed, borrowing_tasks)


# The two rounds of pools: a device's recordings are calibrated as one, then each gets the
# coefficients.

PREFIX = "study.pool."


@dataclass(frozen=True, slots=True)
class PoolTask:
    """The recordings of one device that are calibrated as one.

    Attributes:
        item: represents all of them; its report is the pool's.
        names: names of the members; more: of recordings with the content of one, which do not count.
        stamps: stamps of the members' files when their own results were found.
        inputs: hashes of the members' own results, by name; then names of the copies.
        copies: the recordings of `more`.
    """

    item: Item
    common: Common
    names: tuple[str, ...]
    more: tuple[str, ...]
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
    """Return a task for each pool (see `Round`) of recordings that people did not exclude."""
    rows = {name: row for name, row in known.own_rows().items() if name not in known.silent}
    again = summary.copies(rows)
    return [_pool_of(study, known, members, again) for members in pools(rows)]


def _pool_of(study: Study, known: StudyState, names: list[str], again: Mapping[str, str]) -> PoolTask:
    """Return the task of a pool of these members, and of their copies among all copies."""
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
    more = sorted(name for name, first in again.items() if first in names)

    def member(name: str) -> Member:
        return Member(known.recordings[name].item.source, (known.recordings[name].own.row or {})["sha256"])

    return PoolTask(
        stands_for,
        common_of(study),
        tuple(names),
        tuple(more),
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
    tasks, common = [], common_of(study)
    for one in pool_tasks(study, known):
        entry = known.pools.get(one.item.name)
        if entry is None or entry.row is None or entry.row["outcome"] not in GOOD:
            continue
        together = hashlib.sha256("".join(one.inputs).encode()).hexdigest()[:16]
        for name in (*one.names, *one.more):
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
        row |= {"windows_before_mg": windows.before_mg.mean, "windows_after_mg": windows.after_mg.mean}
    return task.result(result, row)


APPLY_POOLS = Round(POOLED, pooled, pooled_tasks)


# The round in which recordings are calibrated again, with a prior learnt from others of the study.
#
# A prior is learnt from the rows of other recordings' own results, which were found with the prior of
# the population. Kind `study` is learnt from other devices of the model, `device` also from other
# recordings of the device.

MOST_DEVICES = 64
"""Largest number of devices that a prior is learnt from; more hardly change a distribution."""

EARLIEST = datetime(2000, 1, 2)
"""Earliest start of a recording that is taken seriously; clocks that were never set begin before."""

MONTH_S = 365.25 / 12 * 86_400
OFFSETS, SLOPES = slice(6, 9), slice(9, 12)

Model = tuple[Any, ...]
"""Model, counts per g and range, which recordings must share to be compared."""


@dataclass(frozen=True, slots=True)
class _Good:
    """A recording from which others may learn."""

    name: str
    row: Row


def _model(row: Row) -> Model:
    return (row["device_model"] or "", row["lsb_per_g"], row["range_g"])


def _is_good(row: Row, max_error_mg: float) -> bool:
    """Return True if others may learn from a result: no change of the sensor, and certainly a small error."""
    if row["outcome"] != Outcome.CALIBRATED or row.get("change") not in (None, "none"):
        return False
    high: float | None = row["calibration_error_high_mg"]
    return bool(row["device_serial"]) and high is not None and high < max_error_mg


@dataclass
class Learning:
    """Learns priors of recordings from other recordings.

    Args:
        rows: own results by name, found with the population's prior.
        max_error_mg: bound on the error over the sphere, at the high end of its interval, of a result that
            others learn from.
        silent: names of the recordings from which nobody learns, since people excluded them.
    """

    rows: Mapping[str, Row]
    max_error_mg: float
    silent: Collection[str] = ()
    _devices: dict[Model, dict[str, list[_Good]]] = field(default_factory=dict)
    _known: dict[tuple[str, ...], LearntPrior] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Sort good results by model and device; of copies the first by name counts."""
        first: dict[Content, _Good] = {}
        for name in sorted(self.rows):
            row = self.rows[name]
            if name not in self.silent and _is_good(row, self.max_error_mg):
                first.setdefault(content(row), _Good(name, row))
        # an order that has nothing to do with how devices are numbered
        for one in sorted(first.values(), key=lambda one: _sha256(one.row["device_serial"])):
            devices = self._devices.setdefault(_model(one.row), {})
            devices.setdefault(one.row["device_serial"], []).append(one)

    def prior(self, name: str, kind: str) -> LearntPrior | None:
        """Return the prior of a recording; None if too little is known, so that the population's stays."""
        row = self.rows[name]
        devices = self._other_devices(row)
        used = tuple(one.name for device in devices for one in device)
        if used and used not in self._known:
            self._known[used] = _across(devices, _model(row)[0])
        study, known = self._known.get(used), self._devices.get(_model(row), {})
        own = _others(known.get(row["device_serial"], ()), row) if kind == DEVICE_PRIOR else []
        return _of_device(own, row, study) if own else study

    def models_without(self) -> Iterator[tuple[str, int]]:
        """Yield the models without a prior, and the number of devices that are known of each."""
        few = {_model(row) for row in self.rows.values() if not self._other_devices(row)}
        for model in sorted(few, key=str):
            yield model[0], len(self._devices.get(model, ()))

    def _other_devices(self, row: Row) -> list[list[_Good]]:
        """Return the recordings of each other device of the model; none if too few devices are known."""
        devices: list[list[_Good]] = []
        for serial, good in self._devices.get(_model(row), {}).items():
            others = _others(good, row)
            if others and serial != row["device_serial"]:
                devices.append(others)
            if len(devices) == MOST_DEVICES:
                break
        return devices if row["device_model"] and len(devices) >= FEWEST_DEVICES else []


def _others(good: Sequence[_Good], row: Row) -> list[_Good]:
    """Return the recordings with other content."""
    return [one for one in good if content(one.row) != content(row)]


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()


def _across(devices: Sequence[Sequence[_Good]], model: str) -> LearntPrior:
    used = [one for device in devices for one in device]
    reference_c = _reference_c(used)
    estimates = [_of_recordings([one.row for one in device], reference_c) for device in devices]
    parts = []
    for index, (centre, width) in enumerate(zip(POPULATION.centre, POPULATION.width, strict=True)):
        some = [one for device in estimates if (one := device[index]) is not None]
        known = Estimate(centre, width * width)
        if len(some) >= FEWEST_DEVICES:
            known = across_devices(some, centre, width, POPULATION.freedom)
        parts.append(known)
    digest = _sha256("".join(sorted(one.row["sha256"] for one in used)))
    return LearntPrior(learnt(parts, reference_c), STUDY_PRIOR, model, len(devices), len(used), digest)


def _of_recordings(rows: Sequence[Row], reference_c: float | None) -> list[Estimate | None]:
    """Return the estimate of each parameter from the recordings of one device; None without any."""
    each = [_estimates(row, reference_c) for row in rows]
    found: list[Estimate | None] = []
    for index, occasion in enumerate(OCCASION):
        parts = [one for estimates in each if (one := estimates[index]) is not None]
        wider = [Estimate(one.value, one.variance + occasion * occasion) for one in parts]
        found.append(together(wider) if wider else None)
    return found


def _estimates(row: Row, reference_c: float | None) -> list[Estimate | None]:
    """Return the estimate of each parameter from a recording alone, with offsets at a temperature."""
    values, errors = ([row[f"{start}{name}"] for name in PARAMETERS] for start in ("", "se_"))
    if row["reference_c"] is not None and reference_c is not None:
        warmer = reference_c - row["reference_c"]
        for at in range(6, 9):
            values[at] += warmer * values[at + 3]
            errors[at] = hypot(errors[at], warmer * errors[at + 3])
    cells = zip(values, errors, POPULATION.centre, POPULATION.width, strict=True)
    return [
        None
        if value is None or error is None
        else own_estimate(value, error, centre, width, POPULATION.freedom)
        for value, error, centre, width in cells
    ]


def _reference_c(used: Sequence[_Good]) -> float | None:
    """Return the lower median of the reference temperatures; None if there is none."""
    known = sorted(one.row["reference_c"] for one in used if one.row["reference_c"] is not None)
    return float(known[(len(known) - 1) // 2]) if known else None


def _of_device(own: Sequence[_Good], row: Row, study: LearntPrior | None) -> LearntPrior:
    """Return the prior from other recordings of the device and the prior of its model."""
    reference_c = _reference_c(own)
    base = _at(POPULATION if study is None else study.prior, reference_c)
    month = _month(row)
    each = [(_estimates(one.row, reference_c), _month(one.row)) for one in own]
    parts = []
    for index, known in enumerate(base):
        past = [DatedEstimate(one, when) for estimates, when in each if (one := estimates[index]) is not None]
        steps = WALK[index], OCCASION[index]
        parts.append(along_device(past, month, known, *steps) if past else known)
    sources = tuple(Source(one.name, one.row["sha256"]) for one in own)
    prior = learnt(
        parts, reference_c if study is None or reference_c is not None else study.prior.reference_c
    )
    model = row["device_model"]
    if study is None:
        return LearntPrior(prior, DEVICE_PRIOR, model, 0, 0, None, sources)
    return LearntPrior(prior, DEVICE_PRIOR, model, study.devices, study.recordings, study.sha256, sources)


def _at(prior: Prior, reference_c: float | None) -> list[Estimate]:
    """Return centres and squared widths of a prior, with its offsets at a temperature."""
    parts = [Estimate(centre, width * width) for centre, width in zip(prior.centre, prior.width, strict=True)]
    if reference_c is None or prior.reference_c is None:
        return parts
    warmer = reference_c - prior.reference_c
    moved = [
        Estimate(offset.value + warmer * slope.value, offset.variance + warmer * warmer * slope.variance)
        for offset, slope in zip(parts[OFFSETS], parts[SLOPES], strict=True)
    ]
    return [*parts[:6], *moved, *parts[SLOPES]]


def _month(row: Row) -> float | None:
    """Return the middle of a recording by its device's clock [months since 2000]; None if not known."""
    if row["start_time"] is None:
        return None
    start = datetime.fromisoformat(row["start_time"]).replace(tzinfo=None)
    if start < EARLIEST:
        return None
    return float(((start - EARLIEST).total_seconds() + row["duration_s"] / 2) / MONTH_S)


@dataclass(frozen=True, slots=True)
class PriorTask(ReplacementTask):
    """One recording to be calibrated with a prior that was learnt from others.

    The prior with its sources is part of `inputs`.
    """

    learnt: LearntPrior
    round: ClassVar[str] = PRIOR
    refusal: ClassVar[str] = "prior_not_learnt"


def _learning(study: Study, known: StudyState) -> Learning:
    return Learning(known.own_rows(), study.request.recording_settings.max_error_mg, known.silent)


def prior_tasks(study: Study, known: StudyState) -> list[PriorTask]:
    """Return a task for each recording with points for which enough others are known (see `Round`)."""
    assert study.prior is not None
    learning, common, found = _learning(study, known), common_of(study), []
    for name, row in learning.rows.items():
        if row["outcome"] == Outcome.BORROWED or not row["cells"]:
            continue
        prior = learning.prior(name, study.prior)
        if prior is not None:
            state = known.recordings[name]
            content = json.dumps(prior_json(prior), sort_keys=True)
            inputs = (identity(row), _sha256(content)[:16])
            found.append(PriorTask(state.item, common, state.own, inputs, prior))
    return found


def without_prior(study: Study, known: StudyState) -> Iterator[str]:
    """Yield a line for the user on each model for which no prior can be learnt."""
    if study.prior is None:
        return
    for model, number in _learning(study, known).models_without():
        if not model:
            yield "recordings whose device model is unknown learn nothing from other devices"
        else:
            devices = counted(number, "device")
            text = f"{model}: {devices} with good recordings, "
            text += f"a recording needs {FEWEST_DEVICES} others to learn from"
            yield printable(f"{text}; until then these recordings use the population prior")


@guarded
def calibrated_again(task: PriorTask, report_progress: ProgressCallback) -> TaskResult:
    """Calibrate a recording with a learnt prior; its own result stays if that would be lost."""
    item, progress = task.item, StageProgress(report_progress).stage
    request = task.common.request_for(item)
    good = task.own_row["outcome"] != Outcome.REFUSED
    result = calibrate_with(
        item.job, request, task.learnt, progress, must_calibrate=good, before=item.stamps[0]
    )
    if isinstance(result, Reason):
        return task.result(calibrate(item.job, request, progress), task.kept(sentence(result)))
    row = row_of(item, task.common, result) | summary.own(task.own_row)
    return task.result(result, row)


LEARNING = Round(PRIOR, calibrated_again, prior_tasks)
