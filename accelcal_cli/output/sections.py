"""Sections of a report that several documents share, from plain records."""

from __future__ import annotations

from dataclasses import asdict
from math import floor, log10
from typing import Any

from accelcal_cli.core.facts import Facts
from accelcal_cli.core.fixed import FRACTION_BITS, to_float
from accelcal_cli.core.judgement import Coverage, ErrorSummary, Holdout, Judgement, Trial
from accelcal_cli.core.microcontrollers import predicted_seconds
from accelcal_cli.core.points import PARAMETER_NAMES, UPPER_NAMES, Arithmetic, Calibration, Fit
from accelcal_cli.core.recording import Problem, Recording
from accelcal_cli.core.zones import ZoneChange, iso_time

EQUATION = "a = K (v + o + s (T - Tref))"
DAY_S = 86_400


def calibration_json(verdict: Judgement, optimizer: dict[str, Any]) -> dict[str, Any] | None:
    """The `calibration` object; None where there is none."""
    found, fit = verdict.calibration, verdict.fit
    if found is None or fit is None:
        return None
    return {
        **coefficients_json(found),
        "standard_errors": _standard_errors(found, verdict.standard_errors),
        "optimizer": {**optimizer, **_effort(fit, optimizer["arithmetic"])},
    }


def coefficients_json(found: Calibration) -> dict[str, Any]:
    """What is needed to apply a calibration."""
    return {
        "model": found.model,
        "gain": found.gain().tolist(),
        "offset_g": found.offset_g().tolist(),
        "parameters": {name: to_float(value) for name, value in _integers(found, 9).items()},
        "temperature": _temperature(found),
        "equation": EQUATION,
        "fixed_point": _fixed_point(found),
        "gravity": {
            "local_g": float(found.gravity.local_g()),
            "latitude": found.gravity.latitude,
            "altitude": found.gravity.altitude_m,
        },
    }


def _integers(found: Calibration, number: int) -> dict[str, int]:
    """Parameters by name; those above K's diagonal only where there are any."""
    named = dict(zip(PARAMETER_NAMES[:number], found.parameters, strict=False))
    return named | dict(zip(UPPER_NAMES, found.upper, strict=True)) if any(found.upper) else named


def _temperature(found: Calibration) -> dict[str, Any] | None:
    if found.temperature is None:
        return None
    return {"slope_g_per_c": found.slope_g_per_c().tolist(), "reference_c": found.reference_c()}


def _standard_errors(found: Calibration, errors: tuple[float, ...] | None) -> dict[str, float] | None:
    if errors is None:
        return None
    span = 1.0 if found.temperature is None else found.temperature.span_c
    scaled = [value / span if 9 <= index < 12 else value for index, value in enumerate(errors)]
    number = 9 if found.temperature is None else 12
    named = dict(zip(PARAMETER_NAMES[:number], scaled, strict=False))
    named |= dict(zip(UPPER_NAMES, scaled[12:], strict=False))
    return {name: significant(value) for name, value in named.items()}


def _fixed_point(found: Calibration) -> dict[str, Any]:
    scale = found.temperature
    return {
        "fraction_bits": FRACTION_BITS,
        "parameters": _integers(found, 12),
        "temperature_reference_mc": None if scale is None else scale.reference_mc,
        "temperature_span_c": None if scale is None else scale.span_c,
    }


def _effort(fit: Fit, arithmetic: Arithmetic) -> dict[str, Any]:
    seconds = predicted_seconds(fit.operations, arithmetic)
    return {
        "iterations": fit.iterations,
        "stop": fit.stop,
        "operations": asdict(fit.operations),
        "predicted_seconds": seconds and {name: significant(value) for name, value in seconds.items()},
    }


def holdout_json(held: Holdout) -> dict[str, Any]:
    """The `holdout` object: the number to quote."""
    return {
        "method": held.method,
        "points": held.points,
        "postures": held.postures,
        "before_mg": summary_json(held.before),
        "after_mg": summary_json(held.after),
        "improvement_percent": round(held.improvement_percent(), 1) if held.after.mean else None,
        "ci95_mg": [round(value, 4) for value in held.ci95],
    }


def summary_json(errors: ErrorSummary) -> dict[str, float]:
    """Mean, median and 95th percentile [mg]."""
    return {"mean": round(errors.mean, 4), "median": round(errors.median, 4), "p95": round(errors.p95, 4)}


def fit_json(verdict: Judgement, windows: dict[str, Any]) -> dict[str, Any]:
    """The `fit` object: errors on the points that were fitted."""
    errors = verdict.fit_errors
    return {
        "points": verdict.coverage.cells if errors is None else errors.points,
        "postures": None if errors is None else errors.postures,
        "before_mg": None if errors is None else round(errors.before_mg, 4),
        "after_mg": None if errors is None else round(errors.after_mg, 4),
        "windows": windows,
    }


def coverage_json(seen: Coverage) -> dict[str, Any]:
    """The `coverage` object."""
    worst, condition = seen.worst_direction_mg, seen.condition_number
    return {
        "subsets": [list(row) for row in seen.subsets],
        "axis_min_g": [round(value, 4) for value in seen.axis_min_g],
        "axis_max_g": [round(value, 4) for value in seen.axis_max_g],
        "cells": seen.cells,
        "condition_number": None if condition is None else significant(condition),
        "worst_direction_mg": None if worst is None else significant(worst),
    }


def trial_json(trial: Trial) -> dict[str, Any]:
    """One entry of `models_tried`."""
    held = trial.holdout
    return {
        "model": trial.model,
        "after_mg": None if held is None else round(held.after.mean, 4),
        "compared_mg": None if held is None else round(held.compared_mg(), 4),
        "reason": trial.reason,
    }


def problem_json(problem: Problem) -> dict[str, Any]:
    """One entry of `file_health.problems`."""
    return {
        "code": problem.code,
        "message": problem.message,
        "byte_offset": problem.byte_offset,
        "sample": problem.sample,
        "count": problem.count,
    }


def damage_json(facts: Facts) -> dict[str, Any]:
    """The keys of `file_health` that say how much damage has taken."""
    return {"lost_bytes": facts.lost_bytes, "lost_percent": round(facts.lost_percent(), 4)}


def clock_json(recording: Recording, facts: Facts, *, whole: bool = True) -> dict[str, Any]:
    """The object `file_health.clock`; what only reading everything tells is null if not `whole`."""
    jumps, change, rate = facts.jumps, facts.zone_change, facts.rate_hz
    return {
        "rate_hz_nominal": recording.rate_hz,
        "rate_hz_measured": None if rate is None else round(rate, 6),
        "drift_s_per_day": None if rate is None else round(DAY_S * (recording.rate_hz / rate - 1), 3),
        "gaps": jumps.gaps if whole else None,
        "gap_seconds": round(jumps.gap_us / 1e6, 6) if whole else None,
        "backward": jumps.back if whole else None,
        "dst_change": None if change is None else _zone_change(change),
    }


def _zone_change(change: ZoneChange) -> dict[str, Any]:
    return {
        "time": iso_time(change.at_us, change.before_s),
        "utc_offset_s_before": change.before_s,
        "utc_offset_s_after": change.after_s,
        "note": change.note(),
    }


def notes_json(recording: Recording, facts: Facts) -> list[str]:
    """The recording's notes, and the change of its zone."""
    change = facts.zone_change
    return [*recording.notes, *(() if change is None else (change.note(),))]


def significant(value: float, digits: int = 4) -> float:
    """Round to so many significant digits: the last bits of linear algebra differ by machine."""
    return 0.0 if value == 0 else round(value, digits - 1 - floor(log10(abs(value))))
