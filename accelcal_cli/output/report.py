"""The JSON report: its sections made from plain records, one function each.

`build` makes the report of a recording; those of a table of points and of a pool (report_kinds.py) share
its sections. `integers_json` is the fit as integers: points in, coefficients out, for firmware and for a
check bit by bit.
"""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from accelcal_cli.core import results
from accelcal_cli.core.arithmetic import FRACTION_BITS, to_float
from accelcal_cli.core.calibration import PARAMETER_NAMES, UPPER_NAMES, Calibration
from accelcal_cli.core.clock import iso_time
from accelcal_cli.core.errors import printable
from accelcal_cli.core.gyroscope import EQUATION, Bias, Gyroscope, TurnHoldout
from accelcal_cli.core.identity import DRAWS, INTEGERS, REPORT, SAMPLES, identity
from accelcal_cli.core.local_time import ZoneChange, zone_of_times
from accelcal_cli.core.points import PENALTY_BITS, WEIGHT_ONE, Arithmetic, Fit, PointSet, predicted_seconds
from accelcal_cli.core.reasons import significant
from accelcal_cli.core.recording import Problem, Recording
from accelcal_cli.core.results import Facts, Judgement
from accelcal_cli.core.settings import EffectiveSettings
from accelcal_cli.output.advice import completed, of_rows
from accelcal_cli.output.coefficients import EQUATION as DRAWS_EQUATION
from accelcal_cli.output.coefficients import coefficients_json
from accelcal_cli.output.files import json_text
from accelcal_cli.output.report_view import ReportRecording
from accelcal_cli.output.words import sentence

DAY_S = 86_400
SHORT_JUMPS = (
    "its times jitter or skip a little: {} short gaps and steps back in what was read; "
    "windows span them (--longest-gap)"
)


def calibration_json(verdict: Judgement, optimizer: dict[str, Any]) -> dict[str, Any] | None:
    """Return the `calibration` object; None if there is none."""
    calibration, fit = verdict.calibration, verdict.fit
    if calibration is None or fit is None:
        return None
    return {
        **coefficients_json(calibration),
        "standard_errors": _standard_errors(calibration, verdict.standard_errors),
        "optimizer": {**optimizer, **_effort(fit, optimizer["arithmetic"])},
    }


def _standard_errors(calibration: Calibration, errors: tuple[float, ...] | None) -> dict[str, float] | None:
    if errors is None:
        return None
    span = 1.0 if calibration.temperature is None else calibration.temperature.span_c
    scaled = [value / span if 9 <= index < 12 else value for index, value in enumerate(errors)]
    number = 9 if calibration.temperature is None else 12
    named = dict(zip(PARAMETER_NAMES[:number], scaled, strict=False))
    named |= dict(zip(UPPER_NAMES, scaled[12:], strict=False))
    return {name: significant(value) for name, value in named.items()}


def _effort(fit: Fit, arithmetic: Arithmetic) -> dict[str, Any]:
    seconds = predicted_seconds(fit.operations, arithmetic)
    return {
        "iterations": fit.iterations,
        "stop": fit.stop,
        "converged": fit.converged,
        "operations": asdict(fit.operations),
        "predicted_seconds": seconds and {name: significant(value) for name, value in seconds.items()},
    }


def holdout_json(holdout: results.Holdout) -> dict[str, Any]:
    """Return the `holdout` object: the number to quote."""
    return {
        "method": holdout.method,
        "points": holdout.points,
        "postures": holdout.postures,
        "before_mg": summary_json(holdout.before),
        "after_mg": summary_json(holdout.after),
        "improvement_percent": round(holdout.improvement_percent(), 1) if holdout.after.mean else None,
        "improvement_factor": factor_json(holdout),
        "ci95_mg": [round(value, 4) for value in holdout.ci95],
    }


def factor_json(holdout: results.Holdout) -> dict[str, Any] | None:
    """Return the `improvement_factor` object; None where nothing is left after calibration."""
    if not holdout.after.mean:
        return None
    interval = holdout.improvement_ci95()
    return {
        "value": significant(holdout.improvement_factor()),
        "ci95": None if interval is None else [significant(value) for value in interval],
    }


def summary_json(errors: results.ErrorSummary) -> dict[str, float]:
    """Return mean, median and 95th percentile [mg]."""
    return {"mean": round(errors.mean, 4), "median": round(errors.median, 4), "p95": round(errors.p95, 4)}


