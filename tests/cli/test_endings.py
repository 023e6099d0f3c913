"""How the command ends: signals at bad moments, outputs that take nothing, no room, no memory."""

from __future__ import annotations

import errno
import io
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from accelcal_cli.cli import exit_codes
from accelcal_cli.core.errors import OutputError
from accelcal_cli.pipeline import calibrate
from accelcal_cli.segment.segmenter import Segmenter
from accelcal_cli.studies import task
from tests.cli.run import assert_one_line, captured, command, little_room, run, safely
from tests.recordings import directions, still_counts, write_raw

ROOT = Path(__file__).resolve().parent.parent.parent

AT_AN_IMPORT = """
import os, signal, sys
from accelcal_cli.__main__ import main
class Finder:
    def find_spec(self, name, path, target=None):
        if name == "click":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
sys.argv = ["accelcal", "--help"]
main()
"""

IN_A_CALLBACK = """
import signal, sys, weakref
from accelcal_cli.cli.exit_codes import run_safely
class Thing: pass
def command():
    thing = Thing()
    held = weakref.ref(thing, lambda _: signal.raise_signal(signal.SIGTERM))
    del thing
    for _ in range(10**7):
        pass
sys.exit(run_safely(command))
"""


def python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


def test_an_interruption_before_the_command_has_begun_is_quiet() -> None:
    done = python(AT_AN_IMPORT)
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGINT, "", "")
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    assert scripts == {"accelcal": "accelcal_cli.__main__:main"}


def test_a_signal_is_not_lost_in_a_callback() -> None:
    done = python(IN_A_CALLBACK)
    assert done.returncode == 130
    assert done.stderr == "accelcal: interrupted; no incomplete output was left behind\n"


def test_signals_are_left_as_they_were_for_what_comes_after() -> None:
    done = python(
        "import signal\nfrom accelcal_cli.cli.exit_codes import run_safely\nrun_safely(lambda: 0)\n"
        "signal.raise_signal(signal.SIGTERM)"
    )
    assert (done.returncode, done.stderr) == (-signal.SIGTERM, "")


FAILS_AT_ITS_END = """
import contextlib, signal, sys
from accelcal_cli.cli.exit_codes import run_safely
from accelcal_cli.core.errors import OutputError
@contextlib.contextmanager
def output():
    try:
        yield
    finally:
        raise OutputError("a temporary file cannot be removed")
def command():
    with output():
        signal.raise_signal(signal.{})
sys.exit(run_safely(command))
"""


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_an_error_while_a_signal_ends_the_command_is_an_interruption(name: str) -> None:
    done = python(FAILS_AT_ITS_END.format(name))
    assert (done.returncode, done.stderr) == (
        130,
        "accelcal: interrupted; no incomplete output was left behind\n",
    )


def interrupted_and_failing(*_words: object) -> None:
    try:
        raise exit_codes.InterruptedBySignalError
    finally:
        raise OutputError("a temporary file cannot be removed")


@pytest.mark.parametrize("command", [("calibrate",), ("inspect",), ("evaluate", "stillness")], ids=" ".join)
def test_a_recording_that_fails_as_a_signal_ends_it_is_the_last(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...]
) -> None:
    """The others are not begun."""
    paths = [write_raw(tmp_path / f"{name}.raw", still_counts(directions(2))) for name in "ab"]
    before = sorted(tmp_path.iterdir())
    monkeypatch.setattr(Segmenter, "feed", interrupted_and_failing)
    ran = run(*command, *paths)
    assert (ran.code, ran.out) == (130, "")
    assert ran.err == "accelcal: interrupted; no incomplete output was left behind\n"
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("error", [OutputError("x"), OSError("x"), MemoryError()])
def test_a_worker_that_is_terminated_ends_whatever_fails_meanwhile(error: Exception) -> None:
    """Its recording is not entered as failed: it is given to another worker."""

    @task.guarded
    def work(_task: task.Task, _progress: object) -> task.TaskResult:
        try:
            raise SystemExit(143)
        finally:
            raise error

    with pytest.raises(SystemExit) as ended:
        work(None, print)  # type: ignore[type-var]
    assert ended.value.code == 143


def test_a_bug_without_room_for_its_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", None)
    with little_room(0):
        ran = captured(lambda: safely(lambda: 1 / 0))
    assert (ran.code, ran.err.count("\n")) == (70, 1)
    assert "ZeroDivisionError" in ran.err and f'File "{__file__}", line' in ran.err


def test_standard_input_without_room_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"x")))
    with little_room(0):
        ran = run("inspect", "-")
    assert ran.code == 5
    assert_one_line(ran, "standard input cannot be stored", "TMPDIR")


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (MemoryError(), "there was not enough memory"),
        (OSError(errno.ENOMEM, "x"), "there was not enough memory"),
        (RuntimeError("can't start new thread"), "no more threads could be started"),
        (Exception("Failed to launch worker thread: x"), "no more threads could be started"),
    ],
)
def test_no_memory_is_no_bug(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception, told: str
) -> None:
    def fails(*_words: object, **_named: object) -> None:
        raise error

    path = write_raw(tmp_path / "a.raw", still_counts(directions(2)))
    monkeypatch.setattr(calibrate.RecordingRun, "result", fails)
    assert_one_line(run("calibrate", path), str(path), told, code=71)
    assert task.NO_MEMORY == exit_codes.NO_MEMORY


FULL = Path("/dev/full")


@pytest.mark.skipif(not FULL.exists(), reason="needs /dev/full")
def test_errors_that_cannot_be_said_keep_their_code(tmp_path: Path) -> None:
    with FULL.open("wb") as full:
        absent = subprocess.run(command("inspect", tmp_path / "absent"), stderr=full, check=False)
        usage = subprocess.run(command("inspect", "--nope"), stderr=full, check=False)
    assert (absent.returncode, usage.returncode) == (3, 2)


@pytest.mark.skipif(not FULL.exists(), reason="needs /dev/full")
def test_a_full_standard_output_does_not_stop_the_work(tmp_path: Path) -> None:
    paths = [write_raw(tmp_path / f"{name}.raw", still_counts(directions(2))) for name in "ab"]
    with FULL.open("wb") as full:
        done = subprocess.run(
            command("calibrate", *paths), stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 5
    assert done.stderr.splitlines()[-1] == (
        "accelcal: standard output cannot be written (No space left on device): the output was lost"
    )
    assert len(list(tmp_path.glob("*.calibration.json"))) == 2
