"""The evidence: the same twice, with every changed key found, unless it is prose or settled."""

from __future__ import annotations

import hashlib
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from tests.cli.run import exit_code
from tests.evidence import compare, freeze, rules_of, tasks_of
from tests.recordings import good_raw

GOOD, BAD = "made/good.raw", "made/bad.csv"


@pytest.fixture(scope="module")
def frozen(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    data = tmp_path_factory.mktemp("data")
    (data / "made").mkdir()
    good_raw(data / "made")
    (data / BAD).write_text("time,gx,gy,gz\n0.00,1,2,3\n0.04,1,2,3\n0.08,1,2,3\n")
    tasks = {name: task for name, task in tasks_of(data).items() if name in (GOOD, BAD)}
    first = freeze(tasks, jobs=2)
    assert first == freeze(tasks)
    assert exit_code("calibrate", data / GOOD, "-d", data, "-q") == 0
    table = pq.read_table(data / "good.calibrated.parquet")
    nothing_missing = bytes(len(table))
    values = {name: np.asarray(table[name]).tobytes() for name in table.column_names}
    assert first[GOOD]["parquet"]["good.calibrated.parquet"] == {
        "rows": 45_000,
        "columns": {
            name: [str(table[name].type), hashlib.sha256(one + nothing_missing).hexdigest()]
            for name, one in values.items()
        },
    }
    return first


def test_reports_and_errors_are_kept(frozen: dict[str, Any]) -> None:
    assert list(frozen) == [BAD, GOOD]
    assert (frozen[GOOD]["exit_code"], frozen[GOOD]["report"]["outcome"]) == (0, "calibrated")
    assert not {"provenance", "accelcal_version"} & {*frozen[GOOD]["report"]}
    hint = "give --columns X,Y,Z as names, or as numbers from 0, if it is there"
    what = "no column has a name known for acceleration: time, gx, gy, gz"
    assert frozen[BAD] == {
        "exit_code": 3, "message": [f"accelcal: {BAD}, line 1: {what}; {hint}"],
        "error": {"class": "NoRecordingError",
                  "reason": {"code": "other_quantities", "values": {"columns": ["time", "gx", "gy", "gz"]}},
                  "line": 1, "byte_offset": None, "hint": hint, "sensors": []},
        "parquet": {},
    }  # fmt: skip


def changed(frozen: dict[str, Any]) -> dict[str, Any]:
    new = deepcopy(frozen)
    report = new[GOOD]["report"]
    report["calibration"]["gain"][1][0] = 1
    report["message"] = "Otherwise."
    report["recording"]["notes"].append("another")
    report["notes"].append({"code": "another", "values": {}})
    new[BAD]["error"]["hint"] = "none"
    return new


def test_differences_are_told_by_recording_and_key(frozen: dict[str, Any]) -> None:
    assert compare(frozen, frozen) == (["0 differences, 0 settled"], 0)
    lines, left = compare(frozen, changed(frozen))
    assert left == 5
    gain = frozen[GOOD]["report"]["calibration"]["gain"][1][0]
    assert f"  report.calibration.gain[1][0]: {gain} -> 1" in lines
    assert "1 report.calibration.gain[][]" in lines
    assert lines[0] == BAD and lines[1].endswith('-> "none"') and lines[2] == GOOD
    assert compare(frozen, {GOOD: frozen[GOOD]})[1] == 1


def test_prose_is_ignored_but_not_codes(frozen: dict[str, Any]) -> None:
    lines, left = compare(frozen, changed(frozen), ignore_prose=True)
    assert [line.split(":")[0] for line in lines[:3]] == [
        GOOD,
        "  report.calibration.gain[1][0]",
        "  report.notes",
    ]
    assert left == 2


def test_settled_differences_are_counted_with_their_reason(frozen: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "settled.txt"
    path.write_text("# A comment.\n\nreport\\.calibration\\..*  made/*  # it is exact now\n")
    lines, left = compare(frozen, changed(frozen), rules_of(path), ignore_prose=True)
    assert left == 1
    assert lines[-2:] == [
        "settled: 1 report\\.calibration\\..* made/*: it is exact now",
        "1 differences, 1 settled",
    ]
    path.write_text("report.*  made/*\n")
    with pytest.raises(ValueError, match="made"):
        rules_of(path)
    assert all(rule.reason for rule in rules_of())
