"""Issue 50, item 7: a study heeds what people decided, in its table, its summary and its exports."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.cli.run import exit_code, run
from tests.cli.studies import rows, study
from tests.recordings import directions, still_counts, write_raw


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two recordings that can be calibrated, and one that cannot."""
    for name, poses in (("a.raw", 60), ("sub/b.raw", 62), ("few.raw", 1)):
        (tmp_path / "in" / name).parent.mkdir(parents=True, exist_ok=True)
        write_raw(tmp_path / "in" / name, still_counts(directions(poses)))
    return tmp_path / "in"


def decide(folder: Path, text: str, name: str = "out/decisions.csv") -> Path:
    path = folder.parent / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def table(folder: Path) -> dict[str, dict[str, str]]:
    return {row["path"]: row for row in rows(folder.parent / "out")}


def summary(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder.parent / "out" / "study.json").read_text())
    return found


def test_u50_a_decision_changes_use_and_nothing_else(folder: Path) -> None:
    study(folder, "--report-only")
    before = table(folder)
    reports = {one: one.read_bytes() for one in folder.parent.rglob("*.calibration.json")}
    decisions = decide(folder, "recording,use,note,who,when\na.raw,exclude,loose,B. Meyer,2026-11-27\n")
    held = decisions.read_bytes()
    ran = study(folder, "--report-only")
    after = table(folder)
    assert "3 recordings (3 unchanged, 1 decided by people): " in ran.err
    assert before["a.raw"]["use"] == "yes"
    differs = {name for name in before["a.raw"] if before["a.raw"][name] != after["a.raw"][name]}
    assert differs == {"use", "why", "decided_by", "decided_at", "note"}
    assert after["a.raw"]["why"] == "A person decided not to use it (B. Meyer, 2026-11-27): loose."
    assert {**after, "a.raw": 0} == {**before, "a.raw": 0}
    frame = pd.read_parquet(folder.parent / "out" / "study.parquet").set_index("path")
    assert frame.loc["a.raw", ["use", "decided_by", "note"]].tolist() == ["no", "B. Meyer", "loose"]
    assert summary(folder)["uses"] == {"no": 2, "yes": 1}
    assert summary(folder)["decisions"]["rows"] == [["a.raw", "no", "loose", "B. Meyer", "2026-11-27", ""]]
    assert {one: one.read_bytes() for one in reports} == reports
    assert decisions.read_bytes() == held
    decisions.unlink()
    study(folder, "--report-only")
    assert (table(folder), summary(folder)["decisions"]) == (before, None)


def test_u50_each_trouble_with_a_decision_is_one_line(folder: Path) -> None:
    study(folder, "--report-only")
    result = table(folder)["a.raw"]["result"]
    assert result.startswith("r") and result != table(folder)["sub/b.raw"]["result"]
    decide(folder, f"recording,use,result\na.raw,no,{result}\nb.raw,yes,\nb.raw,no,\nx.raw,no,\nfew.raw,?,\n")
    again = still_counts(directions(60))
    again[:, 0] += 5
    write_raw(folder / "a.raw", again)
    ran = study(folder, "--report-only")
    lines = [line for line in ran.err.splitlines() if "decisions.csv: " in line]
    assert lines == [
        "accelcal: decisions.csv: In row 6, use is '?', which is not yes, with care or no.",
        "accelcal: decisions.csv: Row 5 names x.raw, which is not a recording of the study.",
        "accelcal: decisions.csv: The result of a.raw has changed since row 2 decided no. The more cautious "
        "of both counts: no.",
        "accelcal: decisions.csv: Rows 3 and 4 contradict each other on sub/b.raw. The most cautious of them "
        "counts: no.",
    ]
    found = summary(folder)["findings"]["listed"]
    assert [one["code"] for one in found] == [
        "decision_unreadable", "decision_without_recording", "decision_outdated", "decisions_contradict",
    ]  # fmt: skip
    assert found[1]["values"] == {"row": 5, "recording": "x.raw"}
    quiet = study(folder, "--report-only", "-q")
    assert (quiet.code, quiet.err) == (0, "")


def test_u50_a_file_that_is_named_counts_instead_of_that_in_out(folder: Path) -> None:
    decide(folder, "recording,use\na.raw,no\n")
    named = decide(folder, "recording;use\r\nb.raw;no\r\n", "by hand.csv")
    study(folder, "--report-only", "--decisions", named)
    assert {path: row["decided_by"] for path, row in table(folder).items()} == {
        "a.raw": "", "few.raw": "", "sub/b.raw": "a person",
    }  # fmt: skip


