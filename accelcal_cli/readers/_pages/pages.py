"""Pages after decoding: the valid ones as columns, the others as runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.recording import Counts

NO_TEMPERATURE = int(np.iinfo(np.int32).min)
"""Marks a sample whose temperature was not measured, until the last known one replaces it."""

GOOD, ERASED, CHECKSUM, NONSENSE, FOREIGN, RATE, REPEATED, TEXT, LENGTH, DIGITS, NO_PAGE = range(11)
BAD_KINDS = {
    ERASED: ("bad_page", "erased pages between pages with data, left out"),
    CHECKSUM: ("checksum", "pages with a wrong checksum, left out"),
    NONSENSE: ("bad_page", "pages without sensible content, left out"),
    FOREIGN: ("bad_page", "pages of another recording, left out"),
    RATE: ("rate_change", "pages recorded at another rate than the others, left out"),
    REPEATED: ("repeated_page", "pages that the file holds a second time, left out"),
    TEXT: ("bad_page", "pages whose own text is damaged, left out"),
    LENGTH: ("bad_page", "pages with too few or too many digits, left out"),
    DIGITS: ("bad_page", "pages with characters that are no digits among the samples, left out"),
    NO_PAGE: ("bad_page", "stretches of the file that are no page, left out"),
}

DAMAGED = (ERASED, CHECKSUM, NONSENSE, TEXT, LENGTH, DIGITS, NO_PAGE)
"""Kinds whose bytes are lost; a page of another recording or rate is sound, and so is a repeated one."""


@dataclass(frozen=True, slots=True)
class BadRun:
    """`pages` unusable pages in a row from `position` on; `kind` is a key of BAD_KINDS."""

    position: int
    pages: int
    kind: int


@dataclass(frozen=True, slots=True, eq=False)
class PageBlock:
    """Valid pages in file order: p pages with n samples in all.

    Attributes:
        position: (p,) int64, page number within the file.
        rows: (p,) int64, samples in each, at least 1.
        counts: (n, 3).
        sequence: (p,) int64, or None where pages carry none.
        time_us: (p,) int64 stamp of the first sample [us since 1970], or None.
        fresh: (p,) bool, the page itself says that it does not continue the one before; or None.
        temperature_mc: (n,) int32, NO_TEMPERATURE where not measured; or None.
        gyro: (n, 3), or None.
        faulty: (n,) bool, rows whose values are unusable, or None where every row is good.
    """

    position: NDArray[np.int64]
    rows: NDArray[np.int64]
    counts: Counts
    sequence: NDArray[np.int64] | None = None
    time_us: NDArray[np.int64] | None = None
    fresh: NDArray[np.bool_] | None = None
    temperature_mc: NDArray[np.int32] | None = None
    gyro: Counts | None = None
    faulty: NDArray[np.bool_] | None = None

    def __len__(self) -> int:
        return len(self.position)


@dataclass(frozen=True, slots=True, eq=False)
class Decoded:
    """A block of the file after decoding: its valid pages and the others.

    Attributes:
        leftover: bytes at the end that fill no page or frame.
        unused_end: the frames before these were never written.
    """

    block: PageBlock
    bad: list[BadRun]
    leftover: bytes
    unused_end: bool = False


PER_PAGE = ("position", "rows", "sequence", "time_us", "fresh")
PER_ROW = ("counts", "temperature_mc", "gyro", "faulty")


def joined(first: PageBlock, second: PageBlock) -> PageBlock:
    """The pages of both, in order."""
    if not len(first) or not len(second):
        return second if len(second) else first
    columns: dict[str, Any] = {name: joined_column(first, second, name) for name in PER_PAGE + PER_ROW}
    return PageBlock(**columns)


def joined_column(first: PageBlock, second: PageBlock, name: str) -> NDArray[np.generic] | None:
    """One column of both blocks."""
    above, below = getattr(first, name), getattr(second, name)
    return None if above is None or below is None else np.concatenate((above, below))


def split(block: PageBlock, pages: int) -> tuple[PageBlock, PageBlock]:
    """The first `pages` pages, and the rest."""
    row = int(block.rows[:pages].sum())
    cuts = dict.fromkeys(PER_PAGE, pages) | dict.fromkeys(PER_ROW, row)
    above: dict[str, Any] = {name: cut_column(block, name, slice(None, at)) for name, at in cuts.items()}
    below: dict[str, Any] = {name: cut_column(block, name, slice(at, None)) for name, at in cuts.items()}
    return PageBlock(**above), PageBlock(**below)


def cut_column(block: PageBlock, name: str, rows: slice) -> NDArray[np.generic] | None:
    """Part of one column."""
    column = getattr(block, name)
    return None if column is None else column[rows]


def bad_runs(status: NDArray[np.uint8], first_position: int) -> list[BadRun]:
    """Runs of equal pages that are not GOOD.

    Args:
        status: (p,) of GOOD and the keys of BAD_KINDS.
    """
    if not len(status):
        return []
    starts = np.flatnonzero(np.diff(status, prepend=status[0] + 1))
    lengths = np.diff(starts, append=len(status))
    return [
        BadRun(first_position + start, length, kind)
        for start, length, kind in zip(
            starts.tolist(), lengths.tolist(), status[starts].tolist(), strict=True
        )
        if kind != GOOD
    ]


def page_rows(block: PageBlock) -> NDArray[np.int64]:
    """Usable rows of each page, (p,)."""
    return block.rows if block.faulty is None else block.rows - per_page(block, block.faulty)


def per_page(block: PageBlock, marks: NDArray[np.bool_] | None) -> NDArray[np.int64]:
    """How many of each page's rows are marked, (p,)."""
    if marks is None or not marks.any():
        return np.zeros(len(block), np.int64)
    starts = np.cumsum(block.rows) - block.rows
    return np.add.reduceat(marks, starts, dtype=np.int64)
