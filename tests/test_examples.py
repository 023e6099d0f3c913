"""The files in `examples/`: each is run, or looked at, by the program that it is for."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest

from accelcal_cli.output.sentences import OUTCOMES, SENTENCES
from tests.cli.run import run
from tests.cli.studies import results, rows, study_folder
from tests.conftest import ROOT

Capture = pytest.CaptureFixture[str]
EXAMPLES = ROOT / "examples"
NAMES = ("a/p0.raw", "b/p2.raw")
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
COMMAND = f'#!/bin/sh\nexec {sys.executable} -m accelcal_cli "$@"\n'


def tool(name: str, variable: str = "") -> str:
    found = os.environ.get(variable) or shutil.which(name)
    if not found:
        pytest.skip(f"{name} is not installed")
    return found


def says(*words: object, cwd: Path | None = None, **environment: str) -> tuple[int, str]:
    done = subprocess.run(
        list(map(str, words)), cwd=cwd, env={**ENVIRONMENT, **environment}, stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, timeout=120, check=False,
    )  # fmt: skip
    return done.returncode, done.stdout.decode()


@pytest.fixture
def accelcal(tmp_path: Path) -> Path:
    """The command as one file."""
    path = tmp_path / "accelcal"
    path.write_text(COMMAND)
    path.chmod(0o755)
    return path


def results_of_all(out: Path) -> dict[str, object]:
    return {name: held for name, held in results(out).items() if "-of-" not in name}


def test_the_array_of_slurm_does_all_parts_and_the_sum(
    tmp_path: Path, accelcal: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As sbatch would run it: with its variables, the first time after a machine went down; then without."""
    shell = tool("bash")
    folder, out = study_folder(tmp_path / "in dir", NAMES), tmp_path / "out dir"
    words = (shell, EXAMPLES / "accelcal.sbatch", folder, out)
    out.mkdir()
    (out / "study.1-of-2.lock").write_text('{"host": "one that went down", "pid": 1}')
    for task in ("1", "2"):
        array = {"SLURM_ARRAY_TASK_ID": task, "SLURM_ARRAY_TASK_MIN": "1", "SLURM_ARRAY_TASK_COUNT": "2"}
        array |= {"SLURM_RESTART_COUNT": "1"} if task == "1" else {}
        assert says(*words, "--no-temperature", ACCELCAL=str(accelcal), **array)[0] == 0
    code, said = says(*words, "--no-temperature", ACCELCAL=str(accelcal))
    assert (code, "2 recordings (2 unchanged): 2 calibrated" in said) == (0, True)
    assert run(capsys, "study", folder, "-d", tmp_path / "one", "-j", 1, "--no-temperature").code == 0
    assert results_of_all(out) == results(tmp_path / "one")
    assert "usage" in says(*words[:3])[1]


