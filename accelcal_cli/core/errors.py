"""The errors that users see, each kind with its exit code, and helpers that put values into messages."""

from __future__ import annotations

import errno
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import floor, isfinite, log10
from pathlib import Path
from typing import Any

# Reasons: why a result is what it is, what speaks against it and what to do, as codes with values.
#
# A reason is data: programs compare codes and values, and `output/sentences.py` alone makes sentences of
# them.

DIGITS = 4
"""Significant digits of a value: the last bits of linear algebra differ from machine to machine."""


def significant(value: float, digits: int = DIGITS) -> float:
    """Round to significant digits; numbers that are not finite stay as they are."""
    if value == 0:
        return 0.0
    return round(value, digits - 1 - floor(log10(abs(value)))) if isfinite(value) else value


@dataclass(frozen=True, slots=True)
class Reason:
    """A stable code, and the JSON values that its sentence needs."""

    code: str
    values: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, code: str, **values: Any) -> Reason:
        """Make a reason; floats are rounded, tuples become lists, and reasons among the values objects."""
        return cls(code, {name: _json_value(value) for name, value in values.items()})

    def as_json(self) -> dict[str, Any]:
        """Return the object that reports have."""
        return {"code": self.code, "values": dict(self.values)}


def _json_value(value: Any) -> Any:
    if isinstance(value, Reason):
        return value.as_json()
    if isinstance(value, float):
        return significant(value) if isfinite(value) else None
    if isinstance(value, list | tuple):
        return [_json_value(one) for one in value]
    return value


# The errors that users see, each kind with its exit code, and helpers that put values into messages.

NO_BYTES = re.compile("[\ud800-\udc7f\udd00-\udfff]")
"""Halves of characters that stand for no byte of a file name; JSON text may hold them."""


FORMULA = re.compile(
    r"[=@\uff1d\uff20\uff0b\uff0d\t\r\n]|[+-](?![0-9.eE+-]*$)|0[0-9]+$|[0-9]{16,}$|[0-9]+[eE][0-9]+$"
)
"""Cells that spreadsheets would calculate, swallow or show otherwise, such as 007; numbers are excluded."""

ENVIRONMENT_ERRNOS = frozenset(
    getattr(errno, name)
    for name in (
        "EIO", "EMFILE", "ENFILE", "ENOMEM", "ENOSPC", "EDQUOT", "EAGAIN", "EACCES", "EPERM", "ENODEV",
        "ESTALE", "ETIMEDOUT", "EHOSTDOWN", "ENETDOWN", "ENOTCONN", "EREMOTEIO",
    )
    if hasattr(errno, name)
)  # fmt: skip
"""Error numbers of disks, networks, limits and rights, which no file's content causes."""

TOO_MUCH_ASKED = frozenset((errno.ENAMETOOLONG, errno.ELOOP))
"""Error numbers of names that a disk does not take."""

COPY_AGAIN = "copy it again from the device"
"""Hint for a file that is damaged or incomplete."""

NO_THREAD = ("can't start new thread", "Failed to launch worker thread")
"""Messages of Python (_threadmodule.c) and Arrow (thread_pool.cc) when no thread can be started."""


def printable(path: Path | str, *, kept: str = "") -> str:
    """Return a name with control characters escaped and bytes that are not UTF-8 replaced.

    Args:
        kept: characters that stay as they are.
    """
    whole = NO_BYTES.sub("\ufffd", str(path))
    text = whole.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
    return "".join(
        char if char.isprintable() or char in kept else char.encode("unicode_escape").decode()
        for char in text
    )


def spreadsheet_cell(value: Any) -> Any:
    """Return a value, with an apostrophe before a text that a spreadsheet would calculate or change."""
    return f"'{value}" if isinstance(value, str) and FORMULA.match(value) else value


def counted(number: int, what: str) -> str:
    """Return a number with what it counts: `1 recording`, `2 recordings`."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def listed(items: Sequence[str]) -> str:
    """Return items as a phrase: `x`, `x and y`, `x, y and z`."""
    return " and ".join(filter(None, (", ".join(items[:-1]), *items[-1:])))


def similar_words(word: str, known: Iterable[str], most: int = 1) -> list[str]:
    """Return known words that a word may be a slip for, the nearest first; case does not count."""
    import difflib  # few words are slips

    names = {name.lower(): name for name in known}
    return [names[name] for name in difflib.get_close_matches(word.lower(), names, most)]


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return `did you mean 'both'?`; empty if no known word is similar."""
    return "".join(f"did you mean {name!r}?" for name in similar_words(word, known))


