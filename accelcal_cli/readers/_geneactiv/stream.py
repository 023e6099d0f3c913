"""From the text of a file to chunks."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np

from accelcal_cli.core.recording import Chunk, Problem, Validity
from accelcal_cli.readers._geneactiv.decode import Decoder, Settings
from accelcal_cli.readers._geneactiv.first import FirstPages
from accelcal_cli.readers._geneactiv.page import SAMPLES, USUAL_BYTES
from accelcal_cli.readers._geneactiv.scale import Scale
from accelcal_cli.readers._geneactiv.text import Part, TextFile
from accelcal_cli.readers._pages.coarse import CoarseTimeline
from accelcal_cli.readers._pages.join import PageJoiner, Start
from accelcal_cli.readers._pages.pages import PageBlock
from accelcal_cli.readers._pages.timeline import Spacing

BROKEN_OFF = "the compressed data is damaged or ends early"


@dataclass(frozen=True, slots=True)
class Scheme:
    """How to read the pages of one file.

    Attributes:
        spacing: of the samples, at the device's true rate.
        announced: how many pages the header tells of, None where it does not.
        problems: what was found before any page.
    """

    file: TextFile
    settings: Settings
    spacing: Spacing
    first: FirstPages
    announced: int | None = None
    problems: tuple[Problem, ...] = ()

    def stream(self, chunk_samples: int) -> Generator[Chunk]:
        """All rows of the file, whole pages, at least one."""
        assembler = Assembler(self, 0, self.problems)
        with closing(self.file.parts(max(1, chunk_samples // SAMPLES))) as parts:
            for part in parts:
                chunk = assembler.feed(part)
                if part.last:
                    chunk = replace(chunk, problems=chunk.problems + assembler.ending(part, chunk))
                if len(chunk) or chunk.problems:
                    yield chunk

    def piece(self, offset: int, length: int) -> Chunk:
        """The pages that begin within `length` bytes, as if the recording were just these."""
        part = self.file.piece(offset, length)
        pages = max(0, int(part.found.heads[0][1]) - self.first.sequence) if part.found.heads else 0
        return Assembler(self, pages * SAMPLES, ()).feed(part)

    def block(self, part: Part) -> PageBlock:
        """The pages of a part, decoded."""
        return Decoder(self.settings)(part.found, part.first_position).block


class Assembler:
    """Takes the parts of a file in order and gives a chunk for each."""

    def __init__(self, scheme: Scheme, sample: int, problems: tuple[Problem, ...]) -> None:
        self._scheme = scheme
        self._places = _Places()
        self._decode = Decoder(scheme.settings)
        start = Start(sample, scheme.first.temperature_mc, problems)
        timeline = CoarseTimeline(scheme.spacing, scheme.first.unit_us)
        self._joiner = PageJoiner(self._places, scheme.spacing, timeline, start)
        self._highest = self._last_position = -1

    def feed(self, part: Part) -> Chunk:
        """Add a part; the last one releases everything."""
        self._places.part = part
        decoded = self._decode(part.found, part.first_position)
        block = decoded.block
        if len(block) and block.sequence is not None:
            self._highest = max(self._highest, int(block.sequence.max()))
            self._last_position = int(block.position[-1])
        return marked(self._joiner.feed(part, decoded), self._scheme.settings.scale)

    def ending(self, part: Part, chunk: Chunk) -> tuple[Problem, ...]:
        """What is missing at the end of the file."""
        sample, found = chunk.first_sample + len(chunk), part.found
        problems = [Problem("truncated", BROKEN_OFF, part.end, sample)] if part.broke_off else []
        if found.cut is not None:
            missing = SAMPLES - found.cut_samples
            text = f"the file ends within a page: {missing} of its {SAMPLES} samples are missing"
            problems.append(Problem("truncated", text, found.cut, sample, missing))
        lost = self._never_come(part)
        if lost > 0:
            text = f"pages that the header announces are missing at the end of the file: {lost}"
            problems.append(Problem("truncated", text, part.end, sample, lost))
        return tuple(problems)

    def _never_come(self, part: Part) -> int:
        """Pages that the header announces, without those that are reported in another way."""
        damaged = part.next_position - 1 - self._last_position
        cut = part.found.cut is not None and part.found.cut_samples == 0
        return (self._scheme.announced or 0) - (self._highest + 1) - damaged - cut


class _Places:
    """Where the places of the part lie that is being read."""

    part: Part
    page_bytes = USUAL_BYTES

    def offset(self, position: int) -> int:
        """Bytes from the start of the (uncompressed) file."""
        return self.part.offset(position)

    def length(self, position: int, pages: int) -> int:
        """Bytes of so many places."""
        return self.part.length(position, pages)


def marked(chunk: Chunk, scale: Scale) -> Chunk:
    """The chunk with rows marked that lie at the end of what the sensor can tell."""
    low, high = scale.clipped
    counts = chunk.counts
    if not len(counts) or (counts.min() > low.max() and counts.max() < high.min()):
        return chunk
    clipped = ((counts <= low) | (counts >= high)).any(axis=1)
    return replace(chunk, validity=np.where(clipped, Validity.CLIPPED, Validity.MEASURED).astype(np.uint8))
