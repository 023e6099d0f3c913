"""`STEM.quality.json`: a recording along its time, and its points, as numbers for figures.

Columns of numbers, so that two weeks and the most points that there can be fit into 200 KB. It depends on the
recording, the settings and the version alone.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.clock import iso_time
from accelcal_cli.core.identity import QUALITY, identity
from accelcal_cli.core.points import WEIGHT_ONE, PointSet
from accelcal_cli.core.results import Holdout, TimeRows
from accelcal_cli.output.files import json_text
from accelcal_cli.output.report import ReportInput

UNITS = {
    "x": "0.001 g",
    "y": "0.001 g",
    "z": "0.001 g",
    "temperature": "0.1 C",
    "before": "0.01 mg",
    "after": "0.01 mg",
    "weight": "0.001",
}
"""Unit of the whole numbers in each column of `points`."""

SIZE, OFF = {"mean": 0, "p95": 1}, {"p5": 2, "p50": 3, "p95": 4}
"""Inner columns of errors in `rows`, by their places in `Errors`."""


Errors = tuple[float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class BlockErrors:
    """Errors of still windows in a block of time [mg], before and after calibration.

    Each is mean and 95th percentile of | |a| - 1 g |, then the 5th, 50th and 95th percentile of |a| - 1 g.

    Attributes:
        windows: how many there are; after: None without a calibration.
    """

    windows: int
    before: Errors
    after: Errors | None


@dataclass(frozen=True, slots=True, eq=False)
class PointErrors:
    """The n points, with their errors.

    Attributes:
        points: raw points, in units of local gravity.
        before_mg, after_mg: (n,) |a| - 1 g; after: None without a calibration.
        posture: (n,) number of the posture that each belongs to.
        celsius: (n,) temperatures, or None.
    """

    points: PointSet
    before_mg: NDArray[np.float64]
    after_mg: NDArray[np.float64] | None
    posture: NDArray[np.int64]
    celsius: NDArray[np.float64] | None


@dataclass(frozen=True, slots=True, eq=False)
class QualityInput:
    """Everything that the document is made of.

    Attributes:
        rows: of b blocks of time; begun_us: when each of them begins, on the device's clock.
        errors: errors by the number of the block, for blocks with still windows.
        folds: number of parts of the postures that were held out in turn; None if none were.
        convergence: error of the fitted points [mg], of the ideal sensor and after each step of the fit; None
            where the fit kept no record of its steps.
    """

    data: ReportInput
    rows: TimeRows
    begun_us: Sequence[int]
    errors: Mapping[int, BlockErrors]
    points: PointErrors
    folds: int | None
    convergence: tuple[float, ...] | None = None


def quality_json(made: QualityInput) -> dict[str, Any]:
    """Return the document."""
    data = made.data
    judgement, rate_hz = data.judgement, data.recording.rate_hz
    return {
        **identity(QUALITY),
        "sha256": data.sha256,
        "outcome": str(judgement.outcome),
        "model": None if judgement.calibration is None else judgement.calibration.model,
        "row": {
            "samples": made.rows.block_samples,
            "seconds": round(made.rows.block_samples / rate_hz, 6),
            "rate_hz": rate_hz,
        },
        "rows": rows_json(made),
        "units": UNITS,
        "points": _points(made.points),
        "postures": _postures(judgement.holdout, made.folds),
        "convergence": None if made.convergence is None else [round(mg, 4) for mg in made.convergence],
    }


def rows_json(made: QualityInput) -> dict[str, Any]:
    """Return the columns of the blocks of time."""
    rows, offset_s = made.rows, made.data.facts.utc_offset_s
    errors = [made.errors.get(number) for number in range(len(rows))]
    calibrated = made.data.judgement.calibration is not None
    return {
        "start": [iso_time(begun, offset_s) for begun in made.begun_us],
        "samples": list(rows.samples),
        "still": list(rows.still),
        "moving": list(rows.moving),
        "windows": [0 if one is None else one.windows for one in errors],
        "before_mg": _columns(errors, lambda one: one.before, SIZE),
        "after_mg": _columns(errors, lambda one: one.after, SIZE) if calibrated else None,
        "before_off_mg": _columns(errors, lambda one: one.before, OFF),
        "after_off_mg": _columns(errors, lambda one: one.after, OFF) if calibrated else None,
        "temperature_c": [None if heat is None else round(heat / 1000, 2) for heat in rows.temperature_mc],
        "gap_s": [_short(us / 1e6) for us in rows.gap_us],
        "filled": list(rows.filled),
        "clipped": list(rows.clipped),
        "recovered": list(rows.recovered),
        "lost_bytes": list(rows.lost_bytes),
        "worn": list(rows.worn),
    }


def _columns(
    errors: Sequence[BlockErrors | None], of: Callable[[BlockErrors], Errors | None], names: dict[str, int]
) -> dict[str, list[float | None]]:
    """Return some errors of each block, by their places in `Errors`; None without still windows."""
    rows = [None if one is None else of(one) for one in errors]
    return {
        name: [None if one is None else round(one[place], 2) for one in rows] for name, place in names.items()
    }


def _short(seconds: float) -> float | int:
    """Round a length of time; nearly all are 0, and whole numbers are shorter in JSON."""
    shown = round(seconds, 3)
    return int(shown) if shown == int(shown) else shown


def _points(made: PointErrors) -> dict[str, Any]:
    points = made.points
    x, y, z = (_whole(points.xyz[:, axis] / ONE * 1000) for axis in range(3))
    return {
        "x": x,
        "y": y,
        "z": z,
        "windows": points.windows.tolist(),
        "weight": _whole(points.weights / WEIGHT_ONE * 1000),
        "temperature": None if made.celsius is None else _whole(10 * made.celsius),
        "posture": made.posture.tolist(),
        "before": _whole(100 * made.before_mg),
        "after": None if made.after_mg is None else _whole(100 * made.after_mg),
    }


def _whole(values: NDArray[np.float64]) -> list[int]:
    numbers: list[int] = np.rint(values).astype(np.int64).tolist()
    return numbers


def _postures(holdout: Holdout | None, folds: int | None) -> dict[str, Any] | None:
    """Return the errors of each posture where it took no part in the fit."""
    if holdout is None:
        return None
    before, after = ([round(pair[place], 2) for pair in holdout.per_posture] for place in range(2))
    return {"method": holdout.method, "folds": folds, "before_mg": before, "after_mg": after}


def dumps_quality(document: Mapping[str, Any]) -> str:
    """Write the document as text: a line for each key, without further blanks."""
    texts = {key: json_text(value, separators=(",", ":")) for key, value in document.items()}
    return "{" + ",\n".join(f"{json.dumps(key)}:{text}" for key, text in texts.items()) + "}\n"


def wear_hours(quality: Mapping[str, Any]) -> float | None:
    """Return the hours of NAME.quality.json in which the device was worn; None if that is not known."""
    try:
        rate_hz, rows = float(quality["row"]["rate_hz"]), quality["rows"]
        pairs = list(zip(rows["worn"], map(int, rows["samples"]), strict=True))
    except (KeyError, TypeError, ValueError):
        return None
    if not rate_hz or all(worn is None for worn, _ in pairs):
        return None
    return round(sum(samples for worn, samples in pairs if worn) / rate_hz / 3600, 2)
