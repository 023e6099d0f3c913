"""One pass over a session: facts about it, and all its still windows with their times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.collect.cells import CellCollector, CellCounts
from accelcal_cli.collect.plausible import plausible
from accelcal_cli.core.facts import Facts
from accelcal_cli.core.poses import TimedWindows
from accelcal_cli.core.recording import Chunk, Reader
from accelcal_cli.core.settings import PoseSettings
from accelcal_cli.core.windows import WindowCounts, Windows
from accelcal_cli.pipeline.profiles import local_lsb_per_g, make_segmenter
from accelcal_cli.pipeline.request import Progress
from accelcal_cli.pipeline.survey import Observer, with_clipping


@dataclass(frozen=True, slots=True, eq=False)
class Pass:
    """What one pass found.

    Attributes:
        still: windows that the device measured: those of constant values are left out where it
            only repeated a value.
        plausible: (m,) which of them measure about 1 g.
        cells: how many were left out.
    """

    facts: Facts
    still: TimedWindows
    plausible: NDArray[np.bool_]
    counts: WindowCounts
    cells: CellCounts


def timed_pass(reader: Reader, chunk_samples: int, settings: PoseSettings, progress: Progress) -> Pass:
    """Read a recording once.

    Raises:
        UnreadableError: it cannot be read on.
    """
    recording, stillness = reader.recording, settings.stillness
    rest_lsb = local_lsb_per_g(recording, stillness)
    segmenter, observer = make_segmenter(recording, stillness), Observer(recording, rest_lsb)
    collector = CellCollector(rest_lsb, stillness, temperature=False)
    parts: list[TimedWindows] = []
    for raw in reader.chunks(chunk_samples):
        chunk = with_clipping(raw, recording)
        observer.see(chunk)
        for windows in segmenter.feed(chunk):
            observer.see_still(windows)
            collector.add(windows)
            parts.append(timed(windows, chunk, recording.rate_hz))
        progress(chunk.end_byte)
    cells, still = collector.counts(), joined(parts)
    if not cells.constant_used:
        still = still.select(still.windows.spread.max(axis=1, initial=0) > 0)
    return Pass(
        observer.facts(), still, plausible(still.windows, rest_lsb, stillness), segmenter.counts, cells
    )


def timed(windows: Windows, chunk: Chunk, rate_hz: float) -> TimedWindows:
    """Windows that end in a chunk, with their times: its clock knows each one's last sample."""
    last = windows.first_sample + windows.samples - 1 - chunk.first_sample
    low, high = (int(last[0]), int(last[-1]) + 1) if len(last) else (0, 0)
    last_us = chunk.clock.times(low, high)[last - low]
    lengths_us = np.rint((windows.samples - 1) * 1e6 / rate_hz).astype(np.int64)
    return TimedWindows(windows, last_us - lengths_us, last_us + round(1e6 / rate_hz))


def joined(parts: list[TimedWindows]) -> TimedWindows:
    """Consecutive batches as one; their temperatures are not kept."""
    held = [part.windows for part in parts]
    none, wide = np.empty(0, np.int64), np.empty((0, 3), np.int64)
    windows = Windows(
        np.concatenate([none, *(part.samples for part in held)]),
        np.concatenate([none, *(part.first_sample for part in held)]),
        np.concatenate([wide, *(part.sums for part in held)]),
        np.concatenate([wide, *(part.spread for part in held)]),
    )
    return TimedWindows(
        windows,
        np.concatenate([none, *(part.start_us for part in parts)]),
        np.concatenate([none, *(part.end_us for part in parts)]),
    )
