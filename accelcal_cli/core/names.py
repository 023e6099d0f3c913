"""File names as text that any terminal, table and JSON file can hold, and numbers with what they count."""

from __future__ import annotations

from pathlib import Path


def printable(path: Path | str) -> str:
    """A name with control characters escaped and bytes that are not UTF-8 replaced."""
    text = str(path).encode("utf-8", "surrogateescape").decode("utf-8", "replace")
    return "".join(char if char.isprintable() else char.encode("unicode_escape").decode() for char in text)


def counted(number: int, what: str) -> str:
    """`1 recording`, `2 recordings`."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
