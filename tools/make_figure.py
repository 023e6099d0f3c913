"""Remake docs/before_after.png: the sample recording's still windows before and after calibration."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parent.parent
SAMPLE = ROOT / "sample_data" / "recording.bin"
WINDOW_S = 5


def calibrate(folder: Path) -> tuple[pd.DataFrame, dict]:
    """The calibrated sample recording and its report."""
    words = ["calibrate", str(SAMPLE), "-d", str(folder), "-q"]
    subprocess.run([sys.executable, "-m", "accelcal_cli", *words], check=True)
    report = json.loads((folder / "recording.calibration.json").read_text())
    return pd.read_parquet(folder / "recording.calibrated.parquet"), report


def still_norms(frame: pd.DataFrame, report: dict) -> tuple[NDArray, NDArray, NDArray]:
    """Hours, raw and calibrated |a| of the still windows."""
    after = frame[["x", "y", "z"]].to_numpy(np.float64)
    calibration = report["calibration"]
    before = after @ np.linalg.inv(calibration["gain"]).T - calibration["offset_g"]
    length = round(WINDOW_S * report["recording"]["sample_rate_hz"])
    number = len(after) // length
    blocks = after[: number * length].reshape(number, length, 3)
    still = (np.ptp(blocks, axis=1) < 0.12).all(axis=1) & (blocks.std(axis=1) < 0.013).all(axis=1)
    raw = before[: number * length].reshape(number, length, 3)
    hours = np.arange(number) * WINDOW_S / 3600
    norms = [np.linalg.norm(values[still].mean(axis=1), axis=1) for values in (raw, blocks)]
    return hours[still], norms[0], norms[1]


def main() -> None:
    """Draw and save."""
    with tempfile.TemporaryDirectory() as name:
        frame, report = calibrate(Path(name))
    hours, before, after = still_norms(frame, report)
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.2), sharey=True, layout="constrained")
    held = report["holdout"]
    for axis, norms, title, colour in (
        (axes[0], before, f"before: {held['before_mg']['mean']:.1f} mg", "tab:red"),
        (axes[1], after, f"after: {held['after_mg']['mean']:.2f} mg held out", "tab:blue"),
    ):
        axis.axhline(1, color="black", linewidth=0.8)
        axis.plot(hours, norms, ".", markersize=2.5, color=colour)
        axis.set(title=title, xlabel="hours")
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("|a| of still windows [g]")
    figure.savefig(ROOT / "docs" / "before_after.png", dpi=110, metadata={"Software": None})


if __name__ == "__main__":
    main()
