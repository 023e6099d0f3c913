"""The pages of a study's folder: `study.html`, and one for each recording, made again where they changed.

A page holds the hash of all that it was made of: report, quality, and what makes pages. One that has the hash
of what is there now is left alone, so that a nightly study writes only what is new.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from accelcal_cli.cli import exit_codes
from accelcal_cli.cli.report import refuse_foreign_page, write_page
from accelcal_cli.core.errors import UnreadableError, counted, printable
from accelcal_cli.devices import table
from accelcal_cli.devices.review import DeviceReview, review
from accelcal_cli.devices.table import Kind
from accelcal_cli.devices.trends import Rules
from accelcal_cli.output.files import write_text
from accelcal_cli.output.report import load
from accelcal_cli.pages import stamp, study
from accelcal_cli.pages.study_figures import Drift
from accelcal_cli.pipeline.jobs import PAGE_SUFFIX, REPORT_SUFFIX

NAME = "study.html"


@dataclass(slots=True)
class PagesMade:
    """What became of the pages of a study.

    Attributes:
        page: that of the study itself; changed: whether it was written.
        made, kept: pages of recordings that were written, and that were as they would be now.
        faults: why pages could not be made, by recording.
    """

    page: Path
    changed: bool = False
    made: int = 0
    kept: int = 0
    faults: list[str] = field(default_factory=list)


def make_pages(out: Path, *, force: bool = False) -> PagesMade:
    """The page of each recording of the study in a folder, where it changed, and then that of the study.

    Args:
        force: also replace pages that accelcal did not make.

    Raises:
        UsageError, UnreadableError: there is no table of a study in the folder, or it cannot be read.
        OutputError: a page cannot be written, or there is a file of its name that is not ours.
    """
    reviewed = review(out, Rules(), time.time())
    rows = _rows(out / table.NAME)
    made = PagesMade(out / NAME)
    reports = _reports(out, rows)
    addresses = [None if report is None else _make(out, report, made, force=force) for report in reports]
    content = study.StudyContent(
        rows,
        addresses,
        load(out / "study.json") or {},
        [_device(one) for one in reviewed.devices],
        reviewed.records.nameless,
        reviewed.rules.drift_mg,
    )
    text = study.page(content)
    made_of = stamp.made_of(text.encode())
    made.changed = stamp.stamp_of(made.page) != made_of
    if made.changed:
        refuse_foreign_page(made.page, force=force)
        write_text(made.page, stamp.stamped(text, made_of))
    return made


def told(made: PagesMade) -> int:
    """Say on stderr which pages could not be made; returns the exit code."""
    for fault in made.faults:
        exit_codes.say(fault)
    return exit_codes.SOME_FAILED if made.faults else exit_codes.OK


def summary(made: PagesMade) -> str:
    """One line about all of it."""
    own = "" if made.changed else " (unchanged)"
    pages = f"{counted(made.made, 'page')} of recordings made, {made.kept} unchanged"
    return f"{printable(made.page)}{own}; {pages}"


def _rows(path: Path) -> list[dict[str, Any]]:
    """The columns that the page shows, recording by recording; None where an earlier version had none."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with path.open("rb") as source, pq.ParquetFile(source, pre_buffer=False) as file:
            there = [name for name in study.WANTED if name in file.schema_arrow.names]
            found: list[dict[str, Any]] = file.read(columns=there, use_threads=False).to_pylist()
    except (pa.ArrowException, OSError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise UnreadableError(f"cannot be read ({reason})", path=path, hint="run the study again") from error
    return [dict.fromkeys(study.WANTED) | row for row in found]


def _reports(out: Path, rows: Sequence[dict[str, Any]]) -> list[Path | None]:
    """Each recording's report; None where it has none, or none that is there.

    The table's names are printable: where that is not the name of a file, it is looked for among all.
    """
    named = [out / row["report"] if row["report"] else None for row in rows]
    if all(path is None or path.is_file() for path in named):
        return named
    known = {printable(path.relative_to(out)): path for path in _all_reports(out)}
    return [known.get(row["report"]) if row["report"] else None for row in rows]


def _all_reports(out: Path) -> Iterator[Path]:
    for folder, _, names in os.walk(out):
        yield from (Path(folder, name) for name in names if name.endswith(REPORT_SUFFIX))


def page_of(report: Path, out: Path) -> Path:
    """Where the page of a recording goes: beside its report, but not where that of the study is."""
    page = report.with_name(report.name.removesuffix(REPORT_SUFFIX) + PAGE_SUFFIX)
    return page if page != out / NAME else page.with_name(f"study.recording{PAGE_SUFFIX}")


def _make(out: Path, report: Path, made: PagesMade, *, force: bool) -> str | None:
    """Make a recording's page if it changed; returns its path below OUT, None if it has none."""
    page = page_of(report, out)
    refuse_foreign_page(page, force=force)
    try:
        changed = write_page(report, page, kept=True)
    except UnreadableError as error:
        made.faults.append(str(error))
        return None
    made.made += changed
    made.kept += not changed
    return page.relative_to(out).as_posix()


def _device(one: DeviceReview) -> study.DeviceLine:
    key = one.key
    return study.DeviceLine(
        key.serial,
        str(one.verdict),
        tuple(reason.text.replace(" +- ", " ± ") for reason in one.reasons),
        one.recordings,
        one.counted(table.Usage.USED, table.Usage.UNDATED),
        one.refused,
        one.begin,
        one.end,
        one.held_out_mg,
        _fastest(one, Kind.OFFSET),
        _fastest(one, Kind.SCALE, Kind.MISALIGNMENT),
    )


def _fastest(device: DeviceReview, *kinds: Kind) -> Drift | None:
    """The fastest drift of some kinds of parameters."""
    drifts = [one.drift for one in device.trends if one.drift is not None and one.parameter.kind in kinds]
    fastest = max(drifts, key=lambda drift: abs(drift.per_month), default=None)
    return None if fastest is None else Drift(fastest.per_month, fastest.error, fastest.significant)
