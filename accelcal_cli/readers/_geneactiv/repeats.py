"""Pages that a file holds twice."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.readers._pages.pages import PER_PAGE, PER_ROW, PageBlock

REMEMBERED_PAGES = 1 << 15
MIXERS = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F], np.uint64)
"""Odd numbers without a pattern."""


class Repeats:
    """Knows a page again by its number, its time and its first and last sample; so many pages back."""

    def __init__(self) -> None:
        self._marks = np.empty(0, np.uint64)
        self._highest = -1

    def among(self, block: PageBlock) -> NDArray[np.bool_]:
        """Which pages of the next block were there before, (p,)."""
        again = np.zeros(len(block), np.bool_)
        if not len(block) or block.sequence is None:
            return again
        highest = np.maximum.accumulate(np.append(self._highest, block.sequence))
        known = np.append(self._marks, page_marks(block))
        for page in np.flatnonzero(block.sequence <= highest[:-1]).tolist():
            now = len(self._marks) + page
            again[page] = bool((known[max(0, now - REMEMBERED_PAGES) : now] == known[now]).any())
        self._highest, self._marks = int(highest[-1]), known[-REMEMBERED_PAGES:]
        return again


def page_marks(block: PageBlock) -> NDArray[np.uint64]:
    """A number for each page, (p,), that different pages hardly ever share."""
    assert block.sequence is not None and block.time_us is not None
    ends = np.cumsum(block.rows)
    shape = np.concatenate((block.counts[ends - block.rows], block.counts[ends - 1]), axis=1)
    marks = block.sequence.astype(np.uint64) * MIXERS[0] + block.time_us.astype(np.uint64)
    for axis in range(shape.shape[1]):
        marks = marks * MIXERS[1] + shape[:, axis].astype(np.int64).astype(np.uint64)
    return np.asarray(marks)


def chosen(block: PageBlock, pages: NDArray[np.bool_]) -> PageBlock:
    """The pages marked in (p,)."""
    if pages.all():
        return block
    keep = dict.fromkeys(PER_PAGE, pages) | dict.fromkeys(PER_ROW, np.repeat(pages, block.rows))
    columns: dict[str, Any] = {name: picked(block, name, rows) for name, rows in keep.items()}
    return PageBlock(**columns)


def picked(block: PageBlock, name: str, rows: NDArray[np.bool_]) -> NDArray[np.generic] | None:
    """Part of one column."""
    column = getattr(block, name)
    return None if column is None else column[rows]
