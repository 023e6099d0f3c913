"""Cutting log.bin into records, and going on after damage."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.readers._gt3x.layout import LONGEST_BELIEVED, SEPARATOR, Records, records_at
from accelcal_cli.readers._gt3x.page import Page, Span, spoiled_records

FIRST_WALK, LONGEST_WALK = 64, 1 << 20
LOOK_AHEAD = 2 * LONGEST_BELIEVED


@dataclass(frozen=True, slots=True)
class Damage:
    """Bytes that gave no record.

    Attributes:
        start_byte: where they begin in log.bin.
        size: how many.
        records: how many records with a wrong checksum they are; 0 where they are something else.
        before: how many sound records of the batch lie before them.
        cut_off: they are the beginning of a record at the end of the data.
    """

    start_byte: int
    size: int
    records: int
    before: int
    cut_off: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Sound records of a piece of log.bin, and what lies between them.

    Attributes:
        doubtful: (k,) bool, what follows the record is no record: a length that is damaged may pass
            for sound by chance.
    """

    page: Page
    records: Records
    doubtful: NDArray[np.bool_]
    damage: tuple[Damage, ...]


@dataclass(slots=True)
class _Found:
    starts: list[int] = field(default_factory=list)
    doubtful: list[int] = field(default_factory=list)
    damage: list[Damage] = field(default_factory=list)

    def batch(self, page: Page) -> Batch:
        doubtful = np.zeros(len(self.starts), np.bool_)
        doubtful[self.doubtful] = True
        records = records_at(page.buffer, np.array(self.starts, np.int64))
        return Batch(page, records, doubtful, tuple(self.damage))


class Framer:
    """Takes log.bin piece by piece, in equal pieces; the records depend on nothing else."""

    def __init__(self, span: Span) -> None:
        self._span = span
        self._rest = b""
        self._base = 0
        self._lost: int | None = None
        self._most = FIRST_WALK

    def feed(self, data: bytes, *, last: bool) -> Batch:
        """Records of which it is clear what follows them."""
        page = Page(self._rest + data, self._base, last, self._span)
        found, at = _Found(), 0
        while at < len(page.data) and (more := self._step(page, at, found)) is not None:
            at = more
        at = self._kept(page, at, found)
        self._rest, self._base = page.data[at:], page.base + at
        return found.batch(page)

    def _step(self, page: Page, at: int, found: _Found) -> int | None:
        """Go on from `at`; gives where to, or None where more bytes are needed."""
        if self._lost is not None:
            return self._search(page, at, found)
        starts, end = page.follow(at, self._most)
        found.starts += starts
        if len(starts) == self._most:
            self._most = min(2 * self._most, LONGEST_WALK)
            return end
        if (after := page.after_padding(end)) > end:
            return after
        if end < len(page.data) and (page.last or not page.incomplete(end)):
            self._lose(page, end, found)
            return end
        return end if starts else None

    def _lose(self, page: Page, at: int, found: _Found) -> None:
        """What should begin at `at` is no sound record."""
        self._lost, self._most = page.base + at, FIRST_WALK
        if found.starts and page.data[at] != SEPARATOR:
            found.doubtful.append(len(found.starts) - 1)

    def _search(self, page: Page, at: int, found: _Found) -> int | None:
        """Find the next record after damage."""
        assert self._lost is not None
        place = np.searchsorted(page.believable, max(at, self._lost - page.base + 1))
        if place == len(page.believable) and not page.last:
            return None
        end = int(page.believable[place]) if place < len(page.believable) else len(page.data)
        damage = self._damage(page, end, len(found.starts))
        if damage.records:
            found.doubtful = [record for record in found.doubtful if record != damage.before - 1]
        found.damage.append(damage)
        self._lost = None
        return end

    def _damage(self, page: Page, end: int, before: int) -> Damage:
        """What lies between the last record and `end`: records if their sizes lead there."""
        assert self._lost is not None
        lost = self._lost - page.base
        size = end - lost
        if lost < 0:
            return Damage(self._lost, size, 0, before)
        cut_off = page.last and end == len(page.data) and page.incomplete(lost)
        return Damage(self._lost, size, spoiled_records(page.data[lost:end]), before, cut_off)

    def _kept(self, page: Page, at: int, found: _Found) -> int:
        """From where on bytes are still needed: the last record, or while lost as many as two may take."""
        if page.last:
            return len(page.data)
        if self._lost is not None:
            return max(at, len(page.data) - LOOK_AHEAD)
        return found.starts.pop() if found.starts else at
