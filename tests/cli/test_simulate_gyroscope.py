"""`accelcal simulate --gyro`: three formats hold the same rates, and their truth is found again."""

from __future__ import annotations

import json
import struct
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import joined
from accelcal_cli.formats import open_recording
from accelcal_cli.simulate import GyroSensor, Turning, Wearer
from tests.cli.run import assert_one_line, run

Capture = pytest.CaptureFixture[str]
SUFFIX = {"hdf5": ".h5", "raw": ".raw", "cwa": ".cwa"}


def simulated(capsys: Capture, folder: Path, name: str, *words: object) -> tuple[Path, dict[str, Any]]:
    made = run(capsys, "simulate", folder / name, "--format", name, "--gyro", "-q", "--json", *words)
    assert made.code == 0, made
    truth: dict[str, Any] = json.loads(made.out)
    return folder / (name + SUFFIX[name]), truth


def gyroscope(capsys: Capture, path: Path, *words: object) -> dict[str, Any]:
    told = run(capsys, "calibrate", path, "--report-only", "--json", "-q", *words)
    assert told.code == 0, told
    found: dict[str, Any] = json.loads(told.out)["gyroscope"]
    return found


def test_all_formats_hold_the_same_rates(tmp_path: Path, capsys: Capture) -> None:
    held = []
    for name in SUFFIX:
        path, truth = simulated(capsys, tmp_path, name, "--days", 0.02, "--seed", 4)
        with open_recording(path, ReadOptions()) as reader:
            scale = reader.recording.gyro_dps_per_lsb
            assert scale is not None
            held.append(joined(list(reader.chunks(5000))))
        assert scale == pytest.approx((1 / truth["gyroscope"]["lsb_per_dps"],) * 3)
    for other in held[1:]:
        np.testing.assert_array_equal(other.gyro_counts, held[0].gyro_counts)
        np.testing.assert_array_equal(other.counts, held[0].counts)


def test_an_ax6_sector_by_hand(tmp_path: Path, capsys: Capture) -> None:
    """cwa.h: axes and packing 0x62, 40 samples of both sensors, ranges in the top bits of the light."""
    path, _ = simulated(capsys, tmp_path, "cwa", "--days", 0.001, "--no-temperature")
    data = path.read_bytes()
    assert data[:2] == b"MD" and data[4] == 0x64
    with open_recording(path, ReadOptions()) as reader:
        rows = joined(list(reader.chunks(5000)))
        assert reader.recording.device.model == "AX6"
    for number, at in enumerate(range(1024, len(data), 512)):
        (light,) = struct.unpack_from("<H", data, at + 18)
        axes, count = data[at + 25], struct.unpack_from("<H", data, at + 28)[0]
        assert (axes, count, light >> 13, light >> 10 & 7) == (0x62, 40, 0, 2)
        assert sum(struct.unpack_from("<256H", data, at)) % 65_536 == 0
        values = np.array(struct.unpack_from("<240h", data, at + 30)).reshape(40, 6)
        part = slice(40 * number, 40 * number + 40)
        assert rows.gyro_counts is not None
        np.testing.assert_array_equal(values[:, :3], rows.gyro_counts[part])
        np.testing.assert_array_equal(values[:, 3:], rows.counts[part])


def test_the_truth_is_found_again_with_its_slope(tmp_path: Path, capsys: Capture) -> None:
    path, truth = simulated(
        capsys, tmp_path, "raw", "--days", 0.5, "--rate", 25, "--seed", 3, "--gyro-temp-slope", 0.02, -0.03, 0
    )
    found, told = gyroscope(capsys, path), truth["gyroscope"]
    assert found["outcome"] == "calibrated", found["message"]
    off = np.abs(np.array(found["scale"]) - told["scale"])
    assert off.max() < 2e-3
    assert (off / np.array(found["standard_errors"]["scale"])).max() < 3.5
    slope, reference = found["temperature"]["slope_dps_per_c"], found["temperature"]["reference_c"]
    np.testing.assert_allclose(slope, told["slope_dps_per_c"], atol=2e-3)
    bias = np.array(found["bias_dps"]) + np.array(slope) * (told["reference_c"] - reference)
    np.testing.assert_allclose(bias, told["bias_dps"], atol=0.02)
    assert gyroscope(capsys, path, "--no-temperature", "--force")["temperature"] is None


def test_rates_lead_from_each_direction_to_the_next() -> None:
    """By Rodrigues' formula, turn by turn; the noise is taken away."""
    sensor = GyroSensor(np.eye(3), np.zeros(3), np.zeros(3), noise_dps=0.0, lsb_per_dps=256.0)
    turning, rate = Turning(sensor, 100.0, 1), 100.0
    for bout in islice(Wearer(rate, 2, smooth=True).bouts(), 6):
        counts = turning.counts(bout.direction, np.full(len(bout.direction), 30.0))
        if np.abs(counts).max() > 32_000:
            continue
        angles = np.radians(counts / 256.0) / rate
        for angle, (before, after) in zip(angles[1:], pairwise(bout.direction), strict=True):
            size = np.sqrt(angle @ angle)
            axis = angle / max(size, 1e-12)
            cosine = np.cos(size)
            found = (
                before * cosine
                + np.cross(before, axis) * np.sin(size)
                + axis * (axis @ before) * (1 - cosine)
            )
            assert np.abs(found - after).max() < 2e-6


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--format", "gt3x", "--gyro", "--rate", 30), "hdf5"),
        (("--format", "raw", "--gyro-temp-slope", 1, 0, 0), "--gyro"),
    ],
)
def test_what_cannot_be(tmp_path: Path, capsys: Capture, words: tuple[object, ...], named: str) -> None:
    ran = run(capsys, "simulate", tmp_path / "a", *words, "-q")
    assert ran.code == 2
    assert_one_line(ran, named)
    assert list(tmp_path.iterdir()) == []
