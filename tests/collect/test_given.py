"""Points from a table: as a recording's windows, or as the table says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from accelcal_cli.collect.cells import CellCollector
from accelcal_cli.collect.table import Table, given_points
from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.points import WEIGHT_ONE
from accelcal_cli.core.settings import DEFAULT
from tests.collect.made import plain, windows

G = 1 << 24


def table(g: list[tuple[float, float, float]], **more: np.ndarray) -> Table:
    return Table(np.rint(np.array(g) * G).astype(np.int64).reshape(-1, 3), **more)


def test_plain_rows_are_collected_like_windows() -> None:
    random = np.random.default_rng(4)
    g = random.standard_normal((400, 3))
    g /= np.linalg.norm(g, axis=1)[:, None]
    warm = random.integers(20_000, 30_000, 400)
    held = Table(np.rint(g * G).astype(np.int64), warm)
    collector = CellCollector(float(G), DEFAULT, temperature=True)
    collector.add(windows(1, held.counts.tolist(), temperature_sums=warm.tolist()))
    given = given_points(held, DEFAULT)
    assert plain(given.points) == plain(collector.points())
    assert given.label is None and given.implausible == 0 and len(given.rows) == 400


def test_rows_far_from_one_g_are_left_out_and_counted() -> None:
    given = given_points(table([(0, 0, 1), (0, 0, 9), (0, 0, 0), (0, 0, 0.4)]), DEFAULT)
    assert (len(given.points), len(given.rows), given.implausible) == (1, 1, 3)


def test_postures_of_the_table_are_kept_apart() -> None:
    posture = np.array([0, 1, 1, 1])
    given = given_points(
        table([(0, 0.01, 1.01), (0, 0.01, 1.01), (0, 0.01, 1.01), (0, 0.06, 1.01)], posture=posture), DEFAULT
    )
    # posture 1 holds two cells of one 2 x 2 x 2 group, which count as one point between them
    assert given.label is not None and given.label.tolist() == [0, 1, 1]
    assert given.points.windows.tolist() == [1, 2, 1]
    assert given.points.weights.tolist() == [WEIGHT_ONE, round(WEIGHT_ONE * 2 / 3), round(WEIGHT_ONE / 3)]


def test_weights_of_the_table_stand() -> None:
    weight = np.array([2.0, 1.0, 1.0])
    given = given_points(table([(0.25, 0.01, 1), (0.28125, 0.01, 1), (0, 1, 0)], weight=weight), DEFAULT)
    order = np.argsort(given.points.xyz[:, 0])
    assert given.points.xyz[order, 0].tolist() == [0, round((2 * 0.25 + 0.28125) / 3 * ONE)]
    # weights 1 and 3 of a mean of 2
    assert (given.points.weights[order] / WEIGHT_ONE).tolist() == [0.5, 1.5]
    assert given.label is None


def test_local_gravity_is_one() -> None:
    place = replace(DEFAULT, latitude=0.0)
    g = float(place.gravity.local_g())
    given = given_points(table([(0, 0, g)]), place)
    assert abs(int(given.points.xyz[0, 2]) - ONE) <= ONE / G


def test_temperature_can_be_left_aside() -> None:
    held = table([(0, 0, 1), (0, 0, 1)], temperature_mc=np.array([20_000, 30_000]))
    assert given_points(held, replace(DEFAULT, temperature=False)).points.tau is None
    given = given_points(held, DEFAULT)
    assert given.points.temperature is not None and given.rows.tau is not None
    span = given.points.temperature.span_c
    assert (given.rows.tau / ONE * span).tolist() == [-5.0, 5.0]


def test_an_empty_table_gives_no_points() -> None:
    empty = Table(np.empty((0, 3), np.int64), weight=np.empty(0))
    assert len(given_points(empty, DEFAULT).points) == 0
