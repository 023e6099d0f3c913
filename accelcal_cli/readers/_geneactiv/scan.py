"""Finding the pages in the text of a file, damaged or not, a stretch of it at a time."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from accelcal_cli.readers._geneactiv.page import (
    BODY_DIGITS,
    HEAD,
    LONGEST_BYTES,
    SAMPLE_DIGITS,
    SAMPLES,
    SHORTEST_BYTES,
)
from accelcal_cli.readers._geneactiv.signature import MARK
from accelcal_cli.readers._pages.pages import GOOD, LENGTH, NO_PAGE, TEXT

_BLANK = re.compile(rb"\s+")
CARRIAGE_RETURN = 13
Head = tuple[bytes, ...]
"""Serial number, sequence number, time, temperature and rate of a page, as they stand there."""


@dataclass(slots=True)
class Found:
    """Places of a stretch of the file in their order.

    Attributes:
        status: what each place is: GOOD, a page whose text and length are right, or a key of BAD_KINDS.
        offset: where each begins, bytes from the start of the (uncompressed) file.
        length: bytes of each, up to the next page.
        heads, bodies: of the GOOD ones. A body has 3600 characters, fewer only in a page that the
            end of the file cuts off, whose whole samples these are.
        cut: where a page begins that the end of the file cuts off, None without one.
        cut_samples: whole samples of that page.
    """

    status: list[int] = field(default_factory=list)
    offset: list[int] = field(default_factory=list)
    length: list[int] = field(default_factory=list)
    heads: list[Head] = field(default_factory=list)
    bodies: list[bytes] = field(default_factory=list)
    cut: int | None = None
    cut_samples: int = 0

    def place(self, status: int, offset: int, end: int) -> None:
        """Add one of any kind, up to byte `end`."""
        self.status.append(status)
        self.offset.append(offset)
        self.length.append(end - offset)

    def page(self, offset: int, end: int, head: Head, body: bytes) -> None:
        """Add a GOOD one."""
        self.place(GOOD, offset, end)
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

    def feed(self, data: bytes, *, last: bool, stop: int | None = None) -> Found:
        """The places that begin in the text so far and can be seen whole.

        Args:
            last: nothing follows.
            stop: leave out places that begin so many bytes after the start of the text, or later.
        """
        text, found = self._rest + data, Found()
        end = len(text) if last else len(text) - LONGEST_BYTES + 1
        end = end if stop is None else min(end, stop)
        match, at = HEAD.match, 0
        while at < end:
            if self._searching:
                at = self._search(text, at, last=last)
                if not self._searching:
                    self._close(at, found)
                continue
            head = match(text, at)
            begin = len(text) if head is None else head.end()
            close = text.find(b"\n", begin, begin + BODY_DIGITS + 2)
            if head is None or not _is_whole(text, begin, close):
                at = self._last(text, at, head, found) if last else self._other(text, at, head)
                continue
            digits = text[begin : begin + BODY_DIGITS]
            found.page(self._offset + at, self._offset + close + 1, head.groups(), digits)
            at = close + 1
        if last:
            self._close(at, found)
        self._rest, self._offset = text[at:], self._offset + at
        return found

    def _close(self, at: int, found: Found) -> None:
        """What was no page reaches up to here."""
        if self._bad is not None:
            found.place(*self._bad, self._offset + at)
        self._bad = None

    def _search(self, text: bytes, at: int, *, last: bool) -> int:
        """Where the next page begins, or up to where none does."""
        place = text.find(MARK, at)
        self._searching = place < 0
        begun = 0 if last else len(MARK) - 1
        return max(at, len(text) - begun) if self._searching else place

    def _last(self, text: bytes, at: int, head: re.Match[bytes] | None, found: Found) -> int:
        """Take in what is no whole page near the end of the file, which may have cut a page off."""
        if head is not None:
            digits = text[head.end() : head.end() + BODY_DIGITS + 2].removesuffix(b"\r")
            cut = len(digits) <= BODY_DIGITS and b"\n" not in digits
        else:
            begun = text.startswith(MARK, at) or MARK.startswith(text[at : at + len(MARK)])
            cut = begun and len(text) - at < SHORTEST_BYTES and text.find(MARK, at + 1) < 0
            digits = b""
        if not cut:
            return self._other(text, at, head)
        samples = len(digits) // SAMPLE_DIGITS
        if samples < SAMPLES:
            found.cut, found.cut_samples = self._offset + at, samples
        if head is not None and samples:
            begin, end = self._offset + at, self._offset + len(text)
            found.page(begin, end, head.groups(), digits[: samples * SAMPLE_DIGITS])
        return len(text)

    def _other(self, text: bytes, at: int, head: re.Match[bytes] | None) -> int:
        """Begin with what is no page; gives where to go on."""
        blank = _BLANK.match(text, at)
        if blank:
            return blank.end()
        begun = text.startswith(MARK, at)
        self._bad = (NO_PAGE if not begun else TEXT if head is None else LENGTH), self._offset + at
        self._searching = True
        return at + len(MARK) if begun else at


def _is_whole(text: bytes, begin: int, close: int) -> bool:
    """Whether the line that begins and closes here has the digits of a page."""
    over = close - begin - BODY_DIGITS
    return over == 0 or (over == 1 and text[close - 1] == CARRIAGE_RETURN)
