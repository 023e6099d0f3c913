"""Whose results OUT holds, and which of them belong to no recording any more.

OUT belongs to the folders of its last run. A folder is known again by its path, by its number on its disk, or
by the recordings that it holds: moved, copied, linked or mounted elsewhere, it is the same.

A result is an orphan if a study made it and the disk says that nothing is there now, neither at the path in
its report nor at its place in the study. Messages name them, and `--prune` removes them. Nothing is removed
where the disk cannot tell. A folder that holds no recording of an earlier run, or is on another disk than
then, may be that of a disk that is away. Then a result stays unless its recording is elsewhere in the study.
"""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import (
    AccelcalError,
    OutputError,
    Reason,
    UnreadableError,
    UsageError,
    printable,
)
from accelcal_cli.core.paths import files_below, is_there, matching
from accelcal_cli.core.paths import stat_or_none as look
from accelcal_cli.output.decisions import content
from accelcal_cli.output.files import looking_at, read_columns
from accelcal_cli.output.report_reading import load_our_json, load_report, section, sensor_of
from accelcal_cli.output.sentences import sentence
from accelcal_cli.pipeline import jobs
from accelcal_cli.pipeline.outputs import missing_source_of, place_of_report, remove_all
from accelcal_cli.studies.discovery import SUMMARY, Where, places
from accelcal_cli.studies.other_recordings import PREFIX
from accelcal_cli.studies.records import Item
from accelcal_cli.studies.sensors import report_of_all
from accelcal_cli.studies.study import WHOLE, Study

SUMMARY_NAME = f"{WHOLE.basename}{SUMMARY[-1]}"
IDENTITY = ("path", "bytes", "sha256", "sensor")
FOLDERS = "folders"
"""Key in `provenance` of `study.json`: the folders of a run."""
COMPARED = 3
"""Number of recordings, most of which are the same in a folder that is known again by what it holds."""
MOST_DISKS = 1000
"""Bound on the number of subfolders on other disks that are remembered."""


@dataclass(frozen=True, slots=True)
class Folder:
    """A folder of a run, as it is known again.

    Attributes:
        place: where its results are under OUT; empty for a single folder.
        device, number: of its disk, and of itself there.
        disks: numbers of other disks, by the path below it of each folder that holds recordings on one.
    """

    path: str
    place: str
    device: int
    number: int
    disks: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Raise TypeError for what no run writes."""
        if not (isinstance(self.path, str) and isinstance(self.place, str) and isinstance(self.disks, dict)):
            raise TypeError


def folders_now(where: Where, before: Sequence[Folder], known: Collection[Path]) -> list[Folder]:
    """Return the folders of a run.

    Args:
        before: those of the last run, whose disks are remembered while nothing is found on them.
        known: recordings that were found, and that an earlier run found too.
    """
    old, found = {one.place: one.disks for one in before}, []
    for folder, place in places(where):
        device, number = numbers_of(folder)
        disks = dict(old.get(place, {}))
        for below in sorted({one.parent for one in known if one.is_relative_to(folder)}):
            name = below.relative_to(folder).as_posix()
            disks[name] = numbers_of(below)[0]
        others = {name: one for name, one in disks.items() if one != device}
        path, some = str(jobs.resolved_path(folder)), dict([*others.items()][:MOST_DISKS])
        found.append(Folder(path, place, device, number, some))
    return found


def folders_before(study: Study, items: Sequence[Item]) -> list[Folder]:
    """Return the folders of the last run in OUT; none if that is not known, or they are others and replaced.

    Args:
        items: all files that were found now.

    Raises:
        UsageError: they are others, and `force` is not given.
    """
    (before, table), now = _remembered(study), {place: folder for folder, place in places(study.where)}
    for one in before:
        folder = now.get(one.place)
        if folder is not None and _is_same(folder, one, items, table):
            continue
        if study.request.force:
            return []
        named = " and ".join(printable(jobs.resolved_path(folder)) for folder in study.where.folders)
        theirs = " and ".join(printable(held.path) for held in before)
        raise UsageError(
            f"holds the results of {theirs}, not of {named}",
            path=study.out,
            hint="choose another folder with -d, or replace them with --force",
        )
    return before


def _remembered(study: Study) -> tuple[list[Folder], Path]:
    """Return the folders that the summary of the last run names, of the study or of a part, and its table."""
    names = dict.fromkeys((study.shard.basename, WHOLE.basename))
    with looking_at(study.out):
        parts = matching(study.out, f"study.*-of-*{SUMMARY[-1]}")[:1]
    for path in (*(study.out / f"{name}{SUMMARY[-1]}" for name in names), *parts):
        told = section(load_our_json(path) or {}, "provenance").get(FOLDERS)
        if isinstance(told, list) and told:
            with contextlib.suppress(TypeError):  # which others may have changed
                return [Folder(**one) for one in told], path.with_suffix(SUMMARY[0])
    return [], study.out


def numbers_of(folder: Path) -> tuple[int, int]:
    """Return the numbers of a folder's disk and of the folder on it; zeros where the disk cannot tell."""
    try:
        found = look(folder)
    except OSError:
        found = None
    return (0, 0) if found is None else (found.st_dev, found.st_ino)


