"""Damaged GENEActiv recordings: the lines of pages and of the header changed, pages put elsewhere."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from random import Random

import numpy as np

from accelcal_cli.core.formats import ReadOptions
from tests.formats import make_geneactiv
from tests.formats.make_geneactiv import Page
from tests.fuzz.blind import blind
from tests.fuzz.mutant import ORDER, Change, Mutant, Records, Truth, broken, changed, stretch, together

SUFFIX = ".bin"
SAMPLES = 300
LSB_PER_G = 256.0
"""By the gains of the header; without these if a user gives it."""

NUMBERS = (
    *("", "0", "-1", "0.0", "-25.0", "1e9", "999999", "0.000001", "50,0", "50.0 Hz", "nan", "inf", "0x10"),
    *("\x1b[31mX\x07", "\xff\xfe", "A" * 64, "A" * 65, "=cmd()", "\t\x0b", "50.0000001", "100.0", "49.9"),
)
TIMES = (
    *("2024-13-01 00:00:00:000", "2024-02-30 00:00:00:000", "2024-3-4 0:0:5:000", "2099-12-31 23:59:59:999"),
    *("2000-01-01 00:00:00:000", "1999-01-01 00:00:00:000", "2024-03-04 24:00:00:000", "", "9999-12-31"),
    *("2024-03-04 00:61:00:000", "2010-09-16 00:00:00:000", "2024-03-04T00:00:00:000"),
)
JUMPS_S = (1, -1, 12, -12, 3600, -3600, 86_400 * 400, -86_400 * 3000, 86_400 * 20_000)
PAGE_KEYS = (
    *("Device Unique Serial Code", "Sequence Number", "Temperature", "Battery voltage", "Device Status"),
    *("Unassigned", "Measurement Frequency"),
)
HEADER_KEYS = (
    *("Device Unique Serial Code", "Device Type", "Device Model", "Device Firmware Version", "Start Time"),
    *("Accelerometer Range", "Measurement Frequency", "Time Zone", "Config Time", "Extract Notes"),
    "Number of Pages",
)
SCALE_KEYS = ("x gain", "y gain", "z gain", "x offset", "y offset", "z offset")
HEADER_VALUES = (
    *(*NUMBERS, *TIMES, "-8 to 8", "-999999 to 999999", "-0 to 0", "GMT +14:59", "GMT +99:00", "GMT -00:00"),
    *("6400", "102400", "6399", "25601", "-25600", "clock drift -1e5s", "clock drift " + "9" * 50),
)
PAGE = re.compile(
    rb"Recorded Data\r?\nDevice Unique Serial Code:([^\r\n]{0,64})\r?\nSequence Number:(\d{1,10})\r?\n"
    rb"Page Time:(20\d\d-\d\d-\d\d \d\d:\d\d:\d\d:\d{3})\r?\nUnassigned:[^\r\n]{0,64}\r?\n"
    rb"Temperature:[^\r\n]{0,64}\r?\nBattery voltage:[^\r\n]{0,64}\r?\nDevice Status:[^\r\n]{0,64}\r?\n"
    rb"Measurement Frequency:([^\r\n]{0,64})\r?\n([0-9A-Fa-f]{3600})(?:\r?\n|\r?\Z)"
)
"""A page in which nothing is damaged."""

DIGITS = re.compile(rb"(?<=\n)[0-9A-Fa-f]{12,}")
GAIN, NO_GAIN = re.compile(rb"([xyz]) (gain|offset):(\S*)\r?\n"), b"Calibration Data"


@cache
def recording() -> tuple[bytes, tuple[Page, ...]]:
    counts = np.random.RandomState(11).randint(-500, 500, (5 * SAMPLES, 3))
    return make_geneactiv.header().replace(b"\n", b"\r\n"), tuple(make_geneactiv.pages(counts))


@cache
def sound_pages() -> tuple[bytes, ...]:
    return tuple(page.to_bytes().replace(b"\n", b"\r\n") for page in recording()[1])


def set_line(text: bytes, key: str, value: str) -> bytes:
    line = f"{key}:{value}".encode("latin-1")
    return re.sub(rf"(?m)^{key}:[^\r\n]*".encode(), lambda _: line, text, count=1)


def field(pages: Records, random: Random) -> None:
    where, key, value = stretch(pages, random, (1, 1, 1000)), random.choice(PAGE_KEYS), random.choice(NUMBERS)
    pages[where] = [set_line(page, key, value) for page in pages[where]]


def moment(pages: Records, random: Random) -> None:
    where, value = stretch(pages, random, (1, 1, 1000)), random.choice(TIMES)
    pages[where] = [set_line(page, "Page Time", value) for page in pages[where]]


def jump(pages: Records, random: Random) -> None:
    where, seconds = stretch(pages, random, (1, 3, 1000)), random.choice(JUMPS_S)
    first = make_geneactiv.START_US + seconds * 1_000_000
    for at in range(where.start, where.stop):
        when = make_geneactiv.stamp(first + at * SAMPLES * 20_000)
        pages[at] = set_line(pages[at], "Page Time", when)


def numbered(pages: Records, random: Random) -> None:
    where = stretch(pages, random, (1, 1, 1000))
    first = random.choice([0, 1 << 31, (1 << 32) - 1, 9_999_999_990, 10**6, 99_999_999_999])
    for at in range(where.start, where.stop):
        pages[at] = set_line(pages[at], "Sequence Number", str(first + at))


def written_again(pages: Records, random: Random) -> None:
    """A page with the text of one and the samples of another."""
    one, two = (random.choice(recording()[1]) for _ in range(2))
    new = replace(one, rows=two.rows, rate=random.choice(["50.0", "100.0", "25.0"]))
    pages.insert(random.randrange(len(pages)), new.to_bytes())


def samples(pages: Records, random: Random) -> None:
    """Too few digits, too many, or some that are none."""
    at, size = random.randrange(len(pages)), random.choice([1, 11, 12, 120, 1200, 3599, 3600])
    page = pages[at].rstrip(b"\r\n")
    place = max(0, len(page) - 1 - random.randrange(3600))
    odd = bytes([random.choice(b"gG xz\n\0-ff0")])
    spoilt = page[:place] + odd + page[place + 1 :]
    pages[at] = random.choice([page[:-size], page + b"0" * size, spoilt, page.lower()]) + b"\r\n"


def endings(pages: Records, random: Random) -> None:
    at = random.randrange(len(pages))
    pages[at] = random.choice(
        [
            pages[at].rstrip(b"\r\n"),
            *(pages[at].replace(b"\r\n", end) for end in (b"\n", b"\r", b"\r\r\n", b"\n\n")),
        ]
    )


def junk(pages: Records, random: Random) -> None:
    rubbish = (
        *(random.randbytes(700), bytes(512), b"Recorded Data\r\n", b"Recorded Data\r\n" * 200),
        *(b"0" * 5000 + b"\r\n", recording()[0]),
    )
    pages.insert(random.randrange(len(pages)), random.choice(rubbish))


CHANGES: tuple[Change, ...] = (
    *(*ORDER, field, field, moment, jump, jump, numbered, written_again, samples, endings, junk, broken),
)


def header(random: Random) -> bytes:
    text = recording()[0]
    for _ in range(random.randint(1, 2)):
        key = random.choice(HEADER_KEYS if random.random() < 0.7 else SCALE_KEYS)
        text = set_line(text, key, random.choice(HEADER_VALUES))
    form = random.randrange(8)
    if form == 0:
        lines = text.split(b"\r\n")
        random.shuffle(lines)
        text = b"\r\n".join(lines)
    if form == 1:
        text = text.replace(b"\r\n", b"\n")
    if form == 2:
        text += b"A:" + b"x" * random.choice([100, 70_000]) + b"\r\n"
    return text


def mutant(random: Random) -> Mutant:
    data, what = damaged(random)
    options = ReadOptions(lsb_per_g=LSB_PER_G if random.random() < 1 / 3 else None)
    return Mutant(data, what, truth(data, raw=options.lsb_per_g is not None), options)


def damaged(random: Random) -> tuple[bytes, str]:
    head, pages = recording()[0], list(sound_pages())
    if random.random() < 0.2:
        return blind(head + b"".join(pages), random), "blind"
    what = changed(pages, random, CHANGES)
    if random.random() < 0.35:
        head, what = header(random), f"{what} header"
    data = head + b"".join(pages)
    if random.random() < 0.1:
        what, data = f"{what} cut", data[: random.randrange(len(data))]
    return data, what


def truth(data: bytes, *, raw: bool) -> Truth | None:
    """Rows of whole pages, and of all lines of digits; None unless raw, or the header has the usual scale."""
    first = data.find(b"Recorded Data")
    if first < 0 or not (raw or calibration(data[:first]) == calibration(recording()[0])):
        return None
    pages = [match for match in PAGE.finditer(data) if is_time(match[3])]
    left_over = re.sub(rb"\s+", b"", PAGE.sub(b"", data[first:]))
    sure = together([line_rows(match[5]) for match in pages])
    return Truth(sure, together([line_rows(line) for line in DIGITS.findall(data)]), bool(left_over))


def calibration(text: bytes) -> dict[bytes, bytes]:
    """What the header's block of gains and offsets says."""
    block = text.partition(NO_GAIN)[2]
    return {axis + what: value for axis, what, value in GAIN.findall(block)}


def is_time(text: bytes) -> bool:
    try:
        np.datetime64(text[:19].decode().replace(" ", "T"), "s")
    except ValueError:
        return False
    return True


def line_rows(line: bytes) -> np.ndarray:
    """The samples of a line of digits, in g at the gain of the header and no offset."""
    octets = bytes.fromhex(line[: len(line) // 12 * 12].decode())
    six = np.frombuffer(octets, np.uint8).astype(np.int64).reshape(-1, 6)
    x, y = six[:, 0] << 4 | six[:, 1] >> 4, (six[:, 1] & 15) << 8 | six[:, 2]
    z = six[:, 3] << 4 | six[:, 4] >> 4
    return ((np.stack([x, y, z], axis=1) ^ 0x800) - 0x800) / LSB_PER_G
