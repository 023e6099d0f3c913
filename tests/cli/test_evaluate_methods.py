"""`accelcal evaluate methods` on the command line."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import pytest

from tests.cli.run import run
from tests.recordings import directions, good_csv, still_counts, write_csv

Capture = pytest.CaptureFixture[str]
METHODS = ("evaluate", "methods")


def test_a_table_for_each_recording_and_the_published_one(tmp_path: Path, capsys: Capture) -> None:
    first, second = good_csv(tmp_path, "a.csv"), good_csv(tmp_path, "b.csv")
    ran = run(capsys, *METHODS, first, second, "--only", "fixed32,ellipsoid")
    assert ran.code == 0
    one, two, _, published = ran.out.split("\n\n")
    assert one.splitlines()[0] == str(first) and two.splitlines()[0] == str(second)
    assert [line.split()[0] for line in one.splitlines()[3:]] == ["fixed32", "ellipsoid"]
    assert "3.06" in published and "820" in published


def test_json_and_csv_hold_the_same_rows(tmp_path: Path, capsys: Capture) -> None:
    path = good_csv(tmp_path)
    said = json.loads(run(capsys, *METHODS, path, "--only", "float64", "--json").out)
    (row,) = said["rows"]
    (read,) = csv.DictReader(io.StringIO(run(capsys, *METHODS, path, "--only", "float64", "--csv").out))
    assert set(read) == set(row)
    assert {k: read[k] for k in ("recording", "optimizer", "model")} == {
        "recording": str(path), "optimizer": "float64", "model": "9",
    }  # fmt: skip
    assert float(read["after_mg"]) == row["after_mg"]
    assert len(said["published"]) == 4


def test_the_mean_over_recordings_is_a_ratio_of_means(tmp_path: Path, capsys: Capture) -> None:
    """As all R of the paper are; a recording that was refused is in neither mean."""
    paths = [good_csv(tmp_path, "a.csv"), write_csv(tmp_path / "b.csv", still_counts(directions(50), 7))]
    paths.append(write_csv(tmp_path / "few.csv", still_counts(directions(4))))
    said = json.loads(run(capsys, *METHODS, *paths, "--only", "gauss-newton", "--json").out)
    one, two, refused = said["rows"]
    assert refused["after_mg"] is None
    (mean,) = said["means"]
    assert mean["recordings"] == 2
    assert mean["before_mg"] == pytest.approx((one["before_mg"] + two["before_mg"]) / 2)
    ratio = (one["before_mg"] + two["before_mg"]) / (one["after_mg"] + two["after_mg"])
    assert mean["improvement_percent"] == pytest.approx(100 * ratio)
    shown = run(capsys, *METHODS, *paths, "--only", "gauss-newton").out
    assert f"{100 * ratio:.0f}" in shown.split("mean over recordings")[1]
    assert json.loads(run(capsys, *METHODS, paths[0], "--only", "float64", "--json").out)["means"] == []


def test_a_refusal_is_a_row_with_its_reason(tmp_path: Path, capsys: Capture) -> None:
    path = write_csv(tmp_path / "few.csv", still_counts(directions(4)))
    ran = run(capsys, *METHODS, path, "--only", "fixed32")
    assert ran.code == 0
    assert "fixed32: refused: stillness in only 4 postures" in ran.out


def test_one_bad_recording_does_not_stop_the_rest(tmp_path: Path, capsys: Capture) -> None:
    path = good_csv(tmp_path)
    ran = run(capsys, *METHODS, tmp_path / "none.csv", path, "--only", "fixed32")
    assert ran.code == 1 and "none.csv" in ran.err and str(path) in ran.out
    assert run(capsys, *METHODS, tmp_path / "none.csv").code == 3


@pytest.mark.parametrize("names", ["nonesuch", "fixed32,nonesuch", " , "])
def test_an_optimizer_that_does_not_exist_is_wrong_usage(tmp_path: Path, capsys: Capture, names: str) -> None:
    assert run(capsys, *METHODS, good_csv(tmp_path), "--only", names).code == 2
