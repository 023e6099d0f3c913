"""Operations of the system fail in turn: no torn output, the right exit code, a rerun ends as undisturbed."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.faults.checks import ERRORS, TrialFolder, Tried
from tests.faults.growing import trial_folder
from tests.faults.scenarios import SCENARIOS, Scenario
from tests.faults.shim import SHORT, Fault, Runner
from tests.faults.table import COLUMNS, read, rows, written

SOME = {
    "calibrate": (
        Fault("write", "ENOSPC", 2, on=True), Fault("write", SHORT, 7), Fault("fsync", "EIO", 3),
        Fault("rename", "EIO", 5), Fault("read", "EINTR", 9), Fault("thread", "EAGAIN", 1),
    ),
    "calibrate again": (Fault("unlink", "EIO", 6),),
    "calibrate parts": (Fault("open", "EIO", 12), Fault("mkdir", "ENOSPC", 3)),
    "calibrate, now refused": (Fault("create", "ENOSPC", 4),),
    "verify": (Fault("open", "EIO", 15),),
    "six-pose folder": (Fault("list", "EIO", 5),),
    "study shard": (Fault("thread", "EAGAIN", 2),),
    "simulate hdf5": (Fault("write", "ENOSPC", 9, on=True),),
    "watch": (Fault("fsync", "EIO", 1),),
    "watch, arrow": (Fault("write", "ENOSPC", 4), Fault("close", "EIO", 10)),
}  # fmt: skip
"""One fault of each operation, and those that were not survived once; `make nightly` tries all."""


@pytest.mark.parametrize("name", SOME)
def test_what_fails_costs_the_run_alone(request: pytest.FixtureRequest, tmp_path: Path, name: str) -> None:
    scenario = next(one for one in SCENARIOS if one.name == name)
    stage, cells = _trial_folder(scenario, tmp_path, request), read()
    for fault in SOME[name]:
        struck = stage.strike(fault)
        assert struck.failed, fault
        error = f"{fault.error}, lasting" if fault.on else fault.error
        assert struck.ran.code in cells[fault.operation, error, scenario.command], struck


def test_reading_the_table_of_a_study_starts_no_thread(runner: Runner, tmp_path: Path) -> None:
    """A thread of Arrow that is still starting when a short command ends aborts it."""
    scenario = next(one for one in SCENARIOS if one.name == "devices")
    assert not trial_folder(scenario, tmp_path / "stage", runner).calls["thread"]


@pytest.mark.nightly
@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda one: one.name)
def test_each_call_of_each(request: pytest.FixtureRequest, tmp_path: Path, scenario: Scenario) -> None:
    """What the table says to be never called is not."""
    tried = Tried()
    tried.each(_trial_folder(scenario, tmp_path, request), None)
    assert not tried.wrong, "\n".join(tried.wrong)
    known = read()
    assert all(known[place] for place in tried.cells)


def _trial_folder(scenario: Scenario, folder: Path, request: pytest.FixtureRequest) -> TrialFolder:
    """The command, with the runner that its workers are forked by."""
    runner = request.getfixturevalue("quick_runner" if scenario.quick else "runner")
    return trial_folder(scenario, folder / "stage", runner)


def test_the_table_has_no_empty_cell_and_lacks_nothing() -> None:
    cells = read()
    assert rows(cells) == written()
    names = [(operation, error) for operation, errors in ERRORS.items() for error in errors]
    assert sorted(cells) == sorted((*name, column) for name in names for column in COLUMNS)
    assert {one.command for one in SCENARIOS} == set(COLUMNS)


def test_by_the_table_no_failure_passes_for_success_or_a_bug() -> None:
    """What was written must be on the disk; temporary files of some commands may lie elsewhere.

    Of the recordings of `calibrate` some are refused.
    """
    for (operation, error, column), codes in read().items():
        well = {0, 4} if column == "calibrate" else {0}
        assert codes <= {1, 2, 3, 5, 71} | well
        if error in (SHORT, "EINTR"):
            assert codes <= well, (operation, error, column)
        elif operation in ("write", "rename") and column not in ("calibrate", "study", "watch"):
            assert 0 not in codes, (operation, error, column)
