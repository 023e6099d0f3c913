"""A recording calibrated by another process than the user's: elsewhere, and beside others."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.pipeline.jobs import Request
from accelcal_cli.studies.discovery import Where, files
from accelcal_cli.studies.executors import calibrated_in, with_absolute_paths
from accelcal_cli.studies.task import CalibrationTask, Common, TaskResult, calibrated
from tests.cli.run import nightly
from tests.cli.studies import results, study_folder
from tests.conftest import ROOT

NAMES = ("a.raw", "b.raw")


def tasks(folder: Path, out: Path, request: Request | None = None) -> list[CalibrationTask]:
    found = files(Where((folder,), out, exclude=("*.txt", "*.json")), [])
    return [CalibrationTask(item, Common(out, request or Request(), "asked")) for item in found]


def not_told(_part: float) -> None:
    pass


def both(here: Path, folder: Path, patch: pytest.MonkeyPatch, request: Request) -> list[list[TaskResult]]:
    """The answers of a process in `here`, and of one elsewhere with other outputs of the same name."""
    patch.chdir(here)
    one = [calibrated(task, not_told) for task in tasks(folder, Path("out"), request)]
    made = results(here / "out")
    (here / "out").rename(here / "first")
    given = tasks(folder, Path("out"), request)
    (here / "elsewhere").mkdir()
    patch.chdir(here / "elsewhere")
    two = [calibrated_in(here, task, not_told) for task in given]
    assert results(here / "out") == made
    assert not list((here / "elsewhere").iterdir())
    return [one, two]


@pytest.mark.parametrize("name", ["in", nightly(".")])
def test_names_are_those_the_user_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    folder = study_folder(tmp_path / "in", NAMES)
    (folder / "zeros.cwa").write_bytes(bytes(4096))
    here = folder.parent if name == "in" else folder
    one, two = both(here, Path(name), monkeypatch, Request())
    assert [answer.entry.row for answer in one] == [answer.entry.row for answer in two]
    messages = [row["message"] for answer in two if (row := answer.entry.row) and row["exit_code"]]
    assert [one.partition(";")[0] for one in messages] == ["format not recognised"]
    report = json.loads((here / "out/a.calibration.json").read_text())
    assert report["recording"]["path"] == "a.raw"


def test_so_are_a_layout_and_an_output_in_the_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = study_folder(tmp_path / "in", NAMES)
    (folder / "a.layout.toml").rename(tmp_path / "all.toml")
    (folder / "b.layout.toml").unlink()
    (tmp_path / "out").mkdir()
    (tmp_path / "out/b.calibration.json").write_text("mine")
    monkeypatch.chdir(tmp_path)
    request = Request(options=ReadOptions(layout=Path("all.toml")))
    given = tasks(Path("in"), Path("out"), request)
    monkeypatch.chdir(folder)
    fine, wrong = (calibrated_in(tmp_path, task, not_told) for task in given)
    assert fine.entry.row is not None and fine.entry.row["outcome"] == "calibrated"
    assert wrong.entry.row is not None and wrong.entry.again
    assert wrong.entry.row["message"].startswith("out/b.calibration.json: exists and was not written")
    absolute = with_absolute_paths(tmp_path, given[0])
    assert with_absolute_paths(Path("/nowhere"), absolute).item == absolute.item


@pytest.mark.nightly
def test_several_at_once_in_one_process_do_not_disturb_each_other(tmp_path: Path) -> None:
    folder = study_folder(tmp_path / "in", NAMES)
    (folder / "night.h5").symlink_to(ROOT / "sample_data/night.h5")
    alone = [calibrated(task, not_told).entry for task in tasks(folder, tmp_path / "one")]
    with ThreadPoolExecutor(3) as threads:
        together = list(
            threads.map(lambda task: calibrated(task, not_told).entry, tasks(folder, tmp_path / "two"))
        )
    assert [entry.row for entry in alone] == [entry.row for entry in together]
    assert {entry.row["outcome"] for entry in alone if entry.row} == {"calibrated"}
    assert results(tmp_path / "one") == results(tmp_path / "two")
