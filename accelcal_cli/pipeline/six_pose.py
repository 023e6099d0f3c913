"""Calibration from known orientations: a session in, a report with twelve parameters out."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.facts import Facts
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.judgement import Judgement
from accelcal_cli.core.poses import Session
from accelcal_cli.core.recording import Reader
from accelcal_cli.core.settings import PoseSettings
from accelcal_cli.judge.damage import too_damaged
from accelcal_cli.judge.known import judge_known
from accelcal_cli.output import report as reports
from accelcal_cli.output.known import known_json, poses_json
from accelcal_cli.pipeline.existing import prepare, remove, remove_stale_parquet, up_to_date
from accelcal_cli.pipeline.identity import hashing, sha256
from accelcal_cli.pipeline.plan import Job
from accelcal_cli.pipeline.profiles import window_use
from accelcal_cli.pipeline.request import (
    DEFAULT_CHUNK_SAMPLES,
    ProgressMaker,
    Result,
    input_settings,
    no_progress,
)
from accelcal_cli.pipeline.save import save_report, with_provenance
from accelcal_cli.pipeline.timed import Pass, timed_pass
from accelcal_cli.poses.faces import find_faces
from accelcal_cli.poses.intervals import Origin, find_listed
from accelcal_cli.poses.known import known_fit
from accelcal_cli.poses.listed import Listed, read_list
from accelcal_cli.poses.solve import check_range
from accelcal_cli.readers import open_recording

OPTIMIZER = {"name": "least-squares", "arithmetic": "float", "settings": {}}


@dataclass(frozen=True, slots=True)
class PoseRequest:
    """How to calibrate from known orientations.

    Attributes:
        poses: a file that lists them; None: the six faces are found.
        force: overwrite what accelcal did not write, and redo what is up to date.
        command: the command line, for the provenance.
    """

    options: ReadOptions = field(default_factory=ReadOptions)
    settings: PoseSettings = field(default_factory=PoseSettings)
    poses: Path | None = None
    chunk_samples: int = DEFAULT_CHUNK_SAMPLES
    force: bool = False
    command: tuple[str, ...] = ()

    @property
    def integers(self) -> bool:
        """There is no such output."""
        return False

    @property
    def coefficients_sha256(self) -> None:
        """A session's coefficients are its own."""
        return None

    def effective_settings(self, companion: Path | None) -> dict[str, Any]:
        """The report's `settings`: all that decides the result besides the recording."""
        return {
            **self.settings.as_json(),
            "report_only": True,
            "poses": None if self.poses is None else self.poses.name,
            "poses_sha256": None if self.poses is None else sha256(self.poses),
            "input": input_settings(self.options, companion),
        }


def six_pose(
    job: Job, request: PoseRequest, progress: ProgressMaker = no_progress, source: Path | None = None
) -> Result:
    """Calibrate from one session, unless its report is up to date.

    Args:
        source: where the recording's bytes are, if not at the job's source.

    Raises:
        DivergedError: the poses do not determine the parameters; nothing is written.
        AccelcalError: it cannot be read, or its report cannot be written.
    """
    path, listed = source or job.source, _listed(request)
    with open_recording(path, request.options) as reader:
        prepare(job, force=request.force)
        if not request.force and (held := up_to_date(job, path, reader.recording, request)) is not None:
            return held
        data, more = _Session(job.source, request, progress, reader).judged(path, listed)
    return _write(job, request, data, more)


def session_report(path: Path, request: PoseRequest, progress: ProgressMaker = no_progress) -> dict[str, Any]:
    """The report of a session without `provenance`; nothing is written.

    Raises:
        AccelcalError: see `six_pose`.
    """
    listed = _listed(request)
    with open_recording(path, request.options) as reader:
        data, more = _Session(path, request, progress, reader).judged(path, listed)
    return {**reports.build(data), **more}


def _listed(request: PoseRequest) -> Sequence[Listed]:
    return () if request.poses is None else read_list(request.poses)


