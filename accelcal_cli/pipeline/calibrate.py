"""The main job: a recording in, calibrated Parquet and a report out.

`RecordingRun` is one open recording. Its first pass surveys the recording and asks a `Judge`: for the
calibration found from the recording itself (here), for known coefficients (`apply`), for those of a pool
(`pool`), or for known orientations (`six_pose.run`). Its second pass writes what is calibrated.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.collect.subsets import PaperCollector
from accelcal_cli.core.errors import OutputError, Reason
from accelcal_cli.core.parallel import background_result
from accelcal_cli.core.points import PointSet
from accelcal_cli.core.prior import LearntPrior
from accelcal_cli.core.recording import Chunk, Reader, Recording
from accelcal_cli.core.results import Coverage, Facts, Judgement, Outcome
from accelcal_cli.core.settings import (
    NO_PRIOR,
    PAPER,
    VARIED,
    PoseSettings,
    Settings,
    other_rules,
    rule_options,
)
from accelcal_cli.judge.change import change_reason
from accelcal_cli.judge.errors import coverage
from accelcal_cli.judge.model_ladder import postures
from accelcal_cli.judge.verdict import (
    damage_verdict,
    judge_calibrated,
    refuse_provisional_if_rest_is_odd,
    with_advice,
)
from accelcal_cli.output import report as reports
from accelcal_cli.output.coefficients import prior_json
from accelcal_cli.output.files import metadata_of, replacing, write_text
from accelcal_cli.output.quality import QualityInput, dumps_quality, quality_json
from accelcal_cli.output.report import ReportInput, draws_json, gyroscope_json, integers_json
from accelcal_cli.pipeline import export, jobs, outputs, procedures, survey
from accelcal_cli.pipeline.activity import EPOCH_S, EffectMeter, drawn_of, versions_of
from accelcal_cli.pipeline.facts import (
    FactsObserver,
    Timeline,
    Turning,
    along_time,
    gyroscope_of,
    timeline_of,
)
from accelcal_cli.pipeline.jobs import FileStamp, Job, ProgressMaker, Request, Result, no_progress
from accelcal_cli.pipeline.options import name_options_as_in_file
from accelcal_cli.pipeline.windows import WindowLog

SURVEYED_AT_ONCE, CALIBRATED_AT_ONCE = 4, 2
"""Factors on the length of chunks in the first pass, and in the second, which holds row groups. Threads that
each take Python's lock for longer wait less for each other."""

HASHED_IN_BACKGROUND = 1 << 24
"""Size [bytes] from which a recording is hashed by a thread of its own."""

UNLIKE = Reason("unlike_prior")


def calibrate(
    job: Job, request: Request, progress: ProgressMaker = no_progress, source: Path | None = None
) -> Result:
    """Calibrate one recording from its own stillness, unless its outputs are up to date.

    Args:
        source: where the recording's bytes are, if not at the job's source.

    Raises:
        AccelcalError: it cannot be read, or its outputs cannot be written.
    """
    with open_run(job, request, progress, source) as run:
        return run.complete(OwnCalibration(request.recording_settings))


def calibrate_with(
    job: Job,
    request: Request,
    learnt: LearntPrior,
    progress: ProgressMaker = no_progress,
    *,
    must_calibrate: bool = False,
    before: FileStamp | None = None,
) -> Result | Reason:
    """Calibrate one recording with a prior from other recordings.

    Args:
        must_calibrate: a refusal is not written.
        before: the recording's stamp when its own result was found.

    Returns:
        the result, or why none is written: the refusal, or that the points speak against the prior.

    Raises:
        AccelcalError: it cannot be read, or changed, or its outputs cannot be written.
    """
    request = replace(request, settings=replace(request.recording_settings, prior=learnt.kind))
    with open_run(job, request, progress, before=before) as run:
        outputs.prepare(job, force=request.force)
        found = run.result(OwnCalibration(request.recording_settings, learnt))
        judgement = found.data.judgement
        if judgement.unlike:
            return UNLIKE
        if must_calibrate and judgement.outcome is Outcome.REFUSED:
            return judgement.reason
        return run.write(found, integers_json(found.data, found.points) if request.integers else None)


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """The findings of the first pass over a recording.

    Attributes:
        method: with all still windows taken in.
        points: those of its procedure.
        damage: the refusal of a recording that is too damaged; None for any other.
    """

    recording: Recording
    facts: Facts
    method: procedures.Method
    points: PointSet
    coverage: Coverage
    damage: Judgement | None


