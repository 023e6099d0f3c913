"""`accelcal evaluate`: comparisons and the papers' tables, each part imported only when it is run."""

from __future__ import annotations

from accelcal_cli.cli.main import LazyGroup

PARTS = {
    "simulation": "Every optimizer on sensors with known errors (Table 2 in the paper).",
    "methods": "Every optimizer on the same points of each recording (Table 3 in the paper).",
    "stillness": "Every stillness rule on the same recordings.",
    "segments": "Calibrate segments, and compare their error estimates with the rest of the recording.",
    "duration": "Calibration error by hours of wear, and how many hours a refused recording lacks.",
    "homogeneity": "Compare devices that were moved together, raw and calibrated.",
    "smoothing": "Noise at rest after a rolling mean or median (Table 1 of Grammenos et al. 2018).",
    "gravity": "Standard versus local gravity (Table 8 of Grammenos et al. 2018).",
}
"""One-line help of each command, whose module of the laboratory has its name and binds `command`."""

command = LazyGroup(
    "evaluate",
    parts=PARTS,
    modules="accelcal_cli.laboratory.",
    help="Compare methods and stillness rules; reproduce the published tables.",
    no_args_is_help=False,
)
