"""From the text of pages to samples, many pages at a time; pages that a file holds twice are left out.

The factory's gain and offset of each axis, which the header tells, give g = (raw * 100 - offset) / gain;
all three axes are put on one grid of whole counts, slope * raw - shift with one number of counts per g.
The counts are exact where that takes no more than 2**24 counts per g, as with equal gains; else the values
are rounded to a grid of 1 / 2**24 g, 0.03 micro-g at most. Source: Activinsights, GENEActiv instructions,
"Understanding .bin files".
"""

from __future__ import annotations

import re
from binascii import Error, unhexlify
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import gcd, lcm

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.recording import FLOAT_LSB_PER_G, Channels, Chunk, Counts, Problem, clipped_at
from accelcal_cli.formats._pages import pages as paged
from accelcal_cli.formats._pages.pages import Decoded, PageBlock
from accelcal_cli.formats._pages.reader import PageDecoder
from accelcal_cli.formats.geneactiv import scan
from accelcal_cli.formats.geneactiv.scan import Head, TextPages

REMEMBERED_PAGES = 1 << 15
"""Number of pages back that a page may repeat."""

BROKEN_OFF = "the compressed data is damaged or ends early"
MIXERS = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F], np.uint64)
"""Odd numbers without a pattern."""

RAW_VALUES = 1 << 12
RAW_LIMIT = RAW_VALUES // 2
"""Raw values are two's complement of 12 bits: -2048 to 2047."""

GAINS = (6_400, 102_400)
"""Hundredths of a count per g that are possible: ranges of 32 g down to 2 g over 12 bits."""

AXES = "xyz"
_WHOLE = re.compile(r"-?\d{1,9}")


@dataclass(frozen=True, slots=True)
class Factory:
    """The header's calibration block, x y z: g = (raw * 100 - offset) / gain."""

    gain: tuple[int, int, int]
    offset: tuple[int, int, int]

    @property
    def possible(self) -> bool:
        """Whether gains are those of a wrist-worn sensor and offsets below 1 g."""
        return all(
            GAINS[0] <= gain <= GAINS[1] and abs(offset) <= gain
            for gain, offset in zip(self.gain, self.offset, strict=True)
        )


def factory_of(measured: Mapping[str, str]) -> Factory | None:
    """The calibration in the lines of its block, None if a number is missing or impossible."""
    gains = [whole_number(measured.get(f"{axis} gain", "")) for axis in AXES]
    offsets = [whole_number(measured.get(f"{axis} offset", "")) for axis in AXES]
    known = [value for value in gains + offsets if value is not None]
    if len(known) < 2 * len(AXES):
        return None
    factory = Factory((known[0], known[1], known[2]), (known[3], known[4], known[5]))
    return factory if factory.possible else None


def whole_number(text: str) -> int | None:
    """A whole number; None if the text is not one."""
    return int(text) if _WHOLE.fullmatch(text) else None


