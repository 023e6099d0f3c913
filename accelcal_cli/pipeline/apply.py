"""Known coefficients applied to a recording: whose they are, how well they fit it, what the report says.

The donor is the recording that the coefficients come from, the recipient the one that they are applied to.
`apply` takes the donor that the user names, `borrow` the first of the device's other recordings that passes
the test.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import dropwhile, takewhile
from pathlib import Path
from typing import Any

from accelcal_cli.core.calibration import Calibration
from accelcal_cli.core.clock import iso_time
from accelcal_cli.core.declared import as_json
from accelcal_cli.core.errors import Reason, UsageError, printable
from accelcal_cli.core.input_files import size_of
from accelcal_cli.core.points import PointSet
from accelcal_cli.core.recording import Recording
from accelcal_cli.core.results import Change, Holdout, Judgement, Outcome, WithoutMisalignment
from accelcal_cli.core.settings import DEFAULT, LEARNT_PRIORS, SIX_POSE, Settings
from accelcal_cli.formats import ignored_options
from accelcal_cli.judge.change import ChangeSearch, ComparedErrors, change_reason
from accelcal_cli.judge.model_ladder import FEWEST_POSTURES, held_out
from accelcal_cli.judge.quality import check
from accelcal_cli.judge.verdict import better
from accelcal_cli.output.coefficients import (
    COPIED,
    Coefficients,
    coefficients_json,
    read_coefficients,
    without_misalignment,
)
from accelcal_cli.output.report import file_name
from accelcal_cli.output.report_reading import Document, check_sections
from accelcal_cli.output.sections import AppliedCoefficients
from accelcal_cli.pipeline import jobs
from accelcal_cli.pipeline.calibrate import (
    FirstPass,
    Judge,
    OwnCalibration,
    RecordingRun,
    Survey,
    Verdict,
    open_run,
)
from accelcal_cli.pipeline.jobs import FileStamp, Job, ProgressMaker, Request, Result, no_progress
from accelcal_cli.pipeline.options import settings_from_report
from accelcal_cli.pipeline.outputs import prepare
from accelcal_cli.pipeline.procedures import Method, Procedure, TimedCellProcedure, make_method

# Compares known coefficients with a recording along its time, and finds where they do not fit.


@dataclass(frozen=True, slots=True, eq=False)
class ComparedAlongTime:
    """A calibration compared with a recording along time.

    Attributes:
        change: how the sensor changed, as seen from the calibration.
        compared: its errors; None where the recording is too short.
        blocks: number of blocks of time, of `block_samples` each.
    """

    change: Change
    compared: ComparedErrors | None
    blocks: int
    block_samples: int


def compared_along_time(calibration: Calibration, procedure: Procedure) -> ComparedAlongTime:
    """Compare a calibration with all windows of a procedure that keeps blocks of time."""
    assert isinstance(procedure, TimedCellProcedure)
    means = procedure.means()
    if calibration.correction is not None and len(means.block):
        means, calibration = means.corrected(calibration.correction), replace(calibration, correction=None)
    search = ChangeSearch(means)
    change = search.find(calibration)
    if change.at_block is not None:
        change = replace(change, at_us=procedure.begun_us(change.at_block * means.block_samples))
    return ComparedAlongTime(change, search.compared(), means.blocks(), means.block_samples)


def cautions_along_time(
    calibration: Calibration, procedure: Procedure, limit_mg: float, utc_offset_s: int | None
) -> tuple[Reason, ...]:
    """Return the cautions of coefficients of another recording that do not fit this one all the time.

    Args:
        limit_mg: error that no usable calibration reaches.
        utc_offset_s: of the times that the cautions state.
    """
    along = compared_along_time(calibration, procedure)
    if along.compared is None:
        return ()
    assert isinstance(procedure, TimedCellProcedure)
    begun_us, samples = procedure.begun_us, along.block_samples

    def when(block: int) -> str | None:
        return None if block >= along.blocks else iso_time(begun_us(block * samples), utc_offset_s)

    checked = check(along.compared, along.change, along.blocks, limit_mg)
    if checked.degraded:
        changed = change_reason(along.change, utc_offset_s, followed=False)
        # the first period in which the calibration does not hold, and those that follow on it
        later = dropwhile(lambda one: not one.degraded, checked.periods)
        worse = list(takewhile(lambda one: one.degraded, later))
        since = when(worse[0].first) if worse[0].first else None
        worst = max(worse, key=lambda one: one.given_mg - one.unseen_mg)
        errors = {"error_mg": worst.given_mg, "new_mg": worst.unseen_mg}
        why = Reason.of("no_longer_fits", since=since, until=when(worse[-1].end), **errors)
        return (why, *([] if changed is None else [changed]))
    if checked.rises:
        before, late = checked.periods[0], checked.periods[-1]
        errors = {"error_mg": late.given_mg, "before_mg": before.given_mg}
        return (Reason.of("error_rises", since=when(late.first), **errors),)
    return ()


# Known coefficients applied to a recording.

READING = ("unit", "columns", "sensor", "lsb_per_g", "zero", "layout_sha256")
"""Reading options that change the values themselves."""

OF_THE_RECIPIENT = ("precision_mg", "max_damage_percent", "max_error_mg", "strict")
"""Settings that coefficients do not bring along: those of the recording that they are applied to."""

KNOWN = "known_orientations"
ANY_DEVICE = "use --any-device to apply them anyway"
UNSEEN = "coefficients of another recording: all points are held out"
REREAD = "coefficients of the same file read otherwise: points may have been fitted"


class Relation(Enum):
    """How a donor is related to the recipient.

    Attributes:
        OWN: it is the same recording, read as it is read now.
        REREAD: it is the same file, but was read otherwise.
        OTHER: it is another recording.
    """

    OWN = "own"
    REREAD = "reread"
    OTHER = "other"


def apply(
    job: Job, request: Request, progress: ProgressMaker = no_progress, source: Path | None = None
) -> Result:
    """Apply the request's coefficients to one recording, unless its outputs are up to date.

    Args:
        source: where the recording's bytes are, if not at the job's source.

    Raises:
        AccelcalError: it cannot be read, is not of the coefficients' device, lacks the temperature
            they need, or its outputs cannot be written.
    """
    assert request.coefficients is not None
    with open_run(job, request, progress, source) as opened:
        run, judge = with_coefficients(opened, request.coefficients)
        return run.complete(judge)


def with_coefficients(run: RecordingRun, donor: Coefficients) -> tuple[RecordingRun, DonorCoefficients]:
    """Return the run with a donor's coefficients and the settings that go with them, and its judge.

    Raises:
        UsageError: they cannot be applied to the recording, or not without the user saying so.
        UnreadableError: the donor's report has settings that cannot be.
    """
    recording, request = run.reader.recording, run.request
    if recording.calibrated is not None:
        hint = "apply them to the raw recording"
        raise UsageError(f"is {recording.calibrated.sentence()}", path=recording.path, hint=hint)
    relation = checked_relation(donor, recording, run.path_to_read, request)
    settings = settings_for(donor, relation, request.recording_settings)
    need_temperature(at_reference(donor.calibration, settings), recording, has=recording.has_temperature)
    request = replace(request, settings=settings, coefficients=donor)
    return replace(run, request=request), DonorCoefficients(settings, donor, relation)


@dataclass(frozen=True)
class DonorCoefficients(Judge):
    """Judges a donor's coefficients by the recipient's stillness."""

    donor: Coefficients
    relation: Relation

    @property
    def calibration(self) -> Calibration:
        """The calibration that is applied."""
        return at_reference(self.donor.calibration, self.settings)

    def method(self, recording: Recording) -> Method:
        """Return the method; raises UnreadableError if the recording's own report is damaged."""
        if self.relation is Relation.OWN:
            verdict = ("outcome", "reason", "values", "message", "notes", "cautions")
            check_sections(self.donor.document, (*COPIED, KNOWN, *verdict))
        return make_method(recording, self.settings)

    def verdict(self, run: RecordingRun, found: Survey) -> Verdict:
        """Return the donor's own verdict if it is this recording, else the errors on this one's points."""
        need_temperature(self.calibration, found.recording, has=found.facts.has_temperature)
        origin = {"coefficients": _origin_json(self.donor)}
        if found.damage is not None:
            return Verdict(found.damage, origin)
        if self.relation is not Relation.OWN:
            return Verdict(self._borrowed_judgement(found), self._donor_sections() | origin)
        report = self.donor.document.report
        notes, cautions = ([Reason(**one) for one in report.get(name, ())] for name in ("notes", "cautions"))
        own = Judgement(
            Outcome(report["outcome"]),
            Reason(report["reason"], report["values"]),
            found.coverage,
            (),
            self.donor.calibration,
            notes=(Reason("own_coefficients"), *notes),
            cautions=tuple(cautions),
            without_misalignment=self._simpler(None),
        )
        return Verdict(own, self._donor_sections() | origin)

    def _borrowed_judgement(self, found: Survey) -> Judgement:
        settings, calibration = self.settings, self.calibration
        method = REREAD if self.relation is Relation.REREAD else UNSEEN
        holdout = held_out(found.points, calibration, settings.gravity, settings.posture_degrees, method)
        verdict = judged_elsewhere(self.donor, calibration, found, holdout, settings.max_error_mg)
        if found.coverage.distinct_orientations >= settings.min_postures:
            limit_mg, offset_s = settings.max_error_mg, found.facts.utc_offset_s
            later = cautions_along_time(calibration, found.method.procedure, limit_mg, offset_s)
            verdict = replace(verdict, cautions=(*verdict.cautions, *later))
        return replace(verdict, without_misalignment=self._simpler(found.points, method))

    def _simpler(self, points: PointSet | None, method: str = "") -> WithoutMisalignment | None:
        """Return the donor's coefficients without misalignment, held out on some points."""
        if (simpler := without_misalignment(self.donor)) is None:
            return None
        settings, used = self.settings, at_reference(simpler, self.settings)
        place = settings.gravity, settings.posture_degrees
        holdout = None if points is None else held_out(points, used, *place, method)
        return WithoutMisalignment(used, holdout)

    def _donor_sections(self) -> dict[str, Any]:
        """Return the sections of the donor's report that hold here, too."""
        report = self.donor.document.report
        copied = COPIED if self.relation is Relation.OWN else ()
        if self.relation is Relation.OWN and "unchecked" in report.get(KNOWN, {}):
            copied = (*copied, KNOWN)  # which says why there is no error
        section, used = report["calibration"], self.calibration
        errors, spread = section["standard_errors"], section["covariance"]
        if used != self.donor.calibration and errors is not None:
            errors, spread = {name: errors[name] for name in errors if not name.startswith("s")}, None
        optimizer = {**section["optimizer"], "converged": section["optimizer"].get("converged")}
        section = {**section, **coefficients_json(used), "standard_errors": errors}
        section |= {"covariance": spread, "optimizer": optimizer}
        return {"calibration": section, **{name: report.get(name) for name in copied}}


