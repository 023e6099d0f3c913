"""The files of a study and which of them are recordings; files that a study itself wrote.

OUT may be the study's folder itself, and a recording or another program's table may have the name of a file
that a study writes: these are recognised by name and content.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
import stat
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from accelcal_cli.core.errors import (
    AccelcalError,
    NoRecordingError,
    OutputError,
    Reason,
    UnreadableError,
    UsageError,
)
from accelcal_cli.core.formats import Format, Probe, ReadOptions, is_text, probe_file, without
from accelcal_cli.core.input_files import ANY, ARCHIVES, files_of, is_no_part, pattern_of_siblings
from accelcal_cli.core.paths import files_below, is_file, is_folder, is_link, is_there
from accelcal_cli.core.paths import stat_or_none as look
from accelcal_cli.core.system import TookTooLongError, bounded_memory, bounded_time
from accelcal_cli.core.unpacking import plain_name
from accelcal_cli.formats import (
    all_formats,
    archive_around,
    belongs_to,
    named_format,
    refuse_other_files,
    refuse_others,
)
from accelcal_cli.formats.raw import folder_layout, named_layout
from accelcal_cli.formats.tables import bids_channels_path
from accelcal_cli.output import decisions
from accelcal_cli.output.files import is_page, looking_at, stored_schema
from accelcal_cli.output.report_reading import load_our_json
from accelcal_cli.pipeline import jobs
from accelcal_cli.pipeline.options import fits_pattern
from accelcal_cli.studies.records import Item, is_ledger

# Which files of a study are not its recordings, and why: by their names, and by their content.
#
# Whatever has the suffix of a device's files, the header of a table of acceleration, or an archive
# around it is a recording: it is calibrated, refused, or fails with its reason. Everything else is
# named with a reason.

TABLES = "csv"
"""Name of the one format whose suffixes other files often have."""

LONGEST_LOOK_S, LARGEST_LOOK_BYTES = 30.0, 1 << 32
"""Time and memory within which a file is looked into."""

UNFINISHED = (
    ".part", ".partial", ".crdownload", ".download", ".filepart", ".opdownload", ".tmp", ".aria2", ".!ut",
    ".icloud", ".swp",
)  # fmt: skip
"""Ends of the names of downloads and copies that are not finished."""


def why_left_out(item: Item, options: ReadOptions, *, asked_for: bool) -> Reason | None:
    """Return why a file is not one of the study's recordings, by content; None for a recording.

    A file that no format fits is one if its suffix is that of a device's files: it is damaged, and must not
    be ignored silently. So is an archive that the disk does not give, and a text with columns named x, y and
    z, whatever follows.

    Nor may one be ignored that takes long or much memory to look into: its worker has limits of its own.

    Args:
        asked_for: the user named its kind with `--include`.
    """
    try:
        with bounded_time(LONGEST_LOOK_S), bounded_memory(LARGEST_LOOK_BYTES):
            return _looked_into(item, options, asked_for=asked_for)
    except (TookTooLongError, MemoryError):
        return None


def _looked_into(item: Item, options: ReadOptions, *, asked_for: bool) -> Reason | None:
    name = options.format or ("raw" if options.layout is not None else None)
    wanted = all_formats() if name is None else (named_format(name),)
    try:
        if asked_for or files_of(item.source) is not None:
            return None
        if name is None and (packed := archive_around(item.source)) is not None:
            return None if packed else Reason("archive_without_recordings")
        probe = probe_file(item.source, without(options, ("layout",)))
    except UnreadableError as error:
        named = _suffix(item) in _suffixes(all_formats()) or item.source.name.lower().endswith(ARCHIVES)
        return None if named else Reason.of("not_looked_into", fault=error.fault)
    scores = [one.sniff(probe) for one in wanted]
    if (best := max(scores)) > 0:
        return _why_not_this(wanted[scores.index(best)], best, probe, item, options)
    return _why_no_format(wanted, probe, item)


def _why_not_this(form: Format, score: int, probe: Probe, item: Item, options: ReadOptions) -> Reason | None:
    """Return why a file of a format is not a recording; a damaged one may be, and must not be ignored."""
    try:
        refuse_others(form, score, probe)
        if form.is_table:
            form.open(item.source, without(options, form.unused(options))).close()
    except NoRecordingError as error:
        return error.reason
    except AccelcalError:
        pass
    return None


def _why_no_format(wanted: tuple[Format, ...], probe: Probe, item: Item) -> Reason | None:
    """Return what a file is that no format fits; None if its suffix is that of a device's files."""
    if _suffix(item) in _suffixes(tuple(one for one in wanted if one.name != TABLES and not one.is_table)):
        return None
    try:
        refuse_other_files(probe)
    except NoRecordingError as error:
        return error.reason
    except UnreadableError:  # it stands for a recording, such as an archive that is not unpacked
        return None
    return Reason("no_numbers" if is_text(probe.head) else "no_format")


