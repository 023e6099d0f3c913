"""Finding the pages in the text of a GENEActiv .bin file, damaged or not, a part of the file at a time.

The text of a page is nine lines of `key:value`, then 300 samples as one line of 3600 hexadecimal digits.
Numbers have as many digits as they need, lines end in LF or CR LF, and the decimal sign may be a comma (as
computers of some countries wrote it), so that pages differ in length. Source: Activinsights, GENEActiv
instructions, "Understanding .bin files".
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.formats._pages.files import ScannedPages
from accelcal_cli.formats._pages.pages import GOOD, LENGTH, NO_PAGE, TEXT
from accelcal_cli.formats._rows import MISSING
from accelcal_cli.formats.geneactiv import MARK, PAGE_HEAD

SAMPLES = 300
SAMPLE_DIGITS = 12
BODY_DIGITS = SAMPLES * SAMPLE_DIGITS
USUAL_BYTES = 3840
"""About how long a page is."""

LONGEST_BYTES = 4608
"""A page is never longer than this, by the limits of the pattern below."""

SHORTEST_BYTES = BODY_DIGITS + 150

HEAD = re.compile(PAGE_HEAD)
_NUMBER = re.compile(rb"(-?\d{1,6}(?:[.,]\d{1,6})?)(?: Hz)?")
STAMP_BYTES = 23
NO_STAMP = int(np.iinfo(np.int64).min)
"""Marks a time that is none, such as the 31st of February."""

_BLANK = re.compile(rb"\s+")
CARRIAGE_RETURN = 13
Head = tuple[bytes, ...]
"""Serial number, sequence number, time, temperature and rate of a page, as they stand there."""


def number(text: bytes) -> Fraction | None:
    """A decimal number, with a point or a comma; None if the text is not one."""
    match = _NUMBER.fullmatch(text.strip())
    return Fraction(match[1].replace(b",", b".").decode("ascii")) if match else None


@lru_cache(maxsize=4096)
def temperature_mc(text: bytes) -> int:
    """Thousandths of a degree C of a page's temperature; MISSING if it states none."""
    value = number(text)
    return MISSING if value is None else round(value * 1000)


def stamps_us(texts: Sequence[bytes]) -> NDArray[np.int64]:
    """Microseconds since 1970 of page times that HEAD accepts, (p,); NO_STAMP for those that are none."""
    even = b"".join(text if len(text) == STAMP_BYTES else _padded(text) for text in texts)
    digits = np.frombuffer(even, np.uint8).reshape(-1, STAMP_BYTES).astype(np.int64) - ord("0")
    year = digits[:, :4] @ np.array([1000, 100, 10, 1])
    month, day, hour, minute, second = (digits[:, at] * 10 + digits[:, at + 1] for at in (5, 8, 11, 14, 17))
    milli = digits[:, 20:23] @ np.array([100, 10, 1])
    known = (month >= 1) & (month <= 12) & (day >= 1) & (hour < 24) & (minute < 60) & (second < 60)
    begun = ((year - 1970) * 12 + month - 1).astype("M8[M]")
    known &= begun.astype("M8[D]") + (day - 1) < (begun + 1).astype("M8[D]")
    days = begun.astype("M8[D]").astype(np.int64) + day - 1
    time_us = (((days * 24 + hour) * 60 + minute) * 60 + second) * 1_000_000 + milli * 1000
    return np.where(known, time_us, NO_STAMP)


def _padded(text: bytes) -> bytes:
    """A page time with all its leading zeros."""
    year, *numbers, milli = re.split(rb"[- :]", text)
    month, day, hour, minute, second = (part.zfill(2) for part in numbers)
    return b"%s-%s-%s %s:%s:%s:%s" % (year, month, day, hour, minute, second, milli)


@dataclass(slots=True)
class TextPages(ScannedPages):
    """Places of a stretch of the file in their order.

    A GOOD one is a page whose text and length are right; each reaches up to the next page.

    Attributes:
        heads, bodies: of the GOOD ones. A body has 3600 characters, fewer only in a page that the
            end of the file cuts off, whose whole samples these are.
        cut_samples: whole samples of the page that the end of the file cuts off.
    """

    heads: list[Head] = field(default_factory=list)
    bodies: list[bytes] = field(default_factory=list)
    cut_samples: int = 0

    def page(self, offset: int, end: int, head: Head, body: bytes) -> None:
        """Add a GOOD one."""
        self.add(GOOD, offset, end)
        self.heads.append(head)
        self.bodies.append(body)


