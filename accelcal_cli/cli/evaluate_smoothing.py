"""`accelcal evaluate smoothing`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from accelcal_cli.cli import exit_codes, options
from accelcal_cli.cli.output import aligned, each_recording
from accelcal_cli.core.errors import printable
from accelcal_cli.evaluate.smoothing import TABLE_1, Smoothing, as_json, smoothing
from accelcal_cli.pipeline import given
from accelcal_cli.pipeline.jobs import ProgressMaker

HEAD = ("samples", "rolling mean", "of raw", "rolling median", "of raw", "")
PUBLISHED = ("Table 1 of Grammenos et al. 2018 (own recording)", "rolling mean", "rolling median")


@click.command("smoothing")
@click.argument("recordings", nargs=-1, required=True, type=options.FILE)
@click.option("--json", "as_json_", is_flag=True, help="Print one JSON object per line.")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
@options.reading_options
@options.comparing_options
def command(recordings: tuple[Path, ...], **values: Any) -> int:
    """Show how much smaller a rolling mean or median makes the noise of each RECORDING at rest.

    Variances of samples within still windows [g2], without a filter and with those of Grammenos et al. 2018,
    and which width they have for the recording's rate. Nothing that accelcal calibrates is filtered.
    """

    def work(path: Path, bars: ProgressMaker) -> Smoothing:
        settings, chunk = given.settings(values), values["chunk_samples"]
        return smoothing(path, given.read_options(values), settings, chunk, bars)

    found, code = each_recording(recordings, work, quiet=values["quiet"])
    if found and values["as_json_"]:
        lines = [json.dumps({"recording": printable(one.path), **as_json(one)}) for one in found]
        exit_codes.show("\n".join(lines))
    elif found:
        exit_codes.show("\n\n".join([*map(_text, found), _published()]))
    return code


def _text(one: Smoothing) -> str:
    head = f"{printable(one.path)}: {one.windows} still windows at {one.rate_hz:g} Hz, raw {one.raw:.3e} g2"
    rows = [
        [
            str(made.width),
            *(
                cell
                for value in (made.mean, made.median)
                for cell in (f"{value:.3e}", _share(value, one.raw))
            ),
            "for this rate" if made.width == one.usual else "",
        ]
        for made in one.filtered
    ]
    return f"{head}\n{aligned(HEAD, rows)}"


def _share(value: float, raw: float) -> str:
    return f"{100 * value / raw:.0f} %" if raw else "-"


def _published() -> str:
    rows = [[str(width), f"{mean:.3e}", f"{median:.3e}"] for width, (mean, median) in TABLE_1.items()]
    return aligned(PUBLISHED, rows)
