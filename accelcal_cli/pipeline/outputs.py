"""A job's outputs: whose the existing ones are, whether they are up to date, and reports with provenance.

The provenance (who made a result, when, with what) is the one part of a report that may differ between runs.
"""

from __future__ import annotations

import contextlib
import json
import platform
import re
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

from accelcal_cli.core.declared import as_json
from accelcal_cli.core.errors import OutputError, printable
from accelcal_cli.core.input_files import files_of, size_of
from accelcal_cli.core.paths import is_there
from accelcal_cli.core.recording import Recording
from accelcal_cli.core.settings import SIX_POSE, VARIED, PoseSettings
from accelcal_cli.core.version import __version__
from accelcal_cli.formats import ignored_options
from accelcal_cli.output.files import exists, is_page, metadata_of, refuse_foreign, write_text, written_by_us
from accelcal_cli.output.report import dumps, file_name
from accelcal_cli.output.report_reading import (
    fault,
    file_place,
    load_our_json,
    load_report,
    report_schema,
    section,
    sensor_of,
)
from accelcal_cli.output.sections import Provenance
from accelcal_cli.output.windows import is_window_table
from accelcal_cli.pipeline.jobs import (
    PARQUET_SUFFIX,
    UNCALIBRATED_SUFFIX,
    Job,
    Request,
    Result,
    resolved_path,
    sha256,
)

PACKAGES = ("numpy", "pyarrow", "h5py", "click")
"""Packages whose versions the provenance names."""

CALIBRATE, APPLY = "calibrate", "apply"
"""Commands that, like SIX_POSE, do not replace each other's results; a study counts as `calibrate`."""

ESCAPED = re.compile("[\\\\\ufffd]")
"""Characters that `printable` puts into a name in place of others."""

PARTS = ("sensor", "columns")
"""Reading options that choose one of several recordings in a file."""


def prepare(job: Job, windows: tuple[Path, ...] = (), *, force: bool) -> None:
    """Make the output folders, and refuse to overwrite what accelcal did not write.

    Args:
        windows: tables of still windows that are asked for.

    Raises:
        OutputError: a folder cannot be made, or a foreign file is in the way.
    """
    for folder in sorted({path.parent for path in (job.parquet, job.report, *windows)}):
        make_folder(folder)
    if force:
        return
    for path in (job.parquet, job.uncalibrated):
        refuse_foreign(path, known=written_by_us(path))
    refuse_foreign_report(job.report)
    for path in (job.integers, job.draws, job.quality):
        refuse_foreign(path, known=load_our_json(path) is not None)
    for path in windows:
        refuse_foreign(path, known=written_by_us(path) or is_window_table(path))


def make_folder(folder: Path) -> None:
    """Make a folder for results; raises OutputError if that is not possible."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"cannot be made ({error.strerror or error})", path=folder, hint="choose another folder with -d"
        ) from error


def refuse_foreign_report(path: Path) -> None:
    """Raise OutputError if a file is in the way that is not a report of ours."""
    refuse_foreign(path, known=load_report(path) is not None)


def refuse_report_of_another(path: Path, source: Path) -> None:
    """Raise OutputError if a file is in the way that is not a report of ours, or that of another
    recording."""
    refuse_foreign_report(path)
    if (report := load_report(path)) is not None:
        _refuse_other(Job(source, path, path), source, report)


LACKING = "unreadable_part"
"""Code of a problem that may be gone the next time: the disk may have kept a part from being read."""


def up_to_date(job: Job, source: Path, recording: Recording, request: Request) -> Result | None:
    """Return the existing result if it was made of this input, with these settings and this version.

    In a study it names its recording, too: one that was replaced may have the bytes of another suffix.

    Raises:
        OutputError: the outputs are those of another recording, or a good result of another command.
    """
    report = load_report(job.report) if exists(job.report) else None
    if report is None:
        return None
    if not (request.may_replace_result_of_deleted and _was_replaced(report, job)):
        _refuse_other(job, source, report)
    if not _matches(report, recording, request):
        _refuse_replacing(job, source, report, request)
        return None
    kept = keeps(report["calibration"] is not None, request)
    existing = Result(job, report, up_to_date=True, kept=kept)
    if existing.parquet is not None and not _are_a_pair(report, metadata_of(existing.parquet)):
        return None
    if report["calibration"] is not None and _lacks(job, report, request):
        return None
    if any(problem["code"] == LACKING for problem in report["file_health"]["problems"]):
        return None
    renamed = request.may_replace_result_of_deleted and report["recording"]["path"] != file_name(job.source)
    return existing if not renamed and _is_of(report, source) else None


def _lacks(job: Job, report: dict[str, Any], request: Request) -> bool:
    """Return True if integers or draws that are asked for are not there, or are of another calibration."""
    if request.integers and not exists(job.integers):
        return True
    if not request.draws:
        return False
    held = load_our_json(job.draws) or {}
    same = all(held.get(name) == report[name] for name in ("accelcal_version", "calibration"))
    return not same or held.get("asked_for") != request.draws


def keeps(calibrated: bool, request: Request) -> bool:
    """Return True if raw values are asked for and the recording is not calibrated."""
    return request.keep_refused and not request.report_only and not calibrated


def _matches(report: dict[str, Any], recording: Recording, request: Request) -> bool:
    """Return True if a report is whole, of this version, these settings and these coefficients."""
    if report.get("accelcal_version") != __version__ or fault(report, report_schema()) is not None:
        return False
    if "pool" in report:
        return False
    used = report.get("coefficients", {}).get("sha256")
    settings = json_round_trip(request.effective_settings(recording.companion).as_json())
    asked = None if request.coefficients is None else request.coefficients.sha256
    return bool(_as_asked(report["settings"]) == _as_asked(settings) and used == asked)


def _as_asked(settings: dict[str, Any]) -> dict[str, Any]:
    """Return a report's settings without the rule of stillness if that was not asked for, but found."""
    found = VARIED if settings.get("other_stillness") else ()
    return {name: value for name, value in settings.items() if name not in found}


