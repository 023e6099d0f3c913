"""Times of pages whose stamps are coarser than a sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.readers._pages.pages import PageBlock
from accelcal_cli.readers._pages.timeline import Links, Spacing, Steps, fresh_pages, stamps, tolerance_us


@dataclass(frozen=True, slots=True)
class _Next:
    """What is known of a page and the one before it.

    Attributes:
        stamp: the page's stamp [us].
        rows: samples of the page before.
        advance: the same with those of lost pages between.
        apart: the page does not continue the one before.
        limit: misfit beyond which the clock has jumped [us].
    """

    stamp: int
    rows: int
    advance: int
    apart: bool
    limit: float


class CoarseTimeline:
    """Pages whose stamps are coarser than a sample, such as whole seconds.

    Pages follow the first stamp at the nominal rate as long as that stays within one unit of
    each page's stamp, so that a recording at its nominal rate is evenly spaced throughout. Where
    it leaves that band (a sensor faster or slower than nominal) the page is moved to the band's
    edge and the samples before it are spread over what remains. More than half a unit beyond the
    band and the page tolerance is a jump of the clock: times then go on from the new stamp.
    """

    def __init__(self, spacing: Spacing, unit_us: int) -> None:
        self._spacing = spacing
        self._unit_us = unit_us
        self._anchor_us = 0
        self._rows = 0
        self._ahead_us = self._behind_us = 0

    def start(self, block: PageBlock) -> int:
        """The first stamp."""
        self._anchor(int(stamps(block)[0]))
        return self._anchor_us

    def link(self, block: PageBlock, step: Steps, start_us: int) -> Links:
        """Pages that keep to the nominal rate at once, from the first that does not one by one."""
        apart = (step.pages > 1) | step.back | fresh_pages(block)
        before = block.rows[:-1]
        advance = before + (step.pages - 1) * self._spacing.rows
        limit = tolerance_us(self._spacing.rows_us(before), self._spacing) + self._unit_us / 2
        time_us = np.full(len(block), start_us)
        ahead_us, behind_us = np.zeros_like(before), np.zeros_like(before)
        done = self._steady(stamps(block)[1:], advance, apart, time_us)
        columns = (stamps(block)[1:], before, advance, apart, limit)
        rest = zip(*(column[done:].tolist() for column in columns), strict=True)
        for page, known in enumerate(rest, done):
            time_us[page + 1] = self._follow(int(time_us[page]), _Next(*known))
            ahead_us[page], behind_us[page] = self._ahead_us, self._behind_us
        return Links(time_us, apart | (ahead_us > 0) | (behind_us > 0), ahead_us, behind_us)

    def _steady(
        self,
        stamp_us: NDArray[np.int64],
        advance: NDArray[np.int64],
        apart: NDArray[np.bool_],
        time_us: NDArray[np.int64],
    ) -> int:
        """Fill in the times of the first pages that continue each other and fit; how many they are."""
        joined = int(np.argmax(np.append(apart, True)))
        rows = np.cumsum(advance[:joined])
        rate = self._spacing.rate
        step = MICROSECONDS * rate.denominator
        whole, rest = divmod(self._rows * step + rate.numerator // 2, rate.numerator)
        predicted = self._anchor_us + whole + (rest + rows * step) // rate.numerator
        off = np.abs(stamp_us[:joined] - predicted) > self._unit_us
        count = int(np.argmax(np.append(off, True)))
        time_us[1 : count + 1] = predicted[:count]
        self._rows += int(rows[count - 1]) if count else 0
        return count

    def _follow(self, before_us: int, page: _Next) -> int:
        """Time of a page after one at `before_us`; notes a jump of the clock."""
        end_us = before_us + self._nominal(page.rows)
        self._rows += page.advance
        late = self._misfit(page.stamp, self._predicted())
        gap = page.advance > page.rows
        early = -(self._misfit(page.stamp, end_us) if gap else late)
        if abs(late) > page.limit or (page.apart and late):
            self._anchor(page.stamp if early > page.limit else max(page.stamp, end_us))
        elif late:
            self._anchor(max(self._predicted() + late, before_us + self._nominal(page.rows) // 2))
        self._ahead_us = late if late > page.limit and not gap else 0
        self._behind_us = early if early > page.limit else 0
        return self._predicted()

    def _anchor(self, time_us: int) -> None:
        self._anchor_us, self._rows = time_us, 0

    def _nominal(self, rows: int) -> int:
        rate = self._spacing.rate
        return (rows * MICROSECONDS * rate.denominator + rate.numerator // 2) // rate.numerator

    def _predicted(self) -> int:
        return self._anchor_us + self._nominal(self._rows)

    def _misfit(self, stamp: int, predicted: int) -> int:
        """How far the band of a stamp lies after (or, negative, before) a time; 0 inside."""
        return max(stamp - self._unit_us - predicted, 0) + min(stamp + self._unit_us - predicted, 0)