def fit_json(verdict: Judgement, windows: dict[str, Any]) -> dict[str, Any]:
    """Return the `fit` object: errors on the points that were fitted."""
    errors = verdict.fit_errors
    return {
        "points": verdict.coverage.cells if errors is None else errors.points,
        "postures": None if errors is None else errors.postures,
        "before_mg": None if errors is None else round(errors.before_mg, 4),
        "after_mg": None if errors is None else round(errors.after_mg, 4),
        "windows": windows,
    }


def coverage_json(coverage: results.Coverage) -> dict[str, Any]:
    """Return the `coverage` object."""
    worst, condition = coverage.worst_direction_mg, coverage.condition_number
    return {
        "subsets": [list(row) for row in coverage.subsets],
        "axis_min_g": [round(value, 4) for value in coverage.axis_min_g],
        "axis_max_g": [round(value, 4) for value in coverage.axis_max_g],
        "cells": coverage.cells,
        "distinct_orientations": coverage.distinct_orientations,
        "condition_number": None if condition is None else significant(condition),
        "worst_direction_mg": None if worst is None else significant(worst),
        "saturated": [{"axis": "xyz"[axis], "at_g": round(at, 4)} for axis, at in coverage.saturated],
        "subsets_full_after_h": coverage.subsets_full_after_h,
    }


def trial_json(trial: results.Trial) -> dict[str, Any]:
    """Return one entry of `models_tried`."""
    holdout = trial.holdout
    return {
        "model": trial.model,
        "after_mg": None if holdout is None else round(holdout.after.mean, 4),
        "compared_mg": None if holdout is None else round(holdout.compared_mg(), 4),
        "reason": None if trial.reason is None else trial.reason.code,
        "values": {} if trial.reason is None else dict(trial.reason.values),
        **({} if trial.prior is None else {"prior": trial.prior}),
    }


def without_misalignment_json(verdict: Judgement) -> dict[str, Any] | None:
    """Return the `without_misalignment` object; None where there was none, or it could not be left out."""
    simpler = verdict.without_misalignment
    if simpler is None:
        return None
    return {
        "calibration": coefficients_json(simpler.calibration),
        "calibration_error_mg": calibration_error_json(simpler.sphere, verdict.sphere_before),
        "holdout": None if simpler.holdout is None else holdout_json(simpler.holdout),
    }


def calibration_error_json(
    sphere: results.SphereError | None, before: results.SphereError | None
) -> dict[str, Any] | None:
    """Return the `calibration_error_mg` object; None where no error over all orientations is known."""
    if sphere is None or before is None:
        return None
    return {
        "mean": significant(sphere.mean),
        "ci95": [significant(value) for value in sphere.ci95],
        "worst_direction": significant(sphere.worst_direction),
        "worst_direction_at": [round(value, 4) for value in sphere.worst_direction_at],
        "before": significant(before.mean),
    }


def change_json(change: results.Change | None, offset_s: int | None) -> dict[str, Any] | None:
    """Return the `change` object; None where nobody looked for a change."""
    if change is None:
        return None
    holdout = change.holdout
    return {
        "kind": change.kind,
        "unchecked": change.unchecked,
        "at": iso_time(change.at_us, offset_s),
        "size_mg": change.size_mg and significant(change.size_mg),
        "offset_mg": change.offset_mg and [significant(value) for value in change.offset_mg],
        "scale_percent": change.scale_percent and [significant(value) for value in change.scale_percent],
        "holdout": holdout and {key: value and significant(value) for key, value in asdict(holdout).items()},
    }


def misfits_json(misfits: tuple[results.Misfit, ...] | None) -> list[dict[str, Any]] | None:
    """Return the list `misfits`; None where nobody looked for any."""
    if misfits is None:
        return None
    return [
        {
            "kind": one.kind,
            "found": one.found,
            "unit": one.unit,
            "size": [significant(value) for value in one.size],
            "standard_errors": [significant(value) for value in one.standard_errors],
            "before_mg": round(one.before_mg, 4),
            "after_mg": round(one.after_mg, 4),
            "largest_mg": significant(one.largest_mg),
        }
        for one in misfits
    ]


