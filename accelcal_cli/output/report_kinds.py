"""Documents with the keys of a recording's report, without what only samples tell.

They are the report of a fit to points from a table, that of a pool of recordings calibrated as one, with
what the reports of its members say about it, and the object that `--json` prints for a recording that failed.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from accelcal_cli.core.declared import as_json, from_json
from accelcal_cli.core.errors import printable
from accelcal_cli.core.identity import REPORT, identity
from accelcal_cli.core.reasons import Reason
from accelcal_cli.core.recording import Recording
from accelcal_cli.core.results import Holdout
from accelcal_cli.output import report as reports
from accelcal_cli.output.advice import completed
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

FORMAT = "pool"
TAKEN = (
    "calibration",
    "without_misalignment",
    "calibration_error_mg",
    "rest_scatter_mg",
    "holdout",
    "fit",
    "coverage",
    "models_tried",
)
"""Sections that a member's report takes from its pool's."""


@dataclass(frozen=True, slots=True)
class PointsInput(reports.JudgedInput):
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
        path=reports.file_name(data.path),
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
    return completed(reports.document(recording, HealthSection(), windows, data), data.judgement)


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
class PoolInput(reports.JudgedInput):
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
    report = completed(reports.document(recording, HealthSection(), data.windows, data), data.judgement)
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
        "recording": recording | {"path": reports.file_name(path)},
        "outcome": "failed",
        "reason": failure_code(exit_code),
        "values": {"path": printable(path), "exit_code": exit_code},
        "message": printable(message),
        **{name: [] for name in ("notes", "cautions", "advice")},
    }
