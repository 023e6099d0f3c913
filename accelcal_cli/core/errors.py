"""The tree of errors that users see, with the exit code of each kind, and text for their messages.

Names of files as text that any terminal, table and JSON file can hold, and numbers with what they count.
"""

from __future__ import annotations

from pathlib import Path


def printable(path: Path | str) -> str:
    """A name with control characters escaped and bytes that are not UTF-8 replaced."""
    text = str(path).encode("utf-8", "surrogateescape").decode("utf-8", "replace")
    return "".join(char if char.isprintable() else char.encode("unicode_escape").decode() for char in text)


def counted(number: int, what: str) -> str:
    """`1 recording`, `2 recordings`."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


class AccelcalError(Exception):
    """An error with a place and a remedy, shown as one line.

    Args:
        message: what is wrong, without a full stop.
        path: the file concerned.
        byte_offset: where in the file (bytes from its start).
        line: where in a text file (1 is the first line).
        hint: what the user can do about it.
    """

    exit_code = 70

    def __init__(
        self,
        message: str,
        *,
        path: Path | str | None = None,
        byte_offset: int | None = None,
        line: int | None = None,
        hint: str | None = None,
    ) -> None:
        super().__init__(message)
        self.message = message
        self.path = path
        self.byte_offset = byte_offset
        self.line = line
        self.hint = hint

    def __str__(self) -> str:
        where = [] if self.path is None else [printable(self.path)]
        if self.line is not None:
            where.append(f"line {self.line}")
        if self.byte_offset is not None:
            where.append(f"byte {self.byte_offset}")
        text = f"{', '.join(where)}: {self.message}" if where else self.message
        return " ".join((f"{text}; {self.hint}" if self.hint else text).split())


class UsageError(AccelcalError):
    """The command's words do not fit together."""

    exit_code = 2


class UnreadableError(AccelcalError):
    """The recording cannot be read, or its format is not supported."""

    exit_code = 3


class OutputError(AccelcalError):
    """A result could not be written."""

    exit_code = 5


class LockedError(AccelcalError):
    """Another run works in the same output folder."""

    exit_code = 75


class ClusterError(AccelcalError):
    """The cluster cannot be reached, or cannot be used."""

    exit_code = 69


class DivergedError(AccelcalError):
    """A fit found no parameters: it diverged, or the points do not determine them."""

    exit_code = 4


class FixedPointOverflowError(DivergedError):
    """A value left the range of its fixed-point format; nothing was wrapped."""
