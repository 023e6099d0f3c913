"""Coefficients of a device's other recordings onto one, if they prove themselves on its own stillness."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.judgement import Holdout, Judgement, Outcome
from accelcal_cli.core.names import printable
from accelcal_cli.core.points import Calibration, PointSet
from accelcal_cli.judge.borrowed import FEWEST_POSTURES, better, held_out
from accelcal_cli.output.coefficients import Coefficients, read_coefficients
from accelcal_cli.output.report import ReportInput
from accelcal_cli.pipeline import apply, calibrate
from accelcal_cli.pipeline.donor import Link, applied, link, need_temperature, settings_for
from accelcal_cli.pipeline.existing import prepare
from accelcal_cli.pipeline.identity import Seen
from accelcal_cli.pipeline.passes import Passes
from accelcal_cli.pipeline.plan import Job
from accelcal_cli.pipeline.request import ProgressMaker, Request, Result, no_progress
from accelcal_cli.readers import open_recording


@dataclass(frozen=True, slots=True)
class Loan:
    """What came of asking.

    Attributes:
        result: with the coefficients of the first that was accepted; None where none was.
        reasons: why those before it were not.
    """

    result: Result | None
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Own:
    """What a recording's own calibration does to its own points."""

    points: PointSet
    held: Holdout | None


def borrow(
    job: Job,
    request: Request,
    reports: Sequence[Path],
    progress: ProgressMaker = no_progress,
    *,
    must_be_better: bool,
    before: Seen | None = None,
) -> Loan:
    """Apply the coefficients of the first report that stands the test.

    They are tested on all still windows of the recording, none of which they were found from: the error
    must be less than before (no more, where they change nothing), and below the settings' limit.

    Args:
        reports: of recordings of the same device, found with the request's settings.
        must_be_better: also less than that of the recording's own calibration, by more than the
            uncertainty.
        before: how the recording was when its own result was found; None if that does not matter.

    Raises:
        AccelcalError: the recording or a report cannot be read, or changed; or the outputs cannot be written.
    """
    with open_recording(job.source, request.options, request.threads) as reader:
        prepare(job, force=request.force)
        passes = Passes(job, request, progress, reader, job.source, before)
        own = _own(passes) if must_be_better else None
        reasons: list[str] = []
        for path in reports:
            donor = read_coefficients(path, by_content=True)
            try:
                mine, data = _tested(passes, donor)
                if data.judgement.holdout is None:
                    return Loan(None, (_untested(data.judgement),))
                why = _why_not(data, donor.calibration) or _why_own(own, donor, mine)
            except UsageError as error:
                why = error.message
            if why is None:
                return Loan(mine.write(_placed(data, job)), tuple(reasons))
            reasons.append(printable(f"with the coefficients of {donor.origin.path}, {why}"))
        return Loan(None, tuple(reasons))


def _own(passes: Passes) -> _Own:
    data, points = calibrate.judged(passes)
    return _Own(points, data.judgement.holdout)


def _tested(passes: Passes, donor: Coefficients) -> tuple[Passes, ReportInput]:
    """The recording judged with coefficients, and the passes to write it.

    Raises:
        UsageError: they cannot be applied to it.
    """
    recording = passes.reader.recording
    found = link(donor, recording, passes.bytes_at, passes.request)
    if found is not Link.OTHER:
        raise UsageError("it is the same recording")
    settings = settings_for(donor, found, passes.request.settings)
    need_temperature(applied(donor, settings), recording, has=recording.has_temperature)
    mine = replace(passes, request=replace(passes.request, settings=settings, coefficients=donor))
    return mine, apply.judged(mine, donor, found)


def _untested(verdict: Judgement) -> str:
    """Why no coefficients can be tested on a recording."""
    if verdict.outcome is Outcome.REFUSED:
        return verdict.message
    return f"there is no stillness in {FEWEST_POSTURES} postures to test coefficients on"


def _why_not(data: ReportInput, lent: Calibration) -> str | None:
    """Why coefficients are not accepted, or None."""
    held, limit_mg = data.judgement.holdout, data.settings["max_error_mg"]
    assert held is not None
    before, after = held.before.mean, held.after.mean
    changed = f"{before:.1f} mg become {after:.2f} mg on {held.postures} postures"
    if after > before or (after == before and lent.model != "0"):
        return f"{changed}, which is no less"
    return f"{changed}, {limit_mg:g} mg is the limit" if after >= limit_mg else None


def _why_own(own: _Own | None, donor: Coefficients, mine: Passes) -> str | None:
    """Why the recording's own calibration is preferred, or None."""
    if own is None or own.held is None:
        return None
    settings = mine.request.settings
    calibration = applied(donor, settings)
    lent = held_out(own.points, calibration, settings.gravity, settings.posture_degrees, apply.UNSEEN)
    if lent is None or not better(lent, own.held):
        shown = "no" if lent is None else f"{lent.after.mean:.2f} mg"
        return f"{shown} instead of its own {own.held.after.mean:.2f} mg is no less beyond the uncertainty"
    return None


def _placed(data: ReportInput, job: Job) -> ReportInput:
    """The coefficient file by its way from the report, so that both may be moved together."""
    used = data.taken["coefficients"]
    way = Path(os.path.relpath(used["path"], job.report.parent)).as_posix()
    return replace(data, taken={**data.taken, "coefficients": {**used, "path": way}})
