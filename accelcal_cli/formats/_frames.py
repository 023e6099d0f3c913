"""The reader of files of equal frames, one for each sample of an even rate.

A format says where the frames lie and how they are decoded. Rows without usable values are left out, and the
row after them does not continue the one before.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import UniformClock, rate_fraction
from accelcal_cli.core.recording import Channels, Chunk, Counts, Intake, Others, Problem, Reader, Recording
from accelcal_cli.formats._bytes import ByteSource
from accelcal_cli.formats._pages.files import BLOCK_BYTES
from accelcal_cli.formats._problems import Event, Kind, ProblemLog
from accelcal_cli.formats._rows import HeldChannels, RowFilter

FIRST_ROWS, AFTER_BYTES = 1 << 16, 8
"""Rows that are decoded at a time until one is usable, and bytes that an intake keeps of what follows."""

CUT_OFF = "an incomplete sample at the end of the file, bytes left out"
BROKEN_OFF = "the compressed data is damaged or ends early; an incomplete sample, bytes left out"
NEVER_CAME = "samples that the file announces are missing at its end"


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Decoded frames as columns of n rows as in Chunk; a channel of single values may hold MISSING.

    Attributes:
        faulty: (n,) rows without usable values; None if there are none.
    """

    counts: Counts
    faulty: NDArray[np.bool_] | None = None
    validity: NDArray[np.uint8] | None = None
    channels: Channels = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class FrameFile:
    """A file of frames.

    Attributes:
        announced: number of frames by the header, None if it does not say; the bytes after them are not
            frames.
        compressed: it is packed; such a file is only read from its beginning.
        origin_us: time of the first frame.
        decode: decodes frames (n, frame_bytes), given the number of the first one.
        first_values: first measured value of each channel that may lack values; None if none is measured.
        left_out: code and text of faulty rows.
        damaged: the bytes of faulty rows are lost; else they only say that nothing was measured.
        others: returns the channel `others` of some rows, given the first one and their number.
    """

    path: Path
    start_byte: int
    frame_bytes: int
    announced: int | None
    compressed: bool
    origin_us: int
    decode: Callable[[NDArray[np.uint8], int], Frames]
    first_values: Mapping[str, int | None] = field(default_factory=dict)
    left_out: Kind = ("missing_value", "samples without a usable value, left out")
    damaged: bool = True
    others: Callable[[int, int], Others] | None = None

    def whole_frames(self) -> int:
        """Return the number of whole frames in an uncompressed file."""
        there = max(0, self.path.stat().st_size - self.start_byte) // self.frame_bytes
        return there if self.announced is None else min(there, self.announced)

    def offset(self, frame: int) -> int:
        """Return where a frame begins, bytes from the start of the (uncompressed) file."""
        return self.start_byte + frame * self.frame_bytes


