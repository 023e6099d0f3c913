"""Results in OUT whose recording is gone or has another name now: found, told, and removed by `--prune`.

A result is one of these only if its recording was in a folder of the study, and the disk says that nothing is
there now, neither at the path in its report nor at its place in the study. Nothing is removed where the disk
cannot tell. A folder that is empty or cannot be listed may be that of a disk that is away. Then a result
stays unless its recording is elsewhere in the study.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import OutputError, Reason, UnreadableError, UsageError, counted, printable
from accelcal_cli.core.paths import files_below, is_there, may_be_away
from accelcal_cli.output.report_reading import load_report, sensor_of
from accelcal_cli.output.sentences import sentence
from accelcal_cli.pipeline import jobs
from accelcal_cli.pipeline.outputs import missing_source_of, place_of_report, remove_all
from accelcal_cli.studies.discovery import Where, places
from accelcal_cli.studies.other_recordings import PREFIX
from accelcal_cli.studies.sensors import report_of_all
from accelcal_cli.studies.summary import Content, content


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


def orphans(
    where: Where, known: Collection[Path], rows: Collection[Mapping[str, Any]], wholes: Mapping[Path, Path]
) -> list[Orphan]:
    """Return the results whose recording is gone, by name.

    Args:
        known: reports of all recordings that the study found, whether it works on them or not.
        rows: rows of the study's table, whose content tells recordings that were renamed.
        wholes: files whose sensors are known, by the report that each would have as one recording.
    """
    names = {content(row): row["path"] for row in rows if row.get("sha256")}
    found: list[Orphan] = []
    for folder, folders, files in files_below(where.out, []):
        folders[:] = [name for name in folders if name[0] != "."]
        for file in files:
            path = folder / file
            if not file.endswith(jobs.REPORT_SUFFIX) or path in known or file.startswith(PREFIX):
                continue
            if (reason := _why(path, where, names, wholes)) is not None:
                found.append(Orphan(path.relative_to(where.out).as_posix(), path, reason))
    return sorted(found, key=lambda one: one.name)


def _why(
    path: Path, where: Where, names: Mapping[Content, str], wholes: Mapping[Path, Path]
) -> Reason | None:
    """Return why nothing belongs to a report any more; None if something does, or nobody can tell."""
    try:
        report = load_report(path)
        source = None if report is None else missing_source_of(report)
    except (OutputError, UnreadableError):
        return None
    if report is None or source is None:
        return None if report is None else _sensor_gone(path, report, wholes)
    now = names.get((report["recording"]["sha256"], sensor_of(report)))
    if _is_elsewhere(source, path.relative_to(where.out), where) or (now is None and may_be_away(source)):
        return None
    if now is None:
        return Reason.of("recording_gone", source=printable(source.name))
    return Reason.of("recording_renamed", source=printable(source.name), now=now)


def _sensor_gone(path: Path, report: dict[str, Any], wholes: Mapping[Path, Path]) -> Reason | None:
    """Return the reason if a report is of a sensor that its file no longer has; else None."""
    sensor = sensor_of(report)
    whole = None if sensor is None else report_of_all(path, sensor)
    source = None if whole is None else wholes.get(whole)
    if sensor is None or source is None or place_of_report(report) != jobs.resolved_path(source):
        return None
    return Reason.of("sensor_gone", source=printable(source.name), sensor=printable(sensor))


def _is_elsewhere(source: Path, below: Path, where: Where) -> bool:
    """Return True if a recording was in no folder of the study, or is at the place of its result there."""
    if not any(source.is_relative_to(jobs.resolved_path(folder)) for folder in where.folders):
        return True
    name = below.with_name(source.name).as_posix()
    spots = [folder / name.removeprefix(place) for folder, place in places(where) if name.startswith(place)]
    return any(map(is_there, spots))


def refuse_too_many(found: Collection[Orphan], rows: int, *, force: bool) -> None:
    """Refuse to remove more results than stay: a disk may be missing.

    Args:
        rows: number of recordings of the study.

    Raises:
        UsageError: there are more orphans than recordings, and `force` is not given.
    """
    if len(found) > rows and not force:
        what = f"--prune would remove {counted(len(found), 'result')}, more than the {rows} that stay"
        hint = "check that all disks are there; --force removes them, and calibrates all recordings again"
        raise UsageError(what, hint=hint)


def prune(found: Collection[Orphan]) -> None:
    """Remove results without their recordings; raises OutputError if a file cannot be removed."""
    for one in found:
        stem = one.report.name.removesuffix(jobs.REPORT_SUFFIX)
        remove_all(jobs.Job(one.report, one.report.with_name(stem + jobs.PARQUET_SUFFIX), one.report))
