"""Sectors of a file, a block of them at a time."""

from __future__ import annotations

from collections.abc import Generator, Iterator

import numpy as np

from accelcal_cli.readers._cwa.signature import SECTOR_BYTES
from accelcal_cli.readers._pages.blocks import PagedFile, RawBlock
from accelcal_cli.readers._stream import ByteSource


def sector_blocks(file: PagedFile, sectors: int, first_position: int = 0) -> Generator[RawBlock, None, None]:
    """All sectors from `first_position` on, about `sectors` at a time; the last block may be empty.

    The next block overwrites the memory of the one before.

    Raises:
        UnreadableError: the disk fails.
    """
    if file.compressed:
        yield from file.blocks(sectors, first_position)
    else:
        yield from _read_over(file, sectors, first_position)


def _read_over(file: PagedFile, sectors: int, position: int) -> Iterator[RawBlock]:
    """One buffer for all blocks: fresh memory for each costs more time than the reading."""
    left = max(1, file.whole_pages - position + 1)
    buffer = np.empty((min(sectors, left), SECTOR_BYTES), np.uint8)
    data = buffer.reshape(-1)
    with ByteSource(file.path) as source:
        source.seek(file.offset(position))
        last = False
        while not last:
            size = source.read_into(data.data)
            last = size < len(data)
            whole = size // SECTOR_BYTES
            tail = data[whole * SECTOR_BYTES : size].tobytes()
            yield RawBlock(position, buffer[:whole], source.disk_position(), tail, False, last)
            position += whole
