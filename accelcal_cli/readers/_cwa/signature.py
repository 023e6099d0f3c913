"""By what an Axivity .cwa file is known: how its header and its sectors begin.

Source: `Docs/ax3/cwa.h` (github.com/digitalinteraction/openmovement).
"""

from __future__ import annotations

HEADER_BYTES = 1024
HEADER_MAGIC = b"MD" + (HEADER_BYTES - 4).to_bytes(2, "little")
SECTOR_BYTES = 512
SECTOR_MAGIC = b"AX" + (SECTOR_BYTES - 4).to_bytes(2, "little")
"""The first four bytes of a data sector: two letters and the length of what follows."""
