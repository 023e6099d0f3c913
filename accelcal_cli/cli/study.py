"""`accelcal study`: its options, lines and messages, and one progress bar for all recordings."""

from __future__ import annotations

import contextlib
import functools
import json
import shlex
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from accelcal_cli.cli import exit_codes
from accelcal_cli.cli.help import Command, Rare
from accelcal_cli.cli.options import FILE, OneOf, Positive, precision_option, request_of, study_options
from accelcal_cli.cli.output import say_refused, show_row
from accelcal_cli.cli.report import study_pages
from accelcal_cli.core.errors import UsageError, counted, printable
from accelcal_cli.core.results import Outcome
from accelcal_cli.core.system import workers
from accelcal_cli.output.sentences import clause, sentence
from accelcal_cli.pipeline.jobs import refuse_dash
from accelcal_cli.pipeline.options import json_value
from accelcal_cli.run_log import LOG, run_log
from accelcal_cli.studies.discovery import Where
from accelcal_cli.studies.records import FAILED, Item
from accelcal_cli.studies.study import Study, chosen_shard, with_learnt_prior
from accelcal_cli.studies.summary import Summary

if TYPE_CHECKING:
    from accelcal_cli.studies.study import ExecutorHolder
    from accelcal_cli.studies.task import TaskResult


class TerminalObserver:
    """Observer that prints a line for each recording and keeps the exit codes, and what a stop left done."""

    def __init__(self, values: dict[str, Any], stack: contextlib.ExitStack) -> None:
        self.codes: list[int] = []
        self.done = 0
        self._values = values
        self._stack = stack
        self._bar: Any = None
        self._failed = 0

    def begin(self, items: Sequence[Item]) -> None:
        """See `StudyObserver`; every round has its own bar."""
        if self._values["quiet"] or sys.stderr is None or not sys.stderr.isatty():
            return
        from tqdm import tqdm

        if self._bar is not None:
            self._bar.close()
        total = sum(item.size for item in items)
        self._bar = tqdm(total=total, unit="B", unit_scale=True, leave=False, file=sys.stderr)
        self._stack.callback(self._bar.close)
        self._todo, self._done = len(items), 0

    def advance(self, bytes_done: float) -> None:
        """See `StudyObserver`."""
        if self._bar is not None:
            self._bar.update(bytes_done)

    def finished(self, item: Item, result: TaskResult) -> None:
        """See `StudyObserver`."""
        row = result.entry.row
        assert row is not None
        quiet = self._values["quiet"] and not self._values["all_failures"]
        known = result.up_to_date and quiet  # an earlier run said so, and only news are wanted
        self.codes.append(exit_codes.OK if known else row["exit_code"])
        if known:
            return
        self._failed += row["outcome"] == FAILED
        with self._aside(fresh=not result.up_to_date):
            self._print(item, row, up_to_date=result.up_to_date)
            self._comment(item, row, result)

    def note(self, text: str) -> None:
        """See `StudyObserver`."""
        LOG.info("note: %s", text)
        if not self._values["quiet"]:
            with self._aside(fresh=False):
                exit_codes.say(text)

    def found(self, line: str, *, new: bool) -> None:
        """See `StudyObserver`; a quiet run says only what is new."""
        LOG.info("to act on: %s", line)
        if new or self._values["all_failures"] or not self._values["quiet"]:
            with self._aside(fresh=False):
                exit_codes.say(line)

    def stopped(self, done: int) -> None:
        """See `StudyObserver`."""
        self.done = done

    @contextlib.contextmanager
    def _aside(self, *, fresh: bool) -> Iterator[None]:
        """Let the block print lines above the bar, then update the bar."""
        if self._bar is None:
            yield
            return
        with self._bar.external_write_mode(file=sys.stderr):
            yield
        self._done += fresh
        self._bar.set_description(f"{self._done}/{self._todo} recordings, {self._failed} failed")

    def _print(self, item: Item, row: dict[str, Any], *, up_to_date: bool) -> None:
        if self._values["as_json"]:
            exit_codes.show(json.dumps(_document(item, row)))
        elif not self._values["quiet"]:
            kept = row["outcome"] == Outcome.REFUSED
            written = None if row["parquet"] is None else item.job.uncalibrated if kept else item.job.parquet
            show_row(row, item.shown, written, self._values, up_to_date=up_to_date)

    def _comment(self, item: Item, row: dict[str, Any], result: TaskResult) -> None:
        name = printable(item.shown)
        if row["outcome"] == FAILED:
            kept = result.trace and f"; please report it with {exit_codes.keep_trace(result.trace)}"
            exit_codes.say(f"{name}: {row['message']}{kept or ''}")
        elif row["outcome"] == Outcome.REFUSED:
            say_refused(row["message"], item.shown, self._values, shown=not self._values["quiet"])
        if self._values["quiet"]:
            return
        for problem in result.problems if self._values["verbose"] else result.problems[:1]:
            exit_codes.say(f"{name}: {problem}")


