"""Make the recordings of `docs/devices.md`: eight simulated devices, a short recording of each every month.

    python tools/make_fleet.py FOLDER
    accelcal study FOLDER -d OUT --report-only
    accelcal devices OUT

One device's x offset drifts, one loses scale, one has a thermometer that its sensor follows, one is worn for
minutes only, one forgets its date.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from accelcal_cli.simulate import SimulatedSensor, SimulationPlan, simulate

BEGIN = datetime(2025, 3, 3, 18)
MONTHS = 9
DAYS, SHORT_DAYS = 0.5, 0.01
RATE_HZ = 25.0


@dataclass(frozen=True)
class Device:
    """A sensor and what becomes of it in a month."""

    serial: str
    drift_mg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    scale_percent: float = 0.0
    slope_mg_per_c: tuple[float, float, float] = (0.0, 0.0, 0.0)
    short: bool = False
    dated: bool = True


DEVICES = (
    Device("60101"),
    Device("60102", drift_mg=(3.0, 0.0, -0.5)),
    Device("60103"),
    Device("60104", scale_percent=-0.3),
    Device("60105", slope_mg_per_c=(0.9, -0.6, 1.2)),
    Device("60106", short=True),
    Device("60107", dated=False),
    Device("60108"),
)


def main(folder: Path) -> None:
    """Write all recordings."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, device in enumerate(DEVICES):
        random = np.random.RandomState(number)
        gain = (
            np.eye(3)
            + np.diag(random.uniform(-0.02, 0.02, 3))
            + np.tril(random.uniform(-0.01, 0.01, (3, 3)), -1)
        )
        offset = random.uniform(-0.04, 0.04, 3)
        for month in range(MONTHS):
            aged = gain * (1 + month * device.scale_percent / 100 * np.eye(3))
            _write(folder, device, month, aged, offset + month * np.array(device.drift_mg) / 1000, number)


def _write(
    folder: Path, device: Device, month: int, gain: np.ndarray, offset: np.ndarray, number: int
) -> None:
    slope = np.array(device.slope_mg_per_c) / 1000
    sensor = SimulatedSensor(gain, offset, slope, noise_g=0.003, lsb_per_g=256.0, range_g=8.0)
    days = SHORT_DAYS if device.short and month % 3 else DAYS
    plan = SimulationPlan(days, RATE_HZ, 100 * number + month, sensor, temperature=slope.any())
    out = folder / f"{device.serial}-{month + 1:02}"
    simulate(out, "raw", plan, force=True, progress=lambda _: None)
    begin = BEGIN + timedelta(days=month * 365.25 / 12)
    layout = out.with_name(f"{out.name}.layout.toml")
    kept = [line for line in layout.read_text().splitlines() if not line.startswith(("serial", "start_time"))]
    own = [f'serial = "{device.serial}"']
    own += [f'start_time = "{begin.isoformat(timespec="seconds")}"'] if device.dated else []
    at = kept.index("[dump]") + 1
    layout.write_text("\n".join([*kept[:at], *own, *kept[at:]]) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
