"""`accelcal calibrate` from outside: lines, codes, files."""

from __future__ import annotations

import gzip
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from accelcal_cli.core.calibration import IDENTITY, PARAMETER_NAMES
from accelcal_cli.core.points import MODELS, PENALTY_BITS, Penalty, PointSet
from accelcal_cli.optimize import fixed32
from accelcal_cli.pipeline import outputs
from tests.cli.run import assert_one_line, files, nightly, report_of, run, run_process
from tests.recordings import (
    LSB_PER_G,
    OFFSET_G,
    directions,
    good_csv,
    good_raw,
    still_counts,
    straightened,
    worst_errors,
    write_csv,
    write_raw,
)


def test_a_recording_gives_parquet_report_and_one_line(tmp_path: Path) -> None:
    path = good_csv(tmp_path)
    ran = run("calibrate", path)
    assert (ran.code, ran.err) == (0, "")
    assert len(ran.lines) == 1
    fields = ran.lines[0].split("\t")
    assert fields[:3] == [str(path), "calibrated", "9"]
    assert fields[6] == str(tmp_path / "good.calibrated.parquet")
    assert float(fields[3]) > 20
    assert float(fields[4]) < 0.5
    assert files(tmp_path) == [
        "good.calibrated.parquet",
        "good.calibration.json",
        "good.csv",
        "good.quality.json",
    ]


def test_the_report_validates_and_holds_the_true_errors(tmp_path: Path) -> None:
    run("calibrate", good_csv(tmp_path))
    report = report_of(tmp_path / "good.calibration.json")
    gain, offset = worst_errors(report)
    assert gain < 2.5e-4 and offset < 1e-4
    assert report["holdout"]["before_mg"]["mean"] > 1000 * np.abs(OFFSET_G).min()
    names = ("k_xx", "k_yy", "k_zz", "k_yx", "k_zx", "k_zy")
    places = ((0, 0), (1, 1), (2, 2), (1, 0), (2, 0), (2, 1))
    found = report["calibration"]
    assert [found["parameters"][name] for name in names] == [found["gain"][i][j] for i, j in places]
    assert [found["parameters"][name] for name in ("ox", "oy", "oz")] == found["offset_g"]
    integers = found["fixed_point"]["parameters"]
    assert all(integers[name] / 2**29 == found["parameters"][name] for name in names)


def test_parquet_holds_the_calibrated_counts_and_all_times(tmp_path: Path) -> None:
    counts = still_counts(directions(60))
    run("calibrate", write_csv(tmp_path / "a.csv", counts))
    found = report_of(tmp_path / "a.calibration.json")["calibration"]
    frame = pd.read_parquet(tmp_path / "a.calibrated.parquet")
    assert list(frame.columns) == ["time", "x", "y", "z", "validity"]
    expected = (straightened(found, counts / LSB_PER_G) + found["offset_g"]) @ np.array(found["gain"]).T
    np.testing.assert_allclose(frame[["x", "y", "z"]].to_numpy(), expected, rtol=2**-24, atol=2**-30)
    start = np.datetime64("2024-03-04T00:00:00", "us")
    steps = (np.arange(len(counts)) * 40_000).astype("timedelta64[us]")
    assert (frame["time"].to_numpy() == start + steps).all()
    assert (frame["validity"] == 0).all()


def test_json_prints_the_report_on_one_line(tmp_path: Path) -> None:
    ran = run("calibrate", "--json", good_csv(tmp_path))
    assert len(ran.lines) == 1
    assert json.loads(ran.out) == report_of(tmp_path / "good.calibration.json")


@pytest.mark.parametrize("samples", [1, nightly(499), 10**7])
def test_any_chunk_size_gives_the_same_bytes(tmp_path: Path, samples: int) -> None:
    path = write_raw(tmp_path / "a.raw", still_counts(directions(20)))
    run("calibrate", "--model", 6, path, "-d", tmp_path / "one")
    run("calibrate", "--model", 6, path, "-d", tmp_path / "two", "--chunk-samples", samples)
    reports = [report_of(tmp_path / name / "a.calibration.json") for name in ("one", "two")]
    for report in reports:
        del report["provenance"]
    assert reports[0] == reports[1]
    parquets = [(tmp_path / name / "a.calibrated.parquet").read_bytes() for name in ("one", "two")]
    assert parquets[0] == parquets[1]