def _are_a_pair(report: dict[str, Any], metadata: dict[str, Any]) -> bool:
    """Return True if a Parquet file has a report's recording and calibration; parallel runs may mix them."""
    return all(report[name] == metadata.get(name) for name in ("recording", "calibration"))


def _refuse_other(job: Job, source: Path, report: dict[str, Any]) -> None:
    """Raise OutputError if a report stands for another recording, neither moved nor changed.

    What came from memory or standard input has no place: only its bytes tell.
    """
    recorded = report["recording"]
    if place_of_report(report) == resolved_path(Path(printable(source))):
        return
    if recorded["sha256"] != sha256(source):
        raise OutputError(
            f"is the report of another recording ({_said_place(report)})",
            path=job.report,
            hint="choose another folder with -d, a name with -o, or use --force to replace it",
        )


def _was_replaced(report: dict[str, Any], job: Job) -> bool:
    """Return True if the recording of a report is gone, and another file of its folder has its outputs."""
    place = place_of_report(report)
    return place.parent == resolved_path(job.source).parent and not is_there(place)


def missing_source_of(report: dict[str, Any]) -> Path | None:
    """Return where the recording of a report was if it is gone; None if it is there or nobody can tell.

    A path is looked for from the working folder of then and from that of now. Nothing is known about standard
    input, or about a name that the report has escaped.

    Raises:
        UnreadableError: a folder of parts cannot be listed.
    """
    said = file_place(report, "recording") or _said_place(report)
    place = resolved_path(Path(said))
    if said == "-" or ESCAPED.search(place.relative_to(place.anchor).as_posix()):
        return None
    there = any(is_there(one) or files_of(one) for one in (place, place_of_report(report)))
    return None if there else place


def place_of_report(report: dict[str, Any]) -> Path:
    """Return where the recording of a report was."""
    return resolved_path(Path(_said_place(report)))


def _said_place(report: dict[str, Any]) -> str:
    then = section(report, "provenance", "files").get("recording")
    return then if isinstance(then, str) else str(report["recording"]["path"])


def _is_of(report: dict[str, Any], source: Path) -> bool:
    """Return True if a report is of these very bytes."""
    recorded = report["recording"]
    return bool(recorded["bytes"] == size_of(source) and recorded["sha256"] == sha256(source))


def _refuse_replacing(job: Job, source: Path, report: dict[str, Any], request: Request) -> None:
    """Raise OutputError if a good result of the recording as it is would give way to one that is none such.

    A result of the same command and the same part of the file gives way: it was asked for again.
    """
    then, now = _made_by(report), CALIBRATE if request.coefficients is None else APPLY
    if isinstance(request.settings, PoseSettings):
        now = SIX_POSE
    parts = [name for name in PARTS if _part(report, name) != json_round_trip(getattr(request.options, name))]
    what = f"accelcal {then}" if then != now else " and ".join(_words(report, name) for name in parts)
    if report.get("calibration") is not None and what and _is_of(report, source):
        raise OutputError(
            f"holds the result of {what} for this recording",
            path=job.report,
            hint="choose another folder with -d, a name with -o, or use --force to replace it",
        )


def _part(report: dict[str, Any], name: str) -> Any:
    ignored = name in ignored_options(str(report["recording"]["format"]))
    return None if ignored else section(report, "settings", "input").get(name)


