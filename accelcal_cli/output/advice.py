"""Cautions and advice that follow from a report: codes with values, none of which the judgement has given.

`completed` adds them to a report that is being built.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, Literal

from accelcal_cli.core.clock import iso_time
from accelcal_cli.core.errors import Reason
from accelcal_cli.core.local_time import NO_START
from accelcal_cli.core.recording import Device
from accelcal_cli.core.results import NEAR_ONE_G, PROBABLE, Facts, Judgement, Outcome, sides_not_up
from accelcal_cli.core.settings import DEFAULT, PAPER
from accelcal_cli.output import sentences
from accelcal_cli.output.methods import held_out_sentence
from accelcal_cli.output.numbers import number
from accelcal_cli.output.sections import ReportView, report_view

# Faults of devices that their makers have published, as data: which recordings may have them.
#
# `known_faults.json` has an object for each: `name` as the maker calls it, `model` of the device (or
# null), `serial` with which serial numbers begin (or nothing), versions of `firmware` (empty: all),
# dates between which the devices were `shipped` (or null), the `fault` in words, and its public
# `source`. Only what is published stands there.


@dataclass(frozen=True, slots=True)
class KnownFault:
    """A published fault; see the module."""

    name: str
    model: str | None
    serial: str
    firmware: Sequence[str]
    shipped: Sequence[str] | None
    fault: str
    source: str

    def concerns(self, device: Device) -> bool:
        """Return True if a device may have the fault, by its model, serial number and firmware."""
        of_model = self.model in (None, device.model) and (device.serial or "").startswith(self.serial)
        return of_model and (not self.firmware or device.firmware in self.firmware)

    def caution(self) -> Reason:
        """Return the caution of a recording that may have the fault."""
        begun, ended = self.shipped or (None, None)
        when = {"shipped_from": begun, "shipped_to": ended}
        return Reason.of("known_fault", name=self.name, fault=self.fault, **when, source=self.source)


def of_device(device: Device) -> list[Reason]:
    """Return the cautions of the published faults that a device may have."""
    return [one.caution() for one in known_faults() if one.concerns(device)]


@cache
def known_faults() -> tuple[KnownFault, ...]:
    """Return all published faults."""
    text = resources.files("accelcal_cli.output").joinpath("known_faults.json").read_text("utf-8")
    return tuple(KnownFault(**one) for one in json.loads(text))


# Cautions and advice that follow from a report.

LIMIT_MG = DEFAULT.max_error_mg
"""Limit [mg] of the 95 % interval of a good result, where a report's settings do not say."""

MIN_ORIENTATIONS = 9
"""Number of orientations from which on a recording does not lack any, unless they leave out a side."""

FILLED_FROM_PERCENT = 10.0
"""Share of filled samples [%] from which on means over what is left may not stand for the whole time."""

ODD_REST = (
    *("axes_alike", "axis_stuck", "gravity_is_zero", "not_1_g", "rest_scatters"),
    *("wrong_counts_per_g", "wrong_unit"),
)
"""Codes of notes on values that say themselves what to do; more orientations would not help."""

RAW_SETTLED = (Outcome.ALREADY_GOOD, Outcome.PROVISIONAL)
"""Outcomes that say themselves how a result compares with the raw data, more sharply than its interval."""

LIKELY_YEARS = ("1990", "2036")
"""First year in which a recording may begin, and the first one in which it may not: clocks that were never
set, or overflowed, begin in 1980, 2036, 2079 or 2106."""

EMPTY_FROM_PERCENT = 0.1
"""Share of rows without values [%] from which on it is reported."""

MILD = ("sides_unchecked", "not_converged", "rows_without_values", "unlikely_year", "known_fault")
"""Codes of cautions that a good result may have."""


def completed(report: dict[str, Any], judgement: Judgement) -> dict[str, Any]:
    """Return a report with all its cautions, its advice and its message."""
    view = report_view(report)
    health, given = view.file_health, judgement.cautions  # which may be those of coefficients, too
    lost, filled = (health.lost_bytes, health.lost_percent), health.filled_samples
    own = of_file(health.missing_bytes, *lost, filled, view.recording.samples)
    codes = [one.code for one in given]
    found = [
        *own,
        *(one for one in given if one not in own),
        *(one for one in _cautions(view) if one.code not in codes),
    ]
    ways: dict[str, Reason] = {}
    for one in (*judgement.advice, *_advice(view)):
        ways.setdefault(one.code, one)
    return report | {
        "message": sentences.message(view),
        "cautions": [one.as_json() for one in found],
        "advice": [one.as_json() for one in ways.values()],
    }


