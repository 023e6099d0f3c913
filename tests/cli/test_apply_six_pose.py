"""Coefficients of a six-face session onto recordings: B's own equation gives the same values."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np
import pandas as pd

from tests.cli.run import run
from tests.recordings import good_csv

SAMPLE = Path(__file__).resolve().parent.parent.parent / "sample_data" / "six_faces.csv.gz"


def test_a_session_s_own_samples_by_the_equation_of_the_paper(tmp_path: Path) -> None:
    report = tmp_path / "six_faces.calibration.json"
    assert run("six-pose", SAMPLE, "-d", tmp_path).code == 0
    out = tmp_path / "applied.parquet"
    assert run("apply", "--coefficients", report, SAMPLE, "-o", out).code == 0
    known = json.loads(report.read_text())["known_orientations"]
    with gzip.open(SAMPLE, "rt") as file:
        z = pd.read_csv(file, comment="#")[["x", "y", "z"]].to_numpy()
    # a = K^-1 (z - O), Bragge et al.
    expected = (z - np.array(known["O"])) @ np.linalg.inv(np.array(known["K"])).T
    found = pd.read_parquet(out)[["x", "y", "z"]].to_numpy()
    assert np.abs(found - expected).max() < 2e-7


def test_another_recording_is_borrowed_to(tmp_path: Path) -> None:
    assert run("six-pose", SAMPLE, "-d", tmp_path).code == 0
    report, other = tmp_path / "six_faces.calibration.json", good_csv(tmp_path)
    assert run("apply", "--coefficients", report, other).code == 2, "another device, perhaps"
    ran = run("apply", "--coefficients", report, other, "--any-device", "--json")
    made = json.loads(ran.out)
    assert (ran.code, made["outcome"], made["calibration"]["model"]) == (0, "borrowed", "12")