def test_snakemake_does_what_is_new(
    tmp_path: Path, accelcal: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`make snakemake` says where one is."""
    snakemake = tool("snakemake", "ACCELCAL_SNAKEMAKE")
    folder, out, here = study_folder(tmp_path / "in", NAMES), tmp_path / "out", tmp_path / "here"
    here.mkdir()
    (folder / "zeros.cwa").write_bytes(bytes(4096))
    words = (snakemake, "-s", EXAMPLES / "Snakefile", "--directory", here, "--cores", 2, "--config",
             f"folder={folder}", f"out={out}", "parts=2", f"accelcal={accelcal}")  # fmt: skip
    assert says(*words, cwd=here)[0] == 0
    assert [row["outcome"] for row in rows(out)] == ["calibrated"] * 2 + ["failed"]
    assert "Nothing to be done" in says(*words, cwd=here)[1]
    (folder / "zeros.cwa").unlink()
    code, said = says(*words, cwd=here)
    assert (code, "2 recordings (2 unchanged): 2 calibrated" in said) == (0, True)
    assert run(capsys, "study", folder, "-d", tmp_path / "one", "-j", 1).code == 0
    assert results_of_all(out) == results(tmp_path / "one")


def test_systemd_takes_the_units(tmp_path: Path) -> None:
    verify = tool("systemd-analyze")
    for name in ("accelcal.service", "accelcal.timer"):
        unit = (EXAMPLES / name).read_text().replace("/opt/accelcal/bin/accelcal", "/bin/true")
        (tmp_path / name).write_text(unit)
    code, said = says(verify, "verify", tmp_path / "accelcal.service", tmp_path / "accelcal.timer")
    assert (code, "accelcal." in said) == (0, False), said


def test_cron_takes_the_table() -> None:
    crontab = tool("crontab")
    code, said = says(crontab, "-n", EXAMPLES / "accelcal.crontab")
    if "invalid option" in said:
        pytest.skip("this crontab checks no syntax")
    assert code == 0, said


def test_the_command_lines_are_understood(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of the service and the table of cron: with this test's folders they do nothing but look."""
    study_folder(tmp_path / "study", NAMES[:1])
    for name, start in (("accelcal.service", "ExecStart="), ("accelcal.crontab", "15 2 * * *  ")):
        lines = (EXAMPLES / name).read_text().splitlines()
        words = next(line for line in lines if line.startswith(start)).removeprefix(start).split()
        assert words[0] == "/opt/accelcal/bin/accelcal"
        here = [word.replace("/data/", f"{tmp_path}/") for word in words[1:]]
        looked = run(capsys, *here, "--dry-run", "--json")
        states = [json.loads(line)["state"] for line in looked.out.splitlines()]
        assert (looked.code, states) == (0, ["waiting", "left_out"])


def test_the_script_for_jobqueue_is_python() -> None:
    compile((EXAMPLES / "accelcal_jobqueue.py").read_text(), "accelcal_jobqueue.py", "exec")


def python_of(path: Path) -> list[str]:
    """The Python in a notebook's cells, or in a page's blocks."""
    if path.suffix == ".ipynb":
        cells = json.loads(path.read_text("utf-8"))["cells"]
        return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    return re.findall(r"^```python\n(.*?)^```", path.read_text("utf-8"), re.MULTILINE | re.DOTALL)


NIGHTLY = pytest.mark.nightly


@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("examples/first_look.ipynb", "examples"),
        pytest.param("examples/first_look.ipynb", ".", marks=NIGHTLY),
        pytest.param("docs/python.md", ".", marks=NIGHTLY),
    ],
)
def test_python_examples_run(name: str, place: str, monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    mpl.use("Agg")
    monkeypatch.chdir(ROOT / place)
    names: dict[str, Any] = {}
    parts = python_of(ROOT / name)
    assert len(parts) >= 3
    for part in parts:
        exec(compile(part, name, "exec"), names)
    if name.endswith("ipynb"):
        raw, calibrated = re.findall(r"[\d.]+(?= mg)", capsys.readouterr().out)[-2:]
        assert float(raw) > float(calibrated) > 0


def test_p11_the_notebook_has_its_outputs() -> None:
    """`python tools/run_notebook.py` stores them."""
    text = (EXAMPLES / "first_look.ipynb").read_text("utf-8")
    cells = [cell for cell in json.loads(text)["cells"] if cell["cell_type"] == "code"]
    assert all(len(cell["outputs"]) == 1 for cell in cells)
    kinds = [kind for cell in cells for kind in cell["outputs"][0].get("data", {})]
    assert {"text/html", "image/png", "text/plain"} <= set(kinds) and str(ROOT) not in text


@pytest.mark.nightly
def test_the_cookbook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sample_data").symlink_to(ROOT / "sample_data")
    page = ROOT / "docs/cookbook.md"
    (command,) = re.findall(r"^```sh\naccelcal (.*?)\n```", page.read_text("utf-8"), re.MULTILINE)
    assert run(capsys, *command.split(), "-j", 2, "-q").code == 0
    names: dict[str, Any] = {}
    for part in python_of(page):
        exec(compile(part, page.name, "exec"), names)
    assert names["epochs"]["enmo_mg"].between(0, 500).mean() > 0.9
    assert names["by_hour"].sum() == len(names["table"]) and names["shares"][0] > 0.5
    assert len(names["good"]) >= 3 and len(names["look_at"]) == 0
    assert names["minutes"]["filename"].nunique() == len(names["study"])
    assert len(names["quiet"]) > 100 and names["worn_hours"] >= 1


@pytest.fixture
def r_with_arrow() -> str:
    interpreter = tool("Rscript")
    if "TRUE" not in says(interpreter, "-e", "cat(requireNamespace('arrow', quietly = TRUE))")[1]:
        pytest.skip("R's package arrow is not installed")
    return interpreter


@pytest.mark.parametrize(
    ("page", "name", "folder", "shown"),
    [("cookbook.md", "recording", "out", "enmo_mg"), ("r.md", "night", "calibrated", "1000 * enmo")],
)
def test_pages_run_in_r(
    page: str, name: str, folder: str, shown: str, r_with_arrow: str, tmp_path: Path, capsys: Capture
) -> None:
    """The Parquet files of a study of one recording, by the lines of the page."""
    (tmp_path / "in").mkdir()
    (tmp_path / f"in/{name}.bin").symlink_to(ROOT / "sample_data/recording.bin")
    assert run(capsys, "study", tmp_path / "in", "-d", tmp_path / folder, "-j", 1, "-q").code == 0
    text = (ROOT / "docs" / page).read_text("utf-8")
    (program,) = re.findall(r"^```r\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    code, said = says(r_with_arrow, "-e", f"{program}\ncat('', {shown})", cwd=tmp_path)
    assert code == 0, said
    assert 1 < float(said.split()[-1]) < 3


def test_outcomes_and_reasons_in_the_documents_are_those_that_there_are() -> None:
    tables = (
        (ROOT / "README.md").read_text("utf-8").split("## Can I use the result?")[1].split("##")[0],
        (ROOT / "docs/refused.md").read_text("utf-8").split("## The most frequent reasons")[1].split("##")[0],
    )
    outcomes, refusals = (re.findall(r"^\| (`.*?`) \|", table, re.MULTILINE) for table in tables)
    assert outcomes == [f"`{name}`" for name in OUTCOMES]
    codes = [code for cell in refusals for code in re.findall("`(.*?)`", cell)]
    assert len(codes) > 6
    assert set(codes) - {"reason", "advice"} <= set(SENTENCES)
