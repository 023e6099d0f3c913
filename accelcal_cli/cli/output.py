"""What commands print: result lines, tables, CSV, progress and comments; and the loop over recordings."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

from accelcal_cli.cli import exit_codes
from accelcal_cli.core.errors import AccelcalError, UsageError, printable
from accelcal_cli.core.results import Outcome
from accelcal_cli.output.report import sphere_columns
from accelcal_cli.pipeline.jobs import STDIN, Job, Progress, ProgressMaker, Result, no_progress, spooled

WORDS = {
    Outcome.CALIBRATED: "calibrated",
    Outcome.REDUCED_MODEL: "calibrated in part",
    Outcome.ALREADY_GOOD: "good as it is",
    Outcome.BORROWED: "calibrated with another recording's coefficients",
}
"""Outcomes for people, where their names are no words."""


def aligned(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Columns as wide as their widest cell, the first to the left and the others to the right."""
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
    lines = [_line(row, widths) for row in (head, ["-" * width for width in widths], *rows)]
    return "\n".join(lines)


def _line(row: Sequence[str], widths: list[int]) -> str:
    first, *rest = zip(row, widths, strict=True)
    return "  ".join([first[0].ljust(first[1]), *(cell.rjust(width) for cell, width in rest)]).rstrip()


def figure(value: float | None, digits: int = 3) -> str:
    """A cell of so many significant digits, `-` for none."""
    if value is None:
        return "-"
    return f"{value:.0f}" if abs(value) >= 10**digits else f"{value:#.{digits}g}".rstrip(".")


def number(value: float | None, form: str) -> str:
    """A cell of a number in a format, `-` for none."""
    return "-" if value is None else format(value, form)


def show_result(report: dict[str, Any], source: Path, written: Path | None, values: dict[str, Any]) -> None:
    """Print the line of one recording's report; see `show_row`."""
    holdout, calibration = report["holdout"] or {}, report["calibration"] or {}
    before, after = (holdout.get(f"{when}_mg", {}).get("mean") for when in ("before", "after"))
    low, high = holdout.get("ci95_mg", (None, None))
    row = {"outcome": report["outcome"], "model": calibration.get("model"), "before_mg": before}
    judged = {
        "after_mg": after,
        "ci95_low_mg": low,
        "ci95_high_mg": high,
        "improvement_percent": holdout.get("improvement_percent"),
        **sphere_columns(report),
    }
    show_row(row | (judged if calibration else dict.fromkeys(judged)), source, written, values)


def show_row(row: dict[str, Any], source: Path, written: Path | None, values: dict[str, Any]) -> None:
    """Print one recording's row of a study's summary: a sentence at a terminal, else fields.

    Args:
        written: its output, if there is one.
        values: the option `tsv`: fields at a terminal, too.
    """
    words = sys.stdout.isatty() and not values["tsv"]
    exit_codes.show((_sentence if words else _fields)(row, source, written))


def _fields(row: dict[str, Any], source: Path, written: Path | None) -> str:
    """Path, outcome, model, errors before and after [mg], improvement [%], output; `-` for nothing."""
    fields = [
        str(source),
        row["outcome"],
        row["model"] or "-",
        *(number(row[name], ".3f") for name in ("before_mg", "after_mg")),
        number(row["improvement_percent"], ".0f"),
        "-" if written is None else str(written),
    ]
    return "\t".join(map(printable, fields))


def _sentence(row: dict[str, Any], source: Path, written: Path | None) -> str:
    """What became of a recording, and how certain the error is that was left."""
    parts = [f"{source}: {WORDS.get(row['outcome'], row['outcome'])}"]
    before, after, high = row["before_mg"], row["after_mg"], row["ci95_high_mg"]
    sphere = row.get("sphere_mg")
    if row["model"] is not None:
        parts[0] += f" (model {row['model']})"
    if after is not None and sphere is not None:
        shown = f"{figure(row['sphere_low_mg'])} to {figure(row['sphere_high_mg'])}"
        parts.append(f"{figure(before)} mg before, {figure(after)} mg after on postures left out of the fit")
        parts.append(f"{figure(sphere)} mg over the whole sphere (95 % interval {shown})")
        high, before = row["sphere_high_mg"], row["sphere_before_mg"]
    elif after is not None:
        low = figure(row["ci95_low_mg"])
        parts.append(
            f"{figure(before)} mg before, {figure(after)} mg after (95 % interval {low} to {figure(high)})"
        )
    if after is None:
        parts += [f"the raw data are off by {figure(before)} mg"] * (before is not None)
    elif high >= before and row["outcome"] != Outcome.ALREADY_GOOD:
        parts.append(f"this may be no better than the raw data, whose {figure(before)} mg lie within it")
    if written is not None:
        parts.append(f"written to {written}")
    return printable("; ".join(parts))