@click.command(
    "study",
    cls=Command,
    examples=(
        "study recordings -d calibrated --html # all recordings of a folder, with a page of the study",
        "study recordings -d calibrated --borrow # with coefficients of the device's other recordings",
    ),
)
@click.argument("folders", nargs=-1, required=True, type=FILE)
@click.option("-d", "--output-dir", "out", type=FILE, required=True, metavar="OUT",
              help="Folder for the outputs.")  # fmt: skip
@click.option("--include", multiple=True, metavar="GLOB", help="Only these files, such as '*.cwa'.")
@click.option("--exclude", multiple=True, metavar="GLOB", help="Not these files, such as 'pilot/*'.")
@click.option("-j", "--jobs", type=click.IntRange(1, 1024), metavar="N",
              help="Number of workers.  [default: by CPUs and memory]")  # fmt: skip
@click.option("--timeout", type=Positive(1e6), metavar="MINUTES", help="Time limit for each recording.")
@click.option("--settle", type=Positive(), metavar="SECONDS",
              help="Skip files modified within the last SECONDS.")  # fmt: skip
@click.option("--newer-than", cls=Rare, metavar="DATE",
              type=click.DateTime(["%Y-%m-%d", "%Y-%m-%dT%H:%M:%S"]),
              help="Process only files modified since DATE.")  # fmt: skip
@click.option("--retry-failed", is_flag=True, help="Try unchanged failed recordings again.")
@click.option("--all-failures", is_flag=True, help="With -q, also those of earlier runs.")
@click.option("--html", is_flag=True, help="Also write study.html and a page for each.")
@click.option("--decisions", cls=Rare, type=FILE, metavar="FILE",
              help="Table of decisions on recordings.  [default: decisions.csv in OUT]")  # fmt: skip
@click.option("--log", type=FILE, metavar="FILE", help="Add a dated log of this run.")
@click.option("--prune", is_flag=True, help="Remove results whose recording is gone.")
@click.option("--dry-run", is_flag=True, help="Show what would be done, and why.")
@click.option("--shard", cls=Rare, metavar="I/N",
              help="Process part I of N only; `slurm`: the part of this job array task.")  # fmt: skip
@click.option("--unlock", is_flag=True, help="Remove the lock of a run that has ended.")
@click.option("--collect", cls=Rare, is_flag=True, help="Merge the results of all shards.")
@click.option("--executor", cls=Rare, metavar="MODULE:CALLABLE",
              help="Use the concurrent.futures executor that CALLABLE returns.")  # fmt: skip
@click.option(
    "--dask", cls=Rare, metavar="ADDRESS", help="Use the Dask cluster of this scheduler (or scheduler.json)."
)
@click.option(
    "--pool", cls=Rare, type=OneOf(["device"]),
    help="Calibrate the recordings of a device together.",
)  # fmt: skip
@click.option("--borrow", is_flag=True, help="Use coefficients of the same device where needed.")
@click.option("--keep-teaching", cls=Rare, is_flag=True,
              help="Let recordings that people excluded lend, pool and teach.")  # fmt: skip