def gyroscope_json(gyroscope: Gyroscope) -> dict[str, Any]:
    """Return the `gyroscope` object: coefficients as exact as they are applied, errors to four digits."""
    bias, errors, holdout = gyroscope.bias, gyroscope.standard_errors, gyroscope.holdout
    of_bias = None if bias is None else bias.standard_errors
    slope = None
    if bias is not None and bias.reference_c is not None:
        slope = {"slope_dps_per_c": list(bias.slope_dps_per_c), "reference_c": bias.reference_c}
    return {
        "outcome": gyroscope.outcome,
        "reason": gyroscope.reason.code,
        "values": dict(gyroscope.reason.values),
        "message": sentence(gyroscope.reason),
        "equation": EQUATION,
        "scale": None if gyroscope.scale is None else [list(row) for row in gyroscope.scale],
        "bias_dps": None if bias is None else list(bias.dps),
        "temperature": slope,
        "standard_errors": {
            "scale": None if errors is None else [[significant(one) for one in row] for row in errors],
            "bias_dps": None if of_bias is None else [significant(one) for one in of_bias],
        },
        "pairs": gyroscope.pairs,
        "pairs_left_out": gyroscope.left_out,
        "holdout_deg": None if holdout is None else _turn_errors(holdout),
        "rest": None if bias is None else _resting_rates(bias),
    }


def _turn_errors(holdout: TurnHoldout) -> dict[str, Any]:
    return {
        "before": significant(holdout.before),
        "after": significant(holdout.after),
        "ci95": [significant(one) for one in holdout.ci95],
        "mean_before": significant(holdout.mean_before),
        "mean_after": significant(holdout.mean_after),
        "rms_before": significant(holdout.rms_before),
        "rms_after": significant(holdout.rms_after),
    }


def _resting_rates(bias: Bias) -> dict[str, Any]:
    rates = {"raw_dps": bias.raw_dps, "constant_dps": bias.constant_dps, "slope_dps": bias.slope_dps}
    rounded_rates = {name: None if value is None else significant(value) for name, value in rates.items()}
    return {"seconds": round(bias.rest_s, 3), **rounded_rates}


def rest_json(rest: results.Rest) -> dict[str, Any] | None:
    """Return the object `file_health.rest`; None without still windows."""
    if not rest.windows:
        return None
    quantiles = {name: getattr(rest, name) for name in ("median_g", "p5_g", "p95_g")}
    ends = {name: [round(value, 4) for value in getattr(rest, name)] for name in ("axis_min_g", "axis_max_g")}
    return {"windows": rest.windows, **quantiles, **ends}


def problem_json(problem: Problem) -> dict[str, Any]:
    """Return one entry of `file_health.problems`."""
    kept = {name: getattr(problem, name) for name in ("byte_offset", "sample", "count")}
    return {"code": problem.code, "message": problem.told, **kept}


def damage_json(facts: Facts) -> dict[str, Any]:
    """Return the keys of `file_health` that say how much is lost, and how much of that is missing."""
    return {
        "lost_bytes": facts.lost_bytes,
        "lost_percent": round(facts.lost_percent(), 4),
        "missing_bytes": facts.missing_if_known,
    }


def clock_json(recording: Recording, facts: Facts, *, whole: bool = True) -> dict[str, Any]:
    """Return the object `file_health.clock`; what only a complete read shows is null if not `whole`."""
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
        "followed": change.followed,
        "note": change.note(),
    }


def notes_json(recording: Recording, facts: Facts) -> list[str]:
    """Return the recording's notes, with those on a change of its zone and on small jumps of its stamps."""
    notes = [*recording.notes]
    if facts.zone_change is not None:
        notes.append(facts.zone_change.note())
    if facts.gone_over:
        notes.append(SHORT_JUMPS.format(facts.gone_over))
    return notes


def rounded(value: float | None) -> float | None:
    """Round to four decimals, if there is a value."""
    return None if value is None else round(value, 4)


@dataclass(frozen=True, slots=True)
class WindowUse:
    """Numbers of windows by fate, for `fit.windows`; all but `complete` add up to it.

    Where still windows that agree are joined, the joint one counts once, by its fate, and the others
    as `joined`.
    """

    complete: int
    moving: int
    filled: int
    clipped: int
    recovered: int
    joined: int
    repeated: int
    implausible: int
    constant_left_out: int
    temperature_left_out: int
    saturated_left_out: int
    used: int


