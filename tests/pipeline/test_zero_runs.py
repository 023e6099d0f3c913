"""Runs of zeros, which no sensor measures, are rows filled by the device in every format."""

from __future__ import annotations

import copy
import importlib
from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import groupby
from math import ceil
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.clock import UniformClock, rate_fraction
from accelcal_cli.core.formats import Format, ReadOptions
from accelcal_cli.core.recording import Chunk, Problem, Recording, Validity, joined
from accelcal_cli.formats import all_formats
from accelcal_cli.pipeline.survey import MarkingIntake, ZeroRuns, open_marked
from tests.formats import make_edf, make_geneactiv, make_raw, make_unisens
from tests.recordings import directions, still_counts, write_csv

RATE_HZ = 50.0
LEAST = 25
"""Half a second."""

ABOUT = Recording(Path("a"), "raw", RATE_HZ, 256.0, 1)

CHUNK_SAMPLES = (1, 7, 300, 4096)


def with_zeros(runs: Iterable[tuple[int, int]], rows: int = 1200) -> np.ndarray:
    """Counts of a device that moves, with zeros from a row on, so many of them."""
    counts = np.random.RandomState(11).randint(-500, 500, (rows, 3)).astype(np.int16)
    counts[:, 2] |= 1  # no row is zero by chance
    for start, length in runs:
        counts[start : start + length] = 0
    return counts


def oracle(counts: np.ndarray, least: int) -> list[int]:
    """`validity` of rows, run by run."""
    marks: list[int] = []
    for zero, run in groupby(not any(row) for row in counts.tolist()):
        length = len([*run])
        marks += [1 if zero and length >= least else 0] * length
    return marks


RUNS = {
    "at the beginning": [(0, 25)],
    "at the end": [(1175, 25)],
    "one row short at both ends": [(0, 24), (1176, 24)],
    "across edges of chunks": [(290, 30), (595, 25), (899, 24)],
    "with rows between": [(100, 25), (126, 24), (151, 60)],
    "single rows": [(row, 1) for row in range(0, 1200, 2)],
    "all": [(0, 1200)],
}


@pytest.mark.parametrize("runs", RUNS.values(), ids=RUNS)
@pytest.mark.parametrize("size", [1, 7, 24, 25, 26, 300, 4096])
def test_runs_are_exact_wherever_chunks_end(runs: list[tuple[int, int]], size: int) -> None:
    counts = with_zeros(runs)
    chunks = [piece(counts, at, size) for at in range(0, len(counts), size)]
    marked = [*marks(ZeroRuns(ABOUT), chunks)]
    assert [chunk.first_sample for chunk in marked] == [chunk.first_sample for chunk in chunks]
    assert [chunk.problems for chunk in marked] == [chunk.problems for chunk in chunks]
    assert validity(marked) == oracle(counts, LEAST)
    if size == 4096 and not any(oracle(counts, LEAST)):
        assert marked == chunks, "nothing is copied where nothing is marked"


def piece(counts: np.ndarray, at: int, size: int) -> Chunk:
    rows = np.asfortranarray(counts[at : at + size])
    note = Problem("note", f"at {at}", None, at)
    return Chunk(at, rows, UniformClock(0, at, rate_fraction(RATE_HZ)), at + len(rows), problems=(note,))


def marks(zeros: ZeroRuns, chunks: Iterable[Chunk]) -> Iterable[Chunk]:
    for chunk in chunks:
        yield from zeros.add(chunk)
    yield from zeros.finish()


def validity(chunks: list[Chunk]) -> list[int]:
    return [
        flag
        for chunk in chunks
        for flag in ([0] * len(chunk) if chunk.validity is None else chunk.validity.tolist())
    ]


def test_other_marks_stay_and_empty_chunks_keep_their_places() -> None:
    chunk = piece(with_zeros([(10, 40)], 100), 0, 100)
    flags = np.zeros(100, np.uint8)
    flags[[5, 20, 60]] = Validity.RECOVERED, Validity.RECOVERED, Validity.CLIPPED
    first, rest = replace(chunk, validity=flags).part(0, 30), replace(chunk, validity=flags).part(30, 100)
    found = [*marks(ZeroRuns(ABOUT), [chunk.part(0, 0), first, first.part(30, 30), rest])]
    assert [len(one) for one in found] == [0, 30, 0, 70]
    whole = joined(found).validity
    assert whole is not None
    assert np.flatnonzero(whole == Validity.FILLED).tolist() == [*range(10, 20), *range(21, 50)]
    assert whole[[5, 20, 60]].tolist() == [3, 3, 2]


@pytest.mark.parametrize(("rate_hz", "least"), [(1.0, 3), (6.25, 4), (30.0, 15), (85.7, 43), (1000.0, 500)])
def test_a_run_counts_from_half_a_second_and_three_rows_on(rate_hz: float, least: int) -> None:
    for length, marked in ((least - 1, 0), (least, least)):
        counts = with_zeros([(3, length)], length + 10)
        found = [*marks(ZeroRuns(replace(ABOUT, rate_hz=rate_hz)), [piece(counts, 0, len(counts))])]
        assert sum(validity(found)) == marked


