"""Operations of the system fail in turn: no torn output, the right exit code, a rerun ends as undisturbed."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.faults.checks import ERRORS, Stage, Tried
from tests.faults.growing import staged
from tests.faults.scenarios import SCENARIOS, Scenario
from tests.faults.shim import SHORT, Fault, Runner
from tests.faults.table import COLUMNS, read, rows, written

SOME = {
    "calibrate": (
        Fault("write", "ENOSPC", 8), Fault("write", "ENOSPC", 2, on=True), Fault("write", SHORT, 7),
        Fault("fsync", "EIO", 3), Fault("rename", "EIO", 5), Fault("read", "EINTR", 9),
        Fault("open", "EIO", 20), Fault("thread", "EAGAIN", 1),
    ),
    "calibrate long": (Fault("thread", "EAGAIN", 1), Fault("write", "ENOSPC", 4)),
    "calibrate again": (Fault("rename", "EIO", 4), Fault("unlink", "EIO", 6)),
    "calibrate parts": (
        Fault("open", "EIO", 12), Fault("mkdir", "ENOSPC", 3), Fault("close", "EIO", 29),
        Fault("read", SHORT, 5),
    ),
    "calibrate, now refused": (Fault("open", "EIO", 19), Fault("create", "ENOSPC", 4)),
    "verify": (Fault("open", "EIO", 15), Fault("open", "EIO", 16), Fault("thread", "EAGAIN", 1)),
    "six-pose": (Fault("thread", "EAGAIN", 4),),
    "six-pose folder": (Fault("list", "EIO", 5),),
    "study shard": (Fault("thread", "EAGAIN", 2),),
    "simulate hdf5": (
        Fault("write", "ENOSPC", 3), Fault("write", "ENOSPC", 9, on=True), Fault("close", "EIO", 3),
    ),
    "watch": (Fault("create", "ENOSPC", 2), Fault("fsync", "EIO", 1)),
    "watch, arrow": (
        Fault("write", "ENOSPC", 2), Fault("write", "ENOSPC", 4), Fault("write", "ENOSPC", 6, on=True),
        Fault("close", "EIO", 10), Fault("close", "EIO", 11), Fault("read", SHORT, 4),
    ),
}  # fmt: skip
"""Those of `make test`."""


@pytest.mark.parametrize("name", SOME)
def test_what_fails_costs_nothing_but_the_run(
    request: pytest.FixtureRequest, tmp_path: Path, name: str
) -> None:
    scenario = next(one for one in SCENARIOS if one.name == name)
    stage, cells = _staged(scenario, tmp_path, request), read()
    for fault in SOME[name]:
        struck = stage.strike(fault)
        assert struck.failed, fault
        error = f"{fault.error}, lasting" if fault.on else fault.error
        assert struck.ran.code in cells[fault.operation, error, scenario.command], struck


def test_reading_the_table_of_a_study_starts_no_thread(runner: Runner, tmp_path: Path) -> None:
    """A thread of Arrow that is still starting when a short command ends aborts it."""
    scenario = next(one for one in SCENARIOS if one.name == "devices")
    assert not staged(scenario, tmp_path / "stage", runner).calls["thread"]


@pytest.mark.nightly
@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda one: one.name)
def test_each_call_of_each_operation(
    request: pytest.FixtureRequest, tmp_path: Path, scenario: Scenario
) -> None:
    """What the table says to be never called is not."""
    tried = Tried()
    tried.each(_staged(scenario, tmp_path, request), None)
    assert not tried.wrong, "\n".join(tried.wrong)
    known = read()
    assert all(known[place] for place in tried.cells)


def _staged(scenario: Scenario, folder: Path, request: pytest.FixtureRequest) -> Stage:
    """The command, with the runner that its workers are forked by."""
    runner = request.getfixturevalue("quick_runner" if scenario.quick else "runner")
    return staged(scenario, folder / "stage", runner)


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
