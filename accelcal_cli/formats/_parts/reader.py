"""Recordings in several files, read one at a time: in a folder, or in an archive.

The parts of a recording are joined in the order of their times: a missing part is a gap, a repeated one is
read once, and one that cannot be read is reported. An archive may hold one recording alone, which is read by
its own reader, or an export of which one file is the recording; around several it is refused unless they are
parts. The files of a session are recordings of their own.
"""

from __future__ import annotations

import os
import re
import shlex
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

import numpy as np

from accelcal_cli.core.clock import MICROSECONDS, StampClock
from accelcal_cli.core.errors import (
    AccelcalError,
    NoFormatError,
    NoRecordingError,
    OutputError,
    UnreadableError,
    UsageError,
    counted,
    listed,
    printable,
)
from accelcal_cli.core.input_files import (
    ARCHIVES,
    files_of,
    is_no_part,
    is_pattern,
    pattern_of_siblings,
    size_of,
)
from accelcal_cli.core.local_time import NO_START
from accelcal_cli.core.paths import is_file, is_folder
from accelcal_cli.core.recording import (
    CUT_SHORT,
    Chunk,
    PlacedFile,
    Problem,
    Reader,
    Recording,
    others_as,
)
from accelcal_cli.core.system import new_folder, remove_folder
from accelcal_cli.formats._parts import archive
from accelcal_cli.formats._parts.archive import PartFiles
from accelcal_cli.formats._stamps import GAP_PERIODS

SHORTEST_OVERLAP_S, RATE_AGREEMENT = 1.0, 0.05
"""Shortest overlap of parts that is a repetition, and the share by which their rates may differ."""

LISTED, SHOWN = 50, 3
"""Problems of a kind that are listed one by one, and names that are shown."""

OFFICE = "[Content_Types].xml"
"""First member of an Office Open XML file (ECMA-376)."""

SAVE_AS_CSV = "it is a workbook or document of an office program: save its table as CSV"
ARCHIVE = "is an archive: unpack it first"
"""Message for an archive in an archive, or in a folder of parts."""

Open = Callable[[Path], Reader]
"""Opens one part; raises NoFormatError for a file that is not a recording."""


AnyReader = TypeVar("AnyReader", bound=Reader)


def open_parts(
    path: Path,
    open_part: Open,
    kind: Callable[[Path, PartFiles, Open], AnyReader],
    threads: int = 1,
    *,
    joined: bool,
    belongs_to: Callable[[Path], Path | None],
) -> AnyReader:
    """Open a recording of several files: a folder, a pattern, or an archive.

    Args:
        kind: the class of reader, `PartsReader` or `SessionReader`.
        threads: how many may work at a time on unpacking an archive.
        joined: the recordings in an archive are parts of one, whatever their names.
        belongs_to: see `Format`.

    Raises:
        UnreadableError: none can be read, does not say when it begins, or they are not of one recording.
        UsageError: they are of several devices, or an option contradicts them.
        OutputError: there is no room to unpack an archive.
    """
    files = files_of(path)
    if files is not None:
        part_files = PartFiles({file: file.name for file in files}, joined=joined)
        return kind(path, _without_siblings(part_files, belongs_to), open_part)
    try:
        folder = new_folder()
    except OSError as error:
        what, hint = f"no temporary folder can be made ({error.strerror or error})", archive.MORE_SPACE
        raise OutputError(what, path=error.filename, hint=hint) from error
    try:
        part_files = archive.unpack(path, folder, lambda name: not is_no_part(Path(name)), threads)
        part_files.joined = joined
        with _naming(path, part_files):
            return kind(path, _without_siblings(part_files, belongs_to), open_part)
    except BaseException:
        remove_folder(folder)
        raise


@contextmanager
def _naming(archived: Path, part_files: PartFiles) -> Iterator[None]:
    """Let errors name the member of an archive, with its folders there, not the file it was unpacked to."""
    try:
        yield
    except AccelcalError as error:
        if (folder := part_files.folder) is not None:
            unpacked = re.compile(rf"{re.escape(str(folder))}(?:/(\d+))?/?")
            places = {}
            for path, name in part_files.names.items():
                number, *within = path.relative_to(folder).parts
                places[number] = name[: max(0, len(name) - len("/".join(within)))].lstrip("/")

            def in_archive(found: re.Match[str]) -> str:
                return places.get(found[1], "")

            if error.path is not None and unpacked.match(str(error.path)):
                error.path = archived / unpacked.sub(in_archive, str(error.path))
            error.message = unpacked.sub(in_archive, error.message)
            error.hint = error.hint and unpacked.sub(in_archive, error.hint)
        raise


