"""Type checkers report wrong calls of the package, and only those; its examples run."""

from __future__ import annotations

import doctest
import json
import os
import re
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from tests.conftest import ROOT

CALLS = ROOT / "tests/typed_calls.py"
WRONG = {
    number for number, line in enumerate(CALLS.read_text().splitlines(), 1) if line.endswith("  # wrong")
}


def test_p6_mypy_reports_the_twenty_wrong_calls_alone() -> None:
    pytest.importorskip("mypy")
    command = [sys.executable, "-m", "mypy", "--strict", "--no-error-summary", str(CALLS)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    found = [int(number) for number in re.findall(r"typed_calls\.py:(\d+): error", done.stdout)]
    assert (len(WRONG), sorted(found)) == (20, sorted(WRONG)), done.stdout


def test_p6_pyright_reports_the_same() -> None:
    tool = os.environ.get("ACCELCAL_PYRIGHT") or shutil.which("pyright")
    if not tool:
        pytest.skip("pyright is not installed")
    command = [tool, "--pythonpath", sys.executable, "--outputjson", str(CALLS)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    found = json.loads(done.stdout)["generalDiagnostics"]
    assert sorted(one["range"]["start"]["line"] + 1 for one in found) == sorted(WRONG), found


@pytest.mark.parametrize("name", ["_api", "_results", "_studies"])
def test_the_examples_of_docstrings_run(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A decorated function has its docstring from the one it stands for."""
    monkeypatch.chdir(ROOT)
    module, runner = import_module(f"accelcal.{name}"), doctest.DocTestRunner()
    homes = {
        key: one for key, one in vars(module).items() if getattr(one, "__module__", "") == module.__name__
    }
    found = [
        test for key, one in homes.items() for test in doctest.DocTestFinder(recurse=False).find(one, key)
    ]
    assert sum(bool(test.examples) for test in found) == {"_api": 5, "_results": 1, "_studies": 2}[name]
    for test in found:
        runner.run(test)
    assert runner.summarize(verbose=False).failed == 0


def test_p6_every_option_is_a_keyword_with_a_line_of_help() -> None:
    import inspect

    import accelcal

    shown = inspect.signature(accelcal.calibrate).parameters
    assert {"rate", "unit", "prior", "stillness_axis", "temperature"} <= set(shown) and len(shown) > 40
    assert all(one.kind is one.KEYWORD_ONLY for name, one in shown.items() if name != "source")
    text = Path(ROOT / "accelcal/_options.py").read_text()
    assert "[Hz] Sampling rate, if the file has no times (above 0, at most 100000)." in text
