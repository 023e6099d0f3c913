"""A wrong unit, scale or field is said as such, not as a short recording or a clock that drifts."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.cli.run import run
from tests.recordings import directions, good_csv, good_raw, still_counts, write_csv

Capture = pytest.CaptureFixture[str]


@pytest.mark.parametrize("lsb_per_g", [128, 512])
def test_wrong_counts_per_g(tmp_path: Path, capsys: Capture, lsb_per_g: int) -> None:
    ran = run(capsys, "calibrate", good_raw(tmp_path), "--lsb-per-g", lsb_per_g)
    assert (ran.code, "record longer" in ran.err) == (4, False)
    found = re.search(
        r"rest measures (\S+) g instead of 1 g; (\S+) counts per g would fit instead of (\S+):", ran.err
    )
    assert found is not None, ran.err
    measured, fits, given = map(float, found.groups())
    assert measured == pytest.approx(256 / lsb_per_g, rel=0.03)
    assert (fits, given) == (pytest.approx(256, rel=0.03), lsb_per_g)


def test_a_wrong_unit(tmp_path: Path, capsys: Capture) -> None:
    ran = run(capsys, "calibrate", good_csv(tmp_path), "--unit", "m/s2")
    assert ran.code == 4
    assert "as if values in g were read as m/s2; check the unit (--unit)" in ran.err


def test_an_axis_that_is_another_field(tmp_path: Path, capsys: Capture) -> None:
    counts = still_counts(directions(60))
    counts[:, 0] = 8
    ran = run(capsys, "calibrate", write_csv(tmp_path / "a.csv", counts))
    assert ran.code == 4
    assert "x stays at 0.03 g at rest while gravity moves y by " in ran.err
    counts[:, 0] = counts[:, 1]
    ran = run(capsys, "calibrate", write_csv(tmp_path / "b.csv", counts))
    assert "x and y hold the same values throughout" in ran.err


def test_inspect_says_two_rates_instead_of_a_drift_and_no_counts_for_decimals(
    tmp_path: Path, capsys: Capture
) -> None:
    path = write_csv(tmp_path / "a.csv", still_counts(directions(12)), rate_hz=24.4)
    shown = run(capsys, "inspect", "--full", path, "--rate", 25).out
    assert "24.4 Hz measured, 25 Hz nominal" in shown and "s/day" not in shown
    assert "decimal values, in steps of 2^-24 g" in shown
