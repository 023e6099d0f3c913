"""What a page and the table of a study say of a gyroscope: the numbers of the report, and no more."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest

from accelcal_cli.output.report_reading import fault, report_schema
from accelcal_cli.pages.recording import page
from accelcal_cli.pipeline.jobs import Job
from accelcal_cli.studies.records import Item
from accelcal_cli.studies.summary import of_report
from tests.cli.run import exit_code
from tests.pages.html import check


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Of half a simulated day at 25 Hz."""
    base = tmp_path_factory.mktemp("gyro") / "a"
    exit_code("simulate", base, "--format", "raw", "--days", 0.5, "--rate", 25, "--seed", 3, "--gyro", "-q")
    assert exit_code("calibrate", base.with_suffix(".raw"), "--report-only", "-q") == 0
    made: dict[str, Any] = json.loads(base.with_suffix(".calibration.json").read_text())
    return made


def refused(report: dict[str, Any]) -> dict[str, Any]:
    other = copy.deepcopy(report)
    changes = {"outcome": "refused", "message": "too <few> turns", "scale": None, "holdout_deg": None}
    other["gyroscope"] |= changes
    other["gyroscope"]["standard_errors"]["scale"] = None
    return other


def test_the_report_is_of_its_schema(report: dict[str, Any]) -> None:
    assert report["gyroscope"]["outcome"] == "calibrated", report["gyroscope"]["message"]
    for one in (report, refused(report)):
        assert fault(one, report_schema()) is None
    wrong = copy.deepcopy(report)
    wrong["gyroscope"]["scale"] = [[1, 0, 0], [0, 1, 0]]
    assert "gyroscope.scale" in (fault(wrong, report_schema()) or "")


def test_the_page_has_its_coefficients_and_errors(report: dict[str, Any]) -> None:
    text = page(report)
    check(text)
    found = report["gyroscope"]
    for value in (found["scale"][0][0], found["scale"][1][2], found["bias_dps"][2]):
        assert f"{value:.6f}".replace("-", "−") in text
    assert "The gyroscope" in text and found["message"] in text


def test_the_page_of_a_refused_one_says_why(report: dict[str, Any]) -> None:
    text = page(refused(report))
    check(text)
    assert "as measured" in text and "too &lt;few&gt; turns" in text
    assert "Coefficients of w" not in text


def test_coefficients_may_have_no_errors(report: dict[str, Any]) -> None:
    """No calibration of ours leaves them out, but the schema allows it."""
    other = copy.deepcopy(report)
    other["gyroscope"]["standard_errors"] = {"scale": None, "bias_dps": None}
    assert fault(other, report_schema()) is None
    assert f"{other['gyroscope']['scale'][0][0]:.6f}" in page(other)


def test_a_page_without_a_gyroscope_says_nothing_of_one(report: dict[str, Any]) -> None:
    without = {name: value for name, value in report.items() if name != "gyroscope"}
    assert "gyroscope" not in page(without).replace("Gyroscope", "gyroscope")


def test_the_table_of_a_study(report: dict[str, Any]) -> None:
    path = Path("a.raw")
    item = Item("a.raw", Job(path, path, path), ((4, 0),))
    row = of_report(item, 0, report, {})
    held = report["gyroscope"]["holdout_deg"]
    assert (row["gyroscope"], row["gyro_pairs"]) == ("calibrated", report["gyroscope"]["pairs"])
    assert (row["gyro_before_deg"], row["gyro_after_deg"]) == (held["before"], held["after"])
    row = of_report(item, 0, refused(report), {})
    assert (row["gyroscope"], row["gyro_after_deg"]) == ("refused", None)
    del report["gyroscope"]
    assert of_report(item, 0, report, {})["gyroscope"] is None
