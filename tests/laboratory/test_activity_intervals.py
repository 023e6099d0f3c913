"""Intervals of measures of activity hold what the true parameters would show: in 200 simulated situations.

Few and many orientations, a sensor with and without temperature slopes, and rests that scatter by 0.3, 1.5
and 4 mg, in turn; rest and movement of all strengths, so that many epochs are near the threshold of MVPA.
`python -m tests.laboratory.test_activity_intervals 200` prints the figures of docs/effect.md.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from accelcal_cli.activity_effect import effect
from accelcal_cli.core.clock import UniformClock, rate_fraction
from accelcal_cli.core.recording import Chunk
from accelcal_cli.formats import named_encoder
from accelcal_cli.laboratory.segments import Population
from accelcal_cli.pipeline.jobs import Request
from accelcal_cli.simulate import SimulatedSensor, SimulationPlan, describe

RATE_HZ = 10.0
EPOCH, REST, MOVED = (seconds * int(RATE_HZ) for seconds in (1, 60, 60))
SCATTER_MG = (0.3, 1.5, 4.0)
MEASURES = ("enmo_mg", "mad_mg", "mvpa_min", "pim_mg_s", "zcm", "angle_deg")


def drawn_sensor(random: np.random.Generator, *, warm: bool) -> SimulatedSensor:
    worn = Population().draw(random)
    slopes = random.standard_normal(3) / 1000 if warm else np.zeros(3)
    return SimulatedSensor(worn.gain, worn.offset_g, slopes, 0.003, 256.0, 8.0)


def wear(random: np.random.Generator, orientations: int, scatter_mg: float) -> np.ndarray:
    """True acceleration of visits to some orientations, each with rest and then movement."""
    posture = random.standard_normal((orientations, 3))
    posture /= np.linalg.norm(posture, axis=1, keepdims=True)
    parts = []
    for visit in range(max(40, orientations)):
        direction = posture[visit % orientations]
        rest = np.tile(direction * (1 + scatter_mg / 1000 * random.standard_normal()), (REST, 1))
        time = np.arange(MOVED) / RATE_HZ
        size = np.repeat(random.uniform(0.02, 0.7, MOVED // EPOCH), EPOCH)
        swing = size * np.sin(2 * np.pi * random.uniform(0.3, 3) * time)
        shaken = size[:, np.newaxis] / 3 * random.standard_normal((MOVED, 3))
        parts += [rest, direction * (1 + swing)[:, np.newaxis] + shaken]
    return np.concatenate(parts)


def simulated(path: Path, number: int) -> None:
    """Write the recording of a situation, and its truth beside it."""
    random = np.random.default_rng(number)
    many, warm, scatter_mg = number % 2 == 0, number // 2 % 2 == 0, SCATTER_MG[number // 4 % 3]
    sensor = drawn_sensor(random, warm=warm)
    true = wear(random, int(random.integers(30, 60) if many else random.integers(6, 12)), scatter_mg)
    celsius = 30 + 4 * np.sin(np.arange(len(true)) / 5000) if warm else np.full(len(true), 30.0)
    counts = sensor.counts(true, celsius, np.random.RandomState(number))
    plan = SimulationPlan(len(true) / RATE_HZ / 86_400, RATE_HZ, number, sensor)
    chunk = Chunk(
        0,
        counts,
        UniformClock(0, 0, rate_fraction(RATE_HZ)),
        0,
        temperature_mc=np.rint(1000 * celsius).astype(np.int32),
    )
    named_encoder("flash").write(path, describe(plan, path, "flash"), iter([chunk]))
    path.with_name(f"{path.stem}.truth.json").write_text(json.dumps({"sensor": sensor.as_json()}))


def held(numbers: range, folder: Path) -> Iterator[dict[str, float]]:
    """Yield for each situation with a calibration: 1 for a measure whose interval holds the truth, else 0."""
    for number in numbers:
        path = folder / f"{number}.bin"
        simulated(path, number)
        found = effect(path, Request(threads=1), epoch_s=1)["effect"]
        path.unlink()
        if (intervals := found["ci95"]) is None:
            continue
        true = found["versions"]["true"]
        yield {name: float(low <= true[name] <= high) for name, (low, high) in intervals.items()} | {
            "width": intervals["enmo_mg"][1] - intervals["enmo_mg"][0],
            "raw": found["raw_bias"]["enmo_mg"]["value"],
            "many": number % 2 == 0,
        }


def test_51_1_intervals_hold_the_truth(tmp_path: Path) -> None:
    found = list(held(range(12), tmp_path))
    assert len(found) >= 10
    for name in MEASURES:
        assert sum(one[name] for one in found) >= len(found) - 3, name


@pytest.mark.nightly
def test_51_1_intervals_hold_the_truth_in_200_situations(tmp_path: Path) -> None:
    found = list(held(range(1000, 1200), tmp_path))
    assert len(found) >= 180
    for name in ("enmo_mg", "mad_mg", "mvpa_min"):
        assert 0.90 <= np.mean([one[name] for one in found]) <= 0.99, name


if __name__ == "__main__":
    with TemporaryDirectory() as place:
        results = list(held(range(1000, 1000 + int(sys.argv[1])), Path(place)))
    for group in (None, True, False):
        chosen = [one for one in results if group is None or one["many"] is group]
        figures = {name: round(100 * float(np.mean([one[name] for one in chosen])), 1) for name in MEASURES}
        width, raw = (float(np.median([abs(one[key]) for one in chosen])) for key in ("width", "raw"))
        print(group, len(chosen), figures, f"width {width:.3f} mg, raw {raw:.2f} mg")