def test_csv_and_raw_of_the_same_counts_give_the_same_integers(tmp_path: Path) -> None:
    counts = still_counts(directions(40))
    run("calibrate", write_csv(tmp_path / "a.csv", counts), write_raw(tmp_path / "b.raw", counts))
    integers = [
        report_of(tmp_path / name)["calibration"]["fixed_point"]["parameters"]
        for name in ("a.calibration.json", "b.calibration.json")
    ]
    assert integers[0] == integers[1]


def test_a_rerun_does_nothing_and_says_so(tmp_path: Path) -> None:
    path = good_csv(tmp_path)
    first = run("calibrate", "--model", 6, path)
    before = {name: (tmp_path / name).stat().st_mtime_ns for name in files(tmp_path)}
    again = run("calibrate", "--model", 6, path, code=0)
    assert again.out == first.out
    assert "up to date" in again.err
    assert before == {name: (tmp_path / name).stat().st_mtime_ns for name in files(tmp_path)}
    assert "up to date" not in run("calibrate", "--model", 6, path, "--force", code=0).err


def test_a_report_and_a_parquet_of_two_calibrations_are_made_anew(tmp_path: Path) -> None:
    recording = good_raw(tmp_path, "small.raw")
    assert run("calibrate", recording, "-d", tmp_path / "a").code == 0
    assert run("calibrate", recording, "-d", tmp_path / "b", "--model", "6").code == 0
    parquet = "small.calibrated.parquet"
    shutil.copy(tmp_path / "b" / parquet, tmp_path / "a" / parquet)
    again = run("calibrate", recording, "-d", tmp_path / "a")
    assert again.code == 0 and "up to date" not in again.err
    assert (
        pq.read_schema(tmp_path / "a" / parquet).metadata != pq.read_schema(tmp_path / "b" / parquet).metadata
    )


def test_of_two_runs_at_once_no_results_are_mixed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recording = good_raw(tmp_path, "small.raw")
    assert run("calibrate", recording, "-d", tmp_path / "b", "--model", "6").code == 0
    write_text = outputs.with_provenance

    def overtaken(*words: Any, **files: Any) -> Any:
        for name in ("small.calibrated.parquet", "small.calibration.json"):
            shutil.copy(tmp_path / "b" / name, tmp_path / "a" / name)
        return write_text(*words, **files)

    monkeypatch.setattr(outputs, "with_provenance", overtaken)
    ran = run("calibrate", recording, "-d", tmp_path / "a")
    assert_one_line(ran, "small.calibrated.parquet", "was replaced by another run")
    assert ran.code == 5
    assert json.loads((tmp_path / "a" / "small.calibration.json").read_text())["calibration"]["model"] == "6"


def test_a_recording_that_is_now_refused_loses_its_old_parquet(tmp_path: Path) -> None:
    path = good_csv(tmp_path)
    run("calibrate", "--model", 6, path)
    write_csv(path, still_counts(directions(4)))
    assert run("calibrate", "--model", 6, path).code == 4
    assert files(tmp_path) == ["good.calibration.json", "good.csv", "good.quality.json"]


def test_refused_has_a_reason_a_report_and_no_parquet(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "few.csv", still_counts(directions(4)))
    ran = run("calibrate", path, "--strict")
    assert_one_line(ran, str(path), "refused", "4 recorded orientations", code=4)
    outcome, model, before, *others = ran.lines[0].split("\t")[1:]
    assert (outcome, model, set(others)) == ("refused", "-", {"-"}) and float(before) > 10
    assert files(tmp_path) == ["few.calibration.json", "few.csv", "few.quality.json"]
    report = report_of(tmp_path / "few.calibration.json")
    assert report["calibration"] is None


