"""`accelcal verify`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from accelcal_cli.cli import exit_codes
from accelcal_cli.cli.help import Command
from accelcal_cli.cli.options import FILE, chunk_option
from accelcal_cli.cli.output import progress_bars
from accelcal_cli.core.errors import printable
from accelcal_cli.core.version import __version__

if TYPE_CHECKING:
    from accelcal_cli.verify import ParquetCheck, Verified

DIFFERS = 1
SHOWN_KEYS = 5


@click.command(
    "verify",
    cls=Command,
    examples=(
        "verify recording.calibration.json",
        "verify recording.calibration.json recording.cwa --values # also every value of the Parquet file",
    ),
)
@click.argument("report", type=FILE)
@click.argument("recording", required=False, type=FILE)
@click.option("--values", is_flag=True,
              help="Also compare every value of the Parquet file next to the report.")  # fmt: skip
@click.option("--layout", type=FILE, help="Layout file of a raw dump, if not next to the recording.")
@click.option("--poses", type=FILE, help="List of poses of a session, if not next to the recording.")
@click.option("--coefficients", type=FILE,
              help="Coefficient file that a report of `apply` used, if it has moved.")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object.")
@click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors on stderr.")
@chunk_option
def command(report: Path, recording: Path | None, **values: Any) -> int:
    """Reproduce REPORT from its RECORDING and compare the two bit for bit; nothing is written.

    Without RECORDING, takes the one that the report names, next to the report or where it was. Uses the
    settings and reading options of the report. Prints one tab-separated line: path, `identical` or
    `differs`, the largest and the mean difference of calibrated vectors in mg, the version that wrote the
    report, this version, and the keys that differ. The exit code is 1 if anything differs.
    """
    # with pyarrow, which --help does not need
    from accelcal_cli.verify import VerifyOptions, as_json, recording_of, verify

    recording = recording or recording_of(report)
    names = ("layout", "poses", "coefficients", "values", "chunk_samples")
    options = VerifyOptions(**{name: values[name] for name in names})
    with progress_bars(recording.name, quiet=values["quiet"]) as bars:
        verified = verify(report, recording, options, bars)
    text = json.dumps(as_json(report, recording, verified)) if values["as_json"] else line(report, verified)
    exit_codes.show(text)
    if not values["quiet"]:
        _comment(report, verified)
    return exit_codes.OK if verified.identical else DIFFERS


def line(report: Path, verified: Verified) -> str:
    """Write the result in tab-separated fields; `-` for an empty one."""
    from accelcal_cli.verify import word

    keys = verified.all_differing
    shown, more = ", ".join(keys[:SHOWN_KEYS]), len(keys) - SHOWN_KEYS
    fields = [
        printable(report),
        word(verified.identical),
        *("-" if value is None else f"{value:g}" for value in (verified.largest_mg, verified.mean_mg)),
        verified.made_by,
        __version__,
        (f"{shown} and {more} more" if more > 0 else shown) or "-",
    ]
    return "\t".join(printable(field) if field else "-" for field in fields)


def _comment(report: Path, verified: Verified) -> None:
    """Say on stderr what was assumed, and how the Parquet file compares."""
    name = printable(report)
    if verified.missing:
        missing = ", ".join(verified.missing)
        exit_codes.say(f"{name}: does not state {missing}; this version's defaults were used")
    if verified.unknown:
        exit_codes.say(f"{name}: states {', '.join(verified.unknown)}, which this version does not know")
    if verified.parquet is not None:
        exit_codes.say(f"{printable(verified.parquet.path)}: {_parquet_comment(verified.parquet)}")


def _parquet_comment(check: ParquetCheck) -> str:
    if check.differs:
        return f"its metadata differ from the report in {', '.join(check.differs[:SHOWN_KEYS])}"
    if check.values is None:
        return "carries the calibration of the report; its values were not compared (use --values)"
    if check.values.first_row is None:
        return f"carries the calibration of the report, and all {check.values.rows} rows are identical"
    return f"column {check.values.column} differs from row {check.values.first_row} on (counted from 0)"
