"""The JSON report: its sections (`sections.py`) made of what was found and judged, one function each.

`build` makes the report of a recording; those of a table of points and of a pool share its
sections. `integers_json` is the fit as integers: points in, coefficients out, for firmware and for a
check bit by bit.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from accelcal_cli.core import results
from accelcal_cli.core.arithmetic import FRACTION_BITS, to_float
from accelcal_cli.core.calibration import PARAMETER_NAMES, UPPER_NAMES, Calibration
from accelcal_cli.core.clock import iso_time
from accelcal_cli.core.declared import as_json, from_json
from accelcal_cli.core.errors import Reason, printable
from accelcal_cli.core.gyroscope import EQUATION, Gyroscope
from accelcal_cli.core.identity import DRAWS, INTEGERS, REPORT, SAMPLES, identity
from accelcal_cli.core.local_time import zone_of_times
from accelcal_cli.core.points import PENALTY_BITS, WEIGHT_ONE, PointSet, predicted_seconds
from accelcal_cli.core.recording import Problem, Recording
from accelcal_cli.core.results import Facts, Holdout, Judgement
from accelcal_cli.core.settings import EffectiveSettings
from accelcal_cli.output import sections
from accelcal_cli.output.advice import completed, of_rows
from accelcal_cli.output.coefficients import coefficients_json
from accelcal_cli.output.files import json_text
from accelcal_cli.output.report_reading import FAILURES, Document, report_schema
from accelcal_cli.output.sections import (
    HealthSection,
    LeftOutMember,
    OwnWindows,
    PoolMember,
    PoolSection,
    RecordingSection,
    WindowUse,
)
from accelcal_cli.output.sentences import sentence

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
    own = {
        **coefficients_json(calibration),
        "standard_errors": _standard_errors(calibration, verdict.standard_errors),
        "covariance": verdict.covariance,
        "optimizer": {
            **optimizer,
            "iterations": fit.iterations,
            "stop": fit.stop,
            "converged": fit.converged,
            "operations": asdict(fit.operations),
            "predicted_seconds": predicted_seconds(fit.operations, optimizer["arithmetic"]),
        },
    }
    return as_json(from_json(sections.CalibrationSection, own))


def _standard_errors(calibration: Calibration, errors: tuple[float, ...] | None) -> dict[str, float] | None:
    if errors is None:
        return None
    span = 1.0 if calibration.temperature is None else calibration.temperature.span_c
    scaled = [value / span if 9 <= index < 12 else value for index, value in enumerate(errors)]
    number = 9 if calibration.temperature is None else 12
    named = dict(zip(PARAMETER_NAMES[:number], scaled, strict=False))
    return named | dict(zip(UPPER_NAMES, scaled[12:], strict=False))


def holdout_section(holdout: results.Holdout | None) -> sections.HoldoutSection | None:
    """Return the section `holdout`: the number to quote."""
    if holdout is None:
        return None
    return sections.HoldoutSection(
        method=holdout.method,
        points=holdout.points,
        postures=holdout.postures,
        before_mg=holdout.before,
        after_mg=holdout.after,
        improvement_percent=holdout.improvement_percent() if holdout.after.mean else None,
        ci95_mg=holdout.ci95,
        improvement_factor=improvement(holdout),
    )


def improvement(holdout: results.Holdout) -> sections.Factor | None:
    """Return by what the error was divided; None where nothing is left after calibration."""
    if not holdout.after.mean:
        return None
    return sections.Factor(holdout.improvement_factor(), holdout.improvement_ci95())


def _fit(verdict: Judgement, windows: sections.WindowUse) -> sections.FitSection:
    errors = verdict.fit_errors
    if errors is None:
        return sections.FitSection(verdict.coverage.cells, None, None, None, windows)
    return sections.FitSection(errors.points, errors.postures, errors.before_mg, errors.after_mg, windows)


def coverage_section(coverage: results.Coverage) -> sections.CoverageSection:
    """Return the section `coverage`."""
    low, middle, high = coverage.subsets
    return sections.CoverageSection(
        subsets=(low, middle, high),
        axis_min_g=coverage.axis_min_g,
        axis_max_g=coverage.axis_max_g,
        cells=coverage.cells,
        distinct_orientations=coverage.distinct_orientations,
        condition_number=coverage.condition_number,
        worst_direction_mg=coverage.worst_direction_mg,
        saturated=tuple(sections.SaturatedAxis("xyz"[axis], at) for axis, at in coverage.saturated),
        subsets_full_after_h=coverage.subsets_full_after_h,
    )


def trial_section(trial: results.Trial) -> sections.TrialSection:
    """Return an entry of `models_tried`."""
    holdout = trial.holdout
    return sections.TrialSection(
        model=trial.model,
        after_mg=None if holdout is None else holdout.after.mean,
        compared_mg=None if holdout is None else holdout.compared_mg(),
        reason=None if trial.reason is None else trial.reason.code,
        values={} if trial.reason is None else dict(trial.reason.values),
        prior=trial.prior,
    )


def _without_misalignment(verdict: Judgement) -> sections.WithoutMisalignmentSection | None:
    """Return the section; None where there was no misalignment, or it could not be left out."""
    simpler = verdict.without_misalignment
    if simpler is None:
        return None
    return sections.WithoutMisalignmentSection(
        calibration=from_json(sections.Coefficients, coefficients_json(simpler.calibration)),
        calibration_error_mg=calibration_error(simpler.sphere, verdict.sphere_before),
        holdout=holdout_section(simpler.holdout),
    )


def calibration_error(
    sphere: results.SphereError | None, before: results.SphereError | None
) -> sections.CalibrationError | None:
    """Return the section `calibration_error_mg`; None where no error over all orientations is known."""
    if sphere is None or before is None:
        return None
    return sections.CalibrationError(
        mean=sphere.mean,
        ci95=sphere.ci95,
        worst_direction=sphere.worst_direction,
        worst_direction_at=sphere.worst_direction_at,
        before=before.mean,
    )


def probability(sphere: results.SphereError | None) -> sections.Probability | None:
    """Return the section `probability`; None where no error over all orientations is known."""
    return None if sphere is None else sections.Probability(sphere.probably_better(), sphere.below_limit)


def change_section(change: results.Change | None, offset_s: int | None) -> sections.ChangeSection | None:
    """Return the section `change`; None where nobody looked for a change."""
    if change is None:
        return None
    return sections.ChangeSection(
        kind=change.kind,
        unchecked=change.unchecked,
        probability=change.probability,
        at=iso_time(change.at_us, offset_s),
        size_mg=change.size_mg,
        offset_mg=change.offset_mg,
        scale_percent=change.scale_percent,
        holdout=change.holdout,
    )


def gyroscope_json(gyroscope: Gyroscope) -> dict[str, Any]:
    """Return the `gyroscope` object: coefficients as exact as they are applied."""
    bias, errors, rest = gyroscope.bias, gyroscope.standard_errors, None
    if bias is not None:
        rest = sections.RestingRates(bias.rest_s, bias.raw_dps, bias.constant_dps, bias.slope_dps)
    slope = None
    if bias is not None and bias.reference_c is not None:
        slope = sections.GyroscopeSlopes(bias.slope_dps_per_c, bias.reference_c)
    of_scale = None if errors is None else sections.matrix(errors)
    section = sections.GyroscopeSection(
        outcome=gyroscope.outcome,
        reason=gyroscope.reason.code,
        values=dict(gyroscope.reason.values),
        message=sentence(gyroscope.reason),
        equation=EQUATION,
        scale=None if gyroscope.scale is None else sections.matrix(gyroscope.scale),
        bias_dps=None if bias is None else bias.dps,
        temperature=slope,
        standard_errors=sections.GyroscopeErrors(of_scale, None if bias is None else bias.standard_errors),
        pairs=gyroscope.pairs,
        pairs_left_out=gyroscope.left_out,
        holdout_deg=gyroscope.holdout,
        rest=rest,
    )
    return as_json(section)


def rest_section(rest: results.Rest) -> sections.RestSection | None:
    """Return the section `file_health.rest`; None without still windows."""
    if not rest.windows:
        return None
    ends = sections.vector(rest.axis_min_g), sections.vector(rest.axis_max_g)
    return sections.RestSection(rest.windows, rest.median_g, rest.p5_g, rest.p95_g, *ends)


def problem_section(problem: Problem) -> sections.ProblemSection:
    """Return an entry of `file_health.problems`."""
    place = problem.byte_offset, problem.sample, problem.count
    return sections.ProblemSection(problem.code, problem.told, *place)


def losses(facts: Facts) -> dict[str, Any]:
    """Return the keys of `file_health` that say how much is lost, and how much of that is missing."""
    return {
        "lost_bytes": facts.lost_bytes,
        "lost_percent": facts.lost_percent(),
        "missing_bytes": facts.missing_if_known,
    }


def clock_section(recording: Recording, facts: Facts, *, whole: bool = True) -> sections.ClockSection:
    """Return the section `file_health.clock`; what only a complete read shows is None if not `whole`."""
    jumps, change, rate = facts.jumps, facts.zone_change, facts.rate_hz
    shift = None
    if change is not None:
        at, offsets = iso_time(change.at_us, change.before_s), (change.before_s, change.after_s)
        shift = sections.ZoneChangeSection(at, *offsets, change.followed, change.note())
    return sections.ClockSection(
        rate_hz_nominal=recording.rate_hz,
        rate_hz_measured=rate,
        drift_s_per_day=None if rate is None else DAY_S * (recording.rate_hz / rate - 1),
        gaps=jumps.gaps if whole else None,
        gap_seconds=jumps.gap_us / 1e6 if whole else None,
        backward=jumps.back if whole else None,
        dst_change=shift,
    )


def notes_json(recording: Recording, facts: Facts) -> list[str]:
    """Return the recording's notes, with those on a change of its zone and on small jumps of its stamps."""
    notes = [*recording.notes]
    if facts.zone_change is not None:
        notes.append(facts.zone_change.note())
    if facts.gone_over:
        notes.append(SHORT_JUMPS.format(facts.gone_over))
    return notes


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
    facts = data.facts
    windows = replace(data.windows, raw_error_mg=facts.rest.error_mg)
    health = HealthSection(
        problems=tuple(map(problem_section, facts.problems)),
        **asdict(facts.counts),
        clipped_samples_after=data.clipped_after,
        rate_hz_measured=facts.rate_hz,
        **losses(facts),
        clock=clock_section(data.recording, facts),
        rest=rest_section(facts.rest),
    )
    change = change_section(data.judgement.change, facts.utc_offset_s)
    judgement = replace(data.judgement, cautions=(*of_rows(facts), *data.judgement.cautions))
    return completed(document(_recording(data), health, windows, data, change) | data.taken, judgement)


