"""The last day of a recording that grows, for a procedure which keeps nothing along time itself.

Coefficients that were found once are held against it; what is older is forgotten, so that memory and state
do not grow.
"""

from __future__ import annotations

from dataclasses import replace

from accelcal_cli.core.points import Windows
from accelcal_cli.core.recording import Chunk, Recording
from accelcal_cli.core.settings import Settings
from accelcal_cli.pipeline.survey import TimedCellProcedure

LAST_H = 24


class LastDay(TimedCellProcedure):
    """Windows of the last hours, about a day; blocks of time and samples count from the first one kept."""

    def __init__(self, recording: Recording, settings: Settings) -> None:
        super().__init__(recording, settings)
        self._first = 0
        """Samples of the recording before the first block that is kept."""

    def see(self, chunk: Chunk) -> None:
        """Note when hours begin, and forget the first block where there are too many."""
        super().see(replace(chunk, first_sample=chunk.first_sample - self._first))
        hours = self.collector.block_samples // self.hour_samples
        while len(self._begun_us) >= LAST_H + hours:
            self.collector.forget_first_block()
            del self._begun_us[:hours]
            self._first += self.collector.block_samples
            self._means = None

    def see_still(self, windows: Windows) -> None:
        """Take windows in; those that were decided on late may lie before what is kept."""
        kept = windows.select(windows.first_sample >= self._first)
        self.collector.add(replace(kept, first_sample=kept.first_sample - self._first))
        self._means = None
