"""Damaged sound files by omconvert: chunks, lines of metadata and samples changed."""

from __future__ import annotations

import struct
from functools import cache
from random import Random

import numpy as np

from accelcal_cli.core.formats import ReadOptions
from tests.formats import make_wav
from tests.fuzz.blind import blind
from tests.fuzz.mutant import ORDER, Change, Mutant, Records, Truth, changed, stretch

SUFFIX = ".wav"
LABELS = ("Accel-X", "Accel-Y", "Accel-Z", "Gyro-X", "Aux", "", "\x1b[31mX\x07", "Accel-X", "A" * 90)
SCALES = ("8", "16", "0", "-8", "nan", "1e9", "8.5", "", "999999")
LINES = (
    *(
        "Time: 9999-12-31 23:59:59.999\n",
        "Time: 0001-01-01 00:00:00\n",
        "Time: 2018-02-30 00:00:00\n",
        "Time:",
    ),
    *(
        "Time: 2018-03-18 17:24:47+05:00\n",
        "Channel-0: Accel-X\n",
        "Channel-99: Accel-Y\n",
        ":\n",
        "\xff\x80",
    ),
)


@cache
def recording() -> tuple[bytes, ...]:
    """Frames of which some were not measured, clipped, or hold a temperature."""
    random = np.random.RandomState(11)
    counts = random.randint(-9000, 9000, (900, 3))
    aux = random.choice([0] * 40 + [0x8000, 0x4000, 0x0C00 | 258, 0x0800 | 9, 0x0C00], 900)
    data = make_wav.samples(counts, aux)
    return tuple(data[at : at + 8] for at in range(0, len(data), 8))


def flags(frames: Records, random: Random) -> None:
    where = stretch(frames, random, (1, 3, 300))
    last = struct.pack("<H", random.choice([0x8000, 0xFFFF, 0x4000, 0x0C00 | random.getrandbits(10)]))
    frames[where] = [frame[:6] + last for frame in frames[where]]


def ends(frames: Records, random: Random) -> None:
    where = stretch(frames, random, (1, 20))
    value = struct.pack("<h", random.choice([-32_768, 32_767]))
    frames[where] = [value + frame[2:] for frame in frames[where]]


CHANGES: tuple[Change, ...] = (*ORDER, flags, flags, ends)


def header(data_bytes: int, random: Random) -> bytes:
    said = make_wav.comment(
        tuple(random.choice(LABELS) if random.random() < 0.1 else axis for axis in make_wav.AXES),
        tuple(random.choice(SCALES) if random.random() < 0.1 else 8 for _ in range(3)),
    )
    if random.random() < 0.3:
        said = random.choice(LINES) + said
    fmt = make_wav.form(
        random.choice([4, 4, 4, 3, 0, 7, 40]),
        random.choice([100, 100, 1, 0, 48_000, 1 << 20]),
        random.choice([16, 16, 16, 8, 0]),
        random.choice([1, 0xFFFE, 3]),
    )
    head = bytearray(make_wav.header(data_bytes, said=said, fmt=fmt))
    if random.random() < 0.3:
        at = random.choice([4, 16, 60, 64, 72, head.index(b"JUNK") + 4, 1020])
        struct.pack_into(
            "<I", head, at, random.choice([0, 1, data_bytes - 4, 1 << 31, (1 << 32) - 1]) % (1 << 32)
        )
    return bytes(head)


def mutant(random: Random) -> Mutant:
    frames = list(recording())
    if random.random() < 0.25:
        data = b"".join(frames)
        mutated = blind(make_wav.header(len(data)) + data, random)
        return Mutant(mutated, "blind", truth(mutated))
    what = changed(frames, random, CHANGES)
    body = b"".join(frames)
    head = make_wav.header(len(body))
    if random.random() < 0.5:
        head, what = header(len(body), random), f"{what} header"
    data = head + body + random.choice([b"", b"", b"", b"LIST\x04\0\0\0INFO", b"\0" * 13])
    if random.random() < 0.1:
        what, data = f"{what} cut", data[: random.randrange(len(data))]
    options = random.choice([ReadOptions()] * 4 + [ReadOptions(lsb_per_g=4096.0)])
    return Mutant(data, what, truth(data) if options == ReadOptions() else None, options)


def truth(data: bytes) -> Truth | None:
    """Rows of frames that were measured; None unless all but the sizes before them is as it should be."""
    usual = bytearray(make_wav.header(0))
    head = bytearray(data[:1024])
    if len(head) < 1024:
        return None
    announced = struct.unpack_from("<I", head, 1020)[0]
    for part in (usual, head):
        part[4:8] = part[1020:1024] = bytes(4)
    if head != usual or len(data) < 1024 + announced:
        return None
    values = np.frombuffer(data, "<i2", announced // 8 * 4, 1024).reshape(-1, 4)
    if len(data) > 1024 + announced and data[1024 + announced :] != b"LIST\x04\0\0\0INFO":
        return None
    found = values[values[:, 3] >= 0, :3] / make_wav.FULL
    return Truth(found, found)
