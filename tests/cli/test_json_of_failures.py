"""U6: `--json` prints one object for each recording, with the same keys whether it failed or not."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from accelcal_cli.output.report import FAILURES
from accelcal_cli.output.report_reading import report_schema
from tests.cli.run import Ran, run
from tests.recordings import directions, still_counts, write_raw
from tests.schema import check_report


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    """A good recording between one that is not a recording, and one that is not there."""
    (tmp_path / "in").mkdir()
    bad, good, gone = (tmp_path / "in" / name for name in ("bad.cwa", "good.raw", "gone.csv"))
    bad.write_bytes(b"not a recording" * 100)
    write_raw(good, still_counts(directions(60)))
    return [bad, good, gone]


def objects(ran: Ran) -> list[dict[str, Any]]:
    return [json.loads(line) for line in ran.out.splitlines()]


def failure() -> Draft202012Validator:
    schema = report_schema()
    return Draft202012Validator({"$ref": "#/$defs/failure", "$defs": schema["$defs"]})


def test_u6_calibrate_prints_an_object_for_what_failed(files: list[Path], tmp_path: Path) -> None:
    ran = run("calibrate", *files, "-d", tmp_path / "out", "--json", "--report-only")
    bad, good, gone = objects(ran)
    assert ran.code == 1 and len(ran.err.splitlines()) == 2
    check_report(good)
    for found, path in ((bad, files[0]), (gone, files[2])):
        failure().validate(found)
        assert set(found) == set(report_schema()["required"]) <= set(good)
        assert (found["outcome"], found["reason"]) == ("failed", "unreadable")
        assert found["values"] == {"path": str(path), "exit_code": 3}
        assert found["recording"]["path"] == path.name
        assert str(path) not in found["message"] and f"{path}: {found['message']}" in ran.err.replace(
            "accelcal: ", ""
        )


def test_u6_the_schema_of_a_failure_needs_the_keys_of_a_report_and_has_all_reasons() -> None:
    whole, failed = report_schema(), report_schema()["$defs"]["failure"]
    assert failed["required"] == whole["required"]
    recordings = [one["properties"]["recording"]["required"] for one in (whole, failed)]
    assert recordings[0] == recordings[1]
    assert set(failed["properties"]["reason"]["enum"]) == {*FAILURES.values(), "failed"}


def test_u6_a_study_prints_an_object_for_what_failed(files: list[Path], tmp_path: Path) -> None:
    words = ("study", tmp_path / "in", "-d", tmp_path / "out", "-j", 1, "--json", "--report-only")
    found = {one["recording"]["path"]: one for one in objects(run(*words))}
    assert {name: one["outcome"] for name, one in found.items()} == {
        "bad.cwa": "failed", "good.raw": "calibrated",
    }  # fmt: skip
    failure().validate(found["bad.cwa"])
    assert found["bad.cwa"]["values"]["path"] == str(files[0])
    assert objects(run(*words, "-q")) == [], "not new"
    again = objects(run(*words, "-q", "--all-failures"))
    assert [one["outcome"] for one in again if one["outcome"] == "failed"] == ["failed"]


def test_u6_inspect_prints_an_object_for_what_failed(files: list[Path]) -> None:
    ran = run("inspect", *files, "--json")
    bad, good, gone = objects(ran)
    assert ran.code == 1
    for found, path in ((bad, files[0]), (gone, files[2])):
        assert list(found) == list(good)
        for section in ("recording", "prediction"):
            assert set(found[section]) == set(good[section])
        assert found["recording"]["path"] == str(path)
        assert (found["prediction"]["outcome"], found["prediction"]["reason"]) == ("failed", "unreadable")
        assert f"{path}: {found['prediction']['message']}" in ran.err


def test_u6_apply_prints_an_object_for_what_failed(files: list[Path], tmp_path: Path) -> None:
    run("calibrate", files[1], "-d", tmp_path / "first", "--report-only", "-q")
    report = tmp_path / "first" / "good.calibration.json"
    ran = run("apply", "--coefficients", report, *files, "-d", tmp_path / "out", "--json")
    assert [one["outcome"] for one in objects(ran)] == ["failed", "calibrated", "failed"]


def test_u6_so_has_a_bug(files: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: Any) -> None:
        raise RuntimeError("on purpose")

    monkeypatch.setattr("accelcal_cli.pipeline.registry.calibrate", broken)
    ran = run("calibrate", files[1], "-d", tmp_path / "out", "--json")
    (found,) = objects(ran)
    failure().validate(found)
    assert (ran.code, found["reason"], found["message"]) == (70, "bug", "RuntimeError: on purpose")
