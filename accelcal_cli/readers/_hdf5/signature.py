"""HDF5's signature, told without h5py: other formats need not wait for it."""

from __future__ import annotations

SIGNATURE = b"\x89HDF\r\n\x1a\n"
FIRST_USER_BLOCK = 512


def has_signature(head: bytes) -> bool:
    """Whether HDF5's signature stands at byte 0, 512, 1024, 2048, ... (HDF5 File Format, II.A)."""
    offset = 0
    while offset < len(head):
        if head.startswith(SIGNATURE, offset):
            return True
        offset = offset * 2 or FIRST_USER_BLOCK
    return False
