"""By what a GENEActiv .bin file is known: how its header and its pages begin."""

from __future__ import annotations

HEADER_MAGIC = b"Device Identity"
MARK = b"Recorded Data"
"""The first line of a page."""
