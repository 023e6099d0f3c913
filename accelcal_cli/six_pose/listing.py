"""The list of poses of a session: when, or in which file, the device rested, and what is true of it there.

References are either directions of rest, in units of local gravity, or accelerations of any size, as a
turntable, a centrifuge or a robot arm makes them (Bragge et al., conclusions), in standard g or m/s2.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from fractions import Fraction
from math import isfinite, sqrt
from pathlib import Path

from accelcal_cli.core.errors import UsageError, printable
from accelcal_cli.core.input_files import read_text
from accelcal_cli.core.vocabulary import ACCELERATION_UNITS

TIMES = ("start", "end")
FILE = "file"
AXES = ("ax", "ay", "az")
UNITS = {"": Fraction(1)} | {
    unit.pose_ending: 1 / unit.per_g for unit in ACCELERATION_UNITS.values() if unit.pose_ending
}
"""Units [g] by the end of the names of the three columns; without one they hold directions of rest."""

HEADERS = "start,end,ax,ay,az"
LENGTH_TOLERANCE = 0.02
LEAST_G, LARGEST_G = 0.1, 32.0
"""Between these is the length of an acceleration that need not be that of rest."""

LARGEST_FILE = 1 << 20
LARGEST_NUMBER = 1e9

Moment = Fraction | datetime
"""Seconds from the first sample, or a time with or without a zone."""

Fractions3 = tuple[Fraction, Fraction, Fraction]


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
    """One line.

    Attributes:
        start, end: from when to when; None in both: the whole file.
        reference: what is true there, in units of local gravity if `of_rest`, else in standard g.
        file: name of the file of the session; None where it is in one.
    """

    place: Place
    start: Moment | None
    end: Moment | None
    reference: Fractions3
    of_rest: bool = True
    file: str | None = None

    def in_g(self, local_g: Fraction) -> Fractions3:
        """The reference in standard g."""
        x, y, z = self.reference
        return (x * local_g, y * local_g, z * local_g) if self.of_rest else (x, y, z)

    @property
    def length(self) -> float:
        """Of the reference, in its unit."""
        return _length(self.reference)


def read_list(path: Path) -> tuple[Listed, ...]:
    """Read a list of poses: a header and a line for each pose.

    The header names the columns `start,end` or `file` or all three, and `ax,ay,az` (a direction of rest) or
    `ax_g,ay_g,az_g` or `ax_ms2,ay_ms2,az_ms2` (any acceleration). Semicolons or tabs may separate (then
    decimals may have commas). Empty lines and lines that begin with # are skipped.

    Raises:
        UsageError: with the line that is wrong.
    """
    lines = list(_lines(path))
    if not lines:
        raise UsageError("lists no poses", path=path, hint=f"write {HEADERS} and a line for each")
    place, header = lines[0]
    delimiter = next((mark for mark in ";\t" if mark in header), ",")
    names = [name.lower() for name in _cells(header, delimiter)]
    end = _unit_of(names)
    if end is None:
        hint = f"write {HEADERS} (`file` may stand for start,end; ax_g,ay_g,az_g for any acceleration)"
        raise place.wrong(f"the first line is {header[:80]!r}", hint)
    if not lines[1:]:
        raise place.wrong("lists no poses", "write a line for each below this one")
    return tuple(_listed(where, names, _cells(text, delimiter), end) for where, text in lines[1:])


def _unit_of(names: Sequence[str]) -> str | None:
    """How the names of the columns of accelerations end; None if the columns are not those of a list."""
    for end in UNITS:
        axes = [f"{axis}{end}" for axis in AXES]
        if sorted(names) in [sorted([*place, *axes]) for place in (TIMES, (FILE,), (FILE, *TIMES))]:
            return end
    return None


def _lines(path: Path) -> Iterator[tuple[Place, str]]:
    text = read_text(path, "the list of poses", LARGEST_FILE, "utf-8-sig")
    for number, line in enumerate(text.split("\n"), 1):
        if line.strip() and not line.lstrip().startswith("#"):
            yield Place(path, number), line.strip()


def _cells(line: str, delimiter: str) -> list[str]:
    return [cell.strip().strip('"').strip() for cell in line.split(delimiter)]


def _listed(place: Place, names: Sequence[str], cells: Sequence[str], end: str) -> Listed:
    if len(cells) != len(names):
        raise place.wrong(f"has {len(cells)} values, the header {len(names)}")
    values = dict(zip(names, cells, strict=True))
    x, y, z = (_number(values[f"{axis}{end}"], place) * UNITS[end] for axis in AXES)
    _check_length(_length((x, y, z)), place, of_rest=not end)
    start, stop = _times(values, place)
    return Listed(place, start, stop, (x, y, z), not end, _file(values, place))


def _check_length(length: float, place: Place, *, of_rest: bool) -> None:
    if of_rest and abs(length - 1) > LENGTH_TOLERANCE:
        hint = "ax, ay, az are in g: at rest their length is 1 (call them ax_g, ay_g, az_g if it is not)"
        raise place.wrong(f"the reference has the length {length:.4g}", hint)
    if not of_rest and not LEAST_G <= length <= LARGEST_G:
        raise place.wrong(
            f"the reference has the length {length:.4g} g", f"possible are {LEAST_G:g} to {LARGEST_G:g} g"
        )


def _length(vector: Fractions3) -> float:
    x, y, z = vector
    return sqrt(x * x + y * y + z * z)


def _file(values: Mapping[str, str], place: Place) -> str | None:
    if FILE in values and not values[FILE]:
        raise place.wrong("names no file")
    return values.get(FILE)


def _times(values: Mapping[str, str], place: Place) -> tuple[Moment | None, Moment | None]:
    """From when to when; nothing in both cells where a file is named: all of it."""
    start, end = (values.get(name, "") for name in TIMES)
    if FILE in values and not start and not end:
        return None, None
    return moment(start, place), moment(end, place)


def _number(text: str, place: Place) -> Fraction:
    try:
        value = float(text.replace(",", "."))
    except ValueError:
        raise place.wrong(f"{text[:80]!r} is not a number") from None
    if not isfinite(value) or abs(value) > LARGEST_NUMBER:
        raise place.wrong(f"{text[:80]!r} is not a usable number")
    return Fraction(repr(value))


def moment(text: str, place: Place) -> Moment:
    """A number of seconds, or else an ISO time.

    Raises:
        UsageError: it is neither.
    """
    try:
        float(text.replace(",", "."))
    except ValueError:
        pass
    else:
        return _number(text, place)
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        wanted = "a number of seconds nor a time such as 2024-03-04T12:34:56"
        raise place.wrong(f"{printable(text[:80])!r} is neither {wanted}") from None