@dataclass(frozen=True, slots=True)
class FileHealth:
    """`file_health` of the report, in the order of its keys; by default that of no samples."""

    problems: list[dict[str, Any]] = field(default_factory=list)
    counts: results.SampleCounts = field(default_factory=results.SampleCounts)
    clipped_samples_after: int | None = None
    rate_hz_measured: float | None = None
    lost_bytes: int = 0
    lost_percent: float = 0.0
    missing_bytes: int | None = 0
    clock: dict[str, Any] | None = None
    rest: dict[str, Any] | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the object; each of the counts is a key of its own."""
        keys = asdict(self)
        return {"problems": keys.pop("problems"), **keys.pop("counts"), **keys}


@dataclass(frozen=True, slots=True)
class JudgedInput:
    """The settings and the judgement that reports of all kinds are made of."""

    settings: EffectiveSettings
    judgement: Judgement
    optimizer: dict[str, Any]


@dataclass(frozen=True, slots=True)
class ReportInput(JudgedInput):
    """Everything that a recording's report is made of, except the provenance.

    Attributes:
        taken: sections that do not follow from the judgement: those of another report whose coefficients
            are applied, and that of the gyroscope.
        gyroscope: verdict on the gyroscope, None if there is none.
    """

    recording: Recording
    sha256: str
    facts: Facts
    windows: WindowUse
    clipped_after: int | None
    taken: dict[str, Any] = field(default_factory=dict)
    gyroscope: Gyroscope | None = None


def build(data: ReportInput) -> dict[str, Any]:
    """Return the report without `provenance`: the same for the same input, settings and version."""
    raw = data.facts.rest.error_mg
    windows = {**asdict(data.windows), "raw_error_mg": rounded(raw)}
    change = change_json(data.judgement.change, data.facts.utc_offset_s)
    judgement = replace(data.judgement, cautions=(*of_rows(data.facts), *data.judgement.cautions))
    return completed(document(_recording(data), _health(data), windows, data, change) | data.taken, judgement)


def document(
    recording: ReportRecording,
    health: FileHealth,
    windows: dict[str, Any],
    data: JudgedInput,
    change: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Put the sections of a report into their order; `windows` is the object `fit.windows`."""
    verdict = data.judgement
    return {
        **identity(REPORT),
        "recording": recording.as_json(),
        "settings": data.settings.as_json(),
        "outcome": str(verdict.outcome),
        "reason": verdict.reason.code,
        "values": dict(verdict.reason.values),
        "message": "",
        "notes": [note.as_json() for note in verdict.notes],
        "cautions": [],
        "advice": [],
        "calibration": calibration_json(verdict, data.optimizer),
        "without_misalignment": without_misalignment_json(verdict),
        "calibration_error_mg": calibration_error_json(verdict.sphere, verdict.sphere_before),
        "rest_scatter_mg": None if verdict.rest_scatter_mg is None else significant(verdict.rest_scatter_mg),
        "change": change,
        "misfits": misfits_json(verdict.misfits),
        "holdout": None if verdict.holdout is None else holdout_json(verdict.holdout),
        "fit": fit_json(verdict, windows),
        "coverage": coverage_json(verdict.coverage),
        "models_tried": [trial_json(trial) for trial in verdict.trials],
        "file_health": health.as_json(),
    }


def parquet_metadata(data: ReportInput) -> dict[str, Any]:
    """Return the Parquet file's metadata: calibrations, recording, version; of raw values the refusal."""
    verdict = data.judgement
    report = build(data)
    refusal = {name: report[name] for name in ("outcome", "reason", "values", "message")}
    return {
        **identity(SAMPLES),
        "calibration": data.taken.get("calibration") or calibration_json(verdict, data.optimizer),
        "recording": _recording(data).as_json(),
        **{name: data.taken[name] for name in ("gyroscope",) if name in data.taken},
        **(refusal if verdict.calibration is None else {}),
        "result": result_json(report),
    }


def result_json(report: dict[str, Any]) -> dict[str, Any]:
    """Return outcome and held-out error [mg] of a report, for the Parquet file."""
    holdout = report["holdout"]
    error = holdout["after_mg"]["mean"] if isinstance(holdout, dict) else None
    return {"outcome": str(report["outcome"]), "held_out_mg": error}


