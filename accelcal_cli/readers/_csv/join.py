"""Rows of small blocks as longer stretches: what comes after costs the same for a short one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from accelcal_cli.readers._csv.blocks import Block
from accelcal_cli.readers._csv.rows import Rows, joined_rows

BLOCK_BYTES = 1 << 21
"""Text that is parsed at a time, however many samples are wanted: its table takes as much again."""

MOST_JOINED = 1 << 18
"""Rows that are joined however many are wanted: more of them are made no faster, and take memory."""


def block_bytes(samples: int, line_bytes: float) -> int:
    """How much text to parse at a time where so many samples are wanted."""
    return max(1, min(BLOCK_BYTES, int(0.95 * samples * line_bytes)))


def joined(parts: Iterable[tuple[Rows, Block]], samples: int) -> Iterator[tuple[Rows, Block]]:
    """Rows of blocks joined as long as they are no more than `samples`, each with its last block."""
    samples = min(samples, MOST_JOINED)
    held: list[Rows] = []
    number, place = 0, None
    for rows, block in parts:
        if place is not None and number + len(rows) > samples:
            yield _taken(held), place
            number = 0
        if len(rows) or not held:
            held.append(rows)
        number, place = number + len(rows), block
    if place is not None:
        yield _taken(held), place


def _taken(held: list[Rows]) -> Rows:
    """Stretches as one; the list does not keep their memory."""
    rows = joined_rows(held)
    held.clear()
    return rows
