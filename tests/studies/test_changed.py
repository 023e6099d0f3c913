"""A recording that changes between a study's rounds: no later result is of a file that has no own one."""

from __future__ import annotations

from pathlib import Path

from accelcal_cli.pipeline.jobs import Request
from accelcal_cli.studies.discovery import Where
from accelcal_cli.studies.other_recordings import (
    borrowed,
    borrowing_tasks,
    make_pool,
    pool_tasks,
    pooled,
    pooled_tasks,
)
from accelcal_cli.studies.records import Ledger, RecordingState
from accelcal_cli.studies.rounds import StudyState, plan
from accelcal_cli.studies.study import Study
from accelcal_cli.studies.task import CalibrationTask, Common, calibrated
from tests.device_recordings import week

SAID = "changed while it was read"


def told(_part: float) -> None:
    pass


def known(folder: Path) -> tuple[Study, StudyState]:
    """The own results of a study, found in this process."""
    study = Study(Where((folder,), folder.parent / "out"), Request(), pool=True, borrow=True)
    found = plan(study, Ledger(study.out / "study.ledger"))
    held = StudyState()
    for item in found.todo:
        entry = calibrated(CalibrationTask(item, Common(study.out, study.request, study.asked())), told).entry
        held.recordings[item.name] = RecordingState(item, entry, entry)
    return study, held


def grow(path: Path) -> None:
    with path.open("ab") as file:
        file.write(bytes(600))


def test_a_borrower_keeps_its_own_result(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    week(tmp_path / "in/good.raw")
    short = week(tmp_path / "in/short.raw", poses=3)
    study, held = known(tmp_path / "in")
    own = (tmp_path / "out/short.calibrated.parquet").read_bytes()
    (task,) = borrowing_tasks(study, held)
    grow(short)
    row = borrowed(task, told).entry.row
    assert row is not None and row["outcome"] == "provisional" and SAID in row["message"]
    assert (tmp_path / "out/short.calibrated.parquet").read_bytes() == own


def test_a_pool_and_its_members_are_not_made(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    one = week(tmp_path / "in/one.raw")
    week(tmp_path / "in/two.raw", seed=2)
    study, held = known(tmp_path / "in")
    own = (tmp_path / "out/one.calibrated.parquet").read_bytes()
    (task,) = pool_tasks(study, held)
    entry = make_pool(task, told).entry
    assert entry.row is not None and entry.row["outcome"] == "calibrated"
    held.pools[task.item.name] = entry
    first, second = pooled_tasks(study, held)
    grow(one)
    found = pooled(first, told).entry.row
    assert found is not None and "not_pooled" in found["cautions"] and SAID in found["message"]
    assert (tmp_path / "out/one.calibrated.parquet").read_bytes() == own
    assert pooled(second, told).entry.row["pool_recordings"] == 2
    failed = make_pool(task, told).entry.row
    assert failed is not None and failed["outcome"] == "failed" and SAID in failed["message"]
