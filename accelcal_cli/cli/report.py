"""`accelcal report`: pages for people, made of the files that other commands wrote."""

from __future__ import annotations

from pathlib import Path

import click

from accelcal_cli.cli import exit_codes
from accelcal_cli.cli.options import FILE
from accelcal_cli.core.errors import AccelcalError, UsageError, printable
from accelcal_cli.output.files import is_page, refuse_foreign, write_text
from accelcal_cli.output.report import ours
from accelcal_cli.output.report_reading import check_sections, document_bytes, read_document
from accelcal_cli.output.report_schema import report_schema
from accelcal_cli.pipeline.jobs import (
    PAGE_SUFFIX,
    QUALITY_SUFFIX,
    REPORT_SUFFIX,
    Job,
    real,
    refuse_dash,
    refuse_overwriting,
)
from accelcal_cli.pipeline.outputs import make_folder

Places = list[tuple[Path, Path]]
"""Reports, and where the page of each goes."""


@click.command("report")
@click.argument("reports", nargs=-1, required=True, type=FILE)
@click.option("-d", "--output-dir", type=FILE, help="Folder for the pages; otherwise beside each report.")
@click.option("--force", is_flag=True, help="Overwrite files that accelcal did not write.")
@click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors on stderr.")
def command(reports: tuple[Path, ...], output_dir: Path | None, force: bool, quiet: bool) -> int:
    """Make a page of each REPORT (STEM.calibration.json), with figures from STEM.quality.json beside it.

    A page is one HTML file that needs nothing else: it can be read in any browser, printed and mailed.
    Prints the path of each page, a line each. REPORT may also be the folder that `study` wrote into: then
    its study.html, and a page of each recording, are made where they changed.
    """
    refuse_dash(output_dir)
    if len(reports) == 1 and reports[0].is_dir():
        return _study(reports[0], output_dir, force=force, quiet=quiet)
    return exit_codes.of_all([_one(*place, force, quiet) for place in _places(reports, output_dir)])


def _study(out: Path, output_dir: Path | None, *, force: bool, quiet: bool) -> int:
    """The pages of a study, in its own folder."""
    from accelcal_cli.cli import report_study  # it needs jinja2 and pandas

    if output_dir is not None:
        raise UsageError("the pages of a study lie in its own folder", path=out, hint="omit -d")
    made = report_study.make_pages(out, force=force)
    if not quiet:
        exit_codes.say(report_study.summary(made))
    return report_study.told(made)


def _one(report: Path, page: Path, force: bool, quiet: bool) -> int:
    """Make one page; a failure is printed and does not stop the rest."""
    try:
        make_folder(page.parent)
        refuse_foreign_page(page, force=force)
        write_page(report, page)
    except AccelcalError as error:
        return exit_codes.of_failure(error)
    except Exception:
        return exit_codes.report_bug(report)
    if not quiet:
        exit_codes.show(printable(page))
    return exit_codes.OK


def _places(reports: tuple[Path, ...], folder: Path | None) -> Places:
    """Where the pages go; raises UsageError if two would go to the same place."""
    places: Places = []
    owners: dict[Path, Path] = {}
    for report in reports:
        if report.is_dir():
            raise UsageError("is a folder", path=report, hint="give it alone, or name reports")
        page = _beside(report, PAGE_SUFFIX)
        page = page if folder is None else folder / page.name
        if real(page) in owners:
            other = owners[real(page)]
            raise UsageError(f"{other} and {report} would both write {page}", hint="make them one by one")
        owners[real(page)] = report
        places.append((report, page))
    return places


def _beside(report: Path, suffix: str) -> Path:
    """A file of the report's stem."""
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


def write_page(report: Path, page: Path, *, kept: bool = False) -> bool:
    """Make the page of a report from the files alone; returns whether it was made.

    Args:
        kept: a page that is what it would be now is left as it is.

    Raises:
        UnreadableError: the report, or what lies beside it, cannot be read; or the report is damaged.
        OutputError: the page cannot be written.
    """
    from accelcal_cli.pages import stamp

    beside = _beside(report, QUALITY_SUFFIX)
    held = [document_bytes(one) if one.is_file() else b"" for one in (report, beside)]
    made_of = stamp.made_of(*held)
    if kept and stamp.stamp_of(page) == made_of:
        return False
    from accelcal_cli.pages import recording  # jinja2 is needed for pages only

    document = read_document(report)
    check_sections(document, tuple(report_schema()["properties"]))
    quality = (ours(held[1]) or {}) if beside.exists() else None
    write_text(page, stamp.stamped(recording.page(document.report, quality), made_of))
    return True