def _is_same(folder: Path, before: Folder, items: Sequence[Item], table: Path) -> bool:
    """Return True if a folder is that of the last run.

    Its path or its number is the same, and a recording of then is there with its name and size. Without one,
    both must be. Else half of the recordings must be there, and most of some by their content.

    Args:
        items: all files that were found now; table: that of the last run.
    """
    signs = [
        str(jobs.resolved_path(folder)) == before.path,
        numbers_of(folder) == (before.device, before.number),
    ]
    if all(signs):
        return True
    place = before.place
    found, known = {printable(item.name): item for item in items}, {}
    with contextlib.suppress(AccelcalError):
        for row in read_columns(table, IDENTITY).to_pylist():
            if row["path"].startswith(place):
                known[row["path"] if row["sensor"] is None else row["path"].rpartition(" [")[0]] = row
    there = [
        (found[name].size, found[name].source, row.get("sha256"))
        for name, row in known.items()
        if name in found and found[name].size == row.get("bytes")
    ]
    if any(signs) and (there or not known):
        return True
    compared = sorted(there)[:COMPARED]
    same = sum(jobs.sha256(source) == hash_ for _, source, hash_ in compared)
    return 2 * len(there) >= len(known) and 2 * same > len(compared)


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


@dataclass
class Orphans:
    """Finds the results whose recording is gone.

    Args:
        reports: reports of all recordings that the study found, whether it works on them or not.
        rows: rows of the study's table, whose content tells recordings that were renamed.
        wholes: files whose sensors are known, by the report that each would have as one recording.
        before: folders of the last run; none if that is not known.
        known: recordings that were found, and that an earlier run found too.
        looks: False for none.

    Attributes:
        found: the results, by name.
        sizes: of recordings that are gone, perhaps to another name.
        away: number of results that stay since their disk may be away, by the folder where it may be.
    """

    where: Where
    reports: Collection[Path]
    rows: Collection[Mapping[str, Any]]
    wholes: Mapping[Path, Path]
    before: Sequence[Folder]
    known: Collection[Path]
    looks: bool
    found: list[Orphan] = field(default_factory=list)
    sizes: set[int] = field(default_factory=set)
    away: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Look through OUT."""
        self._names = {content(row): row["path"] for row in self.rows if row.get("sha256")}
        self._holding = {folder for one in self.known for folder in one.parents}
        for folder, folders, files in files_below(self.where.out, []) if self.looks else ():
            if folder != self.where.out and load_our_json(folder / SUMMARY_NAME) is not None:
                folders.clear()  # another study
                continue
            folders[:] = sorted(name for name in folders if name[0] != ".")
            for file in files:
                path = folder / file
                if not file.endswith(jobs.REPORT_SUFFIX) or path in self.reports or file.startswith(PREFIX):
                    continue
                if (reason := self._why(path)) is not None:
                    self.found.append(Orphan(path.relative_to(self.where.out).as_posix(), path, reason))
        self.found.sort(key=lambda one: one.name)

    def _why(self, path: Path) -> Reason | None:
        """Return why nothing belongs to a report any more; None if something does, or nobody can tell."""
        held = _held(path)
        if held is None or (reason := _sensor_gone(path, held[0], self.wholes)) is not None:
            return None if held is None else reason
        report, source = held
        known = place_of_report(report)
        ours = self._was_ours(source or known, gone=source is not None)
        spots = [*self._spots(path.relative_to(self.where.out), known.name)]
        stays = source is None if ours else not _made_by_study(report)
        if stays or any(map(is_there, spots)):
            return None
        now = self._names.get((report["recording"]["sha256"], sensor_of(report)))
        if now is None and any(map(self._may_be_away, spots)):
            return None
        name, folder = printable(known.name), printable(known.parent)
        if now is not None:
            return Reason.of("recording_renamed", source=name, now=now)
        self.sizes.add(report["recording"]["bytes"])
        elsewhere = Reason.of("recording_elsewhere", source=name, folder=folder)
        return Reason.of("recording_gone", source=name) if ours else elsewhere

    def _was_ours(self, source: Path, *, gone: bool) -> bool:
        """Return True if a recording was in a folder of the study, or is gone from one of the last run."""
        last = [Path(one.path) for one in self.before] if gone else []
        return any(
            source.is_relative_to(one) for one in (*map(jobs.resolved_path, self.where.folders), *last)
        )

    def _spots(self, below: Path, file: str) -> Iterator[Path]:
        """Yield where a recording must be now whose result has a path below OUT."""
        name = below.with_name(file).as_posix()
        return (folder / name.removeprefix(at) for folder, at in places(self.where) if name.startswith(at))

    def _may_be_away(self, spot: Path) -> bool:
        """Return True if a disk may be missing where a recording was; count its result then.

        The nearest folder that is there holds no recording of an earlier run, or its disk is another one.
        """
        nearest = next((one for one in spot.parents if is_there(one)), spot)
        root, place = next(one for one in places(self.where) if spot.is_relative_to(one[0]))
        below = nearest.relative_to(root) if nearest.is_relative_to(root) else Path()
        last = next((one for one in self.before if one.place == place), None)
        disks = {} if last is None else last.disks
        names = (below.as_posix(), *(one.as_posix() for one in below.parents))
        device = next((disks[one] for one in names if one in disks), None if last is None else last.device)
        if nearest in self._holding and device in (None, numbers_of(nearest)[0]):
            return False
        shown = f"{place}{below.as_posix()}" if below.parts else str(nearest)
        self.away[shown] = self.away.get(shown, 0) + 1
        return True


def _sensor_gone(path: Path, report: dict[str, Any], wholes: Mapping[Path, Path]) -> Reason | None:
    """Return the reason if a report is of a sensor that its file no longer has; else None."""
    sensor = sensor_of(report)
    whole = None if sensor is None else report_of_all(path, sensor)
    source = None if whole is None else wholes.get(whole)
    if sensor is None or source is None or place_of_report(report) != jobs.resolved_path(source):
        return None
    return Reason.of("sensor_gone", source=printable(source.name), sensor=printable(sensor))


def _held(path: Path) -> tuple[dict[str, Any], Path | None] | None:
    """Return a report, and where its recording was if that is gone; None if the disk cannot tell."""
    try:
        report = load_report(path)
        return None if report is None else (report, missing_source_of(report))
    except (OutputError, UnreadableError):
        return None


def _made_by_study(report: dict[str, Any]) -> bool:
    command = section(report, "provenance").get("command")
    return isinstance(command, list) and not {"study", "accelcal.study"}.isdisjoint(map(str, command[:2]))


def prune(found: Collection[Orphan]) -> None:
    """Remove results without their recordings; raises OutputError if a file cannot be removed."""
    for one in found:
        stem = one.report.name.removesuffix(jobs.REPORT_SUFFIX)
        remove_all(jobs.Job(one.report, one.report.with_name(stem + jobs.PARQUET_SUFFIX), one.report))
