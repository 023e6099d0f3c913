"""Reads GENEActiv recordings: what the head says, and pages of text decoded into counts."""

from __future__ import annotations

import re
from binascii import Error, unhexlify
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import lru_cache
from math import gcd, lcm
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, iso_time
from accelcal_cli.core.errors import COPY_AGAIN, UnreadableError
from accelcal_cli.core.formats import ReadOptions, agreed_rate, probe_file
from accelcal_cli.core.recording import (
    FLOAT_LSB_PER_G,
    Channels,
    Chunk,
    Counts,
    Device,
    OtherColumn,
    Others,
    Problem,
    Reader,
    Recording,
    clipped_at,
    first_row,
    no_others,
)
from accelcal_cli.core.written_times import header_zone
from accelcal_cli.formats._pages import pages as paged
from accelcal_cli.formats._pages.files import PageFile, ScannedPages
from accelcal_cli.formats._pages.pages import GOOD, LENGTH, NO_PAGE, TEXT, Decoded, PageBlock
from accelcal_cli.formats._pages.reader import BROKEN_OFF, PageDecoder, PagedReader, PageScheme
from accelcal_cli.formats._pages.timeline import CoarseTimeline, Spacing
from accelcal_cli.formats._rows import MISSING, first_values
from accelcal_cli.formats.geneactiv import HEADER_MAGIC, MARK, PAGE_HEAD

# Finds the pages in the text of a GENEActiv file, damaged or not, and decodes many at a time.
#
# The text of a page is nine lines of `key:value`, then 300 samples as one line of 3600 hexadecimal
# digits. Numbers have as many digits as they need, lines end in LF or CR LF, and the decimal sign may
# be a comma (as computers of some countries wrote it), so that pages differ in length. Pages that a
# file holds twice are left out.
#
# The factory's gain and offset of each axis, from the header, give g = (raw * 100 - offset) / gain;
# all three axes are put on one grid of whole counts, slope * raw - shift with one number of counts
# per g. The counts are exact where that takes no more than 2**24 counts per g, as with equal gains;
# else the values are rounded to a grid of 1 / 2**24 g, 0.03 micro-g at most. Source: Activinsights,
# GENEActiv instructions, "Understanding .bin files".
#
# Light is floor(level * Lux / Volts), of both numbers in the header (the same source).

SAMPLES, SAMPLE_DIGITS = 300, 12
BODY_DIGITS = SAMPLES * SAMPLE_DIGITS
USUAL_BYTES, LONGEST_BYTES = 3840, 4608
"""Usual length of a page, and the longest that the pattern of its text allows."""

SHORTEST_BYTES = BODY_DIGITS + 150

HEAD = re.compile(PAGE_HEAD)
_NUMBER = re.compile(rb"(-?\d{1,6}(?:[.,]\d{1,6})?)(?: Hz)?")
STAMP_BYTES, CARRIAGE_RETURN = 23, 13
NO_STAMP = int(np.iinfo(np.int64).min)
"""Stands for a time that does not exist, such as the 31st of February."""

_BLANK = re.compile(rb"\s+")
Head = tuple[bytes, ...]
"""Serial number, sequence number, time, temperature, voltage and rate of a page, as in its text."""


REMEMBERED_PAGES, MIXERS = 1 << 15, np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F], np.uint64)
"""Pages among which a repeated one is known, and odd numbers that mix what identifies a page."""

RAW_VALUES = 1 << 12
RAW_LIMIT = RAW_VALUES // 2
"""Raw values are two's complement of 12 bits: -2048 to 2047."""

GAINS = (6_400, 102_400)
"""Smallest and largest possible gain [0.01 counts per g]: ranges of 32 g and 2 g over 12 bits."""

AXES = "xyz"
LIGHT_LEVELS, LIGHT_BITS, BUTTON_BIT = 1 << 10, 2, 1
"""Levels of light, and the places of light and button in the last bits of a sample."""

BUTTON, BATTERY = OtherColumn("button", "1 while it is pressed"), OtherColumn("battery", "V")
_WHOLE = re.compile(r"-?\d{1,9}")


def number(text: bytes) -> Fraction | None:
    """Return a decimal number, with a point or a comma; None if the text is not one."""
    match = _NUMBER.fullmatch(text.strip())
    return Fraction(match[1].replace(b",", b".").decode("ascii")) if match else None


