"""The adaptive rule equals its definition in plain Python, however the rows are chunked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from accelcal_cli.core.settings import Adaptive
from accelcal_cli.segment.adaptive import AdaptiveRule
from tests.segment.naive_adaptive import Naive, State
from tests.segment.streams import Stream, batched

CUTS = st.lists(st.integers(0, 120), max_size=12)
NUMBERS = st.builds(
    Adaptive,
    acceleration_factor=st.integers(1, 3),
    rotation_factor=st.integers(1, 3),
    min_windows=st.integers(1, 3),
    max_windows=st.integers(1, 5),
    held_windows=st.integers(1, 12),
)


def found(
    stream: Stream, length: int, lsb_per_g: float, numbers: Adaptive, cuts: list[int] | range = ()
) -> list[State]:
    batches, counts = batched(stream, length, AdaptiveRule(length, lsb_per_g, numbers), cuts)
    fates = counts.moving + counts.filled + counts.clipped + counts.recovered + counts.still + counts.joined
    assert counts.complete == fates and counts.moving >= 0
    states = [state for windows in batches for state in plain(windows)]
    assert len(states) == counts.still
    return states


def plain(windows) -> list[State]:
    warm = windows.temperature_sums
    heat = [None] * len(windows) if warm is None else warm.tolist()
    columns = (windows.first_sample, windows.samples, windows.sums, windows.spread)
    return [
        (first, samples, tuple(sums), tuple(spread), warmth)
        for first, samples, sums, spread, warmth in zip(
            *(column.tolist() for column in columns), heat, strict=True
        )
    ]


@st.composite
def streams(draw: st.DrawFn) -> Stream:
    """Stretches of rest and movement about changing places."""
    number = draw(st.integers(0, 120))
    places = st.integers(0, max(0, number - 1))
    pieces = draw(
        st.lists(st.tuples(st.integers(1, 30), st.integers(0, 4), st.integers(-60, 60)), max_size=12)
    )
    sizes = [size for length, size, _ in pieces for _ in range(length)][:number]
    levels = [level for length, _, level in pieces for _ in range(length)][:number]
    sizes += [1] * (number - len(sizes))
    levels += [40] * (number - len(levels))
    noise = draw(hnp.arrays(np.int16, (number, 3), elements=st.integers(-3, 3)))
    counts = (noise * np.array(sizes)[:, None] + np.array(levels)[:, None]).astype(np.int16)
    counts[:, 1] += 30
    gyro = draw(st.none() | hnp.arrays(np.int16, (number, 3), elements=st.integers(-5, 5)))
    validity = draw(st.none() | hnp.arrays(np.uint8, number, elements=st.sampled_from([0] * 12 + [1, 2, 3])))
    warm = draw(st.none() | hnp.arrays(np.int32, number, elements=st.integers(-40_000, 60_000)))
    breaks = draw(st.lists(places, max_size=3)) if number else []
    return Stream(counts, tuple(breaks), warm, validity, gyro)


@given(streams(), st.integers(1, 6), st.sampled_from([4.0, 64.0, 83.3]), NUMBERS, CUTS)
def test_any_chunking_gives_the_states_of_the_definition(
    stream: Stream, length: int, lsb_per_g: float, numbers: Adaptive, cuts: list[int]
) -> None:
    expected = Naive(lsb_per_g, length, numbers).states(stream)
    assert found(stream, length, lsb_per_g, numbers) == expected
    assert (
        found(stream, length, lsb_per_g, numbers, [min(cut, len(stream.counts)) for cut in cuts]) == expected
    )
    assert found(stream, length, lsb_per_g, numbers, range(len(stream.counts))) == expected


@given(streams(), st.integers(2, 6), NUMBERS, st.sampled_from([1, 16_384, 300_000]), CUTS)
def test_32_bit_counts_are_treated_alike(
    stream: Stream, length: int, numbers: Adaptive, step: int, cuts: list[int]
) -> None:
    fine = replace(stream, counts=stream.counts.astype(np.int32) * step)
    expected = Naive(64.0 * step, length, numbers).states(fine)
    cuts = [min(cut, len(stream.counts)) for cut in cuts]
    assert found(fine, length, 64.0 * step, numbers, cuts) == expected


@pytest.mark.parametrize(
    ("kind", "lsb_per_g"),
    [
        (np.int16, 256.0),
        *(
            pytest.param(*finer, marks=pytest.mark.nightly)
            for finer in ((np.int16, 2048.0), (np.int32, 2.0**24))
        ),
    ],
)
def test_windows_of_real_size_equal_the_definition(kind: type, lsb_per_g: float) -> None:
    draw = np.random.default_rng(int(lsb_per_g))
    poses = np.repeat(draw.standard_normal((6, 3)), 2000, axis=0)
    poses /= np.sqrt((poses**2).sum(axis=1))[:, None]
    noise_g = np.repeat([0.02, 0.003, 0.0032, 0.006, 0.003, 0.3], 2000)[:, None]
    counts = np.rint((poses + noise_g * draw.standard_normal(poses.shape)) * lsb_per_g).astype(kind)
    gyro = np.rint(3 * draw.standard_normal(poses.shape)).astype(np.int16)
    stream = Stream(counts, breaks=(3017,), gyro=gyro)
    numbers = Adaptive(held_windows=20)
    expected = Naive(lsb_per_g, 100, numbers).states(stream)
    assert found(stream, 100, lsb_per_g, numbers) == expected
    assert found(stream, 100, lsb_per_g, numbers, [1, 99, 5050, 11_111]) == expected
    assert len(expected) >= 4


def test_what_enough_others_follow_is_decided_by_what_they_show_also_at_the_end() -> None:
    """Ten windows, nine of them noisy: the first is decided by the ninth, not by the quiet tenth."""
    noisy, quiet = [250, 262, 250, 262], [255, 257, 255, 257]
    counts = np.zeros((40, 3), np.int16)
    counts[:, 2] = 9 * noisy + quiet
    numbers = Adaptive(held_windows=8, min_windows=1, max_windows=1)
    for cuts in ((), range(40), range(4, 40, 4)):
        states = found(Stream(counts), 4, 256.0, numbers, cuts)
        assert [first for first, *_ in states] == [0, 36]
