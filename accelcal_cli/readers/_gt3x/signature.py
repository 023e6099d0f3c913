"""By what a .gt3x file is known: the parts that this zip file names."""

from __future__ import annotations

import re

INFO, LOG, ACTIVITY = "info.txt", "log.bin", "activity.bin"
MAGIC = b"PK\x03\x04"
NAMED = re.compile(rb"PK\x03\x04.{22}(..)..(info\.txt|log\.bin|activity\.bin)", re.DOTALL)
"""A local header of one of the parts; the groups are the length of its name, and the name."""


def names_in(head: bytes) -> set[str]:
    """Names of the parts that begin within the first bytes of a file."""
    return {found[2].decode() for found in NAMED.finditer(head)}


def holds_samples(names: set[str]) -> bool:
    """Whether one of the parts of either kind is among them."""
    return not names.isdisjoint((LOG, ACTIVITY))
