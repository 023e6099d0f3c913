"""The grammar of column names: the words of a sensor, an axis, a place and a unit in `imu_accX [mg]`.

It is the same whatever kind of file a column stands in. Words and units are in `core/vocabulary.py`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.vocabulary import (
    ABOUT_PEOPLE,
    ACCELEROMETER,
    BARE_TIMES,
    GYROSCOPE,
    LABELS,
    MEASURES,
    NOT_RAW,
    OWNERS,
    TIMES,
    UNKNOWN_UNIT,
    Quantity,
    Unit,
    find_unit,
    normalized,
    unit_of,
)
from accelcal_cli.core.vocabulary import TEMPERATURE_UNITS as HEAT_UNITS
from accelcal_cli.core.written_times import stated_zone

AXES = ("x", "y", "z")
SHORT_ACCELEROMETER, SHORT_GYROSCOPE = frozenset({"a"}), frozenset({"g", "w"})
"""First letters of `ax`, and of `gx` and `wx`, which are rotation rates if there is an `ax`."""

ACCELERATIONS = ACCELEROMETER | SHORT_ACCELEROMETER
GYROSCOPE_PAIRS = (("angular", "velocity"), ("angular", "rate"), ("rotation", "rate"))
"""Pairs of words that name a gyroscope."""

NOT_MEASURED_TURNS = frozenset({"bias", "drift", "unbiased", "mag", "magnetometer", "temp", "temperature"})
"""Words in names of a gyroscope's columns that do not hold what it measures."""

OTHER_SENSORS = frozenset({*GYROSCOPE, *NOT_RAW, "mag", "magn", "magnetometer", "user"})
"""Words that rule out measured acceleration."""

OTHER_GROUPS = ("gyr", "mag", "angular", "orient", "quat")
"""Beginnings of names of groups that hold another sensor."""

NEUTRAL = frozenset({"axis", "raw", "value", "cal", "calibrated", "uncalibrated", "uncal"})
"""Words that say nothing about the sensor."""

VALUES = frozenset({"data", "values", "value", "samples", "sample", "xyz", "raw"})
"""Words of a column of three numbers a row that say nothing; the group around it may tell what it holds."""

ELSEWHERE = (MEASURES | LABELS | ABOUT_PEOPLE | OWNERS | OTHER_SENSORS) - {"sensor", "node", "imu"} - NOT_RAW
"""Words in the name of a column that is not an axis of acceleration."""

BRACKET = re.compile(r"[\[(]")
G_FORCE = re.compile(r"^gF([xyz])$")
"""Name of an acceleration in g in files of Physics Toolbox."""

ZONE_WORD = re.compile(
    r"(?:(?:^|[\W_]|(?<=[a-z]))(?:UTC|GMT)|(?:^|[\W_])(?:utc|gmt))(?![A-Za-z])\s*(?:[+-]\d{1,2}(?::?\d\d)?)?"
)
"""A zone among the words of a column's name."""

FINE_TICKS = re.compile(r"sample_?time_?fine", re.IGNORECASE)

WORDS_OF_UNITS = frozenset({Quantity.ACCELERATION, Quantity.COUNTS, Quantity.TIME, Quantity.TEMPERATURE})
"""Quantities whose units are known as the last word of a name, without brackets."""

NO_UNITS = frozenset({"raw"})
"""Last words that are names of units only in brackets."""


def name_and_hint(name: str) -> tuple[str, str | None]:
    """Return a column's name without its bracketed unit, and the words in the brackets."""
    name = name.strip()
    match = BRACKET.search(name, 0, len(name) - 1)
    if match is None or name[-1] not in "])":
        return name, None
    return name[: match.start()].strip(), name[match.end() : -1].strip()


def microseconds_in(text: str) -> float | None:
    """Return the microseconds in a unit of time such as `ms`; None for any other word."""
    unit = unit_of(text, Quantity.TIME)
    return None if unit is None else MICROSECONDS / unit.per


