"""Write build/validation.md: accuracy, coverage of intervals and hours of wear, measured here and now.

Each part is a command that anyone can run alone. Recordings are those of sample_data and, where it is, of
../shared/data (or $ACCELCAL_REAL_DATA). A part that fails is marked as failed, and the exit code is then 1.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
REAL = Path(os.environ.get("ACCELCAL_REAL_DATA", ROOT.parent / "shared" / "data"))
POINTS = REAL / "points" / "geneactiv_84h_points.csv.gz"
PAGE = ROOT / "build" / "validation.md"
METHODS = "fixed32,gauss-newton,ellipsoid,closest-point"
ACCELCAL = ("-m", "accelcal_cli")


@dataclass(frozen=True, slots=True)
class Part:
    """One part of the page: its title, what it shows, and the command after `python`."""

    title: str
    text: str
    command: tuple[str, ...]


def parts() -> Iterator[Part]:
    """Yield the parts that the data allow."""
    held_out = (
        "Mean |r - 1| on held-out orientations, before and after, by methods that fit the same points. "
    )
    peers = (
        "`closest-point` is the autocalibration of van Hees et al. 2014 as in GGIR, `ellipsoid` the paper's "
        "non-iterative method."
    )
    yield Part(
        "Accuracy on held-out orientations",
        held_out + peers,
        (*ACCELCAL, "evaluate", "methods", *map(str, recordings()), "--only", METHODS, "-q"),
    )
    yield Part(
        "Table 3 of the paper",
        "The paper's procedure: 18 points, and control points that took no part.",
        (*ACCELCAL, "evaluate", "methods", "sample_data", "--profile", "paper", "--only", METHODS, "-q"),
    )
    if POINTS.exists():
        table = (str(POINTS), "--table-hours", "84", "--number", "6", "-q")
        yield Part(
            "Held-out stretches",
            "Segments of a recording of 84 h, each compared with the rest of it.",
            (*ACCELCAL, "evaluate", "segments", *table, "--hours", "6,12,24"),
        )
        yield Part(
            "Hours of wear",
            "The same over all orientations, with the share that is usable.",
            (*ACCELCAL, "evaluate", "duration", *table, "--hours", "3,6,12,24"),
        )
    yield Part(
        "Coverage of calibration_error_mg",
        "How often the 95 % interval holds the true error of simulated sensors.",
        ("-m", "tests.laboratory.coverage", "20"),
    )
    yield Part(
        "Coverage of measures of activity",
        "How often the 95 % interval holds what the true parameters show [%].",
        ("-m", "tests.laboratory.test_activity_intervals", "24"),
    )


def recordings() -> list[Path]:
    """Return the recordings that methods are compared on."""
    names = ("actigraph_30hz_12h.csv.gz", "actigraph_gt3xplus_30hz_9h.csv.gz", "ax3_sacrum_100hz_3h.cwa")
    real = [path for name in names if (path := REAL / "vendor" / name).exists()]
    return [Path("sample_data") / name for name in ("recording.bin", "night.h5")] + real


def shown(part: Part) -> tuple[str, bool]:
    """Run a part's command and return its section, and True if it failed."""
    begun = time.monotonic()
    words = [sys.executable, *part.command]
    ran = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    said = ran.stdout.strip() or "(nothing)"
    why = f"\n\n**Failed** with exit code {ran.returncode}: {ran.stderr.strip()[-400:]}"
    failed = why if ran.returncode else ""
    line = " ".join(part.command).replace("-m accelcal_cli", "accelcal").replace(f"{REAL}/", "")
    seconds = f"{time.monotonic() - begun:.0f} s"
    return f"## {part.title}\n\n{part.text}\n\n```\n{said}\n```\n\n`{line}` ({seconds}){failed}\n", bool(
        failed
    )


def main() -> int:
    """Write the page, part by part, so that a slow part does not hold up the others; return the exit code."""
    PAGE.parent.mkdir(exist_ok=True)
    sections, failures = ["# Validation\n"], 0
    for part in parts():
        print(part.title, flush=True)
        section, failed = shown(part)
        sections.append(section)
        failures += failed
        PAGE.write_text("\n".join(sections), encoding="utf-8")
    print(PAGE)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
