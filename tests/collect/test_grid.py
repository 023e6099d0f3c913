"""Cells and copies of them: exact, in their order, wherever blocks of time end."""

from __future__ import annotations

import copy
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.collect.cells import CellCollector
from accelcal_cli.collect.grid import Cells, Grid, add_sums
from accelcal_cli.core.points import Windows
from accelcal_cli.core.settings import DEFAULT
from tests.collect.made import plain
from tests.collect.test_cells import wear

SCALE = Fraction(2047, 8)


@given(
    st.lists(
        st.tuples(
            st.lists(st.integers(-2000, 2000), min_size=3, max_size=3), st.integers(1, 900),
            st.integers(-40_000, 60_000), st.booleans(), st.integers(0, 3),
        ),
        max_size=30,
    ),
    st.booleans(),
)  # fmt: skip
def test_the_place_of_a_cell_is_that_of_its_mean(means: list[Any], temperature: bool) -> None:
    """By the definition; the sums of what lies in a cell lie there, too, and a copy holds the same."""
    cells = Cells(Grid(SCALE, 20, int(temperature)))
    for counts, samples, milli, constant, block in means:
        sums = [value * samples + samples // 2 for value in counts]
        place = [value * 20 // (SCALE * samples) for value in sums]
        degree = milli // 1000 if temperature else 0
        add_sums(cells, (*place, degree, int(constant), block), [1, samples, *sums, milli * samples, 0, 0, 0])
    for held in (cells, cells.with_blocks(lambda block: block >> 1), copy.deepcopy(cells)):
        found = np.array([*held.values()], np.int64).reshape(-1, 9)
        keys = held.grid.keys(found[:, 1], found[:, 2:5], found[:, 5])
        assert keys.tolist() == [[*key[:4]] for key in held]
        assert held.orientations() == len({tuple(part // 2 for part in key[:3]) for key in held})
    copied = copy.deepcopy(cells)
    assert (list(copied.items()), copied.grid) == (list(cells.items()), cells.grid)


@pytest.mark.parametrize("temperature", [False, True])
@given(wear())
def test_a_copy_of_a_collector_goes_on_by_itself(temperature: bool, items: Windows) -> None:
    items = replace(items, first_sample=np.arange(len(items)) * 40)
    collector = CellCollector(256.0, DEFAULT, temperature=temperature, block_samples=100)
    collector.add(items)
    copied, points = copy.deepcopy(collector), plain(collector.points())
    assert plain(copied.points()) == points
    assert copied.timed() == collector.timed()
    copied.add(items)
    assert plain(collector.points()) == points


def test_the_first_block_is_forgotten_and_the_next_one_is_the_first() -> None:
    grid = Grid(SCALE, 20, degrees=0)
    value = [1, 8, 2000, 0, 0, 0, 0, 0, 0]
    cells = Cells(grid)
    for block in (0, 1, 2):
        add_sums(cells, (19, 0, 0, 0, 0, block), value)
    assert [key[5] for key in cells.with_blocks(lambda block: block - 1)] == [0, 1]
    assert cells.with_blocks(lambda block: block >> 1)[19, 0, 0, 0, 0, 0] == [2 * one for one in value]


@given(st.lists(st.tuples(*[st.integers(-3, 3)] * 4), max_size=40), st.integers(0, 40))
def test_orientations_that_were_counted_before_are_counted_once(keys: list[Any], looked: int) -> None:
    cells = Cells(Grid(SCALE, 20, degrees=1))
    for number, (x, y, z, degree) in enumerate(keys, 1):
        add_sums(cells, (x, y, z, degree, 0, 0), [1, 8, 2000, 0, 0, 0, 0, 0, 0])
        if number >= looked:
            assert cells.orientations() == len({(x // 2, y // 2, z // 2) for x, y, z, _ in keys[:number]})
