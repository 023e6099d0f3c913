"""What coefficients have to do with a recording: are they its own, its device's, another's?

What is said of borrowed coefficients: the report's `message`, and the warning on stderr.

Known coefficients onto a recording, judged by the recording's own stillness.

Coefficients of a device's other recordings onto one, if they prove themselves on its own stillness.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import UsageError, printable
from accelcal_cli.core.points import Calibration, PointSet
from accelcal_cli.core.recording import Recording
from accelcal_cli.core.results import Holdout, Judgement, Outcome
from accelcal_cli.core.settings import DEFAULT, SIX_POSE, Settings
from accelcal_cli.formats import open_recording
from accelcal_cli.judge.errors import coverage
from accelcal_cli.judge.verdict import FEWEST_POSTURES, better, damage_verdict, held_out
from accelcal_cli.output.report import ReportInput, coefficients_json
from accelcal_cli.output.report_reading import COPIED, Coefficients, check_sections, read_coefficients
from accelcal_cli.pipeline import calibrate
from accelcal_cli.pipeline.calibrate import Passes
from accelcal_cli.pipeline.jobs import (
    FileStamp,
    Job,
    ProgressMaker,
    Request,
    Result,
    file_stamp,
    hashing,
    no_progress,
    real,
    sha256,
)
from accelcal_cli.pipeline.outputs import prepare, up_to_date
from accelcal_cli.pipeline.report_settings import rebuild

READING = ("unit", "columns", "sensor", "lsb_per_g", "layout_sha256")
"""Reading options that decide the values themselves."""

ANY_DEVICE = "use --any-device to apply them all the same"


class Link(Enum):
    """Own: found from this very recording, read as it is read now. Reread: from the same file, but
    read otherwise. Other: from another recording."""

    OWN = "own"
    REREAD = "reread"
    OTHER = "other"


def link(donor: Coefficients, recording: Recording, bytes_at: Path, request: Request) -> Link:
    """How a recording and the coefficients to apply to it belong together.

    Raises:
        UsageError: they are not of the same device, or it is not known, and the user did not say
            that this does not matter; or they are its own, but not as they would be applied.
    """
    found = relation(donor, recording, bytes_at, request)
    if found is Link.OWN:
        _refuse_changes(donor, recording, request)
    elif not request.any_device:
        _refuse_other_device(donor, recording, found)
    return found


def relation(donor: Coefficients, recording: Recording, bytes_at: Path, request: Request) -> Link:
    """How a recording and coefficients belong together, whatever is asked for."""
    report = donor.document.report
    if report["recording"]["bytes"] != bytes_at.stat().st_size and "coefficients" not in report:
        return Link.OTHER
    if sha256(bytes_at) != donor.origin.sha256:
        return Link.OTHER
    own = report["recording"]["sha256"] == donor.origin.sha256
    return Link.OWN if own and not _read_otherwise(report, recording, request) else Link.REREAD


def _read_otherwise(report: dict[str, Any], recording: Recording, request: Request) -> bool:
    then = report["recording"]
    if (then["format"], then["sample_rate_hz"], then["lsb_per_g"]) != (
        recording.format,
        recording.rate_hz,
        recording.lsb_per_g,
    ):
        return True
    used = report.get("settings")
    before = used.get("input") if isinstance(used, dict) else None
    if not isinstance(before, dict):
        return True
    now = request.effective_settings(recording.companion)["input"]
    return any(before.get(name) != now[name] for name in READING)


def _refuse_changes(donor: Coefficients, recording: Recording, request: Request) -> None:
    """A recording's own result holds only as it was found."""
    found, wanted = donor.calibration, request.settings
    if found.temperature is not None and not wanted.temperature:
        option = "--no-temperature"
    elif wanted.latitude is not None and wanted.gravity != found.gravity:
        option = "--latitude"
    else:
        return
    raise UsageError(
        f"the coefficients are this recording's own, and {option} was not in their making",
        path=recording.path,
        hint=f"leave {option} out, or calibrate it again with it",
    )


def _refuse_other_device(donor: Coefficients, recording: Recording, found: Link) -> None:
    theirs, ours = donor.origin.device.serial, recording.device.serial
    if found is Link.REREAD:
        raise UsageError(
            "the coefficients are of this very file, but the report is not, or the file was read otherwise",
            path=recording.path,
            hint=f"give its own report and the reading options of then, or {ANY_DEVICE}",
        )
    if theirs and theirs == ours:
        return
    if theirs and ours:
        text = f"was recorded by device {ours}, the coefficients are those of device {theirs}"
    elif theirs:
        text = f"does not say which device recorded it, the coefficients are those of device {theirs}"
    elif ours:
        text = f"was recorded by device {ours}, the coefficients do not say whose they are"
    else:
        text = "neither it nor the coefficients say of which device they are"
    raise UsageError(printable(text), path=recording.path, hint=ANY_DEVICE)


