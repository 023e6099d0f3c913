"""`accelcal export`: what is printed, written, refused and overwritten."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest

from tests.cli.run import assert_one_line, run
from tests.cli.test_start import PRINT, lists
from tests.device_recordings import donor, edit, week
from tests.recordings import good_csv
from tests.six_pose.made import six_faces

Capture = pytest.CaptureFixture[str]


def test_coefficients_are_printed_and_what_they_cost_is_said(tmp_path: Path, capsys: Capture) -> None:
    report = donor(tmp_path, warm=True)
    starts = {"ggir": "filename,scale.x,", "biobank": "accProcess ", "omconvert": "omconvert "}
    for form, start in starts.items():
        ran = run(capsys, "export", report, "--to", form)
        assert ran.code == 0 and ran.out.startswith(start), ran
        model = "exported model 6T (9T without misalignment): "
        what = f"{report}: this form cannot hold misalignment and bend; {model}"
        assert what in ran.err
        assert run(capsys, "export", report, "--to", form, "-q").err == ""


def test_several_reports_are_rows_or_lines(tmp_path: Path, capsys: Capture) -> None:
    report = donor(tmp_path)
    other = tmp_path / "other.calibration.json"
    other.write_bytes(report.read_bytes())
    edit(other, lambda held: held["recording"].update(path="other.raw"))
    rows = list(csv.DictReader(io.StringIO(run(capsys, "export", report, other, "--to", "ggir").out)))
    assert [row["filename"] for row in rows] == ["donor.raw", "other.raw"]
    assert len(run(capsys, "export", report, other, "--to", "biobank").lines) == 2


def test_json_has_both_and_each_report_a_line(tmp_path: Path, capsys: Capture) -> None:
    report = donor(tmp_path)
    ran = run(capsys, "export", report, report, "--to", "json")
    assert ran.code == 0 and ran.err == "" and len(ran.lines) == 2
    shown, held = json.loads(ran.lines[0]), json.loads(report.read_text())
    for name in ("calibration_error_mg", "holdout", "without_misalignment", "outcome"):
        assert shown[name] == held[name]
    assert {name: held["calibration"][name] for name in shown["calibration"]} == shown["calibration"]
    assert (shown["calibration"]["model"], shown["recording"]["sha256"]) == ("9", held["recording"]["sha256"])


def test_json_has_nine_where_there_is_nothing_without(tmp_path: Path, capsys: Capture) -> None:
    report = edit(donor(tmp_path), lambda held: held.update(without_misalignment=None))
    assert json.loads(run(capsys, "export", report, "--to", "json").out)["without_misalignment"] is None
    ran = run(capsys, "export", report, "--to", "ggir")
    assert ran.code == 2
    assert_one_line(ran, "has no fit without misalignment; export the calibrated data")


def test_borrowed_coefficients_bring_theirs_along_held_out_here(tmp_path: Path, capsys: Capture) -> None:
    report, out = donor(tmp_path, warm=True), tmp_path / "out"
    path = week(tmp_path / "next.raw", 2, warm=True)
    assert run(capsys, "apply", "--coefficients", report, path, "-d", out).code == 0
    held, now = (json.loads(one.read_text()) for one in (report, out / "next.calibration.json"))
    section = now["without_misalignment"]
    assert section["calibration"] == held["without_misalignment"]["calibration"]
    assert section["holdout"]["method"] == now["holdout"]["method"]
    assert section["calibration_error_mg"] is None
    assert section["holdout"]["after_mg"]["mean"] > now["holdout"]["after_mg"]["mean"]
    assert run(capsys, "verify", out / "next.calibration.json", path).code == 0
    row = run(capsys, "export", out / "next.calibration.json", "--to", "ggir").lines[1]
    assert row.startswith("next.raw,")


def test_slopes_that_are_not_used_are_not_handed_on(tmp_path: Path, capsys: Capture) -> None:
    report, out = donor(tmp_path, warm=True), tmp_path / "out"
    path = week(tmp_path / "next.raw", 2)
    assert run(capsys, "apply", "--no-temperature", "--coefficients", report, path, "-d", out).code == 0
    ran = run(capsys, "export", out / "next.calibration.json", "--to", "ggir")
    (row,) = csv.DictReader(io.StringIO(ran.out))
    assert (row["use.temperature"], row["temperature.offset.x"]) == ("FALSE", "0.0")
    assert row["meantempcal"] == "0.0"


def test_known_orientations_have_no_fit_beside_them(tmp_path: Path, capsys: Capture) -> None:
    report = tmp_path / "session.calibration.json"
    assert run(capsys, "six-pose", six_faces(tmp_path), "-o", report).code == 0
    ran = run(capsys, "export", report, "--to", "ggir")
    assert ran.code == 2
    assert_one_line(ran, "was calibrated on known orientations")


def test_a_refused_recording_has_nothing_to_export(tmp_path: Path, capsys: Capture) -> None:
    path = week(tmp_path / "few.raw", poses=1)
    assert run(capsys, "calibrate", path).code == 4
    ran = run(capsys, "export", tmp_path / "few.calibration.json", "--to", "json")
    assert ran.code == 3
    assert_one_line(ran, "holds no coefficients: the recording was refused")


def test_a_damaged_section_is_refused(tmp_path: Path, capsys: Capture) -> None:
    def wrong(held: dict) -> None:
        held["without_misalignment"]["calibration"]["gain"][0][0] = 1.5

    report = edit(donor(tmp_path), wrong)
    for form in ("ggir", "json"):
        ran = run(capsys, "export", report, "--to", form)
        assert ran.code == 3
        assert_one_line(ran, "calibration.gain is not what calibration.fixed_point says")


def test_nothing_is_overwritten_and_no_input_ever(tmp_path: Path, capsys: Capture) -> None:
    report, there = donor(tmp_path), tmp_path / "there.csv"
    there.write_text("mine")
    data = tmp_path / "donor.calibrated.parquet"
    for words in ((report, "--to", "ggir"), (data, "--to", "csv")):
        ran = run(capsys, "export", *words, "-o", there)
        assert ran.code == 5 and there.read_text() == "mine"
        assert_one_line(ran, "is there already; use --force to replace it")
        before = words[0].read_bytes()
        assert run(capsys, "export", *words, "-o", words[0], "--force").code == 2
        assert words[0].read_bytes() == before
        assert run(capsys, "export", *words, "-o", there, "--force").code == 0
        assert there.read_text() != "mine"
        there.write_text("mine")


def test_data_say_what_they_are(tmp_path: Path, capsys: Capture) -> None:
    donor(tmp_path)
    data, there = tmp_path / "donor.calibrated.parquet", tmp_path / "a.npz"
    ran = run(capsys, "export", data, "--to", "npz", "-o", there, "--resample", "30")
    assert ran.code == 0 and ran.out == ""
    told = "35999 rows at 30 Hz with 0 gaps, times of the device's clock, range -8 to 8 g"
    assert_one_line(ran, f"{there}: {told}")
    with np.load(there) as held:
        assert held["accel"].shape == (35999, 3) and held["fs"] == 30.0


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--to", "csv"), "writes a file, which needs a name; add -o a.csv"),
        (("--to", "actipy"), "--to actipy writes a file, which needs a name; add -o a.csv"),
        (("--to", "skdh"), "--to skdh writes a file, which needs a name; add -o a.npz"),
        (("--to", "npz", "-o", "a.csv"), "an array file has to end in .npz"),
        (("--to", "bids", "-o", "a.tsv"), "is not a Motion-BIDS name"),
        (("--to", "ggir", "--resample", "30"), "--resample is for data"),
        (("--to", "json", "--measured-only"), "--measured-only is for data"),
        (("--to", "csv", "-o", "-"), "results are not written to standard output"),
    ],
)
def test_words_that_do_not_fit(tmp_path: Path, capsys: Capture, words: tuple[str, ...], text: str) -> None:
    ran = run(capsys, "export", tmp_path / "a.calibrated.parquet", *words)
    assert ran.code == 2
    assert_one_line(ran, text)


def test_the_other_kind_of_file_is_told(tmp_path: Path, capsys: Capture) -> None:
    report, data = donor(tmp_path), tmp_path / "donor.calibrated.parquet"
    ran = run(capsys, "export", data.rename(tmp_path / "renamed.parquet"), "--to", "ggir")
    assert ran.code == 3
    assert_one_line(ran, "name a report, NAME.calibration.json")
    for path in (report.rename(tmp_path / "renamed.json"), good_csv(tmp_path)):
        ran = run(capsys, "export", path, "--to", "csv", "-o", tmp_path / "b.csv")
        assert ran.code == 3
        assert_one_line(ran, "name a Parquet file that accelcal wrote, NAME.calibrated.parquet")


def test_coefficients_need_no_pyarrow(tmp_path: Path) -> None:
    words = ["export", str(donor(tmp_path)), "--to", "ggir", "-q"]
    code = (
        f"from accelcal_cli.cli.main import cli\nassert not cli.main({words!r}, 'a', standalone_mode=False)"
    )
    (found,) = lists(f"{code}\n{PRINT}")
    assert "accelcal_cli.exports.coefficients" in found and "pyarrow" not in found


@pytest.mark.parametrize(
    ("given", "form", "needed", "other"),
    [
        ("a b.calibration.json", "csv", "calibrated data", "'{}/a b.calibrated.parquet'"),
        ("a.calibration.json", "bids", "calibrated data", "{}/a.calibrated.parquet"),
        ("a.calibrated.parquet", "ggir", "a report", "{}/a.calibration.json"),
        ("a.calibrated.parquet", "json", "a report", "{}/a.calibration.json"),
    ],
)
def test_u7_a_file_of_the_other_kind_names_the_one_to_give(
    tmp_path: Path, capsys: Capture, given: str, form: str, needed: str, other: str
) -> None:
    ran = run(capsys, "export", tmp_path / given, "--to", form)
    assert ran.code == 2
    assert_one_line(ran, f"--to {form} needs {needed}; give {other.format(tmp_path)} instead")
