"""The command itself: help, version, bugs, imports."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path

import pytest

from accelcal_cli.cli import exit_codes
from accelcal_cli.cli.main import COMMANDS
from accelcal_cli.core.version import __version__
from tests.cli.run import run, run_process

Capture = pytest.CaptureFixture[str]
ROOT = Path(__file__).resolve().parent.parent.parent


def test_version_and_help(capsys: Capture) -> None:
    assert run(capsys, "--version").out == f"accelcal, version {__version__}\n"
    ran = run(capsys, "--help")
    assert ran.code == 0
    assert all(name in ran.out for name in COMMANDS)
    assert run_process("--help").out == ran.out


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_each_command_has_help_and_is_in_the_readme(capsys: Capture, name: str) -> None:
    ran = run(capsys, name, "--help")
    assert ran.code == 0
    assert "Usage: accelcal " + name in ran.out
    assert f"accelcal {name}" in (ROOT / "README.md").read_text()


def test_help_imports_no_heavy_library() -> None:
    code = (
        "import sys; from accelcal_cli.cli.main import cli\n"
        "cli.main(['--help'], standalone_mode=False)\n"
        "heavy = {'numpy', 'pyarrow', 'pandas', 'h5py', 'tqdm'} & set(sys.modules)\n"
        "sys.exit(f'imported {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_bug_is_one_line_and_the_traceback_is_kept(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)

    def broken() -> None:
        raise ZeroDivisionError("a\nb")

    monkeypatch.setattr(exit_codes, "watch_signals", lambda: None)
    assert exit_codes.run_safely(broken) == 70
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    (kept,) = tmp_path.glob("accelcal-bug-*.txt")
    assert str(kept) in err
    assert "ZeroDivisionError" in kept.read_text()
    monkeypatch.undo()


def test_a_lock_that_a_signal_left_open_is_an_interruption_and_no_bug(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A handler that raises while `Condition.wait` gives its lock up makes the release of it fail."""

    def interrupted() -> None:
        try:
            raise exit_codes.InterruptedBySignalError
        finally:
            threading.Lock().release()

    monkeypatch.setattr(exit_codes, "watch_signals", lambda: None)
    assert exit_codes.run_safely(interrupted) == 130
    assert capsys.readouterr().err == "accelcal: interrupted; no incomplete output was left behind\n"


def test_an_unknown_command_is_wrong_usage(capsys: Capture) -> None:
    assert run(capsys, "calibrat").code == 2


def test_a_recording_is_calibrated_without_loading_what_only_others_need(tmp_path: Path) -> None:
    recording = ROOT / "sample_data" / "recording.bin"
    words = ["calibrate", str(recording), "-d", str(tmp_path), "-q"]
    code = (
        "import sys; from accelcal_cli.cli.main import cli\n"
        f"cli.main({words!r}, standalone_mode=False)\n"
        "sys.exit(f'imported {heavy}' if (heavy := {'pandas', 'numpy.ma'} & set(sys.modules)) else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert next(tmp_path.glob("*.parquet"))


def test_a_slip_in_a_command_s_name_is_pointed_out(capsys: pytest.CaptureFixture[str]) -> None:
    ran = run(capsys, "calibrat")
    assert ran.code == 2 and "no such command 'calibrat'. Did you mean 'calibrate'?" in ran.err
    assert "Did you mean" not in run(capsys, "frobnicate").err
