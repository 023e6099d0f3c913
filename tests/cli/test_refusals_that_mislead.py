"""A wrong unit, scale or field is said as such, not as a short recording or a clock that drifts."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.cli.run import run, told
from tests.recordings import directions, good_csv, good_raw, still_counts, write_csv


@pytest.mark.parametrize("lsb_per_g", [128, 512])
def test_wrong_counts_per_g(tmp_path: Path, lsb_per_g: int) -> None:
    """512 leave too few windows, which a prior would fit provisionally: the cause is said instead."""
    path = good_raw(tmp_path)
    ran = run("calibrate", path, "--lsb-per-g", lsb_per_g)
    report = json.loads((tmp_path / "good.calibration.json").read_text())
    note, advice = report["notes"][-1], report["advice"]
    assert (ran.code, note["code"], advice) == (4, "wrong_counts_per_g", [])
    assert (report["reason"], report["calibration"]) == ("still_far_from_1_g", None)
    assert "prediction   refused" in run("inspect", path, "--lsb-per-g", lsb_per_g).out
    assert note["values"]["median_g"] == pytest.approx(256 / lsb_per_g, rel=0.03)
    assert note["values"]["fits"] == pytest.approx(256, rel=0.03)
    assert note["values"]["lsb_per_g"] == lsb_per_g and told(report, "wrong_counts_per_g") in ran.err


@pytest.mark.parametrize(("unit", "measured"), [("m/s2", "0.101"), ("mg", "0.001")])
def test_a_wrong_unit(tmp_path: Path, unit: str, measured: str) -> None:
    ran = run("calibrate", good_csv(tmp_path), "--unit", unit, code=4)
    report = json.loads((tmp_path / "good.calibration.json").read_text())
    assert told(report, "wrong_unit") in ran.err and report["advice"] == []
    said = f"Gravity measures {measured} g instead of 1 g, as if values in g were read as {unit}."
    assert f"{said} Use --unit g." in ran.err


def test_an_axis_that_is_another_field(tmp_path: Path) -> None:
    counts = still_counts(directions(60))
    counts[:, 0] = 8
    ran = run("calibrate", write_csv(tmp_path / "a.csv", counts), code=4)
    report = json.loads((tmp_path / "a.calibration.json").read_text())
    values = report["notes"][-1]["values"]
    assert (values["axis"], values["at_g"], values["others"]) == ("x", 0.03, ["y", "z"])
    assert told(report, "axis_stuck") in ran.err and report["advice"] == [], "more stillness is no help"
    counts[:, 0] = counts[:, 1]
    ran = run("calibrate", write_csv(tmp_path / "b.csv", counts))
    report = json.loads((tmp_path / "b.calibration.json").read_text())
    assert report["notes"][-1] == {"code": "axes_alike", "values": {"axes": ["x", "y"]}}
    assert told(report, "axes_alike") in ran.err


def test_inspect_says_two_rates_instead_of_a_drift_and_no_counts_for_decimals(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "a.csv", still_counts(directions(12)), rate_hz=24.8)
    shown = run("inspect", "--full", path, "--rate", 25).out
    assert "24.8 Hz measured, 25 Hz nominal" in shown and "s/day" not in shown
    assert "decimal values, in steps of 2^-24 g" in shown


def test_still_windows_that_all_stand_where_an_axis_may_saturate(tmp_path: Path) -> None:
    """A quiet device that never turns: its windows were still, and the limit of stillness is not named."""
    moves = np.random.default_rng(1).integers(20, 22, 6000)
    rows = [f"{number / 20:.2f},{x / 1000},0.1,0.99" for number, x in enumerate(moves)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["time,x,y,z", *rows, ""]))
    ran = run("calibrate", path)
    report = json.loads((tmp_path / "a.calibration.json").read_text())
    assert (ran.code, report["reason"]) == (4, "nothing_but_saturated")
    assert report["fit"]["windows"]["saturated_left_out"] == 60
    assert "refused: in every still window an axis stays at one value" in ran.err