def document(
    recording: RecordingSection,
    health: HealthSection,
    windows: WindowUse,
    data: JudgedInput,
    change: sections.ChangeSection | None = None,
) -> dict[str, Any]:
    """Return the sections of a report, without `provenance`, its cautions, its advice and its message."""
    verdict, calibration = data.judgement, calibration_json(data.judgement, data.optimizer)
    report = sections.ReportView(
        **identity(REPORT),
        recording=recording,
        settings=data.settings.as_json(),
        outcome=verdict.outcome,
        reason=verdict.reason.code,
        values=dict(verdict.reason.values),
        message="",
        notes=verdict.notes,
        cautions=(),
        advice=(),
        calibration=None if calibration is None else from_json(sections.CalibrationSection, calibration),
        without_misalignment=_without_misalignment(verdict),
        calibration_error_mg=calibration_error(verdict.sphere, verdict.sphere_before),
        probability=probability(verdict.sphere),
        uncertainty=verdict.uncertainty,
        rest_scatter_mg=verdict.rest_scatter_mg,
        change=change,
        misfits=verdict.misfits,
        holdout=holdout_section(verdict.holdout),
        fit=_fit(verdict, windows),
        coverage=coverage_section(verdict.coverage),
        models_tried=tuple(map(trial_section, verdict.trials)),
        file_health=health,
    )
    return {name: value for name, value in as_json(report).items() if name != "provenance"}


