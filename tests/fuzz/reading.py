"""Reads a damaged file in all ways, and holds what comes against the contract of readers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from accelcal_cli.core.errors import AccelcalError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Chunk, Problem, Reader, Validity
from accelcal_cli.core.settings import DEFAULT
from accelcal_cli.pipeline.facts import FactsObserver
from accelcal_cli.pipeline.procedures import make_method
from accelcal_cli.pipeline.survey import open_marked, survey
from tests.fuzz.mutant import Rows

CHUNK_SAMPLES = 300
OTHER_CHUNKS = (1, 7, 80, 777, 100_000)
MOST_CHUNKS = 20_000
"""A damaged file may claim a million rows: one by one they would take minutes, by our own counting."""

JUMP_PERIODS = 4.5
SHARED = "share a time stamp"
"""In the note of a file whose stamps are too coarse to tell rows apart."""

NOT_USED = "were not used"
"""How the note of a text file ends of which the first lines are left out."""


def checked(chunks: Iterator[Chunk], total_bytes: int) -> Iterator[Chunk]:
    """The chunks; AssertionError for one that breaks the contract."""
    sample = byte = 0
    for chunk in chunks:
        assert chunk.first_sample == sample, "rows do not go on"
        assert byte <= chunk.end_byte <= total_bytes, "progress goes back or beyond the file"
        check_columns(chunk)
        check_breaks(chunk)
        for problem in chunk.problems:
            check_problem(problem)
        assert chunk.used_bytes >= 0
        yield chunk
        sample, byte = sample + len(chunk), chunk.end_byte


def check_columns(chunk: Chunk) -> None:
    """Shapes and types."""
    rows = len(chunk)
    assert chunk.counts.shape == (rows, 3)
    assert chunk.counts.dtype in (np.int16, np.int32)
    for column, dtype in ((chunk.temperature_mc, np.int32), (chunk.validity, np.uint8)):
        assert column is None or (column.shape, column.dtype) == ((rows,), dtype)
    gyro = chunk.gyro_counts
    assert gyro is None or (gyro.shape == (rows, 3) and gyro.dtype in (np.int16, np.int32))


def check_breaks(chunk: Chunk) -> None:
    """Breaks ascend."""
    rows = len(chunk)
    assert chunk.breaks.shape == (len(chunk.breaks),)
    assert (np.diff(chunk.breaks) > 0).all()
    assert not len(chunk.breaks) or 0 <= chunk.breaks[0] <= chunk.breaks[-1] < rows
    assert chunk.first_sample != 0 or 0 not in chunk.breaks, "the first row cannot be a break"
    times = chunk.clock.times(0, rows)
    assert (times.shape, times.dtype) == ((rows,), np.int64)


def check_problem(problem: Problem) -> None:
    """A problem is of something, and has a text that any terminal can show."""
    assert problem.count >= 1 or problem.code == "truncated", problem
    assert problem.lost_bytes >= 0
    assert problem.sample >= 0


def check_jumps(chunks: list[Chunk], rate_hz: float) -> None:
    """Time goes on from row to row, save at breaks."""
    times = np.concatenate([chunk.clock.times(0, len(chunk)) for chunk in chunks])
    steps = np.diff(times)
    broken = np.zeros(len(times), np.bool_)
    for chunk in chunks:
        broken[chunk.first_sample + chunk.breaks] = True
    odd = (steps < 0) | (steps > JUMP_PERIODS * 1e6 / rate_hz + 1)
    untold = np.flatnonzero(odd & ~broken[1:])
    assert not len(untold), f"UNTOLD JUMP of {steps[untold[0]]} us before row {untold[0] + 1}"


def read(
    path: Path, options: ReadOptions, *, whole: bool = True, other_chunks: int = 0
) -> Rows | AccelcalError:
    """All rows of a file, or why it is refused.

    Args:
        whole: run the first pass of `calibrate`, and the preview, as well.
        other_chunks: read again with so many rows a chunk; 0 for not at all.

    Raises:
        AssertionError: a reader breaks its contract.
    """
    try:
        with open_marked(path, options) as reader:
            chunks = list(checked(reader.chunks(CHUNK_SAMPLES), reader.recording.total_bytes))
            rows = gathered(chunks, reader)
            if whole:
                look_round(reader)
            if other_chunks:
                same_in_other_chunks(reader, chunks, other_chunks)
            return rows
    except AccelcalError as error:
        assert str(path.with_suffix("")) in str(error), f"an error without the file's name: {error}"
        return error


def gathered(chunks: list[Chunk], reader: Reader) -> Rows:
    """The rows that the file holds, in g, and the problems."""
    recording = reader.recording
    assert recording.rate_hz > 0
    assert recording.lsb_per_g > 0
    if chunks and not any(SHARED in note for note in recording.notes):
        check_jumps(chunks, recording.rate_hz)
    own = [in_file(chunk, recording.zero_counts) for chunk in chunks]
    counts = np.concatenate([np.empty((0, 3), np.int32), *own])
    told = any(chunk.problems for chunk in chunks) or any(NOT_USED in note for note in recording.notes)
    return Rows(counts / recording.lsb_per_g, told, sum(map(len, chunks)))


def in_file(chunk: Chunk, zeros: tuple[int, int, int]) -> np.ndarray:
    """Counts of the rows that stand in the file, zeros that nothing measured among them."""
    if chunk.validity is None:
        return chunk.counts
    zero = ~chunk.counts.any(axis=1) | (chunk.counts == zeros).all(axis=1)
    return chunk.counts[(chunk.validity != Validity.FILLED) | zero]


def look_round(reader: Reader) -> None:
    """The first pass of a calibration, and a preview."""
    recording = reader.recording
    method = make_method(recording, DEFAULT)
    facts = FactsObserver(recording, method.rest_lsb)
    survey(reader.chunks(CHUNK_SAMPLES), method.segmenter, (facts, method.procedure))
    assert 0 <= facts.result().lost_percent() <= 100
    for chunk in reader.preview(64, 4):
        chunk.clock.times(0, len(chunk))


def same_in_other_chunks(reader: Reader, chunks: list[Chunk], size: int) -> None:
    """Rows with their times and marks, breaks and problems do not depend on the length of the chunks."""
    size = max(size, sum(map(len, chunks)) // MOST_CHUNKS)
    again = list(reader.chunks(size))
    one, two = columns(chunks), columns(again)
    for name, column in one.items():
        assert np.array_equal(column, two[name]), f"CHUNK SIZE {size} changes the {name}"
    told = [[problem for chunk in some for problem in chunk.problems] for some in (chunks, again)]
    assert told[0] == told[1], f"CHUNK SIZE {size} changes the problems"


def columns(chunks: list[Chunk]) -> dict[str, np.ndarray]:
    parts = {
        "counts": [chunk.counts.reshape(-1) for chunk in chunks],
        "times": [chunk.clock.times(0, len(chunk)) for chunk in chunks],
        "breaks": [chunk.breaks + chunk.first_sample for chunk in chunks],
        "temperatures": [c.temperature_mc for c in chunks if c.temperature_mc is not None],
        "rotation rates": [c.gyro_counts.reshape(-1) for c in chunks if c.gyro_counts is not None],
        "validity": [np.zeros(len(c), np.uint8) if c.validity is None else c.validity for c in chunks],
    }
    return {name: np.concatenate([np.empty(0, np.int64), *some]) for name, some in parts.items()}
