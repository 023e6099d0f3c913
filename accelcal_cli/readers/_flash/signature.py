"""By what a dump of flash pages is known: how its header and its pages begin. See docs/flash-format.md."""

from __future__ import annotations

PAGE_BYTES = 512
HEADER_MAGIC = b"\x89ACL\r\n\x1a\n"
PAGE_MAGIC = b"ACLP"
