"""A piece of log.bin: records one after the other, and where one can be believed after damage."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.readers._gt3x.layout import (
    FRAME_BYTES,
    SEPARATOR,
    SOUND,
    Records,
    fits,
    records_at,
    telling,
)

SEPARATOR_BYTE = bytes([SEPARATOR])
PADDING_BYTES = FRAME_BYTES - 1
"""So many zeros between records are padding, as the format's document allows; more hide a record."""


@dataclass(frozen=True, slots=True)
class Span:
    """Seconds since 1970 between which a recording's records are expected."""

    first_s: int
    last_s: int


ANY_TIME = Span(0, 1 << 32)


@dataclass(frozen=True, eq=False)
class Page:
    """A piece of log.bin.

    Attributes:
        base: where it begins.
        last: nothing follows.
    """

    data: bytes
    base: int
    last: bool
    span: Span

    @cached_property
    def buffer(self) -> NDArray[np.uint8]:
        """The bytes, (n,)."""
        return np.frombuffer(self.data, np.uint8)

    @cached_property
    def believable(self) -> NDArray[np.int64]:
        """Where records begin that can be believed without knowing what comes before them.

        Their checksum is right, kind and size go together, and either the next such record
        follows or both time and size are those of a recording.
        """
        records = self._candidates()
        end = records.start + records.size + FRAME_BYTES
        so_far = np.bitwise_xor.accumulate(self.buffer)
        before = np.where(records.start > 0, so_far[records.start - 1], 0)
        sound = (so_far[end - 1] ^ before) == SOUND
        records, end = records.select(sound), end[sound]
        near = (records.second >= self.span.first_s) & (records.second <= self.span.last_s)
        followed = np.isin(end, records.start) | (self.last & (end == len(self.data)))
        return np.asarray(records.start[followed | (near & telling(records))])

    def _candidates(self) -> Records:
        room = max(0, len(self.data) - FRAME_BYTES + 1)
        records = records_at(self.buffer, np.flatnonzero(self.buffer[:room] == SEPARATOR))
        inside = records.start + records.size + FRAME_BYTES <= len(self.data)
        return records.select(inside & fits(records))

    def incomplete(self, at: int) -> bool:
        """Whether what is at `at` could be a record that goes on beyond the piece."""
        left = len(self.data) - at
        return left < FRAME_BYTES or (self.data[at] == SEPARATOR and left < self.length(at))

    def length(self, at: int) -> int:
        """Bytes of the record at `at`, by its header."""
        return FRAME_BYTES + (self.data[at + 6] | self.data[at + 7] << 8)

    def after_padding(self, at: int) -> int:
        """Where a record or the end of the data follows after a few zeros; `at` where that is not so."""
        ahead = self.data[at : at + FRAME_BYTES]
        zeros = len(ahead) - len(ahead.lstrip(b"\0"))
        ends = self.last and at + zeros == len(self.data) and zeros <= PADDING_BYTES
        return at + zeros if ends or ahead[zeros : zeros + 1] == SEPARATOR_BYTE else at

    def follow(self, at: int, most: int) -> tuple[list[int], int]:
        """Sound records one after the other from `at` on, up to `most`; where the next should be."""
        starts, end = walk(self.data, at, most)
        if not starts:
            return starts, at
        start = np.array(starts, np.int64)
        sound = np.bitwise_xor.reduceat(self.buffer[:end], start) == SOUND
        goes_on = end == len(self.data) or self.data[end] == SEPARATOR
        sound[-1] &= goes_on or bool(fits(records_at(self.buffer, start[-1:]))[0])
        good = len(starts) if sound.all() else int(np.argmin(sound))
        return starts[:good], end if good == len(starts) else starts[good]


def walk(data: bytes, at: int, most: int) -> tuple[list[int], int]:
    """Where complete records begin, by their sizes alone, and where the last of them ends."""
    starts: list[int] = []
    room = len(data) - FRAME_BYTES
    while at <= room and data[at] == SEPARATOR and len(starts) < most:
        after = at + FRAME_BYTES + (data[at + 6] | data[at + 7] << 8)
        if after > len(data):
            break
        starts.append(at)
        at = after
    return starts, at


def spoiled_records(data: bytes) -> int:
    """How many records the bytes are by their sizes, the first of which may lack its separator; or 0."""
    starts, reached = walk(SEPARATOR_BYTE + data[1:], 0, len(data))
    return len(starts) if reached == len(data) and any(data) else 0
