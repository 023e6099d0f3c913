"""`accelcal report`: pages of a study's folder."""

from __future__ import annotations

from pathlib import Path

import click

from accelcal_cli.cli import exit_codes
from accelcal_cli.cli.options import FILE


@click.command("report")
@click.argument("out", type=FILE)
@click.option("--force", is_flag=True, help="Also replace pages that accelcal did not make.")
@click.option("-q", "--quiet", is_flag=True, help="Print only what failed.")
def command(out: Path, *, force: bool, quiet: bool) -> int:
    """Make pages to look at of the study in the folder OUT: study.html, and one for each recording.

    Only pages that changed are made.
    """
    from accelcal_cli.cli import report_study

    made = report_study.make_pages(out, force=force)
    if not quiet:
        exit_codes.say(report_study.summary(made))
    return report_study.told(made)
