"""Damaged Avro files of an EmbracePlus: values of arrays, numbers of the record, schema, packed data."""

from __future__ import annotations

import json
import struct
from functools import cache
from random import Random
from typing import Any

import numpy as np

from tests.formats import make_embraceplus as maker
from tests.formats.make_embraceplus import array, long, text
from tests.fuzz.blind import blind
from tests.fuzz.mutant import Mutant, Truth

SUFFIX = ".avro"
ROWS = 700
LSB_PER_G = 2048
NUMBERS = (0, 1, -1, 2**31 - 1, -(2**31), 2**62, -(2**63), 64, 1 << 40)
RATES = (0.0, 64.0, 1e-9, float("nan"), float("inf"), -64.0, 1e30, 100.0)
TYPES = ("int", "long", "float", "double", "null", "string", "bytes", "boolean", "nowhere", 5, None, [])


@cache
def counts() -> np.ndarray:
    return np.random.RandomState(12).randint(-4096, 4096, (ROWS, 3))


def columns(random: Random) -> tuple[list[list[int]], int]:
    """x, y and z, some of them changed, and how many values too many there are."""
    axes = counts().T.tolist()
    for _ in range(random.randint(0, 3)):
        axis, at = random.randrange(3), random.randrange(1, ROWS)
        kind = random.randrange(4)
        if kind == 0:
            axes[axis] = axes[axis][:at]
        elif kind == 1:
            axes[axis][at:at] = axes[axis][:at]
        elif kind == 2:
            axes[axis] = axes[axis][::-1]
        else:
            axes[axis] = axes[axis][at:] + axes[axis][:at]
    sizes = [len(axis) for axis in axes]
    return axes, max(sizes) - min(sizes)


def imu(axes: list[list[int]], random: Random, factor: float, rate: float, start: int) -> bytes:
    data = (
        long(start) + struct.pack("<f", rate) + b"".join(map(long, (0, 0, 0, 0))) + struct.pack("<d", factor)
    )
    block = random.choice([0, 1, 64, 999])
    return data + b"".join(array([long(value) for value in axis], block) for axis in axes)


def node(found: Any, random: Random) -> Any:
    found = json.loads(json.dumps(found))
    places: list[dict[str, Any]] = []

    def walk(item: Any) -> None:
        if isinstance(item, dict):
            places.append(item)
            for value in item.values():
                walk(value)
        elif isinstance(item, list):
            for value in item:
                walk(value)

    walk(found)
    place = random.choice(places)
    place[random.choice([*place])] = random.choice(TYPES)
    return found


def mutant(random: Random) -> Mutant:
    axes, spare = columns(random)
    kind, codec = random.random(), random.choice(["null", "deflate"])
    gyro = imu(random.choice([axes, [[], [], []]]), random, 0.0625, 64.0, maker.START_US)
    plain = imu(axes, random, 1 / LSB_PER_G, 64.0, maker.START_US)
    warm = [30.0 + number / 10 for number in range(ROWS // 64)]
    if kind < 0.35:
        data = maker.container(maker.session(plain, gyro, temperature=warm), maker.schema(True), codec)
        whole = min(map(len, axes))
        rows = np.array([axis[:whole] for axis in axes], float).T.reshape(-1, 3) / LSB_PER_G
        return Mutant(data, "values", Truth(rows, rows, int(spare > 0)))
    if kind < 0.6:
        factor = random.choice([1 / LSB_PER_G, *RATES])
        odd = imu(axes, random, factor, random.choice(RATES), random.choice([maker.START_US, *NUMBERS]))
        version = random.choice([(6, 5, 0), (6, 4, 0), (0, 0, 0)])
        body = maker.session(odd, gyro, version=version, temperature=warm, zone_s=random.choice(NUMBERS))
        return Mutant(maker.container(body, maker.schema(True), codec), "numbers")
    body = maker.session(plain, gyro, temperature=warm)
    if kind < 0.75:
        return Mutant(maker.container(body, node(maker.schema(True), random), codec), "schema")
    if kind < 0.9:
        at = random.randrange(len(body))
        change = random.choice(
            [long(random.choice(NUMBERS)), random.randbytes(3), text("x" * 50), b"\xff" * 12]
        )
        body = body[:at] + change + body[at + random.choice([0, len(change)]) :]
        return Mutant(maker.container(body, maker.schema(True), codec, random.choice([1, 1, 0, 2])), "body")
    return Mutant(blind(maker.container(body, maker.schema(True), codec), random), "blind")
