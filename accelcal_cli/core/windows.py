"""Still windows as integer sums: what flows from the segmenter to the collector."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """m still windows.

    Attributes:
        samples: (m,) int64, number of samples in each.
        first_sample: (m,) number of each window's first sample in the recording.
        sums: (m, 3) int64, sums of the raw counts.
        spread: (m, 3) int64, max - min of the raw counts.
        temperature_sums: (m,) int64, sums of thousandths of a degree C, or None.
    """

    samples: NDArray[np.int64]
    first_sample: NDArray[np.int64]
    sums: NDArray[np.int64]
    spread: NDArray[np.int64]
    temperature_sums: NDArray[np.int64] | None = None

    def __len__(self) -> int:
        return len(self.first_sample)

    def select(self, which: NDArray[np.bool_]) -> Windows:
        """The windows of a mask."""
        warm = None if self.temperature_sums is None else self.temperature_sums[which]
        return Windows(
            self.samples[which], self.first_sample[which], self.sums[which], self.spread[which], warm
        )


def joined_windows(parts: list[Windows]) -> Windows:
    """Windows one after another, all of them with temperatures or none."""
    warm = [part.temperature_sums for part in parts if part.temperature_sums is not None]
    return Windows(
        np.concatenate([part.samples for part in parts]),
        np.concatenate([part.first_sample for part in parts]),
        np.concatenate([part.sums for part in parts]),
        np.concatenate([part.spread for part in parts]),
        np.concatenate(warm) if warm else None,
    )


@dataclass(frozen=True, slots=True)
class WindowCounts:
    """How many windows there were and why some were not used; sums over chunks by +.

    complete = moving + filled + clipped + recovered + joined + still, where a still window made of
    several counts once as still, and its others as joined to it.
    """

    complete: int = 0
    moving: int = 0
    filled: int = 0
    clipped: int = 0
    recovered: int = 0
    still: int = 0
    joined: int = 0

    def __add__(self, other: WindowCounts) -> WindowCounts:
        return WindowCounts(
            *(getattr(self, name) + getattr(other, name) for name in self.__dataclass_fields__)
        )
