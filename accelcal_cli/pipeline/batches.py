"""Still windows in larger portions: what comes of them does not depend on how they are portioned."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from types import TracebackType
from typing import Self

from accelcal_cli.core.windows import Windows, joined_windows

BATCH_WINDOWS = 4096


class Batches:
    """Hands windows on a few thousand at a time, in their order; the rest when the block ends."""

    def __init__(self, use: Callable[[Windows], None]) -> None:
        self._use = use
        self._held: list[Windows] = []
        self._number = 0

    def take(self, found: Iterable[Windows]) -> None:
        """Take windows in."""
        for windows in found:
            if self._held and _warm(self._held[0]) != _warm(windows):
                self._hand_on()
            self._held.append(windows)
            self._number += len(windows)
            if self._number >= BATCH_WINDOWS:
                self._hand_on()

    def _hand_on(self) -> None:
        if self._held:
            self._use(joined_windows(self._held))
        self._held, self._number = [], 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if error is None:
            self._hand_on()


def _warm(windows: Windows) -> bool:
    return windows.temperature_sums is not None
