"""Running the command line inside and outside this process."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from accelcal_cli.cli import exit_codes
from accelcal_cli.cli.main import cli
from accelcal_cli.core.reasons import Reason
from accelcal_cli.output.words import sentence


@dataclass(frozen=True)
class Ran:
    code: int
    out: str
    err: str

    @property
    def lines(self) -> list[str]:
        return self.out.splitlines()


def run(capsys: pytest.CaptureFixture[str], *words: object) -> Ran:
    """Run in this process, through the same error handling as the console command."""
    capsys.readouterr()
    code = exit_code(*words)
    captured = capsys.readouterr()
    return Ran(code, captured.out, captured.err)


def exit_code(*words: object) -> int:
    """Run in this process; provenance names this command, as in a process of its own."""
    arguments = [str(word) for word in words]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(exit_codes, "watch_signals", lambda: None)
        patch.setattr(sys, "argv", ["accelcal", *arguments])
        return exit_codes.run_safely(lambda: cli.main(arguments, "accelcal", standalone_mode=False))


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


def assert_one_line(ran: Ran, *parts: str) -> None:
    """stderr is one line without a traceback and holds these parts."""
    assert ran.err.count("\n") == 1, ran.err
    assert "Traceback" not in ran.err
    for part in parts:
        assert part in ran.err, ran.err


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


def verify(
    capsys: pytest.CaptureFixture[str], report: Path, recording: Path, *words: object
) -> tuple[Ran, dict[str, Any]]:
    """`accelcal verify --json`, which writes nothing, and its object."""
    before = {path: path.read_bytes() for path in report.parent.iterdir() if path.is_file()}
    ran = run(capsys, "verify", report, recording, "--json", *words)
    assert {path: path.read_bytes() for path in report.parent.iterdir() if path.is_file()} == before
    return ran, json.loads(ran.out) if ran.out else {}
