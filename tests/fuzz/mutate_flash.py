"""Damaged dumps in the flash page format: fields of pages changed, and their checksums made right again."""

from __future__ import annotations

import struct
import zlib
from fractions import Fraction
from functools import cache, partial
from random import Random

import numpy as np

from accelcal_cli.core.formats import ReadOptions
from tests.formats import make_flash
from tests.fuzz.blind import blind
from tests.fuzz.mutant import (
    ORDER,
    Change,
    Mutant,
    Records,
    Truth,
    blank,
    broken,
    changed,
    field_setter,
    flip,
    stretch,
    together,
)

SUFFIX = ".bin"
PAGE = 512
WORD = 1 << 32
JUMPS_S = (1, -1, 5, 3600, -3600, -(10**6), 10**8, -(10**9), 1 << 31)
AT_NUMBER, AT_SEQUENCE, AT_SECONDS, AT_MICROSECONDS = 4, 8, 12, 16
HARD_TEXTS = (b"\x1b[31mX\x07", b"\xff\xfe\x80abc", b"=1+1", b"a\nb\tc", b"", b"\xe2\x80\xae", b"S" * 32)
RATES = ((25, 1), (1, 1000), (100_000, 1), (WORD - 1, WORD - 1), (1, 999), (50, 1), (WORD - 1, 171_798_691))
SCALES = ((255, 1), (1, WORD - 1), (WORD - 1, 1), (WORD - 1, 16_777_215), (0, 1), (1, 0), (1, 1))


@cache
def recording() -> tuple[bytes, ...]:
    counts = np.random.RandomState(11).randint(-500, 500, (640, 3)).astype(np.int16)
    return (make_flash.header(), *make_flash.pages(counts))


def set_field(page: bytes, form: str, at: int, value: int) -> bytes:
    """A field of a page, with a checksum that is right again."""
    new = bytearray(page[:508])
    struct.pack_into(form, new, at, value)
    return make_flash.sealed(bytes(new))


def number(random: Random) -> int:
    return random.choice(
        [0, 1, WORD // 2 - 1, WORD // 2, WORD - 1, random.getrandbits(32), random.getrandbits(16)]
    )


def jump(pages: Records, random: Random) -> None:
    where, by = stretch(pages, random, (1, 3, 1000)), random.choice(JUMPS_S)
    for at in range(where.start, where.stop):
        seconds = struct.unpack_from("<I", pages[at], AT_SECONDS)[0]
        pages[at] = set_field(pages[at], "<I", AT_SECONDS, (seconds + by) % WORD)


def numbered(pages: Records, random: Random) -> None:
    where, first = stretch(pages, random, (1, 1, 3, 1000)), number(random)
    for at in range(where.start, where.stop):
        pages[at] = set_field(pages[at], "<I", AT_SEQUENCE, (first + at) % WORD)


def head_within(pages: Records, random: Random) -> None:
    pages.insert(random.randrange(len(pages)), recording()[0])


setter = partial(field_setter, set_field)

CHANGES: tuple[Change, ...] = (
    *ORDER,
    jump,
    jump,
    numbered,
    blank,
    broken,
    head_within,
    setter("recording", "<I", AT_NUMBER, (0, 7, WORD - 1), (1, 3)),
    setter("seconds", "<I", AT_SECONDS, (0, WORD - 1, WORD // 2), (1, 3, 1000)),
    setter("microseconds", "<I", AT_MICROSECONDS, (0, 999_999, 1_000_000)),
    setter("temperature", "<h", 20, (-32_768, 32_767, 0), (1, 3, 1000)),
    setter("samples", "<H", 22, (0, 1, 79, 80, 81, 65_535, 40), (1, 3)),
    setter("flags", "<I", 24, (0, 1, WORD - 1), (1, 3)),
)


def header(random: Random) -> bytes:
    flags, zone = random.choice([0, 1, 2, 3]), random.choice([-32_768, 0, 60, 840, 841, -900])
    rate = random.choice(RATES) if random.random() < 0.3 else None
    page = make_flash.header(flags=flags, zone=zone, rate=rate)
    new = bytearray(page[:508])
    if random.random() < 0.3:
        struct.pack_into("<II", new, 24, *random.choice([*SCALES, (number(random), number(random))]))
    if random.random() < 0.3:
        struct.pack_into("<I", new, 32, number(random))
    if random.random() < 0.3:
        at = random.choice([44, 76, 108])
        new[at : at + 32] = random.choice(HARD_TEXTS).ljust(32, b"\0")
    if random.random() < 0.2:
        new[random.randrange(140)] = random.getrandbits(8)
    sealed = make_flash.sealed(bytes(new))
    return sealed if random.random() < 0.8 else flip(sealed, random)


def mutant(random: Random) -> Mutant:
    head, *pages = recording()
    if random.random() < 0.2:
        data = blind(b"".join([head, *pages]), random)
        return Mutant(data, "blind", truth(data))
    what = changed(pages, random, CHANGES)
    options = ReadOptions()
    if random.random() < 0.3:
        head, what = header(random), f"{what} header"
        options = random.choice([options, options, ReadOptions(rate_hz=100.0, lsb_per_g=256.0)])
    data = b"".join([head, *pages]) + random.choice([b"", b"", b"\xff" * 1024, b"\xff" * 100])
    if random.random() < 0.1:
        what, data = f"{what} cut", data[: random.randrange(len(data))]
    if random.random() < 0.05:
        at = random.randrange(len(data))
        what, data = f"{what} inserted", data[:at] + random.randbytes(random.choice([1, 13, 512])) + data[at:]
    return Mutant(data, what, None if options.rate_hz else truth(data), options)


def truth(data: bytes) -> Truth | None:
    """Rows of the pages of the header's recording whose checksums are right, from the table of the format."""
    if len(data) < PAGE or zlib.crc32(data[:508]) != int.from_bytes(data[508:PAGE], "little"):
        return None
    own, numerator, denominator = (struct.unpack_from("<I", data, at)[0] for at in (12, 24, 28))
    if not numerator or not denominator:
        return None
    scale = float(Fraction(numerator, denominator))
    pages = [data[at : at + PAGE] for at in range(PAGE, len(data), PAGE)]
    parts = [page_rows(page, own) for page in pages]
    rows = together([part / scale for part in parts if part is not None])
    bad = sum(part is None and bool(page.strip(b"\xff")) for page, part in zip(pages, parts, strict=True))
    return Truth(rows, rows, bad)


def page_rows(page: bytes, own: int) -> np.ndarray | None:
    if len(page) < PAGE:
        return None
    magic, recording, _, _, microseconds, _, count, _ = struct.unpack_from("<4sIIIIhHI", page)
    if magic != b"ACLP" or recording != own or not 1 <= count <= 80 or microseconds >= 1_000_000:
        return None
    if zlib.crc32(page[:508]) != int.from_bytes(page[508:], "little"):
        return None
    return np.frombuffer(page, "<i2", 3 * count, 28).reshape(-1, 3)
