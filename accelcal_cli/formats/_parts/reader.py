"""The parts of a recording as one stream, in the order of their times, one part at a time.

What is missing is a gap, what is there twice is read once, and what cannot be read is told.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from accelcal_cli.core.clock import MICROSECONDS, StampClock
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
from accelcal_cli.core.recording import Chunk, Problem, Reader, Recording
from accelcal_cli.core.system import new_folder, remove_folder
from accelcal_cli.formats._parts import archive
from accelcal_cli.formats._stamps import GAP_PERIODS

SHORTEST_OVERLAP_S = 1.0
"""Parts that overlap by less have clocks that do not quite agree; their rows are no repetition."""

RATE_AGREEMENT = 0.05
LISTED = 50
"""Problems of a kind that are given one by one."""

OFFICE = "[Content_Types].xml"
"""The first member of an Office Open XML file (ECMA-376)."""

SHOWN = 3


@dataclass(frozen=True, slots=True)
class Part:
    """One file of a recording.

    Attributes:
        recording: what its header says.
        start_us: time of its first sample.
        size: bytes.
    """

    path: Path
    recording: Recording
    start_us: int
    size: int


Open = Callable[[Path], Reader]
"""Opens one part; raises NoFormatError for a file that is no recording."""


AnyReader = TypeVar("AnyReader", bound=Reader)


def open_parts(
    path: Path, open_part: Open, kind: Callable[[Path, Found, Open], AnyReader], threads: int = 1
) -> AnyReader:
    """Open a recording of several files: a folder, a pattern, or an archive.

    Args:
        kind: what reads them.
        threads: how many may work at a time on unpacking an archive.

    Raises:
        UnreadableError: none of them can be read, or they do not say when they begin.
        UsageError: they are of several devices, or an option contradicts them.
        OutputError: there is no room to unpack an archive.
    """
    files = files_of(path)
    if files is not None:
        return kind(path, Found(files), open_part)
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
        found = Found(unpacked.files, unpacked.damage, unpacked.lost_bytes, folder)
        return kind(path, found, partial(_open_member, path, open_part))
    except BaseException:
        remove_folder(folder)
        raise


def _open_member(archived: Path, open_part: Open, unpacked: Path) -> Reader:
    """Open a member of an archive; errors name it, and not where it was unpacked."""
    try:
        return open_part(unpacked)
    except AccelcalError as error:
        if error.path == unpacked:
            error.path = archived / unpacked.name
        raise


@dataclass(slots=True)
class Found:
    """The files of a recording.

    Attributes:
        damage: what is wrong with the archive that held them.
        folder: a temporary one, to be removed.
        aside: names of those that are no recordings.
        problems: of those that cannot be read.
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
        found: the files.
        open_part: opens one.
    """

    _sizes: Sequence[int]
    """Bytes of the files that are read, in their order."""

    def __init__(self, found: Found, open_part: Open) -> None:
        self._found, self._open_part = found, open_part

    def close(self) -> None:
        """See `Closing`; what was unpacked is removed."""
        if self._found.folder is not None:
            remove_folder(self._found.folder)

    def _open(self, path: Path) -> Reader:
        reader = self._open_part(path)
        reader.threads = self.threads
        return reader

    def _share(self, number: int, end_byte: int) -> int:
        """How far into the recording a place within a file is, for progress."""
        before = sum(self._sizes[:number]) + end_byte
        return self.recording.total_bytes * before // max(sum(self._sizes), 1)


class PartsReader(FilesReader):
    """Reads parts in the order of their times.

    Attributes:
        parts: in this order.
    """

    def __init__(self, path: Path, found: Found, open_part: Open) -> None:
        super().__init__(found, open_part)
        self.parts = self._alike(path, self._described(path))
        self._sizes = [part.size for part in self.parts]
        if found.damage is not None:
            lost = Problem("damaged_archive", found.damage, None, 0, lost_bytes=found.lost_bytes)
            found.problems.append(lost)
        self.recording = _as_one(path, self.parts, found)

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """See `Reader`; a part at a time."""
        joint = _Joint(self.recording, self._found.problems)
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
        """See `Reader`; of parts spread over the recording the beginning of each."""
        step = max(1, len(self.parts) // pieces)
        for number, part in enumerate(self.parts[::step][:pieces]):
            with self._open(part.path) as reader:
                for chunk in reader.preview(chunk_samples, 1):
                    yield replace(_stripped(chunk, self.recording), end_byte=self._share(number * step, 0))

    def _described(self, path: Path) -> list[Part]:
        """The parts that can be read, by time."""
        parts: list[Part] = []
        failure: UnreadableError | None = None
        for file in self._found.files:
            size = file.stat().st_size
            try:
                with self._open(file) as reader:
                    recording = reader.recording
            except NoFormatError:
                self._found.aside.append(file.name)
                continue
            except UnreadableError as error:
                failure = failure or error
                text = f"part {file.name} cannot be read: {error.message}"
                self._found.problems.append(Problem("unreadable_part", printable(text), None, 0, 1, size))
                continue
            if recording.start_us is None:
                hint = "the parts need times; join them to one file instead, if they follow each other"
                raise UnreadableError("does not say when it begins", path=file, hint=hint)
            parts.append(Part(file, recording, recording.start_us, size))
        if not parts:
            raise failure or UnreadableError("holds no parts of a recording", path=path, hint=_instead(path))
        return sorted(parts, key=lambda part: (part.start_us, part.path.name))

    def _alike(self, path: Path, parts: list[Part]) -> list[Part]:
        """Those that are like the first, as parts of one recording are."""
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
                self._found.problems.append(Problem("other_part", text, None, 0, 1, part.size))
        return kept


def unlike(first: Recording, other: Recording) -> str | None:
    """What speaks against two parts being of one recording."""
    if abs(other.rate_hz - first.rate_hz) > RATE_AGREEMENT * first.rate_hz:
        return "sampling rate"
    for name, word in (("lsb_per_g", "scale"), ("range_g", "range"), ("timezone", "time zone")):
        one, two = getattr(first, name), getattr(other, name)
        if one != two and None not in (one, two):
            return word
    return None


def _as_one(path: Path, parts: Sequence[Part], found: Found) -> Recording:
    """The description of all parts together."""
    first, last = parts[0].recording, parts[-1].recording
    notes = [f"{counted(len(parts), 'part')}, from {parts[0].path.name} to {parts[-1].path.name}"]
    if len(parts) == 1:
        notes = [f"1 part, {parts[0].path.name}"]
    if found.aside:
        more = f" and {len(found.aside) - SHOWN} more" if len(found.aside) > SHOWN else ""
        notes.append(f"no recordings, set aside: {', '.join(found.aside[:SHOWN])}{more}")
    lasts_s = None
    if last.duration_s is not None:
        lasts_s = (parts[-1].start_us - parts[0].start_us) / MICROSECONDS + last.duration_s
    return replace(
        first,
        path=path,
        total_bytes=size_of(path),
        samples=None,
        duration_s=lasts_s,
        has_temperature=all(part.recording.has_temperature for part in parts),
        gyro_dps_per_lsb=first.gyro_dps_per_lsb if _all_with_gyroscope(parts) else None,
        notes=(*first.notes, *map(printable, notes)),
    )


def _all_with_gyroscope(parts: Sequence[Part]) -> bool:
    return len({part.recording.gyro_dps_per_lsb for part in parts}) == 1


def _stripped(chunk: Chunk, recording: Recording) -> Chunk:
    """Without channels that not all parts have."""
    return replace(
        chunk,
        temperature_mc=chunk.temperature_mc if recording.has_temperature else None,
        gyro_counts=None if recording.gyro_dps_per_lsb is None else chunk.gyro_counts,
    )


class _Joint:
    """Places the chunks of one part after another in the recording."""

    def __init__(self, recording: Recording, problems: Sequence[Problem]) -> None:
        self._recording = recording
        self._period_us = MICROSECONDS / recording.rate_hz
        self._samples, self._first_of_part = 0, 0
        self._last_us: int | None = None
        self._fresh, self._dropped, self._overlaps = True, 0, False
        self._left = list(problems)
        self._told: dict[str, int] = {}
        self._more: dict[str, Problem] = {}

    def placed(self, part: Part, chunk: Chunk, end_byte: int) -> Chunk:
        """A chunk of a part as one of the recording; rows that the part before has too are left out."""
        problems = [self._renumbered(one, part) for one in chunk.problems]
        skipped = self._skipped(chunk) if self._fresh and len(chunk) else 0
        kept = chunk.part(skipped, len(chunk)) if skipped else chunk
        self._dropped += skipped
        breaks, jumps = kept.breaks, kept.clock_jumps
        if len(kept) and self._fresh:
            if (jump := self._jump(kept, part)) is not None:
                breaks, jumps = np.union1d([0], breaks), np.union1d([0], jumps)
                problems.append(jump)
            self._fresh = False
        told, self._left = [*self._left, *problems], []
        placed = replace(
            _stripped(kept, self._recording),
            first_sample=self._samples,
            end_byte=end_byte,
            breaks=breaks.astype(np.int64, copy=False),
            clock_jumps=jumps.astype(np.int64, copy=False),
            problems=tuple(one for one in told if self._is_told(one)),
        )
        if len(kept):
            self._samples += len(kept)
            self._last_us = int(kept.clock.times(len(kept) - 1, len(kept))[0])
        return placed

    def end_of_part(self, part: Part) -> None:
        """What the part that was read leaves to be told."""
        if self._dropped:
            whole = "all of it" if self._fresh else counted(self._dropped, "row")
            text = f"part {part.path.name} repeats the time of parts before it: {whole} left out"
            self._left.append(Problem("repeated_part", printable(text), None, self._first_of_part, 1))
        self._fresh, self._dropped, self._overlaps = True, 0, False
        self._first_of_part = self._samples

    def end(self) -> Chunk:
        """An empty chunk with the rest of what is to be told."""
        told = tuple(one for one in self._left if self._is_told(one))
        empty = Chunk(
            self._samples,
            np.empty((0, 3), np.int32),
            StampClock(np.empty(0, np.int64)),
            self._recording.total_bytes,
        )
        return replace(empty, problems=(*told, *self._more.values()))

    def _skipped(self, chunk: Chunk) -> int:
        """How many rows at the beginning of a part lie before the end of the one before."""
        if self._last_us is None:
            return 0
        back_s = (self._last_us - int(chunk.clock.times(0, 1)[0])) / MICROSECONDS
        self._overlaps = self._overlaps or back_s >= SHORTEST_OVERLAP_S
        if not self._overlaps:
            return 0
        later = np.flatnonzero(chunk.time_us > self._last_us)
        return int(later[0]) if len(later) else len(chunk)

    def _jump(self, kept: Chunk, part: Part) -> Problem | None:
        """What the clock does between two parts, if it does not run on."""
        if self._last_us is None:
            return None
        step = int(kept.clock.times(0, 1)[0]) - self._last_us
        if 0 <= step <= GAP_PERIODS * self._period_us:
            return None
        code, words = ("clock_back", "goes back") if step < 0 else ("clock_gap", "jumps ahead")
        text = f"the time {words} by {abs(step) / MICROSECONDS:g} s before part {part.path.name}"
        return Problem(code, printable(text), None, self._samples)

    def _renumbered(self, problem: Problem, part: Part) -> Problem:
        sample = self._first_of_part + max(0, problem.sample - self._dropped)
        return replace(problem, sample=sample, message=printable(f"{part.path.name}: {problem.message}"))

    def _is_told(self, problem: Problem) -> bool:
        """Whether a problem is one of the first of its kind; the rest are counted."""
        self._told[problem.code] = self._told.get(problem.code, 0) + 1
        if self._told[problem.code] <= LISTED:
            return True
        more = self._more.get(problem.code, replace(problem, count=0, lost_bytes=0))
        text = "more of the same in later parts"
        count, lost = more.count + problem.count, more.lost_bytes + problem.lost_bytes
        self._more[problem.code] = replace(more, message=text, byte_offset=None, count=count, lost_bytes=lost)
        return False


def _instead(path: Path) -> str | None:
    """What to do with an archive that holds no recording."""
    of_office = path.is_file() and OFFICE in archive.first_names(path, 1)
    return "it is a workbook or document of an office program: save its table as CSV" if of_office else None
