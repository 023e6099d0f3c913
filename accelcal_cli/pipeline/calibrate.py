"""The main job: a recording in, calibrated Parquet and a report out."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path

from accelcal_cli.core.recording import Reader
from accelcal_cli.optimize import named_optimizer
from accelcal_cli.output import report as reports
from accelcal_cli.output.atomic import replacing, write_text
from accelcal_cli.output.parquet import Columns, ParquetSink
from accelcal_cli.pipeline.applying import Target, applier, write_calibrated
from accelcal_cli.pipeline.existing import prepare, remove, up_to_date
from accelcal_cli.pipeline.identity import hashing
from accelcal_cli.pipeline.plan import Job
from accelcal_cli.pipeline.profiles import make_procedure, make_segmenter, optimizer_json
from accelcal_cli.pipeline.provenance import provenance
from accelcal_cli.pipeline.request import ProgressMaker, Request, Result, no_progress
from accelcal_cli.pipeline.survey import survey
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
    prepare(job, force=request.force)
    with open_recording(path, request.options) as reader:
        if not request.force and (held := up_to_date(job, path, request)) is not None:
            return held
        with hashing(path) as digest:
            data = _survey(reader, request, progress, digest)
        data = replace(data, recording=replace(data.recording, path=job.source))
        return _write(job, reader, data, request, progress)


def _survey(
    reader: Reader, request: Request, progress: ProgressMaker, digest: Future[str]
) -> reports.ReportInput:
    """First pass: everything the report says but what the second pass counts."""
    recording, settings = reader.recording, request.settings
    optimizer = named_optimizer(settings.optimizer)
    segmenter = make_segmenter(recording, settings)
    procedure = make_procedure(recording, settings, optimizer)
    shown = progress("reading", recording.total_bytes)
    chunks = reader.chunks(request.chunk_samples)
    facts = survey(recording, chunks, segmenter, procedure, shown)
    return reports.ReportInput(
        recording=recording,
        sha256=digest.result(),
        facts=facts,
        settings=request.effective_settings(),
        judgement=procedure.judge(),
        windows=procedure.window_use(segmenter.counts),
        optimizer=optimizer_json(optimizer, settings),
        clipped_after=None,
    )


def _write(
    job: Job, reader: Reader, data: reports.ReportInput, request: Request, progress: ProgressMaker
) -> Result:
    """Parquet first, the report last: it is the commit mark."""
    remove(job.report)
    if data.judgement.calibration is None or request.report_only:
        remove(job.parquet)
    else:
        beyond = _write_parquet(job, reader, data, request, progress)
        data = replace(data, clipped_after=beyond)
    report = {**reports.build(data), "provenance": provenance(list(request.command))}
    write_text(job.report, reports.dumps(report, pretty=True) + "\n")
    return Result(job, report)


def _write_parquet(
    job: Job, reader: Reader, data: reports.ReportInput, request: Request, progress: ProgressMaker
) -> int:
    """Second pass; returns how many calibrated samples lie beyond the sensor's range."""
    calibration, facts, recording = data.judgement.calibration, data.facts, data.recording
    assert calibration is not None
    columns = Columns(facts.has_temperature, facts.has_gyroscope, facts.utc_offset_s is not None)
    apply = applier(calibration, recording.lsb_per_g)
    shown = progress("writing", recording.total_bytes)
    with (
        replacing(job.parquet) as temporary,
        ParquetSink(temporary, job.parquet, columns, reports.parquet_metadata(data)) as sink,
    ):
        return write_calibrated(
            recording,
            reader.chunks(request.chunk_samples),
            Target(apply, sink, facts.utc_offset_s or 0),
            shown,
        )
