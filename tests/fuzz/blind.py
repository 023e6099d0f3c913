"""Damage to bytes, without a thought for what they mean."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from random import Random


def blind(data: bytes, random: Random) -> bytes:
    for _ in range(random.randint(1, 4)):
        data = damaged(data, random)
    return data


def damaged(data: bytes, random: Random) -> bytes:
    """Bytes changed, a block removed, repeated, moved, zeroed or erased, or the end cut off."""
    if not data:
        return data
    at, other = (random.randrange(len(data)) for _ in range(2))
    size = random.choice([1, 2, 4, 8, 64, 512, random.randint(1, len(data))])
    if random.random() < 0.3:
        at = at // 512 * 512
    if random.random() < 0.2:
        at = min(at, random.randrange(2048))
    before, block, after = data[:at], data[at : at + size], data[at + size :]
    kinds = (
        lambda: before + bytes([data[at] ^ 1 << random.randrange(8)]) + data[at + 1 :],
        lambda: before + random.randbytes(len(block)) + after,
        lambda: before + after,
        lambda: before + block + block + after,
        lambda: before + data[other : other + len(block)] + after,
        lambda: before + bytes(len(block)) + after,
        lambda: before + b"\xff" * len(block) + after,
        lambda: before,
        lambda: before + data[other : other + size] + data[at:],
    )
    return random.choice(kinds)()


def replace_number(data: bytearray, at: int, numbers: Sequence[int], random: Random) -> None:
    """One of these numbers in eight bytes or four, or one bit, in place."""
    form = random.randrange(3)
    if form == 0:
        struct.pack_into("<Q", data, at, random.choice(numbers))
    if form == 1:
        struct.pack_into("<I", data, at, random.choice(numbers) & 0xFFFFFFFF)
    if form == 2:
        data[at] ^= 1 << random.randrange(8)
