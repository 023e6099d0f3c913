"""From sectors to chunks: samples wait until the anchors that tell their times are read."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterator
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import PageClock
from accelcal_cli.core.recording import Chunk, Problem
from accelcal_cli.readers._cwa.blocks import sector_blocks
from accelcal_cli.readers._cwa.decode import SectorBlock, decode
from accelcal_cli.readers._cwa.events import EventMaker
from accelcal_cli.readers._cwa.links import Linker
from accelcal_cli.readers._cwa.sector import Settings
from accelcal_cli.readers._cwa.signature import SECTOR_BYTES
from accelcal_cli.readers._cwa.temperature import Thermometer
from accelcal_cli.readers._cwa.times import NO_SPANS, Spans, Timeline
from accelcal_cli.readers._pages.blocks import PagedFile, RawBlock
from accelcal_cli.readers._pages.problems import Event, ProblemLog


@dataclass(frozen=True, slots=True)
class Scheme:
    """A file whose settings are known.

    Attributes:
        thermometer: what its temperature words mean, None where nothing was measured.
        problems: what was found before any sample.
    """

    file: PagedFile
    settings: Settings
    thermometer: Thermometer | None
    problems: tuple[Problem, ...] = ()

    def sectors(self, chunk_samples: int) -> int:
        """Sectors that make a chunk."""
        return max(1, chunk_samples // self.settings.rows)

    def stream(self, chunk_samples: int) -> Generator[Chunk, None, None]:
        """All chunks of the file."""
        assembler = Assembler(self, 0, self.problems)
        with closing(sector_blocks(self.file, self.sectors(chunk_samples))) as blocks:
            for raw in blocks:
                yield from assembler.feed(raw)

    def piece(self, position: int, sectors: int) -> Iterator[Chunk]:
        """A few sectors from `position` on, as if the recording were just these."""
        with closing(sector_blocks(self.file, sectors, position)) as blocks:
            raw = next(blocks)
        whole = replace(raw, last=True, tail=b"")
        yield from Assembler(self, position * self.settings.rows, ()).feed(whole)


@dataclass(frozen=True, slots=True, eq=False)
class _Waiting:
    """Samples of a block, its sectors' breaks (p,), and what to tell with them."""

    block: SectorBlock
    broken: NDArray[np.bool_]
    end_byte: int


class Assembler:
    """Takes blocks of sectors in file order; gives chunks as soon as their times are known."""

    def __init__(self, scheme: Scheme, sample: int, problems: tuple[Problem, ...]) -> None:
        self._scheme = scheme
        self._events = EventMaker(scheme.file)
        self._linker = Linker(scheme.settings.rate, scheme.settings.rows)
        self._timeline = Timeline(scheme.settings.rate)
        self._log = ProblemLog(problems)
        self._waiting: deque[_Waiting] = deque()
        self._spans = NO_SPANS
        self._nothing, _ = decode(np.empty((0, SECTOR_BYTES), np.uint8), 0, scheme.settings)
        self._rows_in = self._rows_out = sample

    def feed(self, raw: RawBlock) -> Iterator[Chunk]:
        """Add a block; the last one releases everything."""
        block, status = decode(raw.pages, raw.first_position, self._scheme.settings)
        events = list(self._events.left_out(raw, status, block, self._rows_in))
        if len(block):
            self._place(block, raw.end_byte, events)
        if raw.last:
            self._add_spans(self._timeline.finish())
            events += self._events.ending(raw, self._rows_in)
        for event in sorted(events, key=lambda event: event.position):
            self._log.add(event)
        yield from self._ready(None if raw.last else raw.first_position + len(raw.pages), raw.end_byte)

    def _place(self, block: SectorBlock, end_byte: int, events: list[Event]) -> None:
        links = self._linker.link(block)
        events += self._events.links(block, links, self._rows_in)
        self._add_spans(self._timeline.feed(links))
        self._waiting.append(_Waiting(block, links.broken, end_byte))
        self._rows_in += int(block.rows.sum())

    def _add_spans(self, new: Spans) -> None:
        old = self._spans
        self._spans = Spans(
            np.concatenate((old.time_us, new.time_us)), np.concatenate((old.span_us, new.span_us))
        )

    def _ready(self, scanned: int | None, end_byte: int) -> Iterator[Chunk]:
        """Chunks whose times are settled; problems left over go with an empty one."""
        problems = self._log.take(scanned)
        while self._waiting and len(self._waiting[0].block) <= len(self._spans):
            yield self._chunk(self._waiting.popleft(), problems)
            problems = ()
        if problems:
            reached = self._waiting[0].end_byte if self._waiting else end_byte
            nothing = _Waiting(self._nothing, np.empty(0, np.bool_), reached)
            yield self._chunk(nothing, problems)

    def _chunk(self, waiting: _Waiting, problems: tuple[Problem, ...]) -> Chunk:
        block, sectors = waiting.block, len(waiting.block)
        first_row = np.cumsum(block.rows) - block.rows
        spans = self._spans
        self._spans = Spans(spans.time_us[sectors:], spans.span_us[sectors:])
        clock = PageClock(first_row, spans.time_us[:sectors], block.rows, spans.span_us[:sectors])
        chunk = Chunk(
            first_sample=self._rows_out,
            counts=block.counts,
            clock=clock,
            end_byte=waiting.end_byte,
            breaks=first_row[waiting.broken],
            temperature_mc=self._temperature(block),
            gyro_counts=block.gyro if self._scheme.settings.gyro_dps_per_lsb else None,
            problems=problems,
            used_bytes=sectors * SECTOR_BYTES,
        )
        self._rows_out += len(chunk)
        return chunk

    def _temperature(self, block: SectorBlock) -> NDArray[np.int32] | None:
        """Each sector's temperature for all of its samples, (n,)."""
        sensor = self._scheme.thermometer
        return None if sensor is None else np.repeat(sensor.temperature_mc(block.temperature), block.rows)
