"""Times as people write and state them: dates, zones, daylight saving, and whose zone counts."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import date, datetime, timedelta, tzinfo
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import (
    FIRST_US,
    LAST_US,
    MICROSECONDS,
    WIDEST_OFFSET_H,
    StartTime,
    iso_time,
    offset_at_s,
    start_of,
    utc_offset_s,
)
from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.recording import Chunk, Intake, Reader, Recording

# Times as people write them: dates, names of months, zones and halves of the day, around a time of
# day.
#
# `SHAPES` are patterns of cells that have a time of day; what stands before and behind it, the same
# in many rows, is read by `surroundings`. The patterns mean the same in Python and in RE2, which
# Arrow uses (`formats/tables/cells.py`). Names of zones that stand for several are never guessed.

READ = (
    "2024-03-04 12:34:56.789 or in another form that is read: ISO 8601, RFC 2822, 4-Mar-2024 12:34:56, "
    "Mar 4, 2024 12:34:56 PM, 20240304123456"
)
"""Examples of forms, for messages."""

LONGEST = 80
"""Letters of the longest text that can be a time."""

ORDERS = ("dmy", "mdy", "ymd")
"""Orders of day, month and year in a date."""

CENTURY = 2000
"""Added to years of two digits."""

BUDDHIST = 543
BUDDHIST_YEARS = range(1900 + BUDDHIST, 2200 + BUDDHIST)
"""Years that are read as those of the Buddhist calendar, which is this many years ahead."""

_MONTHS = (
    "january februar february march april may june july august september october november december",
    "januar februar marz april mai juni juli august september oktober november dezember mrz maerz",
    "janvier fevrier mars avril mai juin juillet aout septembre octobre novembre decembre",
    "enero febrero marzo abril mayo junio julio agosto septiembre octubre noviembre diciembre",
    "gennaio febbraio marzo aprile maggio giugno luglio agosto settembre ottobre novembre dicembre",
    "janeiro fevereiro marco abril maio junho julho agosto setembro outubro novembro dezembro",
    "januari februari maart april mei juni juli augustus september oktober november december mrt",
    "januari februari mars april maj juni juli augusti september oktober november december",
    "stycznia lutego marca kwietnia maja czerwca lipca sierpnia wrzesnia pazdziernika listopada grudnia",
)
_INITIALS = (
    *(("jan", 1), ("ene", 1), ("gen", 1), ("feb", 2), ("fev", 2), ("mar", 3), ("mae", 3), ("maa", 3)),
    *(("mrz", 3), ("mrt", 3), ("apr", 4), ("avr", 4), ("abr", 4), ("mai", 5), ("may", 5), ("mag", 5)),
    *(("mei", 5), ("maj", 5), ("jun", 6), ("juin", 6), ("giu", 6), ("jul", 7), ("juil", 7), ("lug", 7)),
    *(("aug", 8), ("aou", 8), ("ago", 8), ("sep", 9), ("set", 9), ("oct", 10), ("okt", 10), ("ott", 10)),
    *(("out", 10), ("nov", 11), ("dec", 12), ("dez", 12), ("dic", 12), ("sty", 1), ("lut", 2), ("kwi", 4)),
    *(("cze", 6), ("lip", 7), ("sie", 8), ("wrz", 9), ("paz", 10), ("lis", 11), ("gru", 12)),
)
"""Beginnings of months in the same languages."""

_DAYS = frozenset(
    re.findall(
        r"\w+",
        "mon tue wed thu fri sat sun mo di mi do fr sa so die mit don son lun mar mer jeu ven dim mie jue "
        "vie sab dom gio seg ter qua qui sex ma wo vr za zo",
    )
)
"""Beginnings of weekdays in the same languages."""

_DAY_ENDS = re.compile(
    r".*(?:day|dag|tag|woch|abend|d[iì]|manche|es|[sáa]bado|sabato|domenica|domingo|feira|ter[çc]a|segunda"
    r"|quarta|quinta|sexta|tues|thurs?|weds)"
)
"""Ends of whole names of weekdays: other words begin like them."""

_FILLERS = frozenset(
    re.findall(r"\w+", "t at um a à às de del of den le il la las kl klo st nd rd th er 年 月 日 년 월 일")
)
"""Words between the parts of a time that say nothing."""

_OFFSETS_H = {
    **{"Z": 0, "UT": 0, "UTC": 0, "GMT": 0, "WET": 0, "WEST": 1, "CET": 1, "MEZ": 1, "CEST": 2, "MESZ": 2},
    **{"EET": 2, "SAST": 2, "EEST": 3, "MSK": 3, "PKT": 5, "NPT": 5.75, "ICT": 7, "HKT": 8, "AWST": 8},
    **{"JST": 9, "KST": 9, "ACST": 9.5, "AEST": 10, "ACDT": 10.5, "AEDT": 11, "NZST": 12, "NZDT": 13},
    **{"NDT": -2.5, "BRT": -3, "ADT": -3, "NST": -3.5, "EDT": -4, "EST": -5, "CDT": -5, "MDT": -6},
    **{"MST": -7, "PDT": -7, "PST": -8, "AKDT": -8, "AKST": -9, "HST": -10},
}
"""Hours east of UTC, by the names of zones that stand for one."""

UNREAD_ZONE = "the time zone {!r} of the header is not understood: --timezone gives that of the clock"
AMBIGUOUS = {
    "CST": "Central Standard Time (-06:00) and China (+08:00)",
    "IST": "India (+05:30), Israel (+02:00) and Ireland (+01:00)",
    "BST": "British Summer Time (+01:00) and Bangladesh (+06:00)",
    "AST": "Atlantic (-04:00) and Arabia (+03:00)",
    "GST": "the Gulf (+04:00) and South Georgia (-02:00)",
    "WST": "Samoa (+13:00) and Western Australia (+08:00)",
}
"""Names of zones that stand for several: times with them are those of a clock."""

_HALVES = {"a": False, "p": True, "上午": False, "下午": True, "午前": False, "午後": True}
_HALVES |= {"오전": False, "오후": True}

_TIME = r"(?P<h>\d{1,2}):(?P<m>\d\d)(?::(?P<s>\d\d)(?:[.,:](?P<f>\d{1,12}))?)?"
COLONS = rf"^(?P<before>|.*?[^\d.:]|\d{{1,2}}[A-Za-z]{{3}}\d{{2,4}}:){_TIME}(?P<after>|[^\d.,:].*)$"
BASIC = (
    r"^(?P<before>\d{8}[T _-]?|\d{4}-\d\d-\d\d[T _]|\d{4}-?\d{3}[T _]|\d{4}-?W\d\d-?\d[T _])"
    r"(?P<h>\d\d)(?P<m>\d\d)(?P<s>\d\d)(?:[.,]?(?P<f>\d{1,9}))?(?P<after>|[^\d.,].*)$"
)
DOTS = (
    r"^(?P<before>.*\d{4}.*[^\d.,:] *|\d{1,2}\.\d{1,2}\.\d{2,4} +)(?P<h>\d{1,2})\.(?P<m>\d\d)\.(?P<s>\d\d)"
    r"(?:[.,](?P<f>\d{1,9}))?(?P<after>|[^\d.,:].*)$"
)
DASHES = (
    r"^(?P<before>\d{4}-?\d\d-?\d\d[T _-])(?P<h>\d\d)-(?P<m>\d\d)-(?P<s>\d\d)"
    r"(?:[.,-](?P<f>\d{3,9}))?(?P<after>|[^\d.,-].*)$"
)
DIGITS_ALONE = r"^(?P<before>)(?P<h>\d{1,2})(?P<m>\d\d)(?P<s>\d\d)(?:[.,](?P<f>\d{1,9}))?(?P<after>)$"
"""104140.000: digits of a time of day, which only a look at many of them tells from seconds."""

SHAPES = tuple(re.compile(one) for one in (COLONS, BASIC, DOTS, DASHES))

_NUMERIC = re.compile(r"\D*(\d{1,4})\D{1,3}(\d{1,2})\D{1,3}(\d{1,4})(?!\d)")
_COMPACT = re.compile(r"\D*((?:19|2[0156])\d\d)(\d\d)(\d\d)\D*")
_WEEK = re.compile(r"(\d{4})-?W(\d\d)-?(\d)", re.IGNORECASE)
_ORDINAL = re.compile(r"(\d{4})-?(\d{3})")
_WORD = re.compile(r"[^\W\d_]+")
_OFFSET = re.compile(
    r"(?:(?<![A-Za-z])(?:UTC|GMT)\s?|(?<![\w/]))([+\u2212-])(\d{1,2})(?::?(\d\d))?(?::00)?(?![\w.:/-])"
)
_BARE_OFFSET = re.compile(r"(?:(?:UTC|GMT)\s*)?([+-]?)(\d{1,2})(?::?(\d\d))?(?::00)?", re.IGNORECASE)
_BRACKETS = re.compile(r"\s*[\[(]([^\[\]()]*)[\])]\s*$")
_HALF = re.compile(r"(?<![^\W\d])([AaPp])\.?\s?[Mm](?![^\W\d_])\.?|[上下]午|午[前後]|오[전후]")
_PLACE = re.compile(r"[A-Z][A-Za-z_]+/[A-Za-z_/+-]+\d*")


class Surroundings(NamedTuple):
    """The texts before and behind a time of day, as read.

    Attributes:
        dated: a date is written; day: the date, None if there is none or it does not exist.
        offset_s: seconds that the clock is ahead of UTC, None if nothing says so.
        afternoon: by AM or PM, None without.
        place: a zone by region and place.
        vague: a name of a zone that stands for several.
    """

    dated: bool = False
    day: date | None = None
    offset_s: int | None = None
    afternoon: bool | None = None
    place: str | None = None
    vague: str | None = None


def month_of(word: str) -> int | None:
    """Return the month of a name such as `Mar` or `août`; None for any other word."""
    plain = "".join(one for one in unicodedata.normalize("NFKD", word.lower()) if one.isalpha())
    known = any(name.startswith(plain) for names in _MONTHS for name in names.split())
    known = known or plain == "sept"
    return next((month for name, month in _INITIALS if plain.startswith(name)), None) if known else None


def read_date(text: str, order: str | None = None) -> date | None:
    """Return the date at the beginning of a text; None if it is not one.

    Args:
        order: of day, month and year in numbers; None: only dates that begin with the year, have the name of
            the month, or eight digits.
    """
    if (compact := _COMPACT.fullmatch(text)) is not None:
        return _date(*map(int, compact.groups()))
    words = [*map(month_of, _WORD.findall(text))]
    months = [month for month in words if month is not None][-1:]  # a weekday may look like one: mar. 14 mars
    numbers = re.findall(r"\d+", text)
    if len(months) == 1 and len(numbers) == 2:
        return _with_month(numbers, months[0], order)
    numeric = _NUMERIC.match(text)
    if numeric is None:
        return None
    order = order or ("ymd" if len(numeric[1]) == 4 else "")
    parts = dict(zip(order, numeric.groups(), strict=False))
    if len(parts) < 3 or len(parts["y"]) not in (2, 4) or len(parts["d"]) > 2:
        return None
    return _date(_year(parts["y"]), int(parts["m"]), int(parts["d"]))


def _with_month(numbers: list[str], month: int, order: str | None) -> date | None:
    """Return the date of a day and a year next to a month; of two digits each, the year is the last."""
    first, last = numbers
    if len(first) == 4 or (order == "ymd" and len(first) == len(last) == 2):
        first, last = last, first
    if len(first) > 2 or len(last) not in (2, 4):
        return None
    return _date(_year(last), month, int(first))


def _year(text: str) -> int:
    return int(text) + (CENTURY if len(text) == 2 else 0)


def _date(year: int, month: int, day: int) -> date | None:
    try:
        return date(year - BUDDHIST * (year in BUDDHIST_YEARS), month, day)
    except ValueError:
        return None


def order_in(words: str) -> str | None:
    """Return the order in a pattern such as `dd/MM/yyyy` or `dd-MMM-yy`; None for any other text."""
    plain = re.sub(r"'[^']*'|dddd?|g+", "", words)
    found = "".join(dict.fromkeys(letter for letter in plain.lower() if letter in "dmy"))
    return found if found in ORDERS else None


def stated_zone(text: str) -> str | None:
    """Return a zone of a header, such as `GMT +5:30`, `-5`, `-05:00:00` or `EDT`; None for any other text.

    Returns:
        `UTC`, an offset such as `+05:30`, or a region and place as it is written.
    """
    text = text.strip().strip("[]()")
    if _PLACE.fullmatch(text):
        from zoneinfo import available_timezones  # few headers name one

        return text if text in available_timezones() else None
    bare = _BARE_OFFSET.fullmatch(text)
    if bare is None:
        hours = _OFFSETS_H.get(text.upper())
        return None if hours is None else zone_of(round(60 * hours)) if hours else "UTC"
    minutes = _minutes(*bare.groups())
    return None if minutes is None else zone_of(minutes)


def header_zone(text: str) -> tuple[str | None, tuple[str, ...]]:
    """Return the zone that a header states, None if it states none, and a note if it is not understood."""
    zone, text = stated_zone(text), text.strip()
    notes = () if zone is not None or not text else (UNREAD_ZONE.format(text[:40]),)
    return ("UTC" if zone == "+00:00" else zone), notes


def zone_of(minutes: int) -> str:
    """Return a fixed offset from UTC such as `-05:30`."""
    return f"{'-' if minutes < 0 else '+'}{abs(minutes) // 60:02d}:{abs(minutes) % 60:02d}"


def _minutes(sign: str, hours: str, minutes: str | None) -> int | None:
    total = 60 * int(hours) + int(minutes or 0)
    if int(hours) > WIDEST_OFFSET_H or int(minutes or 0) > 59:
        return None
    return total if sign in ("", "+") else -total


@lru_cache(maxsize=1 << 14)
def surroundings(before: str, after: str, order: str | None = None) -> Surroundings | None:
    """Return what the texts before and behind a time of day say; None if they are not understood.

    Args:
        order: of day, month and year in dates of numbers.
    """
    place, offset_s = None, None
    if (bracket := _BRACKETS.search(after)) is not None:
        after, place = after[: bracket.start()], bracket[1] if _PLACE.fullmatch(bracket[1]) else None
    if (offset := _OFFSET.search(after)) is not None:
        minutes = _minutes(offset[1], offset[2], offset[3])
        if minutes is None:
            return None
        after, offset_s = after[: offset.start()] + after[offset.end() :], 60 * minutes
    text = f"{before} \0 {after}"
    half = _HALF.search(text)
    if half is not None:
        text = text[: half.start()] + text[half.end() :]
    found = _without_words(text)
    if found is None:
        return None
    day, named_s, vague = found
    dated = any(letter.isdigit() for letter in day)
    return Surroundings(
        dated,
        _day_of(day, order) if dated else None,
        named_s if offset_s is None else offset_s,
        None if half is None else _HALVES[half[1].lower() if half[1] else half[0]],
        place,
        vague if offset_s is None else None,
    )


def _without_words(text: str) -> tuple[str, int | None, str | None] | None:
    """Return the date of a text, without names of zones and words that say nothing; offset; vague name.

    Returns:
        None if a word is not understood.
    """
    offset_s, vague = None, None
    for word in _WORD.findall(text):
        low = word.lower()
        if word in AMBIGUOUS:
            vague = word
        elif word.upper() in _OFFSETS_H and (word.isupper() or low in ("z", "utc", "gmt")):
            offset_s = round(3600 * _OFFSETS_H[word.upper()])
        elif low == "w" or (month_of(word) is not None and low not in _FILLERS):
            continue
        elif low not in _FILLERS and low not in _DAYS and not (low[:3] in _DAYS and _DAY_ENDS.fullmatch(low)):
            return None
        text = re.sub(rf"(?<![^\W\d_]){word}(?![^\W\d_])\.?", " ", text, count=1)
    return text.replace("\0", " ").strip(" ,;_"), offset_s, vague


def _day_of(text: str, order: str | None) -> date | None:
    try:
        if (week := _WEEK.fullmatch(text)) is not None:
            return date.fromisocalendar(*map(int, week.groups()))
        if (ordinal := _ORDINAL.fullmatch(text)) is not None:
            return date(int(ordinal[1]), 1, 1) + timedelta(days=int(ordinal[2]) - 1)
    except (ValueError, OverflowError):
        return None
    return read_date(text, order)


def around_time(text: str) -> tuple[str, str] | None:
    """Return what stands before and behind a time of day; None where there is none."""
    found = next((match for shape in SHAPES if (match := shape.fullmatch(text))), None)
    return None if found is None else (found["before"], found["after"])


def undated(before: str, after: str) -> str:
    """Return the text of the date around a time of day, without all else; empty if it is not understood."""
    after = _OFFSET.sub("", _BRACKETS.sub("", after))
    found = _without_words(_HALF.sub("", f"{before} \0 {after}"))
    return "" if found is None else found[0]


def needs_order(text: str) -> bool:
    """Return True for a date in numbers that only an order of day, month and year makes clear."""
    return read_date(text) is None and any(read_date(text, order) for order in ORDERS)


def has_buddhist_year(text: str) -> bool:
    """Return True if a text has a year of the Buddhist calendar."""
    return any(int(year) in BUDDHIST_YEARS for year in re.findall(r"(?<!\d)2[45]\d\d(?!\d)", text))


def is_digits_of_day(text: str) -> bool:
    """Return True if a number such as 104140.000 has the digits of a time of day."""
    found = re.fullmatch(DIGITS_ALONE[1:-1], text)
    return found is not None and int(found["h"]) < 24 and max(int(found["m"]), int(found["s"])) < 60


def is_time(text: str) -> bool:
    """Return True if a text has the form of a time of day, with or without a date; it need not exist."""
    around = around_time(text) if len(text) <= LONGEST else None
    return around is not None and surroundings(*around) is not None


def is_date(text: str) -> bool:
    """Return True if a text is a date without a time of day, in numbers or with the name of a month."""
    if not any(letter.isdigit() for letter in text[:12]) or ":" in text or len(text) > LONGEST:
        return False
    found = _without_words(text)
    return found is not None and found[1:] == (None, None) and any(read_date(found[0], o) for o in ORDERS)


def written_start(text: str, order: str | None = None) -> StartTime | None:
    """Return a date and time that is written in any of the known forms; None for any other text.

    A second 60, of a leap second or of rounding, is the first of the next minute.
    """
    text = text.strip()
    found = next((match for shape in SHAPES if (match := shape.fullmatch(text))), None)
    if found is None:
        return iso_start(text)
    around = surroundings(found["before"], found["after"], order)
    if around is None or around.day is None:
        return None
    seconds = seconds_of_day(int(found["h"]), int(found["m"]), int(found["s"] or 0), around.afternoon)
    if seconds is None:
        return None
    fraction_us = (int((found["f"] or "0").ljust(12, "0")[:9]) + 500) // 1000
    since_s = (around.day - date(1970, 1, 1)).days * 86_400 + seconds - (around.offset_s or 0)
    start_us = since_s * MICROSECONDS + fraction_us
    if not FIRST_US <= start_us <= LAST_US:
        return None
    zone = "UTC" if around.offset_s is not None else around.place
    return StartTime(start_us, zone, bool(around.offset_s))


def iso_start(text: str) -> StartTime | None:
    """Return a date and time as ISO 8601 has it, which may be cut short; None for any other text."""
    try:
        return start_of(datetime.fromisoformat(text.strip()))
    except ValueError:
        return None


def seconds_of_day(hour: int, minute: int, second: int, afternoon: bool | None) -> int | None:
    """Return the seconds since midnight; None for a time of day that does not exist."""
    if afternoon is not None:
        if not 1 <= hour <= 12:
            return None
        hour = hour % 12 + 12 * afternoon
    exists = hour < 24 or (hour == 24 and minute == second == 0)
    return 3600 * hour + 60 * minute + second if exists and minute < 60 and second <= 60 else None


# Local times of a recording: whose zone counts, what the user states, daylight saving.
#
# This is the policy of all formats (docs/time.md). A reader only says which zone a file states: a
# name or an offset for a clock that shows local time, `UTC` for times that count from 1970 or end in
# `Z` or an offset, None if it states none.
#
# A user may state when a recording began, that its clock was wrong, or the zone in which it was worn.
# Times then move as a whole, by one number of microseconds, so that no row is lost, doubled or moved
# against another.
#
# A device's clock runs on when its zone changes its offset. A computer's clock follows the change:
# times in its tables skip an hour in spring and repeat one in autumn. `LocalStamps` makes such times
# run on too, so that all later stages see one offset for a whole recording.

UTC, UNKNOWN = "UTC", "unknown"
"""Meaning of times in the outputs: moments in UTC, or local times of an unknown zone."""

OMIT = "omit {option}, which is for files that state no zone"
TWICE = "{time} occurs twice in {zone} on that day: it is taken to be the first, before clocks were put back"
NEVER = "{time} does not occur in {zone} on that day: the clock is taken to be one that was not put forward"

NO_START = "no_start_time"
"""Code of the problem of a recording without dates; its times count from 1970."""

FIRST_SAMPLES = 1
ISO_HINT = "write it as 2024-03-04T10:00:00, with an offset such as +01:00 if it is known"
STARTED = "it does not say when it began: {} was given with -R start"
SHIFTED = "{:+g} s were added to all times (-R shift)"
WORN = "the clock was set in {there} and worn in {here}: times are those of {here}, {hours:+g} h"

FOLLOWED = "clock_followed"
"""Code of the problem that says where times followed a change of their zone."""

PAUSE_US = 60 * MICROSECONDS
"""Longest pause [us] between the rows before and after a change whose times are said to follow it."""

SHIFT_STEP_US, LARGEST_SHIFT_US = 1800 * MICROSECONDS, 3 * 3600 * MICROSECONDS
"""Step and maximum [us] by which clocks are put forward or back."""

_DAY_S = 86_400


def zone_of_times(offset_s: int | None) -> str:
    """Return the meaning of times in the outputs, by the seconds that the clock is ahead of UTC."""
    return UNKNOWN if offset_s is None else UTC


def in_its_zone(
    recording: Recording, wanted: str | None, *, force: bool, option: str = "--timezone"
) -> Recording:
    """Return a recording as a reader opened it, in the zone that counts.

    Args:
        wanted: the user's zone, for files that state none.
        force: the user's zone counts in any case.
        option: the option that gave it.

    Raises:
        UsageError: the zone that the file states is not the user's; or the user's is to replace offsets
            that the times themselves had.
    """
    zone = _zone(recording, wanted, force, OMIT.format(option=option))
    notes, start_us = recording.notes, recording.start_us
    if zone is not None and start_us is not None:
        first, second = (utc_offset_s(zone, start_us, fold=fold) or 0 for fold in (0, 1))
        if first != second:
            shown = (datetime(1970, 1, 1) + timedelta(microseconds=start_us)).isoformat(" ", "seconds")
            notes = (*notes, (TWICE if first > second else NEVER).format(time=shown, zone=zone))
    return replace(recording, timezone=zone, notes=notes)


def _zone(recording: Recording, wanted: str | None, force: bool, omit: str) -> str | None:
    stated, start_us = recording.timezone, recording.start_us or 0
    if wanted is None or stated is None:
        return wanted or stated
    if utc_offset_s(stated, start_us) == utc_offset_s(wanted, start_us):
        return wanted if force else stated
    if not force:
        what = f"states its time zone, {stated}, which is not {wanted}"
        hint = f"{omit}; or add -R force_timezone=true if the file is wrong"
        raise UsageError(what, path=recording.path, hint=hint)
    if recording.has_offsets:
        what = f"its times have offsets from UTC, which -R force_timezone cannot replace with {wanted}"
        raise UsageError(what, path=recording.path, hint=f"{omit}; or write the times without offsets")
    return wanted


@dataclass(frozen=True, slots=True)
class ZoneChange:
    """Change of a zone's offset from UTC during a recording.

    Attributes:
        at_us: time of the change, on a clock that had the zone's offset until then [us since 1970].
        before_s, after_s: seconds ahead of UTC.
        followed: True if the times followed it; None if they do not show it, and count as those of a clock
            that runs on.
    """

    zone: str
    at_us: int
    before_s: int
    after_s: int
    followed: bool | None = False

    def note(self) -> str:
        """Return the sentence for the report."""
        shift_s = self.after_s - self.before_s
        hours = f"{abs(shift_s) / 3600:g} h"
        put, off, wrong = ("forward", "behind", "late") if shift_s > 0 else ("back", "ahead of", "early")
        then = {
            True: "the times of this file follow that, and were read so",
            False: f"the device's clock was not, and is {hours} {off} local time from then on",
            None: "the rows that were read do not show whether the clock of this file was, too: it is taken "
            f"to be one that was not; if it was, later times are {hours} too {wrong}",
        }
        at = iso_time(self.at_us, self.before_s)
        return f"clocks in {self.zone} were put {put} by {hours} at {at}; {then[self.followed]}"


def zone_changes(zone: str | None, start_us: int, end_us: int) -> Iterator[ZoneChange]:
    """Yield the changes of a zone's offset during a recording; none for a fixed or unknown zone.

    Args:
        start_us, end_us: local times of the first and last sample, on a clock that keeps its offset.
    """
    place = _place(zone)
    if zone is None or place is None:
        return
    try:
        offset_s = before_s = utc_offset_s(zone, start_us) or 0
        low_s, end_s = (time_us // MICROSECONDS - offset_s for time_us in (start_us, end_us))
        while low_s < end_s:
            high_s = min(low_s + _DAY_S, end_s)
            if (after_s := _offset_at(place, high_s)) != before_s:
                at_s = high_s
                while at_s - low_s > 1:
                    middle = (low_s + at_s) // 2
                    low_s, at_s = (middle, at_s) if _offset_at(place, middle) == before_s else (low_s, middle)
                yield ZoneChange(zone, (at_s + before_s) * MICROSECONDS, before_s, after_s)
                before_s = after_s
            low_s = high_s
    except (OverflowError, ValueError, OSError):
        return


def _place(zone: str | None) -> tzinfo | None:
    """Return a zone that may change its offset, one of a region and place; else None."""
    from zoneinfo import ZoneInfo  # few recordings name one

    return None if zone is None or "/" not in zone else ZoneInfo(zone)


def _offset_at(place: tzinfo, utc_s: int) -> int:
    offset = datetime.fromtimestamp(utc_s, place).utcoffset()
    return 0 if offset is None else round(offset.total_seconds())


class LocalStamps:
    """Makes the times of a table's rows those of a clock that runs on.

    Times follow a change of the zone if they jump by as much as its clocks did, just when these did. Such a
    jump is undone; any other stays.
    """

    def __init__(self, zone: str | None) -> None:
        self._zone = zone
        self._place = _place(zone)
        self._start_s: int | None = None
        self._offset_s = 0
        self._before = 0

    def running_on(self, times: NDArray[np.int64]) -> tuple[NDArray[np.int64], list[int]]:
        """Return the next times (n,) [us] on a clock that runs on.

        Returns:
            the times, and the rows before which they follow a change.
        """
        if self._place is None or not len(times):
            return times, []
        if self._start_s is None:
            self._before = int(times[0])
            self._start_s = self._offset_s = utc_offset_s(self._zone, self._before) or 0
        before = np.concatenate(([self._before], times[:-1]))
        self._before = int(times[-1])
        rows, running = [], times + (self._start_s - self._offset_s) * MICROSECONDS
        steps = times - before
        far = np.flatnonzero((np.abs(steps) > SHIFT_STEP_US // 2) & (np.abs(steps) <= LARGEST_SHIFT_US))
        for row in far[steps[far] % SHIFT_STEP_US <= PAUSE_US].tolist():
            shift_s = self._shift_s(int(before[row]), int(times[row]))
            if shift_s:
                self._offset_s += shift_s
                running[row:] -= shift_s * MICROSECONDS
                rows.append(row)
        return running, rows

    def _shift_s(self, before_us: int, after_us: int) -> int:
        """Return the seconds by which clocks and times were put forward between two rows; else 0."""
        assert self._place is not None
        utc_us = before_us - self._offset_s * MICROSECONDS
        try:
            now_s, then_s = (
                _offset_at(self._place, moment // MICROSECONDS) for moment in (utc_us, utc_us + PAUSE_US)
            )
            lasted_us = after_us - before_us - (then_s - now_s) * MICROSECONDS
            moved = now_s == self._offset_s and 0 <= lasted_us <= PAUSE_US
            moved = moved and _offset_at(self._place, (utc_us + lasted_us) // MICROSECONDS) == then_s
        except (OverflowError, ValueError, OSError):
            return 0
        return then_s - now_s if moved else 0


@dataclass(frozen=True, slots=True)
class Retiming:
    """Statements of the user about times; None or 0 where nothing is stated.

    Attributes:
        zone: zone of the device's clock, for files that state none; by_option: the option that gave it.
        force: that zone counts in any case.
        start: start of a recording without dates, ISO 8601.
        shift_us: added to all times.
        worn_zone: zone in which the device was worn while its clock showed another.
    """

    zone: str | None = None
    by_option: str = "--timezone"
    force: bool = False
    start: str | None = None
    shift_us: int = 0
    worn_zone: str | None = None

    def check(self) -> None:
        """Raise UsageError for an unknown zone, a start that is not a time, or an incomplete pair of
        options."""
        utc_offset_s(self.zone, 0)
        utc_offset_s(self.worn_zone, 0)
        if self.force and self.zone is None:
            raise UsageError("-R force_timezone has no zone to use", hint="give it with --timezone")
        if self.by_option != "--timezone" and self.worn_zone is None:
            raise UsageError(
                "-R configured_zone is for -R worn_zone", hint="give that, too, or use --timezone"
            )
        self.started()

    def started(self) -> StartTime | None:
        """Return the start; None if none is stated.

        Raises:
            UsageError: it is not a time.
        """
        if self.start is None:
            return None
        start = written_start(self.start)
        if start is None:
            raise UsageError(f"-R start={self.start[:40]!r} is not a date and time", hint=ISO_HINT)
        return start


class RetimedReader(Reader):
    """Reader that moves the times of another one's chunks.

    Args:
        recording: its description, with the moved times.
        by_us: added to all times.
        dated: the start is known, whatever the file says.
    """

    def __init__(self, reader: Reader, recording: Recording, by_us: int, *, dated: bool) -> None:
        self.recording = recording
        self._reader, self._moved = reader, partial(moved, by_us=by_us, dated=dated)

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """See `Reader`."""
        self._reader.threads = self.threads
        return map(self._moved, self._reader.chunks(chunk_samples))

    def intake(self) -> Intake:
        """See `Reader`."""
        return RetimedIntake(self._reader.intake(), self._moved)

    def preview(self, chunk_samples: int, pieces: int) -> Iterator[Chunk]:
        """See `Reader`."""
        return map(self._moved, self._reader.preview(chunk_samples, pieces))

    def close(self) -> None:
        """Release the file."""
        self._reader.close()


def moved(chunk: Chunk, by_us: int, *, dated: bool) -> Chunk:
    """Return a chunk with moved times; if `dated`, without the problem that there are no dates."""
    problems = chunk.problems
    if dated:
        problems = tuple(problem for problem in problems if problem.code != NO_START)
    return replace(chunk, clock=chunk.clock.shifted(by_us), problems=problems)


class RetimedIntake(Intake):
    """Intake that moves the times of another one's chunks as `RetimedReader` does."""

    def __init__(self, intake: Intake, moved: Callable[[Chunk], Chunk]) -> None:
        self._intake, self._moved = intake, moved

    def take(self, data: bytes, *, last: bool) -> Iterator[Chunk]:
        """See `Intake`."""
        return map(self._moved, self._intake.take(data, last=last))


