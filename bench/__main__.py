"""`make bench`: whole processes against the floor, and against other tools where they are installed.

Recordings are made once by `accelcal simulate` into the folder of the benchmark. Ratios are of runs in turn
on the same machine, each of which begins without what the same command wrote before; they are what matters.
"""

from __future__ import annotations

import argparse
import gzip
import json
import os
import platform
import shutil
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from accelcal_cli.cli.output import aligned
from accelcal_cli.core.version import __version__
from bench.peers import peer_commands
from bench.process import Command, Timing, run, timed

PYTHON = sys.executable
ACCELCAL = [PYTHON, "-m", "accelcal_cli"]
FLOOR, OURS, REPORT_ONLY = "floor", "accelcal", "accelcal --report-only"

REST_S = 20
"""Twice as long as accelcal is slower after scikit-digital-health (bench/LOG.md)."""

OTHER = {"other": OURS, "other --report-only": REPORT_ONLY}
"""Runs of another version, and what they are compared with."""


@dataclass(frozen=True, slots=True)
class Case:
    """One recording.

    Attributes:
        floor: the floor's name of the format.
        writes: whether the floor writes Parquet too, or only reads and decodes.
    """

    name: str
    format: str
    suffix: str
    floor: str
    writes: bool


CASES = (
    Case("cwa", "cwa", ".cwa", "cwa", writes=True),
    Case("gt3x", "gt3x", ".gt3x", "gt3x", writes=False),
    Case("geneactiv", "geneactiv", ".bin", "geneactiv", writes=False),
    Case("flash", "flash", ".bin", "flash", writes=True),
    Case("raw", "raw", ".raw", "raw", writes=True),
    Case("hdf5", "hdf5", ".h5", "hdf5", writes=False),
    Case("csv", "csv", ".csv", "csv", writes=False),
    Case("csv.gz", "csv", ".csv.gz", "csv", writes=False),
)


def main() -> None:
    """Time what is asked for, print a table, write it as JSON."""
    options = _options()
    for folder in (options.folder, options.json.parent):
        folder.mkdir(parents=True, exist_ok=True)
    chosen = [case for case in CASES if not options.only or case.name in options.only.split(",")]
    rows = [row for case in chosen for row in _rows(case, options)]
    head = ("run", "wall s", "least", "most", "CPU s", "MB", "of floor", "of accelcal")
    print(aligned(head, [_cells(row) for row in rows]))
    shown = {"machine": _machine(), "days": options.days, "rate_hz": options.rate, "rows": rows}
    options.json.write_text(json.dumps(shown, indent=2) + "\n")
    print(f"\nWritten: {options.json}")


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench")
    parser.add_argument("--folder", type=Path, default=Path("bench_data"))
    parser.add_argument("--days", type=float, default=7)
    parser.add_argument("--rate", type=float, default=100)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--only", help="names of cases, separated by commas")
    parser.add_argument("--peers", type=Path, help="python of a venv with actipy and scikit-digital-health")
    parser.add_argument("--against", type=Path, help="python of a venv with another version of accelcal")
    parser.add_argument("--json", type=Path, default=Path("bench_data/latest.json"))
    return parser.parse_args()


def recording(case: Case, options: argparse.Namespace) -> Path:
    """The recording of a case, made if it is not there yet."""
    folder = options.folder / f"{case.name}_{options.days:g}d_{options.rate:g}hz"
    path: Path = folder / f"week{case.suffix}"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        made = ["--format", case.format, "--days", f"{options.days:g}", "--rate", f"{options.rate:g}"]
        packed = path.with_name(path.name + ".gz") if case.suffix == ".csv" else path
        run(Command([*ACCELCAL, "simulate", str(packed), *made, "--seed", "3", "--force", "-q"]))
        if packed != path:
            _unpack(packed, path)
    return path


def _unpack(packed: Path, path: Path) -> None:
    with gzip.open(packed) as source, path.open("wb") as target:
        shutil.copyfileobj(source, target, 1 << 20)
    packed.unlink()


def _rows(case: Case, options: argparse.Namespace) -> list[dict[str, Any]]:
    """The rows of a case: what is timed in turn with the floor, and then in turn with each other tool."""
    path = recording(case, options)
    ours = {
        OURS: _calibrate(ACCELCAL, case, path),
        REPORT_ONLY: _calibrate(ACCELCAL, case, path, "--report-only"),
    }
    rows = _beside_floor(case, path, ours, options)
    return rows if options.peers is None else rows + _beside_peers(case, path, ours, options)


def _beside_floor(
    case: Case, path: Path, ours: Mapping[str, Command], options: argparse.Namespace
) -> list[dict[str, Any]]:
    """The floor, this version, and another one if there is one."""
    floor, to = [PYTHON, "-m", "bench.floor", case.floor, str(path)], path.parent / "floor.parquet"
    commands = {FLOOR: Command([*floor, str(to)], to) if case.writes else Command(floor), **ours}
    if options.against:
        other = [str(options.against), "-P", "-m", "accelcal_cli"]
        commands["other"] = _calibrate(other, case, path)
        commands["other --report-only"] = _calibrate(other, case, path, "--report-only")
    found = timed(commands, options.runs)
    rows = []
    for name, timing in found.items():
        beside = {"of_accelcal": timing.wall_s / found[OTHER[name]].wall_s} if name in OTHER else {}
        rows.append(_row(case, name, timing, of_floor=timing.wall_s / found[FLOOR].wall_s, **beside))
    return rows


def _beside_peers(
    case: Case, path: Path, ours: Mapping[str, Command], options: argparse.Namespace
) -> list[dict[str, Any]]:
    """Each other tool, and this one in turn with it alone.

    What ran before matters (bench/LOG.md), so both rest before they run.
    """
    rows = []
    for tool, peer in peer_commands(options.peers, case.name, path).items():
        name = OURS if peer.makes else REPORT_ONLY
        beside, theirs = timed({name: ours[name], tool: peer}, options.runs, REST_S).values()
        rows.append(_row(case, f"{name}, with {tool}", beside))
        rows.append(_row(case, tool, theirs, of_accelcal=theirs.wall_s / beside.wall_s))
    return rows


def _calibrate(program: Sequence[str], case: Case, path: Path, *more: str) -> Command:
    """Calibrate into a folder that is not there yet."""
    to = path.parent / "out"
    return Command(
        [*program, "calibrate", str(path), "-d", str(to), "--format", case.format, "-q", *more], to
    )


def _row(case: Case, name: str, timing: Timing, **ratios: float) -> dict[str, Any]:
    """A row, with ratios to what was timed in turn with it."""
    rounded = {ratio: round(value, 2) for ratio, value in ratios.items()}
    return {"run": f"{case.name}: {name}", **timing.as_json(), **rounded}


def _cells(row: dict[str, Any]) -> list[str]:
    seconds = [f"{row[key]:.2f}" for key in ("wall_s", "wall_least_s", "wall_most_s", "cpu_s")]
    ratios = [f"{row[key]:.2f}" if key in row else "" for key in ("of_floor", "of_accelcal")]
    return [row["run"], *seconds, f"{row['memory_mb']:.0f}", *ratios]


def _machine() -> dict[str, Any]:
    return {
        "time": datetime.now(UTC).isoformat(timespec="minutes"),
        "accelcal": __version__,
        "python": platform.python_version(),
        "processor": platform.processor() or platform.machine(),
        "cpus": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
    }


if __name__ == "__main__":
    main()
