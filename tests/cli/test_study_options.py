"""What `study` takes from `calibrate`: how far damage may go, and the grid of the values."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import pytest

from tests.cli.run import assert_one_line, run
from tests.cli.studies import NAMES, rows, study, study_folder


def test_the_grid_of_the_values_is_that_of_calibrate(tmp_path: Path) -> None:
    folder, out = study_folder(tmp_path / "in", NAMES[:1]), tmp_path / "out"
    words = ("--precision", 0.25)
    assert run("calibrate", folder / NAMES[0], "-d", tmp_path / "one", *words).code == 0
    assert study(folder).code == 0
    exact = (out / "north/a.calibrated.parquet").read_bytes()
    assert "unchanged" not in study(folder, *words).err
    coarse = (out / "north/a.calibrated.parquet").read_bytes()
    assert coarse == (tmp_path / "one/a.calibrated.parquet").read_bytes()
    assert len(coarse) < 0.8 * len(exact)
    assert "1 unchanged" in study(folder, *words).err


def test_what_damage_took_too_much_of_is_refused(tmp_path: Path) -> None:
    folder, out = study_folder(tmp_path / "in", NAMES[:1]), tmp_path / "out"
    path = folder / NAMES[0]
    path.write_bytes(path.read_bytes()[:-1])
    assert study(folder).code == 0
    assert float(rows(out)[0]["lost_percent"]) > 0
    assert study(folder, "-R", "max_damage=0").code == 4
    assert rows(out)[0]["reason"] == "damaged"
    assert not (out / "north/a.calibrated.parquet").exists()


@pytest.mark.parametrize(
    "words",
    [
        ("--newer-than", "0001-01-01"),
        ("--optimizer", "newton"),
        ("--optimizer", "\udcff"),
        ("--sensor", "\udcff"),
        ("-R", "time_column=t\udcff"),
        ("--columns", "x,y,\udcff"),
    ],
)
def test_words_that_cannot_be_are_wrong_usage(tmp_path: Path, words: tuple[str, str]) -> None:
    ran = study(study_folder(tmp_path / "in", NAMES[:1]), *words)
    assert (ran.code, ran.out) == (2, "")
    assert_one_line(ran)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["out", "out/below"])
def test_a_dry_run_says_what_the_run_would_and_as_it_would(tmp_path: Path, name: str) -> None:
    folder = study_folder(tmp_path / "in", NAMES[:1])
    told = study(folder, "--dry-run", "--json")
    todo, left_out = map(json.loads, told.lines)
    assert todo == {"path": str(folder / NAMES[0]), "state": "todo"}
    assert (left_out["path"], left_out["state"], left_out["code"]) == ("readme.txt", "left_out", "no_numbers")
    quiet = study(folder, "--dry-run", "-q")
    assert (quiet.code, quiet.out, quiet.err) == (0, "", "")
    (tmp_path / "out").write_text("a file")
    for words in ([], ["--dry-run"]):
        ran = run("study", folder, "-d", tmp_path / name, *words)
        assert (ran.code, ran.out) == (5, "")
        assert_one_line(ran, "cannot be made")


def test_a_part_may_have_nothing_to_do(tmp_path: Path) -> None:
    folder = study_folder(tmp_path / "in", NAMES[:1])
    (folder / "readme.txt").unlink()
    said = {study(folder, "--shard", f"{part}/2").err.split(". Results")[0] for part in (1, 2)}
    assert said == {"accelcal: 1 recording: 1 calibrated", "accelcal: 0 recordings"}


def test_one_part_does_not_sum_up_all(tmp_path: Path) -> None:
    folder = study_folder(tmp_path / "in", NAMES[:1])
    ran = study(folder, "--shard", "1/2", "--collect")
    assert (ran.code, "give one of them" in ran.err) == (2, True)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("ahead_s", "begun"), [(36_000, True), (1800, False), (-1800, False), (-9000, True)])
def test_a_recording_of_the_future_waits_no_longer(tmp_path: Path, ahead_s: int, begun: bool) -> None:
    folder = study_folder(tmp_path / "in", NAMES[:1])
    when = time.time() + ahead_s
    os.utime(folder / NAMES[0], (when, when))
    ran = study(folder, "--settle", 3600, "-q", "--report-only")
    assert (ran.code, len(rows(tmp_path / "out"))) == (0, int(begun))
    assert ("modified in the future" in ran.err) == (ahead_s == 1800)
