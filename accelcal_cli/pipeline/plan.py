"""Which outputs belong to which recording, decided before any work."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from accelcal_cli.core.errors import UsageError
from accelcal_cli.readers import all_formats

STDIN = Path("-")
PARQUET_SUFFIX = ".calibrated.parquet"
REPORT_SUFFIX = ".calibration.json"
INTEGERS_SUFFIX = ".integers.json"


@dataclass(frozen=True, slots=True)
class Job:
    """One recording and where its results go."""

    source: Path
    parquet: Path
    report: Path

    @property
    def integers(self) -> Path:
        """Where the fit's integers go, if they are asked for."""
        return self.report.with_name(self.report.name.removesuffix(REPORT_SUFFIX) + INTEGERS_SUFFIX)


def real(path: Path) -> Path:
    """The absolute path without links; a loop of links, or a path in a working folder that is gone, stays."""
    try:
        return Path(os.path.realpath(path))
    except FileNotFoundError:
        return path


def stem(path: Path) -> str:
    """File name without `.gz` and its format suffix."""
    name = path.name
    if name.lower().endswith(".gz"):
        name = name[:-3]
    known = {suffix for item in all_formats() for suffix in item.suffixes}
    suffix = Path(name).suffix
    return name[: -len(suffix)] if suffix.lower() in known else name


def plan(sources: list[Path], output_dir: Path | None, output: Path | None) -> list[Job]:
    """Jobs in the order of the sources.

    Raises:
        UsageError: `output` with several recordings, a standard input named twice, or two
            recordings with one output.
    """
    if output is not None and len(sources) > 1:
        raise UsageError("-o/--output names one file, but there are several recordings", hint="use -d")
    jobs = [_job(source, output_dir, output) for source in sources]
    _refuse_collisions(jobs)
    return jobs


def plan_report(source: Path, output_dir: Path | None, report: Path | None, *inputs: Path) -> Job:
    """The job of a command that writes a report and no Parquet.

    Args:
        report: name of the report, if not the usual one.
        inputs: further files that must not be written to.

    Raises:
        UsageError: an input would be overwritten.
    """
    job = _job(source, output_dir, None)
    if report is not None:
        base = report.name.removesuffix(".json").removesuffix(".calibration")
        job = Job(source, report.with_name(base + PARQUET_SUFFIX), report)
    _refuse_collisions([job])
    for path in inputs:
        if real(path) == real(job.report):
            raise UsageError(f"{path} would be overwritten by the report", hint="use -o or -d")
    return job


def _job(source: Path, output_dir: Path | None, output: Path | None) -> Job:
    if output is not None:
        base = output.name.removesuffix(".parquet").removesuffix(".calibrated")
        return Job(source, output, output.with_name(base + REPORT_SUFFIX))
    if source == STDIN:
        folder, name = output_dir or Path(), "stdin"
    else:
        folder, name = output_dir or source.parent, stem(source)
    return Job(source, folder / (name + PARQUET_SUFFIX), folder / (name + REPORT_SUFFIX))


def _refuse_collisions(jobs: list[Job]) -> None:
    owners: dict[Path, Path] = {}
    for job in jobs:
        target = real(job.report)
        if target in owners:
            raise UsageError(
                f"{owners[target]} and {job.source} would both write {job.report}",
                hint="calibrate them separately with -d, or rename one",
            )
        owners[target] = job.source
        if job.source != STDIN and real(job.source) in (target, real(job.parquet)):
            raise UsageError(f"{job.source} would be overwritten by its own output", hint="use -o or -d")
