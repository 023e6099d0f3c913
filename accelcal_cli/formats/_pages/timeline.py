"""Finds when each page of a dump began, and where one page does not continue the page before.

A timeline takes pages in file order; the times do not depend on how many pages a call brings. Between two
pages that continue each other the samples are spread evenly; a page before a break runs at the nominal rate.
Stamps may be missing, finer than a sample, or coarser than one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.recording import cut_columns, joined_columns
from accelcal_cli.formats._pages.pages import PageBlock
from accelcal_cli.formats._problems import Kind

MISSING_PAGES = "sequence_gap", "pages missing by their sequence numbers"
SEQUENCE_BACK = "sequence_back", "pages whose sequence number does not rise"
CLOCK_AHEAD = "clock_gap", "jumps of the device clock ahead"
CLOCK_BACK = "clock_back", "jumps of the device clock back"

RATE_TOLERANCE, STAMP_TOLERANCE_SAMPLES = 0.1, 1.5
"""Share, and sample intervals in addition, by which a page may last longer or shorter (sensors: 6 % off)."""

LONGEST_GAP_S, LATEST_US = 365 * 86_400, 1 << 61
"""Longest jump [s] of a sequence number that is not a new numbering, and latest time [us] of a page."""


@dataclass(frozen=True, slots=True)
class Spacing:
    """Samples per second and in a full page, and bits of the sequence number, which starts from 0 again."""

    rate: Fraction
    rows: int
    sequence_bits: int = 32

    def rows_us(self, rows: NDArray[np.int64] | int) -> NDArray[np.float64]:
        """Return how long samples last at the nominal rate [us]."""
        return np.asarray(rows * (MICROSECONDS * self.rate.denominator) / self.rate.numerator)


@dataclass(frozen=True, slots=True)
class PageSteps:
    """Steps from each page to the next, (m - 1,): pages, at least 1, by which the recording went on.

    Some of them are missing in the file, or the sequence number did not rise.
    """

    pages: NDArray[np.int64]
    missing: NDArray[np.int64]
    back: NDArray[np.bool_]


def steps(block: PageBlock, spacing: Spacing) -> PageSteps:
    """Compare positions and sequence numbers of neighbouring pages."""
    across = np.diff(block.position)
    if block.sequence is None:
        return PageSteps(across, np.zeros_like(across), np.zeros(len(across), np.bool_))
    rise = np.diff(block.sequence) % (1 << spacing.sequence_bits)
    longest = int(LONGEST_GAP_S * spacing.rate / spacing.rows) + 1
    back = (rise == 0) | (rise > min(longest, 1 << (spacing.sequence_bits - 1)))
    forward = np.where(back, across, rise)
    return PageSteps(np.maximum(forward, across), np.maximum(forward - across, 0), back)


@dataclass(frozen=True, slots=True)
class PageLinks:
    """Times of m pages, and whether each but the last is continued by the next.

    Attributes:
        time_us: (m,) int64, first sample of each page.
        broken: (m - 1,) bool, the next page does not continue this one.
        ahead_us, behind_us: (m - 1,) int64, jump of the clock before the next page beyond what the samples
            explain; 0 where there is none.
    """

    time_us: NDArray[np.int64]
    broken: NDArray[np.bool_]
    ahead_us: NDArray[np.int64]
    behind_us: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Spans:
    """Times of pages, (p,) int64 each, as in PageClock."""

    time_us: NDArray[np.int64]
    span_rows: NDArray[np.int64]
    span_us: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.time_us)

    def followed_by(self, second: Spans) -> Spans:
        """Return the spans of both, in order."""
        return Spans(**joined_columns((self, second), self.__dataclass_fields__))

    def split(self, pages: int) -> tuple[Spans, Spans]:
        """Return those of the first `pages` pages, and the rest."""
        parts = slice(None, pages), slice(pages, None)
        above, below = (Spans(**cut_columns(self, self.__dataclass_fields__, part)) for part in parts)
        return above, below


NO_SPANS = Spans(*(np.empty(0, np.int64),) * 3)


@dataclass(frozen=True, slots=True)
class Findings:
    """Findings about pages, (p,) each: numbers, and times [us] that the clock jumped; 0 for none."""

    counts: Mapping[Kind, NDArray[Any]] = field(default_factory=dict)
    times_us: Mapping[Kind, NDArray[np.int64]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Placed:
    """Pages (p,) that do not continue the one before, and spans of the next ones whose times are settled."""

    broken: NDArray[np.bool_]
    spans: Spans
    found: Findings = Findings()


class Timeline(Protocol):
    """Gives pages their times."""

    def feed(self, block: PageBlock, *, last: bool) -> Placed:
        """Place the pages of the next block, which may have none.

        Args:
            last: nothing follows: the times of all pages are settled.
        """


class PageTimeline:
    """A timeline in which a page waits for the next one, which shows how long it lasted."""

    def __init__(self, spacing: Spacing) -> None:
        self._spacing = spacing
        self._last: PageBlock | None = None
        self._last_us = 0

    def start(self, block: PageBlock) -> int:
        """Return the time of the block's first page [us]; called once, before `link`."""
        raise NotImplementedError

    def link(self, block: PageBlock, step: PageSteps, start_us: int) -> PageLinks:
        """Return times and links of all pages of a block whose first page begins at `start_us`."""
        raise NotImplementedError

    def feed(self, block: PageBlock, *, last: bool) -> Placed:
        """See Timeline."""
        before, pages = self._last, block.chosen(slice(None), slice(0))
        if before is not None:
            pages = before.followed_by(pages)
        if not len(pages):
            return Placed(np.empty(0, np.bool_), NO_SPANS)
        step = steps(pages, self._spacing)
        links = self.link(pages, step, self.start(pages) if before is None else self._last_us)
        _, self._last = pages.split(len(pages) - 1)
        self._last_us = int(links.time_us[-1])
        first = int(before is None), 0  # the first page of all follows none
        counts = {MISSING_PAGES: np.pad(step.missing, first), SEQUENCE_BACK: np.pad(step.back, first)}
        times_us = {CLOCK_AHEAD: np.pad(links.ahead_us, first), CLOCK_BACK: np.pad(links.behind_us, first)}
        settled, _ = self._spread(pages, links).split(len(pages) - (not last))
        return Placed(np.pad(links.broken, first), settled, Findings(counts, times_us))

    def _spread(self, pages: PageBlock, links: PageLinks) -> Spans:
        """Spread each page up to the next, or at the nominal rate where no next one limits it."""
        lasted = np.diff(links.time_us)
        # a page before a gap, or before a clock that goes back, has no next page that limits it
        free = links.broken & ((lasted > self._spacing.rows_us(pages.rows[:-1])) | (links.behind_us > 0))
        free |= lasted <= 0
        rate = self._spacing.rate
        nominal_us = MICROSECONDS * rate.denominator
        return Spans(
            links.time_us,
            np.append(np.where(free, rate.numerator, pages.rows[:-1]), rate.numerator),
            np.append(np.where(free, nominal_us, lasted), nominal_us),
        )


