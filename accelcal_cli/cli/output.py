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
from accelcal_cli.output import advice
from accelcal_cli.output.report import sphere_columns
from accelcal_cli.pipeline.jobs import STDIN, Job, Progress, ProgressMaker, Result, no_progress, spooled

WORDS = {
    Outcome.CALIBRATED: "calibrated",
    Outcome.REDUCED_MODEL: "calibrated in part",
    Outcome.ALREADY_GOOD: "good as it is",
    Outcome.BORROWED: "calibrated with another recording's coefficients",
}
"""Outcomes for people, where their names are no words."""

NUMBERS = {"3": "three", "6": "six", "9": "nine", "12": "twelve"}
"""Parameters of models."""


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
    """Print the line of one recording's report, see `show_row`; at a terminal also what to be aware of."""
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
    row |= {"message": report["message"]} | (judged if calibration else dict.fromkeys(judged))
    quiet = values.get("quiet", False)
    show_row(row, source, written, values, () if quiet else _remarks(report))


def _remarks(report: dict[str, Any]) -> tuple[str, ...]:
    """What to be aware of in a result, and what to do about a refusal."""
    if report["outcome"] == Outcome.REFUSED:
        return tuple(f"What to do: {one}" for one in advice.ways_on(report))
    found = (*advice.cautions(report), *filter(None, (advice.unchecked(report),)))
    return tuple(f"Caution: {one}" for one in found)


def show_row(
    row: dict[str, Any],
    source: Path,
    written: Path | None,
    values: dict[str, Any],
    remarks: Sequence[str] | None = None,
) -> None:
    """Print one recording's row of a study's summary: a sentence at a terminal, else fields.

    Args:
        written: its output, if there is one.
        values: the option `tsv`: fields at a terminal, too; and `verbose`: the remarks on stderr then.
        remarks: sentences to follow; None: what the row itself tells.
    """
    if remarks is None:
        remarks = [f"Caution: {one}" for one in _doubts(row)]
    if _in_words(values):
        exit_codes.show("\n".join([_sentence(row, source, written), *(f"  {one}" for one in remarks)]))
        return
    exit_codes.show(_fields(row, source, written))
    for one in remarks if values.get("verbose") else ():
        exit_codes.say(f"{printable(source)}: {one}")


def _in_words(values: dict[str, Any]) -> bool:
    """Whether results are told in sentences."""
    return sys.stdout.isatty() and not values["tsv"] and not values.get("as_json")


def say_refused(message: str, source: Path, values: dict[str, Any], *, shown: bool = True) -> None:
    """Say why a recording was refused, unless the same terminal shows it already.

    Args:
        shown: whether the recording's line was printed.
    """
    if not (shown and _in_words(values) and sys.stderr is not None and sys.stderr.isatty()):
        exit_codes.say(f"{printable(source)}: refused: {message}")


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
    outcome, before, after = row["outcome"], row["before_mg"], row["after_mg"]
    told = f"{source}: {WORDS.get(outcome, outcome)}"
    parts = []
    if row["model"] is not None and outcome != Outcome.ALREADY_GOOD:
        parameters = _parameters(row["model"])
        told += f" ({parameters})" if outcome == Outcome.BORROWED else f" with {parameters}"
    if outcome == Outcome.REFUSED and row.get("message"):
        parts.append(row["message"])
    elif after is not None:
        parts += _errors(row)
    elif before is not None:
        parts.append(f"the raw data are off by {_mg(before)} mg")
    if written is not None:
        parts.append(f"written to {written}")
    return printable(": ".join(filter(None, (told, "; ".join(parts)))))


def _errors(row: dict[str, Any]) -> list[str]:
    """Errors before and after [mg], and the interval of the one to quote."""
    before, after, sphere = row["before_mg"], row["after_mg"], row.get("sphere_mg")
    held_out = "on its own still windows" if row["outcome"] == Outcome.BORROWED else "held out"
    change = f"{_mg(after)} mg" if after == before else f"{_mg(before)} -> {_mg(after)} mg"
    if sphere is None:
        return [f"{change} {held_out}, 95 % {_mg(row['ci95_low_mg'])}-{_mg(row['ci95_high_mg'])}"]
    interval = f"95 % {_mg(row['sphere_low_mg'])}-{_mg(row['sphere_high_mg'])}"
    return [f"{change} {held_out}", f"{_mg(sphere)} mg over the whole sphere, {interval}"]


def _mg(value: float | None) -> str:
    """A number of three digits, without zeros at its end."""
    return "-" if value is None else f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def _parameters(model: str) -> str:
    """A model for people: `nine parameters and temperature`."""
    number_of = NUMBERS.get(model.removesuffix("T"))
    if number_of is None:
        return f"model {model}"
    return f"{number_of} parameters{' and temperature' if model.endswith('T') else ''}"


def _doubts(row: dict[str, Any]) -> list[str]:
    """What the interval of a row says against it."""
    if row["outcome"] == Outcome.REFUSED:
        return []
    sphere = row.get("sphere_mg") is not None
    high = row.get("sphere_high_mg" if sphere else "ci95_high_mg")
    good = row["outcome"] == Outcome.ALREADY_GOOD
    before = None if good else row.get("sphere_before_mg" if sphere else "before_mg")
    return advice.doubts(high, before, everywhere=sphere)


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


def _caution(result: Result, values: dict[str, Any]) -> str | None:
    """What even a quiet run says against a result, unless it is said with the result itself."""
    if result.outcome is Outcome.BORROWED:
        from accelcal_cli.pipeline.apply import warning

        return warning(result.report)
    with_it = (_in_words(values) or values["verbose"]) and not (values["quiet"] or values["as_json"])
    return None if with_it else advice.unchecked_poses(result.report)


def _comment(result: Result, values: dict[str, Any]) -> None:
    report, name = result.report, printable(result.job.source)
    if result.outcome is Outcome.REFUSED:
        say_refused(report["message"], result.job.source, values)
    if (caution := _caution(result, values)) is not None:
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
        if result.outcome is not Outcome.REFUSED:
            exit_codes.say(f"{name}: {report['message']}")
        for trial in report["models_tried"]:
            after_mg = trial["after_mg"]
            error = trial["reason"] if after_mg is None else f"{after_mg:.3f} mg held out"
            prior = " with the prior" if "prior" in trial else ""
            exit_codes.say(f"{name}: model {trial['model']}{prior}: {error}")
