"""A run that is killed before any operation leaves nothing torn, and the next ends as an undisturbed one."""

from __future__ import annotations

import os
import random
import time
from pathlib import Path

import pytest

from tests.faults.kills import VICTIMS, Killing, Victim
from tests.faults.shim import running


@pytest.mark.parametrize("name", ["study"])
def test_killed_some_times(tmp_path: Path, name: str) -> None:
    strike(next(one for one in VICTIMS if one.name == name), tmp_path, 3, seed=1)


@pytest.mark.nightly
@pytest.mark.parametrize("victim", VICTIMS, ids=lambda one: one.name)
def test_killed_often(tmp_path: Path, victim: Victim) -> None:
    seed = int(os.environ.get("ACCELCAL_KILLS_SEED", time.time_ns() % 1_000_000))
    print(f"ACCELCAL_KILLS_SEED={seed}")
    strike(victim, tmp_path, round(200 * victim.share), seed)


def strike(victim: Victim, folder: Path, times: int, seed: int) -> None:
    with running(folder / "shim", forked=True) as runner:
        if runner is None:
            pytest.skip("needs Linux and a C compiler (cc)")
        killing = Killing(victim, folder / "stage", runner)
        killing.kill(times, random.Random(seed))
        assert killing.kills == times
        assert killing.ends
