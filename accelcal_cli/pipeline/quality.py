"""Compares known coefficients with a recording along its time, and finds where they do not fit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import dropwhile, takewhile

from accelcal_cli.core.calibration import Calibration
from accelcal_cli.core.clock import iso_time
from accelcal_cli.core.reasons import Reason
from accelcal_cli.core.results import Change
from accelcal_cli.judge.change import ChangeSearch, ComparedErrors, change_reason
from accelcal_cli.judge.quality import check
from accelcal_cli.pipeline.procedures import Procedure, TimedCellProcedure


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


def cautions_along_time(
    calibration: Calibration, procedure: Procedure, limit_mg: float, utc_offset_s: int | None
) -> tuple[Reason, ...]:
    """Return the cautions of coefficients of another recording that do not fit this one all the time.

    Args:
        limit_mg: error that no usable calibration reaches.
        utc_offset_s: of the times that the cautions state.
    """
    along = compared_along_time(calibration, procedure)
    if along.compared is None:
        return ()
    assert isinstance(procedure, TimedCellProcedure)
    begun_us, samples = procedure.begun_us, along.block_samples

    def when(block: int) -> str | None:
        return None if block >= along.blocks else iso_time(begun_us(block * samples), utc_offset_s)

    checked = check(along.compared, along.change, along.blocks, limit_mg)
    if checked.degraded:
        changed = change_reason(along.change, utc_offset_s, followed=False)
        # the first period in which the calibration does not hold, and those that follow on it
        later = dropwhile(lambda one: not one.degraded, checked.periods)
        worse = list(takewhile(lambda one: one.degraded, later))
        since = when(worse[0].first) if worse[0].first else None
        worst = max(worse, key=lambda one: one.given_mg - one.unseen_mg)
        errors = {"error_mg": worst.given_mg, "new_mg": worst.unseen_mg}
        why = Reason.of("no_longer_fits", since=since, until=when(worse[-1].end), **errors)
        return (why, *([] if changed is None else [changed]))
    if checked.rises:
        before, late = checked.periods[0], checked.periods[-1]
        errors = {"error_mg": late.given_mg, "before_mg": before.given_mg}
        return (Reason.of("error_rises", since=when(late.first), **errors),)
    return ()
