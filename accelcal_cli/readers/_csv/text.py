"""What may be text at all."""

from __future__ import annotations


def is_text(head: bytes) -> bool:
    """Whether all bytes are such as text has."""
    return not head.translate(None, b"\t\n\r\f\x1b" + bytes(range(32, 127)) + bytes(range(128, 256)))
