"""The methods that are compared: accelcal, six parameters, and other tools where they are installed.

Each gets pieces of recordings and returns a calibration for each, or None where its own rule accepts none.
Other tools run in a Python of their own: bench_data/peers (`make bench_data/peers/.ready`), $ACCELCAL_PEERS,
or the one that runs this.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import accelcal
from tools.validation.found import RAW, Found
from tools.validation.samples import Piece, Real
from tools.validation.six_parameters import autocalibrated

ROOT = Path(__file__).resolve().parent.parent.parent
DAY = np.datetime64("2026-01-05T00:00:00.000000")

ACTIPY = """
def run(held, rate):
    import pandas, actipy.processing
    frame = pandas.DataFrame(held["xyz"], columns=list("xyz"), index=pandas.to_datetime(held["time"]))
    frame.index.name = "time"
    if "celsius" in held:
        frame["temperature"] = held["celsius"]
    data, info = actipy.processing.calibrate_gravity(frame)
    return data[["x", "y", "z"]].to_numpy() if info["CalibOK"] else None
"""

SKDH = """
def run(held, rate):
    import warnings, numpy
    from skdh.preprocessing import CalibrateAccelerometer
    more = {"temperature": held["celsius"]} if "celsius" in held else {}
    seconds = held["time"].astype("datetime64[us]").astype(float) / 1e6
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        given = held["xyz"].copy()
        made = CalibrateAccelerometer(min_hours=12).predict(time=seconds, accel=given, fs=rate, **more)
    refused = any("alibration" in str(one.message) for one in said)
    return None if refused else made.get("accel")
"""

AROUND = """
import json, sys, numpy
{run}
def coefficients(path):
    held = dict(numpy.load(path))
    made = run(held, float(held["rate"]))
    if made is None:
        return None
    some = numpy.linspace(0, len(made) - 1, 5000).astype(int)
    columns = [numpy.ones(len(some)), *([held["celsius"][some]] if "celsius" in held else [])]
    found = []
    for axis in range(3):
        table = numpy.column_stack([held["xyz"][some, axis], *columns])
        found.append(numpy.linalg.lstsq(table, made[some, axis], rcond=None)[0].tolist())
    return found
print(json.dumps([coefficients(path) for path in sys.argv[1:]]))
"""


@dataclass(frozen=True)
class Method:
    """A method: its name in tables, what it does with pieces, and whether it can take tables of rests."""

    name: str
    calibrate: Callable[[Sequence[Piece]], list[Found | None]]
    takes_rests: bool = False


def methods() -> list[Method]:
    """Return those that can run here, accelcal first."""
    own = [Method("accelcal", _ours, takes_rests=True), Method("six parameters", _six, takes_rests=True)]
    python = peers_python()
    others = (("actipy", ACTIPY), ("skdh", SKDH))
    return own + [
        Method(name, partial(_peer, python, script)) for name, script in others if installed(python, name)
    ]


def peers_python() -> Path:
    """Return the Python that may have the other tools."""
    there = ROOT / "bench_data" / "peers" / "bin" / "python"
    return Path(os.environ.get("ACCELCAL_PEERS") or (there if there.exists() else sys.executable))


def installed(python: Path, module: str) -> bool:
    """Return whether a module can be imported."""
    done = subprocess.run([str(python), "-c", f"import {module}"], capture_output=True, check=False)
    return done.returncode == 0


def _six(pieces: Sequence[Piece]) -> list[Found | None]:
    return [autocalibrated(piece) for piece in pieces]


def _ours(pieces: Sequence[Piece]) -> list[Found | None]:
    return [_found(piece) for piece in pieces]


def _found(piece: Piece) -> Found | None:
    """Return what `accelcal` makes of a piece, raw values where it says that these are good already."""
    columns = dict(zip("xyz", piece.xyz.T, strict=True))
    if piece.celsius is not None:
        columns["temperature" if piece.rate_hz else "temperature_c"] = piece.celsius
    result = accelcal.calibrate(columns | {"time": times(piece)}, unit="g") if piece.rate_hz else None
    report = accelcal.fit(columns) if result is None else result
    if not report.usable:
        return None
    said = report["calibration_error_mg"]
    claimed = (said["mean"], *said["ci95"]) if said else None
    made = report["calibration"]
    if made is None:
        return Found(RAW.matrix, RAW.constant, RAW.per_c, claimed)
    fit = report.calibration
    reference = fit.reference_temperature or 0.0
    return Found(fit.gain, fit.gain @ (fit.offset - fit.slope * reference), fit.gain @ fit.slope, claimed)


def times(piece: Piece) -> np.ndarray:
    """Return the times of the samples as dates."""
    return DAY + np.rint(piece.seconds * 1e6).astype("timedelta64[us]")


def _peer(python: Path, script: str, pieces: Sequence[Piece]) -> list[Found | None]:
    """Run another tool on pieces; its coefficients follow from what it makes of the values."""
    with TemporaryDirectory() as place:
        paths = [Path(place) / f"{number}.npz" for number in range(len(pieces))]
        for path, piece in zip(paths, pieces, strict=True):
            warm = {} if piece.celsius is None else {"celsius": piece.celsius}
            np.savez(path, time=times(piece), xyz=piece.xyz, rate=piece.rate_hz, **warm)
        words = [str(python), "-c", AROUND.replace("{run}", script), *map(str, paths)]
        done = subprocess.run(words, capture_output=True, text=True, check=True)
    return [_as_found(one) for one in json.loads(done.stdout.splitlines()[-1])]


def _as_found(rows: list[list[float]] | None) -> Found | None:
    if rows is None:
        return None
    held: Real = np.array([[*row, 0.0][:3] for row in rows])
    return Found(np.diag(held[:, 0]), held[:, 1], held[:, 2])