def summarise_first_pass(
    recording: Recording, facts: Facts, method: procedures.Method, settings: Settings | PoseSettings
) -> tuple[Survey, NDArray[np.int64]]:
    """Return the findings of a first pass that is over, and the number of each point's posture."""
    points = method.procedure.result()
    posture = postures(points, settings.posture_degrees)
    covered = coverage(points, posture)
    damage = damage_verdict(facts, settings.max_damage_percent, covered)
    return Survey(recording, facts, method, points, covered, damage), posture


@dataclass(frozen=True, slots=True)
class Verdict:
    """The decision of a judge.

    Attributes:
        sections: of the report, instead of those that follow from the judgement, or besides them.
        used_windows: how many still windows were used, where the procedure does not know.
    """

    judgement: Judgement
    sections: dict[str, Any] = field(default_factory=dict)
    used_windows: int | None = None


@dataclass(frozen=True)
class Judge:
    """Decides what comes of a recording.

    Attributes:
        settings: how stillness is found and judged.
    """

    settings: Settings
    revolutions: ClassVar[bool] = False
    """True if whole revolutions count for the gyroscope, as in a session."""

    def method(self, recording: Recording) -> procedures.Method:
        """Return the method of the first pass."""
        return procedures.make_method(recording, self.settings)

    def optimizer(self) -> dict[str, Any]:
        """Return the report's `optimizer`; raises UsageError for an unknown one."""
        return procedures.optimizer_json(self.settings)

    def verdict(self, run: RecordingRun, found: Survey) -> Verdict:
        """Judge the findings of the first pass."""
        raise NotImplementedError


@dataclass(frozen=True)
class OwnCalibration(Judge):
    """Fits a recording's own points.

    Attributes:
        learnt: the prior from other recordings; None: that of the settings.
    """

    learnt: LearntPrior | None = None

    def verdict(self, run: RecordingRun | None, found: Survey) -> Verdict:
        """Return the judgement of the profile's procedure; it needs no run."""
        learnt, recording, procedure = self.learnt, found.recording, found.method.procedure
        if found.damage is not None:
            judgement = found.damage
        elif recording.calibrated is not None:
            how = procedures.fitting(replace(self.settings, prior=NO_PRIOR))
            judgement = judge_calibrated(found.points, how, recording.calibrated.sentence())
        else:
            settings = refuse_provisional_if_rest_is_odd(self.settings, found.facts, recording)
            how = procedures.fitting(settings, None if learnt is None else learnt.prior)
            judgement = with_advice(procedure.judge(how), found.facts, recording, self.settings)
            judgement = self._with_notes(judgement, found)
        if isinstance(procedure, procedures.PaperProcedure):
            judgement = with_collection_time(judgement, procedure.collector, recording)
        return Verdict(judgement, {} if learnt is None else {"prior": prior_json(learnt)})

    def _with_notes(self, judgement: Judgement, found: Survey) -> Judgement:
        """Return the judgement with notes on prior, windows and rule, and the caution of a change."""
        notes = [] if self.learnt is None else [self.learnt.reason()]
        if repeated := found.method.segmenter.counts.repeated:
            notes.append(Reason.of("windows_repeated", windows=repeated))
        if self.settings.other_stillness and any(
            getattr(self.settings, name) != getattr(PAPER, name) for name in VARIED
        ):
            notes.append(Reason.of("other_stillness", options=rule_options(self.settings)))
        change = None
        if judgement.change is not None:
            followed = judgement.calibration is not None and judgement.calibration.correction is not None
            change = change_reason(judgement.change, found.facts.utc_offset_s, followed=followed)
        cautions = (*judgement.cautions, *([] if change is None else [change]))
        return replace(judgement, notes=(*judgement.notes, *notes), cautions=cautions)


