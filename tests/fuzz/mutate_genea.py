"""Damaged GENEA files: slots changed, and their checksums made right again."""

from __future__ import annotations

from functools import cache
from random import Random

import numpy as np

from accelcal_cli.core.formats import ReadOptions
from tests.formats import make_genea
from tests.fuzz.blind import blind
from tests.fuzz.mutant import ORDER, Change, Mutant, Records, Truth, blank, broken, changed, stretch

SUFFIX = ".bin"
JUMPS_S = (1, -1, 2, 5, 3600, -3600, 10**6, -(10**6), 10**9, 1 << 31)
HARD = (
    "",
    "0",
    "nan",
    "-1",
    "1e9",
    "\x1b[31mX\x07",
    "99999999 1 1",
    "8192 8192 8192",
    "1 2 3",
    "0Hz",
    "9999Hz",
)


@cache
def recording() -> tuple[bytes, ...]:
    counts = np.random.RandomState(11).randint(-2000, 2000, (1200, 3))
    return tuple(make_genea.slots(counts, 80, ahead=30))


def jump(slots: Records, random: Random) -> None:
    where, by = stretch(slots, random, (1, 100, 300, 10_000)), random.choice(JUMPS_S)
    for at in range(where.start, where.stop):
        if len(slots[at]) == 6 and slots[at][1] >> 4 == 2:
            seconds = int.from_bytes(slots[at][2:], "big")
            slots[at] = make_genea.time((seconds + by) % (1 << 32))


def timeless(slots: Records, random: Random) -> None:
    where = stretch(slots, random, (100, 700, 10_000))
    slots[where] = [slot for slot in slots[where] if slot[1:2] < b"\x20" or slot[1:2] > b"\x2f"] or slots[
        where
    ]


def kinds(slots: Records, random: Random) -> None:
    at = random.randrange(len(slots))
    slots[at] = make_genea.slot(bytes([random.randrange(256)]) + random.randbytes(4))


def times(slots: Records, random: Random) -> None:
    at = random.randrange(len(slots))
    first = random.choice([0, make_genea.START_S, (1 << 32) - 300])
    slots[at:at] = [make_genea.time(first + k) for k in range(random.choice([1, 3, 200]))]


CHANGES: tuple[Change, ...] = (*ORDER, jump, jump, timeless, kinds, times, blank, broken, broken)


def mutant(random: Random) -> Mutant:
    head, slots = make_genea.header(), list(recording())
    if random.random() < 0.25:
        data = blind(head + make_genea.pages(slots), random)
        return Mutant(data, "blind", truth(data))
    what = changed(slots, random, CHANGES)
    body = make_genea.pages(slots) + random.choice([b"", b"\xff" * 6000, bytes(900)])
    if random.random() < 0.15:
        rate, gains, offsets = random.choices(HARD, k=3)
        head, what = make_genea.header(rate, gains, offsets, (random.choice(HARD),)), f"{what} header"
    if random.random() < 0.2:
        at, size = random.randrange(len(body)), random.choice([1, 6, 500, 2048, 5000])
        filling = random.choice([bytes(size), b"\xff" * size, random.randbytes(size)])
        what, body = f"{what} hole", body[:at] + filling + body[at + size :]
    data = head + body
    if random.random() < 0.1:
        what, data = f"{what} cut", data[: random.randrange(len(data))]
    options = random.choice([ReadOptions()] * 3 + [ReadOptions(rate_hz=80.0, lsb_per_g=340.0)])
    return Mutant(data, what, truth(data) if options == ReadOptions() else None, options)


def truth(data: bytes) -> Truth | None:
    """Rows of the slots whose checksum is right."""
    head = make_genea.header()
    if not data.startswith(head):
        return None
    pages = [data[at : at + 2046] for at in range(len(head), len(data), 2048)]
    slots = [page[at : at + 6] for page in pages for at in range(0, len(page) // 6 * 6, 6)]
    good = [bool(any(slot)) and make_genea.crc8(slot[1:]) == slot[0] for slot in slots]
    rows = [values(slot) for slot, right in zip(slots, good, strict=True) if right and slot[1] >> 4 == 0]
    written = [k for k, slot in enumerate(slots) if slot.strip(b"\0") and slot.strip(b"\xff")]
    damaged = sum(not right for right in good[: written[-1] + 1]) if written else 0
    found = np.array(rows, float).reshape(-1, 3) / 256
    return Truth(found, found, damaged)


def values(slot: bytes) -> tuple[int, int, int]:
    bits = int.from_bytes(slot[1:], "big")
    x, y, z = (((bits >> shift & 0xFFF) ^ 0x800) - 0x800 for shift in (24, 12, 0))
    return -x, y, -z
