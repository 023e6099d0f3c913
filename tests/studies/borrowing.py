"""A study of devices with good recordings and short ones, simulated with known errors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from accelcal_cli.pipeline.jobs import no_progress
from accelcal_cli.simulate import SimulatedSensor, SimulationPlan, draw_gain_and_offset, simulate
from tests.cli.run import report_of

RATE_HZ, LSB_PER_G = 12.0, 256.0
DAY, TWENTY_MINUTES = 1.0, 20 / 1440


def record(
    path: Path,
    *,
    days: float,
    seed: int,
    start: str,
    device: int = 7,
    serial: str = "D7",
    errors: float = 1.0,
) -> Path:
    """A raw dump of one device on one wrist; device number and serial may contradict each other."""
    gain, offset = draw_gain_and_offset(device, errors, 1.0)
    sensor = SimulatedSensor(gain, offset, np.zeros(3), 0.003, LSB_PER_G, 8.0)
    path.parent.mkdir(parents=True, exist_ok=True)
    plan = SimulationPlan(days, RATE_HZ, seed, sensor, temperature=False)
    made, _ = simulate(path, "raw", plan, force=True, progress=no_progress("", 0))
    layout = made.with_name(made.name.removesuffix(".raw") + ".layout.toml")
    text = layout.read_text()
    for key, value in (("serial", serial), ("start_time", start)):
        lines = [line for line in text.splitlines() if line.startswith(key)]
        assert len(lines) == 1
        text = text.replace(lines[0], f'{key} = "{value}"' if value else "")
    layout.write_text(text)
    return made


def report(out: Path, name: str) -> dict[str, Any]:
    return report_of(out / f"{name}.calibration.json")


def own_errors_mg(
    path: Path, calibration: dict[str, Any], rate_hz: float = RATE_HZ
) -> tuple[float, float, int]:
    """Mean | |a| - 1 | over postures before and after, and the number of postures, from the raw dump.

    As the documents say: 5 s windows whose range is below 0.12 g and whose deviation is below 13 mg on every
    axis; means of cells of 1/20 g, by windows within each 2 x 2 x 2 of them; postures of 15 degrees.
    """
    length = round(5 * rate_hz)
    counts = np.fromfile(path, "<i2").reshape(-1, 3)
    windows = counts[: len(counts) // length * length].reshape(-1, length, 3) / LSB_PER_G
    still = ((np.ptp(windows, axis=1) < 0.12) & (windows.std(axis=1) < 0.013)).all(axis=1)
    means = windows[still].mean(axis=1)
    cells, inverse, number = np.unique(
        np.floor(means * 20).astype(int), axis=0, return_inverse=True, return_counts=True
    )
    places = np.array([means[inverse.reshape(-1) == cell].mean(axis=0) for cell in range(len(cells))])
    blocks = np.unique(cells >> 1, axis=0, return_inverse=True)[1].reshape(-1)
    weights = number / np.bincount(blocks, number)[blocks]
    label = _postures(places, number)
    gain, offset = np.array(calibration["gain"]), np.array(calibration["offset_g"])
    errors = [1000 * np.abs(np.linalg.norm(a, axis=1) - 1) for a in (places, (places + offset) @ gain.T)]
    before, after = (
        np.mean([np.average(error[label == one], weights=weights[label == one]) for one in set(label)])
        for error in errors
    )
    return float(before), float(after), len(set(label))


def _postures(places: np.ndarray, number: np.ndarray) -> np.ndarray:
    """The most frequent place leads; each other joins the nearest leader within 15 degrees, or leads."""
    directions = places / np.linalg.norm(places, axis=1, keepdims=True)
    leaders: list[int] = []
    label = np.zeros(len(places), int)
    for index in sorted(range(len(places)), key=lambda index: -number[index]):
        near = [float(directions[leader] @ directions[index]) for leader in leaders]
        if near and max(near) >= np.cos(np.radians(15)):
            label[index] = int(np.argmax(near))
        else:
            label[index] = len(leaders)
            leaders.append(index)
    return label