def settings_for(donor: Coefficients, found: Link, wanted: Settings) -> Settings:
    """What finds and judges the recording's stillness: what was used on the donor's, as far as it fits.

    Profile `paper` keeps only eighteen points; another recording is judged by all it has.

    Raises:
        UnreadableError: the donor's report has settings that cannot be.
    """
    held = donor.document.report.get("settings")
    known = isinstance(held, dict) and held.get("profile") != SIX_POSE
    rebuilt = rebuild(donor.document).settings if known else DEFAULT
    base = rebuilt if isinstance(rebuilt, Settings) else DEFAULT
    base = replace(base, precision_mg=wanted.precision_mg)
    if found is Link.OWN:
        return replace(base, max_damage_percent=wanted.max_damage_percent)
    base = base if base.profile == DEFAULT.profile else DEFAULT
    place = wanted.gravity if wanted.latitude is not None else donor.calibration.gravity
    return replace(
        base,
        optimizer=DEFAULT.optimizer,
        precision_mg=wanted.precision_mg,
        model=DEFAULT.model,
        temperature=wanted.temperature and donor.calibration.temperature is not None,
        latitude=place.latitude,
        altitude_m=place.altitude_m,
        max_damage_percent=wanted.max_damage_percent,
    )


def applied(donor: Coefficients, settings: Settings) -> Calibration:
    """The calibration to apply: the donor's, at its reference temperature where none is to be used."""
    found = donor.calibration
    if found.temperature is None or settings.temperature:
        return found
    still = (*found.parameters[:9], 0, 0, 0)
    return replace(found, model=found.model.removesuffix("T"), parameters=still, temperature=None)


def need_temperature(calibration: Calibration, recording: Recording, *, has: bool) -> None:
    """Raise UsageError where slopes meet a recording without temperature."""
    if calibration.temperature is not None and not has:
        raise UsageError(
            "has no temperature, but the coefficients have slopes",
            path=recording.path,
            hint=f"--no-temperature uses them as at {calibration.reference_c():.1f} C",
        )


SHOWN_HASH = 12


def sentence(
    donor: Coefficients, calibration: Calibration, recording: Recording, held: Holdout | None, limit_mg: float
) -> str:
    """Whose the coefficients are, what they did, what is different here, and what to beware of."""
    beware = [] if held is None else _warnings(held.before.mean, held.after.mean, limit_mg)
    about = f"coefficients of {_named(donor)}: {_change(held)}"
    return printable("; ".join([about, *beware, *_notes(donor, calibration, recording)]))


def _named(donor: Coefficients) -> str:
    origin = donor.origin
    device = " ".join(word for word in (origin.device.model, origin.device.serial) if word)
    return f"{origin.path} (sha256 {origin.sha256[:SHOWN_HASH]}, device {device or 'unknown'})"


def _change(held: Holdout | None) -> str:
    if held is None:
        return "no two postures of stillness to judge them by"
    return (
        f"{held.before.mean:.1f} mg before, {held.after.mean:.2f} mg after "
        f"on {held.postures} postures, none of which they were found from"
    )


def _notes(donor: Coefficients, calibration: Calibration, recording: Recording) -> list[str]:
    """What is different from the donor, but does not hinder."""
    notes, then = [], donor.document.report["recording"]
    theirs, ours = donor.origin.device, recording.device
    if theirs.serial != ours.serial or not ours.serial:
        notes.append(f"this recording's device is {ours.serial or 'unknown'}")
    elif theirs.model and ours.model and theirs.model != ours.model:
        notes.append(f"this recording's device is a {ours.model} of the same serial")
    direct = then["sha256"] == donor.origin.sha256
    if direct and then["lsb_per_g"] not in (None, recording.lsb_per_g):
        notes.append(f"{recording.lsb_per_g:.10g} counts per g here, {then['lsb_per_g']:.10g} there")
    if donor.calibration.temperature is not None and calibration.temperature is None:
        at_c = donor.calibration.reference_c()
        notes.append(f"used as at {at_c:.1f} C, their temperature slopes are left out")
    return notes


def _warnings(before_mg: float, after_mg: float, limit_mg: float) -> list[str]:
    found = []
    if after_mg > before_mg:
        found.append("the error is larger with them than without")
    if after_mg >= limit_mg:
        found.append(f"{limit_mg:g} mg or more are left")
    return found


