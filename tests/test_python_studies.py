"""`accelcal.study` wherever it is called, and other functions for many files: the bits of the commands."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import textwrap
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import accelcal
from tests.cli.run import run
from tests.cli.studies import NAMES, results, study_folder
from tests.conftest import ROOT
from tests.recordings import LSB_PER_G, directions, still_counts, write_raw

Capture, Expected = pytest.CaptureFixture[str], tuple[Path, dict[str, object]]
PLAIN = """
import accelcal

with open("runs", "a") as file:
    file.write("ran\\n")
table = accelcal.study("in", "out", jobs=2)
print(table["outcome"].tolist())
"""
CALIBRATE = """
import accelcal
from concurrent.futures import ThreadPoolExecutor

with ThreadPoolExecutor(2) as pool:
    found = list(pool.map(accelcal.calibrate, ["in/north/a.raw", "in/north/b.raw"]))
    tables = list(pool.map(lambda name: accelcal.study("in", name, jobs=1, report_only=True), ["1", "2"]))
    two = list(pool.map(lambda name: accelcal.study("in", name, jobs=2), ["out", "3"]))
assert [one.outcome for one in found] == ["calibrated"] * 2
assert all(table["outcome"].tolist() == ["calibrated"] * 2 for table in [*tables, *two])
print(["calibrated"] * 2)
"""
IN_CHILDREN = """
import multiprocessing, os, sys

METHOD = sys.argv[1]


def work(name):
    import accelcal

    assert accelcal.calibrate("in/north/a.raw").outcome == "calibrated"
    return accelcal.study("in", name, jobs=2)["outcome"].tolist()


if __name__ == "__main__":
    if METHOD == "fork":  # the server of workers is the parent's
        work("before")
    context = multiprocessing.get_context(METHOD)
    with context.Pool(1) as pool:
        print(pool.map(work, ["out"])[0])
    if METHOD == "fork" and (child := os.fork()) == 0:
        os._exit(work("child") != ["calibrated"] * 2)
    elif METHOD == "fork":
        assert os.waitpid(child, 0)[1] == 0
"""
NOTEBOOK = """
from jupyter_client.manager import start_new_kernel

said = []
manager, client = start_new_kernel(kernel_name="python3")
cells = ["import accelcal", "table = accelcal.study('in', 'out', jobs=2)", "print(table['outcome'].tolist())"]
for cell in [*cells, "accelcal.calibrate('in/north/a.raw')"]:
    reply = client.execute_interactive(cell, output_hook=lambda message: said.append(message["content"]))
    assert reply["content"]["status"] == "ok", reply
