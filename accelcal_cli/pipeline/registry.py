"""The best calibration of a registry of devices for a recording that has none of its own.

Expected is, for each calibration of the device, its own error over all orientations with the uncertainty of
that, the random walk of the device over the time between, and what a temperature beyond those that it was
found in may add. The smallest is taken. It is not taken where raw data, or the recording's own provisional
coefficients, are expected to be as good, nor where the recording's own stillness speaks against it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from itertools import combinations
from math import hypot, sqrt
from pathlib import Path

from accelcal_cli.core.errors import UsageError, printable
from accelcal_cli.core.recording import Recording
from accelcal_cli.core.results import Outcome
from accelcal_cli.judge.errors import apart_mg
from accelcal_cli.output.registry import RegistryEntry, temperatures_c
from accelcal_cli.output.sections import ReportView
from accelcal_cli.pipeline import apply as applying
from accelcal_cli.pipeline import calibrate as own
from accelcal_cli.pipeline.jobs import FileStamp, Job, ProgressMaker, Request, Result, no_progress

WALK_MG2_A_DAY, WALK_SPREAD = 0.3**2 / 30, 0.1
"""Usual random walk of a device, 0.3 mg in a month, and how far one may be from it."""

WALK_ROUNDS, MOST_COMPARED = 5, 40
"""Rounds in which the walk is found, and the last calibrations of a device that it is found from."""

UNDATED_DAYS = 365.0
"""Time between two recordings of which one has no date."""

SLOPE_MG_PER_C = 1.0
"""Usual slope of an offset, where a calibration has none."""

MOST_TRIED = 3
"""Calibrations that are tried on a recording's own stillness."""

SURE = 2.0
"""Standard deviations of walk and temperature that coefficients may be off and still be better than none."""

OPEN = (Outcome.REFUSED, Outcome.PROVISIONAL)
"""Outcomes of recordings that take coefficients of the registry."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """A recording that needs a calibration.

    Attributes:
        celsius: middle of its temperatures; None if unknown.
        own_mg: expected error of its own provisional coefficients; None without any.
    """

    serial: str | None
    model: str | None
    lsb_per_g: float | None
    start: datetime | None
    celsius: float | None = None
    own_mg: float | None = None

    @classmethod
    def of_recording(cls, recording: Recording) -> Wanted:
        """Return it for a recording that was opened."""
        device, start_us = recording.device, recording.start_us
        start = None if start_us is None else datetime(1970, 1, 1) + timedelta(microseconds=start_us)
        return cls(device.serial, device.model, recording.lsb_per_g, start)

    @classmethod
    def of_report(cls, view: ReportView, quality: Path) -> Wanted:
        """Return it for a recording that was judged."""
        recording, heat, error = view.recording, temperatures_c(quality), view.calibration_error_mg
        provisional = view.calibration is not None and error is not None
        return cls(
            recording.device.serial,
            recording.device.model,
            recording.lsb_per_g,
            _moment(recording.start_time),
            None if heat is None else sum(heat) / 2,
            error.mean if provisional and error is not None else None,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One calibration of the device.

    Attributes:
        expected_mg: error that is expected of it; highest_mg: not more, in 97 of 100 cases.
        raw_mg: error that raw data have at least.
    """

    entry: RegistryEntry
    expected_mg: float
    highest_mg: float
    raw_mg: float

    def helps(self, own_mg: float | None) -> bool:
        """Return True if it is surely better than raw data, and probably better than own coefficients."""
        return self.highest_mg < self.raw_mg and (own_mg is None or self.expected_mg < own_mg)


def candidates(registry: Sequence[RegistryEntry], wanted: Wanted) -> list[Candidate]:
    """Return the calibrations of a recording's device that are expected to help, the best first."""
    known = [one for one in registry if one.serial == wanted.serial and _fits(one.view, wanted)]
    walk = walk_mg2_a_day(known)
    found = [_expected(one, wanted, walk) for one in known]
    helping = [one for one in found if one.helps(wanted.own_mg)]
    return sorted(helping, key=lambda one: (one.expected_mg, one.entry.order()))


def _fits(view: ReportView, wanted: Wanted) -> bool:
    """Return True if neither the model nor the counts in one g are others than those of a recording."""
    recording = view.recording
    alike = ((recording.device.model, wanted.model), (recording.lsb_per_g, wanted.lsb_per_g))
    return all(None in pair or pair[0] == pair[1] for pair in alike)


def _expected(entry: RegistryEntry, wanted: Wanted, walk: float) -> Candidate:
    error = entry.view.calibration_error_mg
    assert error is not None
    days = _days_between(_moment(entry.view.recording.start_time), wanted.start)
    added = walk * days + _of_temperature_mg(entry, wanted.celsius) ** 2
    highest = hypot(error.ci95[1], SURE * sqrt(added))
    raw = sqrt(max(0.0, error.before**2 - highest**2))  # the entry's own error makes raw data look worse
    return Candidate(entry, sqrt(_variance_mg2(entry) + added), highest, raw)