def parquet_metadata(data: ReportInput) -> dict[str, Any]:
    """Return the Parquet file's metadata: calibrations, recording, version; of raw values the refusal."""
    verdict = data.judgement
    report = build(data)
    refusal = {name: report[name] for name in ("outcome", "reason", "values", "message")}
    return {
        **identity(SAMPLES),
        "calibration": data.taken.get("calibration") or calibration_json(verdict, data.optimizer),
        "recording": as_json(_recording(data)),
        **{name: data.taken[name] for name in ("gyroscope",) if name in data.taken},
        **(refusal if verdict.calibration is None else {}),
        "result": result_json(report),
    }


def result_json(report: dict[str, Any]) -> dict[str, Any]:
    """Return outcome and held-out error [mg] of a report, for the Parquet file."""
    holdout = report["holdout"]
    error = holdout["after_mg"]["mean"] if isinstance(holdout, dict) else None
    return {"outcome": str(report["outcome"]), "held_out_mg": error}


def _recording(data: ReportInput) -> RecordingSection:
    recording, facts = data.recording, data.facts
    start = facts.first_us if recording.start_us is None else recording.start_us
    dated = not any(problem.code == "no_start_time" for problem in facts.problems)
    return RecordingSection(
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
        gaps=tuple(
            sections.Gap(gap.sample, iso_time(gap.start_us, facts.utc_offset_s), gap.seconds)
            for gap in facts.gaps
        ),
        gaps_omitted=facts.gaps_omitted,
        notes=notes_json(recording, facts),
        thermometer=recording.thermometer,
        factory_calibration=recording.factory,
    )


