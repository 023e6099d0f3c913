"""`--stillness`: which rule is used, what the report says of it, and options that mean nothing to it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from accelcal_cli.core.settings import STILLNESS
from tests.cli.run import assert_one_line, run
from tests.recordings import RATE_HZ, SECONDS, good_csv, good_raw, worst_errors
from tests.schema import check_report

NUMBERS = {
    "both": (5.0, 0.12, 0.013, [0, 1, 2]),
    "range": (5.0, 0.12, None, [0]),
    "deviation": (10.0, None, 0.013, []),
    "adaptive": (1.0, None, None, []),
}


def reported(folder: Path, *words: object) -> dict:
    path = folder / "good.raw"
    if not path.exists():
        good_raw(folder)
    ran = run("calibrate", path, "--report-only", "--json", "--force", *words)
    assert ran.code in (0, 4), ran
    report = json.loads(ran.out)
    check_report(report)
    del report["provenance"]
    return report


def numbers(report: dict) -> tuple:
    names = ("segment_seconds", "stillness_threshold_g", "stillness_deviation_g", "stillness_axes")
    return tuple(report["settings"][name] for name in names)


@pytest.mark.parametrize("rule", NUMBERS)
def test_each_rule_calibrates_and_is_in_the_report(tmp_path: Path, rule: str) -> None:
    report = reported(tmp_path, "--stillness", rule)
    assert report["outcome"] == "calibrated"
    gain, offset_g = worst_errors(report)
    assert gain < 2.5e-4
    assert offset_g < 1e-4
    assert report["settings"]["stillness"] == rule
    assert numbers(report) == NUMBERS[rule]
    assert (report["settings"]["adaptive"] is not None) == (rule == "adaptive")
    windows = report["fit"]["windows"]
    left_out = ["moving", "filled", "clipped", "recovered", "implausible", "constant_left_out"]
    left_out.append("temperature_left_out")
    assert windows["complete"] == windows["used"] + windows["joined"] + sum(
        windows[name] for name in left_out
    )
    assert (windows["joined"] > 0) == (rule == "adaptive")


def test_every_rule_is_tested_here() -> None:
    assert set(NUMBERS) == set(STILLNESS)


def test_the_default_is_both_and_of_profile_paper_range(tmp_path: Path) -> None:
    assert reported(tmp_path) == reported(tmp_path, "--stillness", "both")
    paper = reported(tmp_path, "--profile", "paper")
    assert paper["settings"]["stillness"] == "range" and paper["settings"]["other_stillness"]
    named = reported(tmp_path, "--profile", "paper", "--stillness", "range")
    assert named == {**paper, "settings": {**paper["settings"], "other_stillness": False}}
    other = reported(tmp_path, "--profile", "paper", "--stillness", "deviation")
    assert (other["settings"]["profile"], numbers(other)) == ("paper", NUMBERS["deviation"])


def test_adaptive_joins_each_rest_into_one_state(tmp_path: Path) -> None:
    windows = reported(tmp_path, "--stillness", "adaptive")["fit"]["windows"]
    assert windows["complete"] == 60 * SECONDS * RATE_HZ // 100
    assert windows["used"] == 60


def test_numbers_of_ones_own_replace_those_of_the_rule(tmp_path: Path) -> None:
    for rule in ("both", "range"):
        words = ("--stillness", rule, "--segment-seconds", 3, "--stillness-threshold-g", 0.2)
        assert numbers(reported(tmp_path, *words))[:2] == (3.0, 0.2)
    assert numbers(reported(tmp_path, "--stillness", "deviation", "--segment-seconds", 5))[0] == 5.0
    report = reported(tmp_path, "--stillness", "adaptive", "--segment-seconds", 2)
    assert report["fit"]["windows"]["complete"] == 60 * SECONDS // 2


@pytest.mark.parametrize("rule", ["deviation", "adaptive"])
def test_a_threshold_that_means_nothing_to_the_rule_is_refused(tmp_path: Path, rule: str) -> None:
    words = ("--stillness", rule, "--stillness-threshold-g", 0.1)
    ran = run("calibrate", good_csv(tmp_path), *words)
    assert_one_line(ran, f"--stillness {rule}", "both or range", code=2)


def test_adaptive_windows_of_less_than_a_second_are_refused(tmp_path: Path) -> None:
    words = ("--stillness", "adaptive", "--segment-seconds", 0.5)
    for command in ("calibrate", "inspect"):
        assert_one_line(run(command, good_csv(tmp_path), *words), "at least 1 s", "--segment-seconds", code=2)


def test_no_rest_near_the_quietest_is_said(tmp_path: Path) -> None:
    path = tmp_path / "moving.csv"
    rows = "\n".join(f"{(i * 7919) % 200 / 100 - 1},{(i * 104729) % 200 / 100 - 1},1" for i in range(5000))
    path.write_text("x,y,z\n" + rows + "\n")
    words = ("--rate", 25, "--unit", "g", "--stillness", "adaptive", "--report-only")
    assert "another rule of --stillness" in run("calibrate", path, *words, code=4).err


def test_inspect_counts_joined_windows_as_still(tmp_path: Path) -> None:
    ran = run("inspect", good_csv(tmp_path), "--stillness", "adaptive", "--full", "--json")
    read = json.loads(ran.out)["read"]
    assert read["windows"] == 450
    assert read["still_windows"] > 400
