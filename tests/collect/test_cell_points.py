"""Where cells are more than points may be: which are joined, and where what they hold together lies."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from accelcal_cli.collect import cell_points
from accelcal_cli.collect.cell_points import MAX_POINTS, Sums, Width, points_of, width_for
from accelcal_cli.collect.cells import CellCollector
from accelcal_cli.core.fixed import ONE
from accelcal_cli.core.points import WEIGHT_ONE, Windows
from accelcal_cli.core.settings import DEFAULT
from tests.cli.run import run
from tests.collect.made import plain, windows

Capture = pytest.CaptureFixture[str]

LENGTH = 8
NUMBER = 600


def sphere(number: int) -> NDArray[np.float64]:
    """Directions that cover it evenly."""
    index = np.arange(number) + 0.5
    z, turn = 1 - 2 * index / number, 2.399963 * index
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)


def many_cells(temperatures: range = range(20_000, 21_000, 1000)) -> Windows:
    """Windows all over the sphere, one for each temperature [thousandths of a degree C]."""
    sums = np.rint(sphere(NUMBER) * 256 * LENGTH).astype(np.int64)
    warm = np.tile(np.array(temperatures) * LENGTH, NUMBER)
    return windows(
        LENGTH, np.repeat(sums, len(temperatures), axis=0).tolist(), temperature_sums=warm.tolist()
    )


def collected(items: Windows, *, temperature: bool = False) -> CellCollector:
    held = CellCollector(256.0, DEFAULT, temperature=temperature)
    held.add(items)
    return held


@pytest.mark.parametrize("limit", [599, 200, 60, 8])
def test_wider_cells_lose_no_window_and_lie_where_these_do(
    limit: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    items = many_cells()
    held = collected(items)
    assert len(held.points()) == NUMBER
    monkeypatch.setattr(cell_points, "MAX_POINTS", limit)
    points = held.points()
    assert 8 <= len(points) <= limit
    number, means = held.fates(items).point, items.sums / (256 * LENGTH)
    for point, place in enumerate(points.xyz_g()):
        parts = means[number == point]
        assert len(parts) == points.windows[point] > 0
        assert np.linalg.norm(place) == pytest.approx(np.sqrt((parts**2).sum(axis=1).mean()), abs=1e-7)
        assert np.cross(place, parts.mean(axis=0)) == pytest.approx(np.zeros(3), abs=1e-7)
    assert points.windows.sum() == NUMBER


def test_two_directions_by_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of (1, 0, 0) for two samples and (0, 1, 0) for one: between them, and as long as they are."""
    monkeypatch.setattr(cell_points, "MAX_POINTS", 1)
    cells = {
        (0, 1, 0, 0): Sums(1, 2, (512, 0, 0), 2 * 20_000, (2 * 64, 0, 0)),
        (1, 0, 0, 0): Sums(1, 1, (0, 256, 0), 26_000, (4 * 64, 0, 0)),
    }
    keys, points = points_of(
        cells, width_for(cells), lambda held: [WEIGHT_ONE] * len(held), 256.0, temperature=True
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
        monkeypatch.setattr(cell_points, "MAX_POINTS", limit * NUMBER)
        points = held.points()
        assert len(points) == degrees * NUMBER
        assert points.windows.sum() == 16 * NUMBER
        assert points.xyz[::degrees].tolist() == alone
    monkeypatch.setattr(cell_points, "MAX_POINTS", 3 * NUMBER - 1)
    assert len({tuple(key[:3]) for key in wide_keys(items)}) < NUMBER, "eight degrees are the most"


def wide_keys(items: Windows) -> list[tuple[int, ...]]:
    """Cells as wide as they have to be, of windows at 20 to 35 degrees."""
    sums = (items.sums * 20 // (256 * LENGTH)).tolist()
    cells = {(*place, 20 + n % 16): Sums(1, 1, (0, 0, 256)) for n, place in enumerate(sums)}
    width = width_for(cells)
    assert width.degrees <= cell_points.FEW_DEGREES
    return [*{width.of(key) for key in cells}]


@pytest.mark.parametrize("directions", [2000, 2500, 3500])
def test_slopes_stay_known_where_each_direction_has_all_temperatures(
    directions: int, tmp_path: Path, capsys: Capture
) -> None:
    """Each at 16 to 31 degrees: too many cells, of one mean temperature; of many, wide from the start."""
    warm = np.tile(np.arange(16.5, 32), directions)
    slopes = np.array([0.001, -0.001, 0.0005])
    g = np.repeat(sphere(directions), 16, axis=0) - np.outer(warm - 26, slopes)
    table = tmp_path / "warm.csv"
    np.savetxt(table, np.column_stack([g, warm]), "%.7f", ",", header="x,y,z,temperature_c", comments="")
    report = json.loads(run(capsys, "fit", table, "--json").out)
    assert report["calibration"]["model"] == "9T"
    assert report["calibration"]["temperature"]["slope_g_per_c"] == pytest.approx(slopes, abs=2e-5)


def test_merged_collectors_are_made_wider_like_the_batch(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cell_points, "MAX_POINTS", 100)
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
    """Numbers before the last four, as of postures, keep cells apart, however wide these become."""
    monkeypatch.setattr(cell_points, "MAX_POINTS", 100)
    sums = np.rint(sphere(200) * 256).astype(int).tolist()
    cells = {(n % 2, *(v // 13 for v in g), n): Sums(1, 1, (g[0], g[1], g[2])) for n, g in enumerate(sums)}
    width = width_for(cells)
    keys, points = points_of(cells, width, lambda held: [WEIGHT_ONE] * len(held), 256.0, temperature=False)
    assert 16 < len(keys) <= 100, "16 would be octants"
    first = np.array([key[0] for key in keys]) == 0
    assert points.windows[first].sum() == points.windows[~first].sum() == 100


def test_the_widest_cells_are_taken_where_all_are_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cell_points, "MAX_POINTS", 3)
    cells = [(posture, 0, 0, 0, 0) for posture in range(9)]
    assert width_for(cells) == Width(cell_points.MOST_SPACE, cell_points.ALL_DEGREES)


@pytest.mark.parametrize("temperature", [False, True])
def test_a_wrist_that_was_everywhere_is_calibrated_as_well(
    temperature: bool, tmp_path: Path, capsys: Capture
) -> None:
    """Means of a known sensor all over the sphere, without noise, that fill more cells than points may be."""
    truth, offset = (
        np.array([[1.02, 0, 0], [0.01, 0.97, 0], [-0.02, 0.015, 1.01]]),
        np.array([0.03, -0.02, 0.01]),
    )
    g = sphere(6000) @ np.linalg.inv(truth).T - offset
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
    table = tmp_path / "many.csv"
    g = sphere(postures * each) * [0.98, 1.02, 1.01] + [0.02, -0.03, 0.01]
    rows = [f"{x:.6f},{y:.6f},{z:.6f},p{n % postures}" for n, (x, y, z) in enumerate(g.tolist())]
    table.write_text("\n".join(["x,y,z,posture", *rows]) + "\n")
    done = run(capsys, "fit", table)
    said = "combinations of posture, direction and temperature, and a fit takes at most 4096 points"
    hint = "leave out the column posture, or average rows that are alike"
    assert done.code == 3 and done.err.endswith(f" {said}; {hint}\n") and done.err.count("\n") == 1
    assert done.err.startswith(f"accelcal: {table}: holds ")


def test_temperatures_of_a_posture_can_all_be_joined(tmp_path: Path, capsys: Capture) -> None:
    """On both sides of freezing, too."""
    table = tmp_path / "cold.csv"
    rows = [f"{x:.6f},{y:.6f},{z:.6f},p{n}" for n, (x, y, z) in enumerate(sphere(3000).tolist())]
    lines = [f"{row},{celsius}" for row in rows for celsius in (-5, 5)]
    table.write_text("\n".join(["x,y,z,posture,temperature_c", *lines]) + "\n")
    assert json.loads(run(capsys, "fit", table, "--json").out)["fit"]["points"] == 3000


def test_as_many_postures_as_points_are_fitted(tmp_path: Path, capsys: Capture) -> None:
    rows = [f"{x:.6f},{y:.6f},{z:.6f},p{n}" for n, (x, y, z) in enumerate(sphere(MAX_POINTS).tolist())]
    table = tmp_path / "many.csv"
    table.write_text("\n".join(["x,y,z,posture", *rows]) + "\n")
    assert json.loads(run(capsys, "fit", table, "--json").out)["fit"]["points"] == MAX_POINTS
