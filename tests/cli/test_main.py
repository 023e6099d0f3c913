"""The command itself: help, version, bugs, imports."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from accelcal_cli.cli import exit_codes
from accelcal_cli.cli.main import COMMANDS
from accelcal_cli.core.version import __version__
from tests.cli.run import assert_one_line, captured, run, run_process, safely

ROOT = Path(__file__).resolve().parent.parent.parent


def test_version_and_help() -> None:
    assert run("--version").out == f"accelcal, version {__version__}\n"
    ran = run("--help", code=0)
    assert all(name in ran.out for name in COMMANDS)
    assert run_process("--help").out == ran.out
    assert "Did you mean" not in run("frobnicate").err


def test_a_bug_is_one_line_and_the_traceback_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)

    def broken() -> None:
        raise ZeroDivisionError("a\nb")

    ran = captured(lambda: safely(broken))
    (kept,) = tmp_path.glob("accelcal-bug-*.txt")
    assert_one_line(ran, str(kept), code=70)
    assert "ZeroDivisionError" in kept.read_text()
    monkeypatch.undo()


def test_a_lock_that_a_signal_left_open_is_an_interruption() -> None:
    """A handler that raises while `Condition.wait` gives its lock up makes the release of it fail."""

    def interrupted() -> None:
        try:
            raise exit_codes.InterruptedBySignalError
        finally:
            threading.Lock().release()

    ran = captured(lambda: safely(interrupted))
    assert (ran.code, ran.err) == (130, "accelcal: interrupted; no incomplete output was left behind\n")