def retimed(reader: Reader, stated: Retiming) -> Reader:
    """Return a reader as its format opened it, with the times that count.

    Raises:
        UnreadableError: no sample can be read.
        UsageError: what is stated contradicts the file, or does not suffice.
    """
    found, by_us = reader.recording, 0
    if stated.start is not None:
        found, by_us = _started(reader, stated)
    if stated.shift_us:
        _need_start(found, "-R shift")
        found = _moved(found, stated.shift_us, SHIFTED.format(stated.shift_us / 1e6))
        by_us += stated.shift_us
    found = in_its_zone(found, stated.zone, force=stated.force, option=stated.by_option)
    reader.recording = replace(reader.recording, timezone=found.timezone)
    if stated.worn_zone is not None:
        found, moved_us = _worn(found, stated.worn_zone)
        by_us += moved_us
    elif not by_us and stated.start is None:
        reader.recording = found
        return reader
    return RetimedReader(reader, found, by_us, dated=stated.start is not None)


def _moved(recording: Recording, by_us: int, note: str) -> Recording:
    start_us = (recording.start_us or 0) + by_us
    return replace(recording, start_us=start_us, notes=(*recording.notes, note))


def _need_start(recording: Recording, option: str) -> None:
    if recording.start_us is None:
        text = f"has no dates that {option} could change"
        raise UsageError(
            text, path=recording.path, hint=f"omit {option}, or say with -R start=TIME when it began"
        )