@contextlib.contextmanager
def progress_bars(label: str, *, quiet: bool, unit: str = "B") -> Iterator[ProgressMaker]:
    """A maker of bars for the stages of one recording; each replaces the one before."""
    if quiet or sys.stderr is None or not sys.stderr.isatty():
        yield no_progress
        return
    from tqdm import tqdm

    name = printable(label)
    with contextlib.ExitStack() as stack:

        def make(stage: str, total: int) -> Progress:
            stack.close()
            bar = tqdm(
                total=total, desc=f"{name} {stage}", unit=unit, unit_scale=True, leave=False, file=sys.stderr
            )
            stack.callback(bar.close)
            return lambda done: bar.update(min(done, total) - bar.n) and None

        yield make


Found = TypeVar("Found")


def each_recording(
    recordings: Sequence[Path], work: Callable[[Path, ProgressMaker], Found], *, quiet: bool
) -> tuple[list[Found], int]:
    """What comes of every recording that can be read, and the exit code; a failure is printed."""
    results, failed = [], 0
    for path in recordings:
        try:
            with progress_bars(path.name, quiet=quiet) as bars:
                results.append(work(path, bars))
        except AccelcalError as error:
            failed = exit_codes.of_failure(error)
    return results, exit_codes.SOME_FAILED if failed and len(recordings) > 1 else failed


def refuse_both(*, as_json: bool, as_csv: bool) -> None:
    """Raise UsageError if JSON and CSV are asked for."""
    if as_json and as_csv:
        raise UsageError("--json and --csv cannot be combined", hint="give one of them")


Work = Callable[[Job, ProgressMaker, Path], Result]
"""Makes one recording's result; the path is where its bytes are."""


def parquet_of(result: Result) -> Path | None:
    """The Parquet file of a result, if it has one."""
    return result.parquet


def run_jobs(
    jobs: list[Job], work: Work, values: dict[str, Any], written: Callable[[Result], Path | None] = parquet_of
) -> int:
    """Do every job and print its result; returns the exit code of all.

    Args:
        values: the options `quiet`, `verbose` and `as_json`.
        written: the output that a result's line names.
    """
    return exit_codes.of_all([_one(job, work, values, written) for job in jobs])


def _one(job: Job, work: Work, values: dict[str, Any], written: Callable[[Result], Path | None]) -> int:
    """Do one job; a failure is printed and does not stop the rest."""
    try:
        with bytes_of(job.source) as source, progress_bars(job.source.name, quiet=values["quiet"]) as bars:
            result = work(job, bars, source)
    except AccelcalError as error:
        return exit_codes.of_failure(error)
    except Exception:
        return exit_codes.report_bug(job.source)
    if values["as_json"]:
        exit_codes.show(json.dumps(result.report))
    else:
        show_result(result.report, result.job.source, written(result), values)
    _comment(result, values)
    return exit_codes.REFUSED if result.outcome is Outcome.REFUSED else exit_codes.OK


@contextlib.contextmanager
def bytes_of(recording: Path) -> Iterator[Path]:
    """Where a recording's bytes are: itself, or a copy of standard input, which errors call `-`.

    Raises:
        UsageError: there is no standard input.
    """
    if recording != STDIN:
        yield recording
        return
    if sys.stdin is None:
        raise UsageError("standard input is closed", hint="give the name of a file")
    with spooled(sys.stdin.buffer) as copy:
        try:
            yield copy
        except AccelcalError as error:
            error.path = STDIN if error.path == copy else error.path
            raise


def _comment(result: Result, values: dict[str, Any]) -> None:
    report, name = result.report, printable(result.job.source)
    if result.outcome is Outcome.REFUSED:
        exit_codes.say(f"{name}: refused: {report['message']}")
    if result.outcome is Outcome.BORROWED:
        from accelcal_cli.pipeline.apply import warning

        if (caution := warning(report)) is not None:
            exit_codes.say(f"{name}: {caution}")
    if values["quiet"]:
        return
    if result.up_to_date:
        exit_codes.say(f"{name}: up to date")
    problems = report["file_health"]["problems"]
    for problem in problems if values["verbose"] else problems[:1]:
        omitted = 0 if values["verbose"] else len(problems) - 1
        more = f" (and {omitted} more; see the report)" if omitted else ""
        exit_codes.say(f"{name}: {problem['code']}: {problem['message']}{more}")
    if values["verbose"]:
        exit_codes.say(f"{name}: {report['message']}")
        for trial in report["models_tried"]:
            after_mg = trial["after_mg"]
            error = trial["reason"] if after_mg is None else f"{after_mg:.3f} mg held out"
            prior = " with the prior" if "prior" in trial else ""
            exit_codes.say(f"{name}: model {trial['model']}{prior}: {error}")
