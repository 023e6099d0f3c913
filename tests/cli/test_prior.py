"""`--prior`, and what reports and the terminal say of the whole sphere."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.run import report_of, run
from tests.recordings import good_csv


def made(folder: Path, *words: object) -> dict:
    path = good_csv(folder)
    assert run("calibrate", path, "--report-only", "--force", *words).code == 0
    return report_of(folder / "good.calibration.json")


def test_by_default_all_parameters_are_fitted_with_a_prior(tmp_path: Path) -> None:
    report = made(tmp_path)
    assert report["settings"]["prior"] == "population"
    sphere = report["calibration_error_mg"]
    low, high = sphere["ci95"]
    assert low <= sphere["mean"] <= sphere["worst_direction"] and sphere["mean"] <= high < sphere["before"]
    *ladder, last = report["models_tried"]
    assert (last["model"], last["prior"]) == ("9", "population")
    assert [one["model"] for one in ladder] == ["0", "3", "6", "9"]
    assert not any("prior" in one for one in ladder)


def test_without_one_the_ladder_decides_and_nothing_is_known_of_the_sphere(tmp_path: Path) -> None:
    report = made(tmp_path, "--prior", "none")
    assert report["settings"]["prior"] == "none" and report["calibration_error_mg"] is None
    assert [one["model"] for one in report["models_tried"]] == ["0", "3", "6", "9"]


@pytest.mark.parametrize("words", [("--model", "9"), ("--profile", "paper"), ("--optimizer", "gauss-newton")])
def test_what_leaves_no_room_for_a_prior_has_none(tmp_path: Path, words: tuple[str, str]) -> None:
    path = good_csv(tmp_path)
    run("calibrate", path, "--report-only", *words)
    assert report_of(tmp_path / "good.calibration.json")["settings"]["prior"] == "none"
    ran = run("calibrate", path, *words, "--prior", "population", code=2)
    assert f"--prior population does not go with {' '.join(words)}" in ran.err
