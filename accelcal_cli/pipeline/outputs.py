"""A job's outputs: whose the existing ones are, whether they are up to date, and reports with provenance.

The provenance (who made a result, when, with what) is the one part of a report that may differ between runs.
"""

from __future__ import annotations

import contextlib
import json
import platform
import sys
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

from accelcal_cli import __version__
from accelcal_cli.core.errors import OutputError, printable
from accelcal_cli.core.recording import Recording
from accelcal_cli.output.files import exists, metadata_of, refuse_foreign, write_text, written_by_us
from accelcal_cli.output.report import dumps, fault, load, load_report, report_schema
from accelcal_cli.pipeline.jobs import Job, Request, Result, real, sha256

PACKAGES = ("numpy", "pyarrow", "h5py", "click")
"""Packages whose versions the provenance names."""


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
    refuse_foreign(job.parquet, known=written_by_us(job.parquet))
    refuse_foreign_report(job.report)
    refuse_foreign(job.integers, known=load(job.integers) is not None)


def refuse_foreign_report(path: Path) -> None:
    """Raise OutputError if a file is in the way that is not a report of ours."""
    refuse_foreign(path, known=load_report(path) is not None)


def up_to_date(job: Job, source: Path, recording: Recording, request: Request) -> Result | None:
    """The existing result if it stands for this input, these settings and this version.

    Raises:
        OutputError: the outputs are those of another recording.
    """
    report = load_report(job.report) if exists(job.report) else None
    if report is None:
        return None
    _refuse_other(job, source, report)
    if not _matches(report, recording, request):
        return None
    existing, recorded = Result(job, report, up_to_date=True), report["recording"]
    if existing.has_parquet and not _are_a_pair(report, metadata_of(job.parquet)):
        return None
    if request.integers and report["calibration"] is not None and not exists(job.integers):
        return None
    unchanged = recorded["bytes"] == source.stat().st_size and recorded["sha256"] == sha256(source)
    return existing if unchanged else None


def _matches(report: dict[str, Any], recording: Recording, request: Request) -> bool:
    """Whether a report is whole, of this version, these settings and these coefficients."""
    if report.get("accelcal_version") != __version__ or fault(report, report_schema()) is not None:
        return False
    if "pool" in report:
        return False
    used = report.get("coefficients", {}).get("sha256")
    settings = json_round_trip(request.effective_settings(recording.companion).as_json())
    asked = None if request.coefficients is None else request.coefficients.sha256
    return bool(report["settings"] == settings and used == asked)


def _are_a_pair(report: dict[str, Any], metadata: dict[str, Any]) -> bool:
    """Whether a Parquet file is of a report's recording and calibration; runs side by side may mix them."""
    return all(report[name] == metadata.get(name) for name in ("recording", "calibration"))


def refuse_replaced(path: Path, metadata: dict[str, Any]) -> None:
    """Raise OutputError if another run has put its own Parquet file in the place of ours."""
    if metadata_of(path) != json_round_trip(metadata):
        raise OutputError(
            "was replaced by another run while this one went on", path=path, hint="run it again alone"
        )


def _refuse_other(job: Job, source: Path, report: dict[str, Any]) -> None:
    """Raise OutputError if a report stands for another recording, neither moved nor changed."""
    recorded = report["recording"]
    if real(Path(recorded["path"])) in {real(Path(printable(path))) for path in (job.source, source)}:
        return
    if recorded["sha256"] != sha256(source):
        raise OutputError(
            f"is the report of another recording ({recorded['path']})",
            path=job.report,
            hint="choose another folder with -d, a name with -o, or use --force to replace it",
        )


def json_round_trip(value: dict[str, Any]) -> Any:
    """A value as it comes back from JSON."""
    return json.loads(json.dumps(value))


def remove_stale_parquet(path: Path, metadata: dict[str, Any]) -> None:
    """Remove a Parquet file of ours that was not made by this calibration; leave foreign files.

    Raises:
        OutputError: it cannot be removed.
    """
    if written_by_us(path) and metadata_of(path) != json_round_trip(metadata):
        remove(path)


def remove(path: Path) -> None:
    """Remove an earlier result of ours that no longer holds.

    Raises:
        OutputError: it cannot be removed.
    """
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"cannot be removed ({error.strerror or error})", path=path) from error


def provenance(command: list[str]) -> dict[str, Any]:
    """The `provenance` object of a report."""
    return {
        "command": [printable(word) for word in command],
        "versions": dict(_versions()),
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "host": platform.node(),
        "platform": f"{sys.platform} {platform.machine()}",
    }


@cache
def _versions() -> tuple[tuple[str, str], ...]:
    from importlib.metadata import PackageNotFoundError, version  # only writing a report needs it

    versions = [("python", platform.python_version())]
    for name in PACKAGES:
        with contextlib.suppress(PackageNotFoundError):
            versions.append((name, version(name)))
    return tuple(versions)


def with_provenance(report: dict[str, Any], command: tuple[str, ...]) -> dict[str, Any]:
    """The report, and who made it when."""
    return {**report, "provenance": provenance(list(command))}


def save_report(path: Path, report: dict[str, Any]) -> None:
    """Write a report; it appears complete or not at all.

    Raises:
        OutputError: the file cannot be written.
    """
    write_text(path, dumps(report, pretty=True) + "\n")