@dataclass(frozen=True, slots=True)
class Name:
    """A column's name taken apart.

    Attributes:
        text: as it is written.
        words: lower-case words, the axis apart, without the unit.
        stated: the unit as the name, a line of units or an attribute states it; empty if none does.
    """

    text: str
    words: tuple[str, ...]
    stated: str

    @property
    def unit(self) -> Unit | None:
        """The stated unit, None if there is none or it is not known."""
        return find_unit(self.stated) if self.stated else None

    @property
    def axis(self) -> str | None:
        """The one axis among its words, None if there is none or several."""
        ends = [word for word in self.words if word in AXES]
        return ends[0] if len(ends) == 1 else None

    @property
    def stem(self) -> tuple[str, ...]:
        """Its words without the axis."""
        return tuple(word for word in self.words if word not in AXES and word not in NEUTRAL)

    @property
    def is_time(self) -> bool:
        """True if it names a column of times."""
        bare = len(self.words) == 1 and self.words[0] in BARE_TIMES
        return bare or bool(TIMES & set(self.words))

    @property
    def is_accelerometer(self) -> bool:
        """True if it names what an accelerometer measures."""
        return bool(ACCELERATIONS & set(self.stem))

    @property
    def is_gyroscope(self) -> bool:
        """True if it names what a gyroscope measures."""
        stem = set(self.stem)
        if NOT_MEASURED_TURNS & stem:
            return False
        short = len(self.stem) == 1 and self.stem[0] in SHORT_GYROSCOPE
        return bool(GYROSCOPE & stem) or short or any(pair in GYROSCOPE_PAIRS for pair in pairwise(self.stem))

    @property
    def is_other(self) -> bool:
        """True if a word rules out that it is measured acceleration, or its unit is of another quantity."""
        unit = self.unit
        other = unit is not None and unit.quantity not in (Quantity.ACCELERATION, Quantity.COUNTS)
        gauss = self.stated == "G" and not self.is_accelerometer  # magnetometers are given in it
        return bool(OTHER_SENSORS & set(self.stem)) or other or gauss

    @property
    def is_elsewhere(self) -> bool:
        """True if it cannot be an axis of acceleration that goes by another name."""
        return (
            bool(ELSEWHERE & set(self.words)) or self.is_time or (self.is_gyroscope and len(self.words) > 1)
        )

    @property
    def place(self) -> tuple[str, ...]:
        """Its words without axis and sensor, such as a side of the body."""
        pairs = (word for pair in GYROSCOPE_PAIRS for word in pair)
        sensor = {*ACCELERATIONS, *GYROSCOPE, *SHORT_GYROSCOPE, *pairs}
        return tuple(word for word in self.stem if word not in sensor)

    def is_all(self, words: frozenset[str]) -> bool:
        """Return True if a column of three numbers has no other words than these, and at least one."""
        own = {word for word in self.words if word not in NEUTRAL | VALUES}
        return normalized(self.text) in words or (bool(own) and own <= words)

    @property
    def says_nothing(self) -> bool:
        """True for names such as `data`, whose group tells what they hold."""
        return bool(self.words) and set(self.words) <= VALUES

    @property
    def zone(self) -> str | None:
        """The zone in the name of a column of times, such as `Timestamp UTC` or `time (+0100)`."""
        plain, hint = name_and_hint(self.text)
        found = ZONE_WORD.search(plain)
        words = "" if found is None else found[0].strip("_ ")
        return (stated_zone(hint) if hint and not hint.isdigit() else None) or stated_zone(words)

    @property
    def time_unit_us(self) -> float | None:
        """Microseconds in the unit that the name of a column of times mentions, or is; None without one."""
        first = self.stated.split(" since ")[0] or (self.words[0] if len(self.words) == 1 else "")
        return microseconds_in(first)

    @property
    def ticks(self) -> bool:
        """True if it says that it counts ticks."""
        return "tick" in self.text.lower()

    @property
    def fine_ticks(self) -> bool:
        """True for Xsens' counter, whose ticks are 0.1 ms or 1 us."""
        return FINE_TICKS.fullmatch(self.text.strip()) is not None


def is_other_group(text: str) -> bool:
    """Return True if the name of a group says that it holds another sensor than an accelerometer."""
    return normalized(text).startswith(OTHER_GROUPS)


@lru_cache(maxsize=4096)
def name_of(text: str, stated: str | None = None) -> Name:
    """Take the name of a column apart.

    Args:
        stated: its unit by a line of units, an attribute or the user; it takes precedence over the name's.
    """
    plain, hint = name_and_hint(G_FORCE.sub(r"acc_\1 [g]", text.strip()))
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", plain)
    words = tuple(word for part in re.split(r"[\W_]+", spaced.lower()) for word in _axis_apart(part) if word)
    unit = (stated or hint or "").strip()
    for last in (3, 2, 1) if not unit else ():
        end = "".join(words[-last:])
        if len(words) > last and _is_last_unit(end, last):
            words, unit = words[:-last], end
            break
    return Name(text, words, unit.strip("[]()"))


def unit_at_end(name: Name) -> str:
    """Return the unit of another quantity, also if it is the last word: `mV` of `vbat_mV`, `lux`."""
    last = re.split(r"[\W_]+", name.text.strip())[-1]
    unit = find_unit(last)
    of_other = unit is not None and unit.quantity is Quantity.OTHER
    return name.stated or (last if of_other else UNKNOWN_UNIT)


def _axis_apart(word: str) -> tuple[str, ...]:
    """Return `accx`, `xacc`, `gyrox` or `gx` as two words."""
    if word[:-1] in ACCELERATIONS | GYROSCOPE | SHORT_GYROSCOPE and word[-1] in AXES:
        return word[:-1], word[-1]
    if word[1:] in ACCELERATIONS | GYROSCOPE and word[:1] in AXES:
        return word[1:], word[0]
    return (word,)


def _is_last_unit(end: str, words: int) -> bool:
    """Return True if the last words of a name, put together, are a unit: `ms2` of `acc_x_m_s2`."""
    if end in NO_UNITS:
        return False
    unit = find_unit(end)
    if unit is None or end == "deg":
        return words == 1 and end in HEAT_UNITS
    several = unit.quantity in (Quantity.ROTATION, Quantity.ACCELERATION, Quantity.COUNTS)
    return several if words > 1 else several or unit.quantity in WORDS_OF_UNITS