@pytest.mark.parametrize("item", all_formats(), ids=lambda item: item.name)
def test_verdicts_11_runs_of_zeros_are_filled(item: Format, tmp_path: Path) -> None:
    counts = with_zeros([(0, 30), (200, 24), (260, 1), (270, 100), (590, 26), (1175, 25)])
    made = importlib.import_module(f"tests.formats.make_{item.name}").make(tmp_path, counts, RATE_HZ, 256.0)
    expected = oracle(counts, LEAST)
    assert sum(expected) == 30 + 100 + 26 + 25
    if item.name == "genea":  # six zero bytes are an empty slot, which is no row
        expected, counts = [0] * (1200 - 206), counts[counts.any(axis=1)]
    with open_marked(made.path, made.options) as reader:
        for size in CHUNK_SAMPLES:
            for _pass in range(2):
                chunks = [*reader.chunks(size)]
                assert validity(chunks) == expected
                assert (
                    np.concatenate([chunk.counts for chunk in chunks]).any(axis=1) == counts.any(axis=1)
                ).all()
        pieces = [*reader.preview(200, 3)]
        assert all(len(chunk) < LEAST or has_marks(chunk) for chunk in pieces)


def has_marks(chunk: Chunk) -> bool:
    """Whether a piece alone is marked as its own zeros say."""
    return validity([chunk]) == oracle(chunk.counts, LEAST)


def test_free_fall_of_coarse_counts_is_measured(tmp_path: Path) -> None:
    """At 16 counts per g and 25 Hz, a drop of 0.44 s is eleven rows of zeros; a longer silence is none."""
    counts = still_counts(directions(20)) // 16 * 16
    counts[1000:1011] = 0
    counts[5000:5013] = 0
    with open_marked(write_csv(tmp_path / "a.csv", counts), ReadOptions()) as reader:
        found = validity([*reader.chunks(4096)])
    assert np.flatnonzero(found).tolist() == [*range(5000, 5013)]


def test_a_growing_recording_is_marked_as_the_whole_one_is(tmp_path: Path) -> None:
    counts = still_counts(directions(10))
    for start, length in ((0, 12), (700, 13), (2000, 900), (len(counts) - 14, 14)):
        counts[start : start + length] = 0
    path = write_csv(tmp_path / "a.csv", counts)
    data, found = path.read_bytes(), []
    with open_marked(path, ReadOptions()) as reader:
        intake = reader.intake()
        assert isinstance(intake, MarkingIntake)
        for at in range(0, len(data), 97):
            found += intake.take(data[at : at + 97], last=False)
            if at % 970 == 0:
                intake = copy.deepcopy(intake)
        found += intake.take(b"", last=True)
    assert validity(found) == oracle(counts, ceil(0.5 * 25))


def of_geneactiv(folder: Path, counts: np.ndarray) -> Path:
    """A device whose factory has found offsets."""
    head = make_geneactiv.header(offset=(250, -130, 77), pages=len(counts) // 300)
    return make_geneactiv.written(folder / "a.bin", make_geneactiv.pages(counts), head)


def of_unisens(folder: Path, counts: np.ndarray) -> Path:
    """Unsigned numbers around 2048."""
    about = make_unisens.signal("acc.bin", "acc", sampleRate=50, baseline=2048, lsbValue=1 / 256)
    numbers = np.where(counts.any(axis=1)[:, None], counts + 2048, 0)
    return make_unisens.folder(
        folder / "u", make_unisens.description(about), acc=numbers.astype("<i2").tobytes()
    )


def of_raw(folder: Path, counts: np.ndarray) -> Path:
    """A converter of 12 bits whose middle is 2048, of a sensor whose range is known."""
    path = make_raw.make(folder, counts, RATE_HZ, 256.0).path
    numbers = np.where(counts.any(axis=1)[:, None], counts + 2048, 0)
    path.write_bytes(b"HEADER" + numbers.astype("<u2").tobytes())
    layout = folder / "dump.layout.toml"
    layout.write_text(layout.read_text().replace('type = "int16"', 'type = "uint16", zero = 2048'))
    return path


def of_edf(folder: Path, counts: np.ndarray) -> Path:
    """A digital zero that is not 0 g."""
    path = make_edf.make(folder, counts, RATE_HZ, 256.0).path
    data = bytearray(path.read_bytes())
    at = 256 + 4 * (16 + 80 + 8)  # physical minimum and maximum of the four signals
    for signal in range(3):
        for place in (at + 8 * signal, at + 8 * (4 + signal)):
            shifted = float(data[place : place + 8]) + 0.125
            data[place : place + 8] = f"{shifted:g}".encode().ljust(8)
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("made", [of_geneactiv, of_unisens, of_raw, of_edf])
def test_zeros_of_the_file_are_zeros_whatever_their_counts(
    made: Callable[[Path, np.ndarray], Path], tmp_path: Path
) -> None:
    counts = with_zeros([(0, 30), (200, 24), (295, 40), (1100, 100)])
    with open_marked(made(tmp_path, counts), ReadOptions()) as reader:
        assert reader.recording.zero_counts != (0, 0, 0)
        for size in (7, 4096):
            found = np.array(validity([*reader.chunks(size)]))
            assert (found == Validity.FILLED).tolist() == [one == 1 for one in oracle(counts, LEAST)]
