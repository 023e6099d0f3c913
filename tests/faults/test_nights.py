"""A study of a lab through many nights, each of which must end as a fresh study of the same files."""

from __future__ import annotations

import os
import random
import time
from pathlib import Path

import pytest

from tests.cli.run import nightly
from tests.faults.nights import Lab, Nights, year
from tests.faults.shim import Runner


@pytest.mark.parametrize(
    ("nights", "recordings", "words"), [(12, 5, ()), nightly(60, 12, ("--html",)), nightly(60, 60, ())]
)
def test_each_night_ends_as_a_fresh_study_of_the_same_files(
    quick_runner: Runner, tmp_path: Path, nights: int, recordings: int, words: tuple[str, ...]
) -> None:
    seed = int(os.environ.get("ACCELCAL_NIGHTS_SEED", time.time_ns() % 1_000_000 if nights > 12 else 1))
    print(f"ACCELCAL_NIGHTS_SEED={seed}")
    one = Nights(Lab(tmp_path / "lab", random.Random(seed)), quick_runner, words)
    happened = [*year(one, nights, recordings)]
    assert len(happened) == nights, happened
