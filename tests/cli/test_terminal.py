"""At a terminal, a sentence that says how certain the error is; fields if asked for, and in pipes."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from accelcal_cli.cli.output import show_row
from tests.cli.run import run
from tests.recordings import good_raw

Capture = pytest.CaptureFixture[str]
Shown = Callable[..., str]
ROW = {
    "outcome": "calibrated",
    "model": "9",
    "before_mg": 13.5,
    "after_mg": 9.8,
    "ci95_low_mg": 5.4,
    "ci95_high_mg": 14.3,
    "improvement_percent": 137.8,
}
UNCERTAIN = "this may be no better than the raw data, whose 13.5 mg lie within it"
SPHERE = {
    "sphere_mg": 4.1,
    "sphere_low_mg": 1.5,
    "sphere_high_mg": 9.9,
    "sphere_worst_mg": 7.0,
    "sphere_before_mg": 20.0,
}


@pytest.fixture
def shown(capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> Shown:
    """What is printed of a row at a terminal."""

    def show(row: dict[str, object], written: Path | None = None, *, tsv: bool = False) -> str:
        monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
        show_row(row, Path("a.cwa"), written, {"tsv": tsv})
        return capsys.readouterr().out

    return show


def test_an_interval_that_holds_the_raw_error_is_said(shown: Shown) -> None:
    start = "a.cwa: calibrated (model 9); 13.5 mg before, 9.80 mg after (95 % interval 5.40 to 14.3); "
    assert shown(ROW, Path("a.parquet")) == f"{start}{UNCERTAIN}; written to a.parquet\n"
    assert UNCERTAIN not in shown(ROW | {"ci95_high_mg": 13.4})


def test_what_has_no_error_after_has_no_interval(shown: Shown) -> None:
    nothing = dict.fromkeys(ROW) | {"outcome": "refused"}
    assert shown(nothing) == "a.cwa: refused\n"
    good = nothing | {"outcome": "already_good", "before_mg": 1.25}
    assert shown(good) == "a.cwa: good as it is; the raw data are off by 1.25 mg\n"


def test_with_a_prior_the_interval_is_that_of_the_sphere(shown: Shown) -> None:
    """The raw error on postures left out, 13.5 mg, lies in their own interval, which is not shown."""
    start = "13.5 mg before, 9.80 mg after on postures left out of the fit; 4.10 mg over the whole sphere"
    assert shown(ROW | SPHERE) == f"a.cwa: calibrated (model 9); {start} (95 % interval 1.50 to 9.90)\n"
    doubtful = shown(ROW | SPHERE | {"sphere_before_mg": 9.5})
    assert doubtful.endswith("; this may be no better than the raw data, whose 9.50 mg lie within it\n")
    assert "no better" not in shown(ROW | SPHERE | {"sphere_before_mg": 9.5, "outcome": "already_good"})


def test_fields_at_a_terminal_are_an_option(shown: Shown) -> None:
    assert shown(ROW, tsv=True) == "a.cwa\tcalibrated\t9\t13.500\t9.800\t138\t-\n"


def test_a_pipe_gets_fields(tmp_path: Path, capsys: Capture) -> None:
    assert len(run(capsys, "calibrate", good_raw(tmp_path), "--report-only").lines[0].split("\t")) == 7
