"""Results do not depend on how a path was typed, and a report leads back to its recording."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.cli.run import assert_one_line, run
from tests.recordings import good_csv, good_raw


def without_provenance(path: Path) -> dict:
    report = json.loads(path.read_text())
    del report["provenance"]
    return report


def test_p8_any_way_to_a_file_gives_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Parquet to the byte, reports but for the provenance; through a linked folder, a link, and `..`."""
    folder = tmp_path / "data"
    folder.mkdir()
    path = good_csv(folder)
    (tmp_path / "linked").symlink_to(folder)
    (tmp_path / "links").mkdir()
    (tmp_path / "links/good.csv").symlink_to(path)
    monkeypatch.chdir(folder)
    typed = [
        "good.csv",
        path,
        "./good.csv",
        "../data/good.csv",
        "../linked/good.csv",
        tmp_path / "links/good.csv",
    ]
    found = []
    for number, words in enumerate(typed):
        out = tmp_path / f"out{number}"
        assert run("calibrate", words, "-d", out, "-q").code == 0
        report = without_provenance(out / "good.calibration.json")
        found.append(((out / "good.calibrated.parquet").read_bytes(), json.dumps(report)))
        assert report["recording"]["path"] == "good.csv"
        assert run("calibrate", path, "-d", out).err.count("up to date") == 1  # whichever was typed
    assert len(set(found)) == 1


def test_p8_so_do_paths_of_coefficients(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, donor = good_raw(tmp_path), tmp_path / "c"
    assert run("calibrate", path, "-d", donor, "-q").code == 0
    monkeypatch.chdir(tmp_path)
    found = []
    for number, coefficients in enumerate([donor / "good.calibration.json", "c/good.calibration.json"]):
        out = tmp_path / f"out{number}"
        words = ("apply", "--coefficients", coefficients, "good.raw", "-d", out, "-q")
        assert run(*words).code == 0
        found.append(without_provenance(out / "good.calibration.json"))
        monkeypatch.chdir("/")
        assert run("verify", out / "good.calibration.json", path).code == 0
        monkeypatch.chdir(tmp_path)
    assert found[0] == found[1] and found[0]["coefficients"]["path"] == "good.calibration.json"


def test_a_report_of_another_recording_of_the_name_is_not_replaced(tmp_path: Path) -> None:
    """The report holds no folder; its provenance says where the recording was."""
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    one, other = good_csv(tmp_path / "a"), good_raw(tmp_path / "b")
    out = tmp_path / "out"
    assert run("calibrate", one, "-d", out, "-q").code == 0
    held = {path: path.read_bytes() for path in out.iterdir()}
    ran = run("calibrate", other, "-d", out, "-q", code=5)
    assert_one_line(ran, "is the report of another recording", str(one), "-d")
    assert held == {path: path.read_bytes() for path in out.iterdir()}
    one.write_text(one.read_text() + "2024-03-05T00:00:00,0,0,1\n")  # the same place: changed, not another
    assert run("calibrate", one, "-d", out, "-q").code == 0
    run("calibrate", other, "-d", out, "-q", "--force", code=0)


def test_verify_finds_what_the_report_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = good_csv(tmp_path)
    assert run("calibrate", path, "-d", tmp_path / "out", "-q").code == 0
    report = tmp_path / "out/good.calibration.json"
    assert run("verify", report).out.split("\t")[1] == "identical"  # where it was
    moved = tmp_path / "moved"
    moved.mkdir()
    for one in (path, report, tmp_path / "out/good.calibrated.parquet"):
        shutil.move(one, moved)
    monkeypatch.chdir(moved)
    assert run("verify", "good.calibration.json").out.split("\t")[1] == "identical"  # next to it
    (moved / "good.csv").unlink()
    ran = run("verify", "good.calibration.json", code=2)
    assert_one_line(
        ran, "its recording, good.csv, is not next to it; accelcal verify good.calibration.json RECORDING"
    )


@pytest.mark.parametrize("files", [5, {"recording": 5}, {"recording": "\\x00"}, {"recording": "/nowhere/a"}])
def test_a_report_that_says_nonsense_of_where_its_files_were(tmp_path: Path, files: object) -> None:
    path = good_raw(tmp_path)
    assert run("calibrate", path, "-q").code == 0
    report = tmp_path / "good.calibration.json"
    held = json.loads(report.read_text())
    held["provenance"]["files"] = files
    report.write_text(json.dumps(held))
    assert run("verify", report).code in (0, 3)
    assert run("export", report, "--to", "biobank", "-q").code in (0, 3)
    assert run("calibrate", path, "-q").code == 0
    assert "files" in json.loads(report.read_text())["provenance"]