def checked_relation(
    donor: Coefficients, recording: Recording, path_to_read: Path, request: Request
) -> Relation:
    """Return how a recording is related to the coefficients, if they may be applied to it.

    Raises:
        UsageError: they are not of the same device, or it is not known, and the user did not say
            that this does not matter; or they are its own, but not as they would be applied.
    """
    relation = relation_of(donor, recording, path_to_read, request)
    if relation is Relation.OWN:
        _refuse_changes(donor, recording, request.recording_settings)
        return relation
    if donor.calibration.correction is not None:
        raise UsageError(
            "the coefficients follow a sensor that changed while it made their own recording",
            path=recording.path,
            hint="find coefficients with --recalibrate never, or from the part of that recording that fits",
        )
    if not request.any_device:
        _refuse_other_device(donor, recording, relation)
    return relation


def relation_of(donor: Coefficients, recording: Recording, path_to_read: Path, request: Request) -> Relation:
    """Return how a recording is related to coefficients."""
    report, then = donor.document.report, donor.document.recording
    if then.bytes != size_of(path_to_read) and "coefficients" not in report:
        return Relation.OTHER
    if jobs.sha256(path_to_read) != donor.origin.sha256:
        return Relation.OTHER
    own = then.sha256 == donor.origin.sha256 and not _is_read_otherwise(donor.document, recording, request)
    return Relation.OWN if own else Relation.REREAD


