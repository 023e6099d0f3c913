"""`accelcal six-pose` from outside: sessions in, reports out."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.calibration import PARAMETER_NAMES, UPPER_NAMES
from accelcal_cli.core.clock import UniformClock, rate_fraction
from accelcal_cli.core.recording import Chunk, Recording
from accelcal_cli.formats.flash.writer import ENCODER
from tests.cli.run import files, nightly, report_of, run, run_process, told
from tests.schema import check_report
from tests.six_pose.made import (
    LSB_PER_G,
    RATE_HZ,
    START,
    UP,
    K,
    O,
    sensed,
    session,
    six_faces,
    start_s,
    write_csv,
    write_list,
)

PLACES = ((0, 0), (1, 1), (2, 2), (1, 0), (2, 0), (2, 1), (0, 1), (0, 2), (1, 2))


def calibrated(path: Path, *words: object) -> dict:
    """The report without its provenance, of a recording that must be calibrated."""
    ran = run("six-pose", path, "--json", *words, code=0)
    report = json.loads(ran.out)
    check_report(report)
    assert report.pop("provenance")["command"]
    return report


def test_a_session_gives_a_report_and_one_line(tmp_path: Path) -> None:
    path = six_faces(tmp_path)
    ran = run("six-pose", path)
    assert (ran.code, ran.err) == (0, "")
    fields = ran.out.rstrip("\n").split("\t")
    assert fields[:3] == [str(path), "calibrated", "12"]
    assert fields[6] == str(tmp_path / "session.calibration.json")
    assert float(fields[3]) > 20
    assert float(fields[4]) < 0.5
    assert files(tmp_path) == ["session.calibration.json", "session.csv"]
    report = report_of(tmp_path / "session.calibration.json")
    values = report["values"]
    assert report["message"] == told(report, "poses_calibrated")
    assert values["norm_before_mg"] == pytest.approx(float(fields[3]), rel=1e-3)
    assert values["norm_after_mg"] == pytest.approx(float(fields[4]), abs=6e-4)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_truth_is_recovered_within_three_standard_errors(tmp_path: Path, seed: int) -> None:
    report = calibrated(six_faces(tmp_path, seed=seed))
    known, found = report["known_orientations"], report["calibration"]
    assert np.all(np.abs(known["K"] - K) < 3 * np.array(known["standard_errors"]["K"]))
    assert np.all(np.abs(known["O"] - O) < 3 * np.array(known["standard_errors"]["O"]))
    assert np.abs(known["K"] - K).max() < 0.5e-3
    gain = np.linalg.inv(K)
    names = (*PARAMETER_NAMES[:6], *UPPER_NAMES)
    for name, place in zip(names, PLACES, strict=True):
        assert abs(found["parameters"][name] - gain[place]) < 3 * found["standard_errors"][name]
    for name, value in zip(PARAMETER_NAMES[6:9], -O, strict=True):
        assert abs(found["parameters"][name] - value) < 3 * found["standard_errors"][name]


def test_both_conventions_say_the_same(tmp_path: Path) -> None:
    report = calibrated(six_faces(tmp_path))
    known, found = report["known_orientations"], report["calibration"]
    np.testing.assert_allclose(np.array(found["gain"]) @ known["K"], np.eye(3), atol=1e-8)
    np.testing.assert_allclose(found["offset_g"], -np.array(known["O"]), atol=2**-29)
    integers = found["fixed_point"]["parameters"]
    names = (*PARAMETER_NAMES[:6], *UPPER_NAMES)
    for name, (row, column) in zip(names, PLACES, strict=True):
        assert integers[name] / 2**29 == found["parameters"][name] == found["gain"][row][column]
    assert [integers[name] for name in ("sx", "sy", "sz")] == [0, 0, 0]
    assert found["temperature"] is None
    assert found["fixed_point"]["temperature_span_c"] is None


def test_a_roll_with_z_level_shows_no_z_once_calibrated(tmp_path: Path) -> None:
    """The validity experiment of Bragge et al.: roll along the work surface, z parallel to the earth."""
    found = calibrated(six_faces(tmp_path))["calibration"]
    turn = np.linspace(0, 4 * np.pi, 2000)
    true = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=1)
    raw = sensed(true, seed=9, noise_g=0.0)
    a = (raw + found["offset_g"]) @ np.array(found["gain"]).T
    assert np.abs(raw[:, 2]).max() > 0.05
    assert np.abs(a[:, 2]).max() < 0.0005
    np.testing.assert_allclose(a, true, atol=0.0005)


def test_the_poses_say_where_and_how_well(tmp_path: Path) -> None:
    order = [*UP, "+x"]
    path = write_csv(tmp_path / "s.csv", session([*order, (0.6, 0.8, 0.0)]))
    report = calibrated(path)
    poses, known = report["poses"], report["known_orientations"]
    assert [pose["face"] for pose in poses] == order
    for index, pose in enumerate(poses):
        assert (pose["start_s"], pose["end_s"]) == (start_s(index) + 1, start_s(index) + 9)
        true = K @ pose["reference_g"] + O
        np.testing.assert_allclose(pose["mean_raw_g"], true, atol=0.0005)
        assert pose["residual_mg"] < pose["held_out_mg"] < 1.5
        assert (pose["repeat_mg"] is None) == (pose["face"] != "+x")
    assert known["repeat_spread_mg"] == max(pose["repeat_mg"] or 0 for pose in poses) < 0.5
    assert known["left_out"]["between_faces"] == 1
    assert known["left_out"]["between_faces_norm_mg"] < 1
    assert report["holdout"]["postures"] == 6
    assert report["fit"]["windows"]["used"] == sum(pose["windows"] for pose in poses)


@pytest.mark.parametrize("chunk", [1, *(nightly(chunk) for chunk in (77, 1000))])
def test_the_report_does_not_depend_on_the_chunk_size(tmp_path: Path, chunk: int) -> None:
    path = six_faces(tmp_path, seconds=4.0)
    whole = calibrated(path)
    assert calibrated(path, "--chunk-samples", chunk, "--force") == whole


def test_flash_pages_give_what_their_counts_say(tmp_path: Path) -> None:
    counts = np.rint(session(list(UP), noise_g=0.004) * LSB_PER_G).astype(np.int16)
    about = Recording(tmp_path, "flash", RATE_HZ, LSB_PER_G, 0, range_g=16.0, start_us=1_709_539_200_000_000)
    clock = UniformClock(1_709_539_200_000_000, 0, rate_fraction(RATE_HZ))
    ENCODER.write(tmp_path / "s.bin", about, [Chunk(0, counts, clock, 0)])
    from_flash = calibrated(tmp_path / "s.bin")
    from_csv = calibrated(write_csv(tmp_path / "t.csv", counts / LSB_PER_G))
    assert from_flash["recording"]["format"] == "flash"
    assert np.abs(from_flash["known_orientations"]["K"] - K).max() < 0.7e-3
    np.testing.assert_allclose(
        from_flash["known_orientations"]["K"], from_csv["known_orientations"]["K"], atol=1e-7
    )


def test_metres_per_second_squared_and_local_gravity(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "s.csv", session(list(UP)), factor=9.80665)
    standard = calibrated(path)
    local = calibrated(path, "--latitude", 0, "--altitude", 2000, "--force")
    g = (9.780327 - 3.086e-6 * 2000) / 9.80665
    assert local["calibration"]["gravity"] == {"local_g": round(g, 9), "latitude": 0.0, "altitude": 2000.0}
    np.testing.assert_allclose(
        local["known_orientations"]["K"],
        np.array(standard["known_orientations"]["K"]) / g,
        rtol=1e-7,
        atol=1e-7,
    )
    np.testing.assert_allclose(
        local["known_orientations"]["O"], standard["known_orientations"]["O"], atol=1e-8
    )
    assert local["poses"][0]["reference_g"][0] == pytest.approx(g, abs=1e-8)


def test_listed_poses_need_not_be_faces(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    true = rng.standard_normal((9, 3))
    true /= np.linalg.norm(true, axis=1, keepdims=True)
    path = write_csv(tmp_path / "s.csv", session(list(true)))
    lines = [
        f"{start_s(index)},{start_s(index) + 10},{x:.7f},{y:.7f},{z:.7f}"
        for index, (x, y, z) in enumerate(true)
    ]
    report = calibrated(path, "--poses", write_list(tmp_path / "poses.csv", lines))
    assert np.abs(report["known_orientations"]["K"] - K).max() < 1e-3
    assert {pose["face"] for pose in report["poses"]} == {"listed"}
    assert report["known_orientations"]["missing_faces"] == []
    assert report["settings"]["poses"] == "poses.csv"
    by_clock = [line.replace(lines[0].split(",")[0], f"{START[:17]}03", 1) for line in lines[:1]] + lines[1:]
    again = calibrated(path, "--poses", write_list(tmp_path / "poses.csv", by_clock))
    assert again["poses"] == report["poses"]
    assert again["settings"]["poses_sha256"] != report["settings"]["poses_sha256"]


def test_standard_input_and_a_name_of_its_own(tmp_path: Path) -> None:
    path = six_faces(tmp_path, seconds=5.0)
    ran = run_process("six-pose", "-", "-o", tmp_path / "out" / "mine.json", stdin=path.read_bytes())
    assert ran.code == 0, ran.err
    assert ran.out.startswith("-\tcalibrated\t12\t")
    assert ran.lines[0].split("\t")[6] == str(tmp_path / "out" / "mine.json")
    assert files(tmp_path / "out") == ["mine.json"]
    assert report_of(tmp_path / "out" / "mine.json")["recording"]["path"] == "-"


def test_the_sample_holds_what_its_truth_says(tmp_path: Path) -> None:
    folder = Path(__file__).resolve().parent.parent.parent / "sample_data"
    report = calibrated(folder / "six_faces.csv.gz", "-d", tmp_path)
    truth, known = json.loads((folder / "six_faces.truth.json").read_text()), report["known_orientations"]
    for name in ("K", "O"):
        errors = 3 * np.array(known["standard_errors"][name])
        assert np.all(np.abs(np.subtract(known[name], truth[name])) < errors)