def test_u50_exclusions_are_not_lost_in_silence(folder: Path) -> None:
    """A file that cannot be read stops the study before it begins, and leaves the table as it was."""
    study(folder, "--report-only")
    decide(folder, "recording,use\na.raw,no\n")
    study(folder, "--report-only")
    held = table(folder)
    decide(folder, 'recording,use\na.raw,"no\n')
    ran = study(folder, "--report-only")
    assert ran.code == 3 and len(ran.err.splitlines()) == 1
    assert "decisions.csv: cannot be read as a table from row 2 on" in ran.err
    assert table(folder) == held
    missing = study(folder, "--decisions", folder / "gone.csv")
    assert missing.code == 2 and "gone.csv: there is no such file" in missing.err


def test_u50_decisions_in_a_study_of_its_own_folder_are_no_recording(folder: Path) -> None:
    held = "recording,use\na.raw,no\n"
    (folder / "decisions.csv").write_text(held)
    run("study", folder, "-d", folder, "-j", 1, "--report-only", "--force")
    found = json.loads((folder / "study.json").read_text())
    assert (found["recordings"], found["files_left_out"]) == (3, [])
    assert (folder / "decisions.csv").read_text() == held


def test_u50_shards_leave_decisions_to_those_who_collect(folder: Path) -> None:
    decide(folder, "recording,use\na.raw,no\nsub/b.raw,with care\n")
    for part in (1, 2):
        assert "decisions.csv" not in study(folder, "--report-only", "--shard", f"{part}/2").err
    study(folder, "--report-only", "--collect")
    assert [row["use"] for row in rows(folder.parent / "out")] == ["no", "no", "with care"]
    ran = study(folder, "--shard", "1/2", "--decisions", "x.csv")
    assert (ran.code, "give it to --collect" in ran.err) == (2, True)


def test_u50_an_export_skips_what_a_person_excluded(folder: Path) -> None:
    """As the table has it, and as the file has it if that was changed since."""
    out = folder.parent / "out"
    decide(folder, "recording,use,note\na.raw,no,loose\n")
    study(folder)
    ran = run("export", out, "--to", "csv", "-d", folder.parent / "one")
    assert f"{out}/a.calibration.json: a person decided not to use it: loose; skipped" in ran.err
    assert [one.name for one in (folder.parent / "one").iterdir()] == ["b.csv"]
    ran = run("export", out, "--to", "ggir")
    assert "a.raw" not in ran.out and "b.raw" in ran.out
    decide(folder, "recording,use\na.raw,yes\nsub/b.raw,no\n")
    ran = run("export", out, "--to", "csv", "-d", folder.parent / "two")
    assert [one.name for one in (folder.parent / "two").iterdir()] == ["a.csv"]
    data, report = out / "sub/b.calibrated.parquet", out / "sub/b.calibration.json"
    for number, one in enumerate((f"{out}/sub/*.json", data, report)):
        ran = run("export", one, "--to", "csv", "-d", folder.parent / f"other{number}", code=1)
        assert ran.err.endswith("a person decided not to use it; skipped\n")
    assert run("export", report, "--to", "ggir", code=1).out == ""
    ran = run("export", data, "--to", "csv", "-o", folder.parent / "b.csv", code=2)
    assert "is not exported: a person decided not to use it; change decisions.csv" in ran.err
    decide(folder, "nothing\n")
    assert run("export", out, "--to", "csv", "-d", folder.parent / "three").code == 3


def test_u50_python_takes_decisions(folder: Path) -> None:
    import accelcal

    named = decide(folder, "recording,use\na.raw,no\n", "mine.csv")
    found = accelcal.study(folder, folder.parent / "out", decisions=named, report_only=True, jobs=1)
    assert found.set_index("path").loc["a.raw", "use"] == "no"


def test_u50_a_name_like_a_formula_comes_back_from_a_spreadsheet(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    write_raw(tmp_path / "in" / "=1+1.raw", np.zeros((50, 3), np.int16))
    words = ("study", tmp_path / "in", "-d", tmp_path / "out", "-j", 1, "-q", "--report-only")
    exit_code(*words)
    with (tmp_path / "out" / "study.csv").open(newline="") as file:
        (row,) = csv.DictReader(file)
    assert row["path"] == "'=1+1.raw"
    with (tmp_path / "out" / "decisions.csv").open("w", newline="") as file:
        csv.writer(file).writerows([["path", "use", "who"], [row["path"], "no", "B"]])
    exit_code(*words)
    assert rows(tmp_path / "out")[0]["decided_by"] == "B"