def _is_read_otherwise(document: Document, recording: Recording, request: Request) -> bool:
    then = document.recording
    now_read = (recording.format, recording.rate_hz, recording.lsb_per_g)
    if (then.format, then.sample_rate_hz, then.lsb_per_g) != now_read:
        return True
    settings = document.report.get("settings")
    before = settings.get("input") if isinstance(settings, dict) else None
    if not isinstance(before, dict):
        return True
    now = jobs.input_settings(request.options, recording.companion)
    used = set(READING) - set(ignored_options(then.format))
    return any(before.get(name) != now.get(name) for name in used)


def _refuse_changes(donor: Coefficients, recording: Recording, wanted: Settings) -> None:
    """Refuse options by which a recording's own result would not be what was found."""
    calibration = donor.calibration
    if calibration.temperature is not None and not wanted.temperature:
        option = "--no-temperature"
    elif wanted.latitude is not None and wanted.gravity != calibration.gravity:
        option = "--latitude"
    else:
        return
    raise UsageError(
        f"the coefficients are this recording's own, and were found without {option}",
        path=recording.path,
        hint=f"omit {option}, or calibrate the recording again with it",
    )


def _refuse_other_device(donor: Coefficients, recording: Recording, relation: Relation) -> None:
    theirs, ours = donor.origin.device.serial, recording.device.serial
    if relation is Relation.REREAD:
        raise UsageError(
            "the coefficients were found from this file, but the report is of another one, "
            "or the file was read differently",
            path=recording.path,
            hint=f"give its own report and the reading options used for it, or {ANY_DEVICE}",
        )
    if theirs and theirs == ours:
        return
    if theirs and ours:
        text = f"was recorded by device {ours}, but the coefficients belong to device {theirs}"
    elif theirs:
        text = f"does not say which device recorded it, but the coefficients belong to device {theirs}"
    elif ours:
        text = f"was recorded by device {ours}, but the coefficients do not say which device they belong to"
    else:
        text = "neither the recording nor the coefficients say which device they come from"
    raise UsageError(printable(text), path=recording.path, hint=ANY_DEVICE)