def with_collection_time(judgement: Judgement, collector: PaperCollector, recording: Recording) -> Judgement:
    """Return the judgement with the hours after which F's nine subsets were full, if they are."""
    if collector.full_after is None:
        return judgement
    hours = round(collector.full_after / recording.rate_hz / 3600, 6)
    return replace(judgement, coverage=replace(judgement.coverage, subsets_full_after_h=hours))


@contextmanager
def open_run(
    job: Job,
    request: Request,
    progress: ProgressMaker = no_progress,
    source: Path | None = None,
    before: FileStamp | None = None,
) -> Iterator[RecordingRun]:
    """Open a job's recording.

    Args:
        source: where the recording's bytes are, if not at the job's source.
        before: its stamp when an earlier result was found that must be of the same bytes.

    Raises:
        AccelcalError: it cannot be read.
    """
    path = source or job.source
    before = before or jobs.file_stamp(path)
    said, request = request.choices_of(path), request.for_recording(path)
    session = isinstance(request.settings, PoseSettings)
    with (
        name_options_as_in_file(said),
        survey.open_marked(
            path, request.options, request.threads, request.unused, session=session, joined=request.joined
        ) as reader,
    ):
        if reader.recording.calibrated is not None:  # already calibrated: do not write a second copy
            request = replace(request, report_only=True)
        yield RecordingRun(job, request, progress, reader, path, before)


@dataclass(frozen=True, slots=True, eq=False)
class FirstPass:
    """The result of the first pass.

    Attributes:
        data: all that the report says but what the second pass counts.
        points: the recording's points, corrected where its sensor changed.
        raw: the points before that; posture: (n,) number of the posture of each.
        method: with all still windows taken in.
        timeline: what was counted along time; None for a procedure without blocks of time.
        log: all still windows, if they are asked for.
    """

    data: ReportInput
    points: PointSet
    raw: PointSet
    posture: NDArray[np.int64]
    method: procedures.Method
    timeline: Timeline | None
    log: WindowLog | None = None

    def quality(self) -> QualityInput | None:
        """Return the recording along time; None without blocks of time."""
        if self.timeline is None:
            return None
        return along_time(self.data, self.raw, self.posture, self.method, self.timeline)


