"""`accelcal report`: pages for people, made of the files that other commands wrote."""

from __future__ import annotations

from pathlib import Path

import click

from accelcal_cli.cli import exit_codes
from accelcal_cli.cli.help import Command
from accelcal_cli.cli.options import FILE
from accelcal_cli.core.errors import AccelcalError, UsageError, counted, printable
from accelcal_cli.core.paths import is_folder
from accelcal_cli.pipeline.jobs import refuse_dash, resolved_path
from accelcal_cli.pipeline.outputs import make_folder


@click.command(
    "report",
    cls=Command,
    examples=(
        "report recording.calibration.json # writes recording.html",
        "report calibrated # pages of a study, for those that changed",
    ),
)
@click.argument("reports", nargs=-1, required=True, type=FILE)
@click.option("-d", "--output-dir", type=FILE, help="Folder for the pages.  [default: next to each report]")
@click.option("--force", is_flag=True, help="Overwrite files that accelcal did not write.")
@click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors on stderr.")
def command(reports: tuple[Path, ...], output_dir: Path | None, force: bool, quiet: bool) -> int:
    """Create an HTML page with figures from each REPORT (NAME.calibration.json).

    A page is one HTML file that any browser shows; it can be printed and mailed. Prints the path of each
    page. REPORT may also be the output folder of `study`: then study.html and the pages of its recordings
    are created where they changed.
    """
    refuse_dash(output_dir)
    if len(reports) == 1 and is_folder(reports[0]):
        if output_dir is not None:
            raise UsageError("the pages of a study lie in its own folder", path=reports[0], hint="omit -d")
        return study_pages(reports[0], force=force, quiet=quiet)
    places = _places(reports, output_dir)
    return exit_codes.of_all([_one_page(report, page, force, quiet) for report, page in places])


def study_pages(out: Path, *, force: bool, quiet: bool) -> int:
    """Make the pages of a study that changed, sum up on stderr, and return the exit code."""
    from accelcal_cli.pages.write import write_study_pages  # it needs jinja2

    made = write_study_pages(out, force=force)
    if not quiet:
        own = "Wrote" if made.changed else "Unchanged:"
        kept = f" ({made.kept} unchanged)" if made.kept else ""
        exit_codes.say(f"{own} {printable(made.page)} and {counted(made.made, 'recording page')}{kept}")
    for fault in made.faults:
        exit_codes.say(fault)
    return exit_codes.SOME_FAILED if made.faults else exit_codes.OK


def _one_page(report: Path, page: Path, force: bool, quiet: bool) -> int:
    """Make one page; a failure is printed and does not stop the rest."""
    from accelcal_cli.pages.write import refuse_foreign_page, write_page

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


def _places(reports: tuple[Path, ...], folder: Path | None) -> list[tuple[Path, Path]]:
    """Pair each report with the place of its page; raises UsageError if two would go to the same place."""
    from accelcal_cli.pages.write import page_of

    places = []
    owners: dict[Path, Path] = {}
    for report in reports:
        if is_folder(report):
            raise UsageError("is a folder", path=report, hint="give it alone, or name reports")
        page = page_of(report)
        page = page if folder is None else folder / page.name
        if resolved_path(page) in owners:
            other = owners[resolved_path(page)]
            raise UsageError(f"{other} and {report} would both write {page}", hint="make them one by one")
        owners[resolved_path(page)] = report
        places.append((report, page))
    return places
