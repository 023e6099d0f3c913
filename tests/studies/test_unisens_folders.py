"""Folders of Unisens in a study: each counts once, and what is left of one is not lost in silence."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from tests.cli.run import run
from tests.formats.make_unisens import description, folder, signal
from tests.recordings import LSB_PER_G, RATE_HZ, directions, still_counts


def test_a_folder_counts_once(tmp_path: Path) -> None:
    counts = still_counts(directions(60)).astype("<i2")
    acc = signal("acc.bin", "acc", sampleRate=RATE_HZ, lsbValue=1 / LSB_PER_G)
    text = description(acc, signal("ecg.bin", "ecg", channels=("a",), unit="mV"))
    (tmp_path / "in").mkdir()
    folder(tmp_path / "in" / "a", text, acc=counts.tobytes(), ecg=bytes(999))
    folder(tmp_path / "in" / "b", text, acc=np.roll(counts, 1, axis=1).tobytes(), ecg=bytes(999))
    folder(tmp_path / "in" / "c", text, ecg=bytes(999))
    told = run("study", tmp_path / "in", "-d", tmp_path / "out", "-j", 1, "-q")
    with (tmp_path / "out" / "study.csv").open(encoding="utf-8", newline="") as file:
        outcomes = {row["path"]: row["outcome"] for row in csv.DictReader(file)}
    assert told.code == 1
    assert outcomes == {"a/acc.bin": "calibrated", "b/acc.bin": "calibrated", "c/unisens.xml": "failed"}
