"""`accelcal study`."""

from __future__ import annotations

import json
from datetime import datetime
from pathlib import Path
from typing import Any

import click

from accelcal_cli.cli import exits
from accelcal_cli.cli.options import Positive, precision_option
from accelcal_cli.cli.request import calibrating_options, request_of
from accelcal_cli.cli.study_watch import Told, watching
from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.judgement import Outcome
from accelcal_cli.core.limits import workers
from accelcal_cli.core.names import counted, printable
from accelcal_cli.core.settings import DEFAULT
from accelcal_cli.study.find import Where
from accelcal_cli.study.items import FAILED
from accelcal_cli.study.plan import Study
from accelcal_cli.study.preview import preview
from accelcal_cli.study.run import run
from accelcal_cli.study.shard import shard
from accelcal_cli.study.summary import Summary
from accelcal_cli.study.todo import overlooked

FOLDER = click.Path(path_type=Path, readable=False)


@click.command("study")
@click.argument("folders", nargs=-1, required=True, type=FOLDER)
@click.option("-d", "--output-dir", "out", type=FOLDER, required=True, help="Folder of the outputs.")
@click.option("--include", multiple=True, metavar="GLOB", help="Begin only these files, such as '*.cwa'.")
@click.option("--exclude", multiple=True, metavar="GLOB", help="Not these files, such as 'pilot/*'.")
@click.option(
    "-j", "--jobs", type=click.IntRange(1, 1024), help="Workers.  [default: as CPUs and memory allow]"
)
@click.option("--timeout", type=Positive(1e6), metavar="MINUTES", help="The longest a recording may take.")
@click.option("--settle", type=Positive(), metavar="SECONDS", help="Leave files changed since for later.")
@click.option(
    "--newer-than",
    type=click.DateTime(["%Y-%m-%d", "%Y-%m-%dT%H:%M:%S"]),
    metavar="DATE",
    help="Begin only files changed since.",
)
@click.option("--retry-failed", is_flag=True, help="Try again what failed and has not changed.")
@click.option("--dry-run", is_flag=True, help="Say what would be done, and do nothing.")
@click.option("--shard", metavar="I/N", help="Only part I of N; `slurm`: this task's of a job array.")
@click.option("--collect", is_flag=True, help="Sum up what the shards have done.")
@click.option("--dask", metavar="ADDRESS", help="Work on the cluster of this scheduler (or scheduler.json).")
@click.option(
    "--pool",
    type=click.Choice(["device"]),
    help="Calibrate all recordings of one device as one, and use the result for each of them.",
)
@click.option(
    "--borrow",
    is_flag=True,
    help="Where a recording cannot be calibrated, or poorly, use the coefficients of the nearest good one of "
    "its device, if they prove themselves on its own stillness.",
)
@precision_option
@calibrating_options
def command(folders: tuple[Path, ...], **values: Any) -> int:
    """Calibrate all recordings in each FOLDER and below, in parallel.

    Mirrors the folders under the one of -d, and writes study.csv, study.parquet and study.json there. A
    second run does only what is new, changed or unfinished. Prints a line for each recording, as `calibrate`
    does; with -q nothing unless something failed.
    """
    study = _study(folders, values)
    if not values["quiet"] and (number := overlooked(study)):
        exits.say(f"left out, since below {printable(study.out)}: {counted(number, 'recording')}")
    if values["dry_run"]:
        return _preview(study, values)
    if (
        study.dask is None
        and study.jobs is not None
        and study.jobs > workers(study.jobs)
        and not values["quiet"]
    ):
        exits.say(f"--jobs {study.jobs} is more than CPUs and memory allow for ({workers(study.jobs)})")
    with watching(study.out, values) as watch:
        result = run(study, watch)
    return _ended(study, result, watch, values)


def _study(folders: tuple[Path, ...], values: dict[str, Any]) -> Study:
    request = request_of(values)
    if values["shard"] and values["collect"]:
        raise UsageError("--shard does a part, --collect sums up all parts", hint="give one of them")
    if values["pool"] and request.settings.profile != DEFAULT.profile:
        raise UsageError(f"profile {request.settings.profile} keeps no cells that could be pooled")
    return Study(
        Where(folders, values["out"], values["include"], values["exclude"]),
        request,
        jobs=values["jobs"],
        timeout_s=None if values["timeout"] is None else values["timeout"] * 60,
        settle_s=values["settle"] or 0.0,
        newer_than_s=_seconds(values["newer_than"]),
        retry_failed=values["retry_failed"],
        shard=shard(values["shard"]),
        collect=values["collect"],
        dask=values["dask"],
        pool=values["pool"] is not None,
        borrow=values["borrow"],
    )


def _seconds(moment: datetime | None) -> float | None:
    """A local time in seconds since 1970; raises UsageError for one that this machine cannot place."""
    try:
        return None if moment is None else moment.timestamp()
    except (ValueError, OverflowError, OSError) as error:
        raise UsageError(f"--newer-than {moment} is a time that no clock shows") from error


def _preview(study: Study, values: dict[str, Any]) -> int:
    """A line for each recording: path and `todo`, `waiting`, or the outcome it has; with -q none."""
    states = sorted((item.name, printable(item.source), state) for item, state in preview(study).items())
    for _, path, state in states:
        if values["as_json"]:
            click.echo(json.dumps({"path": path, "state": state}))
        elif not values["quiet"]:
            click.echo(f"{path}\t{state}")
    return exits.OK


def _ended(study: Study, result: Summary, watch: Told, values: dict[str, Any]) -> int:
    """The last words, and the exit code."""
    for pool in result.pools.values():
        if pool["outcome"] in (FAILED, Outcome.REFUSED):
            device = printable(f"the {pool['recordings']} recordings of device {pool['device_serial']}")
            exits.say(f"{device} are not pooled: {pool['message']}")
    unfinished = study.collect and result.waiting > 0
    if not values["quiet"] or unfinished:
        counts = [f"{number} {name.replace('_', ' ')}" for name, number in result.outcomes().items()]
        more = {"unchanged": result.up_to_date, "not begun": result.waiting}
        counts += [f"{number} {name}" for name, number in more.items() if number]
        counts += [counted(result.left_out, "no recording")] if result.left_out else []
        table = printable(study.out / f"{study.shard.basename}.csv")
        number = ": ".join(filter(None, [counted(len(result.rows), "recording"), ", ".join(counts)]))
        exits.say(f"{number}; see {table}")
    if len(watch.codes) == 1 and not unfinished:
        return watch.codes[0]
    return exits.SOME_FAILED if any(watch.codes) or unfinished else exits.OK