def _words(report: dict[str, Any], name: str) -> str:
    given = _part(report, name)
    text = ",".join(map(str, given)) if isinstance(given, list) else str(given)
    return f"a run without --{name}" if given is None else f"a run with --{name} {printable(text)}"


def _made_by(report: dict[str, Any]) -> str:
    """Return the command that wrote a report."""
    if section(report, "settings").get("profile") == SIX_POSE:
        return SIX_POSE
    used = section(report, "coefficients")
    return APPLY if used and not used.get("without_provenance") else CALIBRATE


def applied_by_hand(job: Job, source: Path) -> Result | None:
    """Return the whole result of `apply` at a job's paths, if it is of the recording as it is now."""
    report = load_report(job.report) if exists(job.report) else None
    if report is None or _made_by(report) != APPLY or fault(report, report_schema()) is not None:
        return None
    result = Result(job, report, up_to_date=True)
    if report["calibration"] is None or not _is_of(report, source):
        return None
    whole = not result.has_parquet or _are_a_pair(report, metadata_of(job.parquet))
    return result if whole else None


def json_round_trip(value: Any) -> Any:
    """Return a value as it comes back from JSON."""
    return json.loads(json.dumps(value))


def withdraw(job: Job, sensor: str | None = None) -> None:
    """Remove the outputs of a job whose results now have another name, if they are its recording's own.

    Args:
        sensor: that it is now of; a result that was made of one by hand stays.

    Raises:
        OutputError: one cannot be removed.
    """
    report = load_report(job.report) if exists(job.report) else None
    if report is None or _made_by(report) != CALIBRATE or (sensor is not None and sensor_of(report)):
        return
    if place_of_report(report) == resolved_path(Path(printable(job.source))):
        remove_all(job)


def remove_all(job: Job) -> None:
    """Remove what accelcal wrote of a recording, the report last; raises OutputError if that fails."""
    for path in (job.parquet, job.uncalibrated):
        if written_by_us(path):
            remove(path)
    for path in (job.integers, job.draws, job.quality):
        remove_ours(path)
    remove_page(job.page)
    remove(job.report)


def is_own_result(path: Path) -> bool:
    """Return True for a file that accelcal wrote, by name and content; False for what cannot be read."""
    try:
        if path.name.endswith((PARQUET_SUFFIX, UNCALIBRATED_SUFFIX)) or path.name == "study.parquet":
            return written_by_us(path) or path.name == "study.parquet"
        if path.suffix == ".json":
            return load_our_json(path) is not None
        return is_page(path) if path.suffix == ".html" else False
    except OutputError:
        return False


def remove_stale_parquet(path: Path, metadata: dict[str, Any]) -> None:
    """Remove a Parquet file if it is ours and not of this calibration; raises OutputError if that fails."""
    if written_by_us(path) and metadata_of(path) != json_round_trip(metadata):
        remove(path)


def remove_ours(path: Path) -> None:
    """Remove a JSON file that no longer holds if it is ours; raises OutputError if that fails."""
    if load_our_json(path) is not None:
        remove(path)


def remove_page(path: Path) -> None:
    """Remove a page whose report no longer holds if it is ours; raises OutputError if that fails."""
    if is_page(path):
        remove(path)


def remove(path: Path) -> None:
    """Remove an earlier result of ours that no longer holds; raises OutputError if that fails."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"cannot be removed ({error.strerror or error})", path=path) from error


def provenance(command: Sequence[str], files: dict[str, str] | None = None) -> Provenance:
    """Return the section `provenance` of a report."""
    return Provenance(
        command=[printable(word) for word in command],
        versions=dict(_versions()),
        time=datetime.now(UTC).isoformat(timespec="seconds"),
        host=platform.node(),
        platform=f"{sys.platform} {platform.machine()}",
        files=files,
    )


@cache
def _versions() -> tuple[tuple[str, str], ...]:
    from importlib.metadata import PackageNotFoundError, version  # only writing a report needs it

    versions = [("accelcal", __version__), ("python", platform.python_version())]
    for name in PACKAGES:
        with contextlib.suppress(PackageNotFoundError):
            versions.append((name, version(name)))
    return tuple(versions)


def with_provenance(report: dict[str, Any], command: tuple[str, ...], **files: Path | None) -> dict[str, Any]:
    """Return the report with its provenance.

    Args:
        files: what it was made of, by name, as typed in the working folder; the report itself has no folders.
    """
    where = {name: printable(path) for name, path in files.items() if path is not None}
    seen_from = where | {"folder": printable(resolved_path(Path()))} if where else None
    return {**report, "provenance": as_json(provenance(command, seen_from))}


def save_report(path: Path, report: dict[str, Any]) -> None:
    """Write a report, which appears complete or not at all; raises OutputError if that fails."""
    write_text(path, dumps(report, pretty=True) + "\n")
