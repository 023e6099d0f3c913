"""Outputs that exist already: whose they are, whether they still hold; and the provenance."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from accelcal_cli.core.errors import OutputError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.identity import SAMPLES, identity
from accelcal_cli.core.settings import DEFAULT
from accelcal_cli.core.version import __version__
from accelcal_cli.formats import open_recording
from accelcal_cli.pipeline.calibrate import calibrate
from accelcal_cli.pipeline.jobs import Job, Request, Result, plan
from accelcal_cli.pipeline.outputs import (
    json_round_trip,
    prepare,
    refuse_foreign_report,
    remove,
    remove_stale_parquet,
    save_report,
    up_to_date,
    with_provenance,
)
from tests.device_recordings import edit, week


@pytest.fixture
def job(tmp_path: Path) -> Job:
    """A calibrated recording's job."""
    (planned,) = plan([week(tmp_path / "a.raw", poses=20)], tmp_path / "out", None)
    calibrate(planned, Request())
    return planned


def existing(job: Job, request: Request | None = None) -> Result | None:
    with open_recording(job.source, ReadOptions()) as reader:
        return up_to_date(job, job.source, reader.recording, request or Request())


def test_the_result_of_the_same_input_settings_and_version_holds(job: Job) -> None:
    result = existing(job)
    assert result == Result(job, json.loads(job.report.read_text()), up_to_date=True)


@pytest.mark.parametrize(
    "request_now",
    [
        Request(settings=replace(DEFAULT, model="6")),
        Request(options=ReadOptions(unit="g")),
        Request(report_only=True),
        Request(integers=True),
    ],
    ids=["settings", "reading", "report only", "integers"],
)
def test_what_was_made_otherwise_does_not_hold(job: Job, request_now: Request) -> None:
    assert existing(job, request_now) is None


def change_version(report: dict[str, Any]) -> None:
    report["accelcal_version"] = __version__ + "x"


def drop_outcome(report: dict[str, Any]) -> None:
    del report["outcome"]


def add_pool(report: dict[str, Any]) -> None:
    report["pool"] = {}


def change_settings(report: dict[str, Any]) -> None:
    report["settings"]["unheard_of"] = 1


@pytest.mark.parametrize("change", [change_version, drop_outcome, add_pool, change_settings])
def test_a_report_that_is_not_ours_of_today_does_not_hold(job: Job, change: Any) -> None:
    edit(job.report, change)
    assert existing(job) is None


def test_a_result_without_its_parquet_does_not_hold(job: Job) -> None:
    job.parquet.unlink()
    assert existing(job) is None


def test_without_a_report_nothing_holds(job: Job) -> None:
    job.report.unlink()
    assert existing(job) is None


def test_a_changed_recording_is_done_again_but_another_one_is_refused(job: Job, tmp_path: Path) -> None:
    with job.source.open("ab") as file:
        file.write(bytes(6))
    assert existing(job) is None
    other = replace(job, source=week(tmp_path / "b.raw", seed=2, poses=20))
    with pytest.raises(OutputError, match=r"is the report of another recording \(.*a\.raw\)") as refusal:
        existing(other)
    assert refusal.value.path == job.report


def test_a_moved_recording_keeps_its_result(job: Job) -> None:
    moved = job.source.with_name("moved.raw")
    job.source.rename(moved)
    job.source.with_suffix(".layout.toml").rename(moved.with_suffix(".layout.toml"))
    held = existing(replace(job, source=moved))
    assert held is None  # the layout's name is one of the settings
    with open_recording(moved, ReadOptions(layout=moved.with_suffix(".layout.toml"))) as reader:
        named = replace(reader.recording, companion=moved.with_suffix(".layout.toml"))
    edit(job.report, lambda report: report["settings"]["input"].update(layout="moved.layout.toml"))
    assert up_to_date(replace(job, source=moved), moved, named, Request()) is not None


@pytest.mark.parametrize("name", ["parquet", "report", "integers", "quality"])
def test_a_foreign_file_in_the_way_is_refused_unless_forced(tmp_path: Path, name: str) -> None:
    (job,) = plan([tmp_path / "a.raw"], tmp_path / "new" / "out", None)
    prepare(job, force=False)
    path = getattr(job, name)
    path.write_text("{}")
    with pytest.raises(OutputError, match="exists and was not written by accelcal") as refusal:
        prepare(job, force=False)
    assert refusal.value.path == path
    prepare(job, force=True)
    assert path.read_text() == "{}"


def test_outputs_of_ours_are_not_in_the_way(job: Job) -> None:
    prepare(job, force=False)
    refuse_foreign_report(job.report)


def test_a_folder_that_cannot_be_made_is_an_output_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (job,) = plan([tmp_path / "a.raw"], tmp_path / "file" / "out", None)
    with pytest.raises(OutputError, match="cannot be made"):
        prepare(job, force=False)


def test_a_stale_parquet_of_ours_is_removed_and_a_foreign_one_stays(job: Job, tmp_path: Path) -> None:
    report = json.loads(job.report.read_text())
    same = {**identity(SAMPLES), **{name: report[name] for name in ("calibration", "recording")}}
    same["result"] = {"outcome": report["outcome"], "held_out_mg": report["holdout"]["after_mg"]["mean"]}
    remove_stale_parquet(job.parquet, same)
    assert job.parquet.exists()
    remove_stale_parquet(job.parquet, {**same, "calibration": None})
    assert not job.parquet.exists()
    foreign = tmp_path / "foreign.parquet"
    foreign.write_bytes(b"PAR1")
    remove_stale_parquet(foreign, {})
    assert foreign.exists()


def test_removing_what_is_not_there_is_nothing_and_a_folder_is_an_error(tmp_path: Path) -> None:
    remove(tmp_path / "none")
    with pytest.raises(OutputError, match="cannot be removed"):
        remove(tmp_path)


def test_provenance_is_added_last_and_names_command_and_versions(tmp_path: Path) -> None:
    report = with_provenance({"outcome": "calibrated"}, ("accelcal", "calibrate", "a\nb"))
    assert list(report) == ["outcome", "provenance"]
    assert report["provenance"]["command"][:2] == ["accelcal", "calibrate"]
    assert "\n" not in report["provenance"]["command"][2]
    assert list(report["provenance"]) == ["command", "versions", "time", "host", "platform"]
    assert {"python", "numpy", "pyarrow", "click"} <= set(report["provenance"]["versions"])
    save_report(tmp_path / "r.json", report)
    text = (tmp_path / "r.json").read_text()
    assert json.loads(text) == report
    assert text == json.dumps(report, indent=2, ensure_ascii=False) + "\n"


def test_a_value_as_it_comes_back_from_json() -> None:
    assert json_round_trip({"a": (1, 2.5), 3: None}) == {"a": [1, 2.5], "3": None}
