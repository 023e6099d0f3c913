"""Reads .gt3x files whole, for their tests."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Chunk, Problem, Reader
from accelcal_cli.formats.gt3x import FORMAT

Found = tuple[str, int | None, int, int]


def opened(path: Path, **options: object) -> Reader:
    return FORMAT.open(path, ReadOptions(**options))


def random_counts(rows: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).integers(-2048, 2048, (rows, 3)).astype(np.int16)


@dataclass(frozen=True)
class Whole:
    """All of a recording; problems as (code, byte offset, sample, count)."""

    chunks: list[Chunk]
    counts: np.ndarray
    times: np.ndarray
    validity: np.ndarray
    breaks: list[int]
    problems: list[Problem]

    @property
    def found(self) -> list[Found]:
        return [(p.code, p.byte_offset, p.sample, p.count) for p in self.problems]

    @property
    def measured(self) -> np.ndarray:
        return self.counts[self.validity == 0]

    def same(self, other: Whole) -> bool:
        columns = ("counts", "times", "validity")
        equal = all(np.array_equal(getattr(self, name), getattr(other, name)) for name in columns)
        return equal and (self.breaks, self.problems) == (other.breaks, other.problems)


def whole(path: Path, chunk_samples: int = 1000, **options: object) -> Whole:
    with opened(path, **options) as reader:
        return gathered(list(reader.chunks(chunk_samples)))


def gathered(chunks: list[Chunk]) -> Whole:
    assert [chunk.first_sample for chunk in chunks] == np.cumsum([0, *map(len, chunks)])[:-1].tolist()
    return Whole(
        chunks,
        np.concatenate([chunk.counts for chunk in chunks]),
        np.concatenate([chunk.clock.times(0, len(chunk)) for chunk in chunks]),
        np.concatenate([validity_of(chunk) for chunk in chunks]),
        [chunk.first_sample + row for chunk in chunks for row in chunk.breaks.tolist()],
        [problem for chunk in chunks for problem in chunk.problems],
    )


def validity_of(chunk: Chunk) -> np.ndarray:
    return np.zeros(len(chunk), np.uint8) if chunk.validity is None else chunk.validity