def warning(report: dict[str, Any]) -> str | None:
    """What a user must be told of a report of borrowed coefficients, or None."""
    held = report["holdout"]
    if report["outcome"] != Outcome.BORROWED or held is None:
        return None
    before_mg, after_mg = held["before_mg"]["mean"], held["after_mg"]["mean"]
    found = _warnings(before_mg, after_mg, report["settings"]["max_error_mg"])
    return f"warning: {report['message']}" if found else None


UNSEEN = "coefficients of another recording: all points are held out"
REREAD = "coefficients of the same file read otherwise: points may have been fitted"


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
    path, donor = source or job.source, request.coefficients
    assert donor is not None
    before = file_stamp(path)
    with open_recording(path, request.options, request.threads) as reader:
        found = link(donor, reader.recording, path, request)
        request = replace(request, settings=settings_for(donor, found, request.settings))
        calibration = applied(donor, request.settings)
        need_temperature(calibration, reader.recording, has=reader.recording.has_temperature)
        prepare(job, force=request.force)
        if not request.force and (held := up_to_date(job, path, reader.recording, request)) is not None:
            return held
        passes = Passes(job, request, progress, reader, path, before)
        return passes.write(judged(passes, donor, found))


def keep_coefficients(path: Path, jobs: list[Job]) -> None:
    """Raise UsageError where a job would write over the very file that its coefficients come from."""
    for job in jobs:
        if real(path) in {real(target) for target in (job.report, job.parquet, job.integers)}:
            raise UsageError(
                "holds the coefficients and would be overwritten",
                path=path,
                hint="choose another folder with -d, or a name with -o",
            )


def judged(passes: Passes, donor: Coefficients, found: Link) -> ReportInput:
    """First pass: survey the recording, and judge the coefficients; nothing is written.

    Raises:
        UnreadableError: the recording cannot be read on, or its own report is damaged.
    """
    if found is Link.OWN:
        check_sections(donor.document, COPIED)
    method, settings = passes.method(), passes.request.settings
    calibration = applied(donor, settings)
    with hashing(passes.bytes_at) as digest:
        facts = passes.survey(method)
        need_temperature(calibration, passes.reader.recording, has=facts.has_temperature)
        points = method.procedure.points()
        own = found is Link.OWN
        spoiled = damage_verdict(facts, settings.max_damage_percent, coverage(points))
        verdict = spoiled or (_own(donor, points) if own else _borrowed(passes, donor, found, points))
        data = passes.found(method, facts, verdict, digest.result())
    named = {"coefficients": _coefficients(donor)}
    return replace(data, taken=named if spoiled else _taken(donor, calibration, own=own) | named)


def _own(donor: Coefficients, points: PointSet) -> Judgement:
    """The recording's own verdict; its sections are taken from its report."""
    report = donor.document.report
    text = printable(f"{report['message']}; these are the recording's own coefficients")
    return Judgement(Outcome(report["outcome"]), text, coverage(points), (), donor.calibration)


def _borrowed(passes: Passes, donor: Coefficients, found: Link, points: PointSet) -> Judgement:
    settings = passes.request.settings
    calibration = applied(donor, settings)
    method = REREAD if found is Link.REREAD else UNSEEN
    held = held_out(points, calibration, settings.gravity, settings.posture_degrees, method)
    text = sentence(donor, calibration, passes.reader.recording, held, settings.max_error_mg)
    return Judgement(Outcome.BORROWED, text, coverage(points), (), calibration, holdout=held)


def _taken(donor: Coefficients, calibration: Calibration, *, own: bool) -> dict[str, Any]:
    """Sections of the donor's report that hold here too."""
    report = donor.document.report
    copied = {name: report[name] for name in COPIED} if own else {}
    return {
        "calibration": _calibration(report["calibration"], donor.calibration, calibration),
        **copied,
    }


def _calibration(section: dict[str, Any], whole: Calibration, used: Calibration) -> dict[str, Any]:
    if used == whole:
        return section
    errors = section["standard_errors"]
    kept = None if errors is None else {name: errors[name] for name in errors if not name.startswith("s")}
    return {**section, **coefficients_json(used), "standard_errors": kept}


def _coefficients(donor: Coefficients) -> dict[str, Any]:
    origin = donor.origin
    return {
        "path": printable(donor.document.path),
        "sha256": donor.sha256,
        **({"without_provenance": True} if donor.by_content else {}),
        "recording_path": origin.path,
        "recording_sha256": origin.sha256,
        "device": asdict(origin.device),
        "accelcal_version": origin.accelcal_version,
    }


