"""The gyroscope of whole recordings: real ones, and such with a known truth, from file to Parquet."""

from __future__ import annotations

import json
import subprocess
import sys
from math import pi
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest

from accelcal_cli.core.calibration import IDENTITY, Calibration
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.gyroscope import Turns
from accelcal_cli.judge.gyroscope import judge_gyroscope
from accelcal_cli.pipeline.facts import Turning
from accelcal_cli.pipeline.survey import open_marked
from tests.cli.run import exit_code, nightly, run
from tests.formats.make_hdf5 import write

XSENS_ZERO, XSENS_PER_G = 32_768, 4000
XSENS_PER_RAD = 4768
"""One scale for all axes: what is left are those of each axis, and their misalignment."""


@pytest.fixture(scope="module")
def xsens(real_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Readings of an Xsens MTi in 42 poses, 8.5 minutes, less the middle of its converter."""
    accel, gyro = (
        np.loadtxt(real_data / "imu" / f"xsens_mti_{name}.txt")[:, 1:] - XSENS_ZERO
        for name in ("acc", "gyro")
    )
    path = tmp_path_factory.mktemp("xsens") / "xsens.h5"
    about = {"sample_rate": 100.0, "units": "counts", "lsb_per_g": float(XSENS_PER_G)}
    write(path, {"accel": accel.astype(np.int16), "gyro": gyro.astype(np.int16)}, about)
    with h5py.File(path, "r+") as file:
        file["gyro"].attrs["dps_per_lsb"] = 180 / pi / XSENS_PER_RAD
    return path


def calibrated(path: Path, *words: object) -> dict[str, Any]:
    told = run("calibrate", path, "--json", "-q", *words, code=0)
    report: dict[str, Any] = json.loads(told.out)
    return report


@pytest.fixture(scope="module")
def held(xsens: Path) -> dict[str, Any]:
    """Its report, beside its values."""
    assert exit_code("calibrate", xsens, "-q", "--segment-seconds", 1) == 0
    report: dict[str, Any] = json.loads(xsens.with_name("xsens.calibration.json").read_text())
    return report


def test_a_real_sensor(xsens: Path, held: dict[str, Any]) -> None:
    found = held["gyroscope"]
    assert found["outcome"] == "calibrated", found["message"]
    assert 30 <= found["pairs"] <= 42
    assert found["holdout_deg"]["after"] < 0.55
    assert 2 < found["holdout_deg"]["before"] < 3.5
    assert found["holdout_deg"]["mean_after"] < 0.55
    assert found["holdout_deg"]["rms_before"] == pytest.approx(3.3, abs=0.1)
    assert found["holdout_deg"]["rms_after"] < 0.5
    with_columns = pq.read_table(xsens.with_name("xsens.calibrated.parquet"))
    assert json.loads(with_columns.schema.metadata[b"accelcal"])["gyroscope"] == found
    run("verify", xsens.with_name("xsens.calibration.json"), xsens, "--values", code=0)


@pytest.mark.nightly
def test_the_same_from_text(xsens: Path, held: dict[str, Any], tmp_path: Path) -> None:
    """Counts as counts, to the bit; rad/s with six decimals, to what these leave."""
    words = ("--segment-seconds", 1, "--rate", 100, "--unit", "counts", "--lsb-per-g", XSENS_PER_G)
    with h5py.File(xsens) as file:
        accel, gyro, step = file["accel"][()], file["gyro"][()], file["gyro"].attrs["dps_per_lsb"]
    whole, decimal = tmp_path / "whole.csv", tmp_path / "decimal.csv"
    table = np.concatenate([accel, gyro], axis=1)
    np.savetxt(whole, table, "%d", ",", header="ax,ay,az,gx,gy,gz", comments="")
    found = calibrated(whole, *words, "-R", f"lsb_per_dps={float(1 / step)!r}")
    assert (found["gyroscope"], found["calibration"]) == (held["gyroscope"], held["calibration"])
    table = np.concatenate([accel, gyro / XSENS_PER_RAD], axis=1)
    np.savetxt(decimal, table, ["%d"] * 3 + ["%.6f"] * 3, ",", header="ax,ay,az,gx,gy,gz", comments="")
    found = calibrated(decimal, *words, "-R", "gyro_unit=rad/s")
    assert found["calibration"] == held["calibration"]
    assert found["gyroscope"]["pairs"] == held["gyroscope"]["pairs"]
    np.testing.assert_allclose(found["gyroscope"]["scale"], held["gyroscope"]["scale"], atol=2e-5)
    np.testing.assert_allclose(found["gyroscope"]["bias_dps"], held["gyroscope"]["bias_dps"], atol=1e-4)
    run("verify", tmp_path / "decimal.calibration.json", decimal, "--values", code=0)


@pytest.mark.parametrize("name", ["mpu9150_imu0.log", nightly("mpu9150_imu1.log")])
def test_a_log_without_names_or_times(real_data: Path, name: str, tmp_path: Path) -> None:
    path, read = real_data / "imu" / name, ("--columns", "0,1,2", "--unit", "m/s2", "--rate", 100)
    words = (*read, "--segment-seconds", 1, "--report-only", "-d", tmp_path)
    assert "gyroscope" not in calibrated(path, *words)
    turning = ("-R", "gyro_columns=3,4,5", "-R")
    found = calibrated(path, *words, *turning, "gyro_unit=rad/s")["gyroscope"]
    assert found["outcome"] == "calibrated", found["message"]
    assert found["holdout_deg"]["after"] < 0.6 * found["holdout_deg"]["before"] < 0.2
    assert np.abs(np.array(found["scale"]) - np.eye(3)).max() < 0.02
    wrong = calibrated(path, *words, *turning, "gyro_unit=deg/s")["gyroscope"]
    assert (wrong["outcome"], wrong["scale"]) == ("refused", None)
    assert wrong["reason"] == "wrong_unit_of_rates"
    assert wrong["message"] == "The rates are about 57 times too small for the turns. Check their unit."


def test_parquet_holds_what_the_report_says(xsens: Path, held: dict[str, Any]) -> None:
    found = held["gyroscope"]
    table = pq.read_table(xsens.with_name("xsens.calibrated.parquet"))
    with open_marked(xsens, ReadOptions()) as reader:
        counts = np.concatenate([chunk.gyro_counts for chunk in reader.chunks(7000)])
    raw = counts * (180 / pi / XSENS_PER_RAD)
    right = (raw - found["bias_dps"]) @ np.array(found["scale"]).T
    for axis, name in enumerate(("gx", "gy", "gz")):
        np.testing.assert_allclose(table[name].to_numpy(), right[:, axis], rtol=1e-6, atol=1e-5)
        assert table.schema.field(name).metadata[b"unit"] == b"deg/s"


def test_a_refused_gyroscope_stays_raw(xsens: Path, tmp_path: Path) -> None:
    """The movement of the first pose after the other, with the gyroscope of no turn at all."""
    still = tmp_path / "still.h5"
    still.write_bytes(xsens.read_bytes())
    with h5py.File(still, "r+") as file:
        step = file["gyro"].attrs["dps_per_lsb"]
        del file["gyro"]
        noise = np.random.default_rng(1).integers(-9, 10, (len(file["accel"]), 3)).astype(np.int16)
        file.create_dataset("gyro", data=noise + np.int16(50)).attrs["dps_per_lsb"] = step
    found = calibrated(still, "--segment-seconds", 1)["gyroscope"]
    assert (found["outcome"], found["scale"]) == ("refused", None)
    assert found["bias_dps"] == pytest.approx([50 * step] * 3, rel=0.01)
    table = pq.read_table(tmp_path / "still.calibrated.parquet")
    np.testing.assert_array_equal(table["gy"].to_numpy(), ((noise[:, 1] + 50) * step).astype(np.float32))


def seen(path: Path, chunk_samples: int) -> Turns:
    with open_marked(path, ReadOptions()) as reader:
        observer = Turning(reader.recording)
        assert observer is not None
        for chunk in reader.chunks(chunk_samples):
            observer.see(chunk)
    return observer.result()


def test_the_same_bits_for_any_chunk_size(xsens: Path, held: dict[str, Any], tmp_path: Path) -> None:
    words = ("--segment-seconds", 1, "--report-only", "-d", tmp_path, "--chunk-samples", 997)
    assert calibrated(xsens, *words)["gyroscope"] == held["gyroscope"]
    one, other = seen(xsens, 777), seen(xsens, 1 << 18)
    for left, right in zip(one.turns, other.turns, strict=True):
        assert (left.before.sums, left.after.gyro_sums) == (right.before.sums, right.after.gyro_sums)
        np.testing.assert_array_equal(left.counts, right.counts)


@pytest.mark.parametrize("scale", [1e-12, nightly(1.0), 1e9])
def test_any_scale_and_any_counts_are_taken(tmp_path: Path, scale: float) -> None:
    """Nothing overflows: rates of 0.002 deg/s are rest whatever the counts; no rows hold such of 1e9."""
    random = np.random.default_rng(1)
    path = tmp_path / "a.h5"
    accel = np.repeat(random.integers(-200, 200, (40, 3)), 500, axis=0).astype(np.int16)
    gyro = random.integers(-(1 << 31), 1 << 31, accel.shape).astype(np.int32)
    gyro[::700] = 0
    write(path, {"accel": accel, "gyro": gyro}, {"sample_rate": 100.0, "units": "counts", "lsb_per_g": 256.0})
    with h5py.File(path, "r+") as file:
        file["gyro"].attrs["dps_per_lsb"] = scale
    if scale > 1e-12:
        with pytest.raises(UnreadableError, match="only 29 of 20000 rows hold usable values"):
            seen(path, 4096)
        return
    found = seen(path, 4096)
    assert found.turns and len(found.rates)
    assert judge_gyroscope(found, Calibration("9", IDENTITY), None).outcome == "refused"


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_known_truth(real_data: Path, tmp_path: Path, seed: int) -> None:
    """Recordings of an independent generator: the scale within its errors, and the bias, from both files."""
    tool = real_data.parent / "tools" / "make_recording.py"
    words = ["--days", "1", "--gyro", "--seed", str(seed), "--truth", str(seed), "--out", str(tmp_path / "a")]
    subprocess.run([sys.executable, tool, *words], check=True, capture_output=True)
    truth = json.loads((tmp_path / "a.truth.json").read_text())
    scale = np.linalg.inv(truth["gyro_A"])
    perfect = seen(tmp_path / "a_gyro.h5", 1 << 18)
    for name in ("a_gyro.h5", "a_ax6.cwa"):
        found = calibrated(tmp_path / name, "--report-only", "--no-temperature")["gyroscope"]
        off = np.abs(np.array(found["scale"]) - scale)
        assert off.max() < 5e-3
        assert (off / np.array(found["standard_errors"]["scale"])).max() < 3
        assert np.abs(np.array(found["bias_dps"]) - truth["gyro_bias_dps"]).max() < 0.02
        assert found["holdout_deg"]["after"] < 1.3 * left_by(scale, truth, perfect)


def left_by(scale: np.ndarray, truth: dict[str, Any], turns: Turns) -> float:
    """Median angle that the true parameters leave on the same turns, by one rotation a sample."""
    angles = []
    for turn in turns.turns:
        ends = [np.array(rest.sums) / rest.samples / truth["lsb_per_g"] for rest in (turn.before, turn.after)]
        u, v = (np.array(truth["K"]) @ (end - truth["b"]) for end in ends)
        u, v = u / np.linalg.norm(u), v / np.linalg.norm(v)
        if u @ v > np.cos(np.radians(20)):
            continue
        rate = (turn.counts / truth["gyro_lsb_per_dps"] - truth["gyro_bias_dps"]) @ scale.T
        for angle in np.radians(rate / truth["fs"]):
            size = np.linalg.norm(angle)
            axis = angle / max(size, 1e-12)
            u = u * np.cos(size) + np.cross(u, axis) * np.sin(size) + axis * (axis @ u) * (1 - np.cos(size))
        angles.append(np.degrees(np.arccos(min(1.0, u @ v))))
    return float(np.median(angles))
