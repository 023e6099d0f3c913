"""Small recordings of devices with a serial number and a thermometer, and reports made by hand."""

from __future__ import annotations

import json
import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from accelcal_cli.pipeline.calibrate import calibrate
from accelcal_cli.pipeline.jobs import Request, plan
from tests.recordings import GAIN, LSB_PER_G, OFFSET_G, RATE_HZ, SECONDS, START, directions

SLOPE_G_PER_C = np.array([0.0009, -0.0006, 0.0012])
REFERENCE_C = 25.0
ONE = 1 << 29


def rest(poses: np.ndarray, seed: int = 1, warm: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Raw values (n, 3) [g] of a sensor with known errors that rests in each pose, and temperatures [C]."""
    samples = round(SECONDS * RATE_HZ)
    heat = np.repeat(20.0 + 15.0 * np.random.RandomState(seed).rand(len(poses)), samples).round(2)
    held = np.repeat(poses @ np.linalg.inv(GAIN).T - OFFSET_G, samples, axis=0)
    if warm:
        held = held - SLOPE_G_PER_C * (heat - REFERENCE_C)[:, None]
    return held + 0.003 * np.random.RandomState(seed).randn(*held.shape), heat


def write_device(
    path: Path,
    values_g: np.ndarray,
    heat_c: np.ndarray | None = None,
    *,
    serial: str | None = "A1",
    model: str | None = None,
    lsb_per_g: float = LSB_PER_G,
    start: str = START,
) -> Path:
    """A headerless dump with its layout beside it; heat in hundredths of a degree."""
    counts = np.rint(values_g * lsb_per_g)[:, :3]
    columns = [counts] if heat_c is None else [counts, np.rint(heat_c * 100)[:, None]]
    path.write_bytes(np.hstack(columns).astype("<i2").tobytes())
    said = {"rate_hz": RATE_HZ, "lsb_per_g": lsb_per_g, "range_g": 8.0, "start_time": start}
    said |= {"serial": serial} if serial else {}
    said |= {"model": model} if model else {}
    fields = [f"{axis} = {{ offset = {2 * index}, type = 'int16' }}" for index, axis in enumerate("xyz")]
    if heat_c is not None:
        fields.append("temperature = { offset = 6, type = 'int16', per_unit = 0.01 }")
    lines = ["[dump]", *(f"{key} = {value!r}" for key, value in said.items()), "[fields]", *fields]
    path.with_name(path.stem + ".layout.toml").write_text("\n".join(lines) + "\n")
    return path


def week(path: Path, seed: int = 1, *, poses: int = 40, warm: bool = False, **device: object) -> Path:
    """One recording of a device that can be calibrated."""
    values, heat = rest(directions(poses), seed, warm)
    return write_device(path, values, heat if warm else None, **device)


@cache
def _donor_files(warm: bool) -> dict[str, bytes]:
    with tempfile.TemporaryDirectory() as name:
        path = week(Path(name) / "donor.raw", warm=warm)
        (job,) = plan([path], None, None)
        calibrate(job, Request())
        return {made.name: made.read_bytes() for made in Path(name).iterdir()}


def donor(folder: Path, *, warm: bool = False) -> Path:
    """A calibrated recording of device A1 with all its outputs; returns its report."""
    for name, data in _donor_files(warm).items():
        (folder / name).write_bytes(data)
    return folder / "donor.calibration.json"


def edit(path: Path, change: object) -> Path:
    """Change a report's JSON in place by a function of it."""
    report = json.loads(path.read_text())
    change(report)
    path.write_text(json.dumps(report))
    return path


def set_coefficients(report: dict, gain: np.ndarray, offset_g: np.ndarray, model: str = "12") -> None:
    """Put a calibration without temperature into a report, by hand: numbers and integers alike."""
    gain, offset_g = np.rint(gain * ONE) / ONE, np.rint(offset_g * ONE) / ONE
    places = {"k_xx": (0, 0), "k_yy": (1, 1), "k_zz": (2, 2), "k_yx": (1, 0), "k_zx": (2, 0), "k_zy": (2, 1)}
    above = {"k_xy": (0, 1), "k_xz": (0, 2), "k_yz": (1, 2)}
    named = {name: float(gain[place]) for name, place in places.items()}
    named |= {f"o{axis}": float(value) for axis, value in zip("xyz", offset_g, strict=True)}
    upper = {name: float(gain[place]) for name, place in above.items()}
    upper = upper if any(upper.values()) else {}
    integers = {name: round(value * ONE) for name, value in named.items()} | {"sx": 0, "sy": 0, "sz": 0}
    integers |= {name: round(value * ONE) for name, value in upper.items()}
    report["calibration"] |= {
        "model": model,
        "gain": gain.tolist(),
        "offset_g": offset_g.tolist(),
        "parameters": named | upper,
        "temperature": None,
        "bend": None,
    }
    report["calibration"]["fixed_point"] |= {
        "parameters": integers,
        "temperature_reference_mc": None,
        "temperature_span_c": None,
        "bend": [0, 0, 0],
    }
