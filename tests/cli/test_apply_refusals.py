"""`accelcal apply`: whose coefficients it refuses, and what it never overwrites."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.cli.run import Ran, assert_one_line, run, told
from tests.device_recordings import REFERENCE_C, SLOPE_G_PER_C, donor, edit, rest, week, write_device
from tests.recordings import GAIN, OFFSET_G, directions, straightened


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def apply(coefficients: Path, *words: object) -> Ran:
    return run("apply", "--coefficients", coefficients, *words)


def refuse(code: int, parts: list[str], coefficients: Path, *words: object) -> None:
    """One line with these parts, the code, and nothing written."""
    before = files(coefficients.parent)
    ran = apply(coefficients, *words)
    assert (ran.code, ran.out) == (code, "")
    assert_one_line(ran, *parts)
    assert files(coefficients.parent) == before


def test_an_unknown_device_passes_for_the_very_same_recording(tmp_path: Path) -> None:
    path = week(tmp_path / "a.raw", serial=None)
    assert run("calibrate", path).code == 0
    coefficients, copy = tmp_path / "a.calibration.json", tmp_path / "copy.raw"
    shutil.copy(path, copy)
    layout = Path(shutil.copy(tmp_path / "a.layout.toml", tmp_path / "copy.layout.toml"))
    ran = apply(coefficients, copy)
    assert (ran.code, ran.lines[0].split("\t")[1]) == (0, "calibrated")
    layout.write_text(layout.read_text().replace("range_g = 8.0", "range_g = 4.0"))
    refuse(2, ["copy.raw", "found from this file", "differently"], coefficients, copy)


def test_equal_serials_of_other_models_pass_with_a_note(tmp_path: Path) -> None:
    coefficients = donor(tmp_path)
    edit(coefficients, lambda report: report["recording"]["device"].update(model="X"))
    other = week(tmp_path / "other.raw", seed=2, poses=12, model="Y")
    assert apply(coefficients, other).code == 0
    report = json.loads((tmp_path / "other.calibration.json").read_text())
    assert told(report, "other_model") == "This recording's device is of model Y, with the same serial."


@pytest.mark.parametrize("words", [("--lsb-per-g", 250), ("--rate", 26)])
def test_the_same_file_read_otherwise_is_another(tmp_path: Path, words: tuple[object, ...]) -> None:
    coefficients, path = donor(tmp_path), tmp_path / "donor.raw"
    words = (path, "-o", tmp_path / "x.parquet", *words)
    refuse(2, [str(path), "--any-device"], coefficients, *words)
    assert apply(coefficients, *words, "--any-device").code == 0
    report = json.loads((tmp_path / "x.calibration.json").read_text())
    assert report["outcome"] == "borrowed"
    assert "points may have been fitted" in report["holdout"]["method"]


def test_slopes_need_temperature_or_a_word(tmp_path: Path) -> None:
    """Without temperature the slopes' share is (T - Tref) s: applied at Tref it is nothing."""
    coefficients = donor(tmp_path, warm=True)
    given = json.loads(coefficients.read_text())["calibration"]
    assert given["model"] == "9T"
    other = week(tmp_path / "other.raw", seed=2, poses=12)
    at_c = f"{given['temperature']['reference_c']:.1f} °C"
    refuse(2, [str(other), "no temperature", "--no-temperature", at_c], coefficients, other)
    assert apply(coefficients, other, "--no-temperature").code == 0
    report = json.loads((tmp_path / "other.calibration.json").read_text())
    assert (report["calibration"]["model"], report["calibration"]["temperature"]) == ("9", None)
    assert report["calibration"]["offset_g"] == given["offset_g"]
    assert "sx" not in report["calibration"]["standard_errors"]
    (left_out,) = [one for one in report["notes"] if one["code"] == "slopes_left_out"]
    assert left_out["values"]["at_c"] == pytest.approx(given["temperature"]["reference_c"], abs=0.01)
    assert report["settings"]["temperature"] is False
    again = ("-d", tmp_path / "out")
    assert apply(tmp_path / "other.calibration.json", other, *again).code == 0


def test_slopes_are_applied_as_calculated_from_the_equation(tmp_path: Path) -> None:
    """a = K (v + q v^2 + o + s (T - Tref)), computed here from the report's numbers."""
    coefficients = donor(tmp_path, warm=True)
    values, heat = rest(directions(12), seed=2, warm=True)
    other = write_device(tmp_path / "other.raw", values, heat)
    assert apply(coefficients, other).code == 0
    frame = pd.read_parquet(tmp_path / "other.calibrated.parquet")
    raw = np.rint(values * 256) / 256
    found = json.loads(coefficients.read_text())["calibration"]
    away = (np.rint(heat * 100) / 100)[:, None] - found["temperature"]["reference_c"]
    shifted = (
        straightened(found, raw) + found["offset_g"] + away * np.array(found["temperature"]["slope_g_per_c"])
    )
    expected = shifted @ np.array(found["gain"]).T
    np.testing.assert_allclose(frame[["x", "y", "z"]].to_numpy(), expected, rtol=2**-23, atol=2**-29)
    true = (raw + OFFSET_G + SLOPE_G_PER_C * (heat - REFERENCE_C)[:, None]) @ GAIN.T
    np.testing.assert_allclose(frame[["x", "y", "z"]].to_numpy(), true, atol=1e-3)
    held = json.loads((tmp_path / "other.calibration.json").read_text())["holdout"]
    assert held["after_mg"]["mean"] < 0.5


def test_the_coefficient_file_is_never_overwritten(tmp_path: Path) -> None:
    words = (tmp_path / "donor.raw", "--force")
    refuse(2, ["donor.calibration.json", "overwritten", "-d"], donor(tmp_path), *words)


def test_calibrate_does_not_take_applied_results_for_its_own(tmp_path: Path) -> None:
    coefficients, path = donor(tmp_path), tmp_path / "donor.raw"
    apply(coefficients, path, "-d", tmp_path / "out")
    ran = run("calibrate", path, "-d", tmp_path / "out", "--force")
    assert (ran.code, ran.err) == (0, "")
    assert "coefficients" not in json.loads((tmp_path / "out" / "donor.calibration.json").read_text())


@pytest.mark.parametrize(
    "text", ['{"accelcal_version": "0.1.0"}', '{"accelcal_version": 1, "recording": []}']
)
def test_our_other_json_files_are_no_reports_to_replace(tmp_path: Path, text: str) -> None:
    path = week(tmp_path / "a.raw", poses=12)
    (tmp_path / "a.calibration.json").write_text(text)
    assert_one_line(run("calibrate", path), "not written by accelcal", code=5)