def is_table(item: Item) -> bool:
    """Return True for a file with a suffix that only tables have."""
    return _suffix(item) not in _suffixes(tuple(one for one in all_formats() if one.name != TABLES))


def _suffix(item: Item) -> str:
    return Path(plain_name(item.source.name.lower())).suffix


def _suffixes(formats: tuple[Format, ...]) -> set[str]:
    return {suffix for one in formats for suffix in one.suffixes}


# The files of a study and which of them are recordings; files that a study itself wrote.

NAMES = re.compile(r"study(\.\d+-of-\d+)?\.(csv|json|parquet|ledger|lock)")
"""Names of the files that a study writes into OUT itself."""

SUMMARY = (".parquet", ".csv", ".json")
LONGEST_HEAD = 1 << 16
OF_TABLE = {"path", "outcome", "report"}
"""Columns by which the table of any version is known, wherever they stand."""

OURS = (
    jobs.PARQUET_SUFFIX, jobs.UNCALIBRATED_SUFFIX, jobs.REPORT_SUFFIX, jobs.INTEGERS_SUFFIX,
    jobs.DRAWS_SUFFIX, jobs.QUALITY_SUFFIX, ".toml", ".truth.json",
)  # fmt: skip


def refuse_foreign(out: Path, base: str, recordings: Collection[Path], *, force: bool) -> None:
    """Refuse to overwrite with the summary what no study wrote; a recording not even with `force`.

    Raises:
        OutputError: such a file is in the way.
    """
    for path in (out / f"{base}{suffix}" for suffix in (*SUMMARY, ".ledger")):
        if not is_there(path) or _is_study_file(path):
            continue
        if not force or jobs.resolved_path(path) in set(map(jobs.resolved_path, recordings)):
            what = "would be overwritten by the study's summary, but was not written by accelcal"
            raise OutputError(what, path=path, hint="move it, or choose another folder with -d")


def _is_study_file(path: Path) -> bool:
    """Return True for a summary or a ledger that a study wrote; False for pipes."""
    try:
        if not is_file(path):
            return False
        if path.suffix == ".parquet":
            schema = stored_schema(path)
            return schema is not None and set(schema.names) >= OF_TABLE
        if path.suffix == ".ledger":
            return is_ledger(path)
        if path.suffix == ".csv":
            with path.open("rb") as file:
                return (
                    set(file.readline(LONGEST_HEAD).decode("utf-8", "replace").strip().split(",")) >= OF_TABLE
                )
        return "recordings" in (load_our_json(path) or {})
    except (OSError, OutputError, UnreadableError, ValueError):
        return False


@dataclass(frozen=True, slots=True)
class Where:
    """Where a study looks for recordings, and for which.

    Attributes:
        folders: folders of the study; each of several has a folder of its own name under OUT.
        out: folder of the outputs.
        include: patterns of names (or of paths under the folder) of files that are started; empty for all.
        exclude: patterns of files that are left out.
    """

    folders: tuple[Path, ...]
    out: Path
    include: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()


Left = dict[str, Reason]
"""Why files are left out, by their names in the study."""


def files(where: Where, notes: list[str], left: Left | None = None) -> list[Item]:
    """Return all files that may be recordings, by name.

    Args:
        notes: receives a line for each link to a folder that was not followed.
        left: receives the files that are left out by their names or as what they are.

    Raises:
        UsageError: one of them is not a folder, or two would share one place under OUT.
    """
    links = _Links([jobs.resolved_path(folder) for folder in where.folders], notes)
    left = {} if left is None else left
    found = [item for folder, place in places(where) for item in _folder(where, folder, place, links, left)]
    return sorted(_apart([*_with_sets(where, found)]), key=lambda item: item.name)


