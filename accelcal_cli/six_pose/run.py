"""Calibration from known orientations: a session in, a report with twelve parameters out.

The run is that of any recording; its judge finds the poses among the still windows and solves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from accelcal_cli.collect.cells import CellCollector, plausible
from accelcal_cli.core.clock import utc_offset_s
from accelcal_cli.core.errors import DivergedError, UnreadableError, UsageError
from accelcal_cli.core.input_files import files_of, is_no_part, pattern_of
from accelcal_cli.core.local_time import NO_START
from accelcal_cli.core.points import Windows
from accelcal_cli.core.recording import PlacedFile, Recording
from accelcal_cli.core.results import Judgement
from accelcal_cli.core.settings import PoseSettings
from accelcal_cli.pipeline.calibrate import Judge, RecordingRun, Survey, Verdict, open_run
from accelcal_cli.pipeline.jobs import STDIN, Job, ProgressMaker, Request, Result, no_progress, real
from accelcal_cli.pipeline.procedures import CellProcedure, Method, local_lsb_per_g
from accelcal_cli.pipeline.survey import StillWindows
from accelcal_cli.segment import chosen_rule, short_gaps, window_length
from accelcal_cli.segment.segmenter import TimedSegmenter
from accelcal_cli.six_pose.listing import Listed, read_list
from accelcal_cli.six_pose.poses import Session, find_faces, find_listed
from accelcal_cli.six_pose.roll import Roll, Rolled, rolled, rolls_of, span_of_roll, sums_of, told, within
from accelcal_cli.six_pose.sections import known_json, poses_json
from accelcal_cli.six_pose.solve import check_range, six_pose_fit
from accelcal_cli.six_pose.spans import Origin, Span
from accelcal_cli.six_pose.verdict import judge_six_pose

OPTIMIZER = {"name": "least-squares", "arithmetic": "float", "settings": {}}


def six_pose(
    job: Job, request: Request, progress: ProgressMaker = no_progress, source: Path | None = None
) -> Result:
    """Calibrate from one session, unless its report is up to date.

    Args:
        request: its settings are `PoseSettings`, and it is `report_only`.
        source: where the recording's bytes are, if not at the job's source.

    Raises:
        DivergedError: the poses do not determine the parameters; nothing is written.
        AccelcalError: it cannot be read, or its report cannot be written.
    """
    judge = known_orientations(request)
    with open_run(job, request, progress, source) as run:
        return run.complete(judge)


def session_of(recordings: Sequence[Path], poses: Path | None = None) -> Path:
    """What stands for the recordings of a session; the list of poses may be among them.

    Raises:
        UsageError: no pattern does, one of them is standard input, or the list of poses would be taken for
            one of them.
        UnreadableError: one of them is missing.
    """
    path = recordings[0]
    if len(recordings) == 1:
        path = real(path) if path.name in ("", "..") else path
    else:
        path = _pattern(recordings, poses)
    if poses is not None and not is_no_part(poses) and real(poses) in map(real, files_of(path) or ()):
        hint = "call it poses.csv, or keep it elsewhere"
        raise UsageError("the list of poses lies among the files of the session", path=poses, hint=hint)
    return path


def _pattern(recordings: Sequence[Path], poses: Path | None) -> Path:
    """The pattern that stands for several recordings."""
    if STDIN in recordings:
        raise UsageError("standard input is one recording", hint="give the names of several, or - alone")
    files = [one for one in dict.fromkeys(recordings) if not is_no_part(one)]
    for one in files:
        if not one.is_file():
            what = "is a folder" if one.is_dir() else "cannot be read (No such file or directory)"
            raise UnreadableError(what, path=one, hint="name the files of one session, or their folder alone")
    if poses in files:
        hint = "call it poses.csv, or keep it elsewhere"
        raise UsageError("the list of poses is named as a recording", path=poses, hint=hint)
    return pattern_of(files) if len(files) > 1 else next(iter(files), recordings[0])


def known_orientations(request: Request) -> KnownOrientations:
    """The judge of a session; raises UsageError for a list of poses that cannot be read."""
    assert isinstance(request.settings, PoseSettings)
    listed = () if request.poses is None else read_list(request.poses)
    rolls = rolls_of(request.settings.roll)
    return KnownOrientations(request.recording_settings, request.settings, listed, rolls)


def _origins(files: Sequence[PlacedFile], found: Survey) -> tuple[Origin, ...]:
    """What times refer to: the recording, or each file of the session."""
    facts, zone = found.facts, found.recording.timezone
    if not files:
        dated = all(problem.code != NO_START for problem in facts.problems)
        return (Origin(facts.first_us or 0, dated, facts.utc_offset_s),)
    return tuple(
        Origin(
            one.first_us,
            one.dated,
            utc_offset_s(zone, one.first_us - one.moved_us) if one.dated else None,
            one.name,
            one.first_sample,
            one.first_sample + one.samples,
            one.moved_us,
            one.problems,
            one.lost_bytes,
        )
        for one in files
    )


class SessionProcedure(CellProcedure):
    """Keeps all still windows with their times; the cells say which of them the device measured."""

    def __init__(self, collector: CellCollector) -> None:
        super().__init__(collector)
        self._kept = StillWindows()

    def see_still(self, windows: Windows) -> None:
        """Take windows in."""
        super().see_still(windows)
        self._kept.see_still(replace(windows, temperature_sums=None))

    def still(self) -> Windows:
        """All windows but those of constant values, where the device only repeated a value."""
        still = self._kept.result()
        if self.collector.counts().constant_used:
            return still
        return still.select(still.spread.max(axis=1, initial=0) > 0)


@dataclass(frozen=True)
class KnownOrientations(Judge):
    """Finds the poses of a session and solves for twelve parameters.

    Attributes:
        poses: how.
        listed: the poses, none to find the six faces.
        rolls: where the device was rolled, to check the calibration by.
    """

    poses: PoseSettings
    listed: Sequence[Listed]
    rolls: Sequence[Roll] = ()

    def method(self, recording: Recording) -> Method:
        """All still windows with their times."""
        rest_lsb = local_lsb_per_g(recording, self.settings)
        length = window_length(self.settings, recording.rate_hz)
        rule = chosen_rule(self.settings, recording.lsb_per_g, length)
        procedure = SessionProcedure(CellCollector(rest_lsb, self.settings, temperature=False))
        gaps = short_gaps(self.settings, length, recording.rate_hz)
        return Method(TimedSegmenter(length, rule, recording.rate_hz, gaps), procedure, rest_lsb)

    def optimizer(self) -> dict[str, Any]:
        """The report's `optimizer`."""
        return OPTIMIZER

    def verdict(self, run: RecordingRun, found: Survey) -> Verdict:
        """Find the poses, fit, judge.

        Raises:
            DivergedError: too much is damaged, or the poses do not determine the parameters.
        """
        try:
            return self._verdict(run, found)
        except DivergedError as error:
            error.path = error.path or run.job.source
            raise

    def _verdict(self, run: RecordingRun, found: Survey) -> Verdict:
        if found.damage is not None:
            raise DivergedError(found.damage.message)
        origins = _origins(run.reader.files, found)
        spans = [span_of_roll(roll, origins) for roll in self.rolls]
        session = self.find_poses(found, origins, spans)
        fit = six_pose_fit(session, self.poses)
        judgement, vectors = judge_six_pose(session, fit, self.poses)
        if judgement.calibration is not None:
            check_range(judgement.calibration)
        rolls = self._rolled(run, judgement, spans, origins)
        judgement = replace(judgement, message="; ".join([judgement.message, *map(told, rolls)]))
        known = known_json(session, fit, judgement.outcome, vectors, rolls)
        sections = {"poses": poses_json(session, fit), "known_orientations": known}
        return Verdict(judgement, sections, sum(pose.state.windows for pose in session.poses))

    def _rolled(
        self, run: RecordingRun, judgement: Judgement, spans: Sequence[Span], origins: Sequence[Origin]
    ) -> list[Rolled]:
        """What comes of each roll; the recording is read once more for it."""
        lsb_per_g, found = run.reader.recording.lsb_per_g, []
        for roll, span in zip(self.rolls, spans, strict=True):
            sums = sums_of(run.reader.chunks(run.request.chunk_samples), span, origins[span.file])
            found.append(rolled(roll, span, sums, lsb_per_g, judgement.calibration))
        return found

    def find_poses(self, found: Survey, origins: Sequence[Origin], rolls: Sequence[Span] = ()) -> Session:
        """The listed poses, or else the six faces.

        Args:
            rolls: where the device was rolled; a slow roll may look still, but is no pose.

        Raises:
            UsageError: the list does not fit the recording.
            DivergedError: nothing is still, or no rest under gravity.
        """
        assert isinstance(found.method.procedure, SessionProcedure)
        lsb_per_g, still = found.recording.lsb_per_g, found.method.procedure.still()
        for span in rolls:
            still = still.select(~within(still, span, origins[span.file]))
        rolled = [span.file for span in rolls]
        if not len(still):
            raise self._no_stillness(found)
        if self.listed:
            return find_listed(still, self.listed, origins, lsb_per_g, self.poses, rolled)
        near_1_g = plausible(still, found.method.rest_lsb, self.settings)
        if not near_1_g.any():
            hint = "check the unit with --unit and --lsb-per-g"
            raise DivergedError("still windows measure far from 1 g", hint=hint)
        return find_faces(still.select(near_1_g), origins, lsb_per_g, self.poses, rolled)

    def _no_stillness(self, found: Survey) -> DivergedError:
        counts = found.method.segmenter.counts
        if counts.still:
            return DivergedError(
                "still windows hold nothing but constant values: the device did not measure",
                hint="turn off its sleep mode",
            )
        return DivergedError(
            f"none of {counts.complete} windows of {self.poses.segment_seconds:g} s is still",
            hint="rest the device on every face for 10 s without touching it",
        )
