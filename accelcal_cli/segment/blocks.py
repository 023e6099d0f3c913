"""Windows before the decision, and what every rule of stillness must do with them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.recording import Counts
from accelcal_cli.core.windows import Windows


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """m complete windows of n samples, one after the other, without a break between them.

    Attributes:
        run: number of the unbroken stretch that they are part of, rising with time.
        first_sample: number of the first window's first sample in the recording.
        columns: (3, m, n) raw counts.
        low, high: (3, m) int64, smallest and largest count.
        sums: (3, m) int64, sums of counts.
        usable: (m,) whether every row was measured.
        temperature_sums: (m,) int64, sums of thousandths of a degree C, or None.
        rotation: (m n, 3) gyroscope counts, or None.
    """

    run: int
    first_sample: int
    columns: NDArray[Any]
    low: NDArray[np.int64]
    high: NDArray[np.int64]
    sums: NDArray[np.int64]
    usable: NDArray[np.bool_]
    temperature_sums: NDArray[np.int64] | None = None
    rotation: Counts | None = None

    def __len__(self) -> int:
        return len(self.usable)

    @property
    def length(self) -> int:
        """Samples in a window."""
        return int(self.columns.shape[2])

    def first_samples(self) -> NDArray[np.int64]:
        """(m,) number of each window's first sample."""
        return self.first_sample + self.length * np.arange(len(self), dtype=np.int64)

    def windows(self, which: NDArray[np.bool_]) -> Windows:
        """The windows of a mask."""
        samples = np.full(len(self), self.length, np.int64)
        spread = (self.high - self.low).T
        return Windows(samples, self.first_samples(), self.sums.T, spread, self.temperature_sums).select(
            which
        )


class Rule(Protocol):
    """Decides which windows are still; one object a recording, since it may remember.

    What it yields is in the order of time, each made of one or more whole windows of the blocks, none
    of them unusable, none in two; it must not depend on how a run was cut into blocks.
    """

    def take(self, blocks: Blocks) -> list[Windows]:
        """Take windows in; returns the still ones that are decided by now."""

    def rest(self) -> list[Windows]:
        """What was held back; called once, after the last block."""