@lru_cache(maxsize=4096)
def temperature_mc(text: bytes) -> int:
    """Return a page's temperature [thousandths of a degree C], MISSING if it states none."""
    value = number(text)
    return MISSING if value is None else round(value * 1000)


def stamps_us(texts: Sequence[bytes]) -> NDArray[np.int64]:
    """Return page times that HEAD accepts [us since 1970], (p,); NO_STAMP for those that do not exist."""
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
    """Add leading zeros to a page time."""
    year, *numbers, milli = re.split(rb"[- :]", text)
    month, day, hour, minute, second = (part.zfill(2) for part in numbers)
    return b"%s-%s-%s %s:%s:%s:%s" % (year, month, day, hour, minute, second, milli)


@dataclass(slots=True)
class TextPages(ScannedPages):
    """Pages of a stretch of the file; the text and length of a GOOD one are right.

    Attributes:
        heads, bodies: of the GOOD ones. A body has 3600 characters; that of a page that the end of the file
            cuts off has fewer, those of its whole samples.
        cut_samples: whole samples of the page that the end of the file cuts off.
    """

    heads: list[Head] = field(default_factory=list)
    bodies: list[bytes] = field(default_factory=list)
    cut_samples: int = 0

    def page(self, offset: int, end: int, head: Head, body: bytes) -> None:
        """Add a GOOD page."""
        self.add(GOOD, offset, end)
        self.heads.append(head)
        self.bodies.append(body)


class TextScanner:
    """Finds the pages in the text of a file; see Scanner in `_pages/files.py`.

    Every page begins with a line of its own, at which the search continues after damage.

    Args:
        offset: where in the file the text begins.
        inside: it may begin within a page; what comes before the first one is passed over.
    """

    def __init__(self, offset: int, *, inside: bool = False) -> None:
        self._offset, self._rest, self._searching = offset, b"", inside
        self._bad: tuple[int, int] | None = None

    def feed(self, data: bytes, *, last: bool, stop: int | None = None) -> TextPages:
        """See Scanner; leaves out pages that begin at byte `stop` of the text or later."""
        text, found = self._rest + data, TextPages()
        end = len(text) if last else len(text) - LONGEST_BYTES + 1
        end = end if stop is None else min(end, stop)
        match, index = HEAD.match, 0
        while index < end:
            if self._searching:
                index = self._search(text, index, last=last)
                if not self._searching:
                    self._close(index, found)
                continue
            head = match(text, index)
            begin = len(text) if head is None else head.end()
            close = text.find(b"\n", begin, begin + BODY_DIGITS + 2)
            over = close - begin - BODY_DIGITS
            whole = over == 0 or (over == 1 and text[close - 1] == CARRIAGE_RETURN)
            if head is None or not whole:
                index = self._last(text, index, head, found) if last else self._other(text, index, head)
                continue
            digits = text[begin : begin + BODY_DIGITS]
            found.page(self._offset + index, self._offset + close + 1, head.groups(), digits)
            index = close + 1
        if last:
            self._close(index, found)
        self._rest, self._offset = text[index:], self._offset + index
        return found

    def _close(self, index: int, found: TextPages) -> None:
        """End a stretch of text that is not a page."""
        if self._bad is not None:
            found.add(*self._bad, self._offset + index)
        self._bad = None

    def _search(self, text: bytes, index: int, *, last: bool) -> int:
        """Return where the next page begins, or up to where none does."""
        place = text.find(MARK, index)
        self._searching = place < 0
        begun = 0 if last else len(MARK) - 1
        return max(index, len(text) - begun) if self._searching else place

    def _last(self, text: bytes, index: int, head: re.Match[bytes] | None, found: TextPages) -> int:
        """Take text that is not a whole page near the end of the file, which may have cut a page off."""
        if head is not None:
            digits = text[head.end() : head.end() + BODY_DIGITS + 2].removesuffix(b"\r")
            cut = len(digits) <= BODY_DIGITS and b"\n" not in digits
        else:
            begun = text.startswith(MARK, index) or MARK.startswith(text[index : index + len(MARK)])
            cut = begun and len(text) - index < SHORTEST_BYTES and text.find(MARK, index + 1) < 0
            digits = b""
        if not cut:
            return self._other(text, index, head)
        samples = len(digits) // SAMPLE_DIGITS
        if samples < SAMPLES:
            found.cut_at, found.cut_samples = self._offset + index, samples
        if head is not None and samples:
            begin, end = self._offset + index, self._offset + len(text)
            found.page(begin, end, head.groups(), digits[: samples * SAMPLE_DIGITS])
        return len(text)

    def _other(self, text: bytes, index: int, head: re.Match[bytes] | None) -> int:
        """Begin a stretch of text that is not a page; return where to continue."""
        blank = _BLANK.match(text, index)
        if blank:
            return blank.end()
        begun = text.startswith(MARK, index)
        self._bad = (NO_PAGE if not begun else TEXT if head is None else LENGTH), self._offset + index
        self._searching = True
        return index + len(MARK) if begun else index


