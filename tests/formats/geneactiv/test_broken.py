"""GENEActiv files cut anywhere and changed anywhere: never more than the file holds, never a crash."""

from __future__ import annotations

import random
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import AccelcalError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Problem
from accelcal_cli.formats import open_recording
from tests.formats.geneactiv.test_geneactiv import joined, times_of
from tests.formats.make_geneactiv import header, pages, written
from tests.formats.reading import breaks

PAGES = 6
COUNTS = np.random.default_rng(8).integers(-2000, 2000, (300 * PAGES, 3))
HEAD = header(pages=PAGES)
OPTIONS = ReadOptions(format="geneactiv")


@dataclass(frozen=True)
class Outcome:
    """Rows (n, 3) as bytes of int32, the rest that was read, or the message of a refusal."""

    data: bytes = b""
    rest: tuple = ()
    problems: tuple[Problem, ...] = ()
    refused: str = ""

    @property
    def rows(self) -> np.ndarray:
        return np.frombuffer(self.data, np.int32).reshape(-1, 3)


def outcome(path: Path, chunk_samples: int) -> Outcome:
    try:
        with open_recording(path, OPTIONS) as reader:
            chunks = list(reader.chunks(chunk_samples))
            lasted = reader.recording.duration_s
            list(reader.preview(500, 3))
    except AccelcalError as error:
        assert str(path) in str(error)
        return Outcome(refused=str(error))
    assert lasted is None or lasted > 0
    rest = (times_of(chunks).tobytes(), joined(chunks, "temperature_mc").tobytes(), breaks(chunks))
    problems = tuple(problem for chunk in chunks for problem in chunk.problems)
    return Outcome(joined(chunks, "counts").astype(np.int32).tobytes(), rest, problems)


@pytest.fixture(
    scope="module", params=[b"\r\n", pytest.param(b"\n", marks=pytest.mark.nightly)], ids=["crlf", "lf"]
)
def whole(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("whole") / "a.bin"
    return written(path, pages(COUNTS), HEAD, request.param).read_bytes()


def check_cuts(path: Path, whole: bytes, ends: Iterable[int]) -> None:
    bodies = [found.end() for found in re.finditer(rb"Frequency:50.0\r?\n", whole)]
    for at in ends:
        path.write_bytes(whole[:at])
        seen = outcome(path, 700)
        expected = sum(min(max(0, at - begin), 3600) // 12 for begin in bodies)
        assert bool(seen.refused) == (expected == 0)
        assert (seen.rows == COUNTS[:expected]).all()
        told = [problem.code for problem in seen.problems]
        assert seen.refused or told == ["truncated"] * len(told)
        assert seen.refused or bool(told) == (expected < len(COUNTS))


def test_a_file_cut_anywhere_gives_all_samples_before_the_cut(whole: bytes, tmp_path: Path) -> None:
    near = range(len(whole) - 3, len(whole))
    check_cuts(tmp_path / "cut.bin", whole, [*range(1, 9000, 197), *range(8990, len(whole), 1977), *near])


@pytest.mark.nightly
def test_a_file_cut_at_every_byte_of_its_first_pages(whole: bytes, tmp_path: Path) -> None:
    anywhere = random.Random(2)
    ends = [*range(1, 9200), *(anywhere.randrange(9200, len(whole)) for _ in range(500))]
    check_cuts(tmp_path / "cut.bin", whole, ends)


def test_one_changed_byte_costs_one_page_at_most(whole: bytes, tmp_path: Path) -> None:
    path, pick = tmp_path / "changed.bin", random.Random(5)
    start = whole.index(b"Recorded Data")
    table = COUNTS.reshape(PAGES, 300, 3)
    for _ in range(40):
        at = pick.randrange(start, len(whole) - 2)
        path.write_bytes(whole[:at] + bytes([pick.randrange(256)]) + whole[at + 1 :])
        rows = outcome(path, 900).rows
        page = (at - start) * PAGES // (len(whole) - start)
        lost = len(rows) < len(COUNTS)
        kept = np.delete(table, [page] if lost else [], axis=0).reshape(-1, 3)
        assert rows.shape == kept.shape
        assert (rows != kept).any(axis=1).sum() <= 1
