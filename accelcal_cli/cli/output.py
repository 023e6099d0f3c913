"""Output of commands: result lines, tables, progress and comments; and the loop over recordings."""

from __future__ import annotations

import contextlib
import json
import shlex
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

from accelcal_cli.cli import exit_codes
from accelcal_cli.core.errors import AccelcalError, Reason, UsageError, counted, printable
from accelcal_cli.core.results import Outcome
from accelcal_cli.output import sentences
from accelcal_cli.output.advice import LIMIT_MG, RAW_SETTLED, doubts
from accelcal_cli.output.numbers import formatted, mg, percent, times_smaller
from accelcal_cli.output.sections import ReportView
from accelcal_cli.output.sentences import outcome_words, parameters_of
from accelcal_cli.pipeline.jobs import (
    PAGE_SUFFIX,
    REPORT_SUFFIX,
    STDIN,
    Job,
    Progress,
    ProgressMaker,
    Result,
    no_progress,
    spooled,
)
from accelcal_cli.studies.columns import error_columns, factor_columns

ALWAYS_SAID = (
    *("cut_short", "nothing_checks_poses", "roll_alone_checks_poses"),
    *("worse_here", "much_left", "no_longer_fits"),
)
"""Codes of cautions that even a quiet run prints."""


def aligned(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Align columns to their widest cells, the first to the left and the others to the right."""
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
    lines = []
    for row in (head, ["-" * width for width in widths], *rows):
        first, *rest = zip(row, widths, strict=True)
        cells = [first[0].ljust(first[1]), *(cell.rjust(width) for cell, width in rest)]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


def show_result(
    report: ReportView,
    source: Path,
    written: Path | None,
    values: dict[str, Any],
    *,
    up_to_date: bool = False,
) -> None:
    """Print the line of one recording's report, see `show_row`; at a terminal also what to be aware of."""
    holdout, calibrated = report.holdout, report.calibration is not None
    row: dict[str, Any] = {
        "outcome": report.outcome,
        "model": None if report.calibration is None else report.calibration.model,
        "before_mg": None if holdout is None else holdout.before_mg.mean,
        "message": report.message,
        "improvement_percent": None,
    }
    if holdout is not None and calibrated:
        low, high = holdout.ci95_mg
        row |= {"after_mg": holdout.after_mg.mean, "ci95_low_mg": low, "ci95_high_mg": high}
        row |= {"improvement_percent": holdout.improvement_percent} | factor_columns(holdout)
    row |= error_columns(report)
    refused = report.outcome == Outcome.REFUSED
    cautions = () if refused else report.cautions
    told = [("Caution", one) for one in cautions] + [("What to do", one) for one in report.advice]
    told = [] if values.get("quiet", False) else told
    remarks = [f"{start}: {sentences.sentence(one)}" for start, one in told]
    show_row(row, source, written, values, remarks, up_to_date=up_to_date)


def show_row(
    row: dict[str, Any],
    source: Path,
    written: Path | None,
    values: dict[str, Any],
    remarks: Sequence[str] | None = None,
    *,
    up_to_date: bool = False,
) -> None:
    """Print one recording's row of a study's summary: a sentence at a terminal, else fields.

    Args:
        written: path of its output, if it has one.
        values: the option `tsv`: fields at a terminal, too; and `verbose`: the remarks on stderr then.
        remarks: sentences to follow; None: the doubts that the row itself raises.
        up_to_date: whether an earlier run wrote the output.
    """
    if remarks is None:
        remarks = [f"Caution: {sentences.sentence(one)}" for one in _doubts(row, values.get("max_error_mg"))]
    if _in_words(values):
        where = None if written is None else f"{'Unchanged:' if up_to_date else 'Written to'} {written}"
        exit_codes.show("\n".join([_sentence(row, source, where), *(f"  {one}" for one in remarks)]))
        return
    exit_codes.show(_fields(row, source, written))
    for one in remarks if values.get("verbose") else ():
        exit_codes.say(f"{printable(source)}: {one}")


def _in_words(values: dict[str, Any]) -> bool:
    """Return True if results are printed as sentences."""
    return sys.stdout.isatty() and not values["tsv"] and not values.get("as_json")


def say_refused(message: str, source: Path, values: dict[str, Any], *, shown: bool = True) -> None:
    """Say why a recording was refused, unless the same terminal shows it already.

    Args:
        shown: the recording's line was printed.
    """
    if not (shown and _in_words(values) and sys.stderr is not None and sys.stderr.isatty()):
        exit_codes.say(f"{printable(source)}: refused: {sentences.begun_small(message)}")


def _fields(row: dict[str, Any], source: Path, written: Path | None) -> str:
    """Write the fields of a result; `-` for nothing.

    Path, outcome, model, held-out errors before and after [mg], improvement [%], output; then the calibration
    error over all orientations and the ends of its interval [mg], and the probability that it is lower than
    that of the raw data.
    """
    fields = [
        str(source),
        row["outcome"],
        row["model"] or "-",
        *(formatted(row.get(name), ".3f") for name in ("before_mg", "after_mg")),
        percent(row["improvement_percent"]),
        "-" if written is None else str(written),
        *(formatted(row.get(f"calibration_error_{name}"), ".3f") for name in ("mg", "low_mg", "high_mg")),
        formatted(row.get("probability_better"), ".3f"),
    ]
    return "\t".join(map(printable, fields))


def _sentence(row: dict[str, Any], source: Path, where: str | None) -> str:
    """Say what became of a recording, how certain the remaining error is, and where the output is."""
    outcome, before, after = row["outcome"], row["before_mg"], row.get("after_mg")
    start = f"{source}: {outcome_words(outcome).result}"
    parts = []
    if row["model"] is not None and outcome != Outcome.ALREADY_GOOD:
        parameters = parameters_of(row["model"])
        start += f" ({parameters})" if outcome == Outcome.BORROWED else f" with {parameters}"
    if outcome == Outcome.REFUSED and row.get("message"):
        parts.append(sentences.begun_small(row["message"]).removesuffix("."))
    elif after is not None:
        parts += _errors(row)
    elif before is not None:
        parts.append(f"the raw data are off by {mg(before)} mg")
    return printable(": ".join(filter(None, (start, ". ".join([*parts, *filter(None, [where])])))))


def _errors(row: dict[str, Any]) -> list[str]:
    """Say the errors before and after [mg], and the interval of the one to quote."""
    before, after, everywhere = row["before_mg"], row.get("after_mg"), row.get("calibration_error_mg")
    where = "its own still windows" if row["outcome"] == Outcome.BORROWED else "held-out data"
    change = f"{mg(after)} mg" if after == before else f"{mg(before)} -> {mg(after)} mg"
    interval = row.get("improvement_factor_low"), row.get("improvement_factor_high")
    smaller = "" if after == before else times_smaller(row.get("improvement_factor"), interval)
    if everywhere is None:
        low, high = mg(row["ci95_low_mg"]), mg(row["ci95_high_mg"])
        return [f"error |r - 1| on {where} {change} (95 % interval {low} to {high}){smaller}"]
    low, high = mg(row["calibration_error_low_mg"]), mg(row["calibration_error_high_mg"])
    raw = row.get("calibration_error_before_mg")
    return [
        f"error over all orientations {mg(raw)} -> {mg(everywhere)} mg (95 % interval {low} to {high})",
        f"Error |r - 1| on {where} {change}{smaller}",
    ]


def _doubts(row: dict[str, Any], limit_mg: float | None) -> list[Reason]:
    """Return what the interval of a row says against it; no limit: the usual one."""
    if row["outcome"] == Outcome.REFUSED or row.get("probability_better") is not None:
        return []
    everywhere = row.get("calibration_error_mg") is not None
    high = row.get("calibration_error_high_mg" if everywhere else "ci95_high_mg")
    settled = row["outcome"] in RAW_SETTLED
    before = None if settled else row.get("calibration_error_before_mg" if everywhere else "before_mg")
    return doubts(high, before, limit_mg or LIMIT_MG, everywhere=everywhere)


@contextlib.contextmanager
def progress_bars(label: str, *, quiet: bool, unit: str = "B") -> Iterator[ProgressMaker]:
    """Provide a maker of bars for the stages of one recording; each replaces the one before."""
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


RecordingResult = TypeVar("RecordingResult")


def each_recording(
    recordings: Sequence[Path],
    work: Callable[[Path, ProgressMaker], RecordingResult],
    *,
    quiet: bool,
    instead: Callable[[Path, str], RecordingResult] | None = None,
) -> tuple[list[RecordingResult], int]:
    """Return the results of all recordings that can be read, and the exit code; a failure is printed.

    Args:
        instead: returns the result of a recording that failed, from its path and the message.
    """
    results, failed = [], 0
    for path in recordings:
        try:
            with progress_bars(path.name, quiet=quiet) as bars:
                results.append(work(path, bars))
        except AccelcalError as error:
            failed = exit_codes.of_failure(error)
            results += [] if instead is None else [instead(path, error.line_for((path,)))]
    return results, exit_codes.SOME_FAILED if failed and len(recordings) > 1 else failed


def refuse_both(*, as_json: bool, as_csv: bool) -> None:
    """Raise UsageError if JSON and CSV are asked for."""
    if as_json and as_csv:
        raise UsageError("--json and --csv cannot be combined", hint="give one of them")


Work = Callable[[Job, ProgressMaker, Path], Result]
"""Function that makes one recording's result; the path is where its bytes are."""


def run_jobs(
    jobs: list[Job],
    work: Work,
    values: dict[str, Any],
    written: Callable[[Result], Path | None] = lambda result: result.parquet,
) -> int:
    """Do every job and print its result or why it failed; return the exit code of all.

    Args:
        values: the options `quiet`, `verbose` and `as_json`.
        written: the output that a result's line names.
    """
    codes, outcomes = [], []
    for job in jobs:
        try:
            with (
                bytes_of(job.source) as source,
                progress_bars(job.source.name, quiet=values["quiet"]) as bars,
            ):
                result = work(job, bars, source)
        except AccelcalError as error:
            codes.append(exit_codes.of_failure(error))
            _show_failed(job.source, codes[-1], error.line_for((job.source,)), values)
            continue
        except Exception as error:
            codes.append(exit_codes.report_bug(job.source))
            _show_failed(job.source, codes[-1], f"{type(error).__name__}: {error}", values)
            continue
        if values["as_json"]:
            exit_codes.show(json.dumps(result.report))
        else:
            path, known = written(result), result.up_to_date
            show_result(result.view, result.job.source, path, values, up_to_date=known)
        _comment(result, values)
        codes.append(exit_codes.REFUSED if result.outcome is Outcome.REFUSED else exit_codes.OK)
        outcomes.append(result.outcome)
    pages = bool(values.get("html"))
    if (len(jobs) > 1 or (pages and outcomes)) and _in_words(values) and not values["quiet"]:
        exit_codes.show(_sum_of(jobs, outcomes, pages=pages))
    return exit_codes.of_all(codes)


def _show_failed(source: Path, code: int, message: str, values: dict[str, Any]) -> None:
    """Print the object of a recording that failed, if objects are wanted."""
    if values["as_json"]:
        from accelcal_cli.output.report import failed_document

        exit_codes.show(json.dumps(failed_document(source, code, message)))


def _sum_of(jobs: Sequence[Job], outcomes: Sequence[Outcome], *, pages: bool) -> str:
    """Sum up several recordings in one line, and name the pages or the command that makes them."""
    if len(jobs) == 1:
        return f"Page: {printable(jobs[0].page)}"
    numbers = Counter(str(one).replace("_", " ") for one in outcomes)
    numbers["failed"] = len(jobs) - len(outcomes)
    counts = ", ".join(f"{number} {name}" for name, number in numbers.items() if number)
    folders = dict.fromkeys(shlex.quote(str(job.report.parent)) for job in jobs)
    made = " ".join(f"{folder}/*{PAGE_SUFFIX if pages else REPORT_SUFFIX}" for folder in folders)
    page = f"Pages: {made}" if pages else f"For pages: accelcal report {made}"
    return printable(f"{counted(len(jobs), 'recording')}: {counts}. {page}")


@contextlib.contextmanager
def bytes_of(recording: Path) -> Iterator[Path]:
    """Provide the path of a recording's bytes: its own, or that of a copy of standard input.

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


def counted_once(problems: Iterable[tuple[str, str]]) -> list[str]:
    """Return problems, by code and message, as texts; those that differ in their number alone are one."""
    found: dict[tuple[str, str], list[str]] = {}
    for code, message in problems:
        stem, mark, number = message.rpartition(": ")
        countable = mark and number.isdecimal()
        found.setdefault((code, stem if countable else message), []).append(number if countable else "")
    texts = []
    for (code, stem), numbers in found.items():
        total = f": {sum(map(int, filter(None, numbers)))}" if any(numbers) else ""
        places = f", in {len(numbers)} places" if len(numbers) > 1 else ""
        texts.append(f"{code}: {stem}{total}{places}")
    return texts


def _say_verdict(result: Result, values: dict[str, Any]) -> None:
    """Say what even a quiet run says: why a recording was refused, or what speaks against its result."""
    report = result.view
    grave = [one for one in report.cautions if one.code in ALWAYS_SAID]
    if result.outcome is Outcome.REFUSED:
        cut = any(one.code == "cut_short" for one in grave)  # whose sentence has that advice
        ways = [one for one in report.advice if not (cut and one.code == "copy_again")][:2]
        why = " ".join([report.message, *map(sentences.sentence, [*grave, *ways])])
        say_refused(why, result.job.source, values)
        return
    said_with_result = (_in_words(values) or values["verbose"]) and not (values["quiet"] or values["as_json"])
    if grave and not said_with_result:
        exit_codes.say(f"{printable(result.job.source)}: caution: {' '.join(map(sentences.sentence, grave))}")


def _comment(result: Result, values: dict[str, Any]) -> None:
    report, name = result.view, printable(result.job.source)
    _say_verdict(result, values)
    if values["quiet"]:
        return
    if result.up_to_date:
        exit_codes.say(f"{name}: up to date")
    problems = counted_once((one.code, one.message) for one in report.file_health.problems)
    for text in problems if values["verbose"] else problems[:1]:
        omitted = 0 if values["verbose"] else len(problems) - 1
        more = f" (and {omitted} more; see the report)" if omitted else ""
        exit_codes.say(f"{name}: {text}{more}")
    if values["verbose"]:
        if result.outcome is not Outcome.REFUSED:
            exit_codes.say(f"{name}: {report.message}")
        for trial in report.models_tried:
            held_out = None if trial.after_mg is None else f"{trial.after_mg:.3f} mg held out"
            error = held_out or sentences.clause(Reason(trial.reason or "", trial.values))
            prior = " with the prior" if trial.prior is not None else ""
            exit_codes.say(f"{name}: model {trial.model}{prior}: {error}")
