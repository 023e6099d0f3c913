"""Quotes in lines of text: one grammar, RFC 4180, before whatever splits them into cells.

A cell that begins with a quote lasts to its closing quote; in between, two quotes are one, and delimiters and
line ends are text. A quote elsewhere is a letter. Parsers that meet an opening quote without its closing one
take all that follows for its cell; `Quotes.settled` leaves them none, so that it costs at most its own line.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

MOST_JOINED = 64
"""Lines behind the first one over which a cell in quotes may reach."""

QUOTE, LETTER = b'"', b"'"
LINE_END, RETURN = b"\n\r"
NO_LINES = np.empty(0, np.int64)


@dataclass(frozen=True, slots=True)
class Settled:
    """Lines in each of which every opening quote has its closing one.

    Attributes:
        text: as many bytes as before; a line end within a cell is a blank, and a quote that is never closed
            an apostrophe.
        joined: (n,) numbers, from 0, of the lines whose ends became blanks.
    """

    text: bytes
    joined: NDArray[np.int64]

    def first_of(self, lines: int) -> NDArray[np.int64]:
        """Return the number of the line, of all before they were settled, at which each line begins."""
        first = np.arange(lines, dtype=np.int64)
        return np.delete(first, self.joined + 1) if len(self.joined) else first


@dataclass(frozen=True)
class Quotes:
    """The quotes of one file.

    Attributes:
        normaliser: changes lines as they are changed before they are parsed.
        delimiter: between the columns.
        columns: the number of cells of a row.
    """

    normaliser: Callable[[bytes], bytes]
    delimiter: str
    columns: int

    @cached_property
    def _mark(self) -> bytes:
        return self.delimiter.encode()

    def settled(self, text: bytes, join: bool = True) -> Settled:
        """Return normalised lines with their quotes settled.

        A line that a quote leaves open is joined with the next ones, at most `MOST_JOINED`, if these close
        the cell and give a row, and are not rows by themselves.

        Args:
            join: the lines follow each other in the file.
        """
        if QUOTE not in text:
            return Settled(text, NO_LINES)
        lines, out, joined = _Lines(text), bytearray(text), list[int]()
        for first, found in self._open_lines(lines, join):
            last = first if found is None else found
            joined += range(first, last)
            for end in lines.ends[first:last].tolist():
                begin = end - (text[end - 1] == RETURN)
                out[begin : end + 1] = b" " * (end + 1 - begin)
            if first == last:
                (start, stop), line = lines.bounds(first), lines[first]
                while (place := self._open_quote(line)[0]) >= 0:
                    line = line[:place] + LETTER + line[place + 1 :]
                out[start:stop] = line
        return Settled(bytes(out), np.array(joined, np.int64))

    def sure_bytes(self, lines: bytes) -> int:
        """Return how many bytes of whole lines, from the first, can be settled without the next ones."""
        tail = len(lines)
        for _ in range(MOST_JOINED + 1):
            tail = lines.rfind(b"\n", 0, max(tail, 0))
        if QUOTE not in lines[tail + 1 :]:
            return len(lines)
        for first, last in self._open_lines(_Lines(self.normaliser(lines)), join=True):
            if last is None:
                return _Lines(lines).bounds(first)[0]
        return len(lines)

    def _open_lines(self, lines: _Lines, join: bool) -> Iterator[tuple[int, int | None]]:
        """Yield each line that a quote leaves open, and the line in which its cell ends: itself if in none.

        The latter is None where the lines end before that shows.
        """
        last = -1
        for line in self._doubtful(lines).tolist():
            if line > last and self._open_quote(lines[line])[0] >= 0:
                found = self._last_line(lines, line) if join else line
                yield line, found
                last = line if found is None else found

    def _last_line(self, lines: _Lines, first: int) -> int | None:
        parts = [lines[first]]
        for line in range(first + 1, min(first + MOST_JOINED + 1, len(lines))):
            parts.append(lines[line])
            if QUOTE in parts[-1]:
                place, cells = self._open_quote(b" ".join(parts))
                if place < 0:
                    fits = cells == self.columns and not (self._is_row(parts[0]) and self._is_row(parts[-1]))
                    return line if fits else first
            if self._is_row(parts[-1]):
                return first
        return first if first + MOST_JOINED < len(lines) else None

    def _is_row(self, line: bytes) -> bool:
        """Return True if a line has the cells of a row, by its quotes or without regard to them."""
        place, cells = self._open_quote(line)
        return line.count(self._mark) + 1 == self.columns or (place < 0 and cells == self.columns)

    def _open_quote(self, line: bytes) -> tuple[int, int]:
        """Return the place of the quote that a line does not close, -1 if there is none, and its cells."""
        place, cells = 0, 1
        while True:
            if line.startswith(QUOTE, place):
                begin, place = place, _behind_closing(line, place + 1)
                if place < 0:
                    return begin, cells
            place = line.find(self._mark, place) + 1
            if not place:
                return -1, cells
            cells += 1

    def _doubtful(self, lines: _Lines) -> NDArray[np.int64]:
        """Return the lines whose quotes are not simply one before, and one behind a cell, or doubled."""
        view = np.frombuffer(lines.text, np.uint8)
        quotes = np.flatnonzero(view == QUOTE[0])
        before = np.searchsorted(quotes, lines.ends)
        number = np.diff(before, prepend=0)
        line = np.repeat(np.arange(len(number)), number)
        opens = (np.arange(len(quotes)) - np.repeat(before - number, number)) % 2 == 0
        neighbours = np.frombuffer(b"\n" + lines.text + b"\n", np.uint8)
        beside = np.where(opens, neighbours[quotes], neighbours[quotes + 2])
        right = np.isin(beside, np.frombuffer(b'\n"' + self._mark, np.uint8))
        right |= ~opens & (beside == RETURN)
        doubtful = number % 2 == 1
        doubtful[line[~right]] = True
        return np.flatnonzero(doubtful)


class _Lines:
    """Lines of a text by their number, without their ends."""

    def __init__(self, text: bytes) -> None:
        self.text = text
        self.ends = np.flatnonzero(np.frombuffer(text, np.uint8) == LINE_END)
        if text and not text.endswith(b"\n"):
            self.ends = np.append(self.ends, len(text))

    def __len__(self) -> int:
        return len(self.ends)

    def bounds(self, line: int) -> tuple[int, int]:
        """Return where a line begins, and where its end is."""
        return int(self.ends[line - 1]) + 1 if line else 0, int(self.ends[line])

    def __getitem__(self, line: int) -> bytes:
        start, stop = self.bounds(line)
        return self.text[start:stop]


def _behind_closing(line: bytes, place: int) -> int:
    """Return the place behind the next quote that is not doubled, -1 if there is none."""
    while (place := line.find(QUOTE, place)) >= 0:
        if not line.startswith(QUOTE, place + 1):
            return place + 1
        place += 2
    return -1
