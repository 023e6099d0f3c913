"""The report of a fit to points from a table: the same keys, nothing that only samples could tell."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from accelcal_cli.core.judgement import Judgement
from accelcal_cli.core.names import printable
from accelcal_cli.core.recording import Device, as_json_device
from accelcal_cli.output.report import document


@dataclass(frozen=True, slots=True)
class PointsInput:
    """All that such a report is made of.

    Attributes:
        rows: rows of the table.
        implausible: rows whose length is nowhere near 1 g.
        raw_error_mg, after_error_mg: mean | |a| - 1 g | over the other rows.
    """

    path: Path
    sha256: str
    bytes: int
    rows: int
    implausible: int
    raw_error_mg: float | None
    after_error_mg: float | None
    settings: dict[str, Any]
    judgement: Judgement
    optimizer: dict[str, Any]


def build_points(data: PointsInput) -> dict[str, Any]:
    """The report without `provenance`."""
    source = {"recording": _recording(data), "settings": data.settings, "file_health": no_health()}
    return document(source, data.judgement, data.optimizer, _windows(data))


def _recording(data: PointsInput) -> dict[str, Any]:
    unknown = ("sample_rate_hz", "lsb_per_g", "range_g", "start_time", "timezone")
    return {
        "path": printable(data.path),
        "sha256": data.sha256,
        "bytes": data.bytes,
        "format": "points",
        "device": as_json_device(Device()),
        **dict.fromkeys(unknown),
        "samples": data.rows,
        "duration_s": None,
        "gaps": [],
        "gaps_omitted": 0,
        "notes": [],
    }


def no_health() -> dict[str, Any]:
    """The object `file_health` where there is no file of samples."""
    return {
        "problems": [],
        "filled_samples": 0,
        "clipped_samples_before": 0,
        "clipped_samples_after": None,
        "rate_hz_measured": None,
        "lost_bytes": 0,
        "lost_percent": 0.0,
        "clock": None,
    }


def _windows(data: PointsInput) -> dict[str, Any]:
    none = ("moving", "filled", "clipped", "recovered", "joined")
    return {
        "complete": data.rows,
        **dict.fromkeys(none, 0),
        "implausible": data.implausible,
        "constant_left_out": 0,
        "used": data.rows - data.implausible,
        "raw_error_mg": None if data.raw_error_mg is None else round(data.raw_error_mg, 4),
        "after_error_mg": None if data.after_error_mg is None else round(data.after_error_mg, 4),
    }
