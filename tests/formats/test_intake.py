"""Recordings that are read while they grow: in whatever pieces, the rows are those of the whole file."""

from __future__ import annotations

import copy
import gzip
from pathlib import Path
from random import Random

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Chunk, joined
from accelcal_cli.formats import all_encoders
from accelcal_cli.pipeline.survey import open_marked
from tests.cli.run import exit_code
from tests.formats import make_edf, make_genea, make_geneactiv, make_parmay, make_wav
from tests.recordings import LSB_PER_G, directions, still_counts, write_csv

STREAMED = ("ax6", "csv", "cwa", "edf", "flash", "genea", "geneactiv", "parmay", "raw", "wav")
COLUMNS = ("counts", "time_us", "breaks", "clock_jumps", "temperature_mc", "gyro_counts", "validity")


@pytest.fixture(scope="session")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("growing")
    found = {}
    for encoder in all_encoders():
        path = folder / f"{encoder.name}{encoder.suffix.removesuffix('.gz')}"
        words = ("--format", encoder.name, "--days", "0.02", "--rate", "50", "--seed", "3", "-q")
        if encoder.name == "csv":
            write_csv(path, still_counts(directions(20)))
        else:
            assert exit_code("simulate", path, *words) == 0
        found[encoder.name] = path
    path = found["ax6"] = folder / "ax6.cwa"
    words = ("--format", "cwa", "--gyro", "--days", "0.02", "--rate", "50", "--seed", "3", "-q")
    assert exit_code("simulate", path, *words) == 0
    for maker in (make_edf, make_genea, make_parmay, make_wav):
        name = maker.__name__.rpartition("_")[2]
        (folder / name).mkdir()
        lsb_per_g = {"edf": 256.0, "genea": 256.0, "parmay": 4096.0, "wav": 4096.0}[name]
        counts = still_counts(directions(20)).astype(np.int64) * round(lsb_per_g / LSB_PER_G)
        found[name] = maker.make(folder / name, counts, 25.0, lsb_per_g).path
    return found


def pieces(data: bytes, random: Random, longest: int) -> list[bytes]:
    found = []
    while data:
        size = random.randint(1, longest)
        found.append(data[:size])
        data = data[size:]
    return found


def grown(path: Path, data: bytes, random: Random) -> Chunk:
    """The rows of a recording that grows; on the way one of two copies ends, the other goes on."""
    chunks: list[Chunk] = []
    with open_marked(path, ReadOptions()) as reader:
        intake = reader.intake()
        for piece in pieces(data, random, 30_000):
            chunks += intake.take(piece, last=False)
            if random.random() < 0.2:
                ended, intake = random.sample((intake, copy.deepcopy(intake)), 2)
                list(ended.take(b"", last=True))
        chunks += intake.take(b"", last=True)
    return joined(chunks)


def same(one: Chunk, other: Chunk) -> bool:
    columns = [(getattr(one, name), getattr(other, name)) for name in COLUMNS]
    alike = all(a is b is None or np.array_equal(a, b) for a, b in columns)
    return alike and one.problems == other.problems and one.used_bytes == other.used_bytes


def whole(path: Path) -> Chunk:
    with open_marked(path, ReadOptions()) as reader:
        return joined(list(reader.chunks(10_000)))


@pytest.mark.parametrize("name", STREAMED)
def test_rows_do_not_depend_on_the_pieces(recordings: dict[str, Path], name: str) -> None:
    path = recordings[name]
    assert same(grown(path, path.read_bytes(), Random(1)), whole(path))


@pytest.mark.parametrize("lost", [0, 8])
def test_a_last_row_without_an_end_is_told_alike(
    recordings: dict[str, Path], lost: int, tmp_path: Path
) -> None:
    """The row is complete without its line end, and cut off without its last digits."""
    path = tmp_path / "csv.csv"
    data = recordings["csv"].read_bytes().rstrip()
    path.write_bytes(data := data[: len(data) - lost])
    found = whole(path)
    assert [problem.code for problem in found.problems] == (["no_line_end"] if lost else [])
    assert same(grown(path, data, Random(1)), found)


