"""Recordings in several files, read one at a time: parts of one recording, or the files of a session.

The parts of a recording are joined in the order of their times: a missing part is a gap, a repeated one is
read once, and one that cannot be read is reported. The files of a session are recordings of their own on one
device, such as one of each face. They follow one another by name, and their times are moved so that each file
begins when the one before ends; when they were made, and in which order, does not matter.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

import numpy as np

from accelcal_cli.core.clock import MICROSECONDS, StampClock
from accelcal_cli.core.door import is_file
from accelcal_cli.core.errors import (
    AccelcalError,
    NoFormatError,
    OutputError,
    UnreadableError,
    UsageError,
    counted,
    listed,
    printable,
)
from accelcal_cli.core.input_files import files_of, is_no_part, size_of
from accelcal_cli.core.local_time import NO_START
from accelcal_cli.core.recording import CUT_SHORT, Chunk, PlacedFile, Problem, Reader, Recording
from accelcal_cli.core.system import new_folder, remove_folder
from accelcal_cli.formats._parts import archive
from accelcal_cli.formats._stamps import GAP_PERIODS

SHORTEST_OVERLAP_S = 1.0
"""Shortest overlap of parts that is a repetition; a shorter one comes from clocks that do not quite agree."""

RATE_AGREEMENT = 0.05
LISTED = 50
"""Number of problems of a kind that are listed one by one."""

OFFICE = "[Content_Types].xml"
"""First member of an Office Open XML file (ECMA-376)."""

SHOWN = 3


@dataclass(frozen=True, slots=True)
class RecordingPart:
    """One part of a recording.

    Attributes:
        recording: what its header says.
        start_us: time of its first sample.
        size: length [bytes].
    """

    path: Path
    recording: Recording
    start_us: int
    size: int


Open = Callable[[Path], Reader]
"""Opens one part; raises NoFormatError for a file that is not a recording."""


AnyReader = TypeVar("AnyReader", bound=Reader)


def open_parts(
    path: Path, open_part: Open, kind: Callable[[Path, PartFiles, Open], AnyReader], threads: int = 1
) -> AnyReader:
    """Open a recording of several files: a folder, a pattern, or an archive.

    Args:
        kind: the class of reader, `PartsReader` or `SessionReader`.
        threads: how many may work at a time on unpacking an archive.

    Raises:
        UnreadableError: none of them can be read, or they do not say when they begin.
        UsageError: they are of several devices, or an option contradicts them.
        OutputError: there is no room to unpack an archive.
    """
    files = files_of(path)
    if files is not None:
        return kind(path, PartFiles(files), open_part)
    try:
        folder = new_folder()
    except OSError as error:
        raise OutputError(
            f"no temporary folder can be made ({error.strerror or error})",
            path=error.filename,
            hint="set TMPDIR to a disk with more space",
        ) from error
    try:
        unpacked = archive.unpack(path, folder, lambda name: not is_no_part(Path(name)), threads)
        part_files = PartFiles(unpacked.files, unpacked.damage, unpacked.lost_bytes, folder)
        return kind(path, part_files, partial(_open_member, path, open_part))
    except BaseException:
        remove_folder(folder)
        raise


def _open_member(archived: Path, open_part: Open, unpacked: Path) -> Reader:
    """Open a member of an archive; errors name the member, not the file it was unpacked to."""
    try:
        return open_part(unpacked)
    except AccelcalError as error:
        if error.path == unpacked:
            error.path = archived / unpacked.name
        raise


@dataclass(slots=True)
class PartFiles:
    """The files of a recording.

    Attributes:
        damage: what is wrong with the archive that held them.
        folder: temporary folder, to be removed.
        aside: names of files that are not recordings.
        problems: one for each file that cannot be read.
    """

    files: tuple[Path, ...]
    damage: str | None = None
    lost_bytes: int = 0
    folder: Path | None = None
    aside: list[str] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)


class FilesReader(Reader):
    """Reads a recording of several files, one at a time.

    Args:
        part_files: the files.
        open_part: opens one.
    """

    _sizes: Sequence[int]
    """Bytes of each file, in the order of reading."""

    def __init__(self, part_files: PartFiles, open_part: Open) -> None:
        self._part_files, self._open_part = part_files, open_part

    def close(self) -> None:
        """See `Closing`; removes what was unpacked."""
        if self._part_files.folder is not None:
            remove_folder(self._part_files.folder)

    def _open(self, path: Path) -> Reader:
        reader = self._open_part(path)
        reader.threads = self.threads
        return reader

    def _share(self, number: int, end_byte: int) -> int:
        """Return how far into the recording a place within a file is [bytes], for progress."""
        before = sum(self._sizes[:number]) + end_byte
        return self.recording.total_bytes * before // max(sum(self._sizes), 1)


class PartsReader(FilesReader):
    """Reads parts in the order of their times.

    Attributes:
        parts: the parts, in this order.
    """

    def __init__(self, path: Path, part_files: PartFiles, open_part: Open) -> None:
        super().__init__(part_files, open_part)
        self.parts = self._alike(path, self._described(path))
        self._sizes = [part.size for part in self.parts]
        if part_files.damage is not None:
            lost = Problem(CUT_SHORT, part_files.damage, None, 0, lost_bytes=part_files.lost_bytes)
            part_files.problems.append(lost)
        self.recording = _as_one(path, self.parts, part_files)

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """See `Reader`; reads a part at a time."""
        joint = _PartPlacer(self.recording, self._part_files.problems)
        for number, part in enumerate(self.parts):
            with self._open(part.path) as reader:
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
            with self._open(part.path) as reader:
                for chunk in reader.preview(chunk_samples, 1):
                    yield replace(_stripped(chunk, self.recording), end_byte=self._share(number * step, 0))

    def _described(self, path: Path) -> list[RecordingPart]:
        """Return the parts that can be read, by time."""
        parts: list[RecordingPart] = []
        failure: UnreadableError | None = None
        for file in self._part_files.files:
            size = file.stat().st_size
            try:
                with self._open(file) as reader:
                    recording = reader.recording
            except NoFormatError:
                self._part_files.aside.append(file.name)
                continue
            except UnreadableError as error:
                failure = failure or error
                text = f"part {file.name} cannot be read: {error.message}"
                self._part_files.problems.append(
                    Problem("unreadable_part", printable(text), None, 0, 1, size)
                )
                continue
            if recording.start_us is None:
                hint = "the parts need times; join them to one file instead, if they follow each other"
                raise UnreadableError("does not say when it begins", path=file, hint=hint)
            parts.append(RecordingPart(file, recording, recording.start_us, size))
        if not parts:
            raise failure or UnreadableError(
                "holds no parts of a recording", path=path, hint=_office_hint(path)
            )
        return sorted(parts, key=lambda part: (part.start_us, part.path.name))

    def _alike(self, path: Path, parts: list[RecordingPart]) -> list[RecordingPart]:
        """Return the parts that are like the first, as parts of one recording are."""
        serials = sorted({part.recording.device.serial for part in parts if part.recording.device.serial})
        if len(serials) > 1:
            text = f"holds parts of {len(serials)} devices ({listed(serials[:SHOWN])})"
            raise UsageError(printable(text), path=path, hint="name the parts of one by a pattern in quotes")
        kept = []
        for part in parts:
            if (why := unlike(parts[0].recording, part.recording)) is None:
                kept.append(part)
            else:
                text = printable(
                    f"part {part.path.name} was left out: its {why} is not that of the first part"
                )
                self._part_files.problems.append(Problem("other_part", text, None, 0, 1, part.size))
        return kept


def unlike(first: Recording, other: Recording) -> str | None:
    """Return the property by which two files are not of one recording; None if they may be."""
    if abs(other.rate_hz - first.rate_hz) > RATE_AGREEMENT * first.rate_hz:
        return "sampling rate"
    for name, word in (("lsb_per_g", "scale"), ("range_g", "range"), ("timezone", "time zone")):
        one, two = getattr(first, name), getattr(other, name)
        if one != two and None not in (one, two):
            return word
    return None


def _as_one(path: Path, parts: Sequence[RecordingPart], part_files: PartFiles) -> Recording:
    """Return the description of all parts together."""
    first, last = parts[0].recording, parts[-1].recording
    notes = [f"{counted(len(parts), 'part')}, from {parts[0].path.name} to {parts[-1].path.name}"]
    if len(parts) == 1:
        notes = [f"1 part, {parts[0].path.name}"]
    if part_files.aside:
        more = f" and {len(part_files.aside) - SHOWN} more" if len(part_files.aside) > SHOWN else ""
        notes.append(f"no recordings, set aside: {', '.join(part_files.aside[:SHOWN])}{more}")
    lasts_s = None
    one_gyroscope = len({part.recording.gyro_dps_per_lsb for part in parts}) == 1
    if last.duration_s is not None:
        lasts_s = (parts[-1].start_us - parts[0].start_us) / MICROSECONDS + last.duration_s
    return replace(
        first,
        path=path,
        total_bytes=size_of(path),
        samples=None,
        duration_s=lasts_s,
        has_temperature=all(part.recording.has_temperature for part in parts),
        gyro_dps_per_lsb=first.gyro_dps_per_lsb if one_gyroscope else None,
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

    def __init__(self, recording: Recording, problems: Sequence[Problem]) -> None:
        self._recording = recording
        self._period_us = MICROSECONDS / recording.rate_hz
        self._samples, self._first_of_part = 0, 0
        self._last_us: int | None = None
        self._fresh, self._dropped, self._overlaps = True, 0, False
        self._left = list(problems)
        self._reported: dict[str, int] = {}
        self._unlisted: dict[str, Problem] = {}

    def placed(self, part: RecordingPart, chunk: Chunk, end_byte: int) -> Chunk:
        """Return a part's chunk as one of the recording, without rows that earlier parts have, too."""
        problems = [
            replace(
                one,
                sample=self._first_of_part + max(0, one.sample - self._dropped),
                message=printable(f"{part.path.name}: {one.message}"),
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
            _stripped(kept, self._recording),
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

    def end_of_part(self, part: RecordingPart) -> None:
        """Note a part that repeats rows of the parts before it, and prepare for the next part."""
        if self._dropped:
            whole = "all of it" if self._fresh else counted(self._dropped, "row")
            text = f"part {part.path.name} repeats the time of parts before it: {whole} left out"
            self._left.append(Problem("repeated_part", printable(text), None, self._first_of_part, 1))
        self._fresh, self._dropped, self._overlaps = True, 0, False
        self._first_of_part = self._samples

    def end(self) -> Chunk:
        """Return an empty chunk with the remaining problems."""
        problems_here = tuple(one for one in self._left if self._is_listed(one))
        empty = Chunk(
            self._samples,
            np.empty((0, 3), np.int32),
            StampClock(np.empty(0, np.int64)),
            self._recording.total_bytes,
        )
        return replace(empty, problems=(*problems_here, *self._unlisted.values()))

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

    def _jump(self, kept: Chunk, part: RecordingPart) -> Problem | None:
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
        text = "more of the same in later parts"
        sums = {
            name: getattr(more, name) + getattr(problem, name)
            for name in ("count", "lost_bytes", "missing_bytes")
        }
        self._unlisted[problem.code] = replace(more, message=text, byte_offset=None, **sums)
        return False


def _office_hint(path: Path) -> str | None:
    """Return what to do with an archive of an office program; None for any other."""
    of_office = is_file(path) and OFFICE in archive.first_names(path, 1)
    return "it is a workbook or document of an office program: save its table as CSV" if of_office else None


class SessionReader(FilesReader):
    """Reads the files of a session.

    Unlike the parts of a recording, all of them are needed: one that cannot be read, or is not like the
    first, ends the session.

    Raises:
        UnreadableError: one cannot be read.
        UsageError: they are of several devices, or differ in rate, scale, range or time zone.
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
        self.recording = _session_as_one(path, described[0][1], self._names)

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
    """Places the chunks of one file in the session.

    Attributes:
        last_us: time of the last row so far, as placed.
    """

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
        return PlacedFile(
            self._name,
            self._first_sample,
            self._samples,
            self._first_us,
            self._moved_us,
            self._dated,
            self._problems,
            self._lost_bytes,
        )


def _files_by_name(path: Path, part_files: PartFiles) -> tuple[list[str], list[Path]]:
    """Return the files and their names, relative to the folder that holds all; in an archive without folders.

    Raises:
        UnreadableError: an archive holds two of one name.
    """
    if part_files.folder is None:
        base = Path(os.path.commonpath([file.parent for file in part_files.files]))
        return [printable(file.relative_to(base).as_posix()) for file in part_files.files], [
            *part_files.files
        ]
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


def _session_as_one(path: Path, first: Recording, names: Sequence[str]) -> Recording:
    """Return the description of the session."""
    some = ", ".join(names[:SHOWN]) + (f" and {len(names) - SHOWN} more" if len(names) > SHOWN else "")
    note = f"a session of {counted(len(names), 'file')} ({some}); the times between them are left out"
    return replace(
        first,
        path=path,
        total_bytes=size_of(path),
        samples=None,
        duration_s=None,
        has_temperature=False,
        gyro_dps_per_lsb=None,
        notes=(*first.notes, note),
    )
