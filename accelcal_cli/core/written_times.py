"""Times as people write them: dates, names of months, zones and halves of the day, around a time of day.

`SHAPES` are patterns of cells that have a time of day; what stands before and behind it, the same in many
rows, is read by `surroundings`. The patterns mean the same in Python and in RE2, which Arrow uses
(`formats/tables/cells.py`). Names of zones that stand for several are never guessed.
"""

from __future__ import annotations

import re
import unicodedata
from datetime import date, datetime, timedelta
from functools import lru_cache
from typing import NamedTuple

from accelcal_cli.core.clock import FIRST_US, LAST_US, MICROSECONDS, WIDEST_OFFSET_H, StartTime, start_of

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

_TIME = r"(?P<h>\d{1,2}):(?P<m>\d\d)(?::(?P<s>\d\d)(?:[.,:](?P<f>\d+))?)?"
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
    """Return the seconds since midnight; None for a time of day that does not exist.

    24:00:00 ends the day; 24:00:01 is its first second, as some browsers write it.
    """
    if afternoon is not None:
        if not 1 <= hour <= 12:
            return None
        hour = hour % 12 + 12 * afternoon
    if hour == 24 and (minute or second):
        hour = 0
    exists = hour <= 24 and minute < 60 and second <= 60
    return 3600 * hour + 60 * minute + second if exists else None