def file_name(path: Path) -> str:
    """Return the name of a file or folder, however its path was typed."""
    return printable(path.name or Path(os.path.abspath(path)).name)  # noqa: PTH100 (links keep their names)


def duration_s(recording: Recording, facts: Facts) -> float:
    """Return the time from the first sample to one period after the last [s], without resets of the clock."""
    return facts.span_us / 1e6 + 1 / recording.rate_hz if facts.samples else 0.0


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
        "bend": list(verdict.fit.bend),
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
        "equation": sections.EQUATION,
        "reference_c": drawn[0].reference_c() if drawn else None,
        "parameters": list(PARAMETER_NAMES),
        "bend_per_g": drawn[0].bend_per_g().tolist() if drawn else None,
        "draws": [
            [to_float(value) for value in one.parameters[:9]] + one.slope_g_per_c().tolist() for one in drawn
        ],
    }


# Documents with the keys of a recording's report, without what only samples tell.
#
# They are the report of a fit to points from a table, that of a pool of recordings calibrated as one,
# with what the reports of its members say about it, and the object that `--json` prints for a
# recording that failed.

FORMAT = "pool"
TAKEN = (
    "calibration",
    "without_misalignment",
    "calibration_error_mg",
    "probability",
    "uncertainty",
    "rest_scatter_mg",
    "holdout",
    "fit",
    "coverage",
    "models_tried",
)
"""Sections that a member's report takes from its pool's."""


@dataclass(frozen=True, slots=True)
class PointsInput(JudgedInput):
    """Everything that the report of a table of points is made of.

    Attributes:
        rows: number of rows of the table.
        implausible: number of rows whose length is nowhere near 1 g.
        raw_error_mg, after_error_mg: mean | |a| - 1 g | over the other rows.
    """

    path: Path
    sha256: str
    bytes: int
    rows: int
    implausible: int
    raw_error_mg: float | None
    after_error_mg: float | None


