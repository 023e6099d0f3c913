"""What the first pages of a file have in common."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from accelcal_cli.readers._geneactiv.decode import unhexed
from accelcal_cli.readers._geneactiv.page import NO_STAMP, number, stamps_us, temperature_mc
from accelcal_cli.readers._geneactiv.scan import Head
from accelcal_cli.readers._geneactiv.text import Part, TextFile
from accelcal_cli.readers._pages.pages import GOOD, NO_TEMPERATURE

PAGES = 64
UNITS_US = (1_000_000, 500_000)
"""Devices stamp their pages with whole seconds (model 1.2) or half ones (model 1.1)."""

FINEST_US = 1_000
AGREEING = 0.9
HALF_SECONDS = 600
RATE_ROUNDING = Fraction(1, 20)


@dataclass(frozen=True, slots=True)
class FirstPages:
    """What most of the first pages tell.

    Attributes:
        serial: as it stands there.
        rate: samples per second.
        sequence: number of the first one.
        missing: pages before it that are not in the file, by that number.
        unit_us: how coarse their times are [us].
        temperature_mc: the first one measured, or NO_TEMPERATURE.
    """

    serial: bytes
    rate: Fraction
    sequence: int
    missing: int
    unit_us: int
    temperature_mc: int


def look_inside(file: TextFile) -> FirstPages | None:
    """Read on until a page is right; None where there is none in the whole file."""
    with closing(file.parts(PAGES)) as parts:
        for part in parts:
            right = _right_pages(part)
            if right:
                return _common(right)
    return None


def _right_pages(part: Part) -> list[tuple[int, Head]]:
    """Place and text of pages that make sense by themselves."""
    found = part.found
    places = [place for place, kind in enumerate(found.status, part.first_position) if kind == GOOD]
    known = stamps_us([head[2] for head in found.heads]) != NO_STAMP
    pages = zip(places, found.heads, found.bodies, known.tolist(), strict=True)
    return [
        (place, head)
        for place, head, body, dated in pages
        if dated and (number(head[4]) or 0) > 0 and unhexed([body]) is not None
    ]


def _common(pages: Sequence[tuple[int, Head]]) -> FirstPages:
    told = [(head[0], number(head[4])) for _, head in pages]
    serial, rate = Counter(told).most_common(1)[0][0]
    place, first = pages[told.index((serial, rate))]
    warm = [temperature_mc(head[3]) for _, head in pages]
    return FirstPages(
        serial=serial,
        rate=rate or Fraction(1),
        sequence=int(first[1]),
        missing=max(0, int(first[1]) - place),
        unit_us=_unit_us([head[2] for _, head in pages]),
        temperature_mc=next((mc for mc in warm if mc != NO_TEMPERATURE), NO_TEMPERATURE),
    )


def _unit_us(stamps: Sequence[bytes]) -> int:
    """The coarsest unit of which nearly all stamps are multiples."""
    time_us = stamps_us(stamps)
    fits = (unit for unit in UNITS_US if np.mean(time_us % unit == 0) >= AGREEING)
    return next(fits, FINEST_US)


def true_rate(told: Fraction) -> Fraction:
    """The rate whose rounded figure a page tells.

    A page of 300 samples lasts a whole number of half seconds: 3.5 s at what is called 85.7 Hz
    (600/7), 4.5 s at 66.7 Hz (200/3).
    """
    exact = Fraction(HALF_SECONDS, max(1, round(HALF_SECONDS / told)))
    return exact if abs(exact - told) <= RATE_ROUNDING else told
