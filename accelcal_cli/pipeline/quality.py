"""`accelcal quality`: checks whether a calibration still fits a recording, in one pass that writes nothing.

The coefficients are those of a report, which are tested as `apply` tests them, or the recording's own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from math import isfinite
from pathlib import Path
from typing import Any

from accelcal_cli.core.calibration import Calibration
from accelcal_cli.core.clock import iso_time
from accelcal_cli.core.errors import UsageError, printable
from accelcal_cli.core.reasons import Reason
from accelcal_cli.core.results import Change, Judgement, Outcome
from accelcal_cli.core.settings import Settings
from accelcal_cli.core.statistics import mean
from accelcal_cli.judge.change import LEAST_MG, ChangeSearch, ComparedErrors, change_reason
from accelcal_cli.judge.quality import Period, check, far_off
from accelcal_cli.output.quality import QualityInput, rows_json
from accelcal_cli.output.words import explained
from accelcal_cli.pipeline.apply import with_coefficients
from accelcal_cli.pipeline.calibrate import FirstPass, Judge, OwnCalibration, RecordingRun, open_run
from accelcal_cli.pipeline.jobs import Job, ProgressMaker, Request, no_progress
from accelcal_cli.pipeline.procedures import Procedure, TimedCellProcedure


class QualityState(StrEnum):
    """The verdict on a calibration along a recording; refused: the recording has none of its own."""

    HOLDS = "holds"
    DEGRADED = "degraded"
    UNCHECKED = "unchecked"
    REFUSED = "refused"


@dataclass(frozen=True, slots=True, eq=False)
class Quality:
    """The findings of a look along a recording.

    Attributes:
        made: the rows of its blocks of time, and its judgement.
        reasons: why it is what it is, the first thing first.
        since, until: times between which the calibration does not hold; None: from the first sample, or to
            the last one, on.
        periods: the parts of the recording that were judged.
    """

    path: Path
    made: QualityInput
    state: QualityState
    reasons: tuple[Reason, ...]
    since: str | None = None
    until: str | None = None
    periods: tuple[Period, ...] = ()

    def when(self, block: int) -> str | None:
        """Return when a block of time begins; None for the end of the recording."""
        begun = self.made.begun_us
        return iso_time(begun[block], self.made.data.facts.utc_offset_s) if block < len(begun) else None


def quality(
    path: Path, request: Request, progress: ProgressMaker = no_progress, source: Path | None = None
) -> Quality:
    """Look at a recording along its time, with the request's coefficients or its own.

    Args:
        source: where the recording's bytes are, if not at its path.

    Raises:
        AccelcalError: it cannot be read, or the coefficients cannot be applied to it (see `apply`).
    """
    with open_run(Job(path, path, path), request, progress, source) as run:
        ready, judge = judged_by(run)
        if not isinstance(judge.method(ready.reader.recording).procedure, TimedCellProcedure):
            raise UsageError(
                f"profile {judge.settings.profile} keeps no windows along time",
                path=path,
                hint="use --profile default, or coefficients that were found with it",
            )
        found = ready.result(judge)
    made = found.quality()
    assert made is not None
    judgement = made.data.judgement
    start = Quality(path, made, QualityState.REFUSED, (judgement.reason, *judgement.notes))
    if judgement.outcome is Outcome.REFUSED:
        return start
    if request.coefficients is not None:
        return _by_donor(start, found, judge.settings)
    assert judgement.calibration is not None
    as_before_the_change = replace(judgement.calibration, correction=None)
    return _by_periods(start, found, as_before_the_change, own=True)


def judged_by(run: RecordingRun) -> tuple[RecordingRun, Judge]:
    """Return the run with the settings of the coefficients that are checked, and its judge."""
    request = run.request
    if request.coefficients is None:
        return run, OwnCalibration(request.recording_settings)
    return with_coefficients(run, request.coefficients)


def _by_donor(start: Quality, found: FirstPass, settings: Settings) -> Quality:
    """Check coefficients of a report, which hold if a calibration of the recording itself gains little."""
    judgement = start.made.data.judgement
    assert judgement.calibration is not None
    postures = judgement.coverage.distinct_orientations
    if postures < settings.min_postures:
        few = Reason.of("too_few_orientations", orientations=postures, needed=settings.min_postures)
        return _by_holdout(start, few, None)
    return _by_periods(start, found, judgement.calibration, own=False)


@dataclass(frozen=True, slots=True, eq=False)
class ComparedAlongTime:
    """A calibration compared with a recording along time.

    Attributes:
        change: how the sensor changed, as seen from the calibration.
        compared: its errors; None where the recording is too short.
        blocks: number of blocks of time, of `block_samples` each.
    """

    change: Change
    compared: ComparedErrors | None
    blocks: int
    block_samples: int


def compared_along_time(calibration: Calibration, procedure: Procedure) -> ComparedAlongTime:
    """Compare a calibration with all windows of a procedure that keeps blocks of time."""
    assert isinstance(procedure, TimedCellProcedure)
    means = procedure.means()
    if calibration.correction is not None and len(means.block):
        means, calibration = means.corrected(calibration.correction), replace(calibration, correction=None)
    search = ChangeSearch(means)
    change = search.find(calibration)
    if change.at_block is not None:
        change = replace(change, at_us=procedure.begun_us(change.at_block * means.block_samples))
    return ComparedAlongTime(change, search.compared(), means.blocks(), means.block_samples)


def _by_periods(start: Quality, found: FirstPass, calibration: Calibration, *, own: bool) -> Quality:
    """Return the verdict by errors in periods of the recording, or by the hold-out if it is too short."""
    along = compared_along_time(calibration, found.method.procedure)
    if along.compared is None:
        return _by_holdout(start, Reason(along.change.unchecked or "too_short"), LEAST_MG)
    limit_mg = start.made.data.settings.method.max_error_mg
    checked = check(along.compared, along.change, along.blocks, limit_mg)
    start = replace(start, periods=_periods_by_row(checked.periods, start.made, along.block_samples))
    if checked.degraded:
        return _degraded(start, along.change)
    return _rising(start) if checked.rises else _holding(start, along, own=own)


def _periods_by_row(
    periods: tuple[Period, ...], made: QualityInput, block_samples: int
) -> tuple[Period, ...]:
    """Number periods by rows, which may be longer than blocks; the last goes to the end."""
    each = made.rows.block_samples // block_samples
    ends = [*(period.end // each for period in periods[:-1]), len(made.rows)]
    return tuple(
        replace(one, first=one.first // each, end=end) for one, end in zip(periods, ends, strict=True)
    )


def _holding(start: Quality, along: ComparedAlongTime, *, own: bool) -> Quality:
    """State the mean error over all stretches of time, and that of the recording's own calibration."""
    compared = along.compared
    assert compared is not None
    numbers = sorted(set(compared.stretch.tolist()))
    given_mg, unseen_mg = (
        mean([float(errors[compared.stretch == number].mean()) for number in numbers])
        for errors in (compared.given_mg, compared.unseen_mg)
    )
    why = Reason.of(
        "still_fits",
        error_mg=unseen_mg if own else given_mg,
        new_mg=None if own else unseen_mg,
        stretches=len(numbers),
    )
    return replace(start, state=QualityState.HOLDS, reasons=(why, *_change(start, along.change)))


