"""Pages as files: what each is made of, which of them are made again, and where they lie.

A page holds the hash of all that it was made of: report, quality, and what makes pages. One that has the hash
of what is there now is left alone, so that a nightly study writes only what is new.
"""

from __future__ import annotations

import contextlib
import hashlib
import re
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import UnreadableError, printable
from accelcal_cli.core.paths import files_below, is_file, open_found
from accelcal_cli.core.version import __version__
from accelcal_cli.devices import table
from accelcal_cli.devices.review import DeviceReview, review
from accelcal_cli.devices.table import Kind
from accelcal_cli.devices.trends import Rules
from accelcal_cli.output.files import NAME, is_page, read_columns, refuse_foreign, write_text
from accelcal_cli.output.report_reading import (
    check_sections,
    document_bytes,
    load_our_json,
    our_json,
    read_document,
    report_schema,
)
from accelcal_cli.output.sentences import in_words, of_device
from accelcal_cli.pages import recording, study
from accelcal_cli.pages.study_figures import MOST_STRIPS, states_of
from accelcal_cli.pipeline.jobs import PAGE_SUFFIX, QUALITY_SUFFIX, REPORT_SUFFIX, Job, refuse_overwriting

STUDY_PAGE = "study.html"
STAMP = re.compile(r'<meta name="accelcal-made-of" content="([0-9a-f]{64})">')
HEAD_BYTES = 8192
"""Length of the part of a page in which the stamp stands."""
CHARSET = '<meta charset="utf-8">\n'
"""Line of a page that the stamp follows."""


def page_of(report: Path) -> Path:
    """Return where the page of a report goes."""
    return _of_same_stem(report, PAGE_SUFFIX)


def _of_same_stem(report: Path, suffix: str) -> Path:
    stem = report.name.removesuffix(REPORT_SUFFIX)
    return report.with_name((stem if stem != report.name else report.stem) + suffix)


def refuse_foreign_page(page: Path, *, force: bool) -> None:
    """Raise OutputError if a file is in the way that accelcal did not make."""
    if not force:
        refuse_foreign(page, known=is_page(page))


def refuse_page(job: Job, *, force: bool) -> None:
    """Raise an error if a job's page would take the place of its recording, or of somebody else's file."""
    refuse_overwriting((job.page,), (job.source,))
    refuse_foreign_page(job.page, force=force)


def write_page(report: Path, page: Path, *, only_changed: bool = False) -> bool:
    """Make the page of a report from the files alone; return True if it was written.

    Args:
        only_changed: do not write a page that would come out the same.

    Raises:
        UnreadableError: the report, or what lies next to it, cannot be read; or the report is damaged.
        OutputError: the page cannot be written.
    """
    quality = _of_same_stem(report, QUALITY_SUFFIX)
    contents = [document_bytes(one) if is_file(one) else b"" for one in (report, quality)]
    stamp = stamp_for(*contents)
    if only_changed and stamp_of(page) == stamp:
        return False
    document = read_document(report)
    check_sections(document, tuple(report_schema()["properties"]))
    text = recording.page(document.report, (our_json(contents[1]) or {}) if is_file(quality) else None)
    write_text(page, stamped(text, stamp))
    return True


@dataclass(slots=True)
class PagesMade:
    """Result of making the pages of a study.

    Attributes:
        page: path of the study's own page; changed: that page was written.
        made, kept: numbers of recordings whose page was written, and whose page was up to date.
        faults: one message for each recording whose page could not be made.
    """

    page: Path
    changed: bool = False
    made: int = 0
    kept: int = 0
    faults: list[str] = field(default_factory=list)


def write_study_pages(out: Path, *, force: bool = False) -> PagesMade:
    """Make the page of each recording of the study in a folder, where it changed, and then that of the study.

    Args:
        force: also replace pages that accelcal did not make.

    Raises:
        UsageError, UnreadableError: there is no table of a study in the folder, or it cannot be read.
        OutputError: a page cannot be written, or there is a file of its name that is not ours.
    """
    reviewed = review(out, Rules(), time.time())
    rows = read_columns(out / NAME, study.WANTED).to_pylist()
    made = PagesMade(out / STUDY_PAGE)
    reports = _reports(out, rows)
    links = [
        None if report is None else _write_recording_page(out, report, made, force=force)
        for report in reports
    ]
    content = study.StudyContent(
        rows,
        links,
        load_our_json(out / "study.json") or {},
        [_device_line(one) for one in reviewed.devices],
        reviewed.records.nameless,
        reviewed.rules.drift_mg,
        hours=_hours(rows, reports),
        origin=_origin(out, [report for report in reports if report is not None]),
    )
    text = study.page(content)
    stamp = stamp_for(text.encode())
    made.changed = stamp_of(made.page) != stamp
    if made.changed:
        refuse_foreign_page(made.page, force=force)
        write_text(made.page, stamped(text, stamp))
    return made


