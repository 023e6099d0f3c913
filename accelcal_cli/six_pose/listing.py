"""The list of poses of a session: when, or in which file, the device rested, and its true acceleration there.

References are either directions of rest, in units of local gravity, or accelerations of any size, as a
turntable, a centrifuge or a robot arm makes them (Bragge et al., conclusions), in standard g or m/s2. Each
line is placed in the session: in its file, at times on the device's clock.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from fractions import Fraction
from math import isfinite, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UsageError, did_you_mean, printable
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
"""Smallest and largest length [g] of an acceleration that need not be that of rest."""

LARGEST_FILE = 1 << 20
LARGEST_NUMBER = 1e9

ALWAYS_US = 1 << 62
"""Time [us] later than any; its negative is earlier than any."""

_EPOCH = datetime(1970, 1, 1)
_MICROSECOND = timedelta(microseconds=1)

Moment = Fraction | datetime
"""Seconds from the first sample, or a time with or without a zone."""

Fractions3 = tuple[Fraction, Fraction, Fraction]


@dataclass(frozen=True, slots=True)
class LinePlace:
    """A line of a file."""

    path: Path
    line: int

    def wrong(self, message: str, hint: str | None = None) -> UsageError:
        """Return an error that names the line."""
        return UsageError(message, path=self.path, line=self.line, hint=hint)


@dataclass(frozen=True, slots=True)
class ListedPose:
    """One line of the list.

    Attributes:
        start, end: times of the rest; both None: the whole file.
        reference: the true acceleration, in units of local gravity if `of_rest`, else in standard g.
        file: name of the file of the session; None if the session is one recording.
    """

    place: LinePlace
    start: Moment | None
    end: Moment | None
    reference: Fractions3
    of_rest: bool = True
    file: str | None = None

    def in_g(self, local_g: Fraction) -> Fractions3:
        """Return the reference in standard g."""
        x, y, z = self.reference
        return (x * local_g, y * local_g, z * local_g) if self.of_rest else (x, y, z)

    @property
    def length(self) -> float:
        """Length of the reference, in its unit."""
        return _length(self.reference)


def read_list(path: Path) -> tuple[ListedPose, ...]:
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
    """Return the end of the acceleration columns' names; None if the columns are not those of a list."""
    for end in UNITS:
        axes = [f"{axis}{end}" for axis in AXES]
        if sorted(names) in [sorted([*place, *axes]) for place in (TIMES, (FILE,), (FILE, *TIMES))]:
            return end
    return None


def _lines(path: Path) -> Iterator[tuple[LinePlace, str]]:
    text = read_text(path, "the list of poses", LARGEST_FILE, "utf-8-sig")
    for number, line in enumerate(text.split("\n"), 1):
        if line.strip() and not line.lstrip().startswith("#"):
            yield LinePlace(path, number), line.strip()


def _cells(line: str, delimiter: str) -> list[str]:
    return [cell.strip().strip('"').strip() for cell in line.split(delimiter)]


def _listed(place: LinePlace, names: Sequence[str], cells: Sequence[str], end: str) -> ListedPose:
    if len(cells) != len(names):
        raise place.wrong(f"has {len(cells)} values, the header {len(names)}")
    values = dict(zip(names, cells, strict=True))
    x, y, z = (_number(values[f"{axis}{end}"], place) * UNITS[end] for axis in AXES)
    length = _length((x, y, z))
    if not end and abs(length - 1) > LENGTH_TOLERANCE:
        hint = "ax, ay, az are in g: at rest their length is 1 (call them ax_g, ay_g, az_g if it is not)"
        raise place.wrong(f"the reference has the length {length:.4g}", hint)
    if end and not LEAST_G <= length <= LARGEST_G:
        hint = f"possible are {LEAST_G:g} to {LARGEST_G:g} g"
        raise place.wrong(f"the reference has the length {length:.4g} g", hint)
    times = [values.get(name, "") for name in TIMES]
    # A file without times is one pose.
    is_whole = FILE in values and not any(times)
    start, stop = (None if is_whole else parse_moment(text, place) for text in times)
    if FILE in values and not values[FILE]:
        raise place.wrong("names no file")
    return ListedPose(place, start, stop, (x, y, z), not end, values.get(FILE))


