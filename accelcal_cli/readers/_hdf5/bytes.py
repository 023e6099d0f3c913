"""The bytes below an HDF5 file, handed to the HDF5 library only where they are sound.

The library (1.14 and 2.0) loops for ever over a global heap whose object sizes are damaged, and
it refuses a file that was cut short even where the part that is left could be read.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

HEAP_MAGIC = b"GCOL\x01\0\0\0"
HEAP_HEADER = OBJECT_HEADER = 16
LARGEST_HEAP_READ = 1 << 20


class SoundBytes(io.RawIOBase):
    """A file read in places, that may claim to be longer than it is.

    Args:
        path: the file.
        claimed: its size as its header tells, for one that was cut short.

    Raises:
        OSError: from `readinto`, for bytes that are not there and for a damaged heap.
    """

    def __init__(self, path: Path, claimed: int = 0) -> None:
        super().__init__()
        self._file = path.open("rb", buffering=0)
        self._claimed = claimed

    def readable(self) -> bool:
        """Always."""
        return True

    def seekable(self) -> bool:
        """Always."""
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Move; the end is where the file claims to end."""
        if whence == io.SEEK_END:
            end = max(self._file.seek(0, io.SEEK_END), self._claimed)
            offset, whence = end + offset, io.SEEK_SET
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """The place of the next read."""
        return self._file.tell()

    def readinto(self, buffer: Any, /) -> int:
        """Fill the whole buffer."""
        view = memoryview(buffer).cast("B")
        done = 0
        while done < len(view):
            count = self._file.readinto(view[done:])
            if not count:
                raise OSError("the file ends before its data")
            done += count
        if len(view) <= LARGEST_HEAP_READ and not heaps_are_sound(bytes(view)):
            raise OSError("a heap of texts is damaged")
        return done

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()


def heaps_are_sound(block: bytes) -> bool:
    """Whether the objects of every global heap that begins in a block lie within it.

    Source: HDF5 File Format Specification, III.E (Global Heap), with 8-byte lengths.
    """
    start = block.find(HEAP_MAGIC)
    while start >= 0:
        if not _heap_is_sound(block[start:]):
            return False
        start = block.find(HEAP_MAGIC, start + 1)
    return True


def _heap_is_sound(heap: bytes) -> bool:
    size = int.from_bytes(heap[8:16], "little")
    place = HEAP_HEADER
    while place + OBJECT_HEADER <= min(size, len(heap)):
        number = int.from_bytes(heap[place : place + 2], "little")
        length = int.from_bytes(heap[place + 8 : place + 16], "little")
        if number == 0 and length < OBJECT_HEADER:
            return False
        # Object 0 is the free space, whose length includes its header.
        place += length if number == 0 else OBJECT_HEADER + -(-length // 8) * 8
    return place <= size
