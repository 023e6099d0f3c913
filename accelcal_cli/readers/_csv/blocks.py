"""A text file as blocks of whole lines."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.readers._stream import ByteSource

PIECE_BYTES = 1 << 18
"""Taken from the file at a time. Fixed, so that a damaged gzip breaks at the same byte in every run."""

LONGEST_LINE = 1 << 20
CACHED_BYTES = 1 << 18
LINE_END = ord("\n")


@dataclass(frozen=True, slots=True)
class Block:
    """Whole lines of a file.

    Attributes:
        data: the lines.
        tail: the rest of the file behind its last line end; only in the last block.
        line: number of its first line, from 1.
        lines: how many lines `data` has.
        offset: byte at which it begins, in the uncompressed stream.
        end: byte behind its last line end.
        end_byte: how far the file on the disk has been read.
        last: nothing follows.
        broken: the compressed data ended early or is damaged.
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

    def without_lines(self) -> Block:
        """Where it lies, without the memory of its lines."""
        return replace(self, data=b"")


def lone_block(data: bytes, line: int, offset: int) -> Block:
    """Some lines of a file, looked at by themselves."""
    return Block(data, b"", line, count_lines(data), offset, offset + len(data), 0, False, False)


class LineFile:
    """A text file, plain or gzip, read once from its beginning."""

    def __init__(self, path: Path, bare_returns: bool = False) -> None:
        self._source = ByteSource(path)
        self._bare_returns = bare_returns

    def close(self) -> None:
        """Release the file."""
        self._source.close()

    def read(self, count: int) -> bytes:
        """At least `count` bytes, fewer only at the end of the data."""
        return b"".join(self._pieces(count))

    def _pieces(self, count: int) -> list[bytes]:
        parts: list[bytes] = []
        while count > 0 and (part := self._piece()):
            parts.append(part)
            count -= len(part)
        return parts

    def _piece(self) -> bytes:
        piece = self._source.read(PIECE_BYTES)
        self._source.refuse_untrue()
        return piece.replace(b"\r", b"\n") if self._bare_returns else piece

    def blocks(self, start: int, line: int, block_bytes: int) -> Iterator[Block]:
        """All lines from byte `start`, which begins line number `line`, about `block_bytes` at a time.

        Raises:
            UnreadableError: a line does not end within 1 MiB, or the disk fails.
        """
        fresh = [self.read(start + block_bytes)[start:]]
        tail, offset, last = b"", start, False
        while not last:
            data, tail = _cut([tail, *fresh])
            fresh = self._pieces(block_bytes)
            last = not fresh
            if len(tail) > LONGEST_LINE and not data:
                raise UnreadableError(
                    "a line has no end", path=self._source.path, line=line, byte_offset=offset
                )
            if data or last:
                rest, lines = tail if last else b"", count_lines(data)
                disk, broken = self._source.disk_position(), self._source.broken
                yield Block(data, rest, line, lines, offset, offset + len(data), disk, last, broken)
                line += lines
                offset += len(data)


def _cut(pieces: list[bytes]) -> tuple[bytes, bytes]:
    """All whole lines of pieces that follow each other, and what is left."""
    for number in reversed(range(len(pieces))):
        piece = pieces[number]
        if cut := piece.rfind(b"\n") + 1:
            whole = b"".join((*pieces[:number], memoryview(piece)[:cut]))
            return whole, b"".join((piece[cut:], *pieces[number + 1 :]))
    return b"", b"".join(pieces)


def count_lines(data: bytes) -> int:
    """How many line ends there are; several times as fast as `bytes.count` where lines are short."""
    view = np.frombuffer(data, np.uint8)
    return sum(
        int(np.count_nonzero(view[start : start + CACHED_BYTES] == LINE_END))
        for start in range(0, len(view), CACHED_BYTES)
    )
