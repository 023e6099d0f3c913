"""Running the command line inside and outside this process."""

from __future__ import annotations

import io
import json
import os
import resource
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from accelcal_cli.cli import exit_codes
from accelcal_cli.cli.main import cli
from accelcal_cli.core.errors import Reason
from accelcal_cli.output.sentences import sentence
from tests.schema import check_report


@dataclass(frozen=True)
class Ran:
    code: int
    out: str
    err: str

    @property
    def lines(self) -> list[str]:
        return self.out.splitlines()


class Written(io.TextIOWrapper):
    """Keeps what is written to it, as a file or a terminal would have it."""

    def __init__(self, *, terminal: bool) -> None:
        self.held, self.terminal = io.BytesIO(), terminal
        super().__init__(self.held, "utf-8", newline="", write_through=True)

    def isatty(self) -> bool:
        return self.terminal


def captured(work: Callable[[], int | None], *, terminal: bool = False) -> Ran:
    """The exit code that some work of this process returns, and what it writes."""
    out, err = Written(terminal=terminal), Written(terminal=terminal)
    with redirect_stdout(out), redirect_stderr(err):
        code = work() or 0
    return Ran(code, out.held.getvalue().decode(), err.held.getvalue().decode())


def run(*words: object, code: int | None = None, terminal: bool = False) -> Ran:
    """Run in this process, through the same error handling as the console command.

    Args:
        code: the exit code that it must have.
    """
    ran = captured(lambda: exit_code(*without_capture(words)), terminal=terminal)
    assert code in (None, ran.code), ran
    return ran


def without_capture(words: tuple[object, ...]) -> tuple[object, ...]:
    """Words of a command; some tests give the capture of pytest before them, which is not needed."""
    return words[1:] if isinstance(next(iter(words), None), pytest.CaptureFixture) else words


def exit_code(*words: object) -> int:
    """Run in this process; provenance names this command, as in a process of its own."""
    arguments = [str(word) for word in words]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["accelcal", *arguments])
        return safely(lambda: cli.main(arguments, "accelcal", standalone_mode=False))


def safely(work: Callable[[], object]) -> int:
    """The exit code of some work, with the errors of a command told, but signals left to the tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(exit_codes, "watch_signals", lambda: None)
        return exit_codes.run_safely(work)


def nightly(*values: object) -> Any:
    """A variant of a test for `make nightly`."""
    return pytest.param(*values, marks=pytest.mark.nightly)


def command(*words: object) -> list[str]:
    """The command line as a new process."""
    return [sys.executable, "-m", "accelcal_cli", *map(str, words)]


def run_process(
    *words: object, stdin: bytes | None = None, cwd: Path | None = None, timeout: float = 300
) -> Ran:
    """Run in a process of its own; what takes longer than `timeout` hangs."""
    done = subprocess.run(
        command(*words),
        input=stdin,
        capture_output=True,
        cwd=cwd,
        env=os.environ,
        timeout=timeout,
        check=False,
    )
    return Ran(done.returncode, done.stdout.decode(), done.stderr.decode())


@contextmanager
def little_room(file_bytes: int) -> Iterator[None]:
    """No file may grow beyond a number of bytes, as on a full disk."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (file_bytes, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def assert_one_line(ran: Ran, *parts: str, code: int | None = None) -> None:
    """stderr is one line without a traceback and holds these parts; the exit code is this one."""
    assert code in (None, ran.code), ran
    assert ran.err.count("\n") == 1, ran.err
    assert "Traceback" not in ran.err
    for part in parts:
        assert part in ran.err, ran.err


def files(folder: Path) -> list[str]:
    """The names of a folder's files."""
    return sorted(path.name for path in folder.iterdir())


def report_of(path: Path) -> dict[str, Any]:
    """A report, which fulfils its schema."""
    report: dict[str, Any] = json.loads(path.read_text("utf-8"))
    check_report(report)
    return report


def codes(reasons: Iterable[dict[str, Any]]) -> list[str]:
    """The codes of `notes`, `cautions` or `advice` of a report."""
    return [one["code"] for one in reasons]


def told(report: dict[str, Any], code: str) -> str:
    """The sentence of a code that the report has as its reason, or among its notes, cautions and advice."""
    every = [
        {"code": report["reason"], "values": report["values"]},
        *report["notes"],
        *report["cautions"],
        *report["advice"],
    ]
    (found,) = [one for one in every if one["code"] == code]
    return sentence(Reason(**found))


def verify(*given: Any) -> tuple[Ran, dict[str, Any]]:
    """`accelcal verify REPORT RECORDING ... --json`, which writes nothing, and its object."""
    report, *words = without_capture(given)
    before = {path: path.read_bytes() for path in report.parent.iterdir() if path.is_file()}
    ran = run("verify", report, *words, "--json")
    assert {path: path.read_bytes() for path in report.parent.iterdir() if path.is_file()} == before
    return ran, json.loads(ran.out) if ran.out else {}
