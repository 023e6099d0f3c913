"""Pages that differ in length: which were found in a part of the file, and where they lie.

A format's scanner notes each place of the file as a page or as what it is instead; a PageJoiner then asks
here for its bytes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar


@dataclass(slots=True)
class Found:
    """Places of a part of the file in their order.

    Attributes:
        status: what each place is: GOOD, a sound page, or a key of BAD_KINDS.
        offset: where each begins, bytes from the start of the (uncompressed) file.
        length: bytes of each.
        cut: where a page begins that the end of the file cuts off, None without one.
    """

    status: list[int] = field(default_factory=list)
    offset: list[int] = field(default_factory=list)
    length: list[int] = field(default_factory=list)
    cut: int | None = None

    def place(self, status: int, offset: int, end: int) -> None:
        """Add one of any kind, up to byte `end`."""
        self.status.append(status)
        self.offset.append(offset)
        self.length.append(end - offset)


AnyFound = TypeVar("AnyFound", bound=Found)


@dataclass(frozen=True, slots=True)
class Part(Generic[AnyFound]):
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
    found: AnyFound
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


Found_co = TypeVar("Found_co", bound=Found, covariant=True)


class Scanner(Protocol[Found_co]):
    """Finds the places in consecutive bytes of a file."""

    def feed(self, data: bytes, *, last: bool) -> Found_co:
        """Those that can be seen whole with the next bytes; there may be none."""
        ...


class PlaceCutter(Generic[AnyFound]):
    """Finds the places in the bytes of a growing file.

    Args:
        scanner: of the bytes from `start` on.
        start: bytes of the header before them.
    """

    def __init__(self, scanner: Scanner[AnyFound], start: int) -> None:
        self._scanner, self._skip = scanner, start
        self._position = self._taken = 0

    def cut(self, data: bytes, *, last: bool) -> Part[AnyFound]:
        """The places that can be seen whole with the next bytes; there may be none."""
        self._taken += len(data)
        skipped = min(self._skip, len(data))
        self._skip -= skipped
        found = self._scanner.feed(data[skipped:], last=last)
        part = Part(self._position, found, self._taken, self._taken, last)
        self._position = part.next_position
        return part


class PartPlaces:
    """Where the places of the part lie that is being read.

    Args:
        page_bytes: about how long a page is.
    """

    part: Part[Any]

    def __init__(self, page_bytes: int) -> None:
        self.page_bytes = page_bytes

    def offset(self, position: int) -> int:
        """Bytes from the start of the (uncompressed) file."""
        return self.part.offset(position)

    def length(self, position: int, pages: int) -> int:
        """Bytes of so many places."""
        return self.part.length(position, pages)
