"""`accelcal export`."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from accelcal_cli.cli import options
from accelcal_cli.cli.exit_codes import OK, SOME_FAILED, of_all, of_failure, say, show
from accelcal_cli.cli.help import AnyType, Command
from accelcal_cli.cli.output import progress_bars
from accelcal_cli.core.errors import AccelcalError, UsageError, counted, printable
from accelcal_cli.core.paths import is_folder
from accelcal_cli.core.system import cpus
from accelcal_cli.exports.rows import WIDEST
from accelcal_cli.exports.selection import COEFFICIENTS, FORMS, check_form, refuse_other_kind, refuse_outputs
from accelcal_cli.output.files import write_text
from accelcal_cli.pipeline.jobs import PARQUET_SUFFIX, refuse_dash

if TYPE_CHECKING:
    from accelcal_cli.exports.data import ExportedData, ExportOptions
    from accelcal_cli.exports.folder import Made
    from accelcal_cli.exports.selection import Selected

VALUES = ("gzip", "jobs", "resample", "smooth", "measured_only")
"""Options that not every form has."""


class Width(AnyType):
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
        "export calibrated --to ggir -d for-ggir # a study, with a script that runs GGIR",
        "export recording.calibrated.parquet --to csv -o recording.csv",
    ),
)
@click.argument("files", nargs=-1, required=True, type=options.FILE)
@click.option("--to", "form", required=True, type=options.OneOf(FORMS),
              help="The tool or the file format.")  # fmt: skip
@click.option("-o", "--output", type=options.FILE, help="The new file. Without it, coefficients are printed.")
@click.option("-d", "--output-dir", type=options.FILE,
              help="Folder for the calibrated data of all recordings, with a script.")  # fmt: skip
@click.option("--gzip", is_flag=True, help="With -d, compress the tables (.csv.gz).")
@click.option("-j", "--jobs", type=click.IntRange(1, 64), metavar="N",
              help="With -d, number of recordings at a time.  [default: one for each CPU]")  # fmt: skip
@click.option("--resample", type=options.Positive(100_000), metavar="HZ",
              help="Resample to HZ within each gap-free stretch.")  # fmt: skip
@click.option("--smooth", type=Width(), metavar="auto|N",
              help="Rolling mean of N samples; auto: 3, 5, 10 or 20, by the rate.")  # fmt: skip
@click.option(
    "--measured-only",
    is_flag=True,
    help="Leave out rows that the device filled in while it slept, and those of damaged blocks.",
)
@click.option("--force", is_flag=True, help="Replace existing files.")
@click.option(
    "-q",
    "--quiet",
    is_flag=True,
    help="On stderr print only errors, skipped recordings, and coefficients over the limit.",
)
def command(files: tuple[Path, ...], **values: Any) -> int:
    """Export coefficients or calibrated data to other tools.

    With -d DIR, exports the calibrated data of all recordings given by FILES: output folders of
    `study`, study.json, reports (NAME.calibration.json), calibrated Parquet files, or patterns in quotes.
    For ggir, biobank, actipy and skdh, DIR also gets a script that runs the tool. Prints one line for each
    file. Recordings that were refused are skipped, and named on stderr.

    Without -d, exports coefficients from reports: ggir, biobank, omconvert or json. These tools
    cannot use misalignment, so a fit without it is exported, and a message gives the loss of accuracy. From
    one NAME.calibrated.parquet, exports the data: csv, npz, mhealth, bids, or (smoothed, resampled) parquet.
    """
    into_folder = values["output_dir"] is not None
    if into_folder:
        refuse_dash(values["output_dir"])
        if values["output"] is not None:
            raise UsageError("-o names one file, and -d a folder", hint="give one of them")
    check_form(values["form"], {name: values[name] for name in VALUES}, folder=into_folder)
    if into_folder:
        return _folder(files, values)
    if values["form"] in COEFFICIENTS:
        return _coefficients(files, values)
    return _data(files, values)


def _coefficients(files: tuple[Path, ...], values: dict[str, Any]) -> int:
    from accelcal_cli.exports import coefficients
    from accelcal_cli.exports.selection import select

    form, output = values["form"], values["output"]
    for path in files:
        refuse_other_kind(path, form)
    if output is not None:
        refuse_outputs((output,), files, force=values["force"])
    done, codes = _each(select(files, data=False), coefficients.read_for(form))
    for one in done if form != "json" else ():
        notes = () if values["quiet"] else (coefficients.cost(one), coefficients.temperature_note(one, form))
        for text in filter(None, (*notes, coefficients.over_limit(one))):
            say(f"{one.path}: {text}")
    text = coefficients.TABLES[form](done)
    if output is None:
        show(text.rstrip("\n")) if done else None
    elif done:
        write_text(output, text)
    return of_all(codes)


def _each(reports: list[Selected], read: Callable[[Path], Any]) -> tuple[list[Any], list[int]]:
    """Read each report; what cannot be exported is said, and does not stop the rest."""
    done, codes = [], []
    for one in reports:
        if one.skipped is not None or one.report is None:
            say(f"{printable(one.path)}: {one.skipped}; skipped")
            codes.append(SOME_FAILED)
            continue
        try:
            done.append(read(one.report))
            codes.append(OK)
        except AccelcalError as error:
            codes.append(of_failure(error))
    return done, codes


def _folder(files: tuple[Path, ...], values: dict[str, Any]) -> int:
    """Export many recordings into a folder."""
    from accelcal_cli.exports import folder
    from accelcal_cli.exports.data import ExportOptions
    from accelcal_cli.exports.selection import select

    form, out, quiet = values["form"], values["output_dir"], values["quiet"]
    wanted = ExportOptions(out, values["resample"], values["measured_only"], values["smooth"], values["gzip"])
    selected = select(files, data=True)
    planned = folder.plan(form, selected, wanted, force=values["force"])
    made = []
    with progress_bars(str(out), quiet=quiet, unit="") as bars:
        shown = bars("recordings", len(planned))
        for one in folder.export_folder(form, planned, wanted, values["jobs"] or cpus()):
            made.append(one)
            shown(len(made))
            if one.error is not None:
                say(f"{one.error}; skipped")
            elif one.written is not None:
                show(printable(one.planned.output))
                if not quiet:
                    say(_about(one.planned.output, form, one.written))
    return _end_folder(form, selected, made, wanted, quiet=quiet)


def _end_folder(
    form: str, selected: list[Selected], made: list[Made], wanted: ExportOptions, *, quiet: bool
) -> int:
    """Say what was skipped, write script and coefficients, and sum up."""
    from accelcal_cli.exports import folder

    for one in selected:
        if one.skipped is not None:
            say(f"{printable(one.path)}: {one.skipped}; skipped")
    number = sum(one.written is not None for one in made)
    if not number:
        return SOME_FAILED
    for message in folder.write_coefficients(form, made, wanted.output):
        say(message)
    script = folder.write_script(form, made, wanted)
    if not quiet:
        what = f"{number} of {counted(len(selected), 'recording')} exported to {printable(wanted.output)}"
        how = "" if script is None else f"; next: {folder.RUN_BY[script.suffix]} {printable(script)}"
        say(f"{what}{how}")
    return OK if number == len(selected) else SOME_FAILED


def _data(files: tuple[Path, ...], values: dict[str, Any]) -> int:
    from accelcal_cli.exports.data import ExportOptions, export_file
    from accelcal_cli.exports.folder import SUFFIXES

    form, output = values["form"], values["output"]
    if len(files) > 1 or is_folder(files[0]):
        raise UsageError("several recordings need a folder", hint="name one with -d instead of -o")
    refuse_other_kind(files[0], form)
    if output is None:
        name = files[0].name.removesuffix(PARQUET_SUFFIX) + SUFFIXES.get(form, ".csv")
        own = form in ("mhealth", "bids")  # whose names follow rules
        hint = "give one with -o" if own else f"add -o {shlex.quote(printable(name))}"
        raise UsageError(f"--to {form} writes a file, which needs a name", hint=hint)
    wanted = ExportOptions(output, values["resample"], values["measured_only"], values["smooth"])
    with progress_bars(files[0].name, quiet=values["quiet"], unit="") as bars:
        written = export_file(form, files[0], wanted, bars, force=values["force"])
    if not values["quiet"]:
        say(_about(output, form, written))
    return OK


def _about(output: Path, form: str, written: ExportedData) -> str:
    """Return in a sentence what was written."""
    about = written.about
    zone = "UTC" if about.utc and form not in ("mhealth", "biobank") else "of the device's clock"
    limits = "" if about.range_g is None else f", range -{about.range_g:g} to {about.range_g:g} g"
    gaps = counted(written.stretches - 1, "gap")
    rows = f"{counted(written.rows, 'row')} at {about.rate_hz:g} Hz with {gaps}"
    means = "" if about.smoothed is None else f", a rolling mean of {about.smoothed} samples"
    return f"{output}: {rows}{means}, times {zone}{limits}"
