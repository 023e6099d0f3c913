"""Remake before_after.png, step.png and enmo.png in docs from the sample recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from numpy.typing import NDArray

import accelcal

ROOT = Path(__file__).resolve().parent.parent
SAMPLE = ROOT / "sample_data" / "recording.bin"
WINDOW_S = 5
RATE_HZ = 25
STEP_G = 0.02
"""The step that is put into the sample recording, in the offset of z after half of it."""


def still_norms(raw: NDArray, calibrated: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Hours, raw and calibrated |a| of the still windows."""
    length = WINDOW_S * RATE_HZ
    number = len(calibrated) // length
    blocks, before = (values[: number * length].reshape(number, length, 3) for values in (calibrated, raw))
    still = (np.ptp(blocks, axis=1) < 0.12).all(axis=1) & (blocks.std(axis=1) < 0.013).all(axis=1)
    hours = np.arange(number) * WINDOW_S / 3600
    norms = [np.linalg.norm(values[still].mean(axis=1), axis=1) for values in (before, blocks)]
    return hours[still], norms[0], norms[1]


def two_panels(titles: tuple[str, str], label: str) -> tuple[Any, Any]:
    """Return a figure with two panels side by side, over hours."""
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.2), sharey=True, layout="constrained")
    for axis, title in zip(axes, titles, strict=True):
        axis.set(title=title, xlabel="hours")
        axis.grid(alpha=0.3)
    axes[0].set_ylabel(label)
    return figure, axes


def save(figure: Any, name: str) -> None:
    """Save a figure among the documents."""
    figure.savefig(ROOT / "docs" / name, dpi=110, metadata={"Software": None})


def norms(raw: pd.DataFrame, result: Any, titles: tuple[str, str]) -> Any:
    """Draw |a| of the still windows before and after; return the figure and its panels."""
    columns = ["x", "y", "z"]
    hours, *both = still_norms(raw[columns].to_numpy(), result.to_pandas()[columns].to_numpy(np.float64))
    figure, axes = two_panels(titles, "|a| of still windows [g]")
    for axis, values, colour in zip(axes, both, ("tab:red", "tab:blue"), strict=True):
        axis.axhline(1, color="black", linewidth=0.8)
        axis.plot(hours, values, ".", markersize=2.5, color=colour)
    return figure, axes


def before_after(raw: pd.DataFrame) -> None:
    """Draw the sample recording before and after its calibration."""
    result = accelcal.calibrate(SAMPLE)
    error = result.report["calibration_error_mg"]
    titles = f"before: {error['before']:.0f} mg", f"after: {error['mean']:.2f} mg over all orientations"
    save(norms(raw, result, titles)[0], "before_after.png")


def step(raw: pd.DataFrame) -> None:
    """Draw the sample recording with a step in a sensor, calibrated once and as the step is followed."""
    stepped = raw.copy()
    at = len(stepped) // 2
    stepped.loc[stepped.index[at:], "z"] += STEP_G
    once = accelcal.calibrate(stepped, recalibrate="never")
    followed = accelcal.calibrate(stepped)
    change = followed.report["change"]["holdout"]
    titles = (
        f"one calibration: {change['constant_mg']:.1f} mg",
        f"the step is followed: {change['changing_mg']:.1f} mg",
    )
    columns = ["x", "y", "z"]
    figure, axes = two_panels(titles, "|a| of still windows [g]")
    for axis, result in zip(axes, (once, followed), strict=True):
        values = result.to_pandas()[columns].to_numpy(np.float64)
        hours, _, after = still_norms(stepped[columns].to_numpy(), values)
        axis.axhline(1, color="black", linewidth=0.8)
        axis.axvline(at / RATE_HZ / 3600, color="tab:red", linestyle="--")
        axis.plot(hours, after, ".", markersize=2.5, color="tab:blue")
    save(figure, "step.png")


def enmo(raw: pd.DataFrame) -> None:
    """Draw ENMO of the sample recording's epochs, raw and calibrated."""
    both = [epochs_mg(table) for table in (raw, accelcal.calibrate(SAMPLE).to_pandas())]
    hours = np.arange(len(both[0])) * WINDOW_S / 3600
    before, after = (values.mean() for values in both)
    titles = f"raw: {before:.0f} mg on average", f"calibrated: {after:.1f} mg on average"
    figure, axes = two_panels(titles, "ENMO [mg]")
    for axis, values, colour in zip(axes, both, ("tab:red", "tab:blue"), strict=True):
        axis.plot(hours, values, linewidth=0.8, color=colour)
    axes[0].set_ylim(0, 150)
    save(figure, "enmo.png")


def epochs_mg(table: pd.DataFrame) -> np.ndarray:
    """Return ENMO [mg] of each window of a table of even rate."""
    rows = WINDOW_S * RATE_HZ
    over = np.maximum(np.linalg.norm(table[["x", "y", "z"]].to_numpy(np.float64), axis=1) - 1, 0)
    return 1000 * over[: len(over) // rows * rows].reshape(-1, rows).mean(axis=1)


def main() -> None:
    """Draw and save."""
    raw = accelcal.read(SAMPLE).to_pandas()
    before_after(raw)
    step(raw)
    enmo(raw)


if __name__ == "__main__":
    main()
