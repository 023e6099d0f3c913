"""The same counts give the same bits of calibration, whichever format they come in."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from accelcal_cli.formats import all_encoders
from tests.cli.run import run

Capture = pytest.CaptureFixture[str]
PLAIN = ("--lsb-per-g", 256, "--range-g", 8)
FINER = ("--lsb-per-g", 341, "--range-g", 6)
OWN_GRID = {"csv"}
"""Decimal numbers come back on a grid of their own."""


def report(capsys: Capture, folder: Path, name: str, words: tuple[object, ...], hours: float) -> Any:
    """Simulate in a format and calibrate it; 50 Hz and 24 s hold whole pages and seconds of every format."""
    (folder / name).mkdir()
    made = run(
        capsys, "simulate", folder / name / "a", "--format", name, "--days", hours / 24, "--rate", 50,
        "--seed", 8, "--no-temperature", "-q", *words,
    )  # fmt: skip
    assert made.code == 0, made
    path = made.lines[0].split("\t")[0]
    told = run(capsys, "calibrate", path, "--report-only", "--json", "--no-temperature", "-q")
    assert told.code == 0, told
    (folder / name / Path(path).name).unlink()
    return json.loads(told.out)


def essence(told: Any) -> dict[str, Any]:
    """What depends on the counts alone."""
    about, health = told["recording"], told["file_health"]
    return {
        "calibration": told["calibration"],
        "holdout": told["holdout"],
        "fit": told["fit"],
        "coverage": told["coverage"],
        "models_tried": told["models_tried"],
        "samples": (about["samples"], about["duration_s"], about["gaps"]),
        "scale": (about["sample_rate_hz"], about["range_g"], about["start_time"]),
        "health": (health["problems"], health["filled_samples"]),
        "clipped": (health["clipped_samples_before"], health["clipped_samples_after"]),
    }


def agree(capsys: Capture, folder: Path, names: list[str], words: tuple[object, ...], hours: float) -> None:
    first, *others = [essence(report(capsys, folder, name, words, hours)) for name in names]
    assert first["calibration"]["model"] == "9"
    assert first["samples"][0] == hours * 3600 * 50
    for name, other in zip(names[1:], others, strict=True):
        assert other == first, f"{name} and {names[0]}"


def test_every_format_of_256_counts_per_g(tmp_path: Path, capsys: Capture) -> None:
    names = [encoder.name for encoder in all_encoders() if encoder.name not in OWN_GRID]
    assert {"cwa", "flash", "geneactiv", "gt3x", "hdf5", "raw"} <= set(names)
    agree(capsys, tmp_path, names, PLAIN, 2)


@pytest.mark.nightly
def test_packed_records_of_341_counts_per_g(tmp_path: Path, capsys: Capture) -> None:
    agree(capsys, tmp_path, ["flash", "gt3x"], FINER, 4)


@pytest.mark.nightly
def test_two_days(tmp_path: Path, capsys: Capture) -> None:
    names = [encoder.name for encoder in all_encoders() if encoder.name not in OWN_GRID]
    agree(capsys, tmp_path, names, PLAIN, 48)
    (tmp_path / "finer").mkdir()
    agree(capsys, tmp_path / "finer", ["flash", "gt3x"], FINER, 48)
