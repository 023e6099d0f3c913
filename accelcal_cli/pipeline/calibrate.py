"""The main job: a recording in, calibrated Parquet and an honest report out."""

from __future__ import annotations

from pathlib import Path

from accelcal_cli.core.points import PointSet
from accelcal_cli.judge.damage import advised, damage_verdict
from accelcal_cli.judge.uncertainty import coverage
from accelcal_cli.output.integers import integers_json
from accelcal_cli.output.report import ReportInput
from accelcal_cli.pipeline.existing import prepare, up_to_date
from accelcal_cli.pipeline.identity import hashing, seen
from accelcal_cli.pipeline.passes import Passes
from accelcal_cli.pipeline.plan import Job
from accelcal_cli.pipeline.profiles import fitting
from accelcal_cli.pipeline.request import ProgressMaker, Request, Result, no_progress
from accelcal_cli.readers import open_recording


def calibrate(
    job: Job, request: Request, progress: ProgressMaker = no_progress, source: Path | None = None
) -> Result:
    """Calibrate one recording, unless its outputs are up to date.

    Args:
        source: where the recording's bytes are, if not at the job's source.

    Raises:
        AccelcalError: it cannot be read, or its outputs cannot be written.
    """
    path = source or job.source
    before = seen(path)
    with open_recording(path, request.options, request.threads) as reader:
        prepare(job, force=request.force)
        if not request.force and (held := up_to_date(job, path, reader.recording, request)) is not None:
            return held
        passes = Passes(job, request, progress, reader, path, before)
        data, points = judged(passes)
        return passes.write(data, integers_json(data, points) if request.integers else None)


def judged(passes: Passes) -> tuple[ReportInput, PointSet]:
    """First pass: survey the recording, fit and judge; nothing is written."""
    settings = passes.request.settings
    how, method = fitting(settings), passes.method()
    with hashing(passes.bytes_at) as digest:
        facts = passes.survey(method)
        points = method.procedure.points()
        spoiled = damage_verdict(facts, settings.max_damage_percent, coverage(points))
        verdict = spoiled or advised(method.procedure.judge(how), facts)
        data = passes.found(method, facts, verdict, digest.result())
    return data, points
