"""Write build/validation.md: accelcal beside other methods, coverage of intervals, and hours of wear.

Recordings are those of sample_data, what can be simulated, and what there is of ../shared/data (or
$ACCELCAL_REAL_DATA). A part that fails is marked as failed, and the exit code is then 1. Tables of
docs/compared.md that differ from those measured are named; `--docs` puts the measured ones there.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from tools.validation.methods import ROOT, Method, methods
from tools.validation.samples import read, table
from tools.validation.tables import (
    Table,
    held_out,
    held_out_stretches,
    known_truth,
    simulated,
    speed,
    two_devices,
)

REAL = Path(os.environ.get("ACCELCAL_REAL_DATA", ROOT.parent / "shared" / "data"))
POINTS = REAL / "points" / "geneactiv_84h_points.csv.gz"
PAGE = ROOT / "build" / "validation.md"
DOCS = ROOT / "docs" / "compared.md"
SAMPLES = ("recording.bin", "night.h5", "evening.csv.gz")
VENDOR = (
    "zio_chest_1.56hz_14d.csv.gz",
    "gt3x_link_30hz_14h.gt3x",
    "actigraph_30hz_12h.csv.gz",
    "actigraph_gt3xplus_30hz_9h.csv.gz",
    "ax3_sacrum_100hz_3h.cwa",
    "gt3x_link_30hz_3h.gt3x",
)
ACCELCAL = ("-m", "accelcal_cli")
MACHINE = ("speed",)
"""Tables whose figures depend on the machine."""


@dataclass(frozen=True)
class Part:
    """One part of the page: its title, and how it is made, as text."""

    title: str
    make: Callable[[], str | Table]


def parts(using: Sequence[Method], folder: Path) -> Iterator[Part]:
    """Yield the parts that the data allow."""
    pieces = [read(path) for path in recordings()]
    if POINTS.exists():
        pieces.append(table(POINTS, 84))
    yield Part("Orientations held out", partial(held_out, pieces, using))
    long = [piece for piece in pieces if piece.hours > 8]
    if long:
        yield Part("Stretches held out", partial(held_out_stretches, long, using, (3, 6, 24)))
    worn = (simulated(folder, 2, seed) for seed in (1, 2, 3))
    yield Part("Sensors whose truth is known", partial(known_truth, worn, using, (6, 12, 24, 48)))
    both = ((simulated(folder, 1, seed, 10), simulated(folder, 1, seed, 11 + seed)) for seed in (1, 2, 3))
    yield Part("Two devices, one movement", partial(two_devices, both, using))
    yield Part("Speed", partial(speed, folder, sys.executable))
    yield from commands()


def recordings() -> list[Path]:
    """Return the recordings that are there."""
    real = [path for name in VENDOR if (path := REAL / "vendor" / name).exists()]
    return [ROOT / "sample_data" / name for name in SAMPLES] + real


def commands() -> Iterator[Part]:
    """Yield the parts that are commands which anyone can run alone."""
    paper = ("sample_data", "--profile", "paper", "--only", "fixed32,gauss-newton,ellipsoid,closest-point")
    yield Part("Table 3 of the paper", partial(_said, (*ACCELCAL, "evaluate", "methods", *paper, "-q")))
    if POINTS.exists():
        hours = (str(POINTS), "--table-hours", "84", "--number", "6", "--hours", "3,6,12,24", "-q")
        yield Part("Hours of wear", partial(_said, (*ACCELCAL, "evaluate", "duration", *hours)))
    coverage = ("-m", "tests.laboratory.coverage", "20")
    yield Part("How often the interval of `calibration_error_mg` holds", partial(_said, coverage))
    activity = ("-m", "tests.laboratory.test_activity_intervals", "24")
    yield Part("How often intervals of measures of activity hold [%]", partial(_said, activity))


def _said(words: tuple[str, ...]) -> str:
    """Run a command of Python and return what it prints."""
    ran = subprocess.run([sys.executable, *words], cwd=ROOT, capture_output=True, text=True, check=False)
    if ran.returncode:
        raise RuntimeError(f"exit code {ran.returncode}: {ran.stderr.strip()[-400:]}")
    line = " ".join(words).replace("-m accelcal_cli", "accelcal").replace(f"{REAL}/", "")
    return f"`{line}`:\n\n```\n{ran.stdout.strip()}\n```"


def section(part: Part, tables: list[Table]) -> tuple[str, bool]:
    """Make a part and return its section, and True if it failed."""
    begun, failed = time.monotonic(), False
    try:
        made = part.make()
        text = made if isinstance(made, str) else f"{made.text}\n\n{made.markdown()}"
        tables += [made] if isinstance(made, Table) else []
    except Exception as error:
        traceback.print_exc()
        text, failed = f"**Failed**: {error}", True
    return f"## {part.title}\n\n{text}\n\n({time.monotonic() - begun:.0f} s)\n", failed


def main(arguments: Sequence[str]) -> int:
    """Write the page, part by part, so that a slow part does not hold up the others; return the exit code."""
    PAGE.parent.mkdir(exist_ok=True)
    using = methods()
    missing = [name for name in ("actipy", "skdh") if name not in {one.name for one in using}]
    absent = f"Not installed here, and left out: {', '.join(missing)}.\n" if missing else ""
    real = "" if REAL.exists() else f"There are no real recordings in {REAL}; those parts are left out.\n"
    sections, failures, tables = ["# Validation\n", absent, real], 0, list[Table]()
    with TemporaryDirectory() as folder:
        for part in parts(using, Path(folder)):
            print(part.title, flush=True)
            text, failed = section(part, tables)
            sections.append(text)
            failures += failed
            PAGE.write_text("\n".join(filter(None, sections)), encoding="utf-8")
    print(PAGE)
    compare(tables, replace="--docs" in arguments)
    return 1 if failures else 0


def block(name: str) -> re.Pattern[str]:
    """Return the pattern of a table of the docs between its two comments."""
    return re.compile(rf"(<!-- make validation: {name} -->\n\n)(.*?)(\n\n<!-- end -->)", re.DOTALL)


def compare(tables: Sequence[Table], *, replace: bool) -> None:
    """Name the tables of the docs that differ from those measured, or put these there."""
    text = DOCS.read_text(encoding="utf-8")
    for one in tables:
        there = block(one.name).search(text)
        if there is None or there[2] == one.markdown():
            continue
        if not replace and one.markdown().splitlines()[0] != there[2].splitlines()[0]:
            continue  # other tools were installed then
        if replace:
            text = text.replace(there[0], f"{there[1]}{one.markdown()}{there[3]}")
        elif one.name not in MACHINE:
            print(f"docs/compared.md differs from what was measured: {one.name}")
    if replace:
        DOCS.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
