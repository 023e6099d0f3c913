"""Reads a text file as blocks of whole lines: a file from its beginning, or one that grows."""

from __future__ import annotations

import codecs
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import wide_text
from accelcal_cli.core.recording import Closing
from accelcal_cli.formats._bytes import ByteSource
from accelcal_cli.formats.tables.cells import BYTE_ORDER_MARK
from accelcal_cli.formats.tables.header import Piece
from accelcal_cli.formats.tables.text.quotes import Quotes

PIECE_BYTES = 1 << 18
"""Bytes taken from the file at a time."""

CACHED_BYTES = 1 << 18
"""Bytes in which line ends are counted at a time."""

LONGEST_LINE = 1 << 20
LINE_END = ord("\n")
BLANKS = (b"\n", b"\r")


@dataclass(frozen=True, slots=True)
class LineBlock(Piece):
    """Whole lines of a file.

    Attributes:
        data: the lines; lines: how many they are; line: number of the first, from 1.
        tail: the rest of the file behind its last line end; only in the last block.
        end: byte behind its last line end, in the uncompressed stream.
        broken: the compressed data ended early or is damaged.
        zeros: how many bytes of value 0 follow the tail, where they are too many to be kept.
        heads: the lines up to here in which the names of the columns stand again.
    """

    data: bytes
    tail: bytes
    line: int
    lines: int
    offset: int
    end: int
    end_byte: int
    last: bool
    broken: bool
    zeros: int = 0
    heads: Sequence[int] = ()

    def emptied(self) -> LineBlock:
        """Return the place of the block, without the memory of its lines."""
        return replace(self, data=b"")


def lone_block(data: bytes, line: int, offset: int) -> LineBlock:
    """Return a block of some lines of a file that are looked at by themselves."""
    return LineBlock(data, b"", line, count_lines(data), offset, offset + len(data), 0, False, False)


class LineCutter:
    """Cuts the bytes of a text file, in the pieces in which they come, into blocks of whole lines.

    Args:
        skip: bytes before the first line that is wanted.
        line: number of that line.
        quotes: keep lines over which a cell may reach in one block; None: none does.
    """

    def __init__(self, path: Path, skip: int, line: int, quotes: Quotes | None = None) -> None:
        self._path, self._quotes = path, quotes
        self._skip = self._offset = skip
        self._line = line
        self._rest = self._open = b""
        self._zeros = 0

    def cut(self, pieces: list[bytes]) -> bytes:
        """Return the lines that end in the next pieces; there may be none.

        Raises:
            UnreadableError: a line does not end within 1 MiB.
        """
        if self._skip:
            data = b"".join(pieces)
            pieces = [data[self._skip :]]
            self._skip -= min(self._skip, len(data))
        endless = self._zeros > 0 and any(piece.strip(b"\0") for piece in pieces)
        lines, self._rest = _cut([self._rest, *pieces])
        if len(self._rest) > LONGEST_LINE and not lines:
            text = self._rest.rstrip(b"\0")
            self._zeros, self._rest = self._zeros + len(self._rest) - len(text), text
        if endless or (len(self._rest) > LONGEST_LINE and not lines):
            line, offset = self._line + count_lines(self._open), self._offset + len(self._open)
            raise UnreadableError("a line has no end", path=self._path, line=line, byte_offset=offset)
        if self._quotes is None:
            return lines
        lines = self._open + lines if self._open else lines
        sure = self._quotes.sure_bytes(lines)
        self._open = lines[sure:]
        return lines[:sure]

    def block(self, lines: bytes, last: bool, end_byte: int | None = None, broken: bool = False) -> LineBlock:
        """Return the lines that were cut as a block; `end_byte` is set for a file on the disk."""
        if last:
            lines, self._open = lines + self._open, b""
        line, offset, number = self._line, self._offset, count_lines(lines)
        self._line, self._offset = line + number, offset + len(lines)
        rest, zeros = (self._rest, self._zeros) if last else (b"", 0)
        end = self._offset + len(self._open) + len(self._rest) if end_byte is None else end_byte
        return LineBlock(lines, rest, line, number, offset, self._offset, end, last, broken, zeros)


