"""Recognises the flash page format, our own dump of a wrist logger's memory.

Specified in docs/flash-format.md.
"""

from __future__ import annotations

import struct
import zlib

from accelcal_cli.core.formats import NOT_FOR_DEVICES, Format, Probe

PAGE_BYTES = 512
HEADER_MAGIC = b"\x89ACL\r\n\x1a\n"
PAGE_MAGIC = b"ACLP"
PAGE_HEAD = struct.Struct("<4sIIIIhH")
"""Magic, recording number, sequence number, seconds, microseconds, temperature and samples of a data page."""

SAMPLES = 80
"""Samples in a full page."""


def recording_id_of(page: bytes) -> int | None:
    """Return the recording number of a data page with possible values and a right checksum, else None."""
    if len(page) < PAGE_BYTES:
        return None
    magic, recording_id, _, _, microseconds, _, samples = PAGE_HEAD.unpack_from(page)
    possible = magic == PAGE_MAGIC and 1 <= samples <= SAMPLES and microseconds < 1_000_000
    right = possible and zlib.crc32(page[:-4]) == int.from_bytes(page[-4:], "little")
    return int(recording_id) if right else None


def sniff(probe: Probe) -> int:
    """Return 100 for the header's signature, 90 for a valid data page where the header is damaged."""
    head = probe.head
    if head.startswith(HEADER_MAGIC):
        return 100
    pages = (head[place : place + PAGE_BYTES] for place in range(PAGE_BYTES, len(head), PAGE_BYTES))
    return 90 if any(recording_id_of(page) is not None for page in pages) else 0


FORMAT = Format(
    "flash",
    "flash pages of a wrist logger (docs/flash-format.md)",
    (".bin",),
    sniff,
    reader="accelcal_cli.formats.flash.reader:open_recording",
    ignores=NOT_FOR_DEVICES,
)
