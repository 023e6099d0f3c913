"""Outputs of earlier versions stay readable: each folder of tests/data/outputs works with every command.

A failure means that people's results of that version would no longer be read. Only while the version is not
released (its folder ends in `.dev`), and the form of the outputs was changed on purpose, is its folder made
again: `python -m tests.freeze_outputs`.
"""

from __future__ import annotations

import csv
import json
import re
import shutil
from pathlib import Path

import pandas as pd
import pyarrow.parquet as pq
import pytest

import accelcal
from accelcal_cli.core.identity import is_ours
from tests.cli.run import Ran, run
from tests.freeze_outputs import CURRENT, OUTPUTS

Capture = pytest.CaptureFixture[str]
REGISTRY = r'"kind": "registry",\s*"schema_version": 4,\s*"accelcal_version": "[^"]*"'
AGAIN = "made by a development version"


@pytest.fixture(params=sorted(OUTPUTS.iterdir()), ids=lambda folder: folder.name)
def frozen(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A copy of the folder of a version, with recordings in `in` and their study in `out`."""
    shutil.copytree(request.param, tmp_path, dirs_exist_ok=True)
    return tmp_path


def commands(folder: Path) -> dict[str, tuple[object, ...]]:
    """Every command that takes outputs of earlier runs, with all of them."""
    out, registry, b = folder / "out", folder / "registry.json", folder / "in" / "b.raw"
    report = out / "a.calibration.json"
    return {
        "apply": ("apply", "--coefficients", report, b, "-d", folder / "applied"),
        "apply --registry": ("apply", "--registry", registry, b, "-d", folder / "registered"),
        "apply --report-only": (*("apply", "--coefficients", report, b, "--report-only"),
                                *("-d", folder / "looked at")),
        "report": ("report", report), "report OUT": ("report", out),
        "export": ("export", report, "--to", "ggir", "-o", folder / "ggir.csv"),
        "export OUT": ("export", out, "--to", "actipy", "-d", folder / "exported"),
        "export --to csv": ("export", out / "a.calibrated.parquet", "--to", "csv", "-o", folder / "a.csv"),
        "devices": ("devices", out),
        "devices --registry": ("devices", registry, "--registry", folder / "merged.json"),
        "inspect": ("inspect", out / "a.calibrated.parquet"),
        "calibrate --registry": (*("calibrate", folder / "in" / "short.raw", "--registry", registry),
                                 *("-d", folder / "short")),
    }  # fmt: skip


NAMES = tuple(commands(Path()))
CODES = {"export OUT": 1}
"""One recording is excluded by a person and one was refused."""


def test_this_version_is_frozen() -> None:
    assert CURRENT.is_dir(), "python -m tests.freeze_outputs makes it"


@pytest.mark.parametrize("name", NAMES)
def test_each_command_reads_them(frozen: Path, capsys: Capture, name: str) -> None:
    ran = run(capsys, *commands(frozen)[name])
    assert ran.code == CODES.get(name, 0), ran


def test_a_report_is_verified(frozen: Path, capsys: Capture) -> None:
    """A later method may give other numbers, which is said."""
    ran = run(capsys, "verify", frozen / "out" / "a.calibration.json", frozen / "in" / "a.raw", "--values")
    assert ran.code in (0, 1) and ran.out.split("\t")[1] in ("identical", "differs"), ran


def test_a_study_goes_on_with_them(frozen: Path, capsys: Capture) -> None:
    """What another version made is made again, and what a person decided stays."""
    before = pd.read_csv(frozen / "out" / "study.csv").set_index("path")
    ran = run(capsys, "study", frozen / "in", "-d", frozen / "out", "-j", 1, "-q")
    assert ran.code in (0, 1), "one is refused, or was before"
    after = pd.read_csv(frozen / "out" / "study.csv").set_index("path")
    assert list(after.index) == list(before.index) and after["use"].to_dict() == before["use"].to_dict()
    assert set(after["accelcal_version"]) == {accelcal.__version__}


def test_python_reads_them(frozen: Path) -> None:
    report = frozen / "out" / "a.calibration.json"
    assert accelcal.Calibration(report)([0.0, 0.0, 1.0], 25.0).shape == (3,)
    assert accelcal.apply(report, [[0.0, 0.0, 1.0]], 25.0).shape == (1, 3)
    assert "a.raw" in accelcal.export(report, to="json")


def test_each_file_states_what_it_is_and_by_which_version(frozen: Path) -> None:
    kinds = {"calibration": "report", "quality": "quality", "study": "study", "registry": "registry"}
    for path in frozen.rglob("*.json"):
        held = json.loads(path.read_text())
        assert is_ours(held) and held["kind"] == kinds[path.name.split(".")[-2]], path
        assert type(held["schema_version"]) is int and isinstance(held["accelcal_version"], str)
    for path in frozen.rglob("*.parquet"):
        held = json.loads(pq.read_schema(path).metadata[b"accelcal"])
        assert held["kind"] == ("study" if path.stem == "study" else "samples")
        assert {"schema_version", "accelcal_version"} <= held.keys()
    with (frozen / "out" / "study.csv").open(newline="") as file:
        assert next(csv.reader(file))[:3] == ["path", "use", "why"]


@pytest.fixture(scope="module")
def developed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of this version as a development version before 1.0.0 wrote it."""
    folder = tmp_path_factory.mktemp("developed")
    shutil.copytree(CURRENT, folder, dirs_exist_ok=True)
    for path in folder.rglob("*.json"):
        text = re.sub(r'"kind": "(report|quality|study)",', "", path.read_text("utf-8"))
        text = re.sub(REGISTRY, '"accelcal_registry": 1', text)
        text = re.sub(r'"accelcal_version": "[^"]*"', '"accelcal_version": "0.3.0"', text)
        path.write_text(text.replace('"schema_version": 4', '"schema_version": 3'), "utf-8")
    for path in folder.rglob("*.parquet"):
        table = pq.read_table(path)
        held = json.loads(table.schema.metadata[b"accelcal"]) | {"accelcal_version": "0.3.0"}
        del held["kind"], held["schema_version"]
        about = None if path.stem == "study" else {b"accelcal": json.dumps(held).encode()}
        pq.write_table(table.replace_schema_metadata(about), path)
    return folder


@pytest.mark.parametrize("name", NAMES)
def test_those_of_development_versions_are_named_and_not_read(
    developed: Path, capsys: Capture, name: str
) -> None:
    assert_named(run(capsys, *commands(developed)[name]))


def test_development_versions_are_named_by_verify_and_python(developed: Path, capsys: Capture) -> None:
    report = developed / "out" / "a.calibration.json"
    assert_named(run(capsys, "verify", report, developed / "in" / "a.raw"))
    for use in (accelcal.Calibration, lambda path: accelcal.export(path, to="ggir")):
        with pytest.raises(accelcal.AccelcalError, match=AGAIN):
            use(report)


def assert_named(ran: Ran) -> None:
    """One line names the version, with a way on; no bug."""
    (line,) = (one for one in ran.err.splitlines() if AGAIN in one)
    assert ran.code == 3 and re.search(rf"{AGAIN}( \(0\.3\.0\))? of accelcal; ", line), ran
    assert "Traceback" not in ran.err
