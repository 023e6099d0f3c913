"""Small recordings in all formats, good, damaged and hopeless, and what must become of each."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np

from accelcal_cli.simulate import SimulatedSensor, SimulationPlan, draw_gain_and_offset, simulate

RATES = {"flash": 10.0, "raw": 10.0, "csv": 10.0, "cwa": 12.5, "geneactiv": 10.0, "gt3x": 30.0, "hdf5": 10.0}
"""All that can be written, at the lowest rate that the device knows."""

THERMOMETER = ("cwa", "geneactiv")
"""Those that cannot be without; without temperature there is less to fit."""

HEADER = 2
"""The damage that leaves sectors of a .cwa file readable: it is refused for what is lost."""

GOOD_DAYS, HOPELESS_DAYS = 0.2, 0.02


def simulated(path: Path, kind: str, seed: int, days: float = GOOD_DAYS) -> Path:
    """A recording of a sensor of its own; only the recording and its layout file stay."""
    gain, offset = draw_gain_and_offset(seed, 1.0, 1.0)
    sensor = SimulatedSensor(gain, offset, np.zeros(3), noise_g=0.003, lsb_per_g=256.0, range_g=8.0)
    plan = SimulationPlan(days, RATES[kind], seed, sensor, kind in THERMOMETER)
    path.parent.mkdir(parents=True, exist_ok=True)
    made, _ = simulate(path, kind, plan, force=True, progress=lambda _done: None)
    made.with_name(path.name + ".truth.json").unlink()
    return made


def mixture(folder: Path, good: int, damaged: int, hopeless: int) -> dict[str, str]:
    """Make a folder; returns each recording's outcome by its name below it.

    Forty sensors and wearers: of some others five hours are too few.
    """
    kinds = list(RATES)
    found: dict[str, str] = {}
    for number in range(good):
        made = simulated(
            folder / f"site{number % 3}" / f"good{number:03}", kinds[number % 7], 1 + number % 40
        )
        found[made.relative_to(folder).as_posix()] = "calibrated"
    for number in range(hopeless):
        path = folder / "short" / f"night{number:03}"
        made = simulated(path, kinds[(2 * number) % 7], 1 + number, HOPELESS_DAYS)
        found[made.relative_to(folder).as_posix()] = "refused"
    for number in range(damaged):
        path = _damaged(folder, number, random.Random(number))
        found[path] = "refused" if path.endswith(".cwa") and number % 4 == HEADER else "failed"
    return found


def _damaged(folder: Path, number: int, chance: random.Random) -> str:
    """One file that is beyond reading: cut short, zeroed, its header overwritten, or garbage."""
    kind = ("cwa", "geneactiv", "hdf5", "gt3x")[number // 4 % 4]
    made = simulated(folder / "broken" / f"bad{number:03}", kind, number + 1, HOPELESS_DAYS)
    content = made.read_bytes()
    made.write_bytes(
        (
            content[: chance.randrange(1, 60)],
            bytes(len(content)),
            chance.randbytes(min(20_000, len(content) // 2)) + content[20_000:24_000],
            chance.randbytes(len(content)),
        )[number % 4]
    )
    return made.relative_to(folder).as_posix()
