"""The text of a page: nine lines of `key:value`, then 300 samples as one line of 3600 hexadecimal digits.

Source: Activinsights, GENEActiv instructions, "Understanding .bin files". Numbers have as many
digits as they need, lines end in LF or CR LF, and the decimal sign may be a comma (as computers
of some countries wrote it), so that pages differ in length.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from fractions import Fraction
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.readers._geneactiv.signature import MARK
from accelcal_cli.readers._pages.pages import NO_TEMPERATURE

SAMPLES = 300
SAMPLE_DIGITS = 12
BODY_DIGITS = SAMPLES * SAMPLE_DIGITS
USUAL_BYTES = 3840
"""About how long a page is."""

LONGEST_BYTES = 4608
"""A page is never longer than this, by the limits of the pattern below."""

SHORTEST_BYTES = BODY_DIGITS + 150

_END = rb"[ \t]{0,32}\r?\n"
_ANY = rb"[^\r\n]{0,64}\r?\n"
HEAD = re.compile(
    MARK
    + _END
    + rb"Device Unique Serial Code:([^\r\n]{0,64})\r?\n"
    + rb"Sequence Number:(\d{1,10})"
    + _END
    + rb"Page Time:(20\d\d-\d\d?-\d\d? \d\d?:\d\d?:\d\d?:\d{3})"
    + _END
    + rb"Unassigned:"
    + _ANY
    + rb"Temperature:([^\r\n]{0,64})\r?\n"
    + rb"Battery voltage:"
    + _ANY
    + rb"Device Status:"
    + _ANY
    + rb"Measurement Frequency:([^\r\n]{0,64})\r?\n"
)
"""A page's text; the groups are serial number, sequence number, time, temperature and rate."""

_NUMBER = re.compile(rb"(-?\d{1,6}(?:[.,]\d{1,6})?)(?: Hz)?")
STAMP_BYTES = 23
NO_STAMP = int(np.iinfo(np.int64).min)
"""Marks a time that is none, such as the 31st of February."""


def number(text: bytes) -> Fraction | None:
    """A decimal number, with a point or a comma; None where the text is none."""
    found = _NUMBER.fullmatch(text.strip())
    return Fraction(found[1].replace(b",", b".").decode("ascii")) if found else None


@lru_cache(maxsize=4096)
def temperature_mc(text: bytes) -> int:
    """Thousandths of a degree C of a page's temperature; NO_TEMPERATURE where it tells none."""
    value = number(text)
    return NO_TEMPERATURE if value is None else round(value * 1000)


def stamps_us(texts: Sequence[bytes]) -> NDArray[np.int64]:
    """Microseconds since 1970 of page times that HEAD accepts, (p,); NO_STAMP for those that are none."""
    even = b"".join(text if len(text) == STAMP_BYTES else _padded(text) for text in texts)
    digits = np.frombuffer(even, np.uint8).reshape(-1, STAMP_BYTES).astype(np.int64) - ord("0")
    year = digits[:, :4] @ np.array([1000, 100, 10, 1])
    month, day, hour, minute, second = (digits[:, at] * 10 + digits[:, at + 1] for at in (5, 8, 11, 14, 17))
    milli = digits[:, 20:23] @ np.array([100, 10, 1])
    known = (month >= 1) & (month <= 12) & (day >= 1) & (hour < 24) & (minute < 60) & (second < 60)
    begun = ((year - 1970) * 12 + month - 1).astype("M8[M]")
    known &= begun.astype("M8[D]") + (day - 1) < (begun + 1).astype("M8[D]")
    days = begun.astype("M8[D]").astype(np.int64) + day - 1
    time_us = (((days * 24 + hour) * 60 + minute) * 60 + second) * 1_000_000 + milli * 1000
    return np.where(known, time_us, NO_STAMP)


def _padded(text: bytes) -> bytes:
    """A page time with all its leading zeros."""
    year, *numbers, milli = re.split(rb"[- :]", text)
    month, day, hour, minute, second = (part.zfill(2) for part in numbers)
    return b"%s-%s-%s %s:%s:%s:%s" % (year, month, day, hour, minute, second, milli)
