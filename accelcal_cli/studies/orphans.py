"""Results in OUT whose recording is gone or has another name now: found, told, and removed by `--prune`.

A result is one of these only if the disk says that nothing is where its recording was, neither at the path in
its report nor at its place in the study: a disk that cannot tell, or a folder that cannot be listed, is not a
reason to remove anything.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from accelcal_cli.core.door import files_below, is_there
from accelcal_cli.core.errors import OutputError, UsageError, counted, printable
from accelcal_cli.core.reasons import Reason
from accelcal_cli.output.report_reading import load_report
from accelcal_cli.output.words import sentence
from accelcal_cli.pipeline import jobs
from accelcal_cli.pipeline.outputs import gone_from, remove_all
from accelcal_cli.studies.discovery import Where, places
from accelcal_cli.studies.pooling import PREFIX


@dataclass(frozen=True, slots=True)
class Orphan:
    """A result without its recording.

    Attributes:
        name: path of its report under OUT.
        reason: why it is one.
    """

    name: str
    report: Path
    reason: Reason

    def as_json(self) -> dict[str, Any]:
        """Return the object of `study.json`."""
        return {"report": printable(self.name), **self.reason.as_json(), "message": sentence(self.reason)}


def orphans(where: Where, known: Collection[Path], rows: Collection[Mapping[str, Any]]) -> list[Orphan]:
    """Return the results whose recording is gone, by name.

    Args:
        known: reports of all recordings that the study found, whether it works on them or not.
        rows: rows of the study's table, whose hashes tell recordings that were renamed.
    """
    names = {row["sha256"]: row["path"] for row in rows if row.get("sha256")}
    found: list[Orphan] = []
    for folder, folders, files in files_below(where.out, []):
        folders[:] = [name for name in folders if name[0] != "."]
        for file in files:
            path = folder / file
            if file.endswith(jobs.REPORT_SUFFIX) and path not in known and not file.startswith(PREFIX):
                found += _orphan(path, where, names)
    return sorted(found, key=lambda one: one.name)


def _orphan(path: Path, where: Where, names: Mapping[str, str]) -> list[Orphan]:
    """Return a result that is an orphan, or nothing."""
    try:
        report = load_report(path)
        source = None if report is None else gone_from(report)
    except OutputError:
        return []
    if report is None or source is None:
        return []
    below = path.relative_to(where.out)
    for folder, place in places(where):
        if below.as_posix().startswith(place):
            inside = Path(below.as_posix().removeprefix(place)).parent
            if is_there(folder / inside / source.name):
                return []
    now = names.get(report["recording"]["sha256"])
    reason = Reason.of("recording_gone", source=printable(source.name))
    if now is not None:
        reason = Reason.of("recording_renamed", source=printable(source.name), now=now)
    return [Orphan(below.as_posix(), path, reason)]


def prune(found: Collection[Orphan], rows: int, *, force: bool) -> None:
    """Remove results without their recordings.

    Args:
        rows: number of recordings of the study. With fewer of them than orphans a disk may be missing.

    Raises:
        UsageError: there are more orphans than recordings, and `force` is not given.
        OutputError: a file cannot be removed.
    """
    if len(found) > rows and not force:
        what = f"--prune would remove {counted(len(found), 'result')}, more than the {rows} that stay"
        raise UsageError(what, hint="check that all disks are there; --force removes them")
    for one in found:
        stem = one.report.name.removesuffix(jobs.REPORT_SUFFIX)
        remove_all(jobs.Job(one.report, one.report.with_name(stem + jobs.PARQUET_SUFFIX), one.report))
