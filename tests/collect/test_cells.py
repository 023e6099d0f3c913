"""The cell collector against a plain dictionary of Fractions, and its rules one by one."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from fractions import Fraction
from math import floor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.collect import cells
from accelcal_cli.collect.cells import CellCollector, CellCounts
from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import Correction
from accelcal_cli.core.points import WEIGHT_ONE, Windows, joined_windows
from accelcal_cli.core.settings import DEFAULT
from accelcal_cli.segment import still_rule
from tests.collect.made import plain, windows
from tests.segment.streams import Stream, segmented

HALF = Fraction(1, 2)
LENGTH = 8


def collector(lsb_per_g: float = 256.0, *, temperature: bool = False) -> CellCollector:
    return CellCollector(lsb_per_g, DEFAULT, temperature=temperature)


def collected(items: Windows, lsb_per_g: float = 256.0, *, temperature: bool = False) -> CellCollector:
    held = collector(lsb_per_g, temperature=temperature)
    held.add(items)
    return held


@st.composite
def wear(draw: st.DrawFn, widest: int = 20) -> Windows:
    """Windows of a wrist at 256 counts per g: some postures, some of them implausible."""
    number = draw(st.integers(0, 40))
    seed = draw(st.integers(0, 2**32 - 1))
    random = np.random.default_rng(seed)
    postures = random.standard_normal((draw(st.integers(1, 8)), 3))
    postures /= np.sqrt((postures**2).sum(axis=1))[:, None] / random.uniform(0.4, 1.6, (len(postures), 1))
    g = postures[random.integers(len(postures), size=number)] + 0.05 * random.standard_normal((number, 3))
    lengths = random.integers(LENGTH, LENGTH + draw(st.sampled_from([1, 30])), number)
    sums = np.rint(g * 256 * lengths[:, None]).astype(np.int64)
    spread = np.array(draw(st.lists(st.integers(0, widest), min_size=number, max_size=number)), np.int64)
    warm = random.integers(20_000 * lengths, 24_000 * lengths)
    return windows(lengths, sums.tolist(), np.stack([spread // 2, spread, spread // 3], 1), warm)


def naive_points(
    items: Windows, lsb_per_g: float, *, temperature: bool, constants: bool
) -> list[tuple[list[int], int, int]]:
    """One (position, weight, windows) for each cell, in the order of the cells."""
    held: dict[tuple[int, ...], list[list[int]]] = defaultdict(list)
    for index, sums in enumerate(items.sums.tolist()):
        samples = int(items.samples[index])
        g = [Fraction(value) / (Fraction(lsb_per_g) * samples) for value in sums]
        if not Fraction(1, 4) < sum(value * value for value in g) < Fraction(9, 4):
            continue
        if not constants and not items.spread[index].any():
            continue
        heat = int(items.temperature_sums[index]) if temperature else 0
        degree = floor(Fraction(heat, 1000 * samples))
        held[*(floor(value * 20) for value in g), degree].append([*sums, samples])
    groups: dict[tuple[int, ...], int] = defaultdict(int)
    for key, members in held.items():
        groups[tuple(floor(Fraction(part, 2)) for part in key[:3])] += len(members)
    found = []
    for key, members in sorted(held.items()):
        share = Fraction(len(members), groups[tuple(floor(Fraction(part, 2)) for part in key[:3])])
        *sums, samples = (sum(part) for part in zip(*members, strict=True))
        means = [Fraction(total) / (Fraction(lsb_per_g) * samples) for total in sums]
        weight = max(1, floor(share * WEIGHT_ONE + HALF))
        found.append(([floor(mean * ONE + HALF) for mean in means], weight, len(members)))
    return found


@given(wear(), st.sampled_from([256.0, 250.0, 341.0]), st.booleans())
def test_points_are_those_of_a_plain_dictionary(items: Windows, lsb_per_g: float, temperature: bool) -> None:
    held = collected(items, lsb_per_g, temperature=temperature)
    points = held.points()
    constants = held.counts().constant_used
    expected = naive_points(items, lsb_per_g, temperature=temperature, constants=constants)
    found = zip(points.xyz.tolist(), points.weights.tolist(), points.windows.tolist(), strict=True)
    assert list(found) == expected
    assert (points.tau is not None) == (temperature and len(points) > 0)


@given(
    wear(), st.lists(st.integers(0, 4), min_size=40, max_size=40), st.permutations(range(5)), st.booleans()
)
def test_merged_parts_in_any_order_equal_the_batch(
    items: Windows, which: list[int], order: list[int], temperature: bool
) -> None:
    part_of = np.array(which[: len(items)], np.int64)
    parts = [collected(items.select(part_of == part), temperature=temperature) for part in order]
    merged = collector(temperature=temperature)
    for part in parts:
        merged.merge(part)
    batch = collected(items, temperature=temperature)
    assert plain(merged.points()) == plain(batch.points())
    assert merged.counts() == batch.counts()
    assert merged.spreads.numbers == batch.spreads.numbers


@given(wear(), st.randoms())
def test_the_order_of_windows_does_not_matter(items: Windows, random: object) -> None:
    order = list(range(len(items)))
    random.shuffle(order)
    one_by_one = collector(temperature=True)
    for index in order:
        one_by_one.add(items.select(np.arange(len(items)) == index))
    assert plain(one_by_one.points()) == plain(collected(items, temperature=True).points())


@given(wear(), wear())
def test_warm_and_cold_parts_merge_into_a_cold_whole(warm: Windows, cold: Windows) -> None:
    merged = collector()
    for part in (collected(warm, temperature=True), collected(cold)):
        merged.merge(part)
    both = collected(warm)
    both.add(cold)
    assert plain(merged.points()) == plain(both.points())


def test_merging_leaves_the_other_collector_as_it_was() -> None:
    one, other = (collected(windows(LENGTH, [(256 * LENGTH, 0, 0)])) for _ in range(2))
    one.merge(other)
    one.merge(other)
    assert other.points().windows.tolist() == [1]
    assert one.points().windows.tolist() == [3]


def test_a_border_between_cells_belongs_to_the_upper_one() -> None:
    # 0.05 g is 5 counts at 100 counts per g
    below, at = (5 * LENGTH - 1, 0, 100 * LENGTH), (5 * LENGTH, 0, 100 * LENGTH)
    assert len(collected(windows(LENGTH, [at, at]), 100.0).points()) == 1
    assert len(collected(windows(LENGTH, [below, at]), 100.0).points()) == 2


@pytest.mark.parametrize(
    ("g", "plausible"),
    [(0.5, False), (0.50049, True), (1.0, True), (1.4995, True), (1.5, False), (0.0, False)],
)
def test_norms_that_gravity_cannot_give_are_left_out_and_counted(g: float, plausible: bool) -> None:
    held = collected(windows(LENGTH, [(0, -round(g * 256 * LENGTH), 0)]))
    assert held.counts().implausible == (not plausible)
    assert len(held.points()) == plausible


def test_norms_are_judged_by_the_settings() -> None:
    held = CellCollector(256.0, replace(DEFAULT, norm_low_g=0.9, norm_high_g=1.1), temperature=False)
    held.add(windows(LENGTH, [(round(g * 256 * LENGTH), 0, 0) for g in (0.8, 1.0, 1.2)]))
    assert (held.counts().implausible, len(held.points())) == (2, 1)


UP, SIDE = (0, 0, 256 * LENGTH), (256 * LENGTH, 0, 0)


def noisy(number: int, deviation: float, samples: int = 500) -> list[tuple[int, ...]]:
    """Spreads in counts of still windows of a sensor with white noise."""
    random = np.random.default_rng(3)
    spreads = []
    for _ in range(number):
        counts = np.rint(deviation * random.standard_normal((samples, 3)) + random.random(3))
        spreads.append(tuple(int(value) for value in counts.max(axis=0) - counts.min(axis=0)))
    return spreads


@pytest.mark.parametrize("deviation", [1.0, 4.0, 12.0])
@pytest.mark.parametrize("constant", [50, 500, 5000])
def test_constants_among_windows_of_a_noisy_sensor_are_a_devices_fill(
    deviation: float, constant: int
) -> None:
    sums = [UP] * constant + [SIDE] * 500
    held = collected(windows(LENGTH, sums, [(0, 0, 0)] * constant + noisy(500, deviation)))
    assert held.counts() == CellCounts(implausible=0, constant=constant, constant_used=False)
    assert held.points().windows.tolist() == [500]


def test_constants_of_a_coarse_sensor_are_kept() -> None:
    # one step is one count: stillness shows as none or one step
    held = collected(windows(LENGTH, [UP] * 90 + [SIDE] * 10, [(0, 0, 0)] * 90 + [(1, 0, 1)] * 10))
    assert held.counts() == CellCounts(implausible=0, constant=90, constant_used=True)
    assert sorted(held.points().windows.tolist()) == [10, 90]


def test_constants_are_believed_from_a_tenth_of_nearly_constant_ones_on() -> None:
    for nearly, believed in ((9, False), (10, True)):
        held = collected(
            windows(LENGTH, [UP] * 100 + [SIDE] * nearly, [(0, 0, 0)] * 100 + [(0, 4, 0)] * nearly)
        )
        assert held.counts().constant_used is believed


def test_constants_alone_are_a_devices_fill() -> None:
    held = collected(windows(LENGTH, [UP] * 5, 0))
    assert held.counts() == CellCounts(implausible=0, constant=5, constant_used=False)
    assert len(held.points()) == 0


def test_cells_are_split_by_whole_degrees_where_temperature_is_used() -> None:
    warm = [LENGTH * mc for mc in (30_999, 31_000, 31_999, -1, 0)]
    items = windows(LENGTH, [UP] * 5, temperature_sums=warm)
    assert collected(items, temperature=True).points().windows.tolist() == [1, 1, 1, 2]
    assert collected(items).points().windows.tolist() == [5]


def heated(*degrees: float, number: int = 1) -> Windows:
    """Windows at rest, `number` at each temperature."""
    warm = [round(1000 * c) * LENGTH for c in degrees for _ in range(number)]
    rest = np.tile([[0, 0, 256 * LENGTH]], (len(warm), 1))
    return windows([LENGTH] * len(warm), rest.tolist(), np.ones((len(warm), 3), np.int64), warm)


@pytest.mark.parametrize(
    ("degrees", "left_out"),
    [
        ((25, 26, 27, 26, 250), 1),
        ((25, 26, 27, 26, -50, 250), 2),
        ((25, 26, 27, 26, 67), 1),
        ((25, 26, 27, 26, 65, -13), 0),
        ((-300, -250, -200, -150, -100, -50, 200), 0),
        ((250, 250, 250), 0),
    ],
    ids=["end", "both ends", "too far", "far", "spread out", "all alike"],
)
def test_temperatures_far_from_all_others_are_a_fault_of_the_thermometer(
    degrees: tuple[float, ...], left_out: int
) -> None:
    held = collected(heated(*degrees), temperature=True)
    assert held.counts().far_temperature == left_out
    assert held.points().windows.sum() == len(degrees) - left_out
    cold = collected(heated(*degrees))
    assert cold.counts().far_temperature == 0 and cold.points().windows.sum() == len(degrees)


def test_the_median_of_temperatures_is_that_of_windows_not_of_cells() -> None:
    items = joined_windows([heated(100, 101, 102), heated(20, number=9)])
    assert collected(items, temperature=True).counts().far_temperature == 3


def test_the_histogram_of_spreads_stays_small_and_is_exact_for_small_ones() -> None:
    spreads = [(value, 0, 0) for value in [*range(1, 64), *range(64, 60_000, 7)]]
    held = collected(windows(LENGTH, [UP] * len(spreads), spreads))
    numbers = held.spreads.numbers
    assert [numbers[value] for value in range(1, 64)] == [1] * 63
    assert sum(numbers.values()) == len(spreads)
    assert len(numbers) < len(spreads) // 4


@given(wear(30), st.booleans())
def test_the_unit_of_the_counts_does_not_matter(items: Windows, temperature: bool) -> None:
    sums, spread = items.sums << 16, items.spread << 16
    fine = Windows(items.samples, items.first_sample, sums, spread, items.temperature_sums)
    one = collected(items, 256.0, temperature=temperature)
    other = collected(fine, float(1 << 24), temperature=temperature)
    assert plain(one.points()) == plain(other.points())
    assert one.counts() == other.counts()


def test_int16_and_int32_recordings_of_one_wear_give_identical_points() -> None:
    random = np.random.default_rng(5)
    directions = random.standard_normal((60, 3))
    directions /= np.sqrt((directions**2).sum(axis=1))[:, None]
    noise = np.repeat(random.choice([0.0, 0.003, 0.0125, 0.014], 60), 100)[:, None]
    g = np.repeat(directions, 100, axis=0) + noise * random.standard_normal((6000, 3))
    counts = np.rint(g * 256).astype(np.int16)
    warm = np.repeat(random.integers(25_000, 35_000, 60), 100).astype(np.int32)
    points = []
    for kind, shift in ((np.int16, 0), (np.int32, 16)):
        lsb_per_g = float(256 << shift)
        rule = still_rule((0, 1, 2), 0.12, 0.013, lsb_per_g)
        stream = Stream(counts.astype(kind) << shift, temperature_mc=warm)
        found, window_uses = segmented(stream, 50, rule, (1, 777, 3001))
        assert 0 < window_uses.still < window_uses.complete
        _, sums, spread, heat = zip(*found, strict=True)
        points.append(plain(collected(windows(50, sums, spread, heat), lsb_per_g, temperature=True).points()))
    assert points[0] == points[1]


def test_nothing_collected_is_no_points() -> None:
    assert len(collector(temperature=True).points()) == 0
    assert collector().counts() == CellCounts(0, 0, False)


def rested(hours: int, *, postures: int = 3) -> Windows:
    """Windows of 8 samples in turn in each posture, 450 of them an hour of one sample a second."""
    number = hours * 450
    g = np.eye(3)[np.arange(number) % postures] * np.where(np.arange(number) % 2, 1, -1)[:, None]
    sums = np.rint(g * 256 * LENGTH).astype(np.int64)
    made = windows(np.full(number, LENGTH), sums.tolist(), np.ones((number, 3), np.int64))
    return replace(made, first_sample=LENGTH * np.arange(number))


def test_blocks_of_time_add_up_to_the_points() -> None:
    held = CellCollector(256.0, DEFAULT, temperature=False, block_samples=3600)
    items = rested(5)
    for part in np.array_split(np.arange(len(items)), 7):
        held.add(items.select(part))
    timed = held.timed()
    assert sorted({block for block, _ in timed}) == [0, 1, 2, 3, 4]
    assert sum(one.windows for _, one in timed) == len(items)
    assert [sum(one.xyz[axis] for _, one in timed) for axis in range(3)] == items.sums.sum(axis=0).tolist()
    points = collected(items).points()
    assert held.points().xyz.tolist() == points.xyz.tolist()
    assert held.points().weights.tolist() == points.weights.tolist()


@pytest.mark.parametrize("parts", [1, pytest.param(2, marks=pytest.mark.nightly), 9])
@pytest.mark.parametrize(("bound", "most"), [("MAX_TIMED", 20), ("MAX_BLOCKS", 2)])
def test_blocks_become_longer_where_there_are_too_many(
    monkeypatch: pytest.MonkeyPatch, bound: str, most: int, parts: int
) -> None:
    monkeypatch.setattr(cells, bound, most)
    held = CellCollector(256.0, DEFAULT, temperature=False, block_samples=3600)
    items = rested(30)
    for part in np.array_split(np.arange(len(items)), parts):
        held.add(items.select(part))
    assert held.block_samples == 16 * 3600
    assert sorted({block for block, _ in held.timed()}) == [0, 1]
    assert sum(one.windows for _, one in held.timed()) == len(items)


def roaming(number: int, seed: int) -> Windows:
    """Windows of 8 samples, 450 an hour, each in a posture and at a temperature of its own."""
    random = np.random.default_rng(seed)
    g = random.standard_normal((number, 3))
    g /= np.sqrt((g**2).sum(axis=1))[:, None]
    sums = np.rint(g * 256 * LENGTH).astype(np.int64).tolist()
    warm = random.integers(15_000 * LENGTH, 40_000 * LENGTH, number)
    made = windows(np.full(number, LENGTH), sums, np.ones((number, 3), np.int64), warm)
    return replace(made, first_sample=LENGTH * np.arange(number))


@pytest.mark.parametrize("temperature", [False, True])
@pytest.mark.parametrize("most", [20, 200, 400, 1200])
def test_a_wrist_that_is_everywhere_at_all_temperatures_comes_to_an_end(
    monkeypatch: pytest.MonkeyPatch, most: int, temperature: bool
) -> None:
    """Blocks become longer, cells wider in temperature; more orientations are all kept, in one block."""
    monkeypatch.setattr(cells, "MAX_TIMED", most)
    items = roaming(1200, seed=3)
    alone = collected(items)
    found = []
    for parts in (1, 7, 60):
        held = CellCollector(256.0, DEFAULT, temperature=temperature, block_samples=360)
        for part in np.array_split(np.arange(len(items)), parts):
            held.add(items.select(part))
        assert sum(one.windows for _, one in held.timed()) == len(items)
        assert held.points().windows.sum() == len(items)
        found.append((held.block_samples, held.timed(), plain(held.points())))
    assert found[0] == found[1] == found[2]
    if most < len(alone.points()):
        assert {block for block, _ in held.timed()} == {0}
        assert held.points().xyz.tolist() == alone.points().xyz.tolist(), "in two temperatures, if at all"


def busy() -> Windows:
    """100 orientations at 16 temperatures."""
    sums = np.repeat(roaming(100, seed=8).sums, 16, axis=0)
    warm = np.tile(np.arange(16_500, 32_500, 1000) * LENGTH, 100)
    return windows(LENGTH, sums.tolist(), temperature_sums=warm.tolist())


def test_a_busy_beginning_ends_in_one_block_however_its_windows_come(monkeypatch: pytest.MonkeyPatch) -> None:
    """100 orientations at 16 temperatures in four hours, then one posture for thirty."""
    monkeypatch.setattr(cells, "MAX_TIMED", 500)
    calm = rested(30, postures=1)
    calm = replace(calm, sums=np.abs(calm.sums), temperature_sums=np.full(len(calm), 20_500 * LENGTH))
    items = joined_windows([busy(), calm])
    items = replace(items, first_sample=LENGTH * np.arange(len(items)))
    found = []
    for parts in (1, 13, 200):
        held = CellCollector(256.0, DEFAULT, temperature=True, block_samples=3600)
        for part in np.array_split(np.arange(len(items)), parts):
            held.add(items.select(part))
        found.append((held.block_samples, held.timed(), plain(held.points())))
    assert found[0] == found[1] == found[2]
    assert {block for block, _ in held.timed()} == {0}


def test_a_pool_of_too_many_cells_is_what_their_windows_give_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cells, "MAX_TIMED", 1000)
    items = busy()
    merged = collector(temperature=True)
    for part in np.array_split(np.arange(len(items)), 3):
        merged.merge(collected(items.select(part), temperature=True))
    assert plain(merged.points()) == plain(collected(items, temperature=True).points())
    assert len(merged.points()) <= 1000


@pytest.mark.parametrize("first", [0, 1])
def test_collectors_of_unlike_degrees_are_merged_as_the_wider_one(
    monkeypatch: pytest.MonkeyPatch, first: int
) -> None:
    items = roaming(400, seed=4)
    narrow = collected(items.select(np.arange(200)), temperature=True)
    monkeypatch.setattr(cells, "MAX_TIMED", 150)
    wide = CellCollector(256.0, DEFAULT, temperature=True, block_samples=3600)
    wide.add(items.select(np.arange(200, 400)))
    merged = collector(temperature=True)
    for part in ((narrow, wide), (wide, narrow))[first]:
        merged.merge(part)
    alone = collected(items).points()
    assert merged.points().xyz.tolist() == alone.xyz.tolist(), "the wider one holds all temperatures together"
    assert merged.points().windows.tolist() == alone.windows.tolist()


def test_a_table_of_windows_gives_the_points_of_their_recording(monkeypatch: pytest.MonkeyPatch) -> None:
    """However many blocks and degrees were joined along the recording."""
    items = roaming(3000, seed=6)
    for most in (1 << 15, 2500, 1000):
        monkeypatch.setattr(cells, "MAX_TIMED", most)
        held = CellCollector(256.0, DEFAULT, temperature=True, block_samples=360)
        held.add(items)
        assert plain(held.points()) == plain(collected(items, temperature=True).points()), most


def test_a_pool_has_no_blocks_of_time() -> None:
    held, merged = CellCollector(256.0, DEFAULT, temperature=False, block_samples=3600), collector()
    held.add(rested(3))
    merged.merge(held)
    assert {block for block, _ in merged.timed()} == {0}
    assert merged.points().xyz.tolist() == held.points().xyz.tolist()


def test_what_makes_no_points_is_in_no_block() -> None:
    items = rested(2)
    items = replace(items, spread=np.repeat(7 + np.arange(len(items)) % 2, 3).reshape(-1, 3))
    far = replace(items.select(np.arange(3)), sums=np.full((3, 3), 9 * 256 * LENGTH, np.int64))
    constant = replace(items.select(np.arange(5)), spread=np.zeros((5, 3), np.int64))
    held = CellCollector(256.0, DEFAULT, temperature=False, block_samples=3600)
    held.add(joined_windows([items, far, constant]))
    assert sum(one.windows for _, one in held.timed()) == len(items)


@pytest.mark.parametrize("lsb_per_g", [256.0, 341.3, 8192.5])
def test_points_of_a_sensor_that_is_put_right(lsb_per_g: float) -> None:
    """The same as of windows whose sums were put right before; exact but for one rounding of each mean."""
    g = np.array([[0.6, 0.64, 0.48], [-0.8, 0.36, 0.48], [0.28, -0.96, 0.0]])
    raw = np.rint(np.tile(g, (600, 1)) * lsb_per_g * LENGTH).astype(np.int64)
    made = windows(np.full(len(raw), LENGTH), raw.tolist(), np.full((len(raw), 3), 7))
    made = replace(made, first_sample=LENGTH * np.arange(len(raw)))
    correction = Correction(
        (0, 7200),
        ((ONE, ONE, ONE), (ONE * 3 // 4, ONE, ONE)),
        ((0, 0, 0), (ONE // 64, 0, ONE // 32)),
        lines=False,
    )
    held = CellCollector(lsb_per_g, DEFAULT, temperature=False, block_samples=3600)
    held.add(made)
    found = held.points(correction)
    plain = held.points()
    assert found.windows.tolist() == plain.windows.tolist()
    assert found.weights.tolist() == plain.weights.tolist()
    share = Fraction(1, 2)  # of each orientation's windows are in either half
    for before, after in zip(plain.xyz.tolist(), found.xyz.tolist(), strict=True):
        x, y, z = (Fraction(value) for value in before)
        expected = (x * (1 + Fraction(3, 4)) * share + share * ONE / 64, y, z + share * ONE / 32)
        assert [abs(value - one) <= 1 for value, one in zip(after, expected, strict=True)] == [True] * 3
