"""U11: the table of a study begins with the columns that people decide by."""

from __future__ import annotations

import csv
from pathlib import Path

from accelcal_cli.output.quality import wear_hours
from tests.cli.run import run
from tests.recordings import directions, still_counts, write_raw

FIRST = [
    "path", "use", "why", "calibration_error_mg", "calibration_error_low_mg", "calibration_error_high_mg",
    "calibration_error_before_mg", "probability_better", "wear_hours", "start_time", "duration_hours",
    "device_serial", "device_model", "outcome", "decided_by", "decided_at", "note",
]  # fmt: skip


def test_u11_the_table_says_first_what_to_use_and_why_not(tmp_path: Path) -> None:
    """Recordings with many orientations and with one, and a table without a time."""
    (tmp_path / "in").mkdir()
    write_raw(tmp_path / "in" / "few.raw", still_counts(directions(1)))
    write_raw(tmp_path / "in" / "good.raw", still_counts(directions(60)))
    (tmp_path / "in" / "odd.csv").write_text("a,b,c\n" + "1,2,3\n" * 40)
    run("study", tmp_path / "in", "-d", tmp_path / "out", "--report-only", "-j", 1, "-q")
    with (tmp_path / "out" / "study.csv").open(encoding="utf-8", newline="") as file:
        table = csv.DictReader(file)
        rows = {row["path"]: row for row in table}
        assert table.fieldnames is not None and list(table.fieldnames[: len(FIRST)]) == FIRST
    assert (rows["good.raw"]["use"], rows["good.raw"]["why"]) == ("yes", "")
    assert rows["few.raw"]["use"] == rows["odd.csv"]["use"] == "no"
    assert rows["few.raw"]["why"].startswith("The device was still in only 1 orientation")
    assert rows["odd.csv"]["why"] == rows["odd.csv"]["message"] != ""


def test_wear_hours_are_those_of_worn_rows() -> None:
    quality = {
        "row": {"rate_hz": 50.0},
        "rows": {"worn": [True, False, None, True], "samples": [180_000, 180_000, 9_000, 90_000]},
    }
    assert wear_hours(quality) == 1.5
    assert wear_hours({"row": {"rate_hz": 50.0}, "rows": {"worn": [None], "samples": [10]}}) is None
    assert wear_hours({}) is None