def _rising(start: Quality) -> Quality:
    """State that the error rises at the end, too short to say why."""
    before, late = start.periods[0], start.periods[-1]
    since = start.when(late.first)
    why = Reason.of("error_rises", since=since, error_mg=late.given_mg, before_mg=before.given_mg)
    return replace(start, state=QualityState.UNCHECKED, reasons=(why,), since=since)


def _degraded(start: Quality, change: Change) -> Quality:
    """State from when to when it does not hold: the first such period, and those that follow on it."""
    periods = list(start.periods)
    first = next(place for place, one in enumerate(periods) if one.degraded)
    last = first
    while last + 1 < len(periods) and periods[last + 1].degraded:
        last += 1
    worst = max(periods[first : last + 1], key=lambda one: one.given_mg - one.unseen_mg)
    since = start.when(periods[first].first) if first else None
    until = start.when(periods[last].end)
    why = Reason.of(
        "no_longer_fits", since=since, until=until, error_mg=worst.given_mg, new_mg=worst.unseen_mg
    )
    reasons = (why, *_change(start, change))
    return replace(start, state=QualityState.DEGRADED, reasons=reasons, since=since, until=until)


def _change(start: Quality, change: Change) -> tuple[Reason, ...]:
    """Return how the sensor changed, if it did."""
    changed = change_reason(change, start.made.data.facts.utc_offset_s, followed=False)
    return () if changed is None else (changed,)


def _by_holdout(start: Quality, why: Reason, small_mg: float | None) -> Quality:
    """Return the verdict where stretches of time cannot be compared, by errors on postures not fitted.

    Args:
        small_mg: coefficients whose error is clearly below this hold: no others could gain more. None: none
            hold.
    """
    judgement, settings = start.made.data.judgement, start.made.data.settings.method
    holdout = judgement.holdout
    if holdout is None:
        return replace(start, state=QualityState.UNCHECKED, reasons=(why,))
    seen = {"error_mg": holdout.after.mean, "high_mg": holdout.ci95[1], "orientations": holdout.postures}
    if far_off(holdout, settings.max_error_mg):
        over = Reason.of("never_fits", **seen, limit_mg=settings.max_error_mg)
        return replace(start, state=QualityState.DEGRADED, reasons=(over,))
    holds = small_mg is not None and holdout.ci95[1] < small_mg
    state = QualityState.HOLDS if holds else QualityState.UNCHECKED
    return replace(start, state=state, reasons=(Reason.of("fits_held_out", **seen), why))


def as_json(found: Quality) -> dict[str, Any]:
    """Return the look as a JSON object."""
    made, donor = found.made, found.made.data.taken.get("coefficients")
    rows = made.rows
    return {
        "recording": printable(found.path),
        "coefficients": None if donor is None else donor["path"],
        "state": str(found.state),
        "reasons": [one.as_json() for one in found.reasons],
        "message": explained(found.reasons[0], found.reasons[1:]),
        "since": found.since,
        "until": found.until,
        "periods": [_period_json(found, one) for one in found.periods],
        "holdout": _holdout_json(made.data.judgement),
        "row": {"samples": rows.block_samples, "rate_hz": made.data.recording.rate_hz},
        "rows": rows_json(made),
    }


def _holdout_json(judgement: Judgement) -> dict[str, Any] | None:
    if (holdout := judgement.holdout) is None:
        return None
    pair = {"before_mg": holdout.before.mean, "after_mg": holdout.after.mean}
    return {"postures": holdout.postures, **{name: round(value, 4) for name, value in pair.items()}}


def _period_json(found: Quality, one: Period) -> dict[str, Any]:
    known = all(map(isfinite, one.fall_mg))
    return {
        "start": found.when(one.first),
        "end": found.when(one.end),
        "given_mg": round(one.given_mg, 4),
        "unseen_mg": round(one.unseen_mg, 4),
        "fall_ci95_mg": [round(value, 4) for value in one.fall_mg] if known else None,
        "degraded": one.degraded,
    }
