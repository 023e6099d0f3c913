"""One pass over a session: facts about it, and all its still windows with their times.

Calibration from known orientations: a session in, a report with twelve parameters out.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.collect.cells import CellCollector, CellCounts, plausible
from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.points import WindowCounts, Windows
from accelcal_cli.core.recording import Chunk, Reader
from accelcal_cli.core.results import Facts, Judgement
from accelcal_cli.core.settings import PoseSettings
from accelcal_cli.formats import open_recording
from accelcal_cli.judge.verdict import too_damaged
from accelcal_cli.output import report as reports
from accelcal_cli.pipeline.jobs import (
    DEFAULT_CHUNK_SAMPLES,
    Job,
    Progress,
    ProgressMaker,
    Result,
    hashing,
    input_settings,
    no_progress,
    sha256,
)
from accelcal_cli.pipeline.method import local_lsb_per_g, make_segmenter, window_use
from accelcal_cli.pipeline.outputs import (
    prepare,
    remove,
    remove_stale_parquet,
    save_report,
    up_to_date,
    with_provenance,
)
from accelcal_cli.pipeline.survey import Observer, with_clipping
from accelcal_cli.six_pose.poses import (
    Listed,
    Origin,
    Session,
    TimedWindows,
    find_faces,
    find_listed,
    read_list,
)
from accelcal_cli.six_pose.solve import check_range, known_fit
from accelcal_cli.six_pose.verdict import judge_known, known_json, poses_json


@dataclass(frozen=True, slots=True, eq=False)
class Pass:
    """What one pass found.

    Attributes:
        still: windows that the device measured: those of constant values are left out where it
            only repeated a value.
        plausible: (m,) which of them measure about 1 g.
        cells: how many were left out.
    """

    facts: Facts
    still: TimedWindows
    plausible: NDArray[np.bool_]
    counts: WindowCounts
    cells: CellCounts


def timed_pass(reader: Reader, chunk_samples: int, settings: PoseSettings, progress: Progress) -> Pass:
    """Read a recording once.

    Raises:
        UnreadableError: it cannot be read on.
    """
    recording, stillness = reader.recording, settings.stillness
    rest_lsb = local_lsb_per_g(recording, stillness)
    segmenter, observer = make_segmenter(recording, stillness), Observer(recording, rest_lsb)
    collector = CellCollector(rest_lsb, stillness, temperature=False)
    parts: list[TimedWindows] = []
    for raw in reader.chunks(chunk_samples):
        chunk = with_clipping(raw, recording)
        observer.see(chunk)
        for windows in segmenter.feed(chunk):
            observer.see_still(windows)
            collector.add(windows)
            parts.append(timed(windows, chunk, recording.rate_hz))
        progress(chunk.end_byte)
    cells, still = collector.counts(), joined(parts)
    if not cells.constant_used:
        still = still.select(still.windows.spread.max(axis=1, initial=0) > 0)
    return Pass(
        observer.facts(), still, plausible(still.windows, rest_lsb, stillness), segmenter.counts, cells
    )


def timed(windows: Windows, chunk: Chunk, rate_hz: float) -> TimedWindows:
    """Windows that end in a chunk, with their times: its clock knows each one's last sample."""
    last = windows.first_sample + windows.samples - 1 - chunk.first_sample
    low, high = (int(last[0]), int(last[-1]) + 1) if len(last) else (0, 0)
    last_us = chunk.clock.times(low, high)[last - low]
    lengths_us = np.rint((windows.samples - 1) * 1e6 / rate_hz).astype(np.int64)
    return TimedWindows(windows, last_us - lengths_us, last_us + round(1e6 / rate_hz))


def joined(parts: list[TimedWindows]) -> TimedWindows:
    """Consecutive batches as one; their temperatures are not kept."""
    held = [part.windows for part in parts]
    none, wide = np.empty(0, np.int64), np.empty((0, 3), np.int64)
    windows = Windows(
        np.concatenate([none, *(part.samples for part in held)]),
        np.concatenate([none, *(part.first_sample for part in held)]),
        np.concatenate([wide, *(part.sums for part in held)]),
        np.concatenate([wide, *(part.spread for part in held)]),
    )
    return TimedWindows(
        windows,
        np.concatenate([none, *(part.start_us for part in parts)]),
        np.concatenate([none, *(part.end_us for part in parts)]),
    )


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