def _started(reader: Reader, stated: Retiming) -> tuple[Recording, int]:
    """Return a recording without dates that begins when the user says, and how far its times move [us]."""
    recording, start = reader.recording, stated.started()
    assert start is not None
    if recording.start_us is not None:
        shown = iso_time(recording.start_us, utc_offset_s(recording.timezone, recording.start_us))
        hint = "-R start is for files without dates; to correct the clock, use -R shift=SECONDS"
        raise UsageError(f"states its own start, {shown}", path=recording.path, hint=hint)
    known = replace(recording, start_us=start.start_us, timezone=start.timezone or recording.timezone)
    note = STARTED.format(stated.start)
    dated = replace(known, has_offsets=start.had_offset, notes=(*recording.notes, note))
    first = next((chunk for chunk in reader.chunks(FIRST_SAMPLES) if len(chunk)), None)
    if first is None:
        raise UnreadableError("holds no samples", path=recording.path)
    return dated, start.start_us - int(first.clock.times(0, 1)[0])


def _worn(recording: Recording, zone: str) -> tuple[Recording, int]:
    """Return a recording with the times of the zone in which it was worn, and how far they move [us].

    Its clock runs on with the offset that its own zone had at the start; so do the times of the other zone.
    """
    _need_start(recording, "-R worn_zone")
    there = recording.timezone
    if there is None:
        hint = "say it with -R configured_zone=ZONE"
        raise UsageError("does not say in which zone its clock was set", path=recording.path, hint=hint)
    start_us = recording.start_us or 0
    before_s = utc_offset_s(there, start_us) or 0
    after_s = offset_at_s(zone, start_us - before_s * MICROSECONDS)
    by_us = (after_s - before_s) * MICROSECONDS
    note = WORN.format(there=there, here=zone, hours=(after_s - before_s) / 3600)
    found = replace(_moved(recording, by_us, note), stamped=False)
    if utc_offset_s(zone, start_us + by_us) != after_s:
        # The local time occurs twice, and the zone's name would stand for the first of them.
        hours, minutes = divmod(abs(after_s) // 60, 60)
        zone = f"{'-' if after_s < 0 else '+'}{hours:02d}:{minutes:02d}"
    return replace(found, timezone=zone), by_us