def _recording(data: ReportInput) -> ReportRecording:
    recording, facts = data.recording, data.facts
    start = facts.first_us if recording.start_us is None else recording.start_us
    dated = not any(problem.code == "no_start_time" for problem in facts.problems)
    return ReportRecording(
        path=file_name(recording.path),
        sha256=data.sha256,
        bytes=recording.total_bytes,
        format=recording.format,
        device=recording.device,
        sample_rate_hz=recording.rate_hz,
        lsb_per_g=recording.lsb_per_g,
        range_g=recording.range_g,
        start_time=iso_time(start, facts.utc_offset_s) if dated else None,
        timezone=recording.timezone,
        time_zone=zone_of_times(facts.utc_offset_s),
        samples=facts.samples,
        duration_s=duration_s(recording, facts),
        gaps=[_gap(gap, facts.utc_offset_s) for gap in facts.gaps],
        gaps_omitted=facts.gaps_omitted,
        notes=notes_json(recording, facts),
        thermometer=None if recording.thermometer is None else asdict(recording.thermometer),
        factory_calibration=None if recording.factory is None else recording.factory.as_json(),
    )


def file_name(path: Path) -> str:
    """Return the name of a file or folder, however its path was typed."""
    return printable(path.name or Path(os.path.abspath(path)).name)  # noqa: PTH100 (links keep their names)


def duration_s(recording: Recording, facts: Facts) -> float:
    """Return the time from the first sample to one period after the last [s], without resets of the clock."""
    return round(facts.span_us / 1e6 + 1 / recording.rate_hz, 6) if facts.samples else 0.0


def _gap(gap: results.Gap, offset_s: int | None) -> dict[str, Any]:
    return {
        "sample": gap.sample,
        "start_time": iso_time(gap.start_us, offset_s),
        "seconds": round(gap.seconds, 6),
    }


def _health(data: ReportInput) -> FileHealth:
    facts = data.facts
    return FileHealth(
        problems=[problem_json(problem) for problem in facts.problems],
        counts=facts.counts,
        clipped_samples_after=data.clipped_after,
        rate_hz_measured=None if facts.rate_hz is None else round(facts.rate_hz, 6),
        **damage_json(facts),
        clock=clock_json(data.recording, facts),
        rest=rest_json(facts.rest),
    )


def dumps(report: dict[str, Any], *, pretty: bool) -> str:
    """Write the report as JSON text."""
    return json_text(report, indent=2 if pretty else None)


def integers_json(data: ReportInput, points: PointSet) -> dict[str, Any] | None:
    """Return points and parameters as fixed-point integers; None if the recording was refused."""
    verdict = data.judgement
    if verdict.calibration is None or verdict.fit is None:
        return None
    scale, penalty = points.temperature, verdict.penalty
    return {
        **identity(INTEGERS),
        "sha256": data.sha256,
        "fraction_bits": FRACTION_BITS,
        "weight_one": WEIGHT_ONE,
        "optimizer": data.optimizer,
        "model": verdict.calibration.model,
        "points": points.xyz.tolist(),
        "weights": points.weights.tolist(),
        "temperatures": None if points.tau is None else points.tau.tolist(),
        "temperature_reference_mc": None if scale is None else scale.reference_mc,
        "temperature_span_c": None if scale is None else scale.span_c,
        "penalty": None if penalty is None else {"fraction_bits": PENALTY_BITS, **asdict(penalty)},
        "parameters": dict(zip(PARAMETER_NAMES, verdict.fit.parameters, strict=True)),
        "iterations": verdict.fit.iterations,
        "stop": verdict.fit.stop,
    }


def draws_json(data: ReportInput, number: int) -> dict[str, Any]:
    """Return plausible coefficients for the analyses of others; none where no posterior is known."""
    verdict = data.judgement
    drawn = verdict.draws(number, data.sha256)
    return {
        **identity(DRAWS),
        "sha256": data.sha256,
        "asked_for": number,
        "calibration": calibration_json(verdict, data.optimizer),
        "equation": DRAWS_EQUATION,
        "reference_c": drawn[0].reference_c() if drawn else None,
        "parameters": list(PARAMETER_NAMES),
        "draws": [
            [to_float(value) for value in one.parameters[:9]] + one.slope_g_per_c().tolist() for one in drawn
        ],
    }