class InUtf8:
    """Makes UTF-8 of text in UTF-16 and UTF-32; any other text stays as it is."""

    def __init__(self) -> None:
        self._decoder: codecs.IncrementalDecoder | None = None
        self._begun = False

    def __call__(self, piece: bytes) -> bytes:
        """Return the next bytes; the first piece decides."""
        if not self._begun and piece:
            self._begun = True
            if (name := wide_text(piece)) is not None:
                self._decoder = codecs.getincrementaldecoder(name)("replace")
        return piece if self._decoder is None else self._decoder.decode(piece).encode()


class LineFile(Closing):
    """A text file, plain or gzip, read once from its beginning."""

    def __init__(self, path: Path, bare_returns: bool = False, threads: int = 1) -> None:
        self._source = ByteSource(path, threads)
        self._bare_returns = bare_returns
        self._in_utf8 = InUtf8()

    def close(self) -> None:
        """Release the file."""
        self._source.close()

    def read(self, count: int) -> bytes:
        """Read `count` bytes, fewer only at the end of the data.

        Raises:
            UnreadableError: the disk fails, or a gzip file is damaged there.
        """
        data = b"".join(self._pieces(count))
        self._source.refuse_damaged()
        return data

    def _pieces(self, count: int) -> list[bytes]:
        parts: list[bytes] = []
        while count > 0 and (read := self._source.read(min(count, PIECE_BYTES))):
            part = self._in_utf8(read)
            parts.append(part.replace(b"\r", b"\n") if self._bare_returns else part)
            count -= len(part)
        return parts

    def blocks(
        self, start: int, line: int, block_bytes: int, quotes: Quotes | None = None
    ) -> Iterator[LineBlock]:
        """Yield all lines from byte `start`, which begins line number `line`, about `block_bytes` at a time.

        Raises:
            UnreadableError: a line does not end within 1 MiB, the disk fails, or, after the lines before that
                place, a gzip file is damaged.
        """
        cutter, last = LineCutter(self._source.path, start, line, quotes), False
        fresh = self._pieces(start + block_bytes)
        while not last:
            lines = cutter.cut(fresh)
            fresh = self._pieces(block_bytes)
            last = not fresh
            if lines or last:
                block = cutter.block(lines, last, self._source.disk_position(), self._source.broken)
                yield replace(block, last=False) if self._source.damaged else block
        self._source.refuse_damaged()


class RepeatedHeads:
    """Blanks the names of the columns where they stand again, as between files that were joined.

    Args:
        head: the file up to its first row.

    Attributes:
        lines: numbers of the lines in which the names stand again.
    """

    def __init__(self, head: bytes) -> None:
        self._head = head.removeprefix(BYTE_ORDER_MARK).splitlines(keepends=True)
        self.lines: list[int] = []

    def without(self, block: LineBlock) -> LineBlock:
        """Return the block with the same lines, those of a repeated head empty."""
        names = self._head[-1] if self._head and not self._head[-1].startswith(BLANKS) else b""
        if not names or names not in block.data:
            return block
        lines = block.data.splitlines(keepends=True)
        for number in range(len(lines)):
            if lines[number] == names:
                self.lines.append(block.line + number)
                for up, line in enumerate(reversed(self._head)):  # as far up as it is the same
                    if number < up or lines[number - up].removeprefix(BYTE_ORDER_MARK) != line:
                        break
                    lines[number - up] = b"\n"
        return replace(block, data=b"".join(lines))


def _cut(pieces: list[bytes]) -> tuple[bytes, bytes]:
    """Return all whole lines of pieces that follow each other, and the rest."""
    for number in reversed(range(len(pieces))):
        piece = pieces[number]
        if cut := piece.rfind(b"\n") + 1:
            whole = b"".join((*pieces[:number], memoryview(piece)[:cut]))
            return whole, b"".join((piece[cut:], *pieces[number + 1 :]))
    return b"", b"".join(pieces)


def count_lines(data: bytes) -> int:
    """Count line ends; several times as fast as `bytes.count` where lines are short."""
    view = np.frombuffer(data, np.uint8)
    return sum(
        int(np.count_nonzero(view[start : start + CACHED_BYTES] == LINE_END))
        for start in range(0, len(view), CACHED_BYTES)
    )
