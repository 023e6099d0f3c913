"""Studies of any size without a calibration: reports varied from one real one, through the real summary."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from datetime import datetime, timedelta
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import accelcal
from accelcal_cli.pipeline.jobs import Job
from accelcal_cli.studies import summary
from accelcal_cli.studies.records import Item
from tests.recordings import directions, still_counts, write_raw

BEGIN = datetime(2025, 1, 6, 9, 30)
A_DEVICE = 8
"""Recordings of each device, one a month."""
DRIFTING = 40
"""Of so many devices one drifts, by 3 mg a month."""

FAILED, REFUSED, CHANGED, DAMAGED, UNCERTAIN = 50, 20, 33, 47, 61
"""Of so many recordings one is so; what comes first here counts."""
VARIED = ("recording", "calibration", "change", "file_health")
"""Sections of a report that are written into."""


@cache
def base_report() -> dict[str, Any]:
    """The report of a recording that was really calibrated."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.raw"
        write_raw(path, still_counts(directions(60)))
        report: dict[str, Any] = copy.deepcopy(dict(accelcal.calibrate(path).report))
    return report


def item(name: str) -> Item:
    """A file of the study."""
    path = Path(name)
    return Item(name, Job(path, path.with_suffix(".calibrated.parquet"), path), ((4_000_000, 0),))


def report_of(number: int, random: np.random.RandomState) -> tuple[int, dict[str, Any]]:
    """Exit code and report of one recording."""
    base = base_report()
    report = base | {name: copy.deepcopy(base[name]) for name in VARIED}
    device, month = divmod(number, A_DEVICE)
    recording = report["recording"]
    recording["device"] = {"model": "AX3", "serial": f"{60_000 + device}", "firmware": "47"}
    begin = BEGIN + timedelta(days=30 * month, minutes=number % 600)
    begin = BEGIN + timedelta(days=30 * month, minutes=number % 600)
    recording["start_time"] = begin.isoformat(timespec="microseconds")
    recording["sha256"] = f"{number:064x}"
    recording["duration_s"] = 604_800.0 + number
    for axis in range(3):
        drift = 0.003 * month if axis == 0 and device % DRIFTING == 0 else 0.0
        report["calibration"]["offset_g"][axis] += 1e-4 * random.randn() + drift
    after, before = float(np.exp(0.4 * random.randn() - 1)), float(np.exp(0.3 * random.randn() + 3.5))
    error = {"mean": after, "ci95": [0.5 * after, 2 * after], "worst_direction": 1.5 * after}
    report["calibration_error_mg"] = base["calibration_error_mg"] | error | {"before": before}
    report["values"] = base["values"] | {"raw_mg": before, "error_mg": after}
    return _troubled(number, report)


def _troubled(number: int, report: dict[str, Any]) -> tuple[int, dict[str, Any]]:
    if number % REFUSED == 1:
        postures = 2 + number % 5
        report |= {"outcome": "refused", "calibration": None, "calibration_error_mg": None, "holdout": None}
        report |= {"reason": "too_few_orientations", "values": {"orientations": postures, "needed": 6}}
        report |= {"notes": [], "cautions": [], "advice": [{"code": "record_longer", "values": {}}]}
        return 4, report
    if number % CHANGED == 2:
        size = 5 + number % 40
        report["change"] |= {
            "kind": "step",
            "at": "2025-01-10T14:00:00.000000",
            "size_mg": size,
            "unchecked": None,
        }
    if number % DAMAGED == 3:
        report["file_health"]["lost_percent"] = 0.1 + number % 17
    if number % UNCERTAIN == 4:
        report["calibration_error_mg"]["ci95"][1] = 10.5 + number % 9
    return 0, report


def rows(count: int, seed: int = 1) -> Iterator[dict[str, Any]]:
    """Rows of the table, as a study makes them."""
    random = np.random.RandomState(seed)
    for number in range(count):
        name = f"site{number % 12:02}/S{number:05}_wrist_week{number % A_DEVICE}.cwa"
        if number % FAILED == 0:
            text = f"{name}, byte {1024 * number}: is not an Axivity .cwa recording (0 sectors examined)"
            yield summary.failed(item(name), 3, f"{text}; copy it again from the device")
            continue
        code, report = report_of(number, random)
        stem = name.removesuffix(".cwa")
        parquet = f"{stem}.calibrated.parquet" if code == 0 else None
        yield summary.of_report(
            item(name), code, report, {"parquet": parquet, "report": f"{stem}.calibration.json"}
        )


def study(out: Path, table: list[dict[str, Any]]) -> Path:
    """`study.parquet`, `study.csv` and `study.json` of these rows in a folder; returns the folder."""
    out.mkdir(parents=True, exist_ok=True)
    summary.write(summary.Summary(sorted(table, key=lambda row: str(row["path"])), {}), out, "study")
    return out