def _with_sets(where: Where, items: list[Item]) -> Iterator[Item]:
    """Replace the items of the files of a recording in parts, and of their logs, by one item."""
    sets: dict[Path | None, list[Item]] = {}
    for item in items:
        sets.setdefault(pattern_of_siblings(item.source), []).append(item)
    single, folders = sets.pop(None, []), {one.parent for one in sets if one is not None}
    yield from (item for item in single if item.source.parent not in folders or not is_no_part(item.source))
    for pattern, members in sets.items():
        assert pattern is not None
        try:
            every = set(files_of(pattern) or ())
        except UnreadableError as error:  # parts must not be read as recordings because of a disk
            yield from (replace(item, refusal=error.line_for((item.source,))) for item in members)
            continue
        whole = len(members) > 1 and {item.source for item in members} == every
        yield from [_set(where, pattern, members)] if whole else members


def _set(where: Where, pattern: Path, members: list[Item]) -> Item:
    """Return the item of all parts of a recording."""
    first = min(members, key=lambda item: item.name)
    beside = first.source.relative_to(_root(where, first.source))
    folder = Path(first.name[: len(first.name) - len(beside.as_posix())])
    name = (folder / pattern.relative_to(_root(where, first.source))).as_posix()
    place = where.out.joinpath(*(part for part in Path(name).parts[:-1] if part != ANY))
    files = json.dumps([(item.name, item.stamps[0]) for item in sorted(members, key=lambda item: item.name)])
    digest = int.from_bytes(hashlib.sha256(files.encode()).digest()[:7], "big")
    stamps = (jobs.file_stamp(pattern), (len(members), digest))
    aside = all(item.aside for item in members)
    return Item(name, job_at(pattern, place / jobs.stem(pattern)), stamps, aside=aside)


def _root(where: Where, source: Path) -> Path:
    """Return the study's folder that contains a file."""
    return next(folder for folder in where.folders if source.is_relative_to(folder))


@dataclass(frozen=True, slots=True)
class _Links:
    """Decides which links to folders are followed: not those that lead to a folder that is searched anyway.

    Attributes:
        roots: real paths of the folders that are searched.
    """

    roots: list[Path]
    notes: list[str]

    def follows(self, folder: Path) -> bool:
        """Return True to go into a folder, which then counts as searched."""
        if not is_link(folder):
            return True
        target = jobs.resolved_path(folder)
        for root in self.roots:
            if target.is_relative_to(root) or root.is_relative_to(target):
                self.notes.append(f"the link {folder} is not followed: {target} is gone through as it is")
                return False
        self.roots.append(target)
        return True


def _apart(items: list[Item]) -> Iterator[Item]:
    """Give a table next to a device's file of the same STEM, such as its export, its full name as STEM."""
    devices = {item.job.report for item in items if not is_table(item)}
    for item in items:
        report, source = item.job.report, item.source
        beside = is_table(item) and report in devices
        yield replace(item, job=job_at(source, report.with_name(source.name))) if beside else item


def job_without_others(item: Item) -> jobs.Job:
    """Return the job that a recording has if no other one of its folder shares its STEM."""
    return job_at(item.source, item.job.report.parent / jobs.stem(item.source))


def job_at(source: Path, target: Path) -> jobs.Job:
    """Return the job whose outputs have the path `target` and the usual suffixes."""
    parquet = target.with_name(target.name + jobs.PARQUET_SUFFIX)
    return jobs.Job(source, parquet, target.with_name(target.name + jobs.REPORT_SUFFIX))


def below_out(where: Where) -> list[Item]:
    """Return the files that are ignored because they lie below OUT, which is below a folder itself."""
    items: list[Item] = []
    every = replace(where, include=(), exclude=())
    for folder, place in places(where):
        if jobs.resolved_path(folder) in jobs.resolved_path(where.out).parents and is_folder(where.out):
            out = jobs.resolved_path(where.out).relative_to(jobs.resolved_path(folder))
            for item in _folder(every, folder / out, f"{place}{out.as_posix()}/", _Links([], []), {}):
                below = item.name.removeprefix(place)
                included = not where.include or fits_pattern(below, where.include)
                if included and not fits_pattern(below, where.exclude):
                    items.append(item)
    return items