class Scanner:
    """Takes a file's text in stretches of any length; what is found does not depend on them.

    Every page begins with a line of its own, at which the search goes on after damage.

    Args:
        offset: where in the file the text begins.
        inside: it may begin within a page; what comes before the first one is passed over.
    """

    def __init__(self, offset: int, *, inside: bool = False) -> None:
        self._offset = offset
        self._rest = b""
        self._searching = inside
        self._bad: tuple[int, int] | None = None

    def feed(self, data: bytes, *, last: bool, stop: int | None = None) -> TextPages:
        """The places that begin in the text so far and can be seen whole.

        Args:
            last: nothing follows.
            stop: leave out places that begin so many bytes after the start of the text, or later.
        """
        text, found = self._rest + data, TextPages()
        end = len(text) if last else len(text) - LONGEST_BYTES + 1
        end = end if stop is None else min(end, stop)
        match, index = HEAD.match, 0
        while index < end:
            if self._searching:
                index = self._search(text, index, last=last)
                if not self._searching:
                    self._close(index, found)
                continue
            head = match(text, index)
            begin = len(text) if head is None else head.end()
            close = text.find(b"\n", begin, begin + BODY_DIGITS + 2)
            if head is None or not _is_whole(text, begin, close):
                index = self._last(text, index, head, found) if last else self._other(text, index, head)
                continue
            digits = text[begin : begin + BODY_DIGITS]
            found.page(self._offset + index, self._offset + close + 1, head.groups(), digits)
            index = close + 1
        if last:
            self._close(index, found)
        self._rest, self._offset = text[index:], self._offset + index
        return found

    def _close(self, index: int, found: TextPages) -> None:
        """What was no page reaches up to here."""
        if self._bad is not None:
            found.add(*self._bad, self._offset + index)
        self._bad = None

    def _search(self, text: bytes, index: int, *, last: bool) -> int:
        """Where the next page begins, or up to where none does."""
        place = text.find(MARK, index)
        self._searching = place < 0
        begun = 0 if last else len(MARK) - 1
        return max(index, len(text) - begun) if self._searching else place

    def _last(self, text: bytes, index: int, head: re.Match[bytes] | None, found: TextPages) -> int:
        """Take in what is no whole page near the end of the file, which may have cut a page off."""
        if head is not None:
            digits = text[head.end() : head.end() + BODY_DIGITS + 2].removesuffix(b"\r")
            cut = len(digits) <= BODY_DIGITS and b"\n" not in digits
        else:
            begun = text.startswith(MARK, index) or MARK.startswith(text[index : index + len(MARK)])
            cut = begun and len(text) - index < SHORTEST_BYTES and text.find(MARK, index + 1) < 0
            digits = b""
        if not cut:
            return self._other(text, index, head)
        samples = len(digits) // SAMPLE_DIGITS
        if samples < SAMPLES:
            found.cut_at, found.cut_samples = self._offset + index, samples
        if head is not None and samples:
            begin, end = self._offset + index, self._offset + len(text)
            found.page(begin, end, head.groups(), digits[: samples * SAMPLE_DIGITS])
        return len(text)

    def _other(self, text: bytes, index: int, head: re.Match[bytes] | None) -> int:
        """Begin with what is no page; gives where to go on."""
        blank = _BLANK.match(text, index)
        if blank:
            return blank.end()
        begun = text.startswith(MARK, index)
        self._bad = (NO_PAGE if not begun else TEXT if head is None else LENGTH), self._offset + index
        self._searching = True
        return index + len(MARK) if begun else index


def _is_whole(text: bytes, begin: int, close: int) -> bool:
    """Whether the line that begins and closes here has the digits of a page."""
    over = close - begin - BODY_DIGITS
    return over == 0 or (over == 1 and text[close - 1] == CARRIAGE_RETURN)
