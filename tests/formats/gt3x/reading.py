"""Reads .gt3x files whole, for their tests."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Chunk, Reader
from accelcal_cli.formats.gt3x import FORMAT
from tests.formats.reading import Read, joined, problems


def opened(path: Path, **options: object) -> Reader:
    return FORMAT.open(path, ReadOptions(**options))


def random_counts(rows: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).integers(-2048, 2048, (rows, 3)).astype(np.int16)


@dataclass(frozen=True)
class Whole(Read):
    """All of a recording, and its chunks."""

    chunks: list[Chunk]

    @property
    def found(self) -> list[tuple[str, int | None, int, int]]:
        return problems(self.chunks)

    @property
    def measured(self) -> np.ndarray:
        return self.counts[self.validity == 0]


def whole(path: Path, chunk_samples: int = 1000, **options: object) -> Whole:
    with opened(path, **options) as reader:
        return gathered(reader, chunk_samples)


def gathered(reader: Reader, chunk_samples: int) -> Whole:
    chunks = list(reader.chunks(chunk_samples))
    return Whole(**vars(joined(reader.recording, chunks)), chunks=chunks)
