"""The two passes over an open recording: reading what is judged, and writing what is calibrated.

The main job: a recording in, calibrated Parquet and an honest report out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from accelcal_cli.core.points import PointSet
from accelcal_cli.core.recording import Reader
from accelcal_cli.core.results import Facts, Judgement
from accelcal_cli.core.system import give_back_freed_memory
from accelcal_cli.formats import open_recording
from accelcal_cli.judge.errors import coverage
from accelcal_cli.judge.verdict import advised, damage_verdict
from accelcal_cli.optimize import named_optimizer
from accelcal_cli.output import report as reports
from accelcal_cli.output.files import replacing, write_text
from accelcal_cli.output.report import ReportInput, integers_json
from accelcal_cli.pipeline.export import (
    Applier,
    Target,
    applier,
    beyond,
    calibrated,
    columns_of,
    write_calibrated,
)
from accelcal_cli.pipeline.jobs import (
    FileStamp,
    Job,
    ProgressMaker,
    Request,
    Result,
    check_unchanged,
    file_stamp,
    hashing,
    no_progress,
)
from accelcal_cli.pipeline.method import Method, fitting, make_method, optimizer_json
from accelcal_cli.pipeline.outputs import (
    prepare,
    remove,
    remove_stale_parquet,
    save_report,
    up_to_date,
    with_provenance,
)
from accelcal_cli.pipeline.survey import survey

SURVEYED_AT_ONCE = 4
"""Chunks of the first pass, which holds no row groups, are so many times as long as those of the second:
threads that each take Python's lock for longer wait less for each other."""


@dataclass(frozen=True, slots=True)
class Passes:
    """One open recording, what is asked for, and where the results go.

    Attributes:
        bytes_at: where the recording's bytes are; the job's source but for standard input.
        before: how it was before it was opened; None if it may change while it is read.
    """

    job: Job
    request: Request
    progress: ProgressMaker
    reader: Reader
    bytes_at: Path
    before: FileStamp | None = None

    def method(self) -> Method:
        """How the settings find and judge the recording's stillness."""
        return make_method(self.reader.recording, self.request.settings)

    def survey(self, method: Method) -> Facts:
        """First pass: facts, and still windows into the method."""
        recording, request = self.reader.recording, self.request
        shown = self.progress("reading", recording.total_bytes)
        chunks = self.reader.chunks(SURVEYED_AT_ONCE * request.chunk_samples)
        facts = survey(recording, chunks, method, shown, request.threads)
        give_back_freed_memory()
        return facts

    def found(self, method: Method, facts: Facts, judgement: Judgement, sha256: str) -> reports.ReportInput:
        """Everything the report says but what the second pass counts."""
        recording, settings = self.reader.recording, self.request.settings
        return reports.ReportInput(
            recording=replace(recording, path=self.job.source),
            sha256=sha256,
            facts=facts,
            settings=self.request.effective_settings(recording.companion),
            judgement=judgement,
            windows=method.procedure.window_use(method.segmenter.counts),
            optimizer=optimizer_json(named_optimizer(settings.optimizer), settings),
            clipped_after=None,
        )

    def write(self, data: reports.ReportInput, integers: dict[str, Any] | None = None) -> Result:
        """Parquet first, the report last: it is the commit mark.

        The report of an earlier result is removed only when the new Parquet is complete.

        Raises:
            UnreadableError: the recording changed between the passes or within one.
            OutputError: a file cannot be written.
        """
        check_unchanged(self.bytes_at, self.before)
        if writes_parquet(data):
            data = replace(data, clipped_after=self._write_parquet(data))
        else:
            remove_stale_parquet(self.job.parquet, reports.parquet_metadata(data))
        if integers is None:
            remove(self.job.integers)
        else:
            write_text(self.job.integers, reports.dumps(integers, pretty=False) + "\n")
        report = with_provenance(reports.build(data), self.request.command)
        save_report(self.job.report, report)
        return Result(self.job, report)

    def _write_parquet(self, data: reports.ReportInput) -> int:
        """Second pass; returns how many calibrated samples lie beyond the sensor's range."""
        # Not every run writes Parquet, and pyarrow takes as long to load as all of accelcal.
        from accelcal_cli.output.parquet import ParquetSink

        facts, recording = data.facts, data.recording
        columns, threads = columns_of(data), self.request.threads
        shown, metadata = self.progress("writing", recording.total_bytes), reports.parquet_metadata(data)
        chunks = self.reader.chunks(self.request.chunk_samples)
        with (
            replacing(self.job.parquet) as temporary,
            ParquetSink(temporary, self.job.parquet, columns, metadata, threads) as sink,
        ):
            target = Target(applier_of(data), sink, facts.utc_offset_s or 0, threads)
            over = write_calibrated(recording, chunks, target, shown)
            sink.close()
            check_unchanged(self.bytes_at, self.before)
            remove(self.job.report)
            return over

    def count_beyond(self, data: reports.ReportInput) -> reports.ReportInput:
        """Second pass without writing: what writing would have counted."""
        if not writes_parquet(data):
            return data
        if data.recording.range_g is None:
            return replace(data, clipped_after=0)
        shown = self.progress("applying", data.recording.total_bytes)
        chunks = self.reader.chunks(self.request.chunk_samples)
        parts = calibrated(data.recording, chunks, applier_of(data), shown)
        return replace(data, clipped_after=sum(beyond(xyz, data.recording.range_g) for _, xyz in parts))


def writes_parquet(data: reports.ReportInput) -> bool:
    """Whether calibrated data belong to a result."""
    return data.judgement.calibration is not None and not data.settings["report_only"]


def applier_of(data: reports.ReportInput) -> Applier:
    """What applies a result's calibration to its recording."""
    assert data.judgement.calibration is not None
    return applier(data.judgement.calibration, data.recording.lsb_per_g, data.settings["precision_mg"])


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
    before = file_stamp(path)
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
