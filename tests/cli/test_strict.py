"""`--strict` and provisional results: what is written, said and returned for recordings and studies."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from tests.cli.run import codes, run, told
from tests.cli.studies import rows, study
from tests.recordings import directions, good_raw, still_counts, write_raw


def few_raw(folder: Path) -> Path:
    """A recording of three orientations, whose calibration is better than raw but may be far off."""
    return write_raw(folder / "few.raw", still_counts(directions(3)))


def metadata(path: Path) -> dict[str, Any]:
    held: dict[str, Any] = json.loads(pq.read_schema(path).metadata[b"accelcal"])
    return held


def test_verdicts_1_better_than_raw_is_provisional_and_strictly_refused(tmp_path: Path) -> None:
    path, parquet = few_raw(tmp_path), tmp_path / "few.calibrated.parquet"
    usual = run("calibrate", path)
    assert (usual.code, usual.lines[0].split("\t")[1]) == (0, "provisional")
    report = json.loads((tmp_path / "few.calibration.json").read_text())
    error = report["calibration_error_mg"]
    assert error["mean"] < error["before"] and error["ci95"][1] > report["settings"]["max_error_mg"]
    assert error["ci95"][1] > error["before"] and report["values"]["percent"] >= 95
    assert not {"error_may_reach", "no_better_than_raw"} & {*codes(report["cautions"])}, (
        "two probabilities decide"
    )
    held = metadata(parquet)
    assert (held["result"]["outcome"], held["calibration"]) == ("provisional", report["calibration"])
    strict = run("calibrate", path, "--strict")
    assert (strict.code, strict.lines[0].split("\t")[1]) == (4, "refused")
    assert not parquet.exists(), "the provisional one went with its report"
    report = json.loads((tmp_path / "few.calibration.json").read_text())
    assert (report["outcome"], report["calibration"]) == ("refused", None)
    assert codes(report["advice"])[0] == "omit_strict" and told(report, "omit_strict") in strict.err
    assert run("calibrate", path).code == 0 and parquet.exists()


def test_one_refused_strictly_of_several_is_exit_code_1(tmp_path: Path) -> None:
    paths = (few_raw(tmp_path), good_raw(tmp_path))
    assert run("calibrate", *paths, "-q", "-d", tmp_path / "usual").code == 0
    run("calibrate", *paths, "-q", "--strict", "-d", tmp_path / "strict", code=1)
    assert [path.name for path in (tmp_path / "strict").glob("*.parquet")] == ["good.calibrated.parquet"]


def test_a_provisional_recording_of_a_study_is_listed_as_such(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    few_raw(tmp_path / "in")
    good_raw(tmp_path / "in")
    out = tmp_path / "out"
    assert study(tmp_path / "in").code == 0
    few, good = rows(out)
    assert (few["path"], few["outcome"], few["reason"], few["exit_code"]) == (
        "few.raw", "provisional", "provisional", "0",
    )  # fmt: skip
    assert float(few["probability_better"]) >= 0.8 and good["outcome"] == "calibrated"
    assert metadata(out / few["parquet"])["result"]["outcome"] == "provisional"
    counts = json.loads((out / "study.json").read_text())
    assert counts["outcomes"] == {"calibrated": 1, "provisional": 1}
    assert study(tmp_path / "in", "--strict").code == 1
    few, good = rows(out)
    assert (few["outcome"], few["exit_code"], few["parquet"]) == ("refused", "4", "")
    assert (good["outcome"], good["exit_code"]) == ("calibrated", "0")
    assert [path.name for path in out.glob("*.calibrated.parquet")] == ["good.calibrated.parquet"]
