"""`accelcal study` from outside: what is found, written, said, and done again."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
import pytest

from tests.cli.run import run
from tests.cli.studies import NAMES, csv_rows, results, rows, study, study_folder
from tests.recordings import directions, still_counts, write_raw

SE_COLUMNS = {
    **{name: name for name in ("k_xx", "k_yy", "k_zz", "k_yx", "k_zx", "k_zy")},
    "ox": "offset_x_g", "oy": "offset_y_g", "oz": "offset_z_g",
}  # fmt: skip
"""Names in the report (first the column of K, then its row) and in the table (row, column)."""


def test_the_folders_are_mirrored_and_summed_up(tmp_path: Path) -> None:
    folder, out = study_folder(tmp_path / "in"), tmp_path / "out"
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    ran = study(folder, code=0)
    assert {line.split("\t")[0] for line in ran.lines} == {str(folder / name) for name in NAMES}
    said = "accelcal: 3 recordings: 3 calibrated. 1 other file skipped. Results: "
    assert ran.err == f"{said}{out / 'study.csv'}\n"
    kinds = ("calibrated.parquet", "calibration.json", "quality.json")
    written = [f"{name[:-4]}.{kind}" for name in NAMES for kind in kinds]
    assert set(results(out)) == {*written, "study.csv", "study.parquet", "study.json"}
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before


def test_a_row_says_what_the_report_says(tmp_path: Path) -> None:
    out = tmp_path / "out"
    ran = study(study_folder(tmp_path / "in", NAMES[:1]))
    report = json.loads((out / "north/a.calibration.json").read_text())
    row = rows(out)[0]
    assert (row["path"], row["outcome"], row["exit_code"]) == ("north/a.raw", "calibrated", "0")
    assert float(row["after_mg"]) == report["holdout"]["after_mg"]["mean"]
    assert [float(row[f"k_{a}{b}"]) for a in "xyz" for b in "xyz"] == [
        value for row in report["calibration"]["gain"] for value in row
    ]
    assert [float(row[f"offset_{a}_g"]) for a in "xyz"] == report["calibration"]["offset_g"]
    assert {name: row[f"se_{column}"] for name, column in SE_COLUMNS.items()} == {
        name: str(report["calibration"]["standard_errors"][name]) for name in SE_COLUMNS
    }
    assert (row["se_slope_x_g_per_c"], row["lost_percent"]) == ("", "0.0")
    assert row["sha256"] == report["recording"]["sha256"]
    assert (row["slope_x_g_per_c"], row["device_serial"]) == ("", "")
    assert (row["parquet"], row["report"]) == ("north/a.calibrated.parquet", "north/a.calibration.json")
    assert (row["rate_hz"], row["samples"], row["duration_s"]) == ("25.0", "45000", "1800.0")
    frame = pd.read_parquet(out / "study.parquet")
    assert list(frame.columns) == list(row)
    assert frame["after_mg"][0] == report["holdout"]["after_mg"]["mean"]
    held = run("calibrate", tmp_path / "in/north/a.raw", "-d", out / "north")
    assert held.lines == ran.lines
    assert held.err.endswith("up to date\n")


def test_names_that_a_spreadsheet_would_calculate(tmp_path: Path) -> None:
    study(study_folder(tmp_path / "in", ("=cmd|' !A1.raw",)), "--report-only")
    (row,) = csv_rows(tmp_path / "out")
    assert (row["path"], row["report"]) == ("'=cmd|' !A1.raw", "'=cmd|' !A1.calibration.json")
    assert pd.read_parquet(tmp_path / "out/study.parquet")["path"][0] == "=cmd|' !A1.raw"


def test_what_was_not_fitted_has_no_standard_error(tmp_path: Path) -> None:
    study(study_folder(tmp_path / "in", NAMES[:1]), "--model", "6", "--report-only")
    (row,) = rows(tmp_path / "out")
    known = [name for name in SE_COLUMNS.values() if row[f"se_{name}"]]
    assert known == ["k_xx", "k_yy", "k_zz", "offset_x_g", "offset_y_g", "offset_z_g"]
    assert row["k_yx"] == "0.0"


def test_damaged_files_are_rows_and_stop_nothing(tmp_path: Path) -> None:
    folder = study_folder(tmp_path / "in", NAMES[:2])
    (folder / "zeros.cwa").write_bytes(bytes(4096))
    (folder / "empty.csv").write_bytes(b"")
    write_raw(folder / "short.raw", still_counts(directions(1)))
    ran = study(folder, code=1)
    assert "Traceback" not in ran.err
    found = {row["path"]: (row["outcome"], row["exit_code"]) for row in rows(tmp_path / "out")}
    done, failed = ("calibrated", "0"), ("failed", "3")
    expected = {"empty.csv": failed, "north/a.raw": done, "north/b.raw": done, "zeros.cwa": failed}
    assert found == expected | {"short.raw": ("refused", "4")}
    assert sum(line.split("\t")[1] == "failed" for line in ran.lines) == 2
    counts = json.loads((tmp_path / "out/study.json").read_text())
    assert counts["outcomes"] == {"calibrated": 2, "failed": 2, "refused": 1}
    quiet = study(folder, "-q", "--all-failures")
    assert (quiet.code, quiet.out) == (1, "")
    failed = [str(folder / name) for name in ("empty.csv", "short.raw", "zeros.cwa")]
    lines = [line.removeprefix("accelcal: ") for line in quiet.err.splitlines()]
    told = {name: line.removeprefix(f"{name}: ") for name, line in zip(failed, lines, strict=True)}
    assert not [name for name, message in told.items() if name in message], "each is named once"
    messages = {row["path"]: row["message"] for row in rows(tmp_path / "out") if row["outcome"] == "failed"}
    assert {name: told[str(folder / name)] for name in messages} == messages


@pytest.mark.parametrize(("name", "content", "code"), [("a.cwa", bytes(4096), 3), ("a.gt3x", b"", 3)])
def test_one_recording_gives_its_own_code(tmp_path: Path, name: str, content: bytes, code: int) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / name).write_bytes(content)
    assert study(tmp_path / "in").code == code


def test_two_recordings_of_one_stem_are_refused_and_the_rest_is_done(tmp_path: Path) -> None:
    folder, out = study_folder(tmp_path / "in"), tmp_path / "out"
    (folder / "north/a.cwa").write_bytes(bytes(4096))
    (folder / "north/b.txt").write_text("a note, no recording\n")
    assert "would share its outputs with a.cwa" in study(folder, "-q", code=1).err
    assert [row["exit_code"] for row in rows(out)] == ["2", "2", "0", "0"]
    assert not (out / "north/a.calibration.json").exists()
    again = study(folder, "-q")
    assert (again.code, again.err) == (0, ""), "it is no news"
    assert study(folder, "--exclude", "*.CWA").code == 0


def test_patterns_choose(tmp_path: Path) -> None:
    folder = study_folder(tmp_path / "in")
    table = folder / "ages.csv"
    table.write_text("age\n31\n32\n")

    def listed(*words: object) -> list[str]:
        lines = study(folder, "--dry-run", *words).lines
        return [str(Path(line.split("\t")[0]).relative_to(folder)) for line in lines]

    assert listed() == list(NAMES)
    assert listed("--include", "[AB].raw") == list(NAMES[:2])
    assert listed("--exclude", "*/deep/*") == list(NAMES[:2])
    assert listed("--include", "ages.csv") == ["ages.csv"]
    assert not (tmp_path / "out").exists()


def test_outputs_inside_the_study_are_not_taken_for_recordings(tmp_path: Path) -> None:
    folder = study_folder(tmp_path / "in", NAMES[:2])
    for out in (folder / "results", folder):
        for unchanged in (0, 2):
            ran = run("study", folder, "-d", out)
            assert (ran.code, len(ran.lines)) == (0, 2)
            assert ("2 unchanged" in ran.err) == bool(unchanged)


def test_several_folders_lie_side_by_side(tmp_path: Path) -> None:
    for name in ("one", "two"):
        study_folder(tmp_path / name, ("a.raw",))
    assert run("study", tmp_path / "one", tmp_path / "two", "-d", tmp_path / "out").code == 0
    assert [row["path"] for row in rows(tmp_path / "out")] == ["one/a.raw", "two/a.raw"]
    study_folder(tmp_path / "deep/one", ("a.raw",))
    ran = run("study", tmp_path / "one", tmp_path / "deep/one", "-d", tmp_path / "out")
    assert (ran.code, ran.out) == (2, "")


@pytest.mark.parametrize("make", [False, True])
def test_no_folder_and_no_recording_are_wrong_usage(tmp_path: Path, make: bool) -> None:
    if make:
        (tmp_path / "in").mkdir()
    ran = study(tmp_path / "in")
    assert (ran.code, ran.out, ran.err.count("\n")) == (2, "", 1)
    assert ("check the path, and that its disk is mounted" in ran.err) == make
    assert not list(tmp_path.glob("out/*"))


def test_json_gives_the_reports(tmp_path: Path) -> None:
    ran = study(study_folder(tmp_path / "in", NAMES[:2]), "--json", "-q")
    reports = [json.loads(line) for line in ran.lines]
    assert {report["recording"]["path"] for report in reports} == {Path(name).name for name in NAMES[:2]}
    found = {report["provenance"]["files"]["recording"] for report in reports}
    assert found == {str(tmp_path / "in" / name) for name in NAMES[:2]}


def test_verdicts_14_copies_are_said_and_count_once(tmp_path: Path) -> None:
    folder, out = study_folder(tmp_path / "in", NAMES[:2]), tmp_path / "out"
    for suffix in ("raw", "layout.toml"):
        (folder / f"b again.{suffix}").write_bytes((folder / f"north/b.{suffix}").read_bytes())
    ran = study(folder)
    assert "accelcal: b again.raw: a copy of north/b.raw, which counts once" in ran.err
    assert "3 recordings: 2 calibrated, 1 copied from others. 1 other file skipped. Results: " in ran.err
    copied = {row["path"]: row["copy_of"] for row in rows(out)}
    assert copied == {"b again.raw": "north/b.raw", "north/a.raw": "", "north/b.raw": ""}
    counts = json.loads((out / "study.json").read_text())
    assert (counts["recordings"], counts["copies"], counts["outcomes"]) == (3, 1, {"calibrated": 2})
    assert counts["models"] == {"9": 2}
