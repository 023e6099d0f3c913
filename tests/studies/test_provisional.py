"""Provisional results of a study give way to better coefficients of their device, as refusals do."""

from __future__ import annotations

from pathlib import Path

from tests.cli.run import run
from tests.cli.studies import results, rows
from tests.device_recordings import rest, week, write_device
from tests.recordings import directions
from tests.studies.borrowing import report

POSES = 4
"""Number of orientations of each recording to pool."""


def table(here: Path, *words: object) -> dict[str, dict[str, str]]:
    assert run("study", here / "in", "-d", here / "out", "-j", 1, "-q", *words).code == 0
    return {row["path"]: row for row in rows(here / "out")}


def test_verdicts_1_a_provisional_recording_borrows(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    week(tmp_path / "in/good.raw")
    week(tmp_path / "in/short.raw", poses=3, seed=2)
    own = table(tmp_path)["short.raw"]
    assert own["outcome"] == "provisional"
    before = results(tmp_path / "out")
    row = table(tmp_path, "--borrow")["short.raw"]
    assert (row["outcome"], row["borrowed_from"], row["exit_code"]) == ("borrowed", "good.raw", "0")
    assert (row["own_outcome"], row["own_message"]) == ("provisional", own["message"])
    assert float(row["after_mg"]) < float(own["after_mg"])
    lent = report(tmp_path / "out", "good")["calibration"]
    assert report(tmp_path / "out", "short")["calibration"] == lent
    assert table(tmp_path)["short.raw"] == own and results(tmp_path / "out") == before


def test_verdicts_1_provisional_recordings_are_pooled(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    values, heat = rest(directions(6 * POSES), seed=3)
    for number in range(6):
        at = slice(750 * POSES * number, 750 * POSES * (number + 1))
        write_device(tmp_path / f"in/{number}.raw", values[at], None if heat is None else heat[at])
    own = table(tmp_path)
    assert {row["outcome"] for row in own.values()} == {"provisional"}
    found = table(tmp_path, "--pool", "device")
    assert {row["outcome"] for row in found.values()} == {"calibrated"}
    assert {row["own_outcome"] for row in found.values()} == {"provisional"}
    assert {row["pool_recordings"] for row in found.values()} == {"6"}
    assert len({row["k_xx"] for row in found.values()}) == 1
