"""An open dump of fixed-size pages, whatever says what a page holds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.recording import Chunk, Problem, Reader, Recording
from accelcal_cli.readers._pages.blocks import PagedFile, RawBlock
from accelcal_cli.readers._pages.join import PageJoiner, Start
from accelcal_cli.readers._pages.pages import NO_TEMPERATURE, Decoded, PageBlock, joined, split
from accelcal_cli.readers._pages.timeline import Spacing, Timeline, steps

LAST_PAGES = 64
FIRST_ROWS = 1 << 16


@dataclass(frozen=True, slots=True)
class PageScheme:
    """How to read the pages of one file.

    Attributes:
        decode: turns a block into valid pages and the rest.
        timeline: makes a fresh timeline.
    """

    file: PagedFile
    spacing: Spacing
    decode: Callable[[RawBlock], Decoded]
    timeline: Callable[[], Timeline]


@dataclass(frozen=True, slots=True)
class Opening:
    """What the first block with a valid page tells.

    Attributes:
        block: its valid pages.
        start_us: time of the first sample.
        temperature_mc: the first measured temperature, or NO_TEMPERATURE.
    """

    block: PageBlock
    start_us: int
    temperature_mc: int


def look_inside(scheme: PageScheme) -> Opening | None:
    """Read on until a page is valid; None where there is none in the whole file."""
    pages = max(1, FIRST_ROWS // scheme.spacing.rows)
    for raw in scheme.file.blocks(pages):
        block = scheme.decode(raw).block
        if len(block) and (block.faulty is None or not block.faulty.all()):
            return Opening(block, scheme.timeline().start(block), first_temperature(block))
    return None


def first_temperature(block: PageBlock) -> int:
    """The first measured one in the block, NO_TEMPERATURE where there is none."""
    if block.temperature_mc is None:
        return NO_TEMPERATURE
    known = block.temperature_mc[block.temperature_mc != NO_TEMPERATURE]
    return int(known[0]) if len(known) else NO_TEMPERATURE


@dataclass(frozen=True, slots=True)
class Extent:
    """Length of a recording as its first and last page tell; None where they do not."""

    samples: int | None
    duration_s: float | None


def extent(scheme: PageScheme, opening: Opening) -> Extent:
    """Compare the first valid page with the last, without reading what lies between.

    The number of samples takes all pages between for full and present; it is None where the
    sequence numbers contradict that, and for a gzip file, whose end is not known.
    """
    last = None if scheme.file.compressed else last_page(scheme)
    if last is None:
        return Extent(None, None)
    ends, _ = split(opening.block, 1)
    if last.position[0] > ends.position[0]:
        ends = joined(ends, last)
    step = steps(ends, scheme.spacing)
    timeline = scheme.timeline()
    links = timeline.link(ends, step, timeline.start(ends))
    rows = int(np.ptp(ends.position)) * scheme.spacing.rows + int(ends.rows[-1])
    lasted_us = int(np.ptp(links.time_us)) + float(scheme.spacing.rows_us(ends.rows[-1]))
    certain = ends.faulty is None and not step.missing.any()
    return Extent(rows if certain else None, lasted_us / MICROSECONDS)


def last_page(scheme: PageScheme) -> PageBlock | None:
    """The last valid page, looked for among the last few before erased ones; None if not there."""
    first = max(0, scheme.file.data_pages() - LAST_PAGES)
    with closing(scheme.file.blocks(LAST_PAGES + 1, first)) as blocks:
        block = scheme.decode(next(blocks)).block
    return split(block, len(block) - 1)[1] if len(block) else None


class PagedReader(Reader):
    """Streams the pages of a dump; each call of `chunks` reads the file from its beginning.

    Args:
        problems: what was found while opening; reported with the first chunk.
    """

    def __init__(
        self, recording: Recording, scheme: PageScheme, opening: Opening, problems: tuple[Problem, ...] = ()
    ) -> None:
        self.recording = recording
        self._scheme = scheme
        self._opening = opening
        self._problems = problems

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """Yield all rows in order, whole pages, at least one."""
        joiner = self._joiner(0, self._problems)
        for raw in self._scheme.file.blocks(self._pages(chunk_samples)):
            chunk = joiner.feed(raw, self._scheme.decode(raw))
            if len(chunk) or chunk.problems:
                yield chunk

    def preview(self, chunk_samples: int, pieces: int) -> Iterator[Chunk]:
        """Enter the file at evenly spread pages; a gzip file gives its first chunks."""
        if self._scheme.file.compressed:
            yield from super().preview(chunk_samples, pieces)
            return
        total = self._scheme.file.data_pages()
        pages = min(self._pages(chunk_samples), max(1, total // max(1, pieces)))
        for piece in range(min(pieces, max(1, total))):
            chunk = self._piece(piece * total // pieces, pages)
            if len(chunk) or chunk.problems:
                yield chunk

    def _piece(self, position: int, pages: int) -> Chunk:
        with closing(self._scheme.file.blocks(pages, position)) as blocks:
            raw = next(blocks)
        joiner = self._joiner(position * self._scheme.spacing.rows, ())
        whole = replace(raw, last=True, tail=raw.tail if raw.last else b"")
        return joiner.feed(whole, self._scheme.decode(whole))

    def _pages(self, chunk_samples: int) -> int:
        return max(1, chunk_samples // self._scheme.spacing.rows)

    def _joiner(self, sample: int, problems: tuple[Problem, ...]) -> PageJoiner:
        scheme = self._scheme
        start = Start(sample, self._opening.temperature_mc, problems)
        return PageJoiner(scheme.file, scheme.spacing, scheme.timeline(), start)
