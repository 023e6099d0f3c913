"""Finds the recordings that paths stand for: reports, calibrated files, folders of studies, patterns."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import (
    AccelcalError,
    OutputError,
    UnreadableError,
    UsageError,
    did_you_mean,
    printable,
)
from accelcal_cli.core.input_files import is_pattern, matching
from accelcal_cli.core.paths import files_below, is_file, is_folder
from accelcal_cli.core.results import Outcome
from accelcal_cli.exports.coefficients import NO_RECORDING
from accelcal_cli.output import decisions
from accelcal_cli.output.files import NAME as TABLE
from accelcal_cli.output.files import exists, read_columns
from accelcal_cli.output.report_reading import check_sections, read_document
from accelcal_cli.output.sentences import begun_small
from accelcal_cli.pipeline.jobs import (
    PARQUET_SUFFIX,
    REPORT_SUFFIX,
    parquet_of,
    refuse_nameless,
    refuse_overwriting,
    report_of,
)

# The forms of an export, which options go with each, and files that are never replaced unasked.

COEFFICIENTS = ("ggir", "biobank", "omconvert", "json")
DATA = ("csv", "npz", "mhealth", "bids", "parquet")
FOLDERS = ("ggir", "biobank", "actipy", "skdh", "csv", "npz", "mhealth", "parquet")
"""Forms of which a folder of recordings can be made."""

FORMS = tuple(dict.fromkeys((*COEFFICIENTS, "actipy", "skdh", *DATA)))


def check_form(form: str, options: Mapping[str, Any], *, folder: bool) -> None:
    """Raise UsageError if there is no such form, or an option does not go with it.

    Args:
        options: those that were given, by name; others are None or False.
        folder: a folder of recordings is wanted.
    """
    if form not in FORMS:
        meant = did_you_mean(form, FORMS)
        raise UsageError(f"there is no form {form!r}", hint=meant or f"choose one of {', '.join(FORMS)}")
    if folder:
        if form not in FOLDERS:
            hint = f"choose one of {', '.join(FOLDERS)}, or a file with -o"
            raise UsageError(f"--to {form} writes no folder of recordings", hint=hint)
        return
    for name, value in options.items():
        if value is None or value is False:
            continue
        if name in ("gzip", "jobs"):
            hint = "name one with -d, or omit it"
            raise UsageError(f"--{name} is for a folder of recordings", hint=hint)
        if form in COEFFICIENTS:
            option = f"--{name.replace('_', '-')}"
            raise UsageError(f"{option} is for data (--to {', '.join(DATA)})", hint="omit it")


def refuse_other_kind(path: Path, form: str) -> None:
    """Raise UsageError for data where a report is needed, or the other way round, naming the other file."""
    kinds = [(PARQUET_SUFFIX, "calibrated data"), (REPORT_SUFFIX, "a report")]
    (suffix, needed), (given, _) = kinds[::-1] if form in COEFFICIENTS else kinds
    if path.name.endswith(given):
        other = shlex.quote(printable(path.with_name(path.name.removesuffix(given) + suffix)))
        raise UsageError(f"--to {form} needs {needed}", path=path, hint=f"give {other} instead")


def refuse_outputs(outputs: Iterable[Path], inputs: Sequence[Path], *, force: bool) -> None:
    """Raise UsageError for an output that is an input, OutputError for one that is there already."""
    for path in outputs:
        refuse_nameless(path)
        refuse_overwriting((path,), inputs)
        if not force:
            refuse_existing([path])


def refuse_existing(outputs: Iterable[Path]) -> None:
    """Raise OutputError for an output that is there already."""
    for path in outputs:
        if exists(path):
            raise OutputError("is there already", path=path, hint="use --force to replace it")


# Finds the recordings that paths stand for.

SUMMARY = "study.json"
SECTIONS = ("recording", "outcome", "message", "file_health")


@dataclass(frozen=True, slots=True)
class Selected:
    """A recording to export.

    Attributes:
        path: what stands for it in messages.
        report, parquet: None where it has none.
        held: the content of its report.
        skipped: why it cannot be exported, None if it can.
    """

    path: Path
    report: Path | None = None
    parquet: Path | None = None
    held: dict[str, Any] | None = None
    skipped: str | None = None


def select(inputs: Iterable[Path], *, data: bool) -> list[Selected]:
    """Return the recordings that paths stand for, in their order; each once if data are wanted.

    Args:
        data: calibrated files are wanted; else reports.

    Raises:
        UsageError: a pattern or a folder has none.
    """
    found: list[Selected] = []
    known: dict[Path, dict[str, str]] = {}
    for path in inputs:
        there = list(_of(path, data=data))
        if not there:
            hint = f"name the output folder of a study, or reports ({REPORT_SUFFIX})"
            raise UsageError("holds no reports of recordings", path=path, hint=hint)
        for one in there:
            why = why_excluded(one.report or one.parquet, known)
            found.append(one if why is None else Selected(one.path, one.report, skipped=why))
    once = {(one.report or one.parquet or one.path).absolute(): one for one in found}
    return list(once.values()) if data else found


def why_excluded(path: Path | None, known: dict[Path, dict[str, str]]) -> str | None:
    """Return why people excluded a recording from the study that it belongs to; None if they did not.

    Args:
        path: its report or its calibrated file; None for one that failed.
        known: receives why the recordings of a study are excluded, by its folder and their reports.
    """
    if path is None:
        return None
    report = (path if path.name.endswith(REPORT_SUFFIX) else report_of(path)).absolute()
    folder = next((one for one in report.parents if is_file(one / TABLE)), None)
    if folder is None:
        return None
    if folder not in known:
        rows = read_columns(folder / TABLE, ("report", *decisions.READ)).to_pylist()
        why, reports = decisions.excluded(folder, rows), {row["path"]: row["report"] for row in rows}
        known[folder] = {reports[one]: begun_small(text).removesuffix(".") for one, text in why.items()}
    return known[folder].get(printable(report.relative_to(folder)))


def _of(path: Path, *, data: bool) -> Iterator[Selected]:
    if is_folder(path) or (path.name == SUMMARY and is_file(path.with_name(TABLE))):
        yield from _of_folder(path if is_folder(path) else path.parent, data=data)
    elif is_pattern(path):
        reports = sorted(one for one in matching(path) if one.name.endswith((REPORT_SUFFIX, PARQUET_SUFFIX)))
        if not reports:
            raise UsageError("matches no report", path=path, hint=f"reports are named NAME{REPORT_SUFFIX}")
        for one in reports:
            yield from _of(one, data=data)
    elif data and path.suffix == ".parquet":
        report = report_of(path)
        yield of_report(report, path) if is_file(report) else Selected(path, parquet=path)
    else:
        yield of_report(path) if data else Selected(path, path)


def _of_folder(folder: Path, *, data: bool) -> Iterator[Selected]:
    """Yield a study's recordings: those of its table where there is one, or all whose reports lie there."""
    table = folder / TABLE
    is_study = is_file(table)
    rows = read_columns(table, ("report", "message", "path")).to_pylist() if is_study else []
    names = {row["report"] for row in rows}
    for report in _reports_below(folder):
        if not is_study or printable(report.relative_to(folder)) in names:
            one = of_report(report)
            if not data and one.held is not None and one.held["outcome"] != Outcome.REFUSED:
                one = Selected(report, report, held=one.held)  # its calibrated file does not matter
            if (one.held or {}).get("recording", {}).get("format") not in NO_RECORDING:
                yield one
    for row in rows:
        if not row["report"]:
            yield Selected(Path(row["path"]), skipped=f"failed ({row['message']})")


def _reports_below(folder: Path) -> list[Path]:
    faults: list[OSError] = []
    found = [
        place / name
        for place, _, names in files_below(folder, faults)
        for name in names
        if name.endswith(REPORT_SUFFIX)
    ]
    for error in faults:
        why, hint = f"cannot be read ({error.strerror or error})", "check its permissions and its disk"
        raise UnreadableError(why, path=error.filename or folder, hint=hint) from error
    return sorted(found)


def of_report(report: Path, parquet: Path | None = None) -> Selected:
    """Return the recording of a report, with the calibrated file next to it."""
    try:
        document = read_document(report)
        check_sections(document, SECTIONS)
    except AccelcalError as error:
        return Selected(report, report, skipped=str(error).removeprefix(f"{printable(report)}: "))
    held, parquet = document.report, parquet or parquet_of(report)
    why = None
    if held["outcome"] == Outcome.REFUSED:
        why = f"refused: {held['message'].rstrip('.')}"
    elif parquet is None:
        name = os.path.basename(held["recording"]["path"])  # noqa: PTH119 (printed as it is)
        why = f"there is no calibrated Parquet file next to it: calibrate {name} without --report-only"
    return Selected(report, report, parquet, held, why)
