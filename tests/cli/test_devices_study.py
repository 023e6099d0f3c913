"""From recordings of a device whose errors change to its drift."""

from __future__ import annotations

import json
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from tests.cli.run import run
from tests.cli.studies import study
from tests.recordings import GAIN, LSB_PER_G, OFFSET_G, RATE_HZ, SECONDS, START, directions

Capture = pytest.CaptureFixture[str]
DRIFT_MG = np.array([6.0, 0.0, -3.0])
"""A month."""


def write_month(folder: Path, serial: str, month: int, drift_mg: np.ndarray) -> None:
    """A recording of the device in a month, with its layout beside it."""
    offset = OFFSET_G + month * drift_mg / 1000
    held = np.repeat(directions(40) @ np.linalg.inv(GAIN).T - offset, round(SECONDS * RATE_HZ), axis=0)
    noise = np.random.RandomState(month + 10 * len(serial) + int(drift_mg.any())).randn(*held.shape)
    held = held + 0.003 * noise
    path = folder / f"{serial}-{month}.raw"
    path.write_bytes(np.rint(held * LSB_PER_G).astype("<i2").tobytes())
    begin = (datetime.fromisoformat(START) + timedelta(days=month * 365.25 / 12)).isoformat()
    said = f"[dump]\nrate_hz = {RATE_HZ}\nlsb_per_g = {LSB_PER_G}\nrange_g = 8.0\nstart_time = '{begin}'\n"
    fields = "".join(f"{axis} = {{ offset = {2 * n}, type = 'int16' }}\n" for n, axis in enumerate("xyz"))
    path.with_name(path.stem + ".layout.toml").write_text(f"{said}serial = '{serial}'\n[fields]\n{fields}")


def test_a_drift_put_into_recordings_is_found(tmp_path: Path, capsys: Capture) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    for month in range(5):
        write_month(folder, "moves", month, DRIFT_MG)
        write_month(folder, "stays", month, DRIFT_MG * 0)
    assert study(capsys, folder, "-q").code == 0
    told = json.loads(run(capsys, "devices", tmp_path / "out", "--json").out)
    moves, stays = told["devices"]
    assert (moves["serial"], moves["verdict"]) == ("moves", "service")
    assert (stays["serial"], stays["verdict"]) == ("stays", "good")
    for axis, drift in zip("xyz", DRIFT_MG, strict=True):
        found = moves["parameters"][f"offset_{axis}"]["drift"]
        assert abs(found["per_month"] - drift) < 4 * found["error"]
        assert found["error"] < 0.1
        still = stays["parameters"][f"offset_{axis}"]
        assert abs(still["drift"]["per_month"]) < 4 * still["drift"]["error"]
        last = 1000 * OFFSET_G["xyz".index(axis)] + 4 * drift
        assert moves["parameters"][f"offset_{axis}"]["value"] == pytest.approx(last, abs=0.2)
    assert moves["reasons"][0]["text"].startswith(("offset x drifts by +6.0", "offset x drifts by +5.99"))
    assert moves["history"][0]["k_yx"] == pytest.approx(GAIN[1, 0], abs=1e-3)
    assert moves["history"][0]["k_zy"] == pytest.approx(GAIN[2, 1], abs=1e-3)


def test_d13_a_file_is_not_said_to_be_missing(tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "P004.cwa").write_text("x")
    for name, what in (("P004.cwa", "is a file, not the output folder of a study"), ("P5", "does not exist")):
        ran = run(capsys, "devices", tmp_path / name)
        assert ran.code == 2 and f"{name}: {what}; " in ran.err