@dataclass(frozen=True, slots=True, eq=False)
class Scale:
    """From raw values to counts.

    Attributes:
        lsb_per_g: counts in one g, of every axis.
        table: (3, 4096) counts of x, y, z by the raw value's 12 bits; int16 where they fit, else int32.
        exact: whether counts / lsb_per_g is what the factory's formula gives, without rounding.
        plain: whether counts are the raw values themselves.
    """

    lsb_per_g: float
    table: Counts
    exact: bool
    plain: bool

    @property
    def clipped(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Counts of each axis, (3,), at the low and at the high end of what the sensor can tell."""
        return self.table[:, RAW_LIMIT].astype(np.int64), self.table[:, RAW_LIMIT - 1].astype(np.int64)


def raw_scale(lsb_per_g: float) -> Scale:
    """Raw values as they are, for a scale that the user gives."""
    return _scale(lsb_per_g, _linear((1, 1, 1), (0, 0, 0)), exact=True)


def factory_scale(factory: Factory) -> Scale:
    """The factory's formula on the coarsest grid that holds it exactly, or on 2**24 counts per g."""
    slopes = [Fraction(100, gain) for gain in factory.gain]
    shifts = [Fraction(offset, gain) for offset, gain in zip(factory.offset, factory.gain, strict=True)]
    grid = lcm(*(number.denominator for number in slopes + shifts))
    whole = [int(number * grid) for number in slopes + shifts]
    common = gcd(*whole)
    lsb_per_g = Fraction(grid, common)
    if lsb_per_g > FLOAT_LSB_PER_G:
        return _scale(FLOAT_LSB_PER_G, _rounded(factory), exact=False)
    reduced = [number // common for number in whole]
    return _scale(float(lsb_per_g), _linear(reduced[:3], reduced[3:]), exact=True)


def _raw_values() -> NDArray[np.int64]:
    """The raw value of each pattern of 12 bits, (4096,)."""
    bits = np.arange(RAW_VALUES, dtype=np.int64)
    return np.where(bits < RAW_LIMIT, bits, bits - RAW_VALUES)


def _linear(slope: Sequence[int], shift: Sequence[int]) -> NDArray[np.int64]:
    """slope * raw - shift of each axis, (3, 4096)."""
    return _raw_values() * np.array(slope, np.int64)[:, None] - np.array(shift, np.int64)[:, None]


def _rounded(factory: Factory) -> NDArray[np.int64]:
    """Counts of 1 / 2**24 g, (3, 4096), rounded to the nearest; gains below 2**24 leave no halves."""
    gain = np.array(factory.gain, np.int64)[:, None]
    counts = _linear((100, 100, 100), factory.offset) * int(FLOAT_LSB_PER_G)
    return np.asarray((2 * counts + gain) // (2 * gain))


def _scale(lsb_per_g: float, table: NDArray[np.int64], *, exact: bool) -> Scale:
    narrow = np.abs(table).max() <= np.iinfo(np.int16).max
    stored: Counts = table.astype(np.int16) if narrow else table.astype(np.int32)
    return Scale(lsb_per_g, stored, exact, plain=bool((table == _raw_values()).all()))


class Repeats:
    """Knows a page again by its number, its time and its first and last sample.

    Args:
        remembered: how many pages back.
    """

    def __init__(self, remembered: int) -> None:
        self._remembered = remembered
        self._marks = np.empty(0, np.uint64)
        self._highest = -1

    def among(self, block: PageBlock) -> NDArray[np.bool_]:
        """Which pages of the next block were there before, (p,)."""
        again = np.zeros(len(block), np.bool_)
        if not len(block) or block.sequence is None:
            return again
        highest = np.maximum.accumulate(np.append(self._highest, block.sequence))
        known = np.append(self._marks, page_marks(block))
        for page in np.flatnonzero(block.sequence <= highest[:-1]).tolist():
            now = len(self._marks) + page
            again[page] = bool((known[max(0, now - self._remembered) : now] == known[now]).any())
        self._highest, self._marks = int(highest[-1]), known[-self._remembered :]
        return again


def page_marks(block: PageBlock) -> NDArray[np.uint64]:
    """A number for each page, (p,), that different pages hardly ever share."""
    assert block.sequence is not None and block.time_us is not None
    ends = np.cumsum(block.rows)
    shape = np.concatenate((block.counts[ends - block.rows], block.counts[ends - 1]), axis=1)
    marks = block.sequence.astype(np.uint64) * MIXERS[0] + block.time_us.astype(np.uint64)
    for axis in range(shape.shape[1]):
        marks = marks * MIXERS[1] + shape[:, axis].astype(np.int64).astype(np.uint64)
    return np.asarray(marks)


@dataclass(frozen=True, slots=True)
class Settings:
    """What all pages of a recording have in common.

    Attributes:
        serial: as it stands in the pages.
        rate: samples per second, as the pages state it.
    """

    serial: bytes
    rate: Fraction
    scale: Scale


class TextDecoder(PageDecoder[TextPages]):
    """Decodes pages in hexadecimal digits.

    Args:
        announced: number of pages by the header, 0 if it does not say.
    """

    def __init__(self, settings: Settings, announced: int = 0) -> None:
        self._settings = settings
        self._announced = announced
        self._repeats = Repeats(REMEMBERED_PAGES)
        self._highest = self._last_position = -1

    def decode(self, found: TextPages) -> Decoded:
        """See PageDecoder."""
        first_position = found.first_position
        status = np.array(found.status, np.uint8)
        places = np.flatnonzero(status == paged.GOOD)
        samples = unhexed(found.bodies)
        time_us = scan.stamps_us([head[2] for head in found.heads])
        verdict = self._verdict(found, time_us, all_digits=samples is not None)
        keep = np.flatnonzero(verdict == paged.GOOD)
        if samples is None or len(keep) < len(verdict):
            samples = unhexlify(b"".join(found.bodies[page] for page in keep.tolist()))
        block = replace(
            self._block(found, keep, samples, first_position + places[keep]), time_us=time_us[keep]
        )
        again = self._repeats.among(block)
        verdict[keep[again]] = paged.REPEATED
        status[places] = verdict
        if again.any():
            block = block.chosen(~again, np.repeat(~again, block.rows))
        if len(block) and block.sequence is not None:
            self._highest = max(self._highest, int(block.sequence.max()))
            self._last_position = int(block.position[-1])
        return Decoded(block, paged.bad_runs(status, first_position))

    def finish(self, chunk: Chunk) -> Chunk:
        """Mark rows that lie at the end of what the sensor can tell."""
        return clipped_at(chunk, *self._settings.scale.clipped)

    def ending(self, found: TextPages, chunk: Chunk) -> tuple[Problem, ...]:
        """See PageDecoder."""
        sample, cut_at = chunk.first_sample + len(chunk), found.cut_at
        problems = [Problem("truncated", BROKEN_OFF, found.end, sample)] if found.broken else []
        if cut_at is not None:
            missing = scan.SAMPLES - found.cut_samples
            text = f"the file ends within a page: {missing} of its {scan.SAMPLES} samples are missing"
            problems.append(Problem("truncated", text, cut_at, sample, missing))
        # damaged pages at the end, and one without a whole sample, are reported in another way
        damaged = found.next_position - 1 - self._last_position
        cut = cut_at is not None and found.cut_samples == 0
        lost = self._announced - (self._highest + 1) - damaged - cut
        if lost > 0:
            text = f"pages that the header announces are missing at the end of the file: {lost}"
            problems.append(Problem("truncated", text, found.end, sample, lost))
        return tuple(problems)

    def _verdict(
        self, found: TextPages, time_us: NDArray[np.int64], *, all_digits: bool
    ) -> NDArray[np.uint8]:
        """What each page is, (p,)."""
        verdict = np.full(len(time_us), paged.GOOD, np.uint8)
        rates = {head[4] for head in found.heads}
        other = {text for text in rates if scan.number(text) != self._settings.rate}
        if other:
            verdict[[head[4] in other for head in found.heads]] = paged.RATE
        verdict[[head[0] != self._settings.serial for head in found.heads]] = paged.FOREIGN
        verdict[time_us == scan.NO_STAMP] = paged.TEXT
        if not all_digits:
            verdict[[unhexed([body]) is None for body in found.bodies]] = paged.DIGITS
        return verdict

    def _block(
        self, found: TextPages, pages: NDArray[np.int64], samples: bytes, position: NDArray[np.int64]
    ) -> PageBlock:
        """Columns of these pages, but for their times."""
        heads = [found.heads[page] for page in pages.tolist()]
        rows = np.array([len(found.bodies[page]) // scan.SAMPLE_DIGITS for page in pages.tolist()], np.int64)
        return PageBlock(
            position=position,
            rows=rows,
            counts=counts(samples, self._settings.scale),
            sequence=np.array([int(head[1]) for head in heads], np.int64),
            channels={name: np.repeat(values, rows) for name, values in page_channels(heads).items()},
        )


def page_channels(heads: Sequence[Head]) -> Channels:
    """What the text of each page says beside its samples, (p,) each."""
    return {"temperature_mc": np.array([scan.temperature_mc(head[3]) for head in heads], np.int32)}


def unhexed(bodies: Sequence[bytes]) -> bytes | None:
    """What the hexadecimal digits of all bodies stand for; None if a character is no digit."""
    try:
        return unhexlify(b"".join(bodies))
    except Error:
        return None


def counts(samples: bytes, scale: Scale) -> Counts:
    """Counts (n, 3) of n samples of 6 bytes.

    A sample is, from the top, 12 bits each of x, y and z, 10 of light, the button and a spare bit.
    """
    high, middle, low = np.frombuffer(samples, ">u2").reshape(-1, 3).T.astype(np.uint16, order="C")
    bits = (high >> 4, (high << 8 & 0xF00) | middle >> 8, (middle << 4 & 0xFF0) | low >> 12)
    found = np.empty((len(high), 3), scale.table.dtype)
    for axis, pattern in enumerate(bits):
        if scale.plain:
            found[:, axis] = (pattern << 4).view(np.int16) >> 4
        else:
            found[:, axis] = scale.table[axis].take(pattern.astype(np.intp), mode="clip")
    return found