def is_doubtful(report: ReportView) -> bool:
    """Return True if a result is to be used with care."""
    unsure = report.outcome in (Outcome.BORROWED, Outcome.PROVISIONAL)
    return unsure or any(one.code not in MILD for one in report.cautions)


def _cautions(report: ReportView) -> tuple[Reason, ...]:
    made, known = report.calibration, report.known_orientations
    sides = _sides(report) if made is not None and report.coverage.cells else []
    unchecked = []
    if known is not None and known.unchecked is not None and made is not None:
        unchecked = [Reason("roll_alone_checks_poses" if known.rolls else "nothing_checks_poses")]
    if made is not None and made.optimizer.converged is False:
        unchecked.append(Reason.of("not_converged", iterations=made.optimizer.iterations))
    doubtful: list[Reason] = []
    if report.probability is None:  # else they have decided
        doubtful = doubts(*_interval(report), everywhere=report.calibration_error_mg is not None)
    return (
        *of_device(report.recording.device),
        *unchecked,
        *doubtful,
        *([Reason.of("sides_unchecked", sides=sides)] if sides else []),
    )


def of_file(
    missing: int | None, lost_bytes: int, lost_percent: float, filled: int, samples: int
) -> list[Reason]:
    """Return the cautions that more is missing from a file, and that much was not measured.

    Args:
        missing: bytes that are known to be missing; None: the file breaks off, by an unknown amount.
    """
    found = []
    if missing != 0:
        share = lost_percent * missing / lost_bytes if missing and lost_bytes else None
        found.append(Reason.of("cut_short", missing_bytes=missing, missing_percent=share))
    share = 100 * filled / max(1, samples)
    if share >= FILLED_FROM_PERCENT:
        found.append(Reason.of("filled_share", filled_percent=share, filled_samples=filled))
    return found


def of_rows(facts: Facts) -> list[Reason]:
    """Return the cautions of rows without values, of an unlikely year, and of a clock that was reset."""
    share = 100 * facts.empty_rows / max(1, facts.empty_rows + facts.samples)
    found = []
    dated = facts.first_us is not None and all(one.code != NO_START for one in facts.problems)
    start = iso_time(facts.first_us, None) or ""
    if dated and not LIKELY_YEARS[0] <= start[:4] < LIKELY_YEARS[1]:
        found.append(Reason.of("unlikely_year", start=start[:19]))
    if share >= EMPTY_FROM_PERCENT:
        found.append(Reason.of("rows_without_values", empty_percent=share, empty_rows=facts.empty_rows))
    if not facts.resets:
        return found
    first, offset_s = facts.resets[0], facts.utc_offset_s
    around = {"before": iso_time(first.before_us, offset_s), "after": iso_time(first.after_us, offset_s)}
    return [*found, Reason.of("clock_reset", sample=first.sample, **around, resets=len(facts.resets))]


def _interval(report: ReportView) -> tuple[float | None, float | None, float]:
    """Return the upper end of the error's 95 % interval, the error before, and the limit [mg]."""
    everywhere, holdout = report.calibration_error_mg, report.holdout
    limit = report.setting("max_error_mg", LIMIT_MG)
    if report.calibration is None:
        return None, None, limit
    if report.outcome in RAW_SETTLED:
        return (None if everywhere is None else everywhere.ci95[1]), None, limit
    if everywhere is not None:
        return everywhere.ci95[1], everywhere.before, limit
    if holdout is not None:
        return holdout.ci95_mg[1], holdout.before_mg.mean, limit
    return None, None, limit


def doubts(
    high: float | None, before: float | None, limit: float = LIMIT_MG, *, everywhere: bool = True
) -> list[Reason]:
    """Return what a 95 % interval says against a result [mg].

    Args:
        high: upper end of the interval; before: error of the raw values to compare with, if there is one.
        everywhere: the interval is that over all orientations, not only the recording's own.
    """
    if high is None:
        return []
    found = []
    if high >= limit:
        found.append(Reason.of("error_may_reach", high_mg=high, everywhere=everywhere))
    if before is not None and high >= before:
        found.append(Reason.of("no_better_than_raw", before_mg=before))
    return found