def settings_for(donor: Coefficients, relation: Relation, wanted: Settings) -> Settings:
    """Return the settings that find and judge the recipient's stillness: the donor's, as far as they fit.

    Profile `paper` keeps only eighteen points; another recording is judged by all its points.

    Raises:
        UnreadableError: the donor's report has settings that cannot be.
    """
    section = donor.document.report.get("settings")
    known = isinstance(section, dict) and section.get("profile") != SIX_POSE
    settings = settings_from_report(donor.document).settings if known else DEFAULT
    base = settings if isinstance(settings, Settings) else DEFAULT
    limits = {name: getattr(wanted, name) for name in OF_THE_RECIPIENT}
    if relation is Relation.OWN:
        return replace(base, **limits)
    base = base if base.profile == DEFAULT.profile else DEFAULT
    place = wanted.gravity if wanted.latitude is not None else donor.calibration.gravity
    return replace(
        base,
        optimizer=DEFAULT.optimizer,
        model=DEFAULT.model,
        prior=DEFAULT.prior if base.prior in LEARNT_PRIORS else base.prior,
        temperature=wanted.temperature and donor.calibration.temperature is not None,
        latitude=place.latitude,
        altitude_m=place.altitude_m,
        **limits,
    )


def at_reference(calibration: Calibration, settings: Settings) -> Calibration:
    """Return a calibration without its slopes if no temperature is to be used."""
    if calibration.temperature is None or settings.temperature:
        return calibration
    still = (*calibration.parameters[:9], 0, 0, 0)
    model = calibration.model.removesuffix("T")
    return replace(calibration, model=model, parameters=still, temperature=None)


