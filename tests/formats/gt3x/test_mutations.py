"""Thousands of damaged ActiGraph files: rows of the original or an error of ours, never anything else."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import AccelcalError
from accelcal_cli.core.recording import Validity
from tests.formats.gt3x.reading import Whole, gathered, opened
from tests.formats.make_gt3x import (
    ACTIVITY,
    ACTIVITY2,
    ASLEEP,
    AWAKE,
    LUX,
    START_S,
    activity,
    battery,
    encoded,
    event,
    info,
    parameters,
    record,
    written,
)

RATE = 30
LENGTH_S = 120
SLOWEST_S = 20.0
Mutation = Callable[[bytearray, np.random.Generator], None]


def place(data: bytearray, random: np.random.Generator) -> tuple[int, int]:
    begin = int(random.integers(len(data)))
    return begin, min(len(data), begin + int(random.integers(1, 2000)))


def flip(data: bytearray, random: np.random.Generator) -> None:
    data[place(data, random)[0]] ^= 1 << int(random.integers(8))


def remove(data: bytearray, random: np.random.Generator) -> None:
    begin, end = place(data, random)
    del data[begin:end]


def truncate(data: bytearray, random: np.random.Generator) -> None:
    del data[place(data, random)[0] :]


def repeat(data: bytearray, random: np.random.Generator) -> None:
    begin, end = place(data, random)
    data[begin:begin] = data[begin:end]


def blank(data: bytearray, random: np.random.Generator) -> None:
    begin, end = place(data, random)
    data[begin:end] = bytes([int(random.choice([0, 0x1E, 0xFF]))]) * (end - begin)


def noise(data: bytearray, random: np.random.Generator) -> None:
    begin, end = place(data, random)
    data[begin:end] = random.integers(0, 256, end - begin).astype(np.uint8).tobytes()


def exchange(data: bytearray, random: np.random.Generator) -> None:
    first, second = sorted(place(data, random)[0] for _ in range(2))
    size = min(300, second - first, len(data) - second)
    data[first : first + size], data[second : second + size] = (
        data[second : second + size],
        data[first : first + size],
    )


MUTATIONS: list[Mutation] = [flip, remove, truncate, repeat, blank, noise, exchange]


def recording(random: np.random.Generator, kind: int) -> tuple[bytes, dict[int, np.ndarray]]:
    """A log with sleep and other records; its samples by second."""
    log, second, rows = [parameters({(1, 10): RATE, (0, 55): encoded(256.0)})], START_S, {}
    while len(rows) < LENGTH_S:
        if rows and random.random() < 0.03:
            log += [event(second, ASLEEP), battery(second + 1), event(second + 20, AWAKE)]
            second += 20
        rows[second] = random.integers(-2048, 2048, (RATE, 3)).astype(np.int16)
        log += [activity(second, rows[second], kind)]
        log += [record(LUX, second, b"\1\0")] if random.random() < 0.3 else []
        second += 1
    return b"".join(log), rows


def read(path: Path) -> Whole | None:
    begin = time.process_time()
    try:
        with opened(path) as reader:
            found = gathered(reader, 100)
            assert found.same_as(gathered(reader, 10**9))
    except AccelcalError as error:
        assert path.name in str(error)
        return None
    finally:
        assert time.process_time() - begin < SLOWEST_S
    return found


def foreign_seconds(found: Whole, rows: dict[int, np.ndarray]) -> int:
    """How many seconds of measured rows are not those that were written."""
    measured = found.validity == Validity.MEASURED
    second, part = np.divmod(found.times[measured], 1_000_000)
    place = np.rint(part * RATE / 1e6).astype(int)
    blank = np.full((RATE, 3), 1 << 20)
    truth = np.stack([rows.get(int(at), blank) for at in np.unique(second)])
    right = (truth[np.unique(second, return_inverse=True)[1], place % RATE] == found.counts[measured]).all(
        axis=1
    )
    return len(np.unique(second[~right]))


def mutate(path: Path, seed: int, mutation: Mutation) -> int:
    """A damaged log in an undamaged zip file; gives seconds that are not of the original."""
    random = np.random.default_rng((seed, MUTATIONS.index(mutation)))
    log, rows = recording(random, (ACTIVITY, ACTIVITY2)[seed % 2])
    data = bytearray(log)
    for _ in range(int(random.integers(1, 4))):
        mutation(data, random)
        data += b"\0" * (not data)
    found = read(written(path, [bytes(data)], info(RATE)))
    if found is None:
        return 0
    lost = len(found.measured) < RATE * LENGTH_S
    assert found.problems or mutation is truncate or not lost
    return foreign_seconds(found, rows)


@pytest.mark.nightly
@pytest.mark.parametrize("mutation", MUTATIONS)
def test_damaged_logs(tmp_path: Path, mutation: Mutation) -> None:
    """None of these collides with the records' checksums of one byte."""
    assert sum(mutate(tmp_path / "a.gt3x", seed, mutation) for seed in range(6)) == 0


@pytest.mark.nightly
@pytest.mark.parametrize("mutation", MUTATIONS)
def test_many_damaged_logs(tmp_path: Path, mutation: Mutation) -> None:
    """A checksum of one byte misses one damaged record in 256; what is cut off is exact."""
    foreign = sum(mutate(tmp_path / "a.gt3x", seed, mutation) for seed in range(100, 500))
    assert foreign <= (0 if mutation in (truncate, flip) else 8)
