"""What is left of recordings that are gone, renamed or replaced; and what of accelcal's own is believed."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import tempfile
import time
from pathlib import Path
from typing import Any

import pytest

from accelcal_cli.core.errors import spreadsheet_cell
from accelcal_cli.core.system import folder_start, new_folder
from accelcal_cli.studies import executors
from tests.cli.run import run
from tests.cli.studies import rows, study, study_folder
from tests.recordings import directions, good_csv, still_counts

NAMES = ("a.raw", "north/b.raw", "north/c.raw")


def told(out: Path) -> dict[str, str]:
    found = json.loads((out / "study.json").read_text())["orphans"]
    return {one["report"]: one["code"] for one in found}


def test_u3_results_whose_recording_is_gone_are_listed_and_pruned(tmp_path: Path) -> None:
    folder, out = study_folder(tmp_path / "in", NAMES), tmp_path / "out"
    assert study(folder).code == 0
    (folder / "a.raw").unlink()
    (folder / "north/b.raw").rename(folder / "north/d.raw")
    (folder / "north/b.layout.toml").rename(folder / "north/d.layout.toml")
    assert "now called north/d.raw" in study(folder, "--dry-run").err
    gone = {"a.calibration.json": "recording_gone", "north/b.calibration.json": "recording_renamed"}
    for _ in range(2):
        ran = study(folder)
        assert (ran.code, told(out)) == (0, gone)
        assert "a.calibration.json stays" in ran.err and "now called north/d.raw" in ran.err
    assert "orphan" not in study(folder, "-q").err
    shown = study(folder, "--prune", "--dry-run")
    assert "would be removed" in shown.err and (out / "a.calibrated.parquet").exists()
    ran = study(folder, "--prune")
    assert ran.code == 0 and "a.calibration.json removed" in ran.err
    left = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    assert not [name for name in left if name.startswith(("a.", "north/b."))]
    assert {"north/c.calibration.json", "north/d.calibrated.parquet"} <= left
    assert told(out) == {}


def test_u3_nothing_is_pruned_that_may_be_there(tmp_path: Path) -> None:
    """Not what is excluded, nor of a recording elsewhere, nor most of a study, as when a disk is missing."""
    folder, out = study_folder(tmp_path / "in", NAMES), tmp_path / "out"
    assert study(folder).code == 0
    assert run("calibrate", good_csv(tmp_path), "-d", out).code == 0
    assert study(folder, "--exclude", "north/*", "--prune").code == 0
    assert (told(out), len(list(out.rglob("*.calibration.json")))) == ({}, 4)
    shutil.rmtree(folder / "north")
    ran = study(folder, "--prune")
    assert ran.code == 2 and "2 results" in ran.err
    assert len(list(out.rglob("*.calibration.json"))) == 4
    assert study(folder, "--prune", "--force").code == 0
    assert len(list(out.rglob("*.calibration.json"))) == 2


def test_results_of_recordings_on_a_disk_that_is_away_stay(tmp_path: Path) -> None:
    """Its folder is there and empty, as before a disk is mounted; or a link to it leads nowhere."""
    folder, out = study_folder(tmp_path / "in", (*NAMES, "d.raw")), tmp_path / "out"
    assert study(folder).code == 0
    (folder / "north").rename(tmp_path / "away")
    nowhere = tmp_path / "nowhere"
    for make, remove in ((Path.mkdir, Path.rmdir), (lambda path: path.symlink_to(nowhere), Path.unlink)):
        make(folder / "north")
        assert study(folder, "--prune", "--force").code in (0, 1)
        assert len(list(out.rglob("*.calibration.json"))) == 4 and told(out) == {}
        remove(folder / "north")
    assert study(folder, "--prune").code == 0
    assert len(list(out.rglob("*.calibration.json"))) == 2


def test_results_of_another_study_below_the_outputs_stay(tmp_path: Path) -> None:
    """Also where its recordings are away."""
    folder, out = study_folder(tmp_path / "in", NAMES), tmp_path / "out"
    other = study_folder(tmp_path / "other", ("x.raw",))
    assert run("study", other, "-d", out / "other", "-j", 1).code == 0
    (other / "x.raw").unlink()
    (other / "notes.txt").write_text("moved\n")
    assert study(folder, "--prune").code == 0
    assert (out / "other/x.calibration.json").exists() and told(out) == {}


def test_a_recording_is_where_its_path_was_typed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, out = study_folder(tmp_path / "in", NAMES), tmp_path / "out"
    monkeypatch.chdir(folder / "north")
    assert run("calibrate", "b.raw", "-o", out / "mine.calibrated.parquet").code == 0
    monkeypatch.chdir(folder)
    assert study(folder, "--prune").code == 0
    assert (out / "mine.calibration.json").exists() and told(out) == {}


def test_a_recording_whose_name_the_report_cannot_show_is_not_taken_for_gone(tmp_path: Path) -> None:
    folder, out = study_folder(tmp_path / "in", NAMES), tmp_path / "out"
    odd = good_csv(tmp_path).rename(folder / "odd\x1b.csv")
    assert run("calibrate", odd, "-o", out / "mine.calibrated.parquet").code == 0
    assert study(folder, "--exclude", "odd*", "--prune").code == 0
    assert (out / "mine.calibration.json").exists() and told(out) == {}


def test_too_much_to_prune_is_refused_before_the_work_begins(tmp_path: Path) -> None:
    folder, out = study_folder(tmp_path / "in", NAMES), tmp_path / "out"
    assert study(folder).code == 0
    shutil.rmtree(folder / "north")
    (folder / "a.raw").write_bytes(still_counts(directions(61), seed=7).astype("<i2").tobytes())
    table = (out / "study.csv").read_bytes()
    for words in ((), ("--dry-run",)):
        ran = study(folder, "--prune", *words)
        assert (ran.code, ran.out) == (2, "") and "--force" in ran.err
    assert (out / "study.csv").read_bytes() == table


@pytest.mark.parametrize("content", ["other", "same"])
def test_u4_a_recording_that_was_replaced_replaces_its_outputs(content: str, tmp_path: Path) -> None:
    folder, out = study_folder(tmp_path / "in", ("a.raw", "b.raw")), tmp_path / "out"
    assert study(folder).code == 0
    old = (folder / "a.raw").read_bytes()
    (folder / "a.raw").unlink()
    counts = still_counts(directions(70), seed=9).astype("<i2").tobytes()
    (folder / "a.bin").write_bytes(old if content == "same" else counts)
    for _ in range(2):
        study(folder, code=0)
        assert [row["path"] for row in rows(out)] == ["a.bin", "b.raw"]
        assert told(out) == {}
    held = json.loads((out / "a.calibration.json").read_text())
    assert held["recording"]["path"] == "a.bin"
    assert held["recording"]["bytes"] == (folder / "a.bin").stat().st_size


def test_u1_own_results_are_not_recordings(tmp_path: Path) -> None:
    good_csv(tmp_path)
    for _ in range(2):
        named = sorted(path for path in tmp_path.iterdir() if path.is_file())
        assert len(run("calibrate", *named, "--html", code=0).lines) == 1
        shown = run("inspect", *sorted(path for path in tmp_path.iterdir() if path.is_file()))
        assert shown.code == 0 and "results of accelcal are not recordings" in shown.err
    ours = sorted(tmp_path.glob("*.c*.*"))
    assert run("calibrate", *[one for one in ours if "calibrat" in one.name]).code == 2


@pytest.mark.parametrize("sign", ["=", "@", "\uff1d", "\uff20", "\uff0b", "\uff0d"])
def test_h10_full_width_signs_begin_no_formula(sign: str) -> None:
    assert spreadsheet_cell(f"{sign}1+1") == f"'{sign}1+1"
    assert re.match(r"\w", spreadsheet_cell("a=1"))


def test_h9_a_report_with_a_name_twice_is_refused(tmp_path: Path) -> None:
    assert run("calibrate", good_csv(tmp_path)).code == 0
    report = next(tmp_path.glob("*.calibration.json"))
    report.write_text(report.read_text().replace('"outcome":', '"outcome": "refused", "outcome":', 1))
    ran = run("verify", report)
    assert (ran.code, ran.err.count("\n")) == (3, 1), ran.err


@pytest.mark.parametrize("words", [("--rate", "0.01"), ("--days", "1e9"), ("--rate", "1e-300")])
def test_h15_simulations_that_cannot_be_are_refused(words: tuple[str, ...], tmp_path: Path) -> None:
    ran = run("simulate", tmp_path / "a.csv", "--format", "csv", *words)
    assert ran.code == 2 and "bug" not in ran.err
    assert run("simulate", tmp_path / ("n" * 300), "--days", "0.001").code == 5


def killed_while_unpacking(task: Any, _report: Any) -> None:
    """Work that makes a temporary folder and hears no signal, as within a library."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    new_folder()
    time.sleep(600)


def test_h16_the_folder_of_a_stopped_worker_goes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(executors, "GRACE_S", 0.1)
    before = {path.name for path in Path(tempfile.gettempdir()).glob("accelcal-*")}
    pool = executors.ProcessPool(killed_while_unpacking, 1, timeout_s=2.0)
    (ended,) = pool.run([1])
    assert "was stopped" in str(ended.fault)
    left = {path.name for path in Path(tempfile.gettempdir()).glob("accelcal-*")} - before
    assert not [name for name in left if not name.startswith(f"{folder_start()}{os.getpid()}-")]
