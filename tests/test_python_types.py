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
from typing import Any

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
    assert sum(bool(test.examples) for test in found) == {"_api": 5, "_results": 1, "_studies": 3}[name]
    for test in found:
        runner.run(test)
    assert runner.summarize(verbose=False).failed == 0


FUNCTIONS = {
    "calibrate": "CalibrationOptions", "inspect": "CalibrationOptions", "effect": "CalibrationOptions",
    "read": "ReadingOptions", "fit": "FitOptions", "from_poses": "PoseOptions", "study": "StudyOptions",
}  # fmt: skip


def texts_of(kind: str) -> dict[str, str]:
    """The options of a class with their texts, read from the source by lines."""
    text = (ROOT / "accelcal/_options.py").read_text("utf-8")
    own, base = re.findall(rf"class {kind}\((\w+).*?\n(.*?)(?=\nclass |\Z)", text, re.DOTALL)[0][::-1]
    found = {} if base == "TypedDict" else texts_of(base)
    entries = re.findall(r'^    (\w+): [^\n]*\n    """(.*?)"""', own, re.DOTALL | re.MULTILINE)
    return found | {name: " ".join(said.split()) for name, said in entries}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_help_describes_each_option_with_its_whole_sentence(name: str) -> None:
    import inspect

    import accelcal

    function, options = getattr(accelcal, name), texts_of(FUNCTIONS[name])
    text = " ".join((function.__doc__ or "").split())
    assert [one for one, said in options.items() if f" {one}: {said}" not in text] == []
    shown, only = inspect.signature(function).parameters, {inspect.Parameter.KEYWORD_ONLY}
    assert {shown[one].kind for one in options} == only and " options: " not in text


def test_the_package_works_without_its_sources(tmp_path: Path) -> None:
    import py_compile

    for path in (ROOT / "accelcal").glob("*.py"):
        py_compile.compile(str(path), str(tmp_path / "accelcal" / f"{path.stem}.pyc"), doraise=True)
    words = [sys.executable, "-c", "import accelcal; print(accelcal.__file__, accelcal.calibrate.__doc__)"]
    own = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])}
    done = subprocess.run(words, cwd=tmp_path, env=own, capture_output=True, text=True, check=False)
    assert done.stdout.startswith(str(tmp_path)) and "options: for reading" in done.stdout, done.stderr


def docstrings() -> dict[str, tuple[str, str]]:
    """Kind and text of all that the reference has, by name."""
    import ast
    import inspect

    import accelcal

    found = {}
    for name in accelcal.__all__:
        one = getattr(accelcal, name)
        found[name] = ("class" if inspect.isclass(one) else "function", inspect.getdoc(one) or "")
        for part, held in vars(one).items() if inspect.isclass(one) else ():
            if not part.startswith("_") and held.__doc__ and (callable(held) or isinstance(held, property)):
                kind = "property" if isinstance(held, property) else "method"
                found[f"{name}.{part}"] = (kind, inspect.getdoc(held) or "")
    for kind in ast.parse((ROOT / "accelcal/_options.py").read_text("utf-8")).body:
        if isinstance(kind, ast.ClassDef):
            for option, said in texts_of(kind.name).items():
                found[f"{kind.name}.{option}"] = ("attribute", said)
    return found


def test_no_entry_of_the_reference_is_cut() -> None:
    """As Sphinx shows it: napoleon takes words before a colon for a type, unless the site's setup hinders."""
    napoleon = pytest.importorskip("sphinx.ext.napoleon")
    conf = dict[str, Any]()
    exec(
        (ROOT / "docs/conf.py").read_text("utf-8").replace("__file__", repr(str(ROOT / "docs/conf.py"))), conf
    )
    cut, settings = {}, napoleon.Config(napoleon_numpy_docstring=conf["napoleon_numpy_docstring"])
    assert not settings.napoleon_numpy_docstring, "it would take the words from what the setup has kept"
    for name, (what, text) in docstrings().items():
        lines = text.splitlines()
        conf["_whole"](None, what, name, None, None, lines)
        shown = napoleon.GoogleDocstring(lines, settings, what=what, name=name).lines()
        if any(re.match(r"\s*:r?type", line) for line in shown):
            cut[name] = shown
        missing = [word for word in re.findall(r"\w+", text) if word not in " ".join(shown)]
        if {*missing} - {"Args", "Attributes", "Returns", "Raises", "Example", "Yields"}:
            cut[name] = missing
    assert cut == {}


def test_no_result_is_described_by_a_colon() -> None:
    """What is before it would be shown as a type."""
    for name, (_, text) in docstrings().items():
        for first in re.findall(r"(?:Returns|Yields):\n\s+(.*)", text):
            assert ":" not in re.sub(r"`[^`]*`", "", first), name
