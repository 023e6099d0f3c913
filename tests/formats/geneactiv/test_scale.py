"""The factory's gains and offsets on one grid of counts."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.recording import Chunk, Recording
from accelcal_cli.formats.geneactiv.reader import Factory, factory_scale
from tests.formats.geneactiv.oracle import exact_g
from tests.formats.geneactiv.test_geneactiv import joined, opened, random_counts
from tests.formats.make_geneactiv import Page, digits, header, pages, written

EVERY = np.stack(
    [np.arange(-2048, 2048), np.arange(2047, -2049, -1), np.roll(np.arange(-2048, 2048), 99)], axis=1
)
Triple = tuple[int, int, int]


def read(folder: Path, counts: np.ndarray, gain: Triple, offset: Triple) -> tuple[Recording, list[Chunk]]:
    whole = counts[: len(counts) // 300 * 300]
    reader = opened(written(folder / "a.bin", pages(whole), header(gain=gain, offset=offset)))
    return reader.recording, list(reader.chunks(10_000))


@pytest.mark.parametrize(
    ("gain", "offset", "lsb_per_g", "kind"),
    [
        ((25600,) * 3, (0, 0, 0), 256.0, np.int16),
        ((25600,) * 3, (100, -4700, 0), 256.0, np.int16),
        ((25522,) * 3, (0, 0, 0), 255.22, np.int16),
        ((25522,) * 3, (272, -1129, 101), 25522.0, np.int32),
        ((25600, 12800, 25600), (0, 0, 0), 256.0, np.int16),
        ((25600, 25500, 25600), (0, 0, 0), 65280.0, np.int32),
        ((25600, 25500, 25600), (1, 0, 0), 1305600.0, np.int32),
        ((25522, 25457, 24829), (272, -1129, 101), 2.0**24, np.int32),
    ],
)
def test_the_grid_is_the_coarsest_that_is_exact(
    tmp_path: Path, gain: Triple, offset: Triple, lsb_per_g: float, kind: type
) -> None:
    recording, chunks = read(tmp_path, EVERY, gain, offset)
    counts = joined(chunks, "counts")
    assert (recording.lsb_per_g, counts.dtype) == (lsb_per_g, kind)
    for raw, found in zip(EVERY[::37].tolist(), counts[::37].tolist(), strict=False):
        for axis in range(3):
            wanted = exact_g(raw[axis], gain[axis], offset[axis]) * Fraction(str(lsb_per_g))
            assert found[axis] == wanted if lsb_per_g < 2**24 else abs(found[axis] - wanted) <= Fraction(1, 2)


numbers = st.tuples(*[st.integers(6_400, 102_400)] * 3), st.tuples(*[st.integers(-6_400, 6_400)] * 3)


@given(*numbers)
def test_counts_are_what_the_formula_gives_to_half_a_count(gain: Triple, offset: Triple) -> None:
    scale = factory_scale(Factory(gain, offset))
    assert scale.lsb_per_g <= 2**24
    for raw in (-2048, -1, 0, 1, 77, 2047):
        for axis in range(3):
            found = Fraction(int(scale.table[axis, raw & 0xFFF]))
            off = abs(found - exact_g(raw, gain[axis], offset[axis]) * Fraction(scale.lsb_per_g))
            assert off <= (Fraction(1, 10**6) if scale.exact else Fraction(1, 2))


def test_values_at_the_ends_of_the_sensor_are_clipped_whatever_the_gain(tmp_path: Path) -> None:
    counts = random_counts(300) // 2
    counts[[5, 80, 299], [0, 1, 2]] = 2047, -2048, 2047
    for gain, offset in (((25600,) * 3, (0,) * 3), ((25522, 25457, 24829), (272, -1129, 101))):
        _, chunks = read(tmp_path, counts, gain, offset)
        validity = chunks[0].validity
        assert validity is not None
        assert np.flatnonzero(validity).tolist() == [5, 80, 299]
        assert set(validity[[5, 80, 299]]) == {2}


def test_no_validity_where_nothing_is_clipped(tmp_path: Path) -> None:
    _, chunks = read(tmp_path, random_counts(600) // 2, (25600,) * 3, (0,) * 3)
    assert all(chunk.validity is None for chunk in chunks)


@pytest.mark.parametrize(
    "told",
    [
        {"gain": (25600, "", 25600)},
        {"gain": (25600, 0, 25600)},
        {"gain": (25600, -25600, 25600)},
        {"gain": (25600, 256, 25600)},
        {"gain": (25600, 256000, 25600)},
        {"gain": (25600, "2x600", 25600)},
        {"offset": (0, 0, 30000)},
        {"offset": (0, 0, "")},
    ],
)
def test_without_a_possible_calibration_the_user_must_give_one(tmp_path: Path, told: dict) -> None:
    counts = random_counts(600)
    path = written(tmp_path / "a.bin", pages(counts), header(pages=2, **told))
    with pytest.raises(UnreadableError, match=r"byte 0: .*calibration .*--lsb-per-g .*about 256"):
        opened(path)
    reader = opened(path, lsb_per_g=250.0)
    chunks = list(reader.chunks(600))
    assert (joined(chunks, "counts") == counts).all()
    assert reader.recording.lsb_per_g == 250
    assert [problem.code for chunk in chunks for problem in chunk.problems] == ["damaged_header"]
    assert "were not applied" in reader.recording.notes[0]


def test_the_users_scale_goes_before_the_factorys(tmp_path: Path) -> None:
    counts = random_counts(300)
    head = header(gain=(25522, 25457, 24829), offset=(272, -1129, 101), pages=1)
    path = written(tmp_path / "a.bin", [Page(counts, 0, body=digits(counts))], head)
    chunks = list(opened(path, lsb_per_g=256.0).chunks(600))
    assert (joined(chunks, "counts") == counts).all()
    assert not chunks[0].problems
