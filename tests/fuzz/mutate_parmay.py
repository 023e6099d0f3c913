"""Damaged Matrix files: fields of packets changed, and their checksums made right again."""

from __future__ import annotations

import struct
import zlib
from functools import cache, partial
from random import Random

import numpy as np

from accelcal_cli.core.formats import ReadOptions
from tests.formats import make_parmay
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

SUFFIX = ".BIN"
MAGIC = b"MDTCPACK"
ROWS = 80
JUMPS_S = (1, -1, 2, 5, 3600, -3600, 10**6, -(10**6), 10**9, -(10**9))
SIZES = (6, 6, 4, 4)


@cache
def recording() -> tuple[bytes, ...]:
    counts = np.random.RandomState(11).randint(-9000, 9000, (12 * ROWS, 3))
    made = []
    for k in range(12):
        rows, start = counts[ROWS * k : ROWS * (k + 1)], make_parmay.START_S + 4 * k
        gyro = (rows[::-1], None, rows[:40])[k % 3] if k > 5 else rows
        warm = ((281, 220),) * (k % 4)
        made.append(
            make_parmay.packet(start, start + 4, rows, gyro=gyro, warm=warm, heart=((0, 74),) * (k % 2))
        )
    return tuple(made)


def set_field(packet: bytes, form: str, at: int, value: int) -> bytes:
    """A field of a packet, with a checksum that is right again."""
    new = bytearray(packet)
    if len(new) >= 36:
        struct.pack_into(form, new, at, value)
    return make_parmay.sealed(bytes(new[12:]))


def jump(packets: Records, random: Random) -> None:
    where, by = stretch(packets, random, (1, 3, 1000)), random.choice(JUMPS_S)
    for at in range(where.start, where.stop):
        for place in random.choice([(12, 16), (12, 16), (12,), (16,)]):
            seconds = struct.unpack_from("<I", packets[at].ljust(36, b"\0"), place)[0]
            packets[at] = set_field(packets[at], "<I", place, (seconds + by) % (1 << 32))


def shorter(packets: Records, random: Random) -> None:
    at = random.randrange(len(packets))
    k = random.choice([0, 1, 2, 40])
    start = make_parmay.START_S + 4 * at
    rows = np.random.RandomState(k).randint(-9000, 9000, (k, 3))
    packets[at] = make_parmay.packet(start, start + random.choice([0, 1, 4]), rows)


def cut_short(packets: Records, random: Random) -> None:
    at = random.randrange(len(packets))
    size = random.choice([1, 7, 8, 30, 36, 100])
    packets[at] = random.choice(
        [packets[at][size:], packets[at][:-size], packets[at] + random.randbytes(size)]
    )


def junk(packets: Records, random: Random) -> None:
    packets.insert(
        random.randrange(len(packets) + 1),
        random.choice([MAGIC, MAGIC[:5], MAGIC * 20, bytes(36), b"\xff" * 700, random.randbytes(50)]),
    )


setter = partial(field_setter, set_field)
CHANGES: tuple[Change, ...] = (
    *(*ORDER, jump, jump, shorter, cut_short, junk, blank, broken),
    setter("start", "<I", 12, (0, (1 << 32) - 1), (1, 3, 1000)),
    setter("end", "<I", 16, (0, (1 << 32) - 1), (1, 3, 1000)),
    setter("samples", "<I", 20, (0, 1, 79, 81, 1 << 31)),
    setter("rotations", "<I", 24, (0, 1, 79, 81, 1 << 31)),
    setter("temperatures", "<I", 28, (0, 1, 2, 1 << 31)),
)


def mutant(random: Random) -> Mutant:
    head, packets = make_parmay.header(12), list(recording())
    options = ReadOptions()
    if random.random() < 0.2:
        data = blind(head + b"".join(packets), random)
        return Mutant(data, "blind", truth(data))
    what = changed(packets, random, CHANGES)
    if random.random() < 0.15:
        head = make_parmay.header(
            random.choice([0, 12, 13, 1 << 31]),
            range_g=random.choice([0, 2, 4, 16, 65_535]),
            range_dps=random.choice([0, 1, 65_535]),
        )
        what = f"{what} header"
        options = random.choice([options, ReadOptions(rate_hz=20.0), ReadOptions(lsb_per_g=4096.0)])
    data = head + b"".join(packets) + random.choice([b"", b"", b"\xff" * 900, bytes(100)])
    if random.random() < 0.1:
        what, data = f"{what} cut", data[: random.randrange(len(data))]
    return Mutant(data, what, truth(data) if options == ReadOptions() else None, options)


def truth(data: bytes) -> Truth | None:
    """Rows of the packets whose checksum is right and that no signature of another begins within."""
    if data[512:516] != b"MDTC" or len(data) < 524:
        return None
    range_g = struct.unpack_from("<H", data, 520)[0]
    if range_g not in (2, 4, 8, 16):
        return None
    starts = [at for at in range(524, len(data)) if data.startswith(MAGIC, at)]
    if not starts:
        return None
    parts, damaged, reached = [], 0, 524
    for at, follower in zip(starts, [*starts[1:], len(data)], strict=True):
        damaged += at > reached
        rows, end = packet_rows(data[at:follower])
        damaged += rows is None
        parts.append(np.empty((0, 3)) if rows is None else rows / (32_768 / range_g))
        reached = at + end
    rest = data[reached:]
    damaged += len(set(rest)) > 1
    rows = together(parts)
    return Truth(rows, rows, damaged)


def packet_rows(piece: bytes) -> tuple[np.ndarray | None, int]:
    """Counts of a packet, None if it is not sound; and how many of the bytes are its own."""
    if len(piece) < 36:
        return None, len(piece)
    crc, _, _, *numbers = struct.unpack_from("<7I", piece, 8)
    size = 36 + sum(number * each for number, each in zip(numbers, SIZES, strict=True))
    if size > min(len(piece), 1 << 20) or zlib.crc32(piece[12:size]) != crc:
        return None, len(piece)
    return np.frombuffer(piece, "<i2", 3 * numbers[0], 36).reshape(-1, 3), size
