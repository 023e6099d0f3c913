"""The round in which recordings are calibrated again, with a prior learnt from others of the study.

A prior is learnt from the rows of other recordings' own results, which were found with the prior of the
population. Kind `study` is learnt from other devices of the model, `device` also from other recordings of the
device.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from math import hypot
from typing import Any, ClassVar, NamedTuple

from accelcal_cli.core.errors import counted, printable
from accelcal_cli.core.prior import POPULATION, LearntPrior, Prior, Source
from accelcal_cli.core.reasons import Reason
from accelcal_cli.core.results import Outcome
from accelcal_cli.core.settings import DEVICE_PRIOR, STUDY_PRIOR
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
from accelcal_cli.output.words import sentence
from accelcal_cli.pipeline.calibrate import calibrate, calibrate_with
from accelcal_cli.studies import summary
from accelcal_cli.studies.borrowing import Row, identity
from accelcal_cli.studies.columns import PARAMETERS
from accelcal_cli.studies.records import ProgressCallback
from accelcal_cli.studies.rounds import Round, StudyState, common_of
from accelcal_cli.studies.study import PRIOR, Study
from accelcal_cli.studies.task import ReplacementTask, StageProgress, TaskResult, guarded, row_of

MOST_DEVICES = 64
"""Largest number of devices that a prior is learnt from; more hardly change a distribution."""

EARLIEST = datetime(2000, 1, 2)
"""Earliest start of a recording that is taken seriously; clocks that were never set begin before."""

MONTH_S = 365.25 / 12 * 86_400
OFFSETS, SLOPES = slice(6, 9), slice(9, 12)

Model = tuple[Any, ...]
"""Model, counts per g and range, which recordings must share to be compared."""


class _Good(NamedTuple):
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
    """

    rows: Mapping[str, Row]
    max_error_mg: float
    _devices: dict[Model, dict[str, list[_Good]]] = field(default_factory=dict)
    _known: dict[tuple[str, ...], LearntPrior] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Sort good results by model and device; of copies the first by name counts."""
        first: dict[summary.Content, _Good] = {}
        for name in sorted(self.rows):
            row = self.rows[name]
            if _is_good(row, self.max_error_mg):
                first.setdefault(summary.content(row), _Good(name, row))
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
    return [one for one in good if summary.content(one.row) != summary.content(row)]


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
    return Learning(known.own_rows(), study.request.recording_settings.max_error_mg)


def tasks(study: Study, known: StudyState) -> list[PriorTask]:
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


LEARNING = Round(PRIOR, calibrated_again, tasks)
