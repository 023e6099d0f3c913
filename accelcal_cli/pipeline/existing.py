"""Outputs that are there already: whose they are, and whether they still hold."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from accelcal_cli import __version__
from accelcal_cli.core.errors import OutputError
from accelcal_cli.output.parquet import refuse_foreign
from accelcal_cli.output.report import load
from accelcal_cli.pipeline.identity import sha256
from accelcal_cli.pipeline.plan import Job
from accelcal_cli.pipeline.request import Request, Result


def prepare(job: Job, *, force: bool) -> None:
    """Make the output folders, and refuse to overwrite what accelcal did not write.

    Raises:
        OutputError: a folder cannot be made, or a foreign file is in the way.
    """
    for folder in sorted({job.parquet.parent, job.report.parent}):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(
                f"cannot be made ({error.strerror or error})",
                path=folder,
                hint="choose another folder with -d",
            ) from error
    if force:
        return
    refuse_foreign(job.parquet)
    for path in (job.report, job.integers):
        if path.exists() and load(path) is None:
            raise OutputError(
                "exists and was not written by accelcal",
                path=path,
                hint="move it away, or use --force to replace it",
            )


def up_to_date(job: Job, source: Path, request: Request) -> Result | None:
    """The existing result if it stands for this input, these settings and this version."""
    report = load(job.report) if job.report.exists() else None
    if report is None or report.get("accelcal_version") != __version__:
        return None
    if report.get("settings") != as_stored(request.effective_settings()):
        return None
    held = Result(job, report, up_to_date=True)
    if held.has_parquet and not job.parquet.exists():
        return None
    if request.integers and report["calibration"] is not None and not job.integers.exists():
        return None
    recorded = report["recording"]
    same = recorded["bytes"] == source.stat().st_size and recorded["sha256"] == sha256(source)
    return held if same else None


def as_stored(value: dict[str, Any]) -> Any:
    """A value as it comes back from JSON."""
    return json.loads(json.dumps(value))


def remove(path: Path) -> None:
    """Remove an earlier result of ours that no longer holds.

    Raises:
        OutputError: it cannot be removed.
    """
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"cannot be removed ({error.strerror or error})", path=path) from error
