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
from tests.recordings import GAIN, OFFSET_G, directions

Capture = pytest.CaptureFixture[str]


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def apply(capsys: Capture, coefficients: Path, *words: object) -> Ran:
    return run(capsys, "apply", "--coefficients", coefficients, *words)


def refuse(capsys: Capture, code: int, parts: list[str], coefficients: Path, *words: object) -> None:
    """One line with these parts, the code, and nothing written."""
    before = files(coefficients.parent)
    ran = apply(capsys, coefficients, *words)
    assert (ran.code, ran.out) == (code, "")
    assert_one_line(ran, *parts)
    assert files(coefficients.parent) == before


def set_serial(report: dict, serial: str | None) -> None:
    report["recording"]["device"]["serial"] = serial


@pytest.mark.parametrize(
    ("theirs", "ours", "parts"),
    [
        ("A1", "B2", ["device B2", "belong to device A1"]),
        ("A1", None, ["does not say which device", "A1"]),
        (None, "B2", ["device B2", "do not say which device"]),
        (None, None, ["neither"]),
        ("", None, ["neither"]),
    ],
)
def test_another_device_needs_any_device(
    tmp_path: Path, capsys: Capture, theirs: str | None, ours: str | None, parts: list[str]
) -> None:
    coefficients = edit(donor(tmp_path), lambda report: set_serial(report, theirs))
    other = week(tmp_path / "other.raw", seed=2, poses=12, serial=ours)
    refuse(capsys, 2, [str(other), "--any-device", *parts], coefficients, other)
    assert apply(capsys, coefficients, other, "--any-device").code == 0
    report = json.loads((tmp_path / "other.calibration.json").read_text())
    assert {"code": "other_device", "values": {"serial": ours or "unknown"}} in report["notes"]
    assert told(report, "other_device") in report["message"]


def test_an_unknown_device_passes_for_the_very_same_recording(tmp_path: Path, capsys: Capture) -> None:
    path = week(tmp_path / "a.raw", serial=None)
    assert run(capsys, "calibrate", path).code == 0
    coefficients, copy = tmp_path / "a.calibration.json", tmp_path / "copy.raw"
    shutil.copy(path, copy)
    layout = Path(shutil.copy(tmp_path / "a.layout.toml", tmp_path / "copy.layout.toml"))
    ran = apply(capsys, coefficients, copy)
    assert (ran.code, ran.lines[0].split("\t")[1]) == (0, "calibrated")
    layout.write_text(layout.read_text().replace("range_g = 8.0", "range_g = 4.0"))
    refuse(capsys, 2, ["copy.raw", "found from this file", "differently"], coefficients, copy)


def test_equal_serials_of_other_models_pass_with_a_note(tmp_path: Path, capsys: Capture) -> None:
    coefficients = donor(tmp_path)
    edit(coefficients, lambda report: report["recording"]["device"].update(model="X"))
    other = week(tmp_path / "other.raw", seed=2, poses=12, model="Y")
    assert apply(capsys, coefficients, other).code == 0
    report = json.loads((tmp_path / "other.calibration.json").read_text())
    assert told(report, "other_model") == "This recording's device is of model Y, with the same serial."


@pytest.mark.parametrize("words", [("--lsb-per-g", 250), ("--rate", 26)])
def test_the_same_file_read_otherwise_is_not_taken_for_its_own(
    tmp_path: Path, capsys: Capture, words: tuple[object, ...]
) -> None:
    coefficients, path = donor(tmp_path), tmp_path / "donor.raw"
    words = (path, "-o", tmp_path / "x.parquet", *words)
    refuse(capsys, 2, [str(path), "--any-device"], coefficients, *words)
    assert apply(capsys, coefficients, *words, "--any-device").code == 0
    report = json.loads((tmp_path / "x.calibration.json").read_text())
    assert report["outcome"] == "borrowed"
    assert "points may have been fitted" in report["holdout"]["method"]


def test_slopes_need_temperature_or_a_word(tmp_path: Path, capsys: Capture) -> None:
    """Without temperature the slopes' share is (T - Tref) s: applied at Tref it is nothing."""
    coefficients = donor(tmp_path, warm=True)
    given = json.loads(coefficients.read_text())["calibration"]
    assert given["model"] == "9T"
    other = week(tmp_path / "other.raw", seed=2, poses=12)
    at_c = f"{given['temperature']['reference_c']:.1f} °C"
    refuse(capsys, 2, [str(other), "no temperature", "--no-temperature", at_c], coefficients, other)
    assert apply(capsys, coefficients, other, "--no-temperature").code == 0
    report = json.loads((tmp_path / "other.calibration.json").read_text())
    assert (report["calibration"]["model"], report["calibration"]["temperature"]) == ("9", None)
    assert report["calibration"]["offset_g"] == given["offset_g"]
    assert "sx" not in report["calibration"]["standard_errors"]
    (left_out,) = [one for one in report["notes"] if one["code"] == "slopes_left_out"]
    assert left_out["values"]["at_c"] == pytest.approx(given["temperature"]["reference_c"], abs=0.01)
    assert report["settings"]["temperature"] is False
    again = ("-d", tmp_path / "out")
    assert apply(capsys, tmp_path / "other.calibration.json", other, *again).code == 0


