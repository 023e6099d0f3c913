"""The six-byte slots of a GENEA file: samples, times and battery voltages, each with a checksum.

A page of 2048 bytes has 341 slots and two bytes more. A slot is a CRC-8 of the five bytes behind it, the kind
in four bits, and its content: three times 12 bits of acceleration, or the time in whole seconds, big-endian.
A time stands before the samples of its second. Sources: github.com/wadpac/GGIRread, R/readGenea.R; the
checksum (polynomial 0x85, start 0, most significant bit first) was found from its sample file, where it holds
for all slots.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, reduce
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.formats._pages.pages import GOOD, NONSENSE, PageBlock, RawBlock, joined
from accelcal_cli.formats._pages.places import Found
from accelcal_cli.formats._pages.timeline import Spacing

PAGE_BYTES = 2048
SLOT_BYTES = 6
SLOTS = PAGE_BYTES // SLOT_BYTES
SAMPLE, TIME = 0, 2
CRC8_POLYNOMIAL = 0x85
LONGEST_S = 8
"""Samples without a time for longer are cut into groups, so that lost times do not fill the memory."""

Slots = NDArray[np.uint8]


@cache
def crc8_positions() -> NDArray[np.uint8]:
    """What value v at each of the five places adds to the checksum, (5, 256)."""
    state = np.arange(256)
    table = np.empty((SLOT_BYTES - 1, 256), np.uint8)
    for place in range(SLOT_BYTES - 2, -1, -1):
        for _ in range(8):
            state = (state << 1 ^ np.where(state & 0x80, CRC8_POLYNOMIAL, 0)) & 0xFF
        table[place] = state
    return table


def sound(slots: Slots) -> NDArray[np.bool_]:
    """Which slots (n, 6) have the right checksum, (n,); empty ones, whose checksum is right too, have not."""
    total = np.zeros(len(slots), np.uint8)
    for place, table in enumerate(crc8_positions(), 1):
        total ^= table[slots[:, place]]
    return np.asarray((total == slots[:, 0]) & slots.any(axis=1))


def kinds(slots: Slots) -> NDArray[np.uint8]:
    """The kind of each slot, (n,)."""
    return np.asarray(slots[:, 1] >> 4)


def seconds(slots: Slots) -> NDArray[np.int64]:
    """Of slots that hold a time: seconds since 1970, (n,)."""
    return np.ascontiguousarray(slots[:, 2:]).view(">u4")[:, 0].astype(np.int64)


def raw_values(slots: Slots) -> NDArray[np.int16]:
    """Of slots that hold a sample: raw x, y and z, (n, 3), the first and the last with their sign changed."""
    one, two, three, four, five = slots[:, 1:].T.astype(np.int16)
    x, y, z = (one & 15) << 8 | two, three << 4 | four >> 4, (four & 15) << 8 | five
    signed = (np.stack((x, y, z), axis=1) ^ 0x800) - 0x800
    return np.asarray(signed * np.array((-1, 1, -1), np.int16))


def page_slots(pages: NDArray[np.uint8]) -> Slots:
    """All slots of pages (p, 2048), (n, 6)."""
    return pages[:, : SLOTS * SLOT_BYTES].reshape(-1, SLOT_BYTES)


def empty_pages(pages: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Which pages hold nothing but 0x00 or 0xFF, (p,)."""
    empty: NDArray[np.bool_] = np.isin(pages[:, 0], (0, 0xFF)) & (pages[:, 0] == pages[:, -1])
    candidates = np.flatnonzero(empty)
    empty[candidates] = (pages[candidates] == pages[candidates, :1]).all(axis=1)
    return empty


