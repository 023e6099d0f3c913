"""`accelcal six-pose` with one file for each face, and where poses are few, rolled or of any size."""

from __future__ import annotations

import gzip
import json
import re
import tarfile
from pathlib import Path

import numpy as np
import pytest

import accelcal
from accelcal_cli.core.errors import DivergedError, UsageError
from tests.cli.run import assert_one_line, codes, nightly, report_of, run, told, verify
from tests.pages.html import check
from tests.recordings import good_csv
from tests.six_pose.made import RATE_HZ, UP, K, O, sensed, session, six_faces, start_s, write_csv, write_list

NAMES = {face: f"{'minus' if face[0] == '-' else 'plus'}_{face[1]}.csv" for face in UP}
ANY = [(0, 0, 1), (0, 0, -1), (0, 2, 1), (0, -2, 1), (3, 0, 1), (-3, 0, 1), (0, 5, 1), (1, 2, 2)]


def folder_of(folder: Path, seconds: float = 10.0) -> Path:
    """A file for each face, all of which begin at the same time."""
    folder.mkdir()
    for number, (face, name) in enumerate(NAMES.items()):
        write_csv(folder / name, session([face], seconds, seed=number + 1))
    return folder


def list_of_files(path: Path, faces: dict[str, str] = NAMES) -> Path:
    lines = [f"{name},{','.join(map(str, UP[face]))}" for face, name in faces.items()]
    return write_list(path, lines, "file,ax,ay,az")


def refused(code: int, *words: object) -> str:
    ran = run("six-pose", *words)
    assert (ran.code, ran.out) == (code, ""), ran.err
    assert_one_line(ran)
    return ran.err


def rolled(axis: int = 2, seconds: float = 20.0) -> np.ndarray:
    angle = np.linspace(0, 4 * np.pi, round(seconds * RATE_HZ))
    true = np.zeros((len(angle), 3))
    one, two = (other for other in range(3) if other != axis)
    true[:, one], true[:, two] = np.cos(angle), np.sin(angle)
    return sensed(true, 9)


def test_a_folder_of_one_file_a_face(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "faces")
    ran = run("six-pose", folder)
    assert (ran.code, ran.err) == (0, "")
    report = report_of(tmp_path / "faces.calibration.json")
    known = report["known_orientations"]
    assert np.all(np.abs(known["K"] - K) < 3 * np.array(known["standard_errors"]["K"]))
    assert np.all(np.abs(known["O"] - O) < 3 * np.array(known["standard_errors"]["O"]))
    faces = {name: face for face, name in NAMES.items()}
    assert [(pose["file"], pose["face"]) for pose in report["poses"]] == sorted(faces.items())
    assert {(pose["start_s"], pose["end_s"]) for pose in report["poses"]} == {(4.0, 12.0)}
    assert [one["name"] for one in known["files"]] == sorted(faces)
    assert {one["start_time"] for one in known["files"]} == {"2024-03-04T08:00:00.000000"}
    assert {one["samples"] for one in known["files"]} == {800}
    assert report["recording"]["samples"] == 4800
    assert report["recording"]["gaps"] == report["file_health"]["problems"] == []
    assert "a session of 6 files (minus_x.csv, minus_y.csv" in report["recording"]["notes"][-1]
    ran, found = verify(tmp_path / "faces.calibration.json", folder)
    assert (ran.code, found["differs"]) == (0, [])


def test_the_calibration_is_that_of_one_recording_with_the_same_states(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "faces")
    order = sorted(NAMES, key=NAMES.__getitem__)
    rows = [session([face], seed=list(UP).index(face) + 1) for face in order]
    whole = write_csv(tmp_path / "whole.csv", np.concatenate(rows))
    for path in (folder, whole):
        assert run("six-pose", path).code == 0
    parts, one = (report_of(tmp_path / f"{name}.calibration.json") for name in ("faces", "whole"))
    assert parts["calibration"] == one["calibration"]
    assert parts["holdout"] == one["holdout"]


@pytest.mark.parametrize("chunk", [77, nightly(1)])
def test_the_bits_do_not_depend_on_the_chunk_size(tmp_path: Path, chunk: int) -> None:
    folder = folder_of(tmp_path / "faces", 4.0)
    write_csv(folder / "roll.csv", rolled(seconds=5.0))
    words = ("six-pose", folder, "--roll", "z,roll.csv", "--json", "--force")
    whole, cut = (json.loads(run(*words, *more).out) for more in ((), ("--chunk-samples", chunk)))
    del whole["provenance"], cut["provenance"]
    assert cut == whole


