"""The posture before each window, against its definition window by window."""

from __future__ import annotations

import numpy as np
import pytest

from accelcal_cli.collect.cells import CellCollector
from accelcal_cli.collect.previous import PreviousPosture
from accelcal_cli.core.fixed import ONE
from accelcal_cli.core.points import Windows
from accelcal_cli.core.settings import DEFAULT

LSB_PER_G, SAMPLES = 1000.0, 100


def windows(means: np.ndarray, first: int = 0) -> Windows:
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
    cells = [np.floor(part / 100).astype(np.int64) for part in parts]
    found = np.concatenate([one.of(windows(part), cell) for part, cell in zip(parts, cells, strict=True)])
    at_once = PreviousPosture().of(windows(means), np.concatenate(cells))
    assert found.tolist() == at_once.tolist()
    within = np.abs(found - by_definition(means)).max(axis=1)
    assert (within <= 20).all(), "cells are runs of windows whose first and last are looked at"
    assert (within == 0).mean() > 0.9


def test_a_run_in_one_cell_goes_on_in_the_next_batch() -> None:
    """Windows at 60, 0.5, 13 and 16.8 degrees and at 90: the third and fourth are of the second's cell."""
    angles = np.radians([60, 0.5, 13.0, 16.8, 90])
    means = np.rint(1000 * np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=1))
    cells = np.array([[0], [1], [1], [1], [2]])
    whole = PreviousPosture().of(windows(means), cells).tolist()
    for cut in range(1, 5):
        one = PreviousPosture()
        parts = [one.of(windows(means[part]), cells[part]).tolist() for part in (slice(cut), slice(cut, 5))]
        assert parts[0] + parts[1] == whole
    assert whole[4] == means[3].tolist()


def fixed(vector: list[int]) -> list[int]:
    return [round(value / LSB_PER_G * ONE) for value in vector]


def test_points_have_the_mean_of_the_postures_before_their_windows() -> None:
    up, down, left = [0, 0, 1010], [0, 0, -990], [1005, 0, 0]
    collector = CellCollector(LSB_PER_G, DEFAULT, temperature=False)
    collector.add(windows(np.array([up, up, down, left])))
    collector.add(windows(np.array([up, down, down]), 4))
    held = collector.points()
    assert held.previous is not None
    found = {
        tuple(xyz): previous for xyz, previous in zip(held.xyz.tolist(), held.previous.tolist(), strict=True)
    }
    assert found[tuple(fixed(left))] == fixed(down)
    assert found[tuple(fixed(down))] == fixed(up)
    assert np.abs(np.array(found[tuple(fixed(up))]) - (np.array(fixed(up)) * 2 + fixed(left)) / 3).max() <= 1