@precision_option
@study_options
def command(folders: tuple[Path, ...], **values: Any) -> int:
    """Calibrate all recordings below each FOLDER into OUT, with study.csv (a row for each).

    Run it again: only new, changed and unfinished recordings are processed. OUT/decisions.csv holds people's
    decisions, FOLDER/study.toml reading options by file name. Prints a line for each recording, as
    `calibrate` does; with -q, only what is new and needs a person.
    """
    from accelcal_cli.studies.rounds import overlooked  # what runs a study takes longer to load than --help

    study = _study(folders, values)
    if values["unlock"]:
        return _unlock(study)
    if not values["quiet"] and (number := overlooked(study)):
        exit_codes.say(
            f"ignored, because they are below {printable(study.out)}: {counted(number, 'recording')}"
        )
    if values["dry_run"]:
        return _preview(study, values)
    with run_log(values["log"], shlex.join(["accelcal", *sys.argv[1:]]), exit_codes.say) as log:
        code = _run(study, values)
        if log is not None:
            log.code = code
    return code


def _run(study: Study, values: dict[str, Any]) -> int:
    """Carry out a study, and make its pages if they are wanted; returns the exit code."""
    from accelcal_cli.studies.run import run

    if study.jobs is not None and study.jobs > workers(study.jobs) and not values["quiet"]:
        exit_codes.say(f"--jobs {study.jobs} is more than CPUs and memory allow ({workers(study.jobs)})")
    with contextlib.ExitStack() as stack:
        observer = TerminalObserver(values, stack)
        try:
            summary = run(study, observer)
        except (KeyboardInterrupt, exit_codes.InterruptedBySignalError) as stop:
            text = f"{counted(observer.done, 'recording')} done; the same command does the rest"
            raise exit_codes.InterruptedBySignalError(text) from stop
    code = _exit_code(study, summary, observer, values)
    if not values["html"]:
        return code
    of_pages = study_pages(study.out, force=study.request.force, quiet=values["quiet"])
    return code or of_pages


def _document(item: Item, row: dict[str, Any]) -> Any:
    """Return the report of a recording, or the object in its place if it failed."""
    if row["outcome"] != FAILED:
        return json.loads(item.job.report.read_text("utf-8"))
    from accelcal_cli.output.report import failed_document

    found = failed_document(item.source, row["exit_code"], row["message"])
    found["values"]["path"] = printable(item.shown)
    return found


def _unlock(study: Study) -> int:
    """Remove the study's lock and say whose it was."""
    from accelcal_cli.studies.run import unlock

    lock = unlock(study)
    what = "there is no lock" if lock is None else f"removed the lock of {printable(str(lock))}"
    exit_codes.say(f"{printable(study.lock)}: {what}")
    return exit_codes.OK


def _study(folders: tuple[Path, ...], values: dict[str, Any]) -> Study:
    request = replace(request_of(values, folders), several=True)
    refuse_dash(values["out"])
    study = Study(
        Where(folders, values["out"], values["include"], values["exclude"]),
        request,
        jobs=values["jobs"],
        timeout_s=None if values["timeout"] is None else values["timeout"] * 60,
        settle_s=values["settle"] or 0.0,
        newer_than_s=_seconds(values["newer_than"]),
        retry_failed=values["retry_failed"],
        shard=chosen_shard(values),
        collect=values["collect"],
        executor=_executor(values),
        pool=values["pool"] is not None,
        borrow=values["borrow"],
        prune=values["prune"],
        keep_teaching=values["keep_teaching"],
        decisions=values["decisions"],
    )
    return with_learnt_prior(study)


def _executor(values: dict[str, Any]) -> ExecutorHolder | None:
    """Return what holds the executor that the options name; None for processes of this machine."""
    from accelcal_cli.studies.executors import dask_executor, named_executor

    address, name = values["dask"], values["executor"]
    if address is not None and name is not None:
        raise UsageError("--dask and --executor both choose who does the work", hint="give one of them")
    if name is not None:
        return functools.partial(named_executor, name)
    return None if address is None else functools.partial(dask_executor, address)