def build_points(data: PointsInput) -> dict[str, Any]:
    """Return the report of a table of points without `provenance`."""
    recording = RecordingSection(
        path=file_name(data.path),
        sha256=data.sha256,
        bytes=data.bytes,
        format="points",
        samples=data.rows,
    )
    used = data.rows - data.implausible
    windows = WindowUse(
        complete=data.rows,
        implausible=data.implausible,
        used=used,
        raw_error_mg=data.raw_error_mg,
        after_error_mg=data.after_error_mg,
    )
    return completed(document(recording, HealthSection(), windows, data), data.judgement)


@dataclass(frozen=True, slots=True)
class Member:
    """A recording of a pool."""

    path: Path
    sha256: str

    @property
    def section(self) -> PoolMember:
        """An entry of `pool.recordings`."""
        return PoolMember(printable(self.path), self.sha256)


@dataclass(frozen=True, slots=True)
class PoolInput(JudgedInput):
    """Everything that the report of a pool is made of, except the provenance.

    Attributes:
        left_out: recordings that contradict the others, with the reason.
        example: one of the recordings; they agree in device, counts per g and range.
        bytes, samples: sums over the members.
        copies: further recordings with the content of a member.
        notes: notes that all members have.
    """

    members: Sequence[Member]
    left_out: Sequence[tuple[Member, Reason]]
    example: Recording
    bytes: int
    samples: int
    windows: WindowUse
    copies: Sequence[Member] = ()
    notes: Sequence[str] = ()


def build_pool(data: PoolInput) -> dict[str, Any]:
    """Return the report of a pool without `provenance`."""
    device, example, members = data.example.device, data.example, data.members
    recording = RecordingSection(
        path=printable(f"pool of {len(members)} recordings of device {device.serial}"),
        sha256=hashlib.sha256("".join(one.sha256 for one in members).encode()).hexdigest(),
        bytes=data.bytes,
        format=FORMAT,
        device=replace(device, firmware=None),
        lsb_per_g=example.lsb_per_g,
        range_g=example.range_g,
        samples=data.samples,
        notes=list(data.notes),
    )
    report = completed(document(recording, HealthSection(), data.windows, data), data.judgement)
    section = PoolSection(
        serial=device.serial or "",
        recordings=tuple(member.section for member in members),
        left_out=tuple(
            LeftOutMember(printable(member.path), member.sha256, why.code, why.values)
            for member, why in data.left_out
        ),
        copies=tuple(copy.section for copy in data.copies) or None,
    )
    return {**report, "pool": as_json(section)}


def of_member(pool: Document, report: Path, holdout: Holdout | None) -> dict[str, Any]:
    """Return the sections of a member's report: those of the pool, and what the pool does to its own windows.

    Args:
        report: future path of the member's report, to which the pool's path is relative.
        holdout: errors on the member's own points, which are some of those that were fitted.
    """
    relative = Path(os.path.relpath(pool.path, report.parent)).as_posix()
    own = None
    if holdout is not None:
        own = OwnWindows(holdout.points, holdout.postures, holdout.before, holdout.after)
    pooled = from_json(PoolSection, pool.report["pool"])
    section = replace(pooled, path=printable(relative), sha256=pool.content_sha256, own_windows=own)
    return {**{name: pool.report.get(name) for name in TAKEN}, "pool": as_json(section)}


def failure_code(exit_code: int) -> str:
    """Return the code of the reason why a recording failed."""
    return FAILURES.get(exit_code, "failed")


def failed_document(path: Path, exit_code: int, message: str) -> dict[str, Any]:
    """Return the object of a recording that has no report: the keys of one, null where nothing is known.

    It is never written into a file. The schema has it under `$defs`, as `failure`.
    """
    schema = report_schema()
    document: dict[str, Any] = dict.fromkeys(schema["required"])
    recording = dict.fromkeys(schema["properties"]["recording"]["required"])
    return document | {
        **identity(REPORT),
        "recording": recording | {"path": file_name(path)},
        "outcome": "failed",
        "reason": failure_code(exit_code),
        "values": {"path": printable(path), "exit_code": exit_code},
        "message": printable(message),
        **{name: [] for name in ("notes", "cautions", "advice")},
    }
