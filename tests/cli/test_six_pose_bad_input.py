"""`accelcal six-pose` where it cannot succeed: one clear line, a code, and nothing written."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.cli.run import assert_one_line, run
from tests.recordings import good_csv
from tests.schema import check_report
from tests.six_pose.made import UP, moved, session, six_faces, start_s, turned, write_csv, write_list


def refused(code: int, *words: object) -> str:
    """The one line of a run that must end with this code and print nothing."""
    ran = run("six-pose", *words)
    assert ran.code == code, ran.err
    assert ran.out == ""
    assert_one_line(ran)
    return ran.err


def only(folder: Path, *names: str) -> bool:
    return sorted(path.name for path in folder.iterdir()) == sorted(names)


@pytest.mark.parametrize(
    ("poses", "told"),
    [
        (["+x"], "only 1 pose found (+x), and at least 5 are needed"),
        (["+x", "-x", "+y", "-y"], "missing: +z, -z"),
        (["+x", "+y", "+z"], "missing: -x, -y, -z"),
        (["+x", "-x", "+y", "+z"], "enough for a fit, but not to check it; missing: -y, -z"),
        ([(0.6, 0.8, 0)] * 2, "no still state lies within 15 degrees of a face; 2 lie between faces"),
    ],
)
def test_too_few_faces(tmp_path: Path, poses: list[object], told: str) -> None:
    path = write_csv(tmp_path / "s.csv", session(poses, seconds=5.0))
    line = refused(4, path)
    assert line.startswith(f"accelcal: {path}: ")
    assert told in line
    assert only(tmp_path, "s.csv")


def test_no_stillness(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "s.csv", moved(40, 1))
    assert "none of 40 windows of 1 s is still; rest the device" in refused(4, path)
    assert only(tmp_path, "s.csv")


def test_a_device_that_repeats_one_value(tmp_path: Path) -> None:
    held = np.repeat(np.array(list(UP.values()), float), 500, axis=0)
    path = write_csv(tmp_path / "s.csv", held)
    assert "holds one constant value" in refused(4, path)


def test_a_wrong_unit(tmp_path: Path) -> None:
    path = six_faces(tmp_path, seconds=4.0)
    assert "far from 1 g; check the unit" in refused(4, path, "--unit", "m/s2")


def test_listed_poses_of_a_scale_that_fixed_point_cannot_hold(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "s.csv", session(list(UP)), factor=0.2)
    lines = [f"{start_s(n)},{start_s(n) + 10},{x},{y},{z}" for n, (x, y, z) in enumerate(UP.values())]
    listed = write_list(tmp_path / "poses.csv", lines)
    assert "a parameter leaves" in refused(4, path, "--unit", "g", "--poses", listed)
    assert only(tmp_path, "s.csv", "poses.csv")


def test_missing_values_are_gaps_and_all_of_them_are_an_error(tmp_path: Path) -> None:
    path = six_faces(tmp_path)
    lines = path.read_text().splitlines()
    at = 1 + round((start_s(2) + 5.5) * 50)
    lines[at] = lines[at].split(",")[0] + ",nan,0.1,0.2"
    path.write_text("\n".join(lines) + "\n")
    ran = run("six-pose", path, "--json", code=0)
    report = json.loads(ran.out)
    assert [problem["code"] for problem in report["file_health"]["problems"]] == ["missing_value"]
    assert [pose["face"] for pose in report["poses"]] == ["+x", "-x", "+y", "+y", "-y", "+z", "-z"]
    hollow = tmp_path / "hollow.csv"
    hollow.write_text(
        "time,x,y,z\n" + "\n".join(f"{line.split(',')[0]},nan,nan,nan" for line in lines[1:]) + "\n"
    )
    assert str(hollow) in refused(3, hollow)
    assert only(tmp_path, "session.csv", "session.calibration.json", "hollow.csv")


def test_tilted_faces_are_refused_with_a_report_that_says_which(tmp_path: Path) -> None:
    poses: list[object] = list(UP)
    poses[2] = turned(UP["+y"], 6.0)
    path = write_csv(tmp_path / "s.csv", session(poses))
    ran = run("six-pose", path, code=4)
    assert ran.out.split("\t")[1:3] == ["refused", "-"]
    assert_one_line(ran, "refused: the poses disagree", "y at ", "Rest the device exactly on its faces")
    report = json.loads((tmp_path / "s.calibration.json").read_text())
    check_report(report)
    assert report["calibration"] is None
    assert report["known_orientations"]["K"] is None
    tilts = {pose["face"]: pose["held_out_tilt_degrees"] for pose in report["poses"]}
    assert tilts["+y"] == pytest.approx(6.0, abs=0.3)
    assert max(tilts, key=lambda face: tilts[face]) in ("+y", "-y")


@pytest.mark.parametrize(
    ("lines", "code", "told"),
    [
        (["3,13,1,0"], 2, "poses.csv, line 2: has 4 values, the header 5"),
        (["3,13,9.81,0,0"], 2, "poses.csv, line 2: the reference has the length 9.81"),
        (["3,13,1,0,0", "900,910,-1,0,0"], 4, "poses.csv, line 3: no still window of 1 s"),
        (["0,2.9,1,0,0"], 4, "poses.csv, line 2: no still window of 1 s"),
        (["3,13,1,0,0", "12,20,-1,0,0"], 2, "poses.csv, line 3: overlaps line 2"),
        (["3,13,1,0,0"], 4, "only 1 pose found (+x), and at least 5 are needed"),
    ],
)
def test_a_list_that_is_wrong(tmp_path: Path, lines: list[str], code: int, told: str) -> None:
    path = six_faces(tmp_path)
    listed = write_list(tmp_path / "poses.csv", lines)
    assert told in refused(code, path, "--poses", listed)
    assert only(tmp_path, "session.csv", "poses.csv")


def test_swapped_lines_of_a_list_are_refused(tmp_path: Path) -> None:
    path = six_faces(tmp_path)
    vectors = [*UP.values()]
    vectors[0], vectors[2] = vectors[2], vectors[0]
    lines = [f"{start_s(n)},{start_s(n) + 10},{x},{y},{z}" for n, (x, y, z) in enumerate(vectors)]
    ran = run("six-pose", path, "--poses", write_list(tmp_path / "poses.csv", lines), code=4)
    assert "the poses disagree" in ran.err


def test_a_missing_recording_and_a_missing_list(tmp_path: Path) -> None:
    assert "nothing.csv: file not found" in refused(3, tmp_path / "nothing.csv")
    path = six_faces(tmp_path, seconds=4.0)
    assert "none.csv: the list of poses cannot be read" in refused(2, path, "--poses", tmp_path / "none.csv")
    assert "the list of poses cannot be read" in refused(2, path, "--poses", tmp_path)


def test_inputs_are_never_overwritten(tmp_path: Path) -> None:
    path = six_faces(tmp_path, seconds=4.0)
    lines = [
        f"{start_s(n, 4.0)},{start_s(n, 4.0) + 4},{x},{y},{z}" for n, (x, y, z) in enumerate(UP.values())
    ]
    listed = write_list(tmp_path / "poses.csv", lines)
    before = (path.read_bytes(), listed.read_bytes())
    refused(2, path, "-o", path, "--force")
    refused(2, path, "--poses", listed, "-o", listed, "--force")
    assert (path.read_bytes(), listed.read_bytes()) == before
    assert run("six-pose", path, "--poses", listed).code == 0


def test_reports_of_others_are_kept_without_force_and_its_own_is_up_to_date(tmp_path: Path) -> None:
    path, report = six_faces(tmp_path, seconds=4.0), tmp_path / "session.calibration.json"
    report.write_text("{}")
    assert "was not written by accelcal" in refused(5, path)
    assert report.read_text() == "{}"
    first, stamp = run("six-pose", path, "--force", code=0), report.stat().st_mtime_ns
    again = run("six-pose", path, code=0)
    assert again.out == first.out and "up to date" in again.err and report.stat().st_mtime_ns == stamp
    other = write_csv(tmp_path / "other.csv", session(["+z"]))
    assert "is the report of another recording" in refused(5, other, "-o", report)


def test_parquet_of_a_replaced_calibration_does_not_outlive_it(tmp_path: Path) -> None:
    path = good_csv(tmp_path)
    assert run("calibrate", path, "--integers").code == 0
    run("six-pose", path, "--face-degrees", 30, "--force", code=4)
    assert only(tmp_path, "good.csv", "good.calibration.json")
