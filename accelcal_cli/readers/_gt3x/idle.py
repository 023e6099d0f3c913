"""Idle sleep: when the device says that it stopped sampling, and for which seconds that holds.

An event record with payload 8 says that the device falls asleep, 9 that it wakes (github.com/actigraph/
GT3X-File-Format, README.md, EVENT). Asleep, "the last sampled accelerometer value is written into
memory at the device's preset sample rate" (ActiGraph, "Idle Sleep Mode Explained"); newer devices leave
the writing to the reader.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.readers._gt3x.page import Span

FELL_ASLEEP, WOKE = b"\x08", b"\x09"
UNWRITTEN_S = 1
"""The second in which a device falls asleep may be lost; the vendor's own export fills it as well."""

LONGEST_SILENCE_S = 86_400
"""Asleep, devices write their battery's voltage every minute: after so long a silence the clock jumped."""


JITTER_S = 2
"""Records of other kinds may carry times a little before those of the records around them."""


@dataclass(frozen=True, slots=True)
class Asleep:
    """Seconds first_s..end_s - 1, asleep by the records."""

    first_s: int
    end_s: int


class IdleWatch:
    """Follows the device's sleep record by record.

    Args:
        span: no sleep reaches beyond it.
    """

    def __init__(self, span: Span) -> None:
        self._span = span
        self._since: int | None = None
        self._heard = 0

    @property
    def asleep(self) -> bool:
        """Whether the last thing known is that it fell asleep."""
        return self._since is not None

    def fall_asleep(self, second: int) -> None:
        """An event of falling asleep."""
        self._since = self._heard = second

    def hear(self, seconds: NDArray[np.int64]) -> None:
        """Times of other records, in file order; the clock must go on evenly."""
        if not self.asleep or not len(seconds):
            return
        steps = np.diff(seconds, prepend=self._heard)
        if (steps < -JITTER_S).any() or (steps > LONGEST_SILENCE_S).any():
            self._since = None
        self._heard = int(seconds.max())

    def wake(self, second: int, next_s: int) -> Asleep | None:
        """The device woke.

        Args:
            next_s: the second after the last one that is known.

        Returns:
            what it slept through since then; None where the records do not say that.
        """
        self.hear(np.array([second]))
        since, self._since = self._since, None
        if since is None:
            return None
        first = max(next_s, since - UNWRITTEN_S)
        end = min(second, self._span.last_s)
        return Asleep(first, end) if first < end else None

    def end(self, next_s: int) -> Asleep | None:
        """The records end: it slept at least until the last of them."""
        return self.wake(self._heard, next_s)

    def forget(self) -> None:
        """Something is not known: damage, or samples while asleep."""
        self._since = None
