"""Tables of studies written by hand, with pyarrow alone."""

from __future__ import annotations

import hashlib
import json
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from accelcal_cli.core.identity import STUDY, identity
from accelcal_cli.core.recording import METADATA_KEY
from accelcal_cli.devices.review import DeviceReview, review
from accelcal_cli.devices.trends import Rules
from accelcal_cli.studies.columns import ALL, NAMES

BEGIN = datetime(2024, 3, 4, 12)
NOW_S = 1_795_000_000.0
"""In November 2026."""
FITTED = {
    "9": ("k_xx", "k_yy", "k_zz", "k_yx", "k_zx", "k_zy", "offset_x_g", "offset_y_g", "offset_z_g"),
    "6": ("k_xx", "k_yy", "k_zz", "offset_x_g", "offset_y_g", "offset_z_g"),
    "3": ("offset_x_g", "offset_y_g", "offset_z_g"),
}
SLOPES = ("slope_x_g_per_c", "slope_y_g_per_c", "slope_z_g_per_c")
IDEAL = {name: float(name[2] == name[3]) for name in (f"k_{a}{b}" for a in "xyz" for b in "xyz")}


def start(day: float) -> str:
    """A start so many days after BEGIN."""
    return (BEGIN + timedelta(days=day)).isoformat(timespec="microseconds")


def fitted(
    serial: str | None, day: float | None, values: dict[str, float] | None = None, **said: Any
) -> dict[str, Any]:
    """The row of a calibrated recording: ideal but for `values`, standard errors 1e-4 (1e-5 of slopes)."""
    when = None if day is None else start(day)
    path = said.get("path", f"{serial}/{when}.cwa")
    row = {"path": path, "outcome": "calibrated", "exit_code": 0, "message": "fitted", "model": "9"}
    row |= {"format": "cwa", "device_model": "AX3", "device_serial": serial, "start_time": when}
    row |= {"before_mg": 40.0, "after_mg": 2.0, "lost_percent": 0.0}
    row |= {"sha256": hashlib.sha256(path.encode()).hexdigest()}
    row |= said
    free = FITTED[row["model"].removesuffix("T")]
    row |= IDEAL | {f"offset_{axis}_g": 0.0 for axis in "xyz"}
    row["offset_x_g"] = 1e-6 * (int(row["sha256"][:4], 16) % 97)
    if row["model"].endswith("T"):
        free = (*free, *SLOPES)
        row |= dict.fromkeys(SLOPES, 0.001) | {"reference_c": said.get("reference_c", 30.0)}
    row |= {f"se_{name}": 1e-5 if name in SLOPES else 1e-4 for name in free}
    return row | (values or {})


def refused(serial: str | None, day: float | None, **said: Any) -> dict[str, Any]:
    """The row of a refused recording."""
    row = dict.fromkeys(FITTED["9"]) | {f"se_{name}": None for name in FITTED["9"]}
    row |= {"outcome": "refused", "exit_code": 4, "model": None, "after_mg": None, "message": "too short"}
    return fitted(serial, day, row) | said


KINDS = {column.name: column.kind for column in ALL}
TYPES = {"text": pa.string(), "whole": pa.int64(), "number": pa.float64()}


def write(out: Path, rows: list[dict[str, Any]]) -> Path:
    """`study.parquet` of these rows in a folder; returns the folder."""
    out.mkdir(parents=True, exist_ok=True)
    kinds = [TYPES[KINDS[name]] for name in NAMES]
    arrays = [
        pa.array([row.get(name) for row in rows], kind) for name, kind in zip(NAMES, kinds, strict=True)
    ]
    with (out / "study.parquet").open("wb") as file:
        about = {METADATA_KEY: json.dumps(identity(STUDY))}
        pq.write_table(pa.table(arrays, names=list(NAMES), metadata=about), file)
    return out


def reviewed(tmp_path: Path, rows: list[dict[str, Any]], **rules: float) -> dict[str, DeviceReview]:
    """The devices of a study of these rows, by serial."""
    found = review(write(tmp_path, rows), Rules(**rules), NOW_S)
    return {one.key.serial: one for one in found.devices}


def good_devices(devices: int = 6, recordings: int = 8, seed: int = 1) -> list[dict[str, Any]]:
    """Devices with random levels and no drift, a recording every 30 days; errors as stated."""
    random = np.random.RandomState(seed)
    rows = []
    for device in range(devices):
        level = 0.005 * random.randn(9)
        for number in range(recordings):
            held = level + 1e-4 * random.randn(9)
            values = {
                name: IDEAL.get(name, 0.0) + value for name, value in zip(FITTED["9"], held, strict=True)
            }
            error = 2.0 + 0.2 * random.rand()
            rows.append(fitted(f"{device:05}", 30.0 * number, values, after_mg=error))
    return rows


def drifting(
    serial: str, per_month: float, recordings: int = 8, name: str = "offset_x_g"
) -> list[dict[str, Any]]:
    """A device of which one parameter drifts [its unit in 30.4375 days], a recording every 30 days."""
    random = np.random.RandomState(len(serial) + recordings)
    rows = []
    for number in range(recordings):
        value = IDEAL.get(name, 0.0) + per_month * 30.0 * number / 30.4375 + 1e-4 * random.randn()
        rows.append(fitted(serial, 30.0 * number, {name: value}))
    return rows