def _without_siblings(part_files: PartFiles, belongs_to: Callable[[Path], Path | None]) -> PartFiles:
    """Set aside what belongs to another file: further sensors of an export, and what describes it."""
    of_another = [file for file in part_files.names if belongs_to(file) is not None]
    part_files.aside += [printable(file.name) for file in of_another]
    for file in of_another:
        del part_files.names[file]
    return part_files


class FilesReader(Reader):
    """Reads a recording of several files, one at a time."""

    _sizes: Sequence[int]
    """Bytes of each file, in the order of reading."""

    def __init__(self, part_files: PartFiles, open_part: Open) -> None:
        self._part_files, self._open_part = part_files, open_part

    def close(self) -> None:
        """See `Closing`; removes what was unpacked."""
        if self._part_files.folder is not None:
            remove_folder(self._part_files.folder)

    def _named(self) -> AbstractContextManager[None]:
        return _naming(self.recording.path, self._part_files)

    def _open(self, path: Path) -> Reader:
        reader = self._open_part(path)
        reader.threads = self.threads
        return reader

    def _share(self, number: int, end_byte: int) -> int:
        """Return how far into the recording a place within a file is [bytes], for progress."""
        before = sum(self._sizes[:number]) + end_byte
        return self.recording.total_bytes * before // max(sum(self._sizes), 1)