def tail_slots(tail: bytes) -> Slots:
    """Whole slots of the part of a page, (n, 6)."""
    count = min(len(tail) // SLOT_BYTES, SLOTS)
    return np.frombuffer(tail, np.uint8, count * SLOT_BYTES).reshape(-1, SLOT_BYTES)


def used(slots: Slots) -> int:
    """How many slots there are before those at the end that hold nothing but 0x00 or 0xFF."""
    written = np.flatnonzero(~((slots == 0).all(axis=1) | (slots == 0xFF).all(axis=1)))
    return int(written[-1]) + 1 if len(written) else 0


@dataclass(frozen=True, slots=True)
class Group:
    """Slots that wait for the next time.

    Attributes:
        slots: (n, 6).
        first: number of the first one within the file.
    """

    slots: Slots
    first: int


NOTHING = Group(np.empty((0, SLOT_BYTES), np.uint8), 0)


class Grouper:
    """Makes groups of samples, each from one time to the next, of the pages of a file in their order.

    Pages that hold nothing are damage only where others follow them.

    Args:
        start_byte: where the first page lies.
        next_us: time of the first sample, by the first time in the file.
    """

    def __init__(self, spacing: Spacing, start_byte: int, next_us: int) -> None:
        self._spacing = spacing
        self._start_byte = start_byte
        self._next_us = next_us
        self._longest = LONGEST_S * spacing.rows
        self._open = NOTHING
        self._empty: list[int] = []
        self._position = 0

    def feed(self, raw: RawBlock) -> tuple[Found, PageBlock]:
        """Places and groups that are complete now; counts are raw values, and rows faulty where damaged."""
        found, blocks = Found(), list[PageBlock]()
        erased = empty_pages(raw.pages)
        edges = [0, *(np.flatnonzero(np.diff(erased)) + 1).tolist(), len(erased)]
        for begin, end in pairwise(edges):
            first, pages = raw.first_position + begin, raw.pages[begin:end]
            if begin < end and erased[begin]:
                blocks.append(self._take(NOTHING, found, last=True))
                self._empty += range(first, raw.first_position + end)
            elif begin < end:
                self._pass_over(found)
                blocks.append(self._take(Group(page_slots(pages), first * SLOTS), found, last=False))
        tail = tail_slots(raw.tail)
        if raw.last:
            if used(tail):
                self._pass_over(found)
            blocks.append(self._take(Group(tail, raw.next_position * SLOTS), found, last=True))
        return found, reduce(joined, blocks)

    def _pass_over(self, found: Found) -> None:
        """Note pages that hold nothing, now that others follow them."""
        for page in self._empty:
            found.place(NONSENSE, self._offset(page * SLOTS), self._offset((page + 1) * SLOTS))
        self._position += len(self._empty)
        self._next_us += len(self._empty) * round(float(self._spacing.rows_us(SLOTS)))
        self._empty = []

    def _take(self, new: Group, found: Found, *, last: bool) -> PageBlock:
        """Groups that end within the open one and new slots; all, save unused slots, if none follow."""
        first = self._open.first if len(self._open.slots) else new.first
        slots = np.concatenate((self._open.slots, new.slots))
        slots = slots[: used(slots)] if last else slots
        good, kind = sound(slots), kinds(slots)
        begins = good & (kind == TIME)
        edges = self._edges(begins)
        if not last:
            edges = edges[:-1] if len(slots) - edges[-2] <= self._longest else edges
        self._open = Group(slots[edges[-1] :].copy(), first + int(edges[-1]))
        is_row = ~good | (kind == SAMPLE)
        rows = np.diff(np.concatenate(([0], np.cumsum(is_row)))[edges])
        time_us = self._times(slots, begins, edges, rows)
        held = np.flatnonzero(rows > 0)
        for group in held.tolist():
            offsets = (self._offset(first + int(edges[at])) for at in (group, group + 1))
            found.place(GOOD, *offsets)
        end = int(edges[-1])
        taken = slots[:end][is_row[:end]]
        block = PageBlock(
            position=self._position + np.arange(len(held)),
            rows=rows[held],
            counts=raw_values(taken),
            time_us=time_us[held],
            faulty=~good[:end][is_row[:end]],
        )
        self._position += len(held)
        return block

    def _edges(self, begins: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Where groups begin, and the end of all slots; at least two numbers."""
        marks = np.unique(np.concatenate(([0], np.flatnonzero(begins))))
        sizes = np.diff(marks, append=len(begins))
        if sizes.max() > self._longest:
            ends = zip(marks.tolist(), (marks + np.maximum(sizes, 1)).tolist(), strict=True)
            marks = np.concatenate([np.arange(at, end, self._longest) for at, end in ends])
        return np.append(marks, len(begins))

    def _times(
        self,
        slots: Slots,
        begins: NDArray[np.bool_],
        edges: NDArray[np.int64],
        rows: NDArray[np.int64],
    ) -> NDArray[np.int64]:
        """Of each group: its own time, or by the next one's, or by the one before [us]."""
        if not len(rows):
            return np.empty(0, np.int64)
        own = np.append(begins, False)[edges]
        known = np.concatenate((slots, np.zeros((1, SLOT_BYTES), np.uint8)))[edges]
        stamps = seconds(known) * MICROSECONDS
        lasted = np.rint(self._spacing.rows_us(rows)).astype(np.int64)
        time_us = stamps[:-1].copy()
        for group in np.flatnonzero(~own[:-1]).tolist():
            before = self._next_us if group == 0 else int(time_us[group - 1] + lasted[group - 1])
            time_us[group] = stamps[group + 1] - lasted[group] if own[group + 1] else before
        self._next_us = int(time_us[-1] + lasted[-1])
        return time_us

    def _offset(self, slot: int) -> int:
        """Where a slot lies in the (uncompressed) file."""
        page, within = divmod(slot, SLOTS)
        return self._start_byte + page * PAGE_BYTES + within * SLOT_BYTES
