"""Known coefficients onto a recording, judged by the recording's own stillness."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.judgement import Judgement, Outcome
from accelcal_cli.core.names import printable
from accelcal_cli.core.points import Calibration, PointSet
from accelcal_cli.judge.borrowed import held_out
from accelcal_cli.judge.damage import damage_verdict
from accelcal_cli.judge.uncertainty import coverage
from accelcal_cli.output.coefficients import COPIED, Coefficients
from accelcal_cli.output.document import check_sections
from accelcal_cli.output.report import ReportInput
from accelcal_cli.output.sections import coefficients_json
from accelcal_cli.pipeline.donor import Link, applied, link, need_temperature, settings_for
from accelcal_cli.pipeline.existing import prepare, up_to_date
from accelcal_cli.pipeline.identity import hashing, seen
from accelcal_cli.pipeline.passes import Passes
from accelcal_cli.pipeline.plan import Job, real
from accelcal_cli.pipeline.remarks import sentence
from accelcal_cli.pipeline.request import ProgressMaker, Request, Result, no_progress
from accelcal_cli.readers import open_recording

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
    before = seen(path)
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