def cause_of_kind(error: BaseException | None, *kinds: type[BaseException]) -> BaseException | None:
    """Return the error, or the one it was raised while handling, that is of one of these kinds; else None."""
    while error is not None and not isinstance(error, kinds):
        error = error.__context__
    return error


def is_environment_error(error: BaseException) -> bool:
    """Return True if the environment (disk, network, limits) caused the error; a retry may succeed."""
    cause = cause_of_kind(error, OSError)
    return isinstance(cause, OSError) and cause.errno in ENVIRONMENT_ERRNOS


def disk_fault(error: BaseException | None) -> str | None:
    """Return what a disk refused where nobody asked it by the door, for people; None for any other error."""
    if not isinstance(error, OSError) or error.errno not in ENVIRONMENT_ERRNOS | TOO_MUCH_ASKED:
        return None
    where = "" if error.filename is None else f"{printable(error.filename)}: "
    return f"{where}cannot be read or written ({error.strerror})"


def missing_resource(error: BaseException | None) -> str | None:
    """Return a sentence on the missing resource, memory or another thread; None for other errors."""
    if isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM:
        return "there was not enough memory"
    if any(words in str(error) for words in NO_THREAD):
        return "no more threads could be started"
    return None


class AccelcalError(Exception):
    """An error with a place and a remedy, shown as one line.

    Args:
        message: what is wrong, without a full stop.
        path: the file concerned.
        byte_offset: where in the file (bytes from its start).
        line: where in a text file (1 is the first line).
        hint: what the user can do about it.
        sensors: values of --sensor, each of which chooses one of the file's sensors; empty if those are not
            what is wrong.
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
        sensors: Sequence[str] = (),
    ) -> None:
        super().__init__(message)
        self.message = message
        self.path = path
        self.byte_offset = byte_offset
        self.line = line
        self.hint = hint
        self.sensors = tuple(sensors)

    def __str__(self) -> str:
        return self.line_for(())

    def line_for(self, known: tuple[Path, ...]) -> str:
        """Return the error in one line, without its path if that is one of those known."""
        where = [] if self.path is None or Path(self.path) in known else [printable(self.path)]
        if self.line is not None:
            where.append(f"line {self.line}")
        if self.byte_offset is not None:
            where.append(f"byte {self.byte_offset}")
        text = f"{', '.join(where)}: {self.message}" if where else self.message
        return printable(" ".join((f"{text}; {self.hint}" if self.hint else text).split()))


class UsageError(AccelcalError):
    """The words of the command do not fit together."""

    exit_code = 2


class UnreadableError(AccelcalError):
    """The recording cannot be read, or its format is not supported."""

    exit_code = 3

    @property
    def fault(self) -> str:
        """Words of the disk, such as `Permission denied`; the message if the disk is not the cause."""
        said = getattr(self.__cause__, "strerror", None)
        return str(said or self.message)


class NoFormatError(UnreadableError):
    """The content of the file matches no format."""


class NoRecordingError(UnreadableError):
    """The file is sound, but it holds no raw acceleration.

    Args:
        reason: what it holds instead; None: a table without acceleration.
    """

    def __init__(self, message: str, *, reason: Reason | None = None, **place: Any) -> None:
        super().__init__(message, **place)
        self.reason = reason or Reason("no_acceleration")


class OutputError(AccelcalError):
    """A result could not be written."""

    exit_code = 5


class LockedError(AccelcalError):
    """Another run works in the same output folder."""

    exit_code = 75


class ClusterError(AccelcalError):
    """The cluster cannot be reached or used."""

    exit_code = 69


class DivergedError(AccelcalError):
    """A fit found no parameters: it diverged, or the points do not determine them."""

    exit_code = 4


class FixedPointOverflowError(DivergedError):
    """A value left the range of its fixed-point format; nothing was wrapped."""


def unread(error: OSError, path: Path | str) -> UnreadableError:
    """Return the error to show for a file that cannot be read."""
    if isinstance(error, FileNotFoundError):
        return UnreadableError("file not found", path=path, hint="check the path")
    what = f"cannot be read ({error.strerror or error})"
    return UnreadableError(what, path=path, hint="check its permissions and its disk")


def output_error(error: OSError, path: Path) -> OutputError:
    """Return the error to show for a failed write."""
    hint = "check the folder and its permissions, or write to another folder"
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        hint = "free some space, or write to another disk"
    if error.errno == errno.ENAMETOOLONG:
        hint = "rename the recording"
    return OutputError(f"cannot be written ({error.strerror or error})", path=path, hint=hint)