def test_a_list_names_the_files(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "faces")
    listed = list_of_files(folder / "poses.csv")
    assert run("six-pose", *sorted(folder.glob("*.csv")), "--poses", listed, "-d", tmp_path).code == 0
    by_list = report_of(tmp_path / "faces.calibration.json")
    assert run("six-pose", folder, "-d", tmp_path / "found").code == 0
    found = report_of(tmp_path / "found/faces.calibration.json")
    assert by_list["calibration"] == found["calibration"]
    assert verify(tmp_path / "faces.calibration.json", folder)[0].code == 0
    for pose, other in zip(by_list["poses"], found["poses"], strict=True):
        assert pose == other


def test_files_may_lie_in_folders_or_in_an_archive(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "faces")
    (folder / "late").mkdir()
    for face in ("+x", "-x"):
        path = folder / NAMES[face]
        packed = folder / "late" / f"{path.name}.gz"
        packed.write_bytes(gzip.compress(path.read_bytes()))
        path.unlink()
    faces = NAMES | {face: f"late/{NAMES[face]}.gz" for face in ("+x", "-x")}
    listed = list_of_files(tmp_path / "angles.csv", faces)
    with tarfile.open(tmp_path / "packed.tar", "w") as archive:
        archive.add(folder, ".")
    flat = list_of_files(tmp_path / "flat.csv", {face: Path(name).name for face, name in faces.items()})
    for path, names in ((folder, listed), (tmp_path / "packed.tar", flat)):
        ran = run("six-pose", path, "--poses", names)
        assert (ran.code, ran.err) == (0, "")
    one, two = (report_of(tmp_path / f"{name}.calibration.json") for name in ("faces", "packed"))
    assert one["calibration"] == two["calibration"]
    assert verify(tmp_path / "packed.calibration.json", tmp_path / "packed.tar", "--poses", flat)[0].code == 0
    with tarfile.open(tmp_path / "twice.tar", "w") as archive:
        for name in ("a/x.csv", "b/x.csv"):
            archive.add(folder / "plus_y.csv", name)
    assert "holds two files called x.csv" in refused(3, tmp_path / "twice.tar")
    packed = (tmp_path / "packed.tar").read_bytes()
    (tmp_path / "cut.tar").write_bytes(packed[: len(packed) // 2])
    assert "the archive breaks off after" in refused(3, tmp_path / "cut.tar")


def test_damage_is_told_with_its_file(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "faces")
    path = folder / NAMES["+y"]
    lines = path.read_text().splitlines()
    lines[400] = lines[400].split(",")[0] + ",nan,0,0"
    path.write_text("\n".join(lines) + "\n")
    assert run("six-pose", folder).code == 0
    report = report_of(tmp_path / "faces.calibration.json")
    (problem,) = report["file_health"]["problems"]
    assert (problem["code"], problem["sample"]) == ("missing_value", 4 * 800 + 399)
    assert problem["message"].startswith("plus_y.csv: ")
    assert [one["problems"] for one in report["known_orientations"]["files"]] == [0, 0, 0, 0, 1, 0]


def test_a_file_that_does_not_belong_ends_the_session(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "faces")
    other = folder / "z_other.csv"
    for content, code, said in (
        (b"hello\n" * 20, 3, "z_other.csv: is text without rows"),
        (b"", 3, "z_other.csv"),
        (b"\x00" * 2000, 3, "z_other.csv"),
    ):
        other.write_bytes(content)
        assert said in refused(code, folder)
    slow = session(["+x"])[::2]
    text = write_csv(other, slow).read_text().splitlines()
    times = [
        line.partition(",")[0] for line in write_csv(other, session(["+x"])).read_text().splitlines()[1::2]
    ]
    rows = [f"{time},{line.partition(',')[2]}" for time, line in zip(times, text[1:], strict=True)]
    other.write_text("\n".join(["time,x,y,z", *rows]) + "\n")
    assert "does not go with minus_x.csv: its sampling rate is another" in refused(2, folder)
    write_csv(other, session([(0.6, 0.8, 0)]))
    assert "z_other.csv: no rest of 2 s lies within 15 degrees of a face" in refused(4, folder)
    other.unlink()
    assert not (tmp_path / "faces.calibration.json").exists()
    assert run("six-pose", folder).code == 0


def test_files_of_another_device_end_the_session(tmp_path: Path) -> None:
    from tests.device_recordings import write_device

    folder = tmp_path / "faces"
    folder.mkdir()
    for number, face in enumerate(("+x", "-x", "+y")):
        held = sensed(np.tile(np.array(UP[face], float), (400, 1)), number)
        write_device(folder / f"{number}.raw", held, serial="A1" if number < 2 else "B2")
    line = refused(2, folder)
    assert "2.raw: is of another device than 0.raw: its serial number is B2, not A1" in line


@pytest.mark.parametrize(
    ("change", "code", "told"),
    [
        ({"-z": "minus_q.csv"}, 2, "'minus_q.csv' is not a file of the session; did you mean 'minus_"),
        ({"-z": None}, 2, "does not list minus_z.csv; write a line for each file"),
    ],
)
def test_lists_of_other_files(tmp_path: Path, change: dict[str, str | None], code: int, told: str) -> None:
    folder = folder_of(tmp_path / "faces")
    faces = {face: name for face, name in (NAMES | change).items() if name is not None}
    assert told in refused(code, folder, "--poses", list_of_files(tmp_path / "list.csv", faces))
    one = six_faces(tmp_path, seconds=4.0)
    line = refused(2, one, "--poses", list_of_files(tmp_path / "list.csv"))
    assert "names a file, but the session is one recording" in line


def test_what_no_pattern_stands_for_is_wrong_usage(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "faces")
    some = [folder / name for name in ("plus_x.csv", "plus_z.csv")]
    assert "cannot be told from other files by a pattern" in refused(2, *some)
    assert "standard input is one recording" in refused(2, some[0], "-")
    assert "none.csv: file not found" in refused(3, some[0], folder / "none.csv")
    assert "faces: is a folder" in refused(3, some[0], folder)
    (tmp_path / "empty").mkdir()
    assert "holds no recordings" in refused(3, tmp_path / "empty")


def test_a_list_among_the_recordings(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "faces", 4.0)
    listed = list_of_files(folder / "angles.csv")
    told = "angles.csv: the list of poses lies among the files of the session; call it poses.csv"
    for path in (folder, folder / "*.csv"):
        assert told in refused(2, path, "--poses", listed)
    line = refused(2, *sorted(folder.glob("*.csv")), "--poses", listed)
    assert "angles.csv: the list of poses is named as a recording" in line


def test_a_report_must_not_become_a_file_of_the_session(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "faces")
    assert "would be among the files of the session" in refused(2, folder, "-o", folder / "r.json")
    for words in (("-d", folder), ("-o", folder / "r.calibration.json"), ("-o", tmp_path / "r.json")):
        for _ in range(2):
            assert run("six-pose", folder, *words).code == 0


def test_a_changed_file_is_done_again(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "faces")
    assert run("six-pose", folder).code == 0
    assert "up to date" in run("six-pose", folder).err
    write_csv(folder / NAMES["+x"], session(["+x"], seed=77))
    ran = run("six-pose", folder)
    assert (ran.code, ran.err) == (0, "")


def test_four_poses_unchecked_say_so_everywhere(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "four.csv", session(["+x", "-x", "+y", "+z"]))
    assert "with --unchecked" in refused(4, path)
    ran = run("six-pose", path, "--unchecked", "-q")
    assert (ran.code, ran.lines[0].split("\t")[1:6]) == (0, ["calibrated", "12", "-", "-", "-"])
    assert_one_line(ran, "Nothing was held out: no error is known")
    report = report_of(tmp_path / "four.calibration.json")
    assert report["settings"]["unchecked"] is True
    known = report["known_orientations"]
    assert known["unchecked"] == "nothing_held_out"
    assert report["holdout"] is known["holdout_vector_mg"] is known["standard_errors"] is None
    assert report["fit"]["after_mg"] is report["calibration"]["standard_errors"] is None
    assert [trial["after_mg"] for trial in report["models_tried"]] == [None, None]
    assert np.abs(known["K"] - K).max() < 2e-3
    ran = run("six-pose", path, "--unchecked", "-v")
    assert ran.err.count("Nothing was held out") == 1, "not twice"
    assert verify(tmp_path / "four.calibration.json", path)[0].code == 0
    coefficients, other = tmp_path / "four.calibration.json", good_csv(tmp_path)
    ran = run("apply", "--coefficients", coefficients, path, "-d", tmp_path / "own")
    assert_one_line(ran, "Nothing was held out: no error is known")
    own = report_of(tmp_path / "own/four.calibration.json")
    assert (own["outcome"], own["holdout"], own["known_orientations"]) == ("calibrated", None, known)
    assert verify(tmp_path / "own/four.calibration.json", path)[0].code == 0
    assert run("apply", "--coefficients", coefficients, other, "--any-device").code == 0
    assert run("report", coefficients).code == 0
    page = (tmp_path / "four.html").read_text()
    assert "Use with care" in page
    assert "Nothing was held out: no error is known" in page


def test_a_roll_is_told_in_the_report(tmp_path: Path) -> None:
    raw = np.vstack([session(["+x", "-x", "+y", "+z"]), rolled()])
    path = write_csv(tmp_path / "s.csv", raw)
    words = ("--unchecked", "--roll", "z,55,75", "--roll", "z,2024-03-04T08:00:58,74")
    ran = run("six-pose", path, *words, code=0)
    report = report_of(tmp_path / "s.calibration.json")
    assert_one_line(ran, told(report, "roll_alone_checks_poses"))
    one, two = report["known_orientations"]["rolls"]
    found = report["calibration"]
    a = (raw[2750:3750] + found["offset_g"]) @ np.array(found["gain"]).T
    assert (one["axis"], one["start_s"], one["end_s"], one["samples"]) == ("z", 55.0, 74.98, 1000)
    assert one["level_mg"]["before"]["mean"] == pytest.approx(1000 * raw[2750:3750, 2].mean(), abs=2e-4)
    assert one["level_mg"]["after"]["mean"] == pytest.approx(1000 * a[:, 2].mean(), abs=2e-4)
    assert one["level_mg"]["after"]["sd"] == pytest.approx(1000 * a[:, 2].std(), abs=2e-4)
    assert one["length_g"]["after"] == pytest.approx(np.sqrt((a**2).sum(axis=1).mean()), abs=1e-4)
    assert (two["start_s"], two["samples"]) == (58.0, 800)
    assert codes(report["notes"]) == ["rolled", "rolled"]
    assert report["settings"]["roll"] == ["z,55,75", "z,2024-03-04T08:00:58,74"]
    assert verify(tmp_path / "s.calibration.json", path)[0].code == 0
    assert run("report", tmp_path / "s.calibration.json").code == 0
    page = check((tmp_path / "s.html").read_text())
    tables = {one.all("caption")[0].text: one for one in page.all("table")}
    cells = [cell.text for cell in tables["Rolls about a level axis, on which gravity should be 0"].all("td")]
    assert cells[0] == "55 to 75 s"
    assert re.fullmatch(r"4[45]\.?\d? \(1[12]\.?\d?\)", cells[1])
    assert len(tables["Poses, and the errors of their vectors"].all("tr")) == 5
    line = refused(4, path, "--unchecked", "--roll", "y,55,75", "--force")
    assert "does not roll there by half a turn, with y level" in line
    assert "names no axis" in refused(2, path, "--roll", "up")


def test_a_file_of_the_session_may_be_a_roll(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "faces")
    write_csv(folder / "roll.csv", rolled(axis=0))
    listed = list_of_files(tmp_path / "list.csv")
    reports = []
    for more in ((), ("--poses", listed)):
        assert run("six-pose", folder, "--roll", "x,roll.csv", *more).code == 0
        reports.append(report_of(tmp_path / "faces.calibration.json"))
    found, by_list = reports
    assert found["known_orientations"]["rolls"] == by_list["known_orientations"]["rolls"]
    (roll,) = found["known_orientations"]["rolls"]
    assert (roll["file"], roll["start_s"], roll["samples"]) == ("roll.csv", 0.0, 1000)
    assert abs(roll["level_mg"]["after"]["mean"]) < 0.5
    assert abs(roll["level_mg"]["before"]["mean"]) > 30


def test_what_looks_still_in_a_slow_roll_is_no_pose(tmp_path: Path) -> None:
    turn = np.arange(0, 360, 0.02)
    true = np.stack([np.cos(np.radians(turn)), np.sin(np.radians(turn)), 0 * turn], axis=1)
    path = write_csv(tmp_path / "s.csv", np.vstack([session(list(UP)), sensed(true, 4)]))
    assert run("six-pose", path).code == 4, "1 degree a second is still, and up to 15 degrees off"
    assert run("six-pose", path, "--roll", "z,81,442", "--force").code == 0
    report = report_of(tmp_path / "s.calibration.json")
    assert len(report["poses"]) == 6
    assert report["known_orientations"]["left_out"]["between_faces"] == 0


def test_a_refused_session_has_a_roll_before_only(tmp_path: Path) -> None:
    poses = [*UP.values()]
    poses[2] = (0.2, 0.98, 0.0)
    path = write_csv(tmp_path / "s.csv", np.vstack([session(list(poses)), rolled()]))
    assert run("six-pose", path, "--roll", "z,81,101").code == 4
    (roll,) = report_of(tmp_path / "s.calibration.json")["known_orientations"]["rolls"]
    assert roll["level_mg"]["after"] is roll["length_g"]["after"] is None


@pytest.mark.parametrize(("end", "factor"), [("_g", 1.0), ("_ms2", 9.80665)])
def test_accelerations_of_any_size(tmp_path: Path, end: str, factor: float) -> None:
    path = write_csv(tmp_path / "fast.csv", session(list(ANY)))
    lines = [
        ",".join(map(str, (start_s(n), start_s(n) + 10, *(factor * value for value in vector))))
        for n, vector in enumerate(ANY)
    ]
    header = f"start,end,{','.join(f'a{axis}{end}' for axis in 'xyz')}"
    listed = write_list(tmp_path / "fast.poses.csv", lines, header)
    words = ("six-pose", path, "--unit", "g", "--poses", listed)
    assert run(*words).code == 0
    report = report_of(tmp_path / "fast.calibration.json")
    known = report["known_orientations"]
    assert np.all(np.abs(known["K"] - K) < 4 * np.array(known["standard_errors"]["K"]))
    assert np.abs(known["K"] - K).max() < 2e-4
    assert known["orientations"] == 8
    assert known["holdout_vector_mg"]["after"]["mean"] < 0.5
    np.testing.assert_allclose([pose["reference_g"] for pose in report["poses"]], ANY, atol=2e-9)
    assert verify(tmp_path / "fast.calibration.json", path)[0].code == 0
    assert run(*words, "--latitude", 0, "--altitude", 3000).code == 0
    again = report_of(tmp_path / "fast.calibration.json")
    assert again["poses"] == report["poses"], "the references hold gravity already"


def test_means_beyond_what_any_reference_is_are_refused(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "s.csv", session(list(UP)), factor=80.0)
    lines = [f"{start_s(n)},{start_s(n) + 10},{x},{y},{z}" for n, (x, y, z) in enumerate(UP.values())]
    listed = write_list(tmp_path / "p.csv", lines, "start,end,ax_g,ay_g,az_g")
    words = ("--unit", "g", "--stillness-threshold-g", 4)
    assert_one_line(run("six-pose", path, "--poses", listed, *words), code=4)


def test_from_python(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "faces")
    write_csv(folder / "roll.csv", rolled())
    listed = list_of_files(tmp_path / "list.csv")
    words = ("--poses", listed, "--roll", "z,roll.csv", "--latitude", 52, "--json", "-d", tmp_path / "out")
    written = json.loads(run("six-pose", folder, *words).out)
    report = accelcal.from_poses(folder, poses=listed, roll=["z,roll.csv"], latitude=52).report
    assert report.pop("provenance")["command"] == ["accelcal.from_poses"]
    del written["provenance"]
    assert report == written
    assert not list(tmp_path.glob("*.json")), "nothing is written"
    several = accelcal.from_poses(sorted(folder.glob("*.csv")), roll=("z,roll.csv",), latitude=52)
    assert several["calibration"] == report["calibration"]
    four = write_csv(tmp_path / "four.csv", session(["+x", "-x", "+y", "+z"]))
    with pytest.raises(DivergedError, match="not to check it"):
        accelcal.from_poses(four)
    assert accelcal.from_poses(four, unchecked=True)["holdout"] is None
    with pytest.raises(UsageError, match="face_degrees cannot be 100"):
        accelcal.from_poses(four, face_degrees=100.0)
    with pytest.raises(TypeError, match="no option 'unchekced'"):
        accelcal.from_poses(four, unchekced=True)
