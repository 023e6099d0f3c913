"""Damaged Axivity recordings: sectors whose fields are changed, and whose checksums are right again."""

from __future__ import annotations

import struct
from dataclasses import replace
from datetime import datetime, timedelta
from functools import cache, partial
from random import Random

import numpy as np

from tests.formats.make_cwa import EPOCH, FULL, header, packed_time, sectors, unpacked_time, with_checksum
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
    stretch,
    together,
)

SUFFIX = ".cwa"
SECTOR = 512
JUMPS_S = (1, -1, 2, -5, 60, -60, 3600, -3600, 86_400, -86_400 * 300, 86_400 * 7300, -86_400 * 3650, 10**9)
AT_COUNT, AT_AXES, AT_RATE, AT_STAMP, AT_SCALE = 28, 25, 24, 14, 18
VERY_LAST = datetime(2063, 12, 31, 23, 59, 59, tzinfo=EPOCH.tzinfo)


@cache
def counts(rows: int = 640) -> np.ndarray:
    return np.random.RandomState(11).randint(-500, 500, (rows, 3)).astype(np.int16)


@cache
def recordings() -> tuple[tuple[bytes, ...], ...]:
    """Header and sectors: plain, packed, with gyroscope, the oldest kind, and in whole seconds."""
    head = header()
    plain = [page.to_bytes() for page in sectors(counts())]
    gyro = [page.to_bytes() for page in sectors(np.hstack([counts(400)] * 2), axes=0x62, scale=0x0C)]
    packed = [packed_sector(page) for page in plain]
    old = [set_field(page, "<B", AT_RATE, 0, 26, 100) for page in plain]
    whole = [
        replace(page, time_us=page.time_us // 1_000_000 * 1_000_000, fractional=False).to_bytes()
        for page in sectors(np.vstack([counts()] * 3))
    ]
    return tuple((head[:SECTOR], head[SECTOR:], *pages) for pages in (plain, gyro, packed, old, whole))


def packed_sector(page: bytes) -> bytes:
    """The same, its numbers taken for packed samples."""
    return set_field(page, "<B", AT_AXES, 0x30)


def set_field(page: bytes, form: str, at: int, value: int, at_offset: int = 0, offset: int = 0) -> bytes:
    """A field of a sector, perhaps the offset as well, with a checksum that is right again."""
    new = bytearray(page)
    struct.pack_into(form, new, at, value)
    if at_offset:
        struct.pack_into("<h", new, at_offset, offset)
    return with_checksum(bytes(new))


def later(page: bytes, seconds: int) -> bytes:
    """A sector stamped so much later, within what its stamp can say."""
    try:
        when = unpacked_time(struct.unpack_from("<I", page, AT_STAMP)[0])
    except ValueError:
        return page
    moved = min(max(when + timedelta(seconds=seconds), datetime(2000, 1, 1, tzinfo=EPOCH.tzinfo)), VERY_LAST)
    return set_field(page, "<I", AT_STAMP, packed_time((moved - EPOCH) // timedelta(microseconds=1)))


def jump(pages: Records, random: Random) -> None:
    where, seconds = stretch(pages, random, (1, 3, 1000)), random.choice(JUMPS_S)
    pages[where] = [later(page, seconds) for page in pages[where]]


def numbered(pages: Records, random: Random) -> None:
    where = stretch(pages, random, (1, 1, 3, 1000))
    first = random.choice([0, (1 << 32) - 2, 1_000_000, random.getrandbits(32)])
    pages[where] = [set_field(page, "<I", 10, first + k & 0xFFFFFFFF) for k, page in enumerate(pages[where])]


def kind(pages: Records, random: Random) -> None:
    at = random.randrange(len(pages))
    name = random.choice([b"UB", b"SI", b"GX", b"GY", b"MD", b"\0\0", b"AX"])
    length = random.choice([508, 508, 0, 65_535])
    pages[at] = with_checksum(name + struct.pack("<H", length) + pages[at][4:])


def head_within(pages: Records, random: Random) -> None:
    at = random.randrange(len(pages))
    pages[at:at] = [header()[:SECTOR], header()[SECTOR:]]


def other_recording(pages: Records, random: Random) -> None:
    at, first = random.randrange(len(pages)), random.choice([0, 1000])
    new = counts()[:: -random.randint(1, 3)][:160]
    late = random.choice([0, 10**12, -(10**12)])
    own = sectors(new, session=9, time_us=1_709_510_400_000_000 + late)
    pages[at:at] = [set_field(page.to_bytes(), "<I", 10, first + k) for k, page in enumerate(own)]


setter = partial(field_setter, set_field)

CHANGES: tuple[Change, ...] = (
    *ORDER,
    jump,
    jump,
    numbered,
    blank,
    broken,
    kind,
    head_within,
    other_recording,
    setter("stamp", "<I", AT_STAMP, (0, 0xFFFFFFFF, 15 << 22, 0x3F << 6), (1, 2, 1000)),
    setter("offset", "<h", 26, (-32_768, 32_767, 0, -81, 79)),
    setter("fraction", "<H", 4, (0, 0x7FFF, 0x8000, 0xFFFF)),
    setter("session", "<I", 6, (0, 0xFFFFFFFF), (1, 1000)),
    setter("rate", "<B", AT_RATE, (0, 0x49, 0x4A, 0x47, 0xFF, 0x08, 0xC8, 0x88), (1, 1, 3, 1000)),
    setter("axes", "<B", AT_AXES, (0x30, 0x62, 0x92, 0, 0xFF, 0x31), (1, 1, 3)),
    setter("count", "<H", AT_COUNT, (0, 1, 40, 79, 81, 120, 65_535)),
    setter("scale", "<H", AT_SCALE, (0, 0x2000, 0xFFFF)),
    setter("temperature", "<H", 20, (0, 1023, 65_535), (1, 3)),
    setter("events", "<B", 22, (0, 0x10, 0x20, 0xFF)),
)


def mutant(random: Random) -> Mutant:
    head, more, *pages = random.choice(recordings()[:1] * 3 + recordings()[1:])
    if random.random() < 0.2:
        data = blind(b"".join([head, more, *pages]), random)
        return Mutant(data, "blind", truth(data))
    what = changed(pages, random, CHANGES)
    data = b"".join([head_of(head, random), more, *pages])
    if random.random() < 0.15:
        what, data = f"{what} whole", ends(data, random)
    return Mutant(data, what, truth(data))


def head_of(head: bytes, random: Random) -> bytes:
    new = bytearray(head)
    if random.random() < 0.2:
        at = random.choice([2, 4, 5, 7, 11, 35, 36, 41, random.randrange(SECTOR)])
        new[at] = random.choice([0, 0xFF, random.getrandbits(8)])
    return bytes(new)


def ends(data: bytes, random: Random) -> bytes:
    at, size = random.randrange(len(data)), random.choice([1, 13, 511, 512, 700])
    return random.choice(
        [
            data[:at],
            data[:at] + random.randbytes(size) + data[at:],
            data[:at] + data[at + size :],
            data[2 * SECTOR :],
            random.randbytes(2 * SECTOR) + data[2 * SECTOR :],
            data + b"\xff" * random.choice([100, 512, 5120]),
            data + data[2 * SECTOR :],
        ]
    )


def truth(data: bytes) -> Truth:
    """Rows of all sectors whose checksum is right, whatever their settings and wherever they begin.

    A sector of the oldest kind has none: nobody can tell whether it is sound.
    """
    place = data.find(b"AX\xfc\x01")
    parts = []
    while place >= 0:
        page = data[place : place + SECTOR]
        rows = sector_rows(page)
        if rows is not None:
            parts.append((place, rows))
        place = data.find(b"AX\xfc\x01", place + 1)
    proved = [rows for at, rows in parts if at % SECTOR == 0 and data[at + AT_RATE]]
    sound = {at for at, _ in parts}
    bad = sum(at not in sound and not unused(data[at : at + SECTOR]) for at in range(1024, len(data), SECTOR))
    return Truth(together(proved), together([rows for _, rows in parts]), bad)


def unused(page: bytes) -> bool:
    """Whether a sector has nothing to tell: blank, or of a kind without acceleration."""
    return page[:2] in (b"UB", b"SI", b"GY", b"GX") or (len(set(page)) == 1 and page[0] in (0, 0xFF))


def sector_rows(page: bytes) -> np.ndarray | None:
    """Acceleration in g of one sector, None if it is not sound."""
    if len(page) < SECTOR:
        return None
    rate, axes, _, count = struct.unpack_from("<BBhH", page, AT_RATE)
    if not 0 < count <= FULL.get(axes, 0):
        return None
    if rate and sum(struct.unpack("<256H", page)) & 0xFFFF:
        return None
    if axes == 0x30:
        words = np.frombuffer(page, "<u4", count, 30).astype(np.int64)
        ten = np.stack([words >> shift & 0x3FF for shift in (0, 10, 20)], axis=1)
        return ((ten ^ 0x200) - 0x200 << (words >> 30)[:, None]) / 256
    width = axes >> 4
    values = np.frombuffer(page, "<i2", count * width, 30).reshape(-1, width)
    scale = struct.unpack_from("<H", page, AT_SCALE)[0] >> 13
    return values[:, 0 if width == 3 else 3 :][:, :3] / float(256 << scale)
