"""A file as text with pages in it, read a part at a time."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path

from accelcal_cli.readers._geneactiv.page import LONGEST_BYTES, USUAL_BYTES
from accelcal_cli.readers._geneactiv.scan import Found, Scanner
from accelcal_cli.readers._stream import ByteSource


@dataclass(frozen=True, slots=True)
class Part:
    """Consecutive places of a file; also what a PageJoiner asks of them.

    Attributes:
        first_position: number of the first place.
        end: how far the part reaches in the (uncompressed) file, bytes.
        end_byte: and on disk, for progress.
        last: nothing follows.
        broke_off: the compressed data broke off rather than ended.
        tail, broken, undecoded: none, for the joiner; a page that is cut off stands in `found`.
    """

    first_position: int
    found: Found
    end: int
    end_byte: int
    last: bool
    broke_off: bool = False
    tail: bytes = b""
    broken: bool = False
    undecoded: int = 0

    @property
    def next_position(self) -> int:
        """Number of the place after these."""
        return self.first_position + len(self.found.status)

    def offset(self, position: int) -> int:
        """Where a place of this part begins, bytes from the start of the (uncompressed) file."""
        return self.found.offset[position - self.first_position]

    def length(self, position: int, pages: int) -> int:
        """Bytes of so many places of this part."""
        first = position - self.first_position
        return sum(self.found.length[first : first + pages])


@dataclass(frozen=True, slots=True)
class TextFile:
    """Where the pages lie.

    Attributes:
        start: where the first one begins, or the search for it, bytes.
        size: bytes on disk.
    """

    path: Path
    start: int
    size: int
    compressed: bool

    def parts(self, pages: int) -> Generator[Part]:
        """All places of the file, those of about `pages` pages at a time; a part may be empty.

        Raises:
            UnreadableError: the disk fails, or a gzip file is damaged within.
        """
        with ByteSource(self.path) as source:
            source.read_exact(self.start)
            scanner = Scanner(self.start)
            position, end, last = 0, self.start, False
            while not last:
                data = source.read_exact(pages * USUAL_BYTES)
                source.refuse_untrue()
                last, end = len(data) < pages * USUAL_BYTES, end + len(data)
                found = scanner.feed(data, last=last)
                yield Part(position, found, end, source.disk_position(), last, source.broken)
                position += len(found.status)

    def piece(self, offset: int, length: int) -> Part:
        """The places that begin within `length` bytes from `offset` on, in an uncompressed file."""
        with ByteSource(self.path) as source:
            source.seek(offset)
            data = source.read_exact(length + LONGEST_BYTES)
        end = offset + len(data)
        found = Scanner(offset, inside=True).feed(data, last=True, stop=length)
        return Part(0, found, end, end, True)