client.stop_channels()
manager.shutdown_kernel()
assert any("verdict" in one.get("data", {}).get("text/html", "") for one in said)
print("".join(one.get("text", "") for one in said))
"""
PROGRAMS = {
    "script": (PLAIN, ["program.py"]), "stdin": (PLAIN, ["-"]), "threads": (CALIBRATE, ["program.py"]),
    "spawn": (IN_CHILDREN, ["program.py", "spawn"]), "fork": (IN_CHILDREN, ["program.py", "fork"]),
    "forkserver": (IN_CHILDREN, ["program.py", "forkserver"]), "notebook": (NOTEBOOK, ["program.py"]),
}  # fmt: skip
FAST = ("script", "stdin")


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> Expected:
    """A folder of two recordings, and what the command makes of it."""
    here = tmp_path_factory.mktemp("study")
    study_folder(here / "in", NAMES[:2])
    words = [sys.executable, "-m", "accelcal_cli", "study", "in", "-d", "command", "-j", "1", "-q"]
    subprocess.run(words, cwd=here, env={**os.environ, "PYTHONPATH": str(ROOT)}, check=True)
    return here, results(here / "command")


@pytest.mark.parametrize(
    "how", [pytest.param(one, marks=[] if one in FAST else pytest.mark.nightly) for one in PROGRAMS]
)
def test_p2_a_study_is_that_of_the_command(how: str, tmp_path: Path, expected: Expected) -> None:
    if how == "notebook":
        pytest.importorskip("ipykernel")
    text, words = PROGRAMS[how]
    (tmp_path / "in").symlink_to(expected[0] / "in")
    (tmp_path / "program.py").write_text(textwrap.dedent(text))
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    own = {"PYTHONPATH": path, "IPYTHONDIR": str(tmp_path), "JUPYTER_PLATFORM_DIRS": "1"}
    done = subprocess.run(
        [sys.executable, *words], input=text if "-" in words else None, cwd=tmp_path, env=os.environ | own,
        capture_output=True, text=True, timeout=200, check=False,
    )  # fmt: skip
    assert done.returncode == 0 and (how == "notebook" or not done.stderr), done.stderr
    assert "['calibrated', 'calibrated']" in done.stdout
    assert results(tmp_path / "out") == expected[1]
    if text == PLAIN:
        assert (tmp_path / "runs").read_text() == "ran\n"


@pytest.mark.parametrize("kind", ["one job", "pool of threads"])
def test_p10_the_work_is_done_in_this_process(
    kind: str, tmp_path: Path, expected: Expected, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(expected[0])
    monkeypatch.setattr("accelcal_cli.studies.executors.ProcessPool", None)
    with ThreadPoolExecutor(2) as pool:
        how: dict[str, Any] = {"jobs": 1} if kind == "one job" else {"executor": pool}
        table = accelcal.study("in", tmp_path / "out", **how)
    assert table["exit_code"].tolist() == [0, 0]
    assert results(tmp_path / "out") == expected[1]


@pytest.mark.nightly
@pytest.mark.parametrize("kind", ["executor", "worker"])
def test_p10_dask_does_the_work(
    kind: str, tmp_path: Path, expected: Expected, monkeypatch: pytest.MonkeyPatch
) -> None:
    distributed = pytest.importorskip("distributed")
    monkeypatch.chdir(expected[0])
    how: dict[str, Any] = {"n_workers": 1, "threads_per_worker": 1, "processes": False}
    cluster = distributed.LocalCluster(**how, dashboard_address=":0")
    with cluster, distributed.Client(cluster) as client:
        if kind == "worker":
            client.submit(accelcal.study, "in", tmp_path / "out", jobs=1, pure=False).result()
            found = client.submit(accelcal.calibrate, "in/north/a.raw", pure=False).result()
            assert found.report["calibration"] == accelcal.calibrate("in/north/a.raw")["calibration"]
        else:
            accelcal.study("in", tmp_path / "out", executor=client.get_executor())
    assert results(tmp_path / "out") == expected[1]


def test_p10_a_study_shows_a_bar_only_if_asked_for(tmp_path: Path, capsys: Capture) -> None:
    folder = study_folder(tmp_path / "in", NAMES[:1])
    (folder / "broken.cwa").write_bytes(b"MD" + bytes(1000))
    table = accelcal.study(folder, tmp_path / "out", jobs=1, progress=True, report_only=True)
    assert sorted(table["outcome"]) == ["calibrated", "failed"]
    said = capsys.readouterr().err
    assert "failed=1" in said and "%" in said
    accelcal.study(folder, tmp_path / "out", jobs=1, report_only=True, retry_failed=True)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"borrow": True, "include": ["*.raw"], "exclude": ["south/*"]},
         ["--borrow", "--include", "*.raw", "--exclude", "south/*"]),
        ({"keep_refused": True, "report_only": False}, ["--keep-refused"]),
        ({"include": "*.raw", "exclude": "south/*"}, ["--include", "*.raw", "--exclude", "south/*"]),
        ({"pool": True, "model": "6"}, ["--pool", "device", "--model", 6]),
        ({"prior": "study", "newer_than": datetime(2020, 1, 2)},
         ["--prior", "study", "--newer-than", "2020-01-02"]),
        ({"timeout": 5.0, "jobs": 2, "html": True}, ["--timeout", 5, "--html"]),
    ],
)  # fmt: skip
def test_p10_options_of_a_study_are_those_of_the_command(
    options: dict[str, Any], words: list[object], tmp_path: Path, capsys: Capture
) -> None:
    folder = study_folder(tmp_path / "in")
    write_raw(folder / "few.raw", still_counts(directions(1)))
    only = [] if options.get("report_only") is False else ["--report-only"]
    accelcal.study([folder], tmp_path / "out", **{"jobs": 1, "report_only": True, **options})
    run(capsys, "study", folder, "-d", tmp_path / "command", "-j", 1, *only, "-q", *words)
    made, told = results(tmp_path / "out"), results(tmp_path / "command")
    assert made.keys() == told.keys() and ("study.html" in made) == ("html" in options)
    assert {name for name in made if made[name] != told[name]} <= {name for name in made if "html" in name}


def test_parts_of_a_study_are_collected(tmp_path: Path, expected: Expected) -> None:
    source, out, log = expected[0] / "in", tmp_path / "out", tmp_path / "night.log"
    assert accelcal.study(source, out, jobs=1, shard="1/2")["path"].tolist() == ["north/b.raw"]
    with pytest.warns(UserWarning, match="1 recording not started"):
        accelcal.study(source, out, jobs=1, collect=True)
    accelcal.study(source, out, jobs=1, shard="2/2")
    accelcal.study(source, out, jobs=1, collect=True, log=log)
    made, told = results(out), expected[1]
    assert all(made[name] == held for name, held in told.items() if name.startswith("north"))
    story = [line.partition("] ")[2] for line in log.read_text().splitlines()]
    assert story[0].startswith("begins: accelcal ") and story[0].endswith(": accelcal.study")
    assert story[-2:] == ['outcomes: {"calibrated": 2}; unchanged: 2', "ends with exit code 0"]
    for name, value in {"collect": True, "prune": True, "html": True, "decisions": "d.csv"}.items():
        said = rf"shard processes one part, {name}\b.* is for the whole study; give (one of|it to collect=T)"
        with pytest.raises(accelcal.AccelcalError, match=said):
            accelcal.study(source, out, shard="1/2", **{name: value})  # type: ignore[arg-type]


def test_draws_and_raw_data_of_refused_recordings_are_written(tmp_path: Path, capsys: Capture) -> None:
    for name, draws, error in (("recording.bin", 7, 10.0), ("night.h5", 8, 0.001)):
        path, options = ROOT / "sample_data" / name, {"strict": True, "max_error": error}
        accelcal.calibrate(path, draws=draws, keep_refused=True, **options).write(tmp_path / "python")  # type: ignore[arg-type]
        words = ("--draws", draws, "--keep-refused", "--strict", "--max-error", error, "-q")
        run(capsys, "calibrate", path, "-d", tmp_path / "command", *words)
    assert (made := results(tmp_path / "python")) == results(tmp_path / "command")
    assert {"recording.draws.json", "night.uncalibrated.parquet"} <= made.keys()
    for value, said in ((-1, "draws cannot be -1"), (7, "draws needs a prior: .*; omit draws")):
        with pytest.raises(accelcal.AccelcalError, match=said):
            accelcal.calibrate(path, draws=value, prior="none")


@pytest.fixture(scope="module")
def result() -> accelcal.Result:
    return accelcal.calibrate(ROOT / "sample_data/recording.bin")


@pytest.mark.parametrize("form", ["ggir", "biobank", "omconvert", "json"])
def test_p7_coefficients_are_exported_as_by_the_command(
    form: Any, result: accelcal.Result, tmp_path: Path, capsys: Capture
) -> None:
    _, report = result.write(tmp_path)
    told = run(capsys, "export", report, "--to", form, "-q").out
    noted = nullcontext() if form == "json" else pytest.warns(UserWarning, match="temperature is left out")
    with noted:
        assert accelcal.export(report, to=form) == told
        made = accelcal.export([result], to=form, output=tmp_path / "made")
    assert (tmp_path / "made").read_text() == made
    if form != "json":
        assert made == told
    with pytest.raises(accelcal.AccelcalError, match="is there already; use force=True"):
        accelcal.export(report, to=form, output=tmp_path / "made")


def test_p7_data_are_exported_as_by_the_command(
    result: accelcal.Result, tmp_path: Path, capsys: Capture
) -> None:
    parquet, _ = result.write(tmp_path)
    assert accelcal.export(result, to="csv", output=tmp_path / "a.csv", smooth="auto", resample=10)
    words = ("--to", "csv", "-o", tmp_path / "b.csv", "--smooth", "auto", "--resample", 10, "-q")
    run(capsys, "export", parquet, *words)
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    with pytest.raises(accelcal.AccelcalError, match="output=FILE, or folder=DIR"):
        accelcal.export(result, to="csv")


@pytest.mark.parametrize(("options", "kind", "text"), [
    ({"to": "cvs"}, accelcal.AccelcalError, "there is no form 'cvs'; did you mean 'csv'"),
    ({"to": "omconvert", "folder": "made"}, accelcal.AccelcalError, "to='omconvert' writes no folder"),
    ({"to": "ggir", "resample": 10}, accelcal.AccelcalError, "resample is for data"),
    ({"to": "ggir", "gzip": True}, accelcal.AccelcalError, "gzip=True is for a folder of recordings"),
    ({"to": "csv", "output": "a", "folder": "made"}, accelcal.AccelcalError, "give one of them"),
    ({"to": "csv", "output": "a"}, accelcal.AccelcalError, "to='csv' needs calibrated data; give .*parquet"),
    ({"to": "csv", "folder": "made", "jobs": 0}, accelcal.AccelcalError, "jobs cannot be 0"),
    ({"to": "csv", "output": "a", "smooth": 2.5}, TypeError, "smooth cannot be 2.5"),
])  # fmt: skip
def test_an_export_that_cannot_be_is_refused_as_by_the_command(
    options: Any, kind: type[Exception], text: str, result: accelcal.Result, tmp_path: Path
) -> None:
    _, report = result.write(tmp_path)
    with pytest.raises(kind, match=text):
        accelcal.export(report, **options)
    report.write_text("{}")
    with pytest.raises(accelcal.AccelcalError, match=r"recording\.calibration\.json.*use force=True"):
        result.write(tmp_path)


def test_p3_a_study_is_exported_as_by_the_command(tmp_path: Path, capsys: Capture) -> None:
    folder = study_folder(tmp_path / "in", NAMES[:2])
    write_raw(folder / "few.raw", still_counts(directions(1)))
    accelcal.study(folder, tmp_path / "out", jobs=1)
    with pytest.warns(UserWarning, match="few.*skipped"):
        accelcal.export(tmp_path / "out", to="ggir", folder=tmp_path / "made", gzip=True, jobs=1)
    run(capsys, "export", tmp_path / "out", "--to", "ggir", "-d", tmp_path / "told", "--gzip", "-q")
    made, told = results(tmp_path / "made"), results(tmp_path / "told")
    assert made.keys() == told.keys() and len(made) >= 4
    assert all(made[name] == told[name] for name in made if not name.endswith(".R"))
    with pytest.warns(UserWarning, match="few.*skipped"):
        table = accelcal.export(tmp_path / "out", to="ggir")
    assert table == run(capsys, "export", tmp_path / "out", "--to", "ggir", "-q").out


def test_p7_pages_are_those_of_the_command(result: accelcal.Result, tmp_path: Path, capsys: Capture) -> None:
    _, path = result.write(tmp_path)
    run(capsys, "report", path, "-q")
    page = (tmp_path / "recording.html").read_text()
    assert accelcal.report(path, tmp_path / "own.html").read_text() == page
    stamp = next(line for line in page.splitlines(keepends=True) if "accelcal-made-of" in line)

    def without_command(text: str) -> list[str]:
        own = ("accelcal.", "python", "<dt>time<")
        return [line for line in text.splitlines() if not any(word in line.lower() for word in own)]

    assert without_command(result.to_html()) == without_command(page.replace(stamp, ""))
    assert accelcal.report(result, tmp_path / "r.html").exists()
    with pytest.raises(accelcal.AccelcalError, match="needs a name"):
        accelcal.report(result)
    (tmp_path / "mine.html").write_text("<p>mine</p>")
    with pytest.raises(accelcal.AccelcalError):
        result.to_html(tmp_path / "mine.html")


def test_p7_a_simulated_recording_is_that_of_the_command(tmp_path: Path, capsys: Capture) -> None:
    options: dict[str, Any] = {"days": 0.02, "rate": 50, "seed": 3, "temp_slope": (0.0, 0.0, 1.0)}
    path, truth = accelcal.simulate(tmp_path / "a", format="cwa", **options)
    words = ("--days", 0.02, "--rate", 50, "--seed", 3, "--temp-slope", 0, 0, 1)
    run(capsys, "simulate", tmp_path / "b", "--format", "cwa", *words, "-q")
    assert path.read_bytes() == (tmp_path / "b.cwa").read_bytes()
    assert truth == json.loads((tmp_path / "b.truth.json").read_text())
    for wrong in ({"days": -1}, {"rate": 1e9}, {"seed": -1}, {"format": "doc"}):
        with pytest.raises(accelcal.AccelcalError):
            accelcal.simulate(tmp_path / "c", **wrong)


def test_p12_temperatures_that_are_not_there(result: accelcal.Result) -> None:
    found = result.calibration
    xyz = np.array([[0.0, 0.1, 1.0], [0.5, 0.5, 0.5], [1.0, 0.0, 0.0]])
    whole = accelcal.apply(result, xyz, [20.0, 21.0, 22.0])
    for missing in (np.nan, np.inf, 1e30):
        made = accelcal.apply(result, xyz, [20.0, missing, 22.0])
        assert np.isnan(made[1]).all() and (made[[0, 2]] == whole[[0, 2]]).all()
    assert (found(xyz[1], 21.0) == whole[1]).all() and found(xyz[1], 21.0).shape == (3,)
    assert (found(xyz, 21) == accelcal.apply(result, xyz, [21.0] * 3)).all()
    assert found(np.zeros((0, 3)), []).shape == (0, 3)
    plain = accelcal.calibrate(ROOT / "sample_data/recording.bin", no_temperature=True, report_only=True)
    assert np.isfinite(plain.calibration(xyz, [np.nan] * 3)).all()
    assert plain.calibration.reference_temperature is None
    for wrong in (xyz.T[:, :2], xyz[0, :2], xyz[np.newaxis], 1.0):
        with pytest.raises(ValueError, match="not"):
            found(wrong, 20)
    with pytest.raises(ValueError, match="temperature has the shape"):
        found(xyz, [20.0, 21.0])


def test_p7_a_result_shows_itself(result: accelcal.Result) -> None:
    text = repr(result)
    assert text.count("\n") == 4 and max(map(len, text.splitlines())) < 180
    assert "recording.bin: calibrated" in text and f"{result.calibration_error_mg:.2g}" in text
    html = result._repr_html_()
    assert "<svg" in html and "Good" in html and len(html) < 30_000
    assert "recording.bin" in html and "{{" not in html and "<html" not in html
    assert result.calibration.gain.shape == (3, 3)
    assert result.calibration.offset.tolist() == result["calibration"]["offset_g"]
    assert result.calibration.slope.tolist() == result["calibration"]["temperature"]["slope_g_per_c"]
    assert result.summary()["outcome"] == "calibrated" and result.summary()["path"] == "recording.bin"
    assert repr(result.calibration).count("gain") == 3
    again = accelcal.Calibration(result.report)
    assert (again.gain == result.calibration.gain).all()


def test_p7_a_refusal_shows_itself() -> None:
    still = accelcal.calibrate(np.tile([0.0, 0.0, 1.0], (5000, 1)), rate=50)
    assert not still.usable and "refused" in repr(still) and repr(still).count("\n") == 4
    assert "Refused" in still._repr_html_() and "Refused" in still.to_html()
    with pytest.raises(accelcal.AccelcalError, match="nothing to apply"):
        _ = still.calibration
    points = accelcal.fit(np.eye(3)[:1])
    assert "refused" in repr(points) and "Refused" in points._repr_html_()
    assert points.summary()["outcome"] == "refused"


def test_p7_values_in_the_forms_of_other_libraries(result: accelcal.Result) -> None:
    pandas, polars, arrow = result.to_pandas(), result.to_polars(), result.to_arrow()
    assert (polars["x"].to_numpy() == pandas["x"].to_numpy()).all() and polars.columns == arrow.column_names
    xarray = pytest.importorskip("xarray")
    made = result.to_xarray()
    assert isinstance(made, xarray.Dataset) and made["x"].attrs["units"] == "g"
    assert (made["x"].to_numpy() == pandas["x"].to_numpy()).all()


def test_p7_a_plot_says_verdict_limit_and_zone() -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    axes = accelcal.calibrate(ROOT / "sample_data/evening.csv.gz", timezone="Europe/Berlin").plot()
    assert "evening.csv.gz: Good" in axes.get_title() and "Europe/Berlin" in axes.get_xlabel()
    assert "1 g ± 10 mg" in [text.get_text() for text in axes.get_legend().get_texts()]


FIRST_LINES: dict[str, str | None] = {
    'accelcal.read("sample_data/recording.bin")': None,
    'accelcal.read("sample_data/recording.bin").to_pandas()': None,
    'accelcal.read_cwa("x.cwa")': r'type accelcal.read\("recording.cwa"\)',
    'accelcal.process("x.cwa")': r'type accelcal.calibrate\("recording.cwa"\)',
    'accelcal.calibrate("sample_data/recording.bin")': None,
    "accelcal.calibrate(df)": None,
    "accelcal.calibrate(xyz, fs=25)": "did you mean 'rate'?",
    "accelcal.calibrate(xyz, 25)": "the others have names, such as rate=",
    "result.data": r"type result.to_pandas\(\)",
    "data, info = result": r"one object: use .to_pandas\(\) and .report",
    "result.calibration.transform(xyz)": r"type result.calibration\(xyz, temperature\)",
    'accelcal.read("sample_data/recording.bin").data': r"a Reading has no attribute 'data'; type result.to_p",
    "result.coef_": "type result.calibration.gain, .offset and .slope",
    "accelcal.Calibration().fit(xyz).transform(xyz)": r"accelcal.calibrate\(xyz, rate=100\).calibration",
    "accelcal.CalibrateAccelerometer()": r'accelcal.calibrate\("recording.cwa"\).calibration',
    "accelcal.fit(xyz)": r"raw samples, .*accelcal.calibrate\(xyz, rate=HZ\)",
    'accelcal.load("x.json")': r'accelcal.Report\("recording.calibration.json"\)',
    'accelcal.calibrate("nope.cwa")': "check the path",
    "accelcal.calibrat(xyz)": "did you mean 'calibrate'",
    "result.to_csv('x.csv')": "type result.write",
    "accelcal.plot(result)": r"\.plot\(\)",
    "accelcal.processing.calibrate_gravity(df)": r'type accelcal.calibrate\("recording.cwa"\).to_pandas\(\)',
    "accelcal.calibrate(time=df.index, accel=xyz)": "did you mean 'source'?",
    'accelcal.calibrate({"time": df.index.to_numpy(), "accel": xyz})': None,
    "df.pipe(accelcal.calibrate)": None,
    'accelcal.calibrate(xyz, rate=25, outdir="x")': r"a result writes its files: .write\(FOLDER\)",
    "accelcal.calibrate(xyz, rate=25, n_jobs=2)": r"accelcal.study\(FOLDER, OUT, jobs=\)",
    'accelcal.calibrate("sample_data")': r"accelcal.study\('sample_data', 'OUT'\)",
    "accelcal.GGIR(df)": r"type accelcal.export\(RESULTS, to=...",
    "result.get_params()": "type result.calibration.gain",
    "result.enmo": r"type result.epochs\(seconds=5\)",
    "__import__('numpy').asarray(result)": r'use .to_pandas\(\)\[\["x", "y", "z"\]\].to_numpy\(\)',
}
"""Lines that users of pandas, scikit-learn, actipy and skdh type first, and the answer to those that fail."""


@pytest.mark.parametrize("line", FIRST_LINES)
def test_p6_the_first_lines_of_a_user_work_or_are_answered(
    line: str, result: accelcal.Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    xyz = still_counts(directions(10)) / LSB_PER_G
    df = pd.DataFrame(xyz, columns=[*"xyz"], index=pd.date_range("2024-03-04", periods=len(xyz), freq="40ms"))
    names = {"accelcal": accelcal, "result": result, "xyz": xyz, "df": df}
    answer = FIRST_LINES[line]
    call: Callable[[], None] = lambda: exec(line, names)  # noqa: E731
    if answer is None:
        call()
    else:
        with pytest.raises((AttributeError, TypeError, accelcal.AccelcalError), match=answer):
            call()


TABLE = pd.DataFrame({"time": [1.0], "x": [0.0], "y": [0.0], "z": [1.0]})


@pytest.mark.parametrize("given", [TABLE, [TABLE], np.zeros((3, 3)), {"x": [1.0]}, 3])
@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda given: accelcal.study(given, "out"), r"one by one: accelcal\.calibrate\(frame\)"),
        (lambda given: accelcal.export(given, to="ggir"), "give results, or the output folder of a study"),
        (accelcal.from_poses, r'frame\.to_parquet\("session\.parquet"\)'),
        (accelcal.report, "calibrate it, and give the result"),
    ],
)
def test_what_is_in_memory_is_not_a_path(given: Any, call: Callable[[Any], Any], said: str) -> None:
    with pytest.raises(TypeError, match=f"a path is needed, not .*: .*{said}"):
        call(given)


def test_a_list_is_not_one_path() -> None:
    calls: list[Any] = [accelcal.verify, accelcal.report, lambda one: accelcal.study("in", one)]
    for call in calls:
        with pytest.raises(TypeError, match=r"a path is needed, not 'list': .*"):
            call(["a", "b"])
    with pytest.raises(accelcal.AccelcalError, match="there is no path in an empty list; give one or more"):
        accelcal.study([], "out")


def test_files_are_calibrated_by_the_call_that_the_error_gives(tmp_path: Path) -> None:
    folder, other = study_folder(tmp_path / "in", NAMES[:2]) / "north", tmp_path / "other"
    other.mkdir()
    write_raw(other / "c[1].raw", still_counts(directions(60), seed=9))
    both = sorted(folder.glob("*.raw"))
    for number, (files, found) in enumerate([
        (both, ["a.raw", "b.raw"]), (pd.Series(map(str, both)), ["a.raw", "b.raw"]), (both[0], ["a.raw"]),
        ([both[0], other / "c[1].raw"], ["north/a.raw", "other/c[1].raw"]),
        ([both[0], other], ["north/a.raw", "north/b.raw", "other/c[1].raw"]),
    ]):  # fmt: skip
        with pytest.raises(accelcal.AccelcalError, match="is a file: a study is of a folder") as raised:
            accelcal.study(files, tmp_path / str(number), jobs=1)
        call = str(raised.value.hint).removesuffix(")") + ", jobs=1, report_only=True)"
        table = eval(call, {"accelcal": accelcal})
        assert table["path"].tolist() == found and table["start_time"].dtype == "datetime64[us]"
        assert table["start_time"][0] == pd.Timestamp("2024-03-04")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"pool": ThreadPoolExecutor(1)}, "pool is True or False.*did you mean executor="),
        ({"retry_failed": "yes"}, "retry_failed is True or False, not 'yes'"),
        ({"executor": 4}, "executor is a concurrent.futures.Executor"),
        ({"jobs": "4"}, "jobs cannot be '4'"),
        ({"n_jobs": 3}, "did you mean 'jobs'"),
        ({"prior": "device", "pool": True}, "prior='device' does not go with pool=True"),
    ],
)
def test_options_are_checked_before_anything_is_computed(options: Any, said: str, tmp_path: Path) -> None:
    with pytest.raises((TypeError, accelcal.AccelcalError), match=said):
        accelcal.study(study_folder(tmp_path / "in", NAMES[:1]), tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["recording.bin", "evening.csv.gz", "night.h5"])
def test_reports_are_read_again_and_quality_is_a_frame(name: str, tmp_path: Path) -> None:
    result = accelcal.calibrate(ROOT / "sample_data" / name, report_only=True)
    _, path = result.write(tmp_path)
    for given in (path, str(path)):
        again = accelcal.Report(given)
        assert again["calibration"] == result["calibration"] and again.quality_frame() is None
    rows, frame = (result.quality() or {})["rows"], result.quality_frame()
    assert frame is not None and frame.index[0] == pd.Timestamp(rows["start"][0][:26])
    assert frame["samples"].tolist() == rows["samples"]
    assert frame["before_mg.p95"].tolist() == rows["before_mg"]["p95"]


@pytest.mark.parametrize("name", ["recording.bin", "evening.csv.gz", "night.h5"])
def test_a_report_is_verified_as_by_the_command(name: str, tmp_path: Path, capsys: Capture) -> None:
    path = ROOT / "sample_data" / name
    _, report = accelcal.calibrate(path).write(tmp_path)
    found = accelcal.verify(report, path, values=True)
    assert {found["result"], found["parquet"]["values"]} == {"identical"} and found["largest_mg"] == 0
    assert found == json.loads(run(capsys, "verify", report, path, "--values", "--json").out)
    content = json.loads(report.read_text("utf-8"))
    content["calibration"]["offset_g"][0] += 0.001
    report.write_text(json.dumps(content), "utf-8")
    changed = accelcal.verify(report, path)
    assert (changed["result"], changed["differs"]) == ("differs", ["calibration.offset_g[0]"])
    with pytest.raises(TypeError, match=r"write the result first: result\.write\(FOLDER\)"):
        accelcal.verify(accelcal.Report(report))  # type: ignore[arg-type]


def test_devices_are_judged_as_by_the_command(tmp_path: Path, capsys: Capture) -> None:
    folder = study_folder(tmp_path / "in", NAMES[:2])
    accelcal.study([folder], tmp_path / "out", jobs=1, report_only=True)
    found = accelcal.devices(tmp_path / "out", rules={"drift_mg": 2}, registry=tmp_path / "all.json")
    told = run(capsys, "devices", tmp_path / "out", "--rule", "drift_mg=2", "--json", "-q").out
    assert found == json.loads(told)
    assert found["rules"]["drift_mg"] == 2 and (tmp_path / "all.json").exists()
    assert found["recordings"] == 2 and len(pd.DataFrame(found["devices"])) == len(found["devices"])
    for options, said in (
        ({"device": "nobody"}, "no recording of device nobody"),
        ({"rules": {"drift": 2}}, "no rule 'drift'; possible: .*drift_mg"),
        ({"rules": {"drift_mg": 0}}, r"rules\['drift_mg'\] cannot be 0"),
    ):
        with pytest.raises(accelcal.AccelcalError, match=said):
            accelcal.devices(tmp_path / "out", registry=tmp_path / "new.json", **options)  # type: ignore[arg-type]
    with pytest.raises(accelcal.AccelcalError, match=r"is a file.*given to accelcal\.study$"):
        accelcal.devices(tmp_path / "all.json", registry=tmp_path / "new.json")
    assert not (tmp_path / "new.json").exists()


def test_a_dry_run_says_what_a_study_would_do_and_writes_nothing(tmp_path: Path) -> None:
    folder = study_folder(tmp_path / "in", NAMES[:2])
    (folder / "notes.pdf").write_bytes(b"%PDF")
    out = tmp_path / "out"
    foreseen = accelcal.study(folder, out, jobs=1, report_only=True, dry_run=True)
    assert not out.exists() and set(foreseen["state"]) == {"todo", "left_out"}
    table = accelcal.study(folder, out, jobs=1, report_only=True)
    again = accelcal.study(folder, out, jobs=1, report_only=True, dry_run=True)
    assert dict(zip(again["path"], again["state"], strict=True)) == {
        **dict(zip(table["path"], table["outcome"], strict=True)),
        **dict.fromkeys(("notes.pdf", "readme.txt"), "left_out"),
    }
    other = accelcal.study(folder, out, jobs=1, report_only=True, model="6", dry_run=True)
    assert other.loc[other["state"] == "todo", "why"].tolist() == ["model"] * 2
    (folder / "north/a.raw").unlink()
    with pytest.warns(UserWarning, match="prune=True removes it"):
        accelcal.study(folder, out, jobs=1, report_only=True)
    accelcal.study(folder, out, jobs=1, report_only=True, prune=True)
    assert sorted(one.name for one in out.rglob("*.calibration.json")) == ["b.calibration.json"]