def _seconds(moment: datetime | None) -> float | None:
    """Return a local time [s since 1970]; raises UsageError if it is outside the range of the clock."""
    try:
        return None if moment is None else moment.timestamp()
    except (ValueError, OverflowError, OSError) as error:
        raise UsageError(f"--newer-than {moment} is outside the range of this machine's clock") from error


def _preview(study: Study, values: dict[str, Any]) -> int:
    """Print path, `todo`, `waiting` or outcome, and stated options of each recording; nothing with -q."""
    from accelcal_cli.studies.run import preview

    def note(text: str) -> None:
        if not values["quiet"]:
            exit_codes.say(text)

    states, left, again = preview(study, note)
    for item, state in sorted(states.items(), key=lambda pair: pair[0].name):
        path = printable(item.shown)
        if values["as_json"]:
            stated = {one.field: {"value": json_value(one.value), "from": one.origin} for one in item.choices}
            more = {"stated": stated or None, "message": item.refusal, "why": again.get(item.name)}
            known = {name: value for name, value in more.items() if value is not None}
            exit_codes.show(json.dumps({"path": path, "state": state, **known}))
        elif not values["quiet"]:
            why = again.get(item.name)
            shown = f"{state} ({why})" if why and state == "todo" else state
            exit_codes.show("\t".join([path, shown, *_stated(item), *filter(None, [item.refusal])]))
    for name, one in left.items():
        if values["as_json"]:
            about = {"path": printable(name), "state": "left_out", **one.as_json(), "message": sentence(one)}
            exit_codes.show(json.dumps(about))
        elif not values["quiet"]:
            exit_codes.say(f"{printable(name)}: left out: {clause(one)}")
    return exit_codes.OK


def _stated(item: Item) -> list[str]:
    """Return the options that files state for a recording, with these files, as one text or none."""
    origins = dict.fromkeys(one.origin for one in item.choices)
    parts = [f"{' '.join(str(c) for c in item.choices if c.origin == one)} ({one})" for one in origins]
    return ["; ".join(parts)] if parts else []


def _exit_code(study: Study, summary: Summary, observer: TerminalObserver, values: dict[str, Any]) -> int:
    """Sum up on stderr and return the exit code."""
    if summary.ahead and study.settle_s > 0:
        what = f"{counted(summary.ahead, 'recording')} that wait: modified in the future by this clock"
        exit_codes.say(f"{what}; check the clocks of the machines")
    unfinished = study.collect and summary.waiting > 0
    if not values["quiet"] or unfinished:
        counts = [f"{number} {name.replace('_', ' ')}" for name, number in summary.outcomes().items()]
        counts += [f"{summary.copies} copied from others"] if summary.copies else []
        counts += [f"{summary.waiting} not started"] if summary.waiting else []
        if values["verbose"]:
            for name, why in summary.files_left_out.items():
                exit_codes.say(f"{printable(name)}: left out: {clause(why)}")
        table = printable(study.out / f"{study.shard.basename}.csv")
        total = ": ".join(filter(None, [_number(summary), ", ".join(counts)]))
        others = f". {counted(summary.left_out, 'other file')} skipped" if summary.left_out else ""
        exit_codes.say(f"{total}{others}. Results: {table}")
    return exit_codes.SOME_FAILED if unfinished else exit_codes.of_all(observer.codes)


def _number(summary: Summary) -> str:
    """Say how many recordings there are, and how many of them an earlier run or a person settled."""
    more = {
        "unchanged": summary.up_to_date,
        "made with other options": summary.kept,
        "decided by people": 0 if summary.decisions is None else len(summary.decisions.changes),
    }
    parts = ", ".join(f"{number} {name}" for name, number in more.items() if number)
    return counted(len(summary.rows), "recording") + (f" ({parts})" if parts else "")