def _hours(
    rows: Sequence[dict[str, Any]], reports: Sequence[Path | None]
) -> list[tuple[int, tuple[list[str], float]]]:
    """Return the states of the hours of the newest recordings that have NAME.quality.json."""
    dated = [
        (str(row.get("start_time") or ""), at, report)
        for at, (row, report) in enumerate(zip(rows, reports, strict=True))
        if report is not None and not row.get("copy_of")
    ]
    found = []
    for _, at, report in sorted(dated)[-MOST_STRIPS:]:
        states = states_of(load_our_json(_of_same_stem(report, QUALITY_SUFFIX)) or {})
        if states is not None:
            found.append((at, states))
    return found


def _origin(out: Path, reports: Sequence[Path]) -> list[tuple[str, str]]:
    """Return the folder of a study, and the command and time of its newest result."""
    found = [("Results in", out.resolve().name)]
    there = {path: path.stat().st_mtime_ns for path in reports if is_file(path)}
    if there and (report := load_our_json(max(sorted(there), key=there.__getitem__))):
        made = report.get("provenance")
        if isinstance(made, dict):
            command, moment = made.get("command"), made.get("time")
            if isinstance(command, list):
                found.append(("Command", " ".join(map(str, command))[: recording.LONGEST_TEXT]))
            if isinstance(moment, str):
                found.append(("Newest result", moment[:16].replace("T", " ") + " UTC"))
    return found


def _reports(out: Path, rows: Sequence[dict[str, Any]]) -> list[Path | None]:
    """Find each recording's report; None where it has none, or none that is there.

    The table's names are printable: where that is not the name of a file, it is looked for among all.
    """
    expected = [out / row["report"] if row["report"] else None for row in rows]
    if all(path is None or is_file(path) for path in expected):
        return expected
    every = [folder / name for folder, _, names in files_below(out, []) for name in names]
    known = {printable(path.relative_to(out)): path for path in every if path.name.endswith(REPORT_SUFFIX)}
    return [known.get(row["report"]) if row["report"] else None for row in rows]


def page_in_study(report: Path, out: Path) -> Path:
    """Return where the page of a study's recording goes: next to its report, never in place of the
    study's."""
    page = report.with_name(report.name.removesuffix(REPORT_SUFFIX) + PAGE_SUFFIX)
    return page if page != out / STUDY_PAGE else page.with_name(f"study.recording{PAGE_SUFFIX}")


def _write_recording_page(out: Path, report: Path, made: PagesMade, *, force: bool) -> str | None:
    """Make a recording's page if it changed; return its path below OUT, None if it has none."""
    page = page_in_study(report, out)
    refuse_foreign_page(page, force=force)
    try:
        changed = write_page(report, page, only_changed=True)
    except UnreadableError as error:
        made.faults.append(str(error))
        return None
    made.made += changed
    made.kept += not changed
    return page.relative_to(out).as_posix()


def _device_line(device: DeviceReview) -> study.DeviceLine:
    return study.DeviceLine(
        device.key.serial,
        in_words(device.verdict),
        tuple(of_device(one.reason) for one in device.findings),
        device.recordings,
        device.counted(table.Usage.USED, table.Usage.UNDATED),
        device.refused,
        device.begin,
        device.end,
        device.held_out_mg,
        device.fastest_drift(Kind.OFFSET),
        device.fastest_drift(Kind.SCALE, Kind.MISALIGNMENT),
    )


def stamp_for(*parts: bytes) -> str:
    """Return the hash of what a page is made of, and of all that makes pages."""
    return _sha256("".join([_makers(), *map(_sha256, parts)]).encode())


def stamped(text: str, stamp: str) -> str:
    """Put its stamp into a page."""
    return text.replace(CHARSET, f'{CHARSET}<meta name="accelcal-made-of" content="{stamp}">\n', 1)


def stamp_of(page: Path) -> str | None:
    """Return the stamp of a page; None if it has none, or is not there."""
    head = b""
    with contextlib.suppress(OSError, UnreadableError), open_found(page) as file:
        head = file.read(HEAD_BYTES)
    match = STAMP.search(head.decode("utf-8", "replace"))
    return match[1] if match else None


@cache
def _makers() -> str:
    """Hash of the version and of all that makes pages: templates, styles, scripts and code."""
    package = files("accelcal_cli.pages")
    parts = [one for folder in (package, package / "templates") for one in folder.iterdir() if one.is_file()]
    hashes = [one.name + _sha256(one.read_bytes()) for one in sorted(parts, key=lambda one: one.name)]
    return _sha256("\n".join([__version__, *hashes]).encode())


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