@dataclass(frozen=True, slots=True)
class RecordingRun:
    """One open recording, what is asked for, and where the results go.

    Attributes:
        path_to_read: where the recording's bytes are; the job's source except standard input.
        before: its stamp before it was opened; None if it may change while it is read.
    """

    job: Job
    request: Request
    progress: ProgressMaker
    reader: Reader
    path_to_read: Path
    before: FileStamp | None = None

    def complete(self, judge: Judge) -> Result:
        """Return the existing result if it still holds, else that of both passes.

        Raises:
            AccelcalError: see `result` and `write`; or the outputs are those of another recording, or files
                that are read.
        """
        job, read = self.job, (self.reader.recording.companion, self.request.poses)
        jobs.refuse_overwriting((*job.outputs, *self._windows), read)
        outputs.prepare(job, self._windows, force=self.request.force)
        if not self.request.force:
            existing = outputs.up_to_date(self.job, self.path_to_read, self.reader.recording, self.request)
            if existing is not None and self.request.windows is None:
                return existing
        found = self.result(judge, logged=self.request.windows is not None)
        if found.log is not None and self.request.windows is not None:
            jobs.check_unchanged(self.path_to_read, self.before)
            found.log.write(self.request.windows, found.data, found.points)
        return self.write(found, integers_json(found.data, found.points) if self.request.integers else None)

    @property
    def _windows(self) -> tuple[Path, ...]:
        return () if self.request.windows is None else (self.request.windows,)

    def result(self, judge: Judge, *, logged: bool = False) -> FirstPass:
        """Do the first pass: survey the recording and judge it; nothing is written.

        A recording that profile `paper` refuses by one rule of stillness may be calibrated by another. It is
        used then, or advised where the user chose the rule.

        Args:
            logged: keep all still windows.

        Raises:
            UnreadableError: the recording cannot be read on.
        """
        found = self._first_pass(judge, logged)
        procedure, verdict = found.method.procedure, found.data.judgement
        near_1_g = isinstance(procedure, procedures.PaperProcedure) and len(procedure.collector) > 0
        if not (near_1_g and verdict.outcome is Outcome.REFUSED):
            return found
        for settings in other_rules(judge.settings):
            run = replace(self, request=replace(self.request, settings=settings))
            other = run._first_pass(replace(judge, settings=settings), logged)
            if other.data.judgement.calibration is not None:
                if judge.settings.other_stillness:
                    return other
                helps = Reason.of("use_options", options=f"--profile paper {rule_options(settings)}")
                verdict = replace(verdict, advice=(helps, *verdict.advice))
                return replace(found, data=replace(found.data, judgement=verdict))
        return found

    def _first_pass(self, judge: Judge, logged: bool) -> FirstPass:
        recording, optimizer, log = self.reader.recording, judge.optimizer(), WindowLog() if logged else None
        method = judge.method(recording)
        method = method if log is None else log.watch(method, recording.rate_hz)
        timeline = timeline_of(method, recording)
        turns = (
            None if recording.gyro_dps_per_lsb is None else Turning(recording, revolutions=judge.revolutions)
        )
        others = [one for one in (log, timeline, turns) if one is not None]
        facts = self.survey(method, *others)
        long = recording.total_bytes >= HASHED_IN_BACKGROUND
        with background_result(partial(jobs.sha256, self.path_to_read), long=long) as digest:
            found, posture = summarise_first_pass(recording, facts, method, self.request.settings)
            raw, verdict = found.points, judge.verdict(self, found)
            points = method.procedure.result()  # of a sensor that changed they are put right
            gyroscope = None if turns is None else gyroscope_of(turns, verdict.judgement, judge.settings)
            sha256 = digest()
        windows = method.procedure.window_use(method.segmenter.counts)
        used = windows.used if verdict.used_windows is None else verdict.used_windows
        data = ReportInput(
            recording=replace(recording, path=self.job.source),
            sha256=sha256,
            facts=facts,
            settings=self.request.effective_settings(recording.companion),
            judgement=verdict.judgement,
            windows=replace(windows, used=used),
            optimizer=optimizer,
            clipped_after=None,
            taken=verdict.sections | ({} if gyroscope is None else {"gyroscope": gyroscope_json(gyroscope)}),
            gyroscope=gyroscope,
        )
        return FirstPass(data, points, raw, posture, method, timeline, log)

    def survey(self, method: procedures.Method, *others: survey.Observer) -> Facts:
        """Show the recording to the method and other observers, and return its facts."""
        recording, request = self.reader.recording, self.request
        facts = FactsObserver(recording, method.rest_lsb, method.segmenter.gaps)
        observers = (facts, method.procedure, *others)
        shown = self.progress("reading", recording.total_bytes)
        chunks = self.reader.chunks(SURVEYED_AT_ONCE * request.chunk_samples)
        survey.survey(chunks, method.segmenter, observers, shown, request.threads)
        return method.completed(facts.result())

    def write(self, found: FirstPass, integers: dict[str, Any] | None = None) -> Result:
        """Write Parquet first, and the report last: it is the commit mark.

        The report of an earlier result is removed only when the new Parquet is complete, or none is due.

        Raises:
            UnreadableError: the recording changed between the passes or within one.
            OutputError: a file cannot be written.
        """
        data, metadata = found.data, reports.parquet_metadata(found.data)
        jobs.check_unchanged(self.path_to_read, self.before)
        kept = outputs.keeps(data.judgement.calibration is not None, self.request)
        written = self.job.uncalibrated if kept else self.job.parquet if writes_parquet(data) else None
        if written is None:
            data = self.count_beyond(data)
            outputs.remove(self.job.report)
        else:
            effect = self._effect(data)
            over = self._write_parquet(data, written, effect)
            data = _with_effect(data if kept else replace(data, clipped_after=over), effect)
        for path in {self.job.parquet, self.job.uncalibrated} - {written}:
            outputs.remove_stale_parquet(path, metadata)
        held = data.judgement.calibration is not None
        drawn = draws_json(data, self.request.draws) if held and self.request.draws else None
        for path, made in ((self.job.integers, integers), (self.job.draws, drawn)):
            if made is None:
                outputs.remove_ours(path)
            else:
                write_text(path, reports.dumps(made, pretty=False) + "\n")
        if (quality := found.quality()) is None:
            outputs.remove_ours(self.job.quality)
        else:
            write_text(self.job.quality, dumps_quality(quality_json(quality)))
        outputs.remove_page(self.job.page)
        donor = None if self.request.coefficients is None else self.request.coefficients.document.path
        report = outputs.with_provenance(
            reports.build(data), self.request.command, recording=self.job.source, coefficients=donor
        )
        if written is not None and metadata_of(written) != outputs.json_round_trip(metadata):
            what, hint = "was replaced by another run while this one went on", "run it again alone"
            raise OutputError(what, path=written, hint=hint)
        outputs.save_report(self.job.report, report)
        return Result(self.job, report, kept=kept)

    def _write_parquet(self, data: ReportInput, path: Path, effect: EffectMeter | None) -> int:
        """Do the second pass; return how many of the samples written lie beyond the sensor's range."""
        # Not every run writes Parquet, and pyarrow takes as long to load as all of accelcal.
        from accelcal_cli.output.columns import schema_of
        from accelcal_cli.parquet import ParquetSink

        columns, threads = export.columns_of(data), self.request.threads
        schema = schema_of(columns, reports.parquet_metadata(data))
        shown = self.progress("writing", data.recording.total_bytes)
        self.reader.with_others = bool(data.recording.others)
        chunks = self._chunks(effect)
        with replacing(path) as temporary, ParquetSink(temporary, path, columns, schema, threads) as sink:
            over = export.write_calibrated(data, chunks, sink, threads, shown)
            sink.close()
            jobs.check_unchanged(self.path_to_read, self.before)
            outputs.remove(self.job.report)
            return over

    def count_beyond(self, data: ReportInput) -> ReportInput:
        """Do the second pass without writing, and return the result with what writing would have found."""
        range_g, effect = data.recording.range_g, self._effect(data)
        over = 0 if writes_parquet(data) else None
        counting = over is not None and range_g is not None
        if counting or effect is not None:
            shown = self.progress("applying", data.recording.total_bytes)
            applied, total = export.transform_of(data), 0
            for chunk in self._chunks(effect):
                total += export.beyond(chunk, applied, range_g)
                shown(chunk.end_byte)
            over = total if counting else over
        return _with_effect(replace(data, clipped_after=over), effect)

    def _effect(self, data: ReportInput) -> EffectMeter | None:
        """Return the meter of activity for the second pass, if it is asked for and there is a calibration."""
        if not self.request.effect or data.judgement.calibration is None:
            return None
        return EffectMeter(versions_of(data), data.recording, EPOCH_S, drawn_of(data))

    def _chunks(self, effect: EffectMeter | None) -> Iterator[Chunk]:
        """Yield the chunks of the second pass."""
        chunks = self.reader.chunks(CALIBRATED_AT_ONCE * self.request.chunk_samples)
        return chunks if effect is None else effect.watch(chunks)


def _with_effect(data: ReportInput, effect: EffectMeter | None) -> ReportInput:
    """Return the result with what was measured in the second pass."""
    if effect is None:
        return data
    effect.finish()
    return replace(data, taken=data.taken | {"effect": effect.result()})


def writes_parquet(data: ReportInput) -> bool:
    """Return True if calibrated data belong to a result."""
    return data.judgement.calibration is not None and not data.settings.report_only
