"""`accelcal evaluate duration`: the error by hours of wear, and what a refused recording lacks."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from accelcal_cli.laboratory.duration import Length, Measured, missing
from tests.cli.run import exit_code, run

Capture = pytest.CaptureFixture[str]


def test_51_3_the_error_falls_with_hours_of_wear(tmp_path: Path, capsys: Capture) -> None:
    folder = tmp_path / "wrist"
    folder.mkdir()
    assert exit_code("simulate", folder / "a.bin", "--days", 0.5, "--rate", 10, "-q") == 0
    assert exit_code("simulate", folder / "b.bin", "--days", 0.003, "--rate", 10, "-q") == 0
    ran = run(capsys, "evaluate", "duration", folder, "--hours", "1,5", "--number", 3, "--json", "-q")
    assert ran.code == 0, ran.err
    found = json.loads(ran.out)
    one, five = found["lengths"]
    assert [one["hours"], five["hours"], five["kind"]] == [1, 5, "simulated, wrist"]
    assert five["usable"] >= one["usable"] and five["error_mg"] < five["raw_mg"] / 5
    segments = [row for row in found["segments"] if row["hours"] == 5]
    assert len(segments) == five["segments"] == 3
    assert five["error_mg"] == pytest.approx(np.mean([row["error_mg"] for row in segments]))
    (refused,) = found["refused"]
    assert refused.endswith("b.bin") and "more usually help" in found["refused"][refused]


def test_51_3_more_hours_are_those_of_the_same_kind() -> None:
    def row(kind: str, hours: float, usable: float) -> Length:
        return Length(kind, hours, 12, usable, 0.0, None, None, None, None)

    short = Measured("a.cwa", "AX3", 2.0, (), "Too few orientations.")
    rows = [row("AX3", 6, 0.5), row("AX3", 12, 0.95), row("AX6", 6, 1.0), row("all", 6, 0.9)]
    assert "segments of 12 h" in missing(short, rows) and "about 10 more" in missing(short, rows)
    assert "about 4 more" in missing(short, rows[2:])
    assert "of 84 h of a GENEActiv" in missing(short, [])
    long = Measured("a.cwa", "AX3", 50.0, (), "The device never rested.")
    assert "length is not what it lacks" in missing(long, rows)


def on_sphere(report: Path) -> tuple[np.ndarray, np.ndarray]:
    made = json.loads(report.read_text())["calibration"]
    offset = np.array(made["offset_g"])
    if made["temperature"] is not None:
        heat = made["temperature"]
        offset = offset + (31 - heat["reference_c"]) * np.array(heat["slope_g_per_c"])
    return np.array(made["gain"]), offset


@pytest.mark.nightly
def test_51_3_direct_cuts_of_a_recording_agree(tmp_path: Path, capsys: Capture, real_data: Path) -> None:
    """Cut by pandas, fitted by `accelcal fit`, and compared over 2000 random directions, by hand."""
    points = real_data / "points" / "geneactiv_84h_points.csv.gz"
    words = ("--table-hours", 84, "--hours", "12", "--number", 7, "--json", "-q")
    ran = run(capsys, "evaluate", "duration", points, *words)
    (told,) = json.loads(ran.out)["lengths"]
    table, errors = pd.read_csv(points), []
    true = np.random.default_rng(1).standard_normal((2000, 3))
    true /= np.linalg.norm(true, axis=1, keepdims=True)
    hour = np.arange(len(table)) / len(table) * 84
    for start in np.linspace(0, 72, 7):
        inside = (hour >= start) & (hour < start + 12)
        made = []
        for name, which in (("cut", inside), ("rest", ~inside)):
            table[which].to_csv(tmp_path / f"{name}.csv", index=False)
            report = tmp_path / f"{name}.json"
            assert exit_code("fit", tmp_path / f"{name}.csv", "-o", report) == 0
            made.append(on_sphere(report))
        (gain, offset), (known, at) = made
        raw = np.linalg.solve(known, true.T).T - at
        errors.append(1000 * np.abs(np.linalg.norm((raw + offset) @ gain.T, axis=1) - 1).mean())
    assert told["error_mg"] == pytest.approx(np.mean(errors), rel=0.1)