@pytest.mark.parametrize("name", STREAMED)
@pytest.mark.parametrize("seed", [1, 2, *(pytest.param(n, marks=pytest.mark.nightly) for n in range(3, 40))])
def test_damage_is_told_alike(recordings: dict[str, Path], name: str, seed: int, tmp_path: Path) -> None:
    """Bytes are blanked, lost and doubled somewhere behind the head, and the end is cut off."""
    random = Random(seed)
    path = tmp_path / recordings[name].name
    data = bytearray(recordings[name].read_bytes())
    for beside in recordings[name].parent.glob(f"{name}.layout.toml"):
        (tmp_path / beside.name).write_bytes(beside.read_bytes())
    for _ in range(random.randint(1, 5)):
        place, length = random.randrange(9000, len(data)), random.randint(1, 2000)
        if name == "csv":  # lines that are no rows end the reading; lost ones do not
            place, length = data.index(b"\n", place - 1000) + 1, 0
            length = data.index(b"\n", place) + 1 - place
        part = data[place : place + length]
        data[place : place + length] = random.choice(
            [b"", part * 2, b"" if name == "csv" else b"\0" * length]
        )
    data = data[: random.randrange(len(data) // 2, len(data))]
    path.write_bytes(data)
    found = whole(path)
    assert same(grown(path, bytes(data), random), found)


def test_other_formats_say_that_they_are_not_read_while_they_grow(recordings: dict[str, Path]) -> None:
    for name in sorted(set(recordings) - set(STREAMED)):
        refusal = pytest.raises(UnreadableError, match=f"{name} are not read while they grow")
        with open_marked(recordings[name], ReadOptions()) as reader, refusal:
            reader.intake()


def test_samples_beyond_those_that_a_sound_file_tells_of_are_not_lost_in_silence(
    recordings: dict[str, Path],
) -> None:
    """Such as those of more than 4 GiB; a chunk of text behind the samples is none of them."""
    path = recordings["wav"]
    with open_marked(path, ReadOptions()) as reader:
        intake = reader.intake()
        samples = sum(map(len, intake.take(path.read_bytes() + b"LIST\4\0\0\0text", last=False)))
        assert samples == len(whole(path))
    with open_marked(path, ReadOptions()) as reader:
        refusal = pytest.raises(UnreadableError, match="more samples follow than its header states")
        with refusal:
            list(reader.intake().take(path.read_bytes() + bytes(100), last=False))


def test_a_page_is_known_again_however_far_back_it_lies(tmp_path: Path) -> None:
    counts = np.arange(400 * 300 * 3).reshape(-1, 3) % 500
    path = make_geneactiv.make(tmp_path, counts, 50.0, LSB_PER_G).path
    data = path.read_bytes()
    first, second = (data.index(b"Recorded Data", begin) for begin in (0, data.index(b"Recorded Data") + 1))
    data += data[first:second]
    path.write_bytes(data)
    expected = whole(path)
    assert "repeated_page" in {problem.code for problem in expected.problems}
    assert same(grown(path, data, Random(2)), expected)


def test_a_gyroscope_in_text(tmp_path: Path) -> None:
    """Its rows wait with those of the acceleration; one without a rate is left out of both."""
    words = ("--format", "csv", "--gyro", "--days", "0.004", "--rate", "50", "--seed", "3", "-q")
    assert exit_code("simulate", tmp_path / "a", *words) == 0
    lines = gzip.decompress((tmp_path / "a.csv.gz").read_bytes()).splitlines(keepends=True)
    lines[9000] = lines[9000].rsplit(b",", 1)[0] + b",\n"
    path = tmp_path / "a.csv"
    path.write_bytes(b"".join(lines))
    expected = whole(path)
    assert expected.gyro_counts is not None and len(expected.gyro_counts) == len(lines) - 2
    assert [problem.code for problem in expected.problems] == ["missing_value"]
    assert same(grown(path, path.read_bytes(), Random(4)), expected)
