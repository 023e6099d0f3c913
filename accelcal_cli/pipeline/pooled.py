"""A pool's coefficients onto one of its recordings."""

from __future__ import annotations

from dataclasses import replace

from accelcal_cli.core.judgement import Coverage, Holdout, Judgement, Outcome
from accelcal_cli.core.names import printable
from accelcal_cli.core.points import Calibration
from accelcal_cli.judge.borrowed import held_out
from accelcal_cli.judge.damage import damage_verdict
from accelcal_cli.judge.pooled import SEEN, worse
from accelcal_cli.judge.uncertainty import coverage
from accelcal_cli.output.coefficients import calibration_of
from accelcal_cli.output.document import Document, check_sections
from accelcal_cli.output.pool_report import TAKEN, of_member
from accelcal_cli.output.report import ReportInput
from accelcal_cli.pipeline.existing import prepare
from accelcal_cli.pipeline.identity import Seen, hashing
from accelcal_cli.pipeline.passes import Passes
from accelcal_cli.pipeline.plan import Job
from accelcal_cli.pipeline.request import ProgressMaker, Request, Result, no_progress
from accelcal_cli.readers import open_recording


def apply_pool(
    job: Job,
    request: Request,
    document: Document,
    progress: ProgressMaker = no_progress,
    before: Seen | None = None,
) -> Result | str:
    """Apply a pool's coefficients to one of its recordings.

    Args:
        before: how the recording was when the pool was made; None if that does not matter.

    Returns:
        the result, or why the recording keeps its own: they make it worse.

    Raises:
        AccelcalError: it or the pool's report cannot be read, or it changed; or the outputs cannot be
            written.
    """
    with open_recording(job.source, request.options, request.threads) as reader:
        prepare(job, force=request.force)
        passes = Passes(job, request, progress, reader, job.source, before)
        data, held = judged(passes, document)
        why = _why_not(data, document, held)
        return passes.write(data) if why is None else why


def judged(passes: Passes, document: Document) -> tuple[ReportInput, Holdout | None]:
    """First pass: survey the recording, and what the pool does to its stillness; nothing is written."""
    check_sections(document, (*TAKEN, "outcome", "message", "pool"))
    calibration = calibration_of(document.report["calibration"])
    method, settings = passes.method(), passes.request.settings
    with hashing(passes.bytes_at) as digest:
        facts = passes.survey(method)
        points = method.procedure.points()
        held = held_out(points, calibration, settings.gravity, settings.posture_degrees, SEEN)
        seen = coverage(points)
        spoiled = damage_verdict(facts, settings.max_damage_percent, seen)
        verdict = spoiled or _verdict(document, calibration, held, seen)
        data = passes.found(method, facts, verdict, digest.result())
    taken = {} if spoiled else of_member(document, passes.job.report, held)
    return replace(data, taken=taken), held


def _verdict(document: Document, calibration: Calibration, held: Holdout | None, seen: Coverage) -> Judgement:
    report = document.report
    said = report["pool"]
    about = f"pool of {len(said['recordings'])} recordings of device {said['serial']}: {report['message']}"
    own = "no two postures of stillness of its own"
    if held is not None:
        own = f"{held.before.mean:.1f} mg before, {held.after.mean:.2f} mg after on its own stillness"
    return Judgement(Outcome(report["outcome"]), printable(f"{about}; {own}"), seen, (), calibration)


def _why_not(data: ReportInput, document: Document, held: Holdout | None) -> str | None:
    """Why a recording keeps its own result, or None."""
    if data.judgement.outcome is Outcome.REFUSED:
        return data.judgement.message
    for one in document.report["pool"]["left_out"]:
        if one["sha256"] == data.sha256:
            return f"left out of the pool: {one['reason']}"
    usual_mg = document.report["holdout"]["after_mg"]["median"]
    return None if held is None else worse(held, usual_mg, data.settings["max_error_mg"])