def need_temperature(calibration: Calibration, recording: Recording, *, has: bool) -> None:
    """Raise UsageError if a calibration has slopes but the recording no temperature."""
    if calibration.temperature is not None and not has:
        raise UsageError(
            "has no temperature, but the coefficients depend on it",
            path=recording.path,
            hint=f"--no-temperature applies them as at {calibration.reference_c():.1f} °C",
        )


def keep_coefficients(path: Path, planned: Sequence[Job]) -> None:
    """Raise UsageError if a job would overwrite the file that its coefficients come from."""
    for job in planned:
        if jobs.resolved_path(path) in {jobs.resolved_path(target) for target in job.outputs}:
            raise UsageError(
                "holds the coefficients and would be overwritten",
                path=path,
                hint="choose another folder with -d, or a name with -o",
            )


def judged_elsewhere(
    donor: Coefficients, calibration: Calibration, found: Survey, holdout: Holdout | None, limit_mg: float
) -> Judgement:
    """Judge a donor's coefficients by their errors on another recording's points; say whose they are."""
    origin, cautions = donor.origin, []
    device = " ".join(word for word in (origin.device.model, origin.device.serial) if word) or "unknown"
    whose = {"path": printable(origin.path), "sha256": origin.sha256[:12], "device": printable(device)}
    if holdout is not None and holdout.after.mean > holdout.before.mean:
        cautions.append(Reason("worse_here"))
    if holdout is not None and holdout.after.mean >= limit_mg:
        cautions.append(Reason.of("much_left", limit_mg=limit_mg))
    return Judgement(
        Outcome.BORROWED,
        Reason.of("borrowed", **whose, **errors_here(holdout)),
        found.coverage,
        (),
        calibration,
        notes=_differences(donor, calibration, found.recording),
        cautions=tuple(cautions),
        holdout=holdout,
    )


def errors_here(holdout: Holdout | None) -> dict[str, Any]:
    """Return the values of a reason that say how coefficients do on a recording's own points."""
    if holdout is None:
        return {"before_mg": None, "after_mg": None, "orientations": None}
    before, after = holdout.before.mean, holdout.after.mean
    return {"before_mg": before, "after_mg": after, "orientations": holdout.postures}


def _differences(donor: Coefficients, calibration: Calibration, recording: Recording) -> tuple[Reason, ...]:
    notes, then = [], donor.document.recording
    theirs, ours = donor.origin.device, recording.device
    if theirs.serial != ours.serial or not ours.serial:
        notes.append(Reason.of("other_device", serial=printable(ours.serial or "unknown")))
    elif theirs.model and ours.model and theirs.model != ours.model:
        notes.append(Reason.of("other_model", model=printable(ours.model)))
    found_there = then.sha256 == donor.origin.sha256
    if found_there and then.lsb_per_g not in (None, recording.lsb_per_g):
        notes.append(Reason("other_counts_per_g", {"here": recording.lsb_per_g, "there": then.lsb_per_g}))
    bare = then.factory_calibration is not None and then.factory_calibration.acceleration is not None
    if found_there and bare != recording.of_bare_sensor:
        notes.append(Reason.of("factory_calibration_differs", applied_here=not bare))
    if donor.calibration.temperature is not None and calibration.temperature is None:
        notes.append(Reason.of("slopes_left_out", at_c=donor.calibration.reference_c()))
    return tuple(notes)


def _origin_json(donor: Coefficients) -> dict[str, Any]:
    origin = donor.origin
    section = AppliedCoefficients(
        path=file_name(donor.document.path),
        sha256=donor.sha256,
        without_provenance=True if donor.by_content else None,
        recording_path=origin.path,
        recording_sha256=origin.sha256,
        device=origin.device,
        accelcal_version=origin.accelcal_version,
    )
    return as_json(section)