def places(where: Where) -> list[tuple[Path, str]]:
    """Return each folder with its place under OUT; raises UsageError for what is not a folder."""
    for folder in where.folders:
        with looking_at(folder, UsageError):
            found = look(folder)
        if found is None or not stat.S_ISDIR(found.st_mode):
            raise UsageError("is not a folder", path=folder, hint="give the folder of the recordings")
    if len(where.folders) == 1:
        return [(where.folders[0], "")]
    names = [jobs.resolved_path(folder).name for folder in where.folders]
    twice = sorted(name for name in set(names) if names.count(name) > 1)
    if twice:
        hint = "run a separate study for each, into another folder"
        raise UsageError(f"several folders are called {twice[0]}", hint=hint)
    return [(folder, f"{name}/") for folder, name in zip(where.folders, names, strict=True)]


def _folder(where: Where, folder: Path, place: str, links: _Links, left: Left) -> Iterator[Item]:
    out = jobs.resolved_path(where.out)
    unlisted: list[OSError] = []
    for base, folders, names in files_below(folder, unlisted, follow=True):
        at_out = jobs.resolved_path(base) == out
        folders[:] = _subfolders(base, folders, out, links)
        if base != folder and at_out:
            folders.clear()
            continue
        for name in names:
            path = base / name
            if _never(path) or (name == decisions.NAME and at_out):
                continue
            below = path.relative_to(folder).as_posix()
            aside = bool(where.include) and not fits_pattern(below, where.include)
            if (reason := _why_by_name(path, below, where)) is not None:
                left[place + below] = reason
            else:
                yield replace(_item(where, path, place + below), aside=aside)
    for error in unlisted:
        path = Path(str(error.filename))
        item = _item(where, path, place + path.relative_to(folder).as_posix())
        yield replace(item, refusal=f"the folder cannot be listed ({error.strerror})")


def _subfolders(base: Path, names: list[str], out: Path, links: _Links) -> list[str]:
    """Return the subfolders to go into, in order: not hidden ones, nor OUT unless it is `base` itself."""
    shown = sorted(name for name in names if name[0] != ".")
    if jobs.resolved_path(base) != out:
        shown = [name for name in shown if jobs.resolved_path(base / name) != out]
    return [name for name in shown if links.follows(base / name)]


def _never(path: Path) -> bool:
    """Return True for what is nobody's recording and is not named: hidden, an output, options, a layout."""
    name = path.name
    if name.startswith(".") or name.endswith(OURS):
        return True
    with contextlib.suppress(OutputError):
        if path.suffix == ".html" and is_page(path):
            return True
    return NAMES.fullmatch(name) is not None and (path.suffix not in SUMMARY or _is_study_file(path))


def _why_by_name(path: Path, below: str, where: Where) -> Reason | None:
    """Return why a file is left out by its name or as what it is; None if its content decides."""
    if (suffix := path.suffix.lower()) in UNFINISHED:
        return Reason.of("unfinished_copy", suffix=suffix)
    if fits_pattern(below, where.exclude):
        return Reason.of("excluded", by="--exclude")
    if (whole := belongs_to(path)) is not None:
        return Reason.of("belongs_to_another", name=whole.name)
    with contextlib.suppress(OSError):  # a broken link, too, is a recording that cannot be read
        if (found := look(path)) is not None and not stat.S_ISREG(found.st_mode):
            return Reason("not_a_file")
    return None


def _item(where: Where, path: Path, name: str) -> Item:
    channels = bids_channels_path(path)
    beside = (named_layout(path), folder_layout(path), *(() if channels is None else (channels,)))
    stamps = tuple(map(jobs.file_stamp, (path, *beside)))
    return Item(name, job_at(path, (where.out / name).parent / jobs.stem(path)), stamps)


def without_collisions(items: list[Item]) -> list[Item]:
    """Refuse recordings that share their STEM in one folder, each with the others' names."""
    owners: dict[Path, list[Item]] = {}
    for item in items:
        owners.setdefault(item.job.report, []).append(item)
    apart: list[Item] = []
    for item in items:
        others = ", ".join(one.source.name for one in owners[item.job.report] if one is not item)
        refusal = f"would share its outputs with {others}: rename one, or use --exclude"
        apart.append(replace(item, refusal=refusal) if others else item)
    return apart


def recordings_in(paths: Sequence[Path], options: ReadOptions) -> list[Path]:
    """Return recordings, those in folders found as a study finds them; raises what `files` raises."""
    found: list[Path] = []
    for path in paths:
        if is_folder(path):
            items = files(Where((path,), path), [])
            found += [one.source for one in items if why_left_out(one, options, asked_for=False) is None]
        else:
            found.append(path)
    return found
