"""`accelcal export`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from accelcal_cli.cli import options
from accelcal_cli.cli.exit_codes import say, show
from accelcal_cli.cli.help import Command
from accelcal_cli.cli.output import progress_bars
from accelcal_cli.core.errors import OutputError, UsageError, counted
from accelcal_cli.exports.rows import WIDEST
from accelcal_cli.output.files import exists, write_text
from accelcal_cli.pipeline.jobs import refuse_nameless, refuse_overwriting

COEFFICIENTS = ("ggir", "biobank", "omconvert", "json")
DATA = ("csv", "npz", "mhealth", "bids", "parquet")


class Width(options.AnyType):
    """Option type: a number of samples, or `auto`, which is 0."""

    name = "samples"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Parse and check."""
        if value == "auto":
            return 0
        return int(click.IntRange(2, WIDEST).convert(value, param, ctx))


@click.command(
    "export",
    cls=Command,
    examples=(
        "export recording.calibration.json --to ggir -o coefficients.csv # for GGIR's backup.cal.coef",
        "export recording.calibrated.parquet --to csv -o recording.csv",
    ),
)
@click.argument("files", nargs=-1, required=True, type=options.FILE)
@click.option("--to", "form", required=True, type=options.OneOf([*COEFFICIENTS, *DATA]),
              help="The tool or the file format.")  # fmt: skip
@click.option("-o", "--output", type=options.FILE, help="The new file. Without it, coefficients are printed.")
@click.option("--resample", "resample_hz", type=options.Positive(100_000), metavar="HZ",
              help="Resample to HZ within each gap-free stretch.")  # fmt: skip
@click.option("--smooth", type=Width(), metavar="auto|N",
              help="Rolling mean of N samples; auto: 3, 5, 10 or 20, by the rate.")  # fmt: skip
@click.option(
    "--measured-only",
    is_flag=True,
    help="Leave out rows that the device filled in while it slept, and those of damaged blocks.",
)
@click.option("--force", is_flag=True, help="Replace files that are there.")
@click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors on stderr.")
def command(files: tuple[Path, ...], **values: Any) -> None:
    """Export coefficients or calibrated data to other tools.

    From reports (NAME.calibration.json), exports coefficients: ggir, biobank, omconvert or json. These tools
    cannot use misalignment, so a fit without it is exported, and a message gives the loss of accuracy. From
    one NAME.calibrated.parquet, exports the data: csv, npz, mhealth, bids, or (smoothed, resampled) parquet.
    """
    if values["form"] in COEFFICIENTS:
        _coefficients(files, values)
    else:
        _data(files, values)


def _coefficients(files: tuple[Path, ...], values: dict[str, Any]) -> None:
    form, output = values["form"], values["output"]
    for name in ("resample_hz", "measured_only", "smooth"):
        if values[name] is not None and values[name] is not False:
            option = f"--{name.removesuffix('_hz').replace('_', '-')}"
            raise UsageError(f"{option} is for data (--to {', '.join(DATA)})", hint="omit it")
    if output is not None:
        _refuse((output,), files, force=values["force"])
    text = _text(form, files, quiet=values["quiet"])
    if output is None:
        show(text.rstrip("\n"))
    else:
        write_text(output, text)


def _text(form: str, files: tuple[Path, ...], *, quiet: bool) -> str:
    from accelcal_cli.exports import coefficients

    if form == "json":
        return "".join(coefficients.as_json(path) + "\n" for path in files)
    read_exported = [coefficients.read_exported(path) for path in files]
    for one in read_exported:
        for sentence in (coefficients.cost(one), coefficients.temperature_note(one, form)):
            if sentence is not None and not quiet:
                say(f"{one.path}: {sentence}")
    if form == "ggir":
        return coefficients.ggir(read_exported)
    return "".join(coefficients.LINES[form](one) + "\n" for one in read_exported)


def _data(files: tuple[Path, ...], values: dict[str, Any]) -> None:
    from accelcal_cli.exports.data import ExportOptions, export_data, outputs_of

    form, output = values["form"], values["output"]
    if len(files) > 1:
        raise UsageError("data are exported from one file at a time", hint="name one calibrated Parquet file")
    if output is None:
        raise UsageError(f"--to {form} writes a file, which needs a name", hint="give one with -o")
    _refuse(outputs_of(form, output), files, force=values["force"])
    wanted = ExportOptions(output, values["resample_hz"], values["measured_only"], values["smooth"])
    with progress_bars(files[0].name, quiet=values["quiet"], unit="") as bars:
        written = export_data(form, files[0], wanted, bars)
    if not values["quiet"]:
        about = written.about
        zone = "UTC" if about.utc and form != "mhealth" else "of the device's clock"
        limits = "" if about.range_g is None else f", range -{about.range_g:g} to {about.range_g:g} g"
        gaps = counted(written.stretches - 1, "gap")
        rows = f"{counted(written.rows, 'row')} at {about.rate_hz:g} Hz with {gaps}"
        means = "" if about.smoothed is None else f", a rolling mean of {about.smoothed} samples"
        say(f"{output}: {rows}{means}, times {zone}{limits}")


def _refuse(outputs: tuple[Path, ...], inputs: tuple[Path, ...], *, force: bool) -> None:
    """Raise UsageError for an output that is an input, OutputError for one that is there already."""
    for path in outputs:
        refuse_nameless(path)
        refuse_overwriting((path,), inputs)
        if exists(path) and not force:
            raise OutputError("is there already", path=path, hint="use --force to replace it")