@dataclass(frozen=True, slots=True)
class Borrowed:
    """The outcome of borrowing.

    Attributes:
        result: with the coefficients of the first donor that was accepted; None if none was.
        reasons: why the donors before it were not.
    """

    result: Result | None
    reasons: tuple[Reason, ...]


def borrow(
    job: Job,
    request: Request,
    reports: Sequence[Path],
    progress: ProgressMaker = no_progress,
    *,
    must_be_better: bool,
    before: FileStamp | None = None,
) -> Borrowed:
    """Apply the coefficients of the first donor that stands the test.

    They are tested on all still windows of the recording, none of which they were found from: the error
    must be less than before (no more, where they change nothing), and below the settings' limit.

    Args:
        reports: reports of the same device's recordings, found with the request's settings.
        must_be_better: the error must also be less than that of the recording's own calibration, by more
            than the uncertainty.
        before: the recording's stamp when its own result was found; None if that does not matter.

    Raises:
        AccelcalError: the recording or a report cannot be read, or changed; or the outputs cannot be written.
    """
    with open_run(job, request, progress, before=before) as run:
        donors = [read_coefficients(path, by_content=True) for path in reports]
        return borrow_in(run, donors, must_be_better=must_be_better, tested=True)


def borrow_in(
    run: RecordingRun, donors: Sequence[Coefficients], *, must_be_better: bool = False, tested: bool = False
) -> Borrowed:
    """Do what `borrow` does, in an open run, with coefficients that were read.

    Args:
        tested: a recording whose stillness cannot test them borrows none.
    """
    prepare(run.job, force=run.request.force)
    own = run.result(OwnCalibration(run.request.recording_settings)) if must_be_better else None
    reasons: list[Reason] = []
    for donor in donors:
        try:
            recipient, judge = with_coefficients(run, donor)
            if judge.relation is not Relation.OTHER:
                raise UsageError("it is the same recording")
            found = recipient.result(judge)
            verdict = found.data.judgement
            if verdict.outcome is Outcome.REFUSED:
                return Borrowed(None, (verdict.reason,))
            if tested and verdict.holdout is None:
                return Borrowed(None, (Reason.of("untested", needed=FEWEST_POSTURES),))
            why = _why_not(judge, verdict.holdout, own)
        except UsageError as error:
            why = Reason.of("not_tried", message=printable(error.message))
        if why is None:
            # the file is named by its path from the report, so that both may be moved together
            path = Path(os.path.relpath(donor.document.path, run.job.report.parent)).as_posix()
            named = found.data.taken["coefficients"] | {"path": printable(path)}
            data = replace(found.data, taken=found.data.taken | {"coefficients": named})
            return Borrowed(recipient.write(replace(found, data=data)), tuple(reasons))
        reasons.append(Reason.of("donor", path=printable(donor.origin.path), why=why))
    return Borrowed(None, tuple(reasons))


def _why_not(judge: DonorCoefficients, holdout: Holdout | None, own: FirstPass | None) -> Reason | None:
    """Return why raw values, or the recording's own calibration, are preferred to a donor's; else None."""
    settings = judge.settings
    if holdout is not None:
        before, after, limit_mg = holdout.before.mean, holdout.after.mean, settings.max_error_mg
        if after > before or (after == before and judge.donor.calibration.model != "0"):
            return Reason.of("not_less", **errors_here(holdout))
        if after >= limit_mg:
            return Reason.of("over_limit_here", **errors_here(holdout), limit_mg=limit_mg)
    if own is None or (own_holdout := own.data.judgement.holdout) is None:
        return None
    borrowed = held_out(own.points, judge.calibration, settings.gravity, settings.posture_degrees, UNSEEN)
    if borrowed is not None and better(borrowed, own_holdout):
        return None
    after_mg = None if borrowed is None else borrowed.after.mean
    return Reason.of("own_is_no_worse", after_mg=after_mg, own_mg=own_holdout.after.mean)