def _advice(report: ReportView) -> tuple[Reason, ...]:
    """Return what else helps a refused recording; nothing for poses, or where a note explains its values."""
    explained = report.poses is not None or any(note.code in ODD_REST for note in report.notes)
    if report.outcome != Outcome.REFUSED or explained or report.reason == "damaged":
        return ()
    health, cells = report.file_health, report.coverage.cells
    if health.rest and not NEAR_ONE_G[0] < health.rest.median_g < NEAR_ONE_G[1]:
        return (Reason("check_unit"),)
    points = report.settings.get("input", {}).get("format") == "points"
    if points and not cells:
        return ()
    if report.settings.get("profile") == PAPER.profile and report.reason != "subsets_not_full":
        return ()  # its sets are full: more orientations would not be used
    again = Reason("check_sensor" if report.reason == "constant_values" else "record_again")
    ways = _orientations(report) if cells else (again,)
    return ways if points else (*ways, Reason("other_coefficients"))


def _orientations(report: ReportView) -> tuple[Reason, ...]:
    """Return which orientations are missing."""
    found, sides = [], _sides(report)
    orientations = report.coverage.distinct_orientations
    few = sides or orientations < report.setting("min_postures", MIN_ORIENTATIONS)
    if few and report.reason != "too_few_orientations":
        found.append(Reason.of("more_orientations", orientations=orientations))
    if sides:
        found.append(Reason.of("rest_on_sides", sides=sides))
    return tuple(found)


def _sides(report: ReportView) -> list[str]:
    """Return directions of axes, such as `-z`, that no point comes near."""
    coverage = report.coverage
    return sides_not_up(coverage.axis_min_g, coverage.axis_max_g, report.setting("coverage_g", 0.3))


@dataclass(frozen=True, slots=True)
class PageVerdict:
    """Verdict at the beginning of a recording's page.

    Attributes:
        level: class of its colour.
        headline: one sentence; reason: the report's message; to_do: what to do, a sentence each.
        error: the error of the calibration, its limit, and its meaning for ENMO, a sentence each.
    """

    level: Literal["good", "care", "bad"]
    headline: str
    reason: str
    to_do: tuple[str, ...]
    error: tuple[str, ...] = ()


def page_verdict(report: ReportView) -> PageVerdict:
    """Return the verdict on a recording."""
    meaning, reason = sentences.outcome_words(report.outcome), sentences.message(report)
    if report.outcome == Outcome.REFUSED:
        headline = "Refused: this recording could not be calibrated."
        return PageVerdict("bad", headline, reason, (meaning.to_do, *map(sentences.sentence, report.advice)))
    doubtful, details = is_doubtful(report), ""
    if (
        report.reason == "calibrated"
        and report.calibration_error_mg is not None
        and report.holdout is not None
    ):
        details = " ".join((held_out_sentence(report.holdout), *map(sentences.sentence, report.notes)))
    opening = f"{'Use with care' if doubtful else 'Good'}: {meaning.headline or meaning.result}"
    return PageVerdict(
        "care" if doubtful else "good",
        f"{opening}.",
        details or reason,
        (meaning.to_do, *map(sentences.sentence, (*report.cautions, *report.advice))),
        (sentences.error_sentence(report), *_meaning_of_error(report)),
    )


def _meaning_of_error(report: ReportView) -> Iterator[str]:
    """Yield the limit of the error, and its effect on ENMO (van Hees et al. 2013)."""
    error = report.calibration_error_mg
    if error is None:
        return
    yield f"The limit is {number(report.setting('max_error_mg', LIMIT_MG))} mg."
    changed = report.change is not None and (report.change.probability or 0.0) >= PROBABLE
    known = report.rest_scatter_mg is not None and not changed
    scatter = f" of {number(report.rest_scatter_mg, 2)} mg" if known else ""
    yield (
        "While the device is still, the mean |a| of an epoch is expected to be off by as much, on average "
        f"over all orientations, and by {number(error.before, 2)} mg without calibration. ENMO at rest also "
        f"has the scatter{scatter} from rest to rest and the noise of single samples in it."
    )
