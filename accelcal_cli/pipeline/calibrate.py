"""The main job: a recording in, calibrated Parquet and an honest report out."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from accelcal_cli.core.recording import Reader
from accelcal_cli.optimize import named_optimizer
from accelcal_cli.output import report as reports
from accelcal_cli.output.atomic import replacing, write_text
from accelcal_cli.output.integers import integers_json
from accelcal_cli.output.parquet import Columns, ParquetSink
from accelcal_cli.pipeline.applying import Target, applier, write_calibrated
from accelcal_cli.pipeline.existing import prepare, remove, remove_stale_parquet, up_to_date
from accelcal_cli.pipeline.identity import hashing
from accelcal_cli.pipeline.plan import Job
from accelcal_cli.pipeline.profiles import Fitting, Method, fitting, make_method, optimizer_json
from accelcal_cli.pipeline.request import ProgressMaker, Request, Result, no_progress
from accelcal_cli.pipeline.save import save_report, with_provenance
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
    with open_recording(path, request.options) as reader:
        prepare(job, force=request.force)
        if not request.force and (held := up_to_date(job, path, reader.recording, request)) is not None:
            return held
        return _Run(job, request, progress, reader).run(path)


@dataclass(frozen=True, slots=True)
class _Run:
    """One calibration of one open recording."""

    job: Job
    request: Request
    progress: ProgressMaker
    reader: Reader

    def run(self, path: Path) -> Result:
        """Survey, judge, write; `path` is where the bytes are."""
        settings = self.request.settings
        how, method = fitting(settings), make_method(self.reader.recording, settings)
        with hashing(path) as digest:
            data = self._survey(method, how, digest)
        data = replace(data, recording=replace(data.recording, path=self.job.source))
        points = method.procedure.points()
        return self._write(data, integers_json(data, points) if self.request.integers else None)

    def _survey(self, method: Method, how: Fitting, digest: Future[str]) -> reports.ReportInput:
        """First pass: everything the report says but what the second pass counts."""
        recording, settings = self.reader.recording, self.request.settings
        shown = self.progress("reading", recording.total_bytes)
        chunks = self.reader.chunks(self.request.chunk_samples)
        facts = survey(recording, chunks, method, shown)
        return reports.ReportInput(
            recording=recording,
            sha256=digest.result(),
            facts=facts,
            settings=self.request.effective_settings(recording.companion),
            judgement=method.procedure.judge(how),
            windows=method.procedure.window_use(method.segmenter.counts),
            optimizer=optimizer_json(named_optimizer(settings.optimizer), settings),
            clipped_after=None,
        )

    def _write(self, data: reports.ReportInput, integers: dict[str, Any] | None) -> Result:
        """Parquet first, the report last: it is the commit mark.

        The report of an earlier result is removed only when the new Parquet is complete.
        """
        if data.judgement.calibration is None or self.request.report_only:
            remove_stale_parquet(self.job.parquet, reports.parquet_metadata(data))
        else:
            data = replace(data, clipped_after=self._write_parquet(data))
        if integers is None:
            remove(self.job.integers)
        else:
            write_text(self.job.integers, reports.dumps(integers, pretty=False) + "\n")
        report = with_provenance(reports.build(data), self.request.command)
        save_report(self.job.report, report)
        return Result(self.job, report)

    def _write_parquet(self, data: reports.ReportInput) -> int:
        """Second pass; returns how many calibrated samples lie beyond the sensor's range."""
        calibration, facts, recording = data.judgement.calibration, data.facts, data.recording
        assert calibration is not None
        columns = Columns(facts.has_temperature, facts.has_gyroscope, facts.utc_offset_s is not None)
        apply = applier(calibration, recording.lsb_per_g)
        shown = self.progress("writing", recording.total_bytes)
        chunks = self.reader.chunks(self.request.chunk_samples)
        with (
            replacing(self.job.parquet) as temporary,
            ParquetSink(temporary, self.job.parquet, columns, reports.parquet_metadata(data)) as sink,
        ):
            target = Target(apply, sink, facts.utc_offset_s or 0)
            beyond = write_calibrated(recording, chunks, target, shown)
            sink.close()
            remove(self.job.report)
            return beyond
