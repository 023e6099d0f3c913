"""Everything that the reader of a recording gives, in one piece."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from accelcal_cli.core.formats import Format, ReadOptions
from accelcal_cli.core.recording import Chunk, Problem, Recording


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
    """All of a recording, with the chunks joined."""
    with form.open(path, ReadOptions(**options)) as reader:
        chunks = list(reader.chunks(chunk_samples))
        assert max(map(len, chunks)) <= chunk_samples
        return joined(reader.recording, chunks)


def joined(recording: Recording, stream: Iterable[Chunk]) -> Read:
    """Chunks put together, each of which must follow the one before."""
    chunks = list(stream)
    sizes = [len(chunk) for chunk in chunks]
    assert [chunk.first_sample for chunk in chunks] == [sum(sizes[:place]) for place in range(len(sizes))]
    warm = [chunk.temperature_mc for chunk in chunks]
    gyro = [chunk.gyro_counts for chunk in chunks]
    marks = [np.zeros(len(c), np.uint8) if c.validity is None else c.validity for c in chunks]
    return Read(
        recording,
        np.concatenate([chunk.counts for chunk in chunks]),
        np.concatenate([chunk.clock.times(0, len(chunk)) for chunk in chunks]),
        [chunk.first_sample + int(row) for chunk in chunks for row in chunk.breaks],
        [problem for chunk in chunks for problem in chunk.problems],
        np.concatenate(warm) if recording.has_temperature else None,
        np.concatenate(gyro) if recording.gyro_dps_per_lsb else None,
        np.concatenate(marks),
    )
