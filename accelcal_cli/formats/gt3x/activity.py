"""The older kind of .gt3x: activity.bin, nothing but packed samples, without times or checksums.

Source: github.com/actigraph/NHANES-GT3X-File-Format, README.md and fileformats/activity.bin.md
(GT3X+ and ActiSleep+ with firmware up to 2.5.0).
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import closing
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import UniformClock, rate_fraction
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.recording import Chunk, Problem, Validity
from accelcal_cli.formats.gt3x.archive import Archive, Fault, Member, MemberStream
from accelcal_cli.formats.gt3x.sensors import PAIR_BYTES, YXZ, packed_bytes, packed_samples, unpacked
from accelcal_cli.formats.gt3x.timeline import fault_problem

PIECE_BYTES = PAIR_BYTES << 16
ASLEEP = "samples that repeat the one before for a second or longer, taken for idle sleep of the device"
CUT_SAMPLE = "bytes of an incomplete sample at the end of activity.bin, left out"


@dataclass(frozen=True, slots=True)
class ActivityFile:
    """An activity.bin whose settings are known.

    Attributes:
        start_us: time of the first sample.
        problems: what was found before any sample.
    """

    archive: Archive
    member: Member
    rate: int
    start_us: int
    problems: tuple[Problem, ...] = ()

    @property
    def samples(self) -> int | None:
        """How many there are, None if the zip file is damaged or does not say."""
        size = None if self.archive.problems else self.member.unpacked_bytes
        return None if size is None else int(packed_samples(np.array(size)))

    def stream(self, chunk_samples: int, threads: int = 1) -> Generator[Chunk, None, None]:
        """All chunks.

        Args:
            threads: how many may work at a time.

        Raises:
            UnreadableError: the disk fails, or what was packed is not what comes out: without
                checksums of their own, any of the values may be wrong.
        """
        from accelcal_cli.formats._rows import RepeatedSamples  # log.bin marks idle sleep itself

        repeats, rows, problems = RepeatedSamples(self.rate), 0, self.problems
        waiting = np.empty((0, 3), np.int16)
        asleep: list[int] = []
        with (
            MemberStream(self.archive, self.member) as source,
            closing(source.pieces(PIECE_BYTES, threads)) as pieces,
        ):
            for piece in pieces:
                waiting = np.concatenate((waiting, samples_of(piece.data)))
                filled = repeats.mark(waiting, last=piece.last)
                counts, waiting = waiting[: len(filled)], waiting[len(filled) :]
                asleep += [rows + int(np.argmax(filled)), int(filled.sum())] if filled.any() else []
                if piece.last:
                    problems += slept(asleep) + self._ending(source, rows + len(counts))
                for start in range(0, len(counts) or bool(problems), chunk_samples):
                    part = slice(start, start + chunk_samples)
                    yield self._chunk(counts[part], filled[part], rows + start, piece.end_byte, problems)
                    problems = ()
                rows += len(counts)

    def _chunk(
        self,
        counts: NDArray[np.int16],
        filled: NDArray[np.bool_],
        first: int,
        end_byte: int,
        problems: tuple[Problem, ...],
    ) -> Chunk:
        return Chunk(
            first_sample=first,
            counts=counts,
            clock=UniformClock(self.start_us, first, rate_fraction(self.rate)),
            end_byte=end_byte,
            validity=np.where(filled, Validity.FILLED, Validity.MEASURED).astype(np.uint8)
            if filled.any()
            else None,
            problems=problems,
            used_bytes=int(np.diff(packed_bytes(np.array((first, first + len(counts)))))[0]),
        )

    def _ending(self, source: MemberStream, rows: int) -> tuple[Problem, ...]:
        if source.fault in (Fault.DAMAGED, Fault.WRONG_CHECKSUM):
            raise UnreadableError(
                "activity.bin in it is damaged: some of its values are not what was recorded",
                path=self.archive.path,
                hint="copy it again from its source",
            )
        fault = fault_problem(source, rows)
        left = source.size - int(packed_bytes(packed_samples(np.array(source.size))))
        cut = Problem("truncated", f"{CUT_SAMPLE}: {left}", source.size - left, rows, left, left)
        return (*((cut,) if left else ()), *((fault,) if fault else ()))


def slept(asleep: list[int]) -> tuple[Problem, ...]:
    """A record of all samples that the device filled, from pairs of a first one and how many."""
    if not asleep:
        return ()
    first, count = asleep[0], sum(asleep[1::2])
    place = int(packed_bytes(np.array(first)))
    return (Problem("idle_sleep", f"{ASLEEP}: {count}", place, first, count),)


def samples_of(data: bytes) -> NDArray[np.int16]:
    """Samples of a piece of activity.bin, (n, 3)."""
    whole = int(packed_samples(np.array(len(data))))
    return np.asarray(unpacked(np.frombuffer(data, np.uint8)[None], whole, YXZ)[0])


def has_samples(file: ActivityFile) -> bool:
    """Whether there is one at all.

    Raises:
        UnreadableError: the disk fails, or activity.bin is packed in an unusual way.
    """
    with MemberStream(file.archive, file.member) as source:
        return len(samples_of(source.read(PAIR_BYTES))) > 0
