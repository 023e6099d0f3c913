"""Reports that no accelcal wrote: refused in one line, or taken for another file; never a bug of ours."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.cli.run import assert_one_line, run
from tests.device_recordings import donor, edit
from tests.recordings import good_csv

HUGE = 10**400
NESTED = "[" * 100_000


def path_of(report: dict[str, Any], path: str) -> None:
    report["recording"]["path"] = path


def device(report: dict[str, Any], **more: object) -> None:
    report["recording"]["device"] |= more


def fixed(report: dict[str, Any], name: str, value: object) -> None:
    report["calibration"]["fixed_point"][name] = value


HOSTILE = {
    "NUL in the path": lambda held: path_of(held, "a\0b"),
    "half a character": lambda held: path_of(held, "\ud800"),
    "half a character in a setting": lambda held: held["settings"].update(optimizer="\ud800"),
    "an unknown key of the device": lambda held: device(held, colour="red"),
    "a huge size": lambda held: held["recording"].update(bytes=HUGE),
    "a huge rate": lambda held: held["recording"].update(sample_rate_hz=HUGE),
    "a huge setting": lambda held: held["settings"].update(segment_seconds=HUGE),
    "a huge temperature": lambda held: fixed(held, "temperature_reference_mc", HUGE),
    "an impossible layout": lambda held: held["settings"]["input"].update(layout="a/\0"),
    "no name of a layout": lambda held: held["settings"]["input"].update(layout="/"),
    "nested": lambda held: held.update(message=json.loads("[" * 200 + "]" * 200)),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_report(tmp_path: Path, name: str) -> None:
    report, path = edit(donor(tmp_path), HOSTILE[name]), tmp_path / "donor.raw"
    for words in (
        ("verify", report, path),
        ("apply", "--coefficients", report, "-d", tmp_path / "out", path),
        ("calibrate", "--report-only", path),
    ):
        ran = run(*words)
        assert ran.code in (0, 1, 2, 3, 5), (words, ran)
        if ran.code > 1:
            assert_one_line(ran, str(report) if words[0] != "verify" else "")


@pytest.mark.parametrize("text", [NESTED.encode(), b'{"a":' * 50_000, b"\xed\xa0\x80", b"\xff"])
def test_a_report_that_is_no_json(tmp_path: Path, text: bytes) -> None:
    report, path = donor(tmp_path), tmp_path / "donor.raw"
    report.write_bytes(text)
    for words, code in ((("verify", report, path), 3), (("calibrate", "--report-only", path), 5)):
        ran = run(*words)
        assert ran.code == code
        assert_one_line(ran, str(report))


def test_columns_that_are_no_names_in_the_report_in_the_way(tmp_path: Path) -> None:
    columns = {"columns": [None, 1, "x"]}
    words = ("calibrate", "--report-only", good_csv(tmp_path))
    assert run(*words).code == 0
    good = tmp_path / "good.calibration.json"
    report = edit(good, lambda held: held["settings"]["input"].update(columns))
    assert_one_line(run(*words), str(report), "a run with --columns None,1,x", code=5)


def test_nested_metadata_of_a_parquet_file(tmp_path: Path) -> None:
    report, path = donor(tmp_path), tmp_path / "donor.raw"
    schema = pa.schema([("x", pa.float32())], {b"accelcal": NESTED.encode()})
    pq.write_table(pa.table({"x": [1.0]}, schema), tmp_path / "donor.calibrated.parquet")
    assert_one_line(run("calibrate", path), "donor.calibrated.parquet", "was not written by accelcal", code=5)
    assert run("verify", report, path).code == 1


@pytest.mark.parametrize("name", ["study.json", "study.csv", "study.parquet", "study.ledger", "study.lock"])
@pytest.mark.parametrize("kind", ["nested", "pipe"])
def test_files_with_the_names_of_a_study(tmp_path: Path, name: str, kind: str) -> None:
    """In the folder of the recordings, which is that of the outputs too."""
    donor(tmp_path)
    if kind == "nested":
        (tmp_path / name).write_text(NESTED)
    else:
        os.mkfifo(tmp_path / name)
    ran = run("study", tmp_path, "-d", tmp_path, "-j", 1, "--report-only")
    assert_one_line(ran, str(tmp_path / name), code=5)
