"""An EmbracePlus writes a file every half hour: as one recording they have the bits of the whole."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import accelcal
from tests.cli.studies import rows, study
from tests.formats.make_embraceplus import NONE, SERIAL, START_US, container, schema, sensor, session
from tests.recordings import directions

SAME = (
    "outcome",
    "calibration",
    "holdout",
    "fit",
    "coverage",
    "calibration_error_mg",
    "models_tried",
    "change",
)
PARTS, SECONDS, RATE_HZ, LSB_PER_G = 48, 40, 64, 2048
COUNT_US = 1_000_000 // RATE_HZ


def made(counts: np.ndarray, start_us: int) -> bytes:
    body = session(
        sensor(counts, (0, 0, 0, 0), 1 / LSB_PER_G, RATE_HZ, start_us), sensor(NONE, (0, 0, 0, 0), 1.0)
    )
    return container(body, schema(True))


def day() -> np.ndarray:
    """Samples of all parts: rests of thirty seconds, which no part ends with."""
    poses = directions(PARTS * SECONDS // 30)
    gain, offset = np.diag([1.02, 0.98, 1.01]), np.array([0.03, -0.02, 0.05])
    held = np.repeat(poses @ np.linalg.inv(gain).T - offset, 30 * RATE_HZ, axis=0)
    noise = 0.003 * np.random.default_rng(1).normal(size=held.shape)
    return np.rint((held + noise) * LSB_PER_G).astype(int)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    base, counts = tmp_path_factory.mktemp("embraceplus"), day()
    (base / "whole.avro").write_bytes(made(counts, START_US))
    number = SECONDS * RATE_HZ
    for part in range(PARTS):
        start_us = START_US + part * number * COUNT_US
        date = "2024-03-04" if part < PARTS // 2 else "2024-03-05"
        place = base / f"participant_data/{date}/S01-{SERIAL}/raw_data/v6"
        place.mkdir(parents=True, exist_ok=True)
        data = made(counts[part * number : (part + 1) * number], start_us)
        (place / f"S01-{SERIAL}_{start_us // 1_000_000}.avro").write_bytes(data)
    return base


def same(report: dict[str, Any], expected: dict[str, Any]) -> bool:
    return all(json.dumps(report[name]) == json.dumps(expected[name]) for name in SAME)


def test_48_files_have_the_bits_of_the_whole(folder: Path) -> None:
    expected = accelcal.calibrate(folder / "whole.avro", report_only=True).report
    assert expected["outcome"] == "calibrated"
    report = accelcal.calibrate(folder / "participant_data", parts=True, report_only=True).report
    assert same(report, expected)
    assert report["recording"]["samples"] == PARTS * SECONDS * RATE_HZ
    assert report["file_health"]["problems"] == []
    assert any(note.startswith("48 parts, from S01-3YK3K1521D_") for note in report["recording"]["notes"])


def test_a_study_knows_them_over_the_folders_of_several_days(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert study(capsys, folder / "participant_data", "-d", tmp_path / "out", "--report-only").code == 0
    (row,) = rows(tmp_path / "out")
    assert row["path"] == f"*/S01-{SERIAL}/raw_data/v6/S01-{SERIAL}_*.avro"
    assert row["report"] == f"S01-{SERIAL}/raw_data/v6/S01-{SERIAL}.calibration.json"
    expected = accelcal.calibrate(folder / "whole.avro", report_only=True).report
    assert same(json.loads((tmp_path / "out" / row["report"]).read_text()), expected)
