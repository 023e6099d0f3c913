"""The files of a session: recordings of their own on one device, such as one of each face, as one stream.

They follow one another by name, and their times are moved so that each file begins when the one before ends;
when they were made, and in which order, does not matter.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.errors import NoFormatError, UnreadableError, UsageError, counted, printable
from accelcal_cli.core.input_files import size_of
from accelcal_cli.core.local_time import NO_START
from accelcal_cli.core.recording import Chunk, PlacedFile, Recording
from accelcal_cli.formats._parts.archive import PartFiles
from accelcal_cli.formats._parts.reader import SHOWN, FilesReader, Open, unlike


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
