"""Cells of `collect/cells.py`: their sums, copies, the posture before, and the points made of them."""

from __future__ import annotations

import copy
import json
from dataclasses import replace
from fractions import Fraction
from math import floor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.collect import cells
from accelcal_cli.collect.cells import (
    MAX_POINTS,
    CellCollector,
    Cells,
    CellSums,
    Grid,
    PreviousPosture,
    Width,
    add_sums,
    points_of,
    to_points,
    width_for,
)
from accelcal_cli.core.arithmetic import ONE, rounded_quotient
from accelcal_cli.core.calibration import TemperatureScale
from accelcal_cli.core.points import WEIGHT_ONE, Windows
from accelcal_cli.core.settings import DEFAULT
from tests.cli.run import run
from tests.collect.made import plain, windows
from tests.collect.test_cells import collected, wear
from tests.optimize.oracle import directions

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
    filled = Cells(Grid(SCALE, 20, int(temperature)))
    for counts, samples, milli, constant, block in means:
        sums = [value * samples + samples // 2 for value in counts]
        place = [value * 20 // (SCALE * samples) for value in sums]
        degree = milli // 1000 if temperature else 0
        add_sums(
            filled, (*place, degree, int(constant), block), [1, samples, *sums, milli * samples, 0, 0, 0]
        )
    for held in (filled, filled.with_blocks(lambda block: block >> 1), copy.deepcopy(filled)):
        found = np.array([*held.values()], np.int64).reshape(-1, 9)
        keys = held.grid.keys(found[:, 1], found[:, 2:5], found[:, 5])
        assert keys.tolist() == [[*key[:4]] for key in held]
        assert held.orientations() == len({tuple(part // 2 for part in key[:3]) for key in held})
    copied = copy.deepcopy(filled)
    assert (list(copied.items()), copied.grid) == (list(filled.items()), filled.grid)


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
    filled = Cells(grid)
    for block in (0, 1, 2):
        add_sums(filled, (19, 0, 0, 0, 0, block), value)
    assert [key[5] for key in filled.with_blocks(lambda block: block - 1)] == [0, 1]
    assert filled.with_blocks(lambda block: block >> 1)[19, 0, 0, 0, 0, 0] == [2 * one for one in value]


@given(st.lists(st.tuples(*[st.integers(-3, 3)] * 4), max_size=40), st.integers(0, 40))
def test_orientations_that_were_counted_before_are_counted_once(keys: list[Any], looked: int) -> None:
    filled = Cells(Grid(SCALE, 20, degrees=1))
    for number, (x, y, z, degree) in enumerate(keys, 1):
        add_sums(filled, (x, y, z, degree, 0, 0), [1, 8, 2000, 0, 0, 0, 0, 0, 0])
        if number >= looked:
            assert filled.orientations() == len({(x // 2, y // 2, z // 2) for x, y, z, _ in keys[:number]})


LSB_PER_G, SAMPLES = 1000.0, 100


def rests(means: np.ndarray, first: int = 0) -> Windows:
    number = len(means)
    samples = np.full(number, SAMPLES, np.int64)
    spread = np.full((number, 3), 5, np.int64)
    place = (first + np.arange(number)) * SAMPLES
    return Windows(samples, place, np.asarray(means * SAMPLES, np.int64), spread)


def by_definition(means: np.ndarray) -> np.ndarray:
    """A posture lasts while windows lie within 15 degrees of its first one."""
    before, leader = means.copy(), None
    last, posture_before = means[0], None
    for index, mean in enumerate(means):
        if leader is not None:
            cosine = mean @ leader / np.linalg.norm(mean) / np.linalg.norm(leader)
        if leader is None or cosine < np.sqrt(956 / 1024):
            posture_before = None if leader is None else last
            leader = mean
        last = mean
        if posture_before is not None:
            before[index] = posture_before
    return before


def wrist(number: int) -> np.ndarray:
    """Stays for a while, then turns."""
    random = np.random.RandomState(2)
    poses = random.standard_normal((40, 3))
    stays = np.repeat(poses / np.linalg.norm(poses, axis=1)[:, None], random.randint(1, 30, 40), axis=0)
    return np.rint(1000 * stays[:number] + 3 * random.standard_normal((len(stays[:number]), 3)))


@pytest.mark.parametrize("batch", [1, 7, 10_000])
def test_it_is_the_last_window_of_the_posture_before(batch: int) -> None:
    means, one = wrist(400), PreviousPosture()
    parts = [means[start : start + batch] for start in range(0, len(means), batch)]
    filled = [np.floor(part / 100).astype(np.int64) for part in parts]
    found = np.concatenate([one.of(rests(part), cell) for part, cell in zip(parts, filled, strict=True)])
    at_once = PreviousPosture().of(rests(means), np.concatenate(filled))
    assert found.tolist() == at_once.tolist()
    within = np.abs(found - by_definition(means)).max(axis=1)
    assert (within <= 20).all(), "filled are runs of windows whose first and last are looked at"
    assert (within == 0).mean() > 0.9


def test_a_run_in_one_cell_goes_on_in_the_next_batch() -> None:
    """Windows at 60, 0.5, 13 and 16.8 degrees and at 90: the third and fourth are of the second's cell."""
    angles = np.radians([60, 0.5, 13.0, 16.8, 90])
    means = np.rint(1000 * np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=1))
    filled = np.array([[0], [1], [1], [1], [2]])
    whole = PreviousPosture().of(rests(means), filled).tolist()
    for cut in range(1, 5):
        one = PreviousPosture()
        parts = [one.of(rests(means[part]), filled[part]).tolist() for part in (slice(cut), slice(cut, 5))]
        assert parts[0] + parts[1] == whole
    assert whole[4] == means[3].tolist()


def fixed(vector: list[int]) -> list[int]:
    return [round(value / LSB_PER_G * ONE) for value in vector]


def test_points_have_the_mean_of_the_postures_before_their_windows() -> None:
    up, down, left = [0, 0, 1010], [0, 0, -990], [1005, 0, 0]
    collector = CellCollector(LSB_PER_G, DEFAULT, temperature=False)
    collector.add(rests(np.array([up, up, down, left])))
    collector.add(rests(np.array([up, down, down]), 4))
    held = collector.points()
    assert held.previous is not None
    found = {
        tuple(xyz): previous for xyz, previous in zip(held.xyz.tolist(), held.previous.tolist(), strict=True)
    }
    assert found[tuple(fixed(left))] == fixed(down)
    assert found[tuple(fixed(down))] == fixed(up)
    assert np.abs(np.array(found[tuple(fixed(up))]) - (np.array(fixed(up)) * 2 + fixed(left)) / 3).max() <= 1


HALF = Fraction(1, 2)


def rounded(value: Fraction) -> int:
    return floor(value + HALF)


@given(st.integers(-(10**30), 10**30), st.integers(1, 10**15))
def test_quotients_are_rounded_halves_up(value: int, divisor: int) -> None:
    assert rounded_quotient(value, divisor) == rounded(Fraction(value, divisor))


@given(
    st.lists(st.tuples(*[st.integers(-(2**40), 2**40)] * 3, st.integers(1, 4000)), max_size=6),
    st.sampled_from([256.0, 4096.0, float(1 << 24), 341.3333333333333, 83.3, 1 / 0.0039]),
)
def test_means_are_the_nearest_fixed_point_numbers(
    items: list[tuple[int, int, int, int]], lsb_per_g: float
) -> None:
    sums = [CellSums(1, item[3], item[:3]) for item in items]
    points = to_points(sums, [7] * len(sums), lsb_per_g, temperature=False)
    scale = Fraction(lsb_per_g)
    expected = [[rounded(Fraction(axis * ONE) / (n * scale)) for axis in xyz] for *xyz, n in items]
    assert points.xyz.tolist() == expected
    assert points.weights.tolist() == [7] * len(items)
    assert points.xyz.dtype == np.int64 and points.xyz.shape == (len(items), 3)
    assert points.tau is None and points.temperature is None


@given(
    st.lists(
        st.tuples(st.integers(-60_000, 90_000), st.integers(1, 500), st.integers(1, 2**15)),
        min_size=1,
        max_size=8,
    )
)
def test_temperatures_are_scaled_about_their_weighted_mean_to_within_two(
    items: list[tuple[int, int, int]],
) -> None:
    sums = [CellSums(1, n, (0, 0, 0), mean * n + n // 3) for mean, n, _ in items]
    weights = [weight for *_, weight in items]
    points = to_points(sums, weights, 256.0, temperature=True)
    means = [rounded(Fraction(item.temperature_mc, item.samples)) for item in sums]
    reference = rounded(Fraction(sum(w * m for w, m in zip(weights, means, strict=True)), sum(weights)))
    scale = points.temperature
    assert scale is not None and scale.reference_mc == reference
    assert (
        scale.span_c >= 1
        and scale.span_c.is_integer()
        and scale.span_c.hex().startswith("0x1.0000000000000p")
    )
    assert points.tau is not None
    assert points.tau.tolist() == [
        rounded((Fraction(s.temperature_mc, s.samples) - reference) / 1000 / Fraction(scale.span_c) * ONE)
        for s in sums
    ]
    widest = max(abs(mean - reference) for mean in means)
    assert widest < 2000 * scale.span_c
    assert scale.span_c == 1 or widest >= 1000 * scale.span_c
    assert abs(points.tau).max() < 2 * ONE


def test_no_points_have_no_temperature() -> None:
    points = to_points([], [], 256.0, temperature=True)
    assert len(points) == 0 and points.xyz.shape == (0, 3)
    assert points.tau is None and points.temperature is None


def test_the_scale_by_hand() -> None:
    sums = [CellSums(1, 10, (0, 0, 0), 10 * mean) for mean in (27_000, 33_000)]
    points = to_points(sums, [1, 1], 256.0, temperature=True)
    assert points.temperature == TemperatureScale(30_000, 2.0)
    assert points.tau is not None and points.tau.tolist() == [-3 * ONE // 2, 3 * ONE // 2]


Capture = pytest.CaptureFixture[str]

LENGTH = 8
NUMBER = 600


def table_of(folder: Path, columns: str, rows: Any) -> Path:
    """A table of mean accelerations [g] and what goes with them."""
    table = folder / "means.csv"
    table.write_text("\n".join([columns, *rows]) + "\n")
    return table


def many_cells(temperatures: range = range(20_000, 21_000, 1000)) -> Windows:
    """Windows all over the sphere, one for each temperature [thousandths of a degree C]."""
    sums = np.rint(directions(NUMBER) * 256 * LENGTH).astype(np.int64)
    warm = np.tile(np.array(temperatures) * LENGTH, NUMBER)
    return windows(
        LENGTH, np.repeat(sums, len(temperatures), axis=0).tolist(), temperature_sums=warm.tolist()
    )


@pytest.mark.parametrize("limit", [599, 200, 60, 8])
def test_wider_cells_lose_no_window_and_lie_where_these_do(
    limit: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    items = many_cells()
    held = collected(items)
    assert len(held.points()) == NUMBER
    monkeypatch.setattr(cells, "MAX_POINTS", limit)
    points = held.points()
    assert 8 <= len(points) <= limit
    number, means = held.window_uses(items).point, items.sums / (256 * LENGTH)
    for point, place in enumerate(points.xyz_g()):
        parts = means[number == point]
        assert len(parts) == points.windows[point] > 0
        assert np.linalg.norm(place) == pytest.approx(np.sqrt((parts**2).sum(axis=1).mean()), abs=1e-7)
        assert np.cross(place, parts.mean(axis=0)) == pytest.approx(np.zeros(3), abs=1e-7)
    assert points.windows.sum() == NUMBER


def test_two_directions_by_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of (1, 0, 0) for two samples and (0, 1, 0) for one: between them, and as long as they are."""
    monkeypatch.setattr(cells, "MAX_POINTS", 1)
    filled = {
        (0, 1, 0, 0): CellSums(1, 2, (512, 0, 0), 2 * 20_000, (2 * 64, 0, 0)),
        (1, 0, 0, 0): CellSums(1, 1, (0, 256, 0), 26_000, (4 * 64, 0, 0)),
    }
    keys, points = points_of(
        filled, width_for(filled), lambda held: [WEIGHT_ONE] * len(held), 256.0, temperature=True
    )
    assert keys == [(0, 0, 0, 0)]
    assert points.xyz_g()[0] == pytest.approx(np.array([2, 1, 0]) / np.sqrt(5), abs=4 / ONE)
    assert points.windows.tolist() == [2]
    assert points.temperature is not None and points.temperature.reference_mc == 22_000
    assert points.previous is not None and points.previous.tolist() == [[ONE // 2, 0, 0]]


def test_temperatures_are_joined_before_orientations(monkeypatch: pytest.MonkeyPatch) -> None:
    """16 whole degrees, 20 to 35: joined by 2, 4 and 8."""
    items = many_cells(range(20_500, 36_500, 1000))
    held = collected(items, temperature=True)
    alone = plain(collected(items).points())[0]
    for limit, degrees in ((16, 16), (15, 8), (7, 4), (3, 3)):
        monkeypatch.setattr(cells, "MAX_POINTS", limit * NUMBER)
        points = held.points()
        assert len(points) == degrees * NUMBER
        assert points.windows.sum() == 16 * NUMBER
        assert points.xyz[::degrees].tolist() == alone
    monkeypatch.setattr(cells, "MAX_POINTS", 3 * NUMBER - 1)
    assert len({tuple(key[:3]) for key in wide_keys(items)}) < NUMBER, "eight degrees are the most"


def wide_keys(items: Windows) -> list[tuple[int, ...]]:
    """Cells as wide as they have to be, of windows at 20 to 35 degrees."""
    sums = (items.sums * 20 // (256 * LENGTH)).tolist()
    filled = {(*place, 20 + n % 16): CellSums(1, 1, (0, 0, 256)) for n, place in enumerate(sums)}
    width = width_for(filled)
    assert width.degrees <= cells.FEW_DEGREES
    return [*{width.of(key) for key in filled}]


@pytest.mark.parametrize(
    "number", [2000, *(pytest.param(number, marks=pytest.mark.nightly) for number in (2500, 3500))]
)
def test_slopes_stay_known_where_each_direction_has_all_temperatures(
    number: int, tmp_path: Path, capsys: Capture
) -> None:
    """Each at 16 to 31 degrees: too many filled, of one mean temperature; of many, wide from the start."""
    warm = np.tile(np.arange(16.5, 32), number)
    slopes = np.array([0.001, -0.001, 0.0005])
    g = np.repeat(directions(number), 16, axis=0) - np.outer(warm - 26, slopes)
    table = tmp_path / "warm.csv"
    np.savetxt(table, np.column_stack([g, warm]), "%.7f", ",", header="x,y,z,temperature_c", comments="")
    report = json.loads(run(capsys, "fit", table, "--json").out)
    assert report["calibration"]["model"] == "9T"
    assert report["calibration"]["temperature"]["slope_g_per_c"] == pytest.approx(slopes, abs=2e-5)


def test_merged_collectors_are_made_wider_like_the_batch(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cells, "MAX_POINTS", 100)
    items = many_cells()
    odd = np.arange(NUMBER) % 2 == 1
    merged = collected(items.select(odd))
    merged.merge(collected(items.select(~odd)))
    assert plain(merged.points()) == plain(collected(items).points())


def test_many_temperatures_end_as_few_enough_points() -> None:
    """Eight octants and 600 whole degrees are more than the 4096 points that are allowed."""
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    sums = [[148 * LENGTH * part for part in corner] for corner in corners for _ in range(600)]
    warm = [LENGTH * 1000 * degree for _ in corners for degree in range(600)]
    points = collected(windows(LENGTH, sums, temperature_sums=warm), temperature=True).points()
    assert len(points) == 8 * 300 <= MAX_POINTS
    assert points.windows.tolist() == [2] * len(points)


def test_what_lies_apart_for_other_reasons_stays_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """Numbers before the last four, as of postures, keep filled apart, however wide these become."""
    monkeypatch.setattr(cells, "MAX_POINTS", 100)
    sums = np.rint(directions(200) * 256).astype(int).tolist()
    filled = {
        (n % 2, *(v // 13 for v in g), n): CellSums(1, 1, (g[0], g[1], g[2])) for n, g in enumerate(sums)
    }
    width = width_for(filled)
    keys, points = points_of(filled, width, lambda held: [WEIGHT_ONE] * len(held), 256.0, temperature=False)
    assert 16 < len(keys) <= 100, "16 would be octants"
    first = np.array([key[0] for key in keys]) == 0
    assert points.windows[first].sum() == points.windows[~first].sum() == 100


def test_the_widest_cells_are_taken_where_all_are_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cells, "MAX_POINTS", 3)
    filled = [(posture, 0, 0, 0, 0) for posture in range(9)]
    assert width_for(filled) == Width(cells.MOST_SPACE, cells.ALL_DEGREES)


@pytest.mark.parametrize("temperature", [False, True])
def test_a_wrist_that_was_everywhere_is_calibrated_as_well(
    temperature: bool, tmp_path: Path, capsys: Capture
) -> None:
    """Means of a known sensor all over the sphere, without noise, that fill more cells than points may be."""
    truth, offset = (
        np.array([[1.02, 0, 0], [0.01, 0.97, 0], [-0.02, 0.015, 1.01]]),
        np.array([0.03, -0.02, 0.01]),
    )
    g = directions(6000) @ np.linalg.inv(truth).T - offset
    warm = np.random.default_rng(2).uniform(20, 36, len(g))
    columns = [*g.T, warm] if temperature else [*g.T]
    table = tmp_path / "means.csv"
    head = "x,y,z,temperature_c" if temperature else "x,y,z"
    np.savetxt(table, np.column_stack(columns), "%.8f", ",", header=head, comments="")
    report = json.loads(run(capsys, "fit", table, "--json").out)
    found = report["calibration"]
    assert np.array(found["gain"]) == pytest.approx(truth, abs=2e-4)
    assert found["offset_g"] == pytest.approx(offset, abs=2e-4)
    error_mg = 1000 * np.abs(
        np.linalg.norm((g + found["offset_g"]) @ np.transpose(found["gain"]), axis=1) - 1
    )
    assert error_mg.mean() < 0.2


@pytest.mark.parametrize(("postures", "each"), [(MAX_POINTS + 1, 1), (600, 30), (300, 30), (100, 100)])
def test_postures_that_hold_too_many_directions_are_refused_in_one_line(
    postures: int, each: int, tmp_path: Path, capsys: Capture
) -> None:
    """Their means would lie far inside the sphere; moved out, they would be those of a perfect sensor."""
    g = directions(postures * each) * [0.98, 1.02, 1.01] + [0.02, -0.03, 0.01]
    rows = [f"{x:.6f},{y:.6f},{z:.6f},p{n % postures}" for n, (x, y, z) in enumerate(g.tolist())]
    table = table_of(tmp_path, "x,y,z,posture", rows)
    done = run(capsys, "fit", table)
    said = "combinations of orientation, direction and temperature, and a fit takes at most 4096 points"
    hint = "leave out the column `posture`, or average rows that are alike"
    assert done.code == 3 and done.err.endswith(f" {said}; {hint}\n") and done.err.count("\n") == 1
    assert done.err.startswith(f"accelcal: {table}: holds ")


@pytest.mark.parametrize(("postures", "degrees"), [(MAX_POINTS, [25]), (3000, [-5, 5])])
def test_as_many_postures_as_points_are_fitted_and_their_temperatures_can_all_be_joined(
    postures: int, degrees: list[int], tmp_path: Path, capsys: Capture
) -> None:
    """On both sides of freezing, too."""
    places = enumerate(directions(postures).tolist())
    rows = [f"{x:.6f},{y:.6f},{z:.6f},p{n},{celsius}" for n, (x, y, z) in places for celsius in degrees]
    table = table_of(tmp_path, "x,y,z,posture,temperature_c", rows)
    assert json.loads(run(capsys, "fit", table, "--json").out)["fit"]["points"] == postures
