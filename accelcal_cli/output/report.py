"""The JSON report: one function a section, all from plain records."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from accelcal_cli import __version__
from accelcal_cli.core.facts import Facts, Gap
from accelcal_cli.core.judgement import Judgement
from accelcal_cli.core.names import printable
from accelcal_cli.core.recording import Recording, as_json_device
from accelcal_cli.core.zones import iso_time
from accelcal_cli.output.schema import fault
from accelcal_cli.output.sections import (
    calibration_json,
    clock_json,
    coverage_json,
    damage_json,
    fit_json,
    holdout_json,
    notes_json,
    problem_json,
    trial_json,
)

SCHEMA_VERSION = 1
LARGEST_BYTES = 64 << 20
"""A report has some thousand entries at most; what is longer is none."""


@dataclass(frozen=True, slots=True)
class WindowUse:
    """Windows by fate, for `fit.windows`; all but `complete` add up to it.

    Where still windows that agree are joined, the joint one counts once, by its fate, and the others
    as `joined`.
    """

    complete: int
    moving: int
    filled: int
    clipped: int
    recovered: int
    joined: int
    implausible: int
    constant_left_out: int
    used: int


@dataclass(frozen=True, slots=True)
class ReportInput:
    """All that a report is made of, save the provenance.

    Attributes:
        taken: sections of the report that do not follow from the judgement: those of another report
            whose coefficients are applied.
    """

    recording: Recording
    sha256: str
    facts: Facts
    settings: dict[str, Any]
    judgement: Judgement
    windows: WindowUse
    optimizer: dict[str, Any]
    clipped_after: int | None
    taken: dict[str, Any] = field(default_factory=dict)


def build(data: ReportInput) -> dict[str, Any]:
    """The report without `provenance`: the same for the same input, settings and version."""
    source = {
        "recording": recording_json(data.recording, data.sha256, data.facts),
        "settings": data.settings,
        "file_health": _health(data),
    }
    windows = {name: getattr(data.windows, name) for name in data.windows.__dataclass_fields__}
    raw = data.facts.still_error_mg
    used = {**windows, "raw_error_mg": None if raw is None else round(raw, 4)}
    return document(source, data.judgement, data.optimizer, used) | data.taken


def document(
    source: dict[str, Any], verdict: Judgement, optimizer: dict[str, Any], windows: dict[str, Any]
) -> dict[str, Any]:
    """A report in the order of its keys.

    Args:
        source: the objects `recording`, `settings` and `file_health`.
        windows: the object `fit.windows`.
    """
    return {
        "schema_version": SCHEMA_VERSION,
        "accelcal_version": __version__,
        "recording": source["recording"],
        "settings": source["settings"],
        "outcome": str(verdict.outcome),
        "message": verdict.message,
        "calibration": calibration_json(verdict, optimizer),
        "holdout": None if verdict.holdout is None else holdout_json(verdict.holdout),
        "fit": fit_json(verdict, windows),
        "coverage": coverage_json(verdict.coverage),
        "models_tried": [trial_json(trial) for trial in verdict.trials],
        "file_health": source["file_health"],
    }


def parquet_metadata(data: ReportInput) -> dict[str, Any]:
    """What the Parquet file says of itself: calibration, recording, version."""
    return {
        "accelcal_version": __version__,
        "calibration": data.taken.get("calibration") or calibration_json(data.judgement, data.optimizer),
        "recording": recording_json(data.recording, data.sha256, data.facts),
    }


def recording_json(recording: Recording, sha256: str, facts: Facts) -> dict[str, Any]:
    """The `recording` object."""
    start = facts.first_us if recording.start_us is None else recording.start_us
    known = not any(problem.code == "no_start_time" for problem in facts.problems)
    return {
        "path": printable(recording.path),
        "sha256": sha256,
        "bytes": recording.total_bytes,
        "format": recording.format,
        "device": as_json_device(recording.device),
        "sample_rate_hz": recording.rate_hz,
        "lsb_per_g": recording.lsb_per_g,
        "range_g": recording.range_g,
        "start_time": iso_time(start, facts.utc_offset_s) if known else None,
        "timezone": recording.timezone,
        "samples": facts.samples,
        "duration_s": duration_s(recording, facts),
        "gaps": [_gap(gap, facts.utc_offset_s) for gap in facts.gaps],
        "gaps_omitted": facts.gaps_omitted,
        "notes": notes_json(recording, facts),
    }


def duration_s(recording: Recording, facts: Facts) -> float:
    """From the first sample to one period after the last [s]."""
    if facts.first_us is None or facts.last_us is None:
        return 0.0
    return round((facts.last_us - facts.first_us) / 1e6 + 1 / recording.rate_hz, 6)


def _gap(gap: Gap, offset_s: int | None) -> dict[str, Any]:
    return {
        "sample": gap.sample,
        "start_time": iso_time(gap.start_us, offset_s),
        "seconds": round(gap.seconds, 6),
    }


def _health(data: ReportInput) -> dict[str, Any]:
    facts = data.facts
    return {
        "problems": [problem_json(problem) for problem in facts.problems],
        "filled_samples": facts.filled,
        "clipped_samples_before": facts.clipped,
        "clipped_samples_after": data.clipped_after,
        "rate_hz_measured": None if facts.rate_hz is None else round(facts.rate_hz, 6),
        **damage_json(facts),
        "clock": clock_json(data.recording, facts),
    }


def dumps(report: dict[str, Any], *, pretty: bool) -> str:
    """The report as JSON text."""
    return json.dumps(report, indent=2 if pretty else None, allow_nan=False, ensure_ascii=False)


@cache
def report_schema() -> dict[str, Any]:
    """The JSON Schema of the report."""
    from importlib import resources  # only what is there already is held against it

    text = resources.files("accelcal_cli.output").joinpath("report.schema.json").read_text("utf-8")
    schema: dict[str, Any] = json.loads(text)
    return schema


def load(path: Path) -> dict[str, Any] | None:
    """A JSON file that accelcal wrote, or None where the file is anything else."""
    try:
        if not path.is_file() or path.stat().st_size > LARGEST_BYTES:
            return None
        report = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return report if isinstance(report, dict) and "accelcal_version" in report else None


def load_report(path: Path) -> dict[str, Any] | None:
    """A report of ours that says whose it is, or None where the file is anything else."""
    report, needed = load(path), ("path", "sha256", "bytes")
    if report is None:
        return None
    known = report_schema()["properties"]["recording"]["properties"]
    asked = {"type": "object", "required": needed, "properties": {name: known[name] for name in needed}}
    return report if fault(report.get("recording"), asked) is None else None
