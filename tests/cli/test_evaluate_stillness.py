"""`accelcal evaluate stillness`: text, JSON, CSV, the truth, exit codes."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from accelcal_cli.core.settings import STILLNESS
from tests.cli.run import assert_one_line, run
from tests.recordings import GAIN, OFFSET_G, good_csv, good_raw, worst_errors

Capture = pytest.CaptureFixture[str]


def evaluated(capsys: Capture, *words: object) -> list[dict]:
    ran = run(capsys, "evaluate", "stillness", *words, "--json")
    assert ran.code == 0, ran
    return json.loads(ran.out)["rules"]


def with_truth(folder: Path) -> Path:
    path = good_raw(folder)
    known = {"K": GAIN.tolist(), "b": (-OFFSET_G).tolist()}
    (folder / "good.truth.json").write_text(json.dumps(known))
    return path


def test_figures_are_those_of_calibrate(tmp_path: Path, capsys: Capture) -> None:
    path = with_truth(tmp_path)
    raw, *rows = evaluated(capsys, path)
    assert raw["rule"] == "raw"
    assert [row["rule"] for row in rows] == list(STILLNESS)
    for row in rows:
        words = ("--stillness", row["rule"], "--report-only", "--json", "--force")
        report = json.loads(run(capsys, "calibrate", path, *words).out)
        assert (row["outcome"], row["model"]) == (report["outcome"], report["calibration"]["model"])
        assert row["after_mg"] == report["holdout"]["after_mg"]["mean"]
        assert row["before_mg"] == report["holdout"]["before_mg"]["mean"]
        assert (row["points"], row["windows"]) == (report["fit"]["points"], report["fit"]["windows"]["used"])
        assert row["postures"] == report["fit"]["postures"]
        gain, offset_g = worst_errors(report)
        assert row["gain_error"] == pytest.approx(gain, abs=1e-8)
        assert row["offset_error_mg"] == pytest.approx(1000 * offset_g, abs=1e-4)
        assert row["on_points_of_mg"][row["rule"]] == report["fit"]["after_mg"]


@pytest.mark.nightly
def test_csv_is_one_table_of_all_recordings(tmp_path: Path, capsys: Capture) -> None:
    one, two = good_raw(tmp_path, "one.raw"), good_raw(tmp_path, "two.raw")
    ran = run(capsys, "evaluate", "stillness", one, two, "--csv")
    assert ran.code == 0
    table = list(csv.DictReader(ran.lines))
    assert [(row["recording"], row["rule"]) for row in table] == [
        (str(path), rule) for path in (one, two) for rule in ("raw", *STILLNESS)
    ]
    assert [row["on_range_mg"] for row in table[:5]] == [row["on_range_mg"] for row in table[5:]]
    (both,) = [row for row in evaluated(capsys, one) if row["rule"] == "both"]
    assert float(table[1]["after_mg"]) == both["after_mg"]
    assert float(table[1]["on_range_mg"]) == both["on_points_of_mg"]["range"]
    assert table[0]["after_mg"] == table[1]["gain_error"] == ""


@pytest.mark.nightly
def test_text_shows_the_truth_only_where_it_is_known(tmp_path: Path, capsys: Capture) -> None:
    unknown = run(capsys, "evaluate", "stillness", good_raw(tmp_path))
    known = run(capsys, "evaluate", "stillness", with_truth(tmp_path))
    assert (unknown.code, known.code, known.err) == (0, 0, "")
    assert "gain error" in known.out
    assert "gain error" not in unknown.out
    assert all(unknown.out.count(rule) >= 2 for rule in STILLNESS)


def test_one_unreadable_recording_does_not_stop_the_others(tmp_path: Path, capsys: Capture) -> None:
    missing, good = tmp_path / "missing.csv", good_csv(tmp_path)
    ran = run(capsys, "evaluate", "stillness", missing, good)
    assert ran.code == 1
    assert_one_line(ran, "missing.csv")
    assert str(good) in ran.out
    assert run(capsys, "evaluate", "stillness", missing).code == 3


def test_wrong_usage(tmp_path: Path, capsys: Capture) -> None:
    path = good_csv(tmp_path)
    for words in (
        ("--json", "--csv"),
        ("--stillness", "both"),
        ("--profile", "paper"),
        ("--altitude", 3),
        ("--optimizer", "none"),
    ):
        ran = run(capsys, "evaluate", "stillness", path, *words)
        assert ran.code == 2, ran
    assert run(capsys, "evaluate", "nothing").code == 2
