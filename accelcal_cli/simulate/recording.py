"""A simulated recording as a stream of chunks, and the truth about it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import RandomState
from numpy.typing import NDArray

from accelcal_cli.core.clock import UniformClock, rate_fraction
from accelcal_cli.core.recording import Chunk, Device, Recording
from accelcal_cli.simulate.sensor import Sensor
from accelcal_cli.simulate.wear import Bout, Wearer

START_US = 1_709_510_400_000_000
"""2024-03-04T00:00:00."""
STILL_SECONDS = 10


@dataclass(frozen=True, slots=True)
class Plan:
    """What to simulate.

    Attributes:
        unit_samples: the number of samples is cut to a multiple of this.
    """

    days: float
    rate_hz: float
    seed: int
    sensor: Sensor
    temperature: bool = True
    unit_samples: int = 1

    @property
    def samples(self) -> int:
        """Number of samples."""
        wanted = round(self.days * 86_400 * self.rate_hz)
        return wanted - wanted % self.unit_samples


@dataclass(slots=True)
class Truth:
    """Errors over the motionless 10 s stretches, before and with the true parameters [mg]."""

    stretches: int = 0
    before: list[float] = field(default_factory=list)
    after: list[float] = field(default_factory=list)

    def see(self, counts: NDArray[np.int16], warm: NDArray[np.float64], sensor: Sensor) -> None:
        """Take one motionless stretch in."""
        mean = counts.mean(axis=0) / sensor.lsb_per_g
        moved = mean + sensor.offset_g + sensor.slope_g_per_c * (warm.mean() - sensor.reference_c)
        self.stretches += 1
        self.before.append(abs(float(np.sqrt((mean**2).sum())) - 1) * 1000)
        self.after.append(abs(float(np.sqrt(((sensor.gain @ moved) ** 2).sum())) - 1) * 1000)

    def as_json(self) -> dict[str, Any]:
        """The truth file's `still` object."""
        means = [sum(v) / len(v) if v else None for v in (self.before, self.after)]
        return {
            "stretches": self.stretches,
            "seconds": STILL_SECONDS,
            "before_mg": means[0],
            "with_true_parameters_mg": means[1],
        }


def describe(plan: Plan, path: Path, format_name: str) -> Recording:
    """The recording that a writer is to describe."""
    return Recording(
        path=path,
        format=format_name,
        rate_hz=plan.rate_hz,
        lsb_per_g=plan.sensor.lsb_per_g,
        total_bytes=0,
        device=Device("simulated", f"SIM{plan.seed:05d}", None),
        range_g=plan.sensor.range_g,
        start_us=START_US,
        samples=plan.samples,
        has_temperature=plan.temperature,
    )


def stream(plan: Plan, truth: Truth) -> Iterator[Chunk]:
    """Chunks of a plan, one a bout; fills `truth` on the way."""
    noise = RandomState(plan.seed + 1_000_003)
    rate = rate_fraction(plan.rate_hz)
    done = 0
    for bout in Wearer(plan.rate_hz, plan.seed).bouts():
        number = min(len(bout.still), plan.samples - done)
        warm = temperature_c(done, number, plan.rate_hz, worn=bout.worn)
        counts = plan.sensor.counts(bout.acceleration[:number], warm, noise)
        _note_stillness(bout, counts, warm, plan, truth)
        yield Chunk(
            done,
            counts,
            UniformClock(START_US, done, rate),
            0,
            temperature_mc=np.rint(warm * 1000).astype(np.int32) if plan.temperature else None,
        )
        done += number
        if done == plan.samples:
            return


def temperature_c(first: int, number: int, rate_hz: float, *, worn: bool) -> NDArray[np.float64]:
    """Skin temperature with a daily and a faster swing; some degrees less off the wrist."""
    seconds = (first + np.arange(number)) / rate_hz
    swing = 3.5 * np.sin(2 * np.pi * (seconds / 86_400 - 0.2)) + 1.2 * np.sin(2 * np.pi * seconds / 5400)
    return np.asarray(29.0 + swing - (0.0 if worn else 5.0))


def _note_stillness(
    bout: Bout, counts: NDArray[np.int16], warm: NDArray[np.float64], plan: Plan, truth: Truth
) -> None:
    length = round(STILL_SECONDS * plan.rate_hz)
    at = np.flatnonzero(bout.still[: len(counts)])
    if not len(at):
        return
    for start in range(int(at[0]), len(counts) - length + 1, length):
        truth.see(counts[start : start + length], warm[start : start + length], plan.sensor)