@dataclass(frozen=True, slots=True)
class Factory:
    """The header's calibration block, x y z: g = (raw * 100 - offset) / gain."""

    gain: tuple[int, int, int]
    offset: tuple[int, int, int]


def factory_of(measured: Mapping[str, str]) -> Factory | None:
    """Return the calibration of the header; None without possible gains of a wrist, and offsets below 1 g."""
    names = [f"{axis} {what}" for what in ("gain", "offset") for axis in AXES]
    known = [value for name in names if (value := whole_number(measured.get(name, ""))) is not None]
    if len(known) < len(names):
        return None
    gains, offsets = (known[0], known[1], known[2]), (known[3], known[4], known[5])
    pairs = zip(gains, offsets, strict=True)
    possible = all(GAINS[0] <= gain <= GAINS[1] and abs(offset) <= gain for gain, offset in pairs)
    return Factory(gains, offsets) if possible else None


def whole_number(text: str) -> int | None:
    """Return a whole number, None if the text is not one."""
    return int(text) if _WHOLE.fullmatch(text) else None


@dataclass(frozen=True, slots=True, eq=False)
class Scale:
    """Converts raw values to counts.

    Attributes:
        lsb_per_g: counts in one g, of every axis.
        table: (3, 4096) counts of x, y, z by the raw value's 12 bits; int16 where they fit, else int32.
        exact: counts / lsb_per_g is what the factory's formula gives, without rounding.
        plain: counts are the raw values themselves.
    """

    lsb_per_g: float
    table: Counts
    exact: bool
    plain: bool

    @property
    def clipped(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Counts of each axis, (3,), at the low and the high end of the sensor's range."""
        return self.table[:, RAW_LIMIT].astype(np.int64), self.table[:, RAW_LIMIT - 1].astype(np.int64)


def raw_scale(lsb_per_g: float) -> Scale:
    """Return the scale that leaves raw values as they are, for counts per g that the user gives."""
    return _scale(lsb_per_g, _linear((1, 1, 1), (0, 0, 0)), exact=True)


def factory_scale(factory: Factory) -> Scale:
    """Put the factory's formula on the coarsest grid that holds it exactly, or on 2**24 counts per g."""
    slopes = [Fraction(100, gain) for gain in factory.gain]
    shifts = [Fraction(offset, gain) for offset, gain in zip(factory.offset, factory.gain, strict=True)]
    grid = lcm(*(number.denominator for number in slopes + shifts))
    whole = [int(number * grid) for number in slopes + shifts]
    common = gcd(*whole)
    lsb_per_g = Fraction(grid, common)
    if lsb_per_g > FLOAT_LSB_PER_G:  # rounded to the nearest; gains below 2**24 leave no halves
        gain = np.array(factory.gain, np.int64)[:, None]
        counts = _linear((100, 100, 100), factory.offset) * int(FLOAT_LSB_PER_G)
        return _scale(FLOAT_LSB_PER_G, (2 * counts + gain) // (2 * gain), exact=False)
    reduced = [number // common for number in whole]
    return _scale(float(lsb_per_g), _linear(reduced[:3], reduced[3:]), exact=True)


def _raw_values() -> NDArray[np.int64]:
    """Return the raw value of each pattern of 12 bits, (4096,)."""
    bits = np.arange(RAW_VALUES, dtype=np.int64)
    return np.where(bits < RAW_LIMIT, bits, bits - RAW_VALUES)


def _linear(slope: Sequence[int], shift: Sequence[int]) -> NDArray[np.int64]:
    """Return slope * raw - shift of each axis, (3, 4096)."""
    return _raw_values() * np.array(slope, np.int64)[:, None] - np.array(shift, np.int64)[:, None]


def _scale(lsb_per_g: float, table: NDArray[np.int64], *, exact: bool) -> Scale:
    narrow = np.abs(table).max() <= np.iinfo(np.int16).max
    stored: Counts = table.astype(np.int16) if narrow else table.astype(np.int32)
    return Scale(lsb_per_g, stored, exact, plain=bool((table == _raw_values()).all()))


@dataclass(frozen=True, slots=True, eq=False)
class Light:
    """The values (1024,) of the levels of light, in lux, or as they are where the header has no scale."""

    column: OtherColumn
    values: NDArray[np.float32]


def light_of(measured: Mapping[str, str]) -> Light:
    """Return what levels of light mean, by the calibration of the header."""
    lux, volts = (whole_number(measured.get(name, "")) for name in ("Lux", "Volts"))
    levels = np.arange(LIGHT_LEVELS)
    if lux is None or volts is None or lux <= 0 or volts <= 0:
        return Light(OtherColumn("light", "counts"), levels.astype(np.float32))
    return Light(OtherColumn("light", "lux"), (levels * lux // volts).astype(np.float32))


class Repeats:
    """Knows a page again by its number, its time and its first and last sample."""

    def __init__(self) -> None:
        self._marks = np.empty(0, np.uint64)
        self._highest = -1

    def among(self, block: PageBlock) -> NDArray[np.bool_]:
        """Mark the pages of the next block that were there before, (p,)."""
        again = np.zeros(len(block), np.bool_)
        if not len(block) or block.sequence is None:
            return again
        highest = np.maximum.accumulate(np.append(self._highest, block.sequence))
        known = np.append(self._marks, page_marks(block))
        # only a page whose number does not rise can be a repeated one
        for page in np.flatnonzero(block.sequence <= highest[:-1]).tolist():
            now = len(self._marks) + page
            again[page] = bool((known[max(0, now - REMEMBERED_PAGES) : now] == known[now]).any())
        self._highest, self._marks = int(highest[-1]), known[-REMEMBERED_PAGES:]
        return again


def page_marks(block: PageBlock) -> NDArray[np.uint64]:
    """Return a number for each page, (p,), that different pages hardly ever share."""
    assert block.sequence is not None and block.time_us is not None
    ends = np.cumsum(block.rows)
    shape = np.concatenate((block.counts[ends - block.rows], block.counts[ends - 1]), axis=1)
    marks = block.sequence.astype(np.uint64) * MIXERS[0] + block.time_us.astype(np.uint64)
    for axis in range(shape.shape[1]):
        marks = marks * MIXERS[1] + shape[:, axis].astype(np.int64).astype(np.uint64)
    return np.asarray(marks)


@dataclass(frozen=True, slots=True)
class Settings:
    """Properties that all pages of a recording share; serial number and rate [Hz] as they state them."""

    serial: bytes
    rate: Fraction
    scale: Scale
    light: Light


class TextDecoder(PageDecoder[TextPages]):
    """Decodes pages in hexadecimal digits, of which the header announces a number, or 0."""

    def __init__(self, settings: Settings, announced: int = 0) -> None:
        self._settings, self._announced = settings, announced
        self._repeats = Repeats()
        self._highest = self._last_position = -1

    def decode(self, found: TextPages) -> Decoded:
        """See PageDecoder."""
        first_position = found.first_position
        status = np.array(found.status, np.uint8)
        places = np.flatnonzero(status == GOOD)
        samples = unhexed(found.bodies)
        time_us = stamps_us([head[2] for head in found.heads])
        verdict = self._verdict(found, time_us, all_digits=samples is not None)
        keep = np.flatnonzero(verdict == GOOD)
        if samples is None or len(keep) < len(verdict):  # decode again, without the damaged pages
            samples = unhexlify(b"".join(found.bodies[page] for page in keep.tolist()))
        block = self._block(found, keep, samples, first_position + places[keep])
        block = replace(block, time_us=time_us[keep])
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
        """Mark rows that reach the end of the sensor's range."""
        return clipped_at(chunk, *self._settings.scale.clipped)

    def ending(self, found: TextPages, sample: int) -> tuple[Problem, ...]:
        """See PageDecoder."""
        cut_at = found.cut_at
        problems = [Problem("truncated", BROKEN_OFF, found.end, sample)] if found.broken else []
        if cut_at is not None:
            missing = SAMPLES - found.cut_samples
            text = f"the file ends within a page: {missing} of its {SAMPLES} samples are missing"
            problems.append(Problem("truncated", text, cut_at, sample, missing, 0, missing * SAMPLE_DIGITS))
        # damaged pages at the end, and one without a whole sample, are reported in another way
        damaged = found.next_position - 1 - self._last_position
        cut = cut_at is not None and found.cut_samples == 0
        lost = self._announced - (self._highest + 1) - damaged - cut
        if lost > 0:
            text = f"pages that the header announces are missing at the end of the file: {lost}"
            problems.append(Problem("truncated", text, found.end, sample, lost, 0, lost * USUAL_BYTES))
        return tuple(problems)

    def _verdict(
        self, found: TextPages, time_us: NDArray[np.int64], *, all_digits: bool
    ) -> NDArray[np.uint8]:
        """Return what each page is, GOOD or a key of BAD_KINDS, (p,)."""
        verdict = np.full(len(time_us), GOOD, np.uint8)
        rates = {head[5] for head in found.heads}
        other = {text for text in rates if number(text) != self._settings.rate}
        if other:
            verdict[[head[5] in other for head in found.heads]] = paged.RATE
        verdict[[head[0] != self._settings.serial for head in found.heads]] = paged.FOREIGN
        verdict[time_us == NO_STAMP] = TEXT
        if not all_digits:
            verdict[[unhexed([body]) is None for body in found.bodies]] = paged.DIGITS
        return verdict

    def _block(
        self, found: TextPages, pages: NDArray[np.int64], samples: bytes, position: NDArray[np.int64]
    ) -> PageBlock:
        """Return the columns of these pages, without their times."""
        heads = [found.heads[page] for page in pages.tolist()]
        rows = np.array([len(found.bodies[page]) // SAMPLE_DIGITS for page in pages.tolist()], np.int64)
        channels = {name: np.repeat(values, rows) for name, values in page_channels(heads).items()}
        if self.with_others:
            channels["others"] = others_of(samples, self._settings.light, heads, rows)
        return PageBlock(
            position=position,
            rows=rows,
            counts=counts_of(samples, self._settings.scale),
            sequence=np.array([int(head[1]) for head in heads], np.int64),
            channels=channels,
        )


def page_channels(heads: Sequence[Head]) -> Channels:
    """Return the channels that the text of pages holds, (p,) each."""
    return {"temperature_mc": np.array([temperature_mc(head[3]) for head in heads], np.int32)}


def unhexed(bodies: Sequence[bytes]) -> bytes | None:
    """Decode the hexadecimal digits of all bodies; return None if a character is not a digit."""
    try:
        return unhexlify(b"".join(bodies))
    except Error:
        return None


def counts_of(samples: bytes, scale: Scale) -> Counts:
    """Return counts (n, 3) of n samples of 6 bytes.

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


def others_of(samples: bytes, light: Light, heads: Sequence[Head], rows: NDArray[np.int64]) -> Others:
    """Return light and button of n samples of 6 bytes, and the voltage once a page, (n, 3)."""
    low = np.frombuffer(samples, ">u2")[2::3].astype(np.uint16)
    volts = [number(head[4]) for head in heads]
    others = no_others(len(low), 3)
    others[:, 0] = light.values[low >> LIGHT_BITS & LIGHT_LEVELS - 1]
    others[:, 1] = low >> BUTTON_BIT & 1
    others[np.cumsum(rows) - rows, 2] = [np.nan if one is None else float(one) for one in volts]
    return others


# Opens a GENEActiv .bin file: reads its header, and describes the recording.
#
# The properties that most of the first pages share describe the recording; pages that differ are left
# out.

PAGES, AGREEING = 64, 0.9
"""Pages that describe the recording, and share of them whose times must be multiples of a unit."""

UNITS_US = (1_000_000, 500_000)
"""Units of the pages' times [us]: whole seconds (model 1.2) or half seconds (model 1.1)."""

FINEST_US = 1_000
HALF_SECONDS, RATE_ROUNDING = 600, Fraction(1, 20)
"""At R Hz, a page lasts 600 / R half seconds; most by which its rate [Hz] is rounded."""

TAIL_BYTES = 1 << 16
"""Bytes at the end of the file in which the last page is looked for."""

USUAL_RANGE_G = 8.0
NO_START = "the device's clock was reset by an empty battery: its dates are not those of the recording"
HEADER_RESET = "the header's times are those of a device that was reset; the times are those of the pages"

CALIBRATION = "Calibration Data"
RESET_DATE = "2010-09-16"
"""Date to which an empty battery resets a device's clock; the header then has lost its times."""

NO_DEVICE = Device()
_PAGE_LINE = re.compile(
    MARK + rb"[ \t]*(?:[\r\n]|\Z)|(?:^|(?<=\r))(?:Sequence Number:|Page Time:|[0-9A-Fa-f]{256})", re.MULTILINE
)
"""The beginning of a page, or a line of one, whichever comes first. A damaged page is not a part of the
header, even if its lines end in carriage returns alone, or the end of the line before it is lost."""

_RANGE = re.compile(r"-\s*(\d+(?:\.\d+)?)\s*to\s*(\d+(?:\.\d+)?)")
_DRIFT = re.compile(r"clock drift (-?\d+(?:\.\d+)?) ?s")


@dataclass(frozen=True, slots=True)
class Header:
    """The header; a field is None if it is missing or impossible.

    Attributes:
        data_start: where the first page lies, bytes.
        rate: configured rate [Hz].
        range_g: the sensor clips at +- this.
        timezone: of the device's clock, `UTC` or such as `+01:00`; zone_notes: that it is not understood.
        factory: the calibration block.
        pages: the number that it announces.
        reset: its times are those of a device that was reset.
        light: what levels of light mean.
        drift_s: error of the device's clock that was noted at the download.
        missing: names of required fields that are None, for people.
    """

    data_start: int
    device: Device = NO_DEVICE
    rate: Fraction | None = None
    range_g: float | None = None
    timezone: str | None = None
    zone_notes: tuple[str, ...] = ()
    factory: Factory | None = None
    light: Light = field(default_factory=lambda: light_of({}))
    pages: int | None = None
    reset: bool = False
    drift_s: str | None = None
    missing: tuple[str, ...] = ()


def parse_header(head: bytes) -> Header:
    """Read the header from the file's first bytes."""
    match = _PAGE_LINE.search(head)
    end = match.start() if match else 0
    text = head[:end].decode("ascii", "replace")
    about, measured = _values(text), _values(text.rpartition(CALIBRATION)[2])
    factory = factory_of(measured)
    rate = number(about.get("Measurement Frequency", "").encode("ascii", "replace"))
    ends = _RANGE.search(about.get("Accelerometer Range", ""))  # such as -8 to 8, symmetric
    range_g = float(ends[2]) if ends and float(ends[1]) == float(ends[2]) > 0 else None
    serial = about.get("Device Unique Serial Code")
    zone, zone_notes = header_zone(about.get("Time Zone", ""))
    model = " ".join(about[key] for key in ("Device Type", "Device Model") if key in about)
    drift = _DRIFT.search(about.get("Extract Notes", ""))
    needed = {
        "serial number": serial,
        "measurement frequency": rate,
        "range": range_g,
        "calibration": factory,
    }
    return Header(
        data_start=end,
        device=Device(model or None, serial, about.get("Device Firmware Version")),
        rate=rate,
        range_g=range_g,
        timezone=zone,
        zone_notes=zone_notes,
        factory=factory,
        light=light_of(measured),
        pages=whole_number(measured.get("Number of Pages", "")),
        reset=any(about.get(key, "").startswith(RESET_DATE) for key in ("Config Time", "Start Time")),
        drift_s=drift[1] if drift else None,
        missing=tuple(name for name, value in needed.items() if value is None),
    )


def _values(text: str) -> dict[str, str]:
    """Return the first value of each key; empty values are left out."""
    values: dict[str, str] = {}
    for line in text.splitlines():
        key, _, value = line.partition(":")
        shown = "".join(letter for letter in value if letter.isprintable()).strip()
        if shown:
            values.setdefault(key.strip(), shown)
    return values


@dataclass(frozen=True, slots=True)
class FirstPages:
    """Properties that most of the first pages share.

    Attributes:
        serial: as in their text.
        rate: samples per second.
        sequence: number of the first page.
        missing: pages before it that are not in the file, by that number.
        unit_us: the coarsest unit [us] of which nearly all their times are multiples.
        first_values: first measured value of each channel, None if there is none.
    """

    serial: bytes
    rate: Fraction
    sequence: int
    missing: int
    unit_us: int
    first_values: dict[str, int | None]


def look_inside(file: PageFile[TextPages]) -> FirstPages | None:
    """Read on until a page is right; return None if there is none in the whole file."""
    with closing(file.blocks(file.amount(PAGES))) as blocks:
        for block in blocks:
            right = _right_pages(block)
            if right:
                return _common(right)
    return None


def _right_pages(found: TextPages) -> list[tuple[int, Head]]:
    """Return position and text of pages that make sense by themselves."""
    places = [place for place, kind in enumerate(found.status, found.first_position) if kind == GOOD]
    known = stamps_us([head[2] for head in found.heads]) != NO_STAMP
    pages = zip(places, found.heads, found.bodies, known.tolist(), strict=True)
    return [
        (place, head)
        for place, head, body, dated in pages
        if dated and (number(head[5]) or 0) > 0 and unhexed([body]) is not None
    ]


def _common(pages: Sequence[tuple[int, Head]]) -> FirstPages:
    stated = [(head[0], number(head[5])) for _, head in pages]
    serial, rate = Counter(stated).most_common(1)[0][0]
    place, first = pages[stated.index((serial, rate))]
    time_us = stamps_us([head[2] for _, head in pages])
    units = (unit for unit in UNITS_US if np.mean(time_us % unit == 0) >= AGREEING)
    return FirstPages(
        serial=serial,
        rate=rate or Fraction(1),
        sequence=int(first[1]),
        missing=max(0, int(first[1]) - place),
        unit_us=next(units, FINEST_US),
        first_values=first_values(page_channels([head for _, head in pages])),
    )


def true_rate(rate: Fraction) -> Fraction:
    """Return the true rate for the rounded figure in a page.

    A page of 300 samples lasts a whole number of half seconds: 3.5 s at what is called 85.7 Hz
    (600/7), 4.5 s at 66.7 Hz (200/3).
    """
    exact = Fraction(HALF_SECONDS, max(1, round(HALF_SECONDS / rate)))
    return exact if abs(exact - rate) <= RATE_ROUNDING else rate


@dataclass(frozen=True, slots=True)
class TextScheme(PageScheme[TextPages]):
    """Describes how the pages of one file are read, which have `settings` in common."""

    file: PageFile[TextPages]
    settings: Settings
    first_sequence: int

    def pieces(self, chunk_samples: int, pieces: int) -> Iterator[tuple[int, TextPages]]:
        """Enter at evenly spread bytes, each time up to the next page."""
        file = self.file
        if file.compressed:
            return
        spread = max(USUAL_BYTES, (file.size - file.start_byte) // max(1, pieces))
        length = min(spread, max(1, chunk_samples // SAMPLES) * USUAL_BYTES)
        for piece in range(pieces):
            block = piece_of(file, file.start_byte + piece * spread, length)
            page = max(0, int(block.heads[0][1]) - self.first_sequence) if block.heads else 0
            yield page * SAMPLES, block


def piece_of(file: PageFile[TextPages], offset: int, length: int) -> TextPages:
    """Return the pages that begin within `length` bytes from `offset` on, in an uncompressed file."""
    data = file.read(offset, length + LONGEST_BYTES)
    return TextScanner(offset, inside=True).feed(data, last=True, stop=length).alone(offset + len(data))


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a recording; `Format.open` says what is raised."""
    probe = probe_file(path, options)
    header = parse_header(probe.head)
    start, packed = header.data_start, probe.compressed
    file = PageFile(path, start, USUAL_BYTES, probe.size, packed, TextScanner, proved=False)
    first = look_inside(file)
    if first is None:
        known = probe.head.startswith(HEADER_MAGIC)
        what = "holds no intact page of samples" if known else "is not a GENEActiv .bin recording"
        raise UnreadableError(what, path=path, byte_offset=start, hint=COPY_AGAIN)
    settings = Settings(first.serial, first.rate, scale_of(header, options, path), header.light)
    spacing = Spacing(true_rate(first.rate), SAMPLES)
    scheme = TextScheme(
        file,
        spacing,
        decoder=lambda: TextDecoder(settings, header.pages or 0),
        timeline=lambda: CoarseTimeline(spacing, first.unit_us),
        settings=settings,
        first_sequence=first.sequence,
        first_values=first.first_values,
    )
    start_us = scheme.first_time_us()
    dated = not (iso_time(start_us, None) or "").startswith(RESET_DATE)
    scheme = replace(scheme, problems=problems_of(header, first, dated=dated))
    recording = describe(scheme, header, options, start_us if dated else None)
    return PagedReader(replace(recording, notes=notes(first, header, options)), scheme)


def problems_of(header: Header, first: FirstPages, *, dated: bool) -> tuple[Problem, ...]:
    """Return what is wrong before any page is read."""
    problems, start = [], header.data_start
    if header.missing:
        text = f"the header does not tell the device's {', '.join(header.missing)}"
        problems.append(Problem("damaged_header", text, 0, 0))
    if not dated:
        problems.append(Problem("no_start_time", NO_START, start, 0))
    if first.missing:
        text = f"pages missing before the first one by its sequence number: {first.missing}"
        problems.append(Problem("sequence_gap", text, start, 0, first.missing))
    return tuple(problems)


def scale_of(header: Header, options: ReadOptions, path: Path) -> Scale:
    """Return the user's counts per g for the raw values, else the factory's calibration, if there is one."""
    if options.lsb_per_g is not None:
        return raw_scale(options.lsb_per_g)
    if header.factory is None:
        usual = RAW_LIMIT / (header.range_g or USUAL_RANGE_G)
        hint = f"give --lsb-per-g to read the raw values (about {usual:g} by the sensor's range)"
        what = (
            "the factory's calibration (gain and offset of x, y and z) is missing from the header or damaged"
        )
        raise UnreadableError(what, path=path, byte_offset=0, hint=hint)
    return factory_scale(header.factory)


def describe(scheme: TextScheme, header: Header, options: ReadOptions, start_us: int | None) -> Recording:
    """Describe the recording, still without notes."""
    settings, file = scheme.settings, scheme.file
    serial = settings.serial.decode("ascii", "replace").strip()
    return Recording(
        path=file.path,
        format="geneactiv",
        rate_hz=agreed_rate(options, float(settings.rate), file.path),
        lsb_per_g=settings.scale.lsb_per_g,
        total_bytes=file.size,
        device=replace(header.device, serial=serial or header.device.serial),
        range_g=header.range_g,
        start_us=start_us,
        timezone=header.timezone,
        duration_s=duration_s(scheme, start_us),
        has_temperature=scheme.first_values["temperature_mc"] is not None,
        others=(settings.light.column, BUTTON, BATTERY),
        zero_counts=first_row(settings.scale.table.T),
    )


def notes(first: FirstPages, header: Header, options: ReadOptions) -> tuple[str, ...]:
    """Return notes for the user on how the file was understood."""
    texts = []
    serial = first.serial.decode("ascii", "replace").strip()
    if header.rate is not None and header.rate != first.rate:
        texts.append(f"the header says {float(header.rate):g} Hz, the pages {float(first.rate):g} Hz")
    if header.device.serial not in (None, serial):
        texts.append(f"the header names device {header.device.serial}, the pages {serial}")
    if options.lsb_per_g is not None:
        texts.append("--lsb-per-g was given: the factory's gain and offset were not applied")
    if header.reset:
        texts.append(HEADER_RESET)
    if header.drift_s is not None:
        texts.append(f"the header notes a clock drift of {header.drift_s} s; the times are the device's own")
    return (*texts, *header.zone_notes)


def duration_s(scheme: TextScheme, start_us: int | None) -> float | None:
    """Return the time from the first sample to the end of the last page [s], None if not found."""
    file = scheme.file
    if file.compressed or start_us is None:
        return None
    piece = piece_of(file, max(file.start_byte, file.size - TAIL_BYTES), TAIL_BYTES)
    last = TextDecoder(scheme.settings).decode(piece).block
    if not len(last) or last.time_us is None:
        return None
    lasted_us = int(last.time_us[-1]) - start_us + float(scheme.spacing.rows_us(last.rows[-1]))
    return lasted_us / MICROSECONDS if lasted_us > 0 else None