class FrameReader(Reader):
    """Streams the frames from the beginning; gives the problems found while opening with the first chunk."""

    def __init__(self, recording: Recording, file: FrameFile, problems: tuple[Problem, ...] = ()) -> None:
        self.recording = recording
        self._file = file
        self._problems = problems

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """Yield all rows in order, `chunk_samples` at a time."""
        size, with_others = self._size(chunk_samples), self.with_others
        stream = self._stream(0, self._file.announced, size, self._problems, with_others=with_others)
        for chunk in stream:
            if len(chunk) or chunk.problems:
                yield chunk

    def first_us(self) -> int | None:
        """Return the time of the first row that is not left out [us], None without one."""
        with closing(self._stream(0, self._file.announced, FIRST_ROWS, ())) as chunks:
            return next((int(chunk.clock.times(0, 1)[0]) for chunk in chunks if len(chunk)), None)

    def preview(self, chunk_samples: int, pieces: int) -> Iterator[Chunk]:
        """Enter the file at evenly spread frames; a short or packed file gives its first chunks."""
        size = self._size(chunk_samples)
        total = 0 if self._file.compressed else self._file.whole_frames()
        if total < pieces * size:
            yield from super().preview(chunk_samples, pieces)
            return
        for piece in range(pieces):
            first = piece * total // pieces
            yield from self._stream(first, first + size, size, ())

    def _size(self, chunk_samples: int) -> int:
        return max(1, min(chunk_samples, BLOCK_BYTES // self._file.frame_bytes))

    def _stream(
        self,
        first: int,
        stop: int | None,
        size: int,
        problems: tuple[Problem, ...],
        *,
        with_others: bool = False,
    ) -> Generator[Chunk]:
        """Yield frames first..stop-1, `size` at a time; the last chunk may be empty."""
        file = self._file if with_others else replace(self._file, others=None)
        rows = _Rows(file, self.recording, first, problems)
        with ByteSource(file.path, self.threads) as source:
            source.seek(file.offset(first))
            last = False
            while not last:
                wanted = size if stop is None else min(size, stop - rows.frame)
                data = source.read_exact(wanted * file.frame_bytes)
                source.refuse_damaged()
                last = len(data) < wanted * file.frame_bytes or rows.frame + wanted == stop
                chunk = rows.feed(data, source.disk_position(), last=last)
                if last:
                    broken, undecoded = source.broken, source.undecoded()
                    ending = rows.ending(len(data), stop, broken=broken, undecoded=undecoded)
                    chunk = replace(chunk, problems=chunk.problems + ending)
                yield chunk


class _Rows:
    """Makes chunks of consecutive frames; `frame` is the number of the next one."""

    def __init__(
        self, file: FrameFile, recording: Recording, frame: int, problems: tuple[Problem, ...]
    ) -> None:
        self.frame = self._samples = frame
        self._file, self._rate = file, rate_fraction(recording.rate_hz)
        self._log = ProblemLog(problems)
        self._held = HeldChannels(file.first_values)
        self._filter = RowFilter()

    def feed(self, data: bytes, end_byte: int, *, last: bool) -> Chunk:
        """Return the next whole frames as a chunk."""
        count = len(data) // self._file.frame_bytes
        flat = np.frombuffer(data, np.uint8, count * self._file.frame_bytes)
        frames = self._file.decode(flat.reshape(count, self._file.frame_bytes), self.frame)
        chunk = Chunk(
            first_sample=self._samples,
            counts=frames.counts,
            clock=UniformClock(self._file.origin_us, self.frame, self._rate),
            end_byte=end_byte,
            validity=frames.validity,
            problems=(),
            used_bytes=0,
            others=None if self._file.others is None else self._file.others(self.frame, count),
            **self._held.fill(frames.channels),
        )
        faulty = np.zeros(count, np.bool_) if frames.faulty is None else frames.faulty
        chunk = self._filter.apply(chunk, faulty)
        kind, places = self._file.left_out, np.flatnonzero(faulty)
        before = np.cumsum(~faulty) if len(places) else places
        for index, number, scattered in self._log.runs(kind, places):
            row = int(places[index])
            frame = self.frame + row
            sample, lost = self._samples + int(before[row]), number * self._file.frame_bytes
            event = Event(frame, number, *kind, self._file.offset(frame), sample, number, scattered=scattered)
            self._log.add(replace(event, lost_bytes=lost if self._file.damaged else 0))
        self.frame += count
        self._samples += len(chunk)
        problems = self._log.take(None if last else self.frame)
        return replace(chunk, problems=problems, used_bytes=len(chunk) * self._file.frame_bytes)

    def ending(
        self, size: int, stop: int | None, *, broken: bool = False, undecoded: int = 0
    ) -> tuple[Problem, ...]:
        """Return what is wrong with the end of a file whose last piece has `size` bytes.

        Args:
            stop: number of frames that there should be, None if unknown.
            broken: the compressed data broke off, `undecoded` bytes before the end of the file on disk.
        """
        left, offset, problems = size % self._file.frame_bytes, self._file.offset(self.frame), []
        if left or broken:
            text = f"{BROKEN_OFF if broken else CUT_OFF}: {left}"
            problems.append(Problem("truncated", text, offset, self._samples, left, left + undecoded))
        if stop is not None and stop > self.frame:
            missing = stop - self.frame
            lacking = missing * self._file.frame_bytes - left
            text = f"{NEVER_CAME}: {missing}"
            problems.append(Problem("truncated", text, offset, self._samples, missing, 0, lacking))
        return tuple(problems)


class FrameIntake(Intake):
    """Takes a file of frames as it grows; `after` are the first bytes after the announced frames."""

    def __init__(self, recording: Recording, file: FrameFile, problems: tuple[Problem, ...]) -> None:
        self.after = b""
        self._file = file
        self._rows = _Rows(replace(file, others=None), recording, 0, problems)
        self._skip, self._taken = file.start_byte, 0
        self._rest = b""

    def take(self, data: bytes, *, last: bool) -> Iterator[Chunk]:
        """See `Intake`."""
        file, rows = self._file, self._rows
        self._taken += len(data)
        skipped = min(self._skip, len(data))
        self._skip -= skipped
        data = self._rest + data[skipped:]
        left = len(data) if file.announced is None else (file.announced - rows.frame) * file.frame_bytes
        self.after = (self.after + data[left:])[:AFTER_BYTES]
        data = data[:left]
        size = len(data) // file.frame_bytes * file.frame_bytes
        self._rest = data[size:]
        chunk = rows.feed(data[:size], self._taken, last=last)
        if last:
            chunk = replace(chunk, problems=chunk.problems + rows.ending(len(data), file.announced))
        if len(chunk) or chunk.problems or last:
            yield chunk