def fresh_pages(block: PageBlock) -> NDArray[np.bool_]:
    """Mark the pages after the first that say that they do not continue the one before, (m - 1,)."""
    return np.zeros(len(block) - 1, np.bool_) if block.fresh is None else block.fresh[1:]


class NominalTimeline(PageTimeline):
    """Pages without a stamp: they follow each other at the nominal rate, lost ones included."""

    def __init__(self, spacing: Spacing, origin_us: int) -> None:
        super().__init__(spacing)
        self._origin_us, self._slot = origin_us, 0
        self._latest = int(LATEST_US // MICROSECONDS * spacing.rate / spacing.rows)

    def start(self, block: PageBlock) -> int:
        """Count from the file's page 0, which begins at the origin."""
        self._slot = int(block.position[0])
        return self._times([self._slot])[0]

    def link(self, block: PageBlock, step: PageSteps, start_us: int) -> PageLinks:
        """Count pages, by sequence number where there is one."""
        slots = np.minimum(self._slot + np.cumsum(np.append(0, step.pages)), self._latest)
        self._slot = int(slots[-1])
        time_us = np.array(self._times(slots.tolist()), np.int64)
        short = block.rows[:-1] < self._spacing.rows
        none = np.zeros(len(short), np.int64)
        broken = short | (step.pages > 1) | step.back | fresh_pages(block)
        return PageLinks(time_us, broken, none, none)

    def _times(self, slots: list[int]) -> list[int]:
        samples_per_s = self._spacing.rate.numerator
        step, half = self._spacing.rows * MICROSECONDS * self._spacing.rate.denominator, samples_per_s // 2
        return [self._origin_us + (slot * step + half) // samples_per_s for slot in slots]


class ExactTimeline(PageTimeline):
    """Pages with stamps finer than a sample: each page begins at its stamp."""

    def start(self, block: PageBlock) -> int:
        """Return the first stamp."""
        return int(stamps(block)[0])

    def link(self, block: PageBlock, step: PageSteps, start_us: int) -> PageLinks:
        """Take for a jump of the clock whatever neither the samples nor `tolerance_us` explain."""
        time_us = stamps(block)
        lasted = np.diff(time_us)
        expected = self._spacing.rows_us(block.rows[:-1])
        allowed = tolerance_us(expected, self._spacing)
        ahead = (lasted > expected + allowed) & (step.pages == 1)
        behind = lasted < expected - np.minimum(allowed, expected / 2)
        off = np.rint(lasted - expected).astype(np.int64)
        broken = ahead | behind | (step.pages > 1) | step.back | fresh_pages(block)
        return PageLinks(time_us, broken, np.where(ahead, off, 0), np.where(behind, -off, 0))


def stamps(block: PageBlock) -> NDArray[np.int64]:
    """Return the pages' stamps, which a timeline by stamps needs."""
    assert block.time_us is not None
    return block.time_us


def tolerance_us(expected_us: NDArray[np.float64], spacing: Spacing) -> NDArray[np.float64]:
    """Return by how much the length of a page may differ from the nominal one [us] without a jump."""
    return RATE_TOLERANCE * expected_us + STAMP_TOLERANCE_SAMPLES * float(spacing.rows_us(1))


class CoarseTimeline(PageTimeline):
    """Pages whose stamps are coarser than a sample, such as whole seconds.

    Pages follow the first stamp at the nominal rate as long as that stays within one unit of
    each page's stamp, so that a recording at its nominal rate is evenly spaced throughout. Where
    it leaves that band (a sensor faster or slower than nominal) the page is moved to the band's
    edge and the samples before it are spread over what remains. More than half a unit beyond the
    band and the page tolerance is a jump of the clock: times then continue from the new stamp.
    """

    def __init__(self, spacing: Spacing, unit_us: int) -> None:
        super().__init__(spacing)
        self._unit_us = unit_us
        self._anchor_us = self._rows = self._ahead_us = self._behind_us = 0

    def start(self, block: PageBlock) -> int:
        """Return the first stamp."""
        self._anchor(int(stamps(block)[0]))
        return self._anchor_us

    def link(self, block: PageBlock, step: PageSteps, start_us: int) -> PageLinks:
        """Place pages that keep to the nominal rate at once, and one by one from the first that does not."""
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
            time_us[page + 1] = self._follow(int(time_us[page]), *known)
            ahead_us[page], behind_us[page] = self._ahead_us, self._behind_us
        return PageLinks(time_us, apart | (ahead_us > 0) | (behind_us > 0), ahead_us, behind_us)

    def _steady(
        self,
        stamp_us: NDArray[np.int64],
        advance: NDArray[np.int64],
        apart: NDArray[np.bool_],
        time_us: NDArray[np.int64],
    ) -> int:
        """Fill in times of the first pages that continue each other and fit; return their number."""
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

    def _follow(self, before_us: int, stamp: int, rows: int, advance: int, apart: bool, limit: float) -> int:
        """Return the time of a page with this stamp after one at `before_us`, and note a jump of the clock.

        Args:
            rows: samples of the page before.
            advance: these samples and those of lost pages between.
            apart: the page does not continue the one before.
            limit: misfit beyond which the clock has jumped [us].
        """
        end_us = before_us + self._nominal(rows)
        self._rows += advance
        late = self._misfit(stamp, self._predicted())
        gap = advance > rows
        early = -(self._misfit(stamp, end_us) if gap else late)
        if abs(late) > limit or (apart and late):
            self._anchor(stamp if early > limit else max(stamp, end_us))
        elif late:
            self._anchor(max(self._predicted() + late, before_us + self._nominal(rows) // 2))
        self._ahead_us = late if late > limit and not gap else 0
        self._behind_us = early if early > limit else 0
        return self._predicted()

    def _anchor(self, time_us: int) -> None:
        self._anchor_us, self._rows = time_us, 0

    def _nominal(self, rows: int) -> int:
        rate = self._spacing.rate
        return (rows * MICROSECONDS * rate.denominator + rate.numerator // 2) // rate.numerator

    def _predicted(self) -> int:
        return self._anchor_us + self._nominal(self._rows)

    def _misfit(self, stamp: int, predicted: int) -> int:
        """Return how far the band of a stamp lies after (or, negative, before) a time; 0 inside."""
        return max(stamp - self._unit_us - predicted, 0) + min(stamp + self._unit_us - predicted, 0)