def test_slopes_are_applied_as_calculated_from_the_equation(tmp_path: Path, capsys: Capture) -> None:
    """a = K (v + o + s (T - Tref)), computed here from the report's numbers."""
    coefficients = donor(tmp_path, warm=True)
    values, heat = rest(directions(12), seed=2, warm=True)
    other = write_device(tmp_path / "other.raw", values, heat)
    assert apply(capsys, coefficients, other).code == 0
    frame = pd.read_parquet(tmp_path / "other.calibrated.parquet")
    raw = np.rint(values * 256) / 256
    found = json.loads(coefficients.read_text())["calibration"]
    away = (np.rint(heat * 100) / 100)[:, None] - found["temperature"]["reference_c"]
    shifted = raw + found["offset_g"] + away * np.array(found["temperature"]["slope_g_per_c"])
    expected = shifted @ np.array(found["gain"]).T
    np.testing.assert_allclose(frame[["x", "y", "z"]].to_numpy(), expected, rtol=2**-23, atol=2**-29)
    true = (raw + OFFSET_G + SLOPE_G_PER_C * (heat - REFERENCE_C)[:, None]) @ GAIN.T
    np.testing.assert_allclose(frame[["x", "y", "z"]].to_numpy(), true, atol=1e-3)
    held = json.loads((tmp_path / "other.calibration.json").read_text())["holdout"]
    assert held["after_mg"]["mean"] < 0.5


def test_its_own_coefficients_cannot_be_changed_on_the_way(tmp_path: Path, capsys: Capture) -> None:
    coefficients, path = donor(tmp_path, warm=True), tmp_path / "donor.raw"
    for words in (("--no-temperature",), ("--latitude", 50)):
        parts = [str(path), words[0], "calibrate the recording again"]
        refuse(capsys, 2, parts, coefficients, path, "-d", tmp_path / "out", *words)


def test_the_coefficient_file_is_never_overwritten(tmp_path: Path, capsys: Capture) -> None:
    coefficients, path = donor(tmp_path), tmp_path / "donor.raw"
    other = week(tmp_path / "other.raw", seed=2, poses=12)
    for words in ((path,), (path, "--force"), (other, path), (path, "-o", tmp_path / "donor.parquet")):
        refuse(capsys, 2, ["donor.calibration.json", "overwritten", "-d"], coefficients, *words)
    link = tmp_path / "link.json"
    link.symlink_to(coefficients)
    refuse(capsys, 2, ["overwritten"], link, path)
    folder = tmp_path / "folder"
    folder.symlink_to(tmp_path)
    refuse(capsys, 2, ["overwritten"], coefficients, path, "-d", folder)


def test_foreign_files_and_other_recordings_results_are_kept(tmp_path: Path, capsys: Capture) -> None:
    coefficients, other = donor(tmp_path), week(tmp_path / "other.raw", seed=2, poses=12)
    for name in ("other.calibrated.parquet", "other.calibration.json", "other.integers.json"):
        (tmp_path / name).write_text('{"mine": 1}')
        refuse(capsys, 5, [name, "not written by accelcal", "--force"], coefficients, other)
        (tmp_path / name).unlink()
    out = tmp_path / "out"
    assert apply(capsys, coefficients, other, "-d", out).code == 0
    (tmp_path / "b").mkdir()
    same_name = week(tmp_path / "b" / "other.raw", seed=3, poses=12)
    before = files(out)
    ran = apply(capsys, coefficients, same_name, "-d", out)
    assert ran.code == 5
    assert_one_line(ran, str(other), "another recording")
    assert files(out) == before
    assert apply(capsys, coefficients, same_name, "-d", out, "--force").code == 0


def test_a_rerun_does_nothing_until_something_changes(tmp_path: Path, capsys: Capture) -> None:
    coefficients, other = donor(tmp_path), week(tmp_path / "other.raw", seed=2, poses=12)
    first = apply(capsys, coefficients, other)
    again = apply(capsys, coefficients, other)
    assert (again.code, again.out) == (0, first.out)
    assert "up to date" in again.err
    edit(coefficients, lambda report: report["provenance"].update(host="elsewhere"))
    assert "up to date" not in apply(capsys, coefficients, other).err
    assert "up to date" in apply(capsys, coefficients, other).err
    assert "up to date" not in apply(capsys, coefficients, other, "--latitude", 10).err
    assert "up to date" not in apply(capsys, coefficients, other, "--force").err


def test_calibrate_does_not_take_applied_results_for_its_own(tmp_path: Path, capsys: Capture) -> None:
    coefficients, path = donor(tmp_path), tmp_path / "donor.raw"
    apply(capsys, coefficients, path, "-d", tmp_path / "out")
    ran = run(capsys, "calibrate", path, "-d", tmp_path / "out", "--force")
    assert (ran.code, ran.err) == (0, "")
    assert "coefficients" not in json.loads((tmp_path / "out" / "donor.calibration.json").read_text())


@pytest.mark.parametrize(
    "text", ['{"accelcal_version": "0.1.0"}', '{"accelcal_version": 1, "recording": []}']
)
def test_our_other_json_files_are_no_reports_to_replace(tmp_path: Path, capsys: Capture, text: str) -> None:
    path = week(tmp_path / "a.raw", poses=12)
    (tmp_path / "a.calibration.json").write_text(text)
    ran = run(capsys, "calibrate", path)
    assert ran.code == 5
    assert_one_line(ran, "not written by accelcal")