@dataclass(frozen=True, slots=True)
class Loan:
    """What came of asking.

    Attributes:
        result: with the coefficients of the first that was accepted; None where none was.
        reasons: why those before it were not.
    """

    result: Result | None
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Own:
    """What a recording's own calibration does to its own points."""

    points: PointSet
    held: Holdout | None


def borrow(
    job: Job,
    request: Request,
    reports: Sequence[Path],
    progress: ProgressMaker = no_progress,
    *,
    must_be_better: bool,
    before: FileStamp | None = None,
) -> Loan:
    """Apply the coefficients of the first report that stands the test.

    They are tested on all still windows of the recording, none of which they were found from: the error
    must be less than before (no more, where they change nothing), and below the settings' limit.

    Args:
        reports: of recordings of the same device, found with the request's settings.
        must_be_better: also less than that of the recording's own calibration, by more than the
            uncertainty.
        before: how the recording was when its own result was found; None if that does not matter.

    Raises:
        AccelcalError: the recording or a report cannot be read, or changed; or the outputs cannot be written.
    """
    with open_recording(job.source, request.options, request.threads) as reader:
        prepare(job, force=request.force)
        passes = Passes(job, request, progress, reader, job.source, before)
        own = _own_result(passes) if must_be_better else None
        reasons: list[str] = []
        for path in reports:
            donor = read_coefficients(path, by_content=True)
            try:
                mine, data = _tested(passes, donor)
                if data.judgement.holdout is None:
                    return Loan(None, (_untested(data.judgement),))
                why = _why_not(data, donor.calibration) or _why_own(own, donor, mine)
            except UsageError as error:
                why = error.message
            if why is None:
                return Loan(mine.write(_placed(data, job)), tuple(reasons))
            reasons.append(printable(f"with the coefficients of {donor.origin.path}, {why}"))
        return Loan(None, tuple(reasons))


def _own_result(passes: Passes) -> _Own:
    data, points = calibrate.judged(passes)
    return _Own(points, data.judgement.holdout)


def _tested(passes: Passes, donor: Coefficients) -> tuple[Passes, ReportInput]:
    """The recording judged with coefficients, and the passes to write it.

    Raises:
        UsageError: they cannot be applied to it.
    """
    recording = passes.reader.recording
    found = link(donor, recording, passes.bytes_at, passes.request)
    if found is not Link.OTHER:
        raise UsageError("it is the same recording")
    settings = settings_for(donor, found, passes.request.settings)
    need_temperature(applied(donor, settings), recording, has=recording.has_temperature)
    mine = replace(passes, request=replace(passes.request, settings=settings, coefficients=donor))
    return mine, judged(mine, donor, found)


def _untested(verdict: Judgement) -> str:
    """Why no coefficients can be tested on a recording."""
    if verdict.outcome is Outcome.REFUSED:
        return verdict.message
    return f"there is no stillness in {FEWEST_POSTURES} postures to test coefficients on"


def _why_not(data: ReportInput, lent: Calibration) -> str | None:
    """Why coefficients are not accepted, or None."""
    held, limit_mg = data.judgement.holdout, data.settings["max_error_mg"]
    assert held is not None
    before, after = held.before.mean, held.after.mean
    changed = f"{before:.1f} mg become {after:.2f} mg on {held.postures} postures"
    if after > before or (after == before and lent.model != "0"):
        return f"{changed}, which is no less"
    return f"{changed}, {limit_mg:g} mg is the limit" if after >= limit_mg else None


def _why_own(own: _Own | None, donor: Coefficients, mine: Passes) -> str | None:
    """Why the recording's own calibration is preferred, or None."""
    if own is None or own.held is None:
        return None
    settings = mine.request.settings
    calibration = applied(donor, settings)
    lent = held_out(own.points, calibration, settings.gravity, settings.posture_degrees, UNSEEN)
    if lent is None or not better(lent, own.held):
        shown = "no" if lent is None else f"{lent.after.mean:.2f} mg"
        return f"{shown} instead of its own {own.held.after.mean:.2f} mg is no less beyond the uncertainty"
    return None


def _placed(data: ReportInput, job: Job) -> ReportInput:
    """The coefficient file by its way from the report, so that both may be moved together."""
    used = data.taken["coefficients"]
    way = Path(os.path.relpath(used["path"], job.report.parent)).as_posix()
    return replace(data, taken={**data.taken, "coefficients": {**used, "path": way}})