class PartsReader(FilesReader):
    """Reads `parts` in the order of their times; these are what the header of each says."""

    def __init__(self, path: Path, part_files: PartFiles, open_part: Open) -> None:
        super().__init__(part_files, open_part)
        described = self._described(path)
        undated = [part.path for part in described if part.start_us is None]
        if undated and len(described) > 1 and part_files.joined:
            hint = "the parts need times; join them to one file instead, if they follow each other"
            raise UnreadableError("does not say when it begins", path=undated[0], hint=hint)
        described.sort(key=lambda part: (part.start_us or 0, part.path.name))
        if not part_files.joined:
            self._refuse_several(path, described)
        self.parts = self._alike(path, described)
        self._sizes = [part.path.stat().st_size for part in self.parts]
        if part_files.damage is not None:
            lost = Problem(CUT_SHORT, part_files.damage, None, 0, lost_bytes=part_files.lost_bytes)
            part_files.problems.append(lost)
        self.recording = _as_one(path, self.parts, part_files)

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """See `Reader`; reads a part at a time."""
        joint = _PartPlacer(self.recording, self._part_files.problems, named=len(self.parts) > 1)
        for number, part in enumerate(self.parts):
            with self._named(), self._open(part.path) as reader:
                reader.with_others = self.with_others and bool(part.others)
                for chunk in reader.chunks(chunk_samples):
                    placed = joint.placed(part, chunk, self._share(number, chunk.end_byte))
                    if len(placed) or placed.problems:
                        yield placed
            joint.end_of_part(part)
        end = joint.end()
        if end.problems:
            yield end

    def preview(self, chunk_samples: int, pieces: int) -> Iterator[Chunk]:
        """See `Reader`; takes the beginnings of parts spread over the recording."""
        step = max(1, len(self.parts) // pieces)
        for number, part in enumerate(self.parts[::step][:pieces]):
            with self._named(), self._open(part.path) as reader:
                for chunk in reader.preview(chunk_samples, 1):
                    yield replace(_stripped(chunk, self.recording), end_byte=self._share(number * step, 0))

    def _described(self, path: Path) -> list[Recording]:
        """Return the parts that can be read."""
        parts: list[Recording] = []
        failures: list[tuple[Path, UnreadableError]] = []
        for file in self._part_files.names:
            try:
                with self._open(file) as reader:
                    parts.append(reader.recording)
            except (NoFormatError, NoRecordingError) as error:
                if isinstance(error, NoFormatError) and archive.is_archive(file):
                    failures.append((file, UnreadableError(ARCHIVE, path=file)))
                else:
                    self._part_files.aside.append(file.name)
            except UnreadableError as error:
                failures.append((file, error))
        if not parts and failures:
            raise failures[0][1]
        if not parts:
            of_office = is_file(path) and OFFICE in archive.first_names(path, 1)
            damage = "" if self._part_files.damage is None else f"; {self._part_files.damage}"
            text, hint = f"holds no parts of a recording{damage}", SAVE_AS_CSV if of_office else None
            raise UnreadableError(text, path=path, hint=hint)
        self._sort_out(parts, failures)
        return parts

    def _sort_out(self, parts: Sequence[Recording], failures: Sequence[tuple[Path, UnreadableError]]) -> None:
        """Report files that cannot be read: damaged parts, or if no part has their suffix other files."""
        suffixes = {part.path.suffix.lower() for part in parts}
        tables = {part.format for part in parts} == {"csv"}
        for file, error in failures:
            joined, size = self._part_files.joined, file.stat().st_size
            is_other = size == 0 or (tables and not joined and not error.sensors)
            if not is_other and (joined or file.suffix.lower() in suffixes):
                name = printable(self._part_files.names[file])
                text = f"part {name} cannot be read: {printable(error.message)}"
                self._part_files.problems.append(Problem("unreadable_part", text, None, 0, 1, size))
            else:
                why = f" ({ARCHIVE})" if error.message == ARCHIVE else ""
                self._part_files.aside.append(file.name + why)

    def _refuse_several(self, path: Path, parts: Sequence[Recording]) -> None:
        """Raise UnreadableError for an archive of recordings whose names do not say that they are parts."""
        files = [part.path for part in parts]
        broken = [one for one in self._part_files.problems if one.code == "unreadable_part"]
        siblings = {pattern_of_siblings(Path(file.name)) for file in files}
        if len(files) + len(broken) == 1 or (len(siblings) == 1 and None not in siblings):
            return
        names = [printable(file.name) for file in files]
        if len({*names}) < len(names):
            in_archive = self._part_files.names if self._part_files.folder is not None else {}
            names = [printable(in_archive.get(file, str(file))) for file in files]
        some = listed(names) if len(names) <= SHOWN else f"{', '.join(names[:SHOWN])} and more"
        what = f"holds {len(files) + len(broken)} recordings ({some})"
        raise UnreadableError(what, path=path, hint=_unpacking_hint(path))

    def _alike(self, path: Path, parts: list[Recording]) -> list[Recording]:
        """Return the parts that are like the first, as parts of one recording are."""
        serials = sorted({part.device.serial for part in parts if part.device.serial})
        if len(serials) > 1:
            text = f"holds parts of {len(serials)} devices ({listed(serials[:SHOWN])})"
            raise UsageError(printable(text), path=path, hint="name the parts of one by a pattern in quotes")
        kept = []
        for part in parts:
            if (why := unlike(parts[0], part)) is None:
                kept.append(part)
            else:
                text = f"part {part.path.name} was left out: its {why} is not that of the first part"
                size = part.path.stat().st_size
                self._part_files.problems.append(Problem("other_part", printable(text), None, 0, 1, size))
        return kept


def _unpacking_hint(path: Path) -> str:
    """Return how each of several recordings is calibrated: the commands, for a folder or an archive."""
    name = printable(path)
    if is_pattern(path):
        return "name them one by one to calibrate each; with --parts they are parts of one"
    if is_folder(path):
        how = f"`accelcal study {shlex.quote(name)} -d OUT`"
        return f"{how} calibrates each; with --parts they are parts of one"
    folder = next((name[: -len(one)] for one in ARCHIVES if name.lower().endswith(one)), f"{name}_unpacked")
    packed, here = shlex.quote(name), shlex.quote(folder)
    how = f"mkdir {here} && tar -xf {packed} -C {here}"
    if zipfile.is_zipfile(path):
        how = f"unzip {packed} -d {here}"
    return f"`{how}` and `accelcal study {here} -d OUT` calibrate each; with --parts they are parts of one"


def unlike(first: Recording, other: Recording) -> str | None:
    """Return the property by which two files are not of one recording; None if they may be."""
    if abs(other.rate_hz - first.rate_hz) > RATE_AGREEMENT * first.rate_hz:
        return "sampling rate"
    for name, word in (("lsb_per_g", "scale"), ("range_g", "range"), ("timezone", "time zone")):
        one, two = getattr(first, name), getattr(other, name)
        if one != two and None not in (one, two):
            return word
    return None


def _as_one(path: Path, parts: Sequence[Recording], part_files: PartFiles) -> Recording:
    """Return the description of all parts together."""
    first, last = parts[0], parts[-1]
    between = "" if len(parts) == 1 else f"from {first.path.name} to "
    notes = [f"{counted(len(parts), 'part')}, {between}{last.path.name}"]
    if part_files.aside:
        more = f" and {len(part_files.aside) - SHOWN} more" if len(part_files.aside) > SHOWN else ""
        notes.append(f"no recordings, set aside: {', '.join(part_files.aside[:SHOWN])}{more}")
    lasts_s, one_gyroscope = None, len({part.gyro_dps_per_lsb for part in parts}) == 1
    if last.duration_s is not None:
        lasts_s = ((last.start_us or 0) - (first.start_us or 0)) / MICROSECONDS + last.duration_s
    return replace(
        first,
        path=path,
        total_bytes=size_of(path),
        samples=None,
        duration_s=lasts_s,
        companion=first.companion if part_files.folder is None else None,
        has_temperature=all(part.has_temperature for part in parts),
        gyro_dps_per_lsb=first.gyro_dps_per_lsb if one_gyroscope else None,
        others=tuple(dict.fromkeys(column for part in parts for column in part.others)),
        notes=(*first.notes, *map(printable, notes)),
    )


def _stripped(chunk: Chunk, recording: Recording) -> Chunk:
    """Return a chunk without the channels that not all parts have."""
    return replace(
        chunk,
        temperature_mc=chunk.temperature_mc if recording.has_temperature else None,
        gyro_counts=None if recording.gyro_dps_per_lsb is None else chunk.gyro_counts,
    )


class _PartPlacer:
    """Places the chunks of one part after another in the recording."""

    def __init__(self, recording: Recording, problems: Sequence[Problem], *, named: bool) -> None:
        self._recording, self._named = recording, named
        self._period_us = MICROSECONDS / recording.rate_hz
        self._samples, self._first_of_part = 0, 0
        self._last_us: int | None = None
        self._fresh, self._dropped, self._overlaps = True, 0, False
        self._left = list(problems)
        self._reported: dict[str, int] = {}
        self._unlisted: dict[str, Problem] = {}

    def placed(self, part: Recording, chunk: Chunk, end_byte: int) -> Chunk:
        """Return a part's chunk as one of the recording, without rows that earlier parts have, too."""
        begin, name = self._first_of_part, f"{part.path.name}: " if self._named else ""
        problems = [
            replace(
                one,
                sample=begin + max(0, one.sample - self._dropped),
                message=printable(name + one.message) if name else one.message,
            )
            for one in chunk.problems
        ]
        skipped = self._skipped(chunk) if self._fresh and len(chunk) else 0
        kept = chunk.part(skipped, len(chunk)) if skipped else chunk
        self._dropped += skipped
        breaks, jumps = kept.breaks, kept.clock_jumps
        if len(kept) and self._fresh:
            if (jump := self._jump(kept, part)) is not None:
                breaks, jumps = np.union1d([0], breaks), np.union1d([0], jumps)
                problems.append(jump)
            self._fresh = False
        problems_here, self._left = [*self._left, *problems], []
        placed = replace(
            _stripped(others_as(kept, part.others, self._recording.others), self._recording),
            first_sample=self._samples,
            end_byte=end_byte,
            breaks=breaks.astype(np.int64, copy=False),
            clock_jumps=jumps.astype(np.int64, copy=False),
            problems=tuple(one for one in problems_here if self._is_listed(one)),
        )
        if len(kept):
            self._samples += len(kept)
            self._last_us = int(kept.clock.times(len(kept) - 1, len(kept))[0])
        return placed

    def end_of_part(self, part: Recording) -> None:
        """Note a part that repeats rows of the parts before it, and prepare for the next part."""
        if self._dropped:
            whole = "all of it" if self._fresh else counted(self._dropped, "row")
            text = f"part {part.path.name} repeats the time of parts before it: {whole} left out"
            self._left.append(Problem("repeated_part", printable(text), None, self._first_of_part, 1))
        self._fresh, self._dropped, self._overlaps = True, 0, False
        self._first_of_part = self._samples

    def end(self) -> Chunk:
        """Return an empty chunk with the remaining problems."""
        problems = tuple(one for one in self._left if self._is_listed(one))
        nothing, clock = np.empty((0, 3), np.int32), StampClock(np.empty(0, np.int64))
        empty = Chunk(self._samples, nothing, clock, self._recording.total_bytes)
        return replace(empty, problems=(*problems, *self._unlisted.values()))

    def _skipped(self, chunk: Chunk) -> int:
        """Return how many rows at the beginning of a part lie before the end of the one before."""
        if self._last_us is None:
            return 0
        back_s = (self._last_us - int(chunk.clock.times(0, 1)[0])) / MICROSECONDS
        self._overlaps = self._overlaps or back_s >= SHORTEST_OVERLAP_S
        if not self._overlaps:
            return 0
        later = np.flatnonzero(chunk.time_us > self._last_us)
        return int(later[0]) if len(later) else len(chunk)

    def _jump(self, kept: Chunk, part: Recording) -> Problem | None:
        """Return the jump of the clock between two parts; None if it runs on."""
        if self._last_us is None:
            return None
        step = int(kept.clock.times(0, 1)[0]) - self._last_us
        if 0 <= step <= GAP_PERIODS * self._period_us:
            return None
        code, words = ("clock_back", "goes back") if step < 0 else ("clock_gap", "jumps ahead")
        text = f"the time {words} by {abs(step) / MICROSECONDS:g} s before part {part.path.name}"
        return Problem(code, printable(text), None, self._samples)

    def _is_listed(self, problem: Problem) -> bool:
        """Return True for one of the first problems of its kind; count the others."""
        self._reported[problem.code] = self._reported.get(problem.code, 0) + 1
        if self._reported[problem.code] <= LISTED:
            return True
        more = self._unlisted.get(problem.code, replace(problem, count=0, lost_bytes=0, missing_bytes=0))
        text, names = "more of the same in later parts", ("count", "lost_bytes", "missing_bytes")
        sums = {name: getattr(more, name) + getattr(problem, name) for name in names}
        self._unlisted[problem.code] = replace(more, message=text, byte_offset=None, **sums)
        return False


# The files of a session: recordings of their own on one device, such as one of each face, as one
# stream.
#
# They follow one another by name, and their times are moved so that each file begins when the one
# before ends; when they were made, and in which order, does not matter.


class SessionReader(FilesReader):
    """Reads the files of a session.

    Unlike the parts of a recording, all of them are needed: one that cannot be read, or is of another device
    or settings than the first, ends the session.
    """

    def __init__(self, path: Path, part_files: PartFiles, open_part: Open) -> None:
        super().__init__(part_files, open_part)
        if part_files.damage is not None:
            raise UnreadableError(part_files.damage, path=path)
        if not part_files.files:
            raise UnreadableError("holds no recordings", path=path)
        self._names, self._files = _files_by_name(path, part_files)
        self._sizes = [file.stat().st_size for file in self._files]
        described = [(file, self._described(file)) for file in self._files]
        _refuse_unlike(described)
        names, first = self._names, described[0][1]
        some = ", ".join(names[:SHOWN]) + (f" and {len(names) - SHOWN} more" if len(names) > SHOWN else "")
        note = f"a session of {counted(len(names), 'file')} ({some}); the times between them are left out"
        self.recording = replace(
            first,
            path=path,
            total_bytes=size_of(path),
            samples=None,
            duration_s=None,
            has_temperature=False,
            gyro_dps_per_lsb=None,
            others=(),
            notes=(*first.notes, note),
        )

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """See `Reader`; reads a file at a time."""
        placed: list[PlacedFile] = []
        next_us: int | None = None
        for number, file in enumerate(self._files):
            one = _FilePlacer(self._names[number], sum(before.samples for before in placed), next_us)
            with self._open(file) as reader:
                for chunk in reader.chunks(chunk_samples):
                    yield replace(one.placed(chunk), end_byte=self._share(number, chunk.end_byte))
            placed.append(one.done(file))
            next_us = one.last_us + round(MICROSECONDS / self.recording.rate_hz)
        self.files = tuple(placed)

    def _described(self, file: Path) -> Recording:
        try:
            with self._open(file) as reader:
                return reader.recording
        except NoFormatError as error:
            error.hint = "every file of the session must be a recording; a list of poses is called poses.csv"
            raise


class _FilePlacer:
    """Places the chunks of one file in the session; `last_us` is the time of its last row, as placed."""

    def __init__(self, name: str, first_sample: int, first_us: int | None) -> None:
        self._name, self._first_sample, self._first_us = name, first_sample, first_us
        self._moved_us: int | None = None
        self._samples = self._problems = self._lost_bytes = 0
        self._begun, self._dated, self.last_us = first_us is None, True, 0

    def placed(self, chunk: Chunk) -> Chunk:
        """Return a chunk of the file as one of the session."""
        breaks = chunk.breaks
        if len(chunk) and self._moved_us is None:
            own_us = int(chunk.clock.times(0, 1)[0])
            first_us = own_us if self._first_us is None else self._first_us
            self._first_us, self._moved_us = first_us, first_us - own_us
            breaks = breaks if self._begun else np.union1d([0], breaks).astype(np.int64)
        self._dated &= all(problem.code != NO_START for problem in chunk.problems)
        self._problems += len(chunk.problems)
        self._lost_bytes += sum(one.lost_bytes + one.missing_bytes for one in chunk.problems)
        here = self._first_sample
        placed = replace(
            chunk,
            first_sample=here + self._samples,
            clock=chunk.clock.shifted(self._moved_us or 0),
            breaks=breaks,
            temperature_mc=None,
            gyro_counts=None,
            problems=tuple(
                replace(one, sample=here + one.sample, message=printable(f"{self._name}: {one.message}"))
                for one in chunk.problems
            ),
        )
        if len(chunk):
            self._samples += len(chunk)
            self.last_us = int(placed.clock.times(len(chunk) - 1, len(chunk))[0])
        return placed

    def done(self, file: Path) -> PlacedFile:
        """Return the description of the whole file; raises UnreadableError if it has no samples."""
        if self._first_us is None or self._moved_us is None:
            raise UnreadableError("holds no samples", path=file)
        place = (self._name, self._first_sample, self._samples, self._first_us, self._moved_us)
        return PlacedFile(*place, self._dated, self._problems, self._lost_bytes)


def _files_by_name(path: Path, part_files: PartFiles) -> tuple[list[str], list[Path]]:
    """Return names, without the folder of all, and files; an archive must not hold two of a name."""
    if part_files.folder is None:
        files = [*part_files.files]
        base = Path(os.path.commonpath([file.parent for file in files]))
        return [printable(file.relative_to(base).as_posix()) for file in files], files
    files = sorted(part_files.files, key=lambda file: file.name)
    names = [printable(file.name) for file in files]
    if (twice := next((one for one, two in pairwise(names) if one == two), None)) is not None:
        raise UnreadableError(f"holds two files called {twice}", path=path, hint="unpack it, or rename one")
    return names, files


def _refuse_unlike(described: Sequence[tuple[Path, Recording]]) -> None:
    """Raise UsageError for a file that is not of the first one's device and settings."""
    (first_file, first), *others = described
    for file, other in others:
        for name, word in (("serial", "serial number"), ("model", "model")):
            one, two = getattr(first.device, name), getattr(other.device, name)
            if None not in (one, two) and one != two:
                text = f"is of another device than {first_file.name}: its {word} is {two}, not {one}"
                raise UsageError(printable(text), path=file, hint="a session is of one device")
        if (why := unlike(first, other)) is not None:
            text = f"does not go with {first_file.name}: its {why} is another"
            raise UsageError(printable(text), path=file, hint="a session is of one device, set up once")