def _length(vector: Fractions3) -> float:
    x, y, z = vector
    return sqrt(x * x + y * y + z * z)


def _number(text: str, place: LinePlace) -> Fraction:
    try:
        value = float(text.replace(",", "."))
    except ValueError:
        raise place.wrong(f"{text[:80]!r} is not a number") from None
    if not isfinite(value) or abs(value) > LARGEST_NUMBER:
        raise place.wrong(f"{text[:80]!r} is not a usable number")
    return Fraction(repr(value))


def parse_moment(text: str, place: LinePlace) -> Moment:
    """Parse a number of seconds, or else an ISO time.

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


@dataclass(frozen=True, slots=True)
class Origin:
    """A recording, or a file of a session, to which the times of a list refer.

    Attributes:
        first_us: time of the first sample on the device's clock, as it stands in the recording.
        dated: True if that clock shows a date.
        offset_s: seconds that it is ahead of UTC, None if unknown.
        name: name of the file; None if the session is one recording.
        first_sample, end_sample: its samples within the recording; None: to the end.
        moved_us: added to the times of its clock, so that files follow one another.
        problems, lost_bytes: extent of the damage to the file.
    """

    first_us: int
    dated: bool
    offset_s: int | None
    name: str | None = None
    first_sample: int = 0
    end_sample: int | None = None
    moved_us: int = 0
    problems: int = 0
    lost_bytes: int = 0

    def holds(self, sample: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which samples are its own."""
        inside: Any = sample >= self.first_sample
        return np.asarray(inside if self.end_sample is None else inside & (sample < self.end_sample))


def file_origins(origins: Sequence[Origin]) -> tuple[Origin, ...]:
    """Return the origins that are files; none if the session is one recording."""
    return tuple(origin for origin in origins if origin.name is not None)


@dataclass(frozen=True, slots=True)
class Span:
    """The place of a line of a list.

    Attributes:
        file: number of its file.
        start_us, end_us: times on the device's clock, as in the recording.
    """

    file: int
    start_us: int
    end_us: int
    listed: ListedPose

    @property
    def whole(self) -> bool:
        """True for the whole file."""
        return self.listed.start is None


def span_of(item: ListedPose, origins: Sequence[Origin]) -> Span:
    """Return the place of a line.

    Raises:
        UsageError: its file is not in the session, it ends before it starts, or its times cannot be
            compared with the recording's.
    """
    file = _file_of(item, origins)
    if item.start is None or item.end is None:
        return Span(file, -ALWAYS_US, ALWAYS_US, item)
    start, end = (_device_us(moment, item, origins[file]) for moment in (item.start, item.end))
    if end <= start:
        raise item.place.wrong("ends before it starts")
    return Span(file, start, end, item)


def _file_of(item: ListedPose, origins: Sequence[Origin]) -> int:
    names = [origin.name for origin in origins if origin.name is not None]
    if item.file is None:
        if names:
            raise item.place.wrong("names no file, but the session is in several", "add a column `file`")
        return 0
    if not names:
        hint = "leave out the column `file`, or give the folder of the files instead of a recording"
        raise item.place.wrong("names a file, but the session is one recording", hint)
    if item.file not in names:
        text = f"{printable(item.file[:80])!r} is not a file of the session"
        raise item.place.wrong(text, did_you_mean(item.file, names) or None)
    return names.index(item.file)


def _device_us(moment: Moment, item: ListedPose, origin: Origin) -> int:
    if not isinstance(moment, datetime):
        return origin.first_us + round(moment * 1_000_000)
    if not origin.dated:
        raise item.place.wrong("the recording has no date", "write seconds from its start")
    local_us = (moment.replace(tzinfo=None) - _EPOCH) // _MICROSECOND + origin.moved_us
    zone = moment.utcoffset()
    if zone is None:
        return local_us
    if origin.offset_s is None:
        text = "the time has a zone, but that of the recording is not known"
        raise item.place.wrong(text, "give --timezone")
    return local_us - zone // _MICROSECOND + origin.offset_s * 1_000_000
