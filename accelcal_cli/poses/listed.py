"""A file that lists poses: when the device rested, and what it truly measured then."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from fractions import Fraction
from math import isfinite, sqrt
from pathlib import Path

from accelcal_cli.core.errors import UsageError

COLUMNS = ("start", "end", "ax", "ay", "az")
LENGTH_TOLERANCE = 0.02
LARGEST_FILE = 1 << 20
LARGEST_NUMBER = 1e9

Moment = Fraction | datetime
"""Seconds from the first sample, or a time with or without a zone."""


@dataclass(frozen=True, slots=True)
class Place:
    """A line of a file."""

    path: Path
    line: int

    def wrong(self, message: str, hint: str | None = None) -> UsageError:
        """An error that names the line."""
        return UsageError(message, path=self.path, line=self.line, hint=hint)


@dataclass(frozen=True, slots=True)
class Listed:
    """One line: from when to when, and the direction there in units of local gravity."""

    place: Place
    start: Moment
    end: Moment
    direction: tuple[Fraction, Fraction, Fraction]


def read_list(path: Path) -> tuple[Listed, ...]:
    """Read a list of poses: a header `start,end,ax,ay,az` and a line for each pose.

    Semicolons or tabs may separate (then decimals may have commas). Empty lines and lines that begin
    with # are skipped.

    Raises:
        UsageError: with the line that is wrong.
    """
    lines = list(_lines(path))
    if not lines:
        raise UsageError("lists no poses", path=path, hint=f"write {','.join(COLUMNS)} and a line for each")
    place, header = lines[0]
    delimiter = next((mark for mark in ";\t" if mark in header), ",")
    names = [name.lower() for name in _cells(header, delimiter)]
    if sorted(names) != sorted(COLUMNS):
        raise place.wrong(f"the first line is {header[:80]!r}", f"write {','.join(COLUMNS)}")
    if not lines[1:]:
        raise place.wrong("lists no poses", "write a line for each below this one")
    return tuple(_listed(where, names, _cells(text, delimiter)) for where, text in lines[1:])


def _lines(path: Path) -> Iterator[tuple[Place, str]]:
    """Lines that say something."""
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise UsageError("is too large for a list of poses", path=path)
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise UsageError(f"the poses cannot be read ({error.strerror or error})", path=path) from error
    except UnicodeDecodeError as error:
        raise UsageError("the poses are not UTF-8 text", path=path, byte_offset=error.start) from error
    for number, line in enumerate(text.split("\n"), 1):
        if line.strip() and not line.lstrip().startswith("#"):
            yield Place(path, number), line.strip()


def _cells(line: str, delimiter: str) -> list[str]:
    cells = [cell.strip().strip('"').strip() for cell in line.split(delimiter)]
    return cells if delimiter == "," else [cell.replace(",", ".") for cell in cells]


def _listed(place: Place, names: Sequence[str], cells: Sequence[str]) -> Listed:
    if len(cells) != len(names):
        raise place.wrong(f"has {len(cells)} values, the header {len(names)}")
    held = dict(zip(names, cells, strict=True))
    x, y, z = (_number(held[name], place) for name in ("ax", "ay", "az"))
    length = sqrt(x * x + y * y + z * z)
    if abs(length - 1) > LENGTH_TOLERANCE:
        hint = "ax, ay, az are in g: at rest their length is 1"
        raise place.wrong(f"the reference has the length {length:.4g}", hint)
    return Listed(place, _moment(held["start"], place), _moment(held["end"], place), (x, y, z))


def _number(text: str, place: Place) -> Fraction:
    try:
        value = float(text)
    except ValueError:
        raise place.wrong(f"{text[:80]!r} is not a number") from None
    if not isfinite(value) or abs(value) > LARGEST_NUMBER:
        raise place.wrong(f"{text[:80]!r} is not a usable number")
    return Fraction(repr(value))


def _moment(text: str, place: Place) -> Moment:
    """A number of seconds, or else an ISO time."""
    try:
        float(text)
    except ValueError:
        pass
    else:
        return _number(text, place)
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        wanted = "a number of seconds nor a time such as 2024-03-04T12:34:56"
        raise place.wrong(f"{text[:80]!r} is neither {wanted}") from None
