"""Results that were good stay until someone asks for others in their place, and names say what a file is."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from accelcal_cli.pipeline.jobs import Request, file_stamp, plan
from accelcal_cli.studies.other_recordings import pools
from accelcal_cli.studies.records import Item
from accelcal_cli.studies.summary import copies
from accelcal_cli.studies.task import CalibrationTask, Common, calibrated
from tests.cli.run import assert_one_line, report_of, run
from tests.cli.studies import rows, study
from tests.device_recordings import donor, rest, write_device
from tests.formats import make_opal
from tests.recordings import LSB_PER_G, directions, good_csv, good_raw, still_counts, write_csv, write_raw


def held(folder: Path) -> dict[str, bytes]:
    """All files by name."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def test_a_refused_six_pose_leaves_a_good_calibration(tmp_path: Path) -> None:
    path = good_raw(tmp_path)
    assert run("calibrate", "--model", 6, path, "--integers").code == 0
    before = held(tmp_path)
    ran = run("six-pose", path, "--face-degrees", 30)
    assert_one_line(ran, "good.calibration.json", "the result of accelcal calibrate", "-o", "--force", code=5)
    assert held(tmp_path) == before
    assert run("six-pose", path, "--face-degrees", 30, "-d", tmp_path / "other").code == 4
    assert held(tmp_path) == before


def test_calibrate_leaves_a_good_six_pose(tmp_path: Path) -> None:
    (tmp_path / "six.calibration.json").write_text(json.dumps(_six_pose(tmp_path)))
    before = held(tmp_path)
    ran = run("calibrate", "--model", 6, tmp_path / "six.csv.gz")
    assert_one_line(ran, "the result of accelcal six-pose", code=5)
    assert held(tmp_path) == before


def _six_pose(folder: Path) -> dict[str, Any]:
    sample = Path(__file__).resolve().parents[2] / "sample_data" / "six_faces.csv.gz"
    path = Path(shutil.copy(sample, folder / "six.csv.gz"))
    assert run("six-pose", path).code == 0
    return report_of(folder / "six.calibration.json")


def test_one_sensor_of_a_file_does_not_replace_another(tmp_path: Path) -> None:
    made = make_opal.make(tmp_path, still_counts(directions(60)), 25.0, LSB_PER_G)
    run("calibrate", "--model", 6, made.path, "--sensor", "XI-000001", "--report-only", code=0)
    before = held(tmp_path)
    ran = run("calibrate", "--model", 6, made.path, "--sensor", "XI-000002", "--report-only")
    assert_one_line(ran, "made.calibration.json", "a run with --sensor XI-000001", "-d", "-o", code=5)
    assert held(tmp_path) == before
    words = ("--sensor", "XI-000002", "--report-only", "-o", tmp_path / "left.parquet")
    assert run("calibrate", "--model", 6, made.path, *words).code == 0
    assert report_of(tmp_path / "left.calibration.json")["recording"]["device"]["serial"] == "XI-000002"


def test_columns_of_one_sensor_do_not_replace_those_of_another(tmp_path: Path) -> None:
    path = good_csv(tmp_path)
    assert run("calibrate", "--model", 6, path, "--report-only").code == 0
    ran = run("calibrate", "--model", 6, path, "--report-only", "--columns", "y,x,z")
    assert_one_line(ran, "the result of a run without --columns for", code=5)
    assert run("calibrate", "--model", 6, path, "--report-only", "--columns", "y,x,z", "--force").code == 0


def test_a_worker_keeps_what_apply_made(tmp_path: Path) -> None:
    coefficients, path, out = donor(tmp_path), tmp_path / "donor.raw", tmp_path / "out"
    assert run("apply", "--coefficients", coefficients, path, "-d", out).code == 0
    before, (job,) = held(out), plan([path], out, None)
    item = Item("donor.raw", job, (file_stamp(path), None, None))
    result = calibrated(CalibrationTask(item, Common(out, Request(), "asked")), lambda _part: None)
    assert (result.up_to_date, result.entry.row["parquet"]) == (True, "donor.calibrated.parquet")
    assert held(out) == before
    result = calibrated(CalibrationTask(item, Common(out, Request(force=True), "asked")), lambda _part: None)
    assert not result.up_to_date
    assert held(out) != before


@pytest.mark.nightly
def test_a_study_keeps_what_apply_made(tmp_path: Path) -> None:
    (tmp_path / "good").mkdir()
    coefficients = donor(tmp_path / "good")
    values, _ = rest(directions(12)[:4])
    (tmp_path / "in").mkdir()
    path = write_device(tmp_path / "in" / "few.raw", values)
    out = tmp_path / "out"
    assert study(tmp_path / "in", "--strict").code == 4
    assert run("apply", "--coefficients", coefficients, path, "-d", out).code == 0
    before = {name: data for name, data in held(out).items() if name.startswith("few.")}
    assert "few.calibrated.parquet" in before
    for _ in range(2):
        assert study(tmp_path / "in", "--borrow", "--pool", "device", "--strict").code == 0
        assert {name: data for name, data in held(out).items() if name.startswith("few.")} == before
        (row,) = rows(out)
        assert (row["outcome"], row["parquet"]) == ("borrowed", "few.calibrated.parquet")
        (out / "study.ledger").unlink()
    assert study(tmp_path / "in", "--force", "--strict").code == 4
    assert "few.calibrated.parquet" not in held(out)


def test_calibrate_leaves_what_apply_made(tmp_path: Path) -> None:
    coefficients, path, out = donor(tmp_path), tmp_path / "donor.raw", tmp_path / "out"
    assert run("apply", "--coefficients", coefficients, path, "-d", out).code == 0
    before = held(out)
    assert_one_line(run("calibrate", "--model", 6, path, "-d", out), "the result of accelcal apply", code=5)
    assert held(out) == before


