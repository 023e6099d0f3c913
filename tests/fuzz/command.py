"""Runs the command in this process, and finds what no command may do."""

from __future__ import annotations

import io
import json
import re
import shutil
import sys
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

from accelcal_cli.cli import exit_codes
from accelcal_cli.cli.main import cli

CODES = (0, 1, 2, 3, 4, 5, 75)
CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
OUR_LINES = re.compile(r"accelcal: |$")
WITHOUT_OUTPUTS = (2, 3, 5)


@dataclass(frozen=True)
class Ran:
    """What a command did.

    Attributes:
        trace: of what it did not expect, None if there was nothing.
    """

    code: object
    shown: str
    said: str
    trace: str | None


@contextmanager
def caught_output() -> Iterator[tuple[io.StringIO, io.StringIO]]:
    with patch.object(sys, "stdout", io.StringIO()), patch.object(sys, "stderr", io.StringIO()):
        yield sys.stdout, sys.stderr  # type: ignore[misc]


def run(arguments: Sequence[object]) -> Ran:
    traces: list[str] = []
    words = [str(word) for word in arguments]
    with (
        caught_output() as (shown, said),
        patch.object(exit_codes, "keep_trace", lambda text: traces.append(text) or "a file"),
        patch.object(exit_codes, "watch_signals", lambda: None),
        patch.object(exit_codes, "_end_silently_on_signals", lambda: None),
    ):
        try:
            code: object = exit_codes.run_safely(
                lambda: cli.main(args=words, prog_name="accelcal", standalone_mode=False)
            )
        except Exception:
            code = None
            traces.append(traceback.format_exc())
    return Ran(code, shown.getvalue(), said.getvalue(), traces[0] if traces else None)


def wrong(ran: Ran, folder: Path | None = None) -> str | None:
    """What a command did that none may do; `folder` holds its outputs and nothing else."""
    if ran.trace is not None:
        return ran.trace
    if ran.code not in CODES:
        return f"CODE {ran.code}: {ran.said}"
    for name, text in (("stdout", ran.shown), ("stderr", ran.said)):
        if CONTROL.search(text):
            return f"CONTROL CHARACTER on {name}: {text[max(0, CONTROL.search(text).start() - 60) :][:120]!r}"
    foreign = [line for line in ran.said.splitlines() if not OUR_LINES.match(line)]
    if foreign:
        return f"FOREIGN LINE on stderr: {foreign[0]!r}"
    return None if folder is None else wrong_outputs(ran, folder)


def wrong_outputs(ran: Ran, folder: Path) -> str | None:
    """What lies in a folder and should not, or is not whole."""
    files = [path for path in folder.rglob("*") if path.is_file()] if folder.exists() else []
    for path in files:
        if path.name.startswith(".") or path.suffix == ".tmp":
            return f"LEFT BEHIND: {path.name}"
        if path.suffix == ".json":
            json.loads(path.read_text("utf-8"), parse_constant=refuse_constant)
    if ran.code in WITHOUT_OUTPUTS and files:
        return f"OUTPUTS of a run with code {ran.code}: {sorted(path.name for path in files)}"
    return None


def refuse_constant(name: str) -> None:
    """NaN is not JSON."""
    raise AssertionError(f"{name} in a JSON file")


def checked_run(arguments: Sequence[object], folder: Path | None = None) -> tuple[Ran, str | None]:
    """Run a command whose outputs go to a new folder; what it did, and what was wrong."""
    if folder is not None:
        shutil.rmtree(folder, ignore_errors=True)
    ran = run(arguments)
    return ran, wrong(ran, folder)
