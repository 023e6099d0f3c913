"""Real recordings: what calibrating each gives, and the figures known of them (data/SOURCES.md)."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from accelcal_cli.core.errors import Reason
from accelcal_cli.output.sentences import clause
from tests.cli.run import run
from tests.schema import check_report

Capture = pytest.CaptureFixture[str]
NILSPOD = """
[dump]
rate_hz = 204.8
lsb_per_g = 2048.0
range_g = 16.0
header_bytes = {header}
frame_bytes = 20
[fields]
gx = {{ offset = 0, type = "int16", per_unit = 0.061 }}
gy = {{ offset = 2, type = "int16", per_unit = 0.061 }}
gz = {{ offset = 4, type = "int16", per_unit = 0.061 }}
x = {{ offset = 6, type = "int16" }}
y = {{ offset = 8, type = "int16" }}
z = {{ offset = 10, type = "int16" }}
"""


REPORTS: dict[tuple[object, ...], tuple[int, dict]] = {}
"""What runs that write nothing but a report gave, by recording and options: several tests look at one."""


def calibrated(capsys: Capture, path: Path, folder: Path, *words: object) -> tuple[int, dict]:
    if "--report-only" not in words:
        return freshly_calibrated(capsys, path, folder, *words)
    if (path, *words) not in REPORTS:
        inner = folder / str(len(REPORTS))
        REPORTS[path, *words] = freshly_calibrated(capsys, path, inner, *words)
    return REPORTS[path, *words]


def freshly_calibrated(capsys: Capture, path: Path, folder: Path, *words: object) -> tuple[int, dict]:
    ran = run(capsys, "calibrate", path, "-d", folder, "-q", *words)
    reports = list(folder.glob("*.calibration.json"))
    assert len(reports) == 1, ran
    report = json.loads(reports[0].read_text())
    check_report(report)
    return ran.code, report


@pytest.mark.nightly
def test_a_chest_recording_of_fourteen_days(real_data: Path, tmp_path: Path, capsys: Capture) -> None:
    path = real_data / "vendor" / "zio_chest_1.56hz_14d.csv.gz"
    code, report = calibrated(capsys, path, tmp_path, "--report-only")
    assert code == 0
    assert report["calibration"]["model"] == "9"
    assert report["holdout"]["after_mg"]["mean"] < 3.0
    assert 13.9 < report["recording"]["duration_s"] / 86_400 < 14.1


@pytest.mark.parametrize(
    ("name", "raw_error_mg"),
    [
        pytest.param("zio_chest_1.56hz_14d.csv.gz", 25.4, marks=pytest.mark.nightly),
        pytest.param("actigraph_30hz_12h.csv.gz", 19.95, marks=pytest.mark.nightly),
        ("actigraph_gt3xplus_30hz_9h.csv.gz", 15.36),
    ],
)
def test_raw_errors_over_still_windows_are_the_known_ones(
    real_data: Path, tmp_path: Path, capsys: Capture, name: str, raw_error_mg: float
) -> None:
    """Windows that hold filled rows do not count.

    The ActiGraph GT3X+ has 16.8 mg over 4011 windows, of which 2095 are filled: 15.36 mg without them; the
    one of 12 h 22.86 mg over 967 windows, nine of which hold zeros: 19.95 mg without these.
    """
    options = ("--profile", "paper", "--stillness", "range", "--report-only")
    _, report = calibrated(capsys, real_data / "vendor" / name, tmp_path, *options)
    assert report["fit"]["windows"]["raw_error_mg"] == pytest.approx(raw_error_mg, abs=0.05)


def test_zeros_that_a_device_wrote_are_left_out(real_data: Path, tmp_path: Path, capsys: Capture) -> None:
    code, report = calibrated(
        capsys, real_data / "vendor" / "actigraph_30hz_12h.csv.gz", tmp_path, "--report-only"
    )
    assert code == 0
    assert report["calibration"]["model"] == "9"
    assert report["holdout"]["after_mg"]["mean"] < 2.5
    assert report["fit"]["windows"]["filled"] > 4000 and report["file_health"]["filled_samples"] == 643_830


def test_one_sided_stillness_gives_no_scale(real_data: Path, tmp_path: Path, capsys: Capture) -> None:
    path = real_data / "vendor" / "actigraph_gt3xplus_30hz_9h.csv.gz"
    code, report = calibrated(capsys, path, tmp_path, "--prior", "none")
    assert code == 0
    assert (report["outcome"], report["calibration"]["model"]) == ("reduced_model", "3")
    why = Reason.of("no_stillness_on_sides", sides=["-x"], reach_g=0.3)
    assert report["values"]["why"] == why.as_json() and clause(why) in report["message"]
    assert report["recording"]["start_time"] == "2012-06-27T10:54:00.000000"
    assert report["file_health"]["filled_samples"] == 338_770


def test_counts_of_a_wristband(real_data: Path, tmp_path: Path, capsys: Capture) -> None:
    path = real_data / "vendor" / "empatica_e4_32hz_2h.csv"
    code, report = calibrated(capsys, path, tmp_path, "--report-only")
    assert code == 0
    assert (report["outcome"], report["calibration"]["model"]) == ("calibrated", "9")
    assert report["holdout"]["after_mg"]["mean"] < 2 < report["calibration_error_mg"]["mean"] < 6, (
        "x never beyond 0.3 g"
    )
    assert report["recording"]["samples"] == 200_406
    assert report["recording"]["start_time"] == "2017-06-02T22:50:04.000000+00:00"


def test_six_postures_give_coefficients_that_are_no_worse_than_they_claim(
    real_data: Path, tmp_path: Path, capsys: Capture
) -> None:
    """A fit without a prior gives a scale of 0.68 here. With one, the offset of y is all that it corrects."""
    path = real_data / "vendor" / "must_refuse_30hz_4h.csv.gz"
    code, report = calibrated(capsys, path, tmp_path)
    assert (code, report["outcome"]) == (0, "provisional")
    assert report["calibration_error_mg"]["ci95"][1] > 20
    assert report["calibration_error_mg"]["before"] > 25
    assert [row[axis] for axis, row in enumerate(report["calibration"]["gain"])] == pytest.approx(
        [1, 1, 1], abs=0.01
    )
    (output,) = tmp_path.glob("*.parquet")
    output.unlink()
    code, report = calibrated(capsys, path, tmp_path, "--prior", "none", "--force")
    assert (code, report["outcome"]) == (4, "refused")
    assert not list(tmp_path.glob("*.parquet"))


@pytest.mark.parametrize(
    ("name", "samples", "rate_hz"),
    [
        ("ax3_100hz_3min.cwa", 17_400, 98.86),
        ("ax3_corrupt_blocks_0_13_14_142_143_144.cwa", 16_680, 98.86),
        ("ax3_200hz_5min.cwa", 58_800, 197.25),
        pytest.param("ax3_sacrum_100hz_3h.cwa", 1_208_160, 98.17, marks=pytest.mark.nightly),
    ],
)
def test_axivity_recordings(
    real_data: Path, tmp_path: Path, capsys: Capture, name: str, samples: int, rate_hz: float
) -> None:
    code, report = calibrated(capsys, real_data / "vendor" / name, tmp_path, "--report-only")
    assert (code, report["outcome"]) in ((4, "refused"), (0, "provisional"))
    assert report["recording"]["samples"] == samples
    assert report["recording"]["device"]["model"] == "AX3"
    assert report["file_health"]["rate_hz_measured"] == pytest.approx(rate_hz, rel=2e-3)


@pytest.mark.nightly
def test_the_sacrum_recording_says_which_side_is_missing(
    real_data: Path, tmp_path: Path, capsys: Capture
) -> None:
    path = real_data / "vendor" / "ax3_sacrum_100hz_3h.cwa"
    _, report = calibrated(capsys, path, tmp_path, "--report-only")
    assert report["recording"]["device"]["serial"] == "51888"
    assert {"code": "rest_on_sides", "values": {"sides": ["-x"]}} in report["advice"]
    _, paper = calibrated(capsys, path, tmp_path, "--report-only", "--profile", "paper")
    assert paper["reason"] == "subsets_not_full" and "x -1 g" in paper["values"]["subsets"]
    assert paper["fit"]["windows"]["raw_error_mg"] == pytest.approx(15.9, abs=0.15)


def test_six_bad_blocks_are_listed(real_data: Path, tmp_path: Path, capsys: Capture) -> None:
    path = real_data / "vendor" / "ax3_corrupt_blocks_0_13_14_142_143_144.cwa"
    _, report = calibrated(capsys, path, tmp_path, "--report-only")
    bad = [item for item in report["file_health"]["problems"] if item["code"] == "checksum"]
    assert sum(item["count"] for item in bad) == 6
    assert [(item["byte_offset"] - 1024) // 512 for item in bad] == [0, 13, 142]


def test_an_opal_file_asks_which_sensor_and_reads_it(
    real_data: Path, tmp_path: Path, capsys: Capture
) -> None:
    path = real_data / "vendor" / "apdm_opal.h5"
    ran = run(capsys, "calibrate", path, "-d", tmp_path)
    assert ran.code == 3
    assert "Right Wrist" in ran.err
    assert "--sensor" in ran.err
    code, report = calibrated(capsys, path, tmp_path, "--sensor", "Right Wrist")
    assert code in (0, 4)
    assert report["recording"]["samples"] == 36_460
    assert report["recording"]["sample_rate_hz"] == 128


@pytest.mark.parametrize(
    "name", ["nilspod_84965c0.bin", pytest.param("nilspod_92338c81.bin", marks=pytest.mark.nightly)]
)
def test_a_dump_through_a_layout(real_data: Path, tmp_path: Path, capsys: Capture, name: str) -> None:
    path = real_data / "imu" / name
    layout = tmp_path / "nilspod.toml"
    layout.write_text(NILSPOD.format(header=path.stat().st_size % 20))
    code, report = calibrated(capsys, path, tmp_path, "--layout", layout)
    assert code == 0
    assert report["recording"]["samples"] == path.stat().st_size // 20
    assert all(number > 0 for row in report["coverage"]["subsets"] for number in row)