def test_fit_leaves_the_report_of_a_recording(tmp_path: Path) -> None:
    coefficients = donor(tmp_path)
    before, points = held(tmp_path), tmp_path / "points.csv"
    points.write_text("\n".join(["x,y,z", *(",".join(map(str, one)) for one in directions(60))]) + "\n")
    assert_one_line(run("fit", points, "-o", coefficients), "is the report of another recording", code=5)
    assert held(tmp_path) == {**before, "points.csv": points.read_bytes()}


@pytest.mark.parametrize(
    ("command", "name", "part"),
    [
        ("calibrate", "foo.csv", "has to end in .parquet"),
        ("calibrate", "foo.json", "has to end in .parquet"),
        ("six-pose", "foo.parquet", "has to end in .json"),
        ("fit", "foo.csv", "has to end in .json"),
        ("calibrate", "-", "standard output"),
        ("six-pose", "-", "standard output"),
        ("fit", "-", "standard output"),
        ("simulate", "-", "standard output"),
    ],
)
def test_a_name_is_that_of_what_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str, name: str, part: str
) -> None:
    monkeypatch.chdir(tmp_path)
    path = write_raw(tmp_path / "a.raw", still_counts(directions(2)))
    words = (name,) if command == "simulate" else (path, "-o", name)
    before = held(tmp_path)
    assert_one_line(run(command, *words), part, code=2)
    assert held(tmp_path) == before


def test_a_folder_is_not_standard_output_either(tmp_path: Path) -> None:
    path = good_raw(tmp_path)
    for words in (("calibrate", path), ("six-pose", path), ("study", tmp_path)):
        assert_one_line(run(*words, "-d", "-"), "standard output", code=2)


def test_a_recording_and_its_own_export_are_both_calibrated(tmp_path: Path) -> None:
    """Whether the table lay there first, as here, or came later."""
    folder, out = tmp_path / "in", tmp_path / "out"
    folder.mkdir()
    write_csv(folder / "S01.csv", still_counts(directions(60)))
    assert study(folder, "--integers").code == 0
    write_raw(folder / "S01.raw", still_counts(directions(60)))
    ran = study(folder, "--integers")
    assert (ran.code, ran.err.count("\n")) == (0, 1), ran.err
    kinds = (".calibrated.parquet", ".calibration.json", ".integers.json", ".quality.json")
    expected = {f"{stem}{kind}" for stem in ("S01", "S01.csv") for kind in kinds}
    assert {name for name in held(out) if not name.startswith("study.")} == expected
    assert report_of(out / "S01.calibration.json")["recording"]["format"] == "raw"
    assert report_of(out / "S01.csv.calibration.json")["recording"]["format"] == "csv"
    table = {row["path"]: row["report"] for row in rows(out)}
    assert table == {"S01.csv": "S01.csv.calibration.json", "S01.raw": "S01.calibration.json"}
    assert "2 unchanged" in study(folder, "--integers").err


def test_a_foreign_ledger_stays(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    good_raw(tmp_path / "in")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "study.ledger").write_text("2024-03-04 rent 900\n")
    assert_one_line(study(tmp_path / "in"), "study.ledger", "not written by accelcal", code=5)
    assert held(tmp_path / "out") == {"study.ledger": b"2024-03-04 rent 900\n"}


def test_a_copy_is_known_by_device_and_content() -> None:
    def row(serial: str | None, sha256: str | None, outcome: str = "refused") -> dict[str, Any]:
        same = {"device_model": None, "lsb_per_g": 256.0, "range_g": 8.0, "lost_percent": 0.0}
        return {"device_serial": serial, "sha256": sha256, "outcome": outcome, **same}

    serials = {"c": "A1", "a": "A2", "b": "A1", "d": "B1", "e": "B1"}
    table = {name: row(serial, sha256) for name, (serial, sha256) in serials.items()}
    table |= {"f": row(None, "3"), "g": row(None, "3"), "h": row("A", "4", "borrowed")}
    table |= {"i": row(None, None), "j": row(None, None)}
    assert copies(table) == {"c": "b", "e": "d", "g": "f"}
    assert pools(table) == [["a", "b"]]


@pytest.mark.nightly
def test_copies_of_one_file_count_once_in_a_pool(tmp_path: Path) -> None:
    values, _ = rest(directions(24))
    half = len(values) // 2
    folder = tmp_path / "in"
    folder.mkdir()
    for name, part in (("one", values[:half]), ("two", values[half:])):
        write_device(folder / f"{name}.raw", part)
    assert study(folder, "--pool", "device", "--report-only").code == 0
    (pool,) = (tmp_path / "out").glob("study.pool.*.json")
    alone = report_of(pool)
    write_device(folder / "two again.raw", values[half:])
    ran = study(folder, "--pool", "device", "--report-only", code=0)
    assert "two again.raw: a copy of two.raw, which counts once" in ran.err
    (pool,) = (tmp_path / "out").glob("study.pool.*.json")
    made = report_of(pool)
    for section in ("calibration", "holdout", "fit", "coverage", "models_tried"):
        assert made[section] == alone[section]
    assert [len(made["pool"][name]) for name in ("recordings", "copies")] == [2, 1]
    assert made["pool"]["copies"][0]["path"].endswith("two again.raw")
    table = {row["path"]: row for row in rows(tmp_path / "out")}
    assert [row["pool_recordings"] for row in table.values()] == ["2"] * 3
    copied = {path: row["copy_of"] for path, row in table.items()}
    assert copied == {"one.raw": "", "two again.raw": "two.raw", "two.raw": ""}
    assert "3 unchanged" in study(folder, "--pool", "device", "--report-only").err
