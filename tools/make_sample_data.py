"""Remake sample_data/: three small simulated recordings and the truth about them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parent.parent / "sample_data"
SLOPE_MG_PER_C = ("0.8", "-0.5", "0.6")
RECORDINGS = (
    ("recording", "flash", ["--days", "0.3", "--rate", "25", "--seed", "11"]),
    ("evening", "csv", ["--days", "0.15", "--rate", "20", "--seed", "12", "--no-temperature"]),
    (
        "night",
        "hdf5",
        ["--days", "0.3", "--rate", "25", "--seed", "13", "--temp-slope", *SLOPE_MG_PER_C],
    ),
)


def main() -> None:
    """Run `accelcal simulate` for each recording."""
    FOLDER.mkdir(exist_ok=True)
    for name, format_name, options in RECORDINGS:
        words = ["simulate", str(FOLDER / name), "--format", format_name, "--force", *options]
        subprocess.run([sys.executable, "-m", "accelcal_cli", *words], check=True)


if __name__ == "__main__":
    main()