@dataclass(frozen=True, slots=True)
class _Session:
    """One open session; `shown` is the path that the report names."""

    shown: Path
    request: PoseRequest
    progress: ProgressMaker
    reader: Reader

    def judged(self, path: Path, listed: Sequence[Listed]) -> tuple[reports.ReportInput, dict[str, Any]]:
        """Read, find the poses, fit, judge: all that the report says; `path` is where the bytes are."""
        with hashing(path) as digest:
            shown = self.progress("reading", self.reader.recording.total_bytes)
            seen = timed_pass(self.reader, self.request.chunk_samples, self.request.settings, shown)
            return self._judged(seen, listed, digest)

    def _judged(
        self, seen: Pass, listed: Sequence[Listed], digest: Future[str]
    ) -> tuple[reports.ReportInput, dict[str, Any]]:
        settings = self.request.settings
        try:
            refuse_damage(seen.facts, settings)
            session = find_poses(seen, self.reader.recording.lsb_per_g, listed, settings)
            fit = known_fit(session, settings)
            judgement, vectors = judge_known(session, fit, settings)
            if judgement.calibration is not None:
                check_range(judgement.calibration)
        except DivergedError as error:
            error.path = error.path or self.shown
            raise
        known = known_json(session, fit, judgement.outcome, vectors)
        data = self._input(seen, session, digest.result(), judgement)
        return data, {"poses": poses_json(session, fit), "known_orientations": known}

    def _input(self, seen: Pass, session: Session, sha256: str, judgement: Judgement) -> reports.ReportInput:
        recording = self.reader.recording
        constant = 0 if seen.cells.constant_used else seen.cells.constant
        use = window_use(seen.counts, seen.cells.implausible, constant)
        used = sum(pose.state.windows for pose in session.poses)
        return reports.ReportInput(
            recording=replace(recording, path=self.shown),
            sha256=sha256,
            facts=seen.facts,
            settings=self.request.effective_settings(recording.companion),
            judgement=judgement,
            windows=replace(use, used=used),
            optimizer=OPTIMIZER,
            clipped_after=None,
        )


def _write(job: Job, request: PoseRequest, data: reports.ReportInput, more: dict[str, Any]) -> Result:
    """The report, after what an earlier command of ours left for this recording is gone."""
    remove_stale_parquet(job.parquet, reports.parquet_metadata(data))
    remove(job.integers)
    report = with_provenance({**reports.build(data), **more}, request.command)
    save_report(job.report, report)
    return Result(job, report)


def refuse_damage(facts: Facts, settings: PoseSettings) -> None:
    """Raise DivergedError for a session of which damage has taken too much."""
    text = too_damaged(facts, settings.max_damage_percent)
    if text is not None:
        raise DivergedError(text)


def find_poses(seen: Pass, lsb_per_g: float, listed: Sequence[Listed], settings: PoseSettings) -> Session:
    """The listed poses, or else the six faces.

    Raises:
        UsageError: the list does not fit the recording.
        DivergedError: nothing is still, or no rest under gravity.
    """
    facts = seen.facts
    first_us = facts.first_us or 0
    if not len(seen.still):
        raise _no_stillness(seen, settings)
    if listed:
        dated = all(problem.code != "no_start_time" for problem in facts.problems)
        origin = Origin(first_us, dated, facts.utc_offset_s)
        return find_listed(seen.still, listed, origin, lsb_per_g, settings)
    if not seen.plausible.any():
        hint = "check the unit with --unit and --lsb-per-g"
        raise DivergedError("still windows measure far from 1 g", hint=hint)
    return find_faces(seen.still.select(seen.plausible), first_us, lsb_per_g, settings)


def _no_stillness(seen: Pass, settings: PoseSettings) -> DivergedError:
    if seen.counts.still:
        return DivergedError(
            "still windows hold nothing but constant values: the device did not measure",
            hint="switch its sleep mode off",
        )
    return DivergedError(
        f"none of {seen.counts.complete} windows of {settings.segment_seconds:g} s is still",
        hint="rest the device on every face for 10 s, untouched",
    )
