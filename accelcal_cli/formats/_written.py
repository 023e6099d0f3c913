"""Reads columns of times that people wrote, many cells at a time (`core/written_times.py` knows the forms).

Numbers of the time of day are taken from the cells by Arrow; what stands around them is read once for each
text that differs.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date, datetime
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from accelcal_cli.core.clock import FIRST_US, LAST_US
from accelcal_cli.core.written_times import (
    DIGITS_ALONE,
    SHAPES,
    Surroundings,
    month_of,
    stated_zone,
    surroundings,
)
from accelcal_cli.formats._stamps import IMPOSSIBLE, NO_TIME

EPOCH_DAY = date(1970, 1, 1).toordinal()
DAY_S = 86_400
NO_DAY, OTHER_DAY = -(1 << 40), -(1 << 41)
"""Stand for a day that does not exist, and for one that is written in another form."""

DIRECTIVES = {
    **{"H": r"(?P<h>\d{1,2})", "I": r"(?P<h>\d{1,2})", "M": r"(?P<m>\d{1,2})", "S": r"(?P<s>\d{1,2})"},
    **{"f": r"(?P<f>\d{1,9})", "%": "%", "n": r"\s+", "t": r"\s+"},
    **{"d": r"\d{1,2}", "m": r"\d{1,2}", "y": r"\d\d", "Y": r"\d{4}", "j": r"\d{1,3}", "p": r"[^\d\s]{1,6}"},
    **{"b": r"[^\d\s,/]+", "B": r"[^\d\s,/]+", "a": r"[^\d\s,/]+", "A": r"[^\d\s,/]+", "u": r"\d"},
    **{"z": r"(?:Z|[+-]\d\d:?\d\d)", "Z": r"[A-Za-z/_]+", "G": r"\d{4}", "V": r"\d\d", "U": r"\d\d"},
}
"""Patterns of the directives of strptime; those of a time of day have names."""

SHORTHANDS = {"%T": "%H:%M:%S", "%F": "%Y-%m-%d", "%D": "%m/%d/%y", "%R": "%H:%M", "%e": "%d", "%h": "%b"}


@dataclass(frozen=True, slots=True)
class Written:
    """How the cells of a column of times are written.

    Attributes:
        pattern: of a cell, with groups h, m, s and f of its time of day, and others.
        order: of day, month and year in dates of numbers.
        directives: strptime's, of the groups d0, d1, ...; empty where `surroundings` reads before and after.
        offsets: True where the times are those of the offsets that are written, False for a clock's.
        vague: names of zones are left out, since one of them stands for several.
    """

    pattern: str
    order: str | None = None
    directives: tuple[str, ...] = ()
    offsets: bool = False
    vague: bool = False

    def read(self, cells: Any) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return texts (n,), an array of Arrow, as times (n,) [us], and the rows of those not written so.

        NO_TIME stands where a text is empty or not written so, IMPOSSIBLE for times that do not exist.
        """
        import pyarrow.compute as pc  # takes a tenth of a second, and most files need none of it

        found = pc.extract_regex(pc.utf8_trim_whitespace(cells), self.pattern)
        rows = np.flatnonzero(np.from_dlpack(found.is_valid().cast(pa.uint8())))
        others = np.from_dlpack(cells.is_valid().cast(pa.uint8())) > 0
        times = np.full(len(cells), NO_TIME, np.int64)
        if len(rows):
            read, known = self._times_of(pc, found.drop_null())
            times[rows] = np.where(known, read, NO_TIME)
            others[rows] = ~known
        return times, np.flatnonzero(others)

    def _times_of(self, pc: Any, found: Any) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return the times of what the pattern found (n,), and flags of those whose day is understood."""
        names = [field.name for field in found.type]
        parts = {name: pc.fill_null(pc.struct_field(found, name), "") for name in names}
        h, m, s = (_whole(pc, parts.get(name), len(found)) for name in "hms")
        decimals = parts.get("f")
        padded = None if decimals is None else pc.utf8_slice_codeunits(pc.utf8_rpad(decimals, 9, "0"), 0, 9)
        ns = _whole(pc, padded, len(found))
        around = [parts[name] for name in names if name not in ("h", "m", "s", "f")]
        days, shift, late = self._days(pc, around, len(found))
        halves = late >= 0
        hours = np.where(halves, h % 12 + 12 * late, h)
        wrong = (hours > 24) | ((h == 24) & ((m > 0) | (s > 0) | (ns > 0))) | (m > 59) | (s > 60)
        wrong |= (halves & ((h > 12) | (h == 0))) | (days <= NO_DAY)
        seconds = (np.where(wrong, 0, days) * 24 + hours) * 3600 + m * 60 + s - shift
        times = seconds * 1_000_000 + (ns + 500) // 1000
        wrong |= (times < FIRST_US) | (times > LAST_US)
        return np.where(wrong, IMPOSSIBLE, times), days != OTHER_DAY

    def _days(self, pc: Any, around: Sequence[Any], rows: int) -> tuple[NDArray[np.int64], ...]:
        """Return the days since 1970, the seconds ahead of UTC, and 1 for PM, 0 for AM, -1 without; (n,)."""
        if not around:
            return np.zeros(rows, np.int64), np.zeros(rows, np.int64), np.full(rows, -1)
        joined = pc.binary_join_element_wise(*around, "\x1f") if len(around) > 1 else around[0]
        coded = joined.dictionary_encode()
        read = np.array([self._read(text) for text in coded.dictionary.to_pylist()], np.int64)
        values = read.reshape(-1, 3)[np.from_dlpack(coded.indices)]
        return values[:, 0], values[:, 1], values[:, 2]

    def _read(self, text: str) -> tuple[int, int, int]:
        found = self.around(text.split("\x1f"))
        if found is None or not self.fits(found):
            return OTHER_DAY, 0, -1
        day = 0 if not found.dated else NO_DAY if found.day is None else found.day.toordinal() - EPOCH_DAY
        late = -1 if found.afternoon is None else int(found.afternoon)
        return day, (found.offset_s or 0) if self.offsets else 0, late

    def fits(self, found: Surroundings) -> bool:
        """Return True if there is a zone where the others have one, and none where they have none."""
        return self.vague or self.offsets == (found.offset_s is not None)

    def around(self, texts: Sequence[str]) -> Surroundings | None:
        """Return what the texts around a time of day say; None if they are not understood."""
        if not self.directives:
            return surroundings(texts[0], texts[1], self.order)
        pairs = [_in_english(*pair) for pair in zip(self.directives, texts, strict=True)]
        asked, given = (" ".join(some) for some in zip(("%I", "1"), *pairs, strict=True))
        try:
            read = datetime.strptime(given, asked)
        except ValueError:
            return Surroundings(True) if "%d" in self.directives else None
        dated = any(one[1] in "dmyYjGV" for one, _ in pairs)
        offset = read.utcoffset()
        half = read.hour >= 12 if "%p" in self.directives else None
        offset_s = None if offset is None else round(offset.total_seconds())
        return Surroundings(dated, read.date(), offset_s, half)

    def cell(self, text: str) -> Surroundings | None:
        """Return what stands around the time of day of one cell; None if it is written otherwise."""
        found = re.fullmatch(self.pattern.removeprefix("^").removesuffix("$"), text.strip())
        if found is None:
            return None
        groups = found.groupdict("")
        return self.around([groups[name] for name in groups if name not in ("h", "m", "s", "f")] or ["", ""])


def _in_english(directive: str, text: str) -> tuple[str, str]:
    """Return a directive of strptime and its text without names that depend on a language."""
    if directive in ("%b", "%B"):
        return "%m", str(month_of(text) or text)
    if directive in ("%a", "%A"):
        return "%%", "%"
    zone = stated_zone(text) if directive == "%Z" else None
    return ("%z", zone.replace("UTC", "Z")) if zone and "/" not in zone else (directive, text)


def _whole(pc: Any, texts: Any, rows: int) -> NDArray[np.int64]:
    """Return texts of digits (n,) as numbers; 0 for an empty one, and where there are none."""
    if texts is None:
        return np.zeros(rows, np.int64)
    filled = pc.if_else(pc.equal(texts, ""), "0", texts)
    return np.from_dlpack(pc.cast(filled, pa.int64())).astype(np.int64, copy=False)


def written_form(cells: Sequence[str], order: str | None = None) -> Written | None:
    """Return how cells are written, at least one; None if not all of them are times of one form."""
    forms = (Written(shape.pattern, order) for shape in SHAPES)
    return next((form for form in forms if all(form.cell(cell) is not None for cell in cells)), None)


def digits_alone() -> Written:
    """Return the form of times of day such as 104140.000."""
    return Written(DIGITS_ALONE)


def strptime_form(text: str) -> Written:
    """Return the form that a pattern of strptime describes.

    Raises:
        ValueError: it has no time of day, or a directive that is not known or stands twice.
    """
    for short, long in SHORTHANDS.items():
        text = text.replace(short, long)
    directives: list[str] = []
    pattern = ""
    for literal, directive in re.findall(r"([^%]+)|%(.)", text):
        if literal:
            pattern += re.escape(literal).replace(r"\ ", r"\s+")
        elif directive not in DIRECTIVES:
            raise ValueError(f"%{directive} is not known")
        elif "(?P<" in DIRECTIVES[directive] or directive in "%nt":
            pattern += DIRECTIVES[directive]
        else:
            pattern += f"(?P<d{len(directives)}>{DIRECTIVES[directive]})"
            directives.append(f"%{directive}")
    if "?P<h>" not in pattern:
        raise ValueError("it has no hour, %H or %I")
    try:
        re.compile(pattern)
    except re.error as error:
        raise ValueError("a directive is used twice") from error
    return Written(f"^{pattern}$", directives=tuple(directives))
