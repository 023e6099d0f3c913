"""Everything that the reader of a recording gives, in one piece."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from accelcal_cli.core.formats import Format, ReadOptions
from accelcal_cli.core.recording import Chunk, Problem, Reader, Recording


@dataclass(frozen=True)
class Read:
    """All rows of a recording, with what is told of them."""

    recording: Recording
    counts: np.ndarray
    times: np.ndarray
    breaks: list[int]
    problems: list[Problem]
    temperature: np.ndarray | None
    gyro: np.ndarray | None
    validity: np.ndarray

    @property
    def g(self) -> np.ndarray:
        return self.counts / self.recording.lsb_per_g

    @property
    def codes(self) -> list[str]:
        return [problem.code for problem in self.problems]

    def same_as(self, other: Read) -> bool:
        names = ("counts", "times", "temperature", "gyro", "validity")
        pairs = [(getattr(self, name), getattr(other, name)) for name in names]
        alike = all(one is two or np.array_equal(one, two) for one, two in pairs)
        return alike and self.breaks == other.breaks and self.problems == other.problems


def read_all(path: Path, form: Format, chunk_samples: int, **options: Any) -> Read:
    with form.open(path, ReadOptions(**options)) as reader:
        chunks = list(reader.chunks(chunk_samples))
        assert max(map(len, chunks)) <= chunk_samples
        return joined(reader.recording, chunks)


def joined(recording: Recording, stream: Iterable[Chunk]) -> Read:
    chunks = list(stream)
    sizes = [len(chunk) for chunk in chunks]
    assert [chunk.first_sample for chunk in chunks] == [sum(sizes[:place]) for place in range(len(sizes))]
    warm = [chunk.temperature_mc for chunk in chunks]
    gyro = [chunk.gyro_counts for chunk in chunks]
    marks = [np.zeros(len(c), np.uint8) if c.validity is None else c.validity for c in chunks]
    return Read(
        recording,
        column(chunks),
        times(chunks),
        breaks(chunks),
        whole_problems(chunks),
        np.concatenate(warm) if recording.has_temperature else None,
        np.concatenate(gyro) if recording.gyro_dps_per_lsb else None,
        np.concatenate(marks),
    )


def rows(chunks: list[Chunk]) -> np.ndarray:
    return np.concatenate([np.empty((0, 3), np.int16), *(chunk.counts for chunk in chunks)])


def column(chunks: list[Chunk], name: str = "counts") -> np.ndarray:
    return np.concatenate([getattr(chunk, name) for chunk in chunks])


def times(chunks: list[Chunk]) -> np.ndarray:
    return np.concatenate([chunk.clock.times(0, len(chunk)) for chunk in chunks])


def breaks(chunks: list[Chunk]) -> list[int]:
    return [chunk.first_sample + int(row) for chunk in chunks for row in chunk.breaks]


def whole_problems(chunks: list[Chunk]) -> list[Problem]:
    return [problem for chunk in chunks for problem in chunk.problems]


def problems(chunks: list[Chunk]) -> list[tuple[str, int | None, int, int]]:
    """Codes, byte offsets, samples and counts."""
    return [(p.code, p.byte_offset, p.sample, p.count) for p in whole_problems(chunks)]


def told(chunks: list[Chunk]) -> list[tuple[str, int | None, int, int, int]]:
    """Codes, byte offsets, samples, counts and lost bytes."""
    lost = (p.lost_bytes for p in whole_problems(chunks))
    return [(*found, size) for found, size in zip(problems(chunks), lost, strict=True)]


def check_same(first: list[Chunk], *others: list[Chunk]) -> None:
    """Rows, times, breaks and problems do not depend on the size of the chunks."""
    for other in others:
        assert np.array_equal(rows(other), rows(first))
        assert np.array_equal(times(other), times(first))
        assert breaks(other) == breaks(first)
        assert whole_problems(other) == whole_problems(first)


def all_of(
    reader: Reader, chunk_samples: int = 1000
) -> tuple[np.ndarray, np.ndarray, list[int], list[Chunk]]:
    """Counts, times, numbers of the samples after breaks, and the chunks."""
    chunks = list(reader.chunks(chunk_samples))
    return column(chunks), times(chunks), breaks(chunks), chunks