def _variance_mg2(entry: RegistryEntry) -> float:
    """Return the expected square of an entry's error, with the uncertainty of that [mg2]."""
    error = entry.view.calibration_error_mg
    assert error is not None
    low, high = error.ci95
    return error.mean**2 + ((high - low) / 4) ** 2


def _of_temperature_mg(entry: RegistryEntry, celsius: float | None) -> float:
    """Return what a temperature beyond those of the entry's recording may add to its error [mg]."""
    if celsius is None or entry.temperature_c is None:
        return 0.0
    low, high = entry.temperature_c
    beyond = max(0.0, low - celsius, celsius - high)
    view = entry.view.calibration
    errors = {} if view is None or view.temperature is None else dict(view.standard_errors or {})
    slopes = [1000 * float(errors[name]) for name in ("sx", "sy", "sz") if errors.get(name) is not None]
    slope = sqrt(sum(one * one for one in slopes) / len(slopes)) if slopes else SLOPE_MG_PER_C
    return slope * beyond * sqrt(3) / 2  # the mean over the sphere of |d . u| is |d| / 2


def walk_mg2_a_day(known: Sequence[RegistryEntry]) -> float:
    """Return the random walk of a device, by how far its calibrations are apart beyond their errors [mg2].

    The square of that is expected to be q t, t the days between; its standard deviation is about 1.4 times
    what it and the errors are expected to be. Pairs are weighted by that; the usual walk counts as one more.
    """
    dated = [(at, one) for one in known if (at := _moment(one.view.recording.start_time)) is not None]
    dated = sorted(dated, key=lambda pair: (pair[0], pair[1].order()))[-MOST_COMPARED:]
    held = [(at, one.coefficients().calibration, _variance_mg2(one)) for at, one in dated]
    pairs = [
        (_days_between(at, later), apart_mg(one, other) ** 2 - errors - more, errors + more)
        for (at, one, errors), (later, other, more) in combinations(held, 2)
    ]
    walk = WALK_MG2_A_DAY
    for _ in range(WALK_ROUNDS):
        weight = 1 / (2 * WALK_SPREAD**2)
        total, weights = weight * WALK_MG2_A_DAY, weight
        for days, square, errors in pairs:
            weight = 0.5 / (errors + walk * days) ** 2
            total += weight * days * square
            weights += weight * days**2
        walk = max(total / weights, WALK_MG2_A_DAY / 10)
    return walk


def _moment(start: str | None) -> datetime | None:
    """Return the start of a recording, of its device's clock; None if it is not known."""
    try:
        return None if start is None else datetime.fromisoformat(start).replace(tzinfo=None)
    except ValueError:
        return None


def _days_between(one: datetime | None, other: datetime | None) -> float:
    if one is None or other is None:
        return UNDATED_DAYS
    return abs((one.replace(tzinfo=UTC) - other.replace(tzinfo=UTC)).total_seconds()) / 86_400


def calibrate(
    job: Job,
    request: Request,
    progress: ProgressMaker = no_progress,
    source: Path | None = None,
    before: FileStamp | None = None,
) -> Result:
    """Calibrate one recording from its own stillness, or by the request's registry where that is not enough.

    Raises:
        UnreadableError: an entry of its device is damaged.
        AccelcalError: see `calibrate` in `pipeline/calibrate.py`.
    """
    result = own.calibrate(job, request, progress, source)
    if not request.registry or result.outcome not in OPEN or result.view.reason == "damaged":
        return result
    found = candidates(request.registry, Wanted.of_report(result.view, job.quality))
    if not found:
        return result
    donors = [one.entry.coefficients() for one in found[:MOST_TRIED]]
    with own.open_run(job, request, progress, source, before) as run:
        return applying.borrow_in(run, donors).result or result


def apply(
    job: Job, request: Request, progress: ProgressMaker = no_progress, source: Path | None = None
) -> Result:
    """Apply the best calibration of the request's registry to one recording.

    Raises:
        UsageError: the registry has none that is expected to be better than raw data.
        UnreadableError: an entry of its device is damaged.
        AccelcalError: see `apply` in `pipeline/apply.py`.
    """
    assert request.registry is not None
    with own.open_run(job, request, source=source) as run:
        wanted = Wanted.of_recording(run.reader.recording)
    found = candidates(request.registry, wanted)
    if not found:
        serial = (
            "without a serial number" if wanted.serial is None else f"of device {printable(wanted.serial)}"
        )
        hint = "accelcal devices OUT --registry FILE.json adds the calibrations of a study"
        text = (
            f"is a recording {serial}, for which the registry has nothing that is surely better than raw data"
        )
        raise UsageError(text, path=job.source, hint=hint)
    best = found[0].entry.coefficients()
    return applying.apply(job, replace(request, coefficients=best), progress, source)