def test_report_only_writes_no_parquet(tmp_path: Path) -> None:
    ran = run("calibrate", "--model", 6, "--report-only", good_csv(tmp_path), code=0)
    assert ran.lines[0].split("\t")[6] == "-"
    assert files(tmp_path) == ["good.calibration.json", "good.csv", "good.quality.json"]


def test_foreign_files_are_not_overwritten_without_force(tmp_path: Path) -> None:
    path = good_csv(tmp_path)
    for name in ("good.calibrated.parquet", "good.calibration.json"):
        (tmp_path / name).write_text("{}")
        assert_one_line(run("calibrate", path), name, "not written by accelcal", "--force", code=5)
        assert (tmp_path / name).read_text() == "{}"
        assert run("calibrate", path, "--force", "--model", 6).code == 0
        (tmp_path / "good.calibrated.parquet").unlink()
        (tmp_path / "good.calibration.json").unlink()


def test_two_inputs_with_one_output_are_refused_before_any_work(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    one, two = good_csv(tmp_path), good_csv(tmp_path / "other")
    ran = run("calibrate", "--model", 6, one, two, "-d", tmp_path / "out")
    assert_one_line(ran, str(one), str(two), code=2)
    assert not (tmp_path / "out").exists()


def test_gz_and_plain_of_one_stem_collide(tmp_path: Path) -> None:
    path = good_csv(tmp_path)
    packed = path.with_suffix(".csv.gz")
    packed.write_bytes(gzip.compress(path.read_bytes()))
    assert run("calibrate", path, packed).code == 2
    assert run("calibrate", packed, "-d", tmp_path / "out", "--model", 6).code == 0
    assert (tmp_path / "out" / "good.calibrated.parquet").exists()


def test_output_names_the_parquet_and_the_report_lies_beside(tmp_path: Path) -> None:
    run("calibrate", good_csv(tmp_path), "-o", tmp_path / "sub" / "mine.parquet", "--model", 6, code=0)
    assert files(tmp_path / "sub") == ["mine.calibration.json", "mine.parquet", "mine.quality.json"]
    other = good_csv(tmp_path, "b.csv")
    assert run("calibrate", other, other, "-o", tmp_path / "x.parquet").code == 2


def test_several_recordings_one_bad(tmp_path: Path) -> None:
    good, bad = good_csv(tmp_path), tmp_path / "absent.csv"
    ran = run("calibrate", bad, good, "--model", 6, code=1)
    assert [line.split("\t")[0] for line in ran.lines] == [str(good)]
    assert str(bad) in ran.err


def test_standard_input(tmp_path: Path) -> None:
    data = good_csv(tmp_path).read_bytes()
    ran = run_process("calibrate", "-", "-d", tmp_path / "out", stdin=data)
    assert (ran.code, ran.err) == (0, "")
    assert ran.lines[0].split("\t")[:3] == ["-", "calibrated", "9"]
    assert files(tmp_path / "out") == [
        "stdin.calibrated.parquet",
        "stdin.calibration.json",
        "stdin.quality.json",
    ]
    other = run_process("calibrate", "-", "-d", tmp_path / "out", stdin=data[: data.rfind(b"\n", 0, -1) + 1])
    assert other.code == 5 and "is the report of another recording (-)" in other.err


def test_model_and_profile_are_in_the_report(tmp_path: Path) -> None:
    path = good_csv(tmp_path)
    run("calibrate", path, "--model", "6")
    report = report_of(tmp_path / "good.calibration.json")
    assert report["settings"]["model"] == "6"
    assert report["calibration"]["model"] == "6"
    assert report["outcome"] == "reduced_model"
    assert "as asked for" in report["message"]


def test_profile_paper_fits_eighteen_points_in_fifty_iterations(tmp_path: Path) -> None:
    faces = np.concatenate([np.eye(3), -np.eye(3)])
    corners = directions(200)
    counts = still_counts(np.concatenate([faces, faces, faces, corners]))
    ran = run("calibrate", write_csv(tmp_path / "a.csv", counts), "--profile", "paper")
    report = report_of(tmp_path / "a.calibration.json")
    assert ran.code == 0
    assert report["fit"]["points"] == 18
    assert report["calibration"]["optimizer"]["iterations"] == 50
    assert report["calibration"]["optimizer"]["operations"] == {
        "additions": 90_150,
        "multiplications": 90_150,
    }
    assert report["calibration"]["optimizer"]["predicted_seconds"]["ATmega328"] == 0.7043  # F: about 0.7 s
    assert report["holdout"]["method"].startswith("control points")


def test_the_integers_fit_again_to_the_same_bits(tmp_path: Path) -> None:
    path = good_csv(tmp_path)
    run("calibrate", path)
    assert "up to date" not in run("calibrate", path, "--integers").err
    held = json.loads((tmp_path / "good.integers.json").read_text())
    points = PointSet(
        np.array(held["points"], np.int64),
        np.array(held["weights"], np.int64),
        np.ones(len(held["points"]), np.int64),
    )
    bits, prior = held["penalty"].pop("fraction_bits"), held["penalty"]
    penalty = Penalty(tuple(prior["centre"]), tuple(prior["strength"]))
    straight = points.straightened(tuple(held["bend"]))
    again = fixed32.OPTIMIZER.fit_penalized(straight, MODELS[held["model"]], penalty, IDENTITY).fit
    assert bits == PENALTY_BITS
    assert dict(zip(PARAMETER_NAMES, again.parameters, strict=True)) == held["parameters"]
    found = report_of(tmp_path / "good.calibration.json")["calibration"]
    assert found["fixed_point"]["parameters"] == held["parameters"]
    assert "up to date" in run("calibrate", path, "--integers").err


def test_report_only_leaves_a_parquet_that_still_holds(tmp_path: Path) -> None:
    path = good_csv(tmp_path)
    run("calibrate", path, "--model", 9)
    before = (tmp_path / "good.calibrated.parquet").read_bytes()
    run("calibrate", path, "--report-only", "--model", 9)
    assert (tmp_path / "good.calibrated.parquet").read_bytes() == before
    run("calibrate", path, "--report-only", "--model", 6)
    assert not (tmp_path / "good.calibrated.parquet").exists()


@pytest.mark.parametrize(
    ("zone", "hours"), [("Europe/Berlin", 1), ("+05:30", 5.5), nightly("UTC", 0), nightly("-03:00", -3)]
)
def test_a_known_zone_gives_utc_times(tmp_path: Path, zone: str, hours: float) -> None:
    run("calibrate", good_csv(tmp_path), "--timezone", zone, "--model", 6)
    frame = pd.read_parquet(tmp_path / "good.calibrated.parquet")
    local = pd.Timestamp("2024-03-04T00:00:00")
    assert frame["time"].iloc[0] == (local - pd.Timedelta(hours=hours)).tz_localize("UTC")
    assert report_of(tmp_path / "good.calibration.json")["recording"]["start_time"].startswith(
        "2024-03-04T00:00"
    )


def test_time_has_one_type_where_the_zone_is_known_and_else_says_unknown(tmp_path: Path) -> None:
    path, parquet = good_csv(tmp_path), tmp_path / "good.calibrated.parquet"
    for words, zone, kind in (((), "unknown", None), (("--timezone", "Europe/Berlin"), "UTC", "UTC")):
        run("calibrate", path, "--model", 6, *words)
        schema = pq.read_schema(parquet)
        assert (schema.field("time").type, schema.metadata[b"time_zone"]) == (
            pa.timestamp("us", kind),
            zone.encode(),
        )
        assert report_of(tmp_path / "good.calibration.json")["recording"]["time_zone"] == zone


def test_force_timezone_without_a_zone_is_a_usage_error(tmp_path: Path) -> None:
    ran = run("calibrate", good_csv(tmp_path), "-R", "force_timezone=true", code=2)
    assert "give it with --timezone" in ran.err
