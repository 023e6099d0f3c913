"""A sensor that changes while it records: in the report, at the terminal and in the table of a study."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from tests.cli.run import run
from tests.recordings import GAIN, LSB_PER_G, OFFSET_G, directions, write_raw

Capture = pytest.CaptureFixture[str]
RATE_HZ, HOURS, HOUR = 0.5, 24, 1800
STEP_G = np.array([0.012, -0.010, 0.012])


def long_raw(path: Path, changed_at_h: int | None) -> Path:
    """A day at half a hertz with a new posture every ten minutes; it begins at midnight."""
    poses = np.repeat(directions(6 * HOURS), HOUR // 6, axis=0)
    raw = poses @ np.linalg.inv(GAIN).T - OFFSET_G
    if changed_at_h is not None:
        raw[changed_at_h * HOUR :] += STEP_G
    noise = 0.003 * np.random.RandomState(4).standard_normal(raw.shape)
    write_raw(path, np.rint((raw + noise) * LSB_PER_G).astype(np.int16))
    layout = path.with_name(path.stem + ".layout.toml")
    layout.write_text(layout.read_text().replace("rate_hz = 25.0", f"rate_hz = {RATE_HZ}"))
    return path


def test_a_step_in_the_offsets_is_told_with_its_time(tmp_path: Path, capsys: Capture) -> None:
    path = long_raw(tmp_path / "jumps.raw", 14)
    ran = run(capsys, "calibrate", path, "--report-only", "--json")
    report = json.loads(ran.out)
    change = report["change"]
    assert (change["kind"], change["at"]) == ("step", "2024-03-04T14:00:00.000000")
    assert change["offset_mg"] == pytest.approx((12, -10, 12), abs=1)
    assert "the sensor changes while it records: its offsets jump at 2024-03-04T14:00:00" in report["message"]
    for size in ("500", "1799", "100000"):
        again = run(capsys, "calibrate", path, "--report-only", "--json", "--force", "--chunk-samples", size)
        assert json.loads(again.out)["change"] == change


def test_a_sensor_that_stays_as_it_is_is_said_to(tmp_path: Path, capsys: Capture) -> None:
    ran = run(capsys, "calibrate", long_raw(tmp_path / "same.raw", None), "--report-only", "--json")
    report = json.loads(ran.out)
    assert report["change"]["kind"] == "none" and "changes" not in report["message"]
    assert report["change"]["holdout"]["stretches"] == 24
    assert report["change"]["holdout"]["constant_mg"] < 1.5


def test_the_table_of_a_study_has_it(tmp_path: Path, capsys: Capture) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    long_raw(folder / "jumps.raw", 14)
    long_raw(folder / "same.raw", None)
    run(capsys, "study", folder, "-d", tmp_path / "out", "--report-only", "-j", "1")
    rows = list(csv.DictReader((tmp_path / "out" / "study.csv").read_text().splitlines()))
    assert [(row["path"], row["change"], row["change_at"]) for row in rows] == [
        ("jumps.raw", "step", "2024-03-04T14:00:00.000000"),
        ("same.raw", "none", ""),
    ]
    assert float(rows[0]["change_mg"]) == pytest.approx(19.6, abs=1)
