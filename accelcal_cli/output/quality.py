"""`STEM.quality.json`: a recording along its time, and its points, as numbers for figures.

Columns of numbers, so that two weeks and the most points that there can be fit into 200 KB. It depends on the
recording, the settings and the version alone.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.clock import iso_time
from accelcal_cli.core.declared import SHA256, Key, as_json, schema_of
from accelcal_cli.core.identity import QUALITY, SCHEMA_VERSION, identity
from accelcal_cli.core.points import WEIGHT_ONE, PointSet
from accelcal_cli.core.results import Holdout, Outcome, TimeRows
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

Counts = list[int]
Numbers = list[float | None]
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


@dataclass(frozen=True, slots=True)
class RowLength:
    """`row`."""

    samples: Annotated[int, Key("Samples of a row", least=1)]
    seconds: Annotated[float, Key("Length of a row", "s", positive=True, digits=6)]
    rate_hz: Annotated[float, Key("Sampling rate", "Hz", positive=True)]


@dataclass(frozen=True, slots=True)
class Sizes:
    """`rows.before_mg`: without a sign."""

    mean: Annotated[Numbers, Key("Means", digits=2)]
    p95: Annotated[Numbers, Key("95th percentiles", digits=2)]


@dataclass(frozen=True, slots=True)
class Percentiles:
    """`rows.before_off_mg`: with their sign."""

    p5: Annotated[Numbers, Key("5th percentiles", digits=2)]
    p50: Annotated[Numbers, Key("Medians", digits=2)]
    p95: Annotated[Numbers, Key("95th percentiles", digits=2)]


@dataclass(frozen=True, slots=True)
class RowColumns:
    """`rows`."""

    start: Annotated[Sequence[str], Key("Time of the first sample of each row")]
    samples: Annotated[Counts, Key("Number of samples", least=0)]
    still: Annotated[Counts, Key("Still windows", least=0)]
    moving: Annotated[Counts, Key("Windows with movement", least=0)]
    windows: Annotated[Counts, Key("Windows whose error is known", least=0)]
    before_mg: Annotated[Sizes, Key("Error before calibration", "mg")]
    after_mg: Annotated[Sizes | None, Key("Error after calibration", "mg")]
    before_off_mg: Annotated[Percentiles, Key("|a| - 1 g before calibration", "mg")]
    after_off_mg: Annotated[Percentiles | None, Key("|a| - 1 g after calibration", "mg")]
    temperature_c: Annotated[Numbers, Key("Mean temperature", "degrees C", digits=2)]
    gap_s: Annotated[list[float], Key("Length of gaps", "s", least=0)]
    filled: Annotated[Counts, Key("Filled samples", least=0)]
    clipped: Annotated[Counts, Key("Clipped samples", least=0)]
    recovered: Annotated[Counts, Key("Samples from damaged blocks", least=0)]
    lost_bytes: Annotated[Counts, Key("Bytes that are lost", least=0)]
    worn: Annotated[list[bool | None], Key("True if the device was on a body; null if that is not known")]


@dataclass(frozen=True, slots=True)
class PointColumns:
    """`points`."""

    x: Annotated[Counts, Key("x of each point", "g")]
    y: Annotated[Counts, Key("y of each point", "g")]
    z: Annotated[Counts, Key("z of each point", "g")]
    windows: Annotated[Counts, Key("Number of windows", least=0)]
    weight: Annotated[Counts, Key("Weight in the fit", least=0)]
    temperature: Annotated[Counts | None, Key("Temperature", "degrees C")]
    posture: Annotated[Counts, Key("Number of its orientation", least=0)]
    before: Annotated[Counts, Key("|a| - 1 g before calibration", "mg")]
    after: Annotated[Counts | None, Key("|a| - 1 g after calibration", "mg")]


@dataclass(frozen=True, slots=True)
class PostureErrors:
    """`postures`: where each took no part in the fit."""

    method: Annotated[str, Key("Data that were held out")]
    folds: Annotated[int | None, Key("Number of parts that were held out in turn")]
    before_mg: Annotated[list[float], Key("Error before calibration", "mg", least=0, digits=2)]
    after_mg: Annotated[list[float], Key("Error after calibration", "mg", least=0, digits=2)]


@dataclass(frozen=True, slots=True)
class QualityView:
    """A recording along its time, and its points. Columns of a table have the same length."""

    kind: Annotated[str, Key("Kind of the file", only=QUALITY)]
    schema_version: Annotated[int, Key("Version of the form of all outputs", only=SCHEMA_VERSION)]
    accelcal_version: Annotated[str, Key("Version of accelcal that wrote the file")]
    sha256: Annotated[str, Key("SHA-256 of the recording", pattern=SHA256)]
    outcome: Annotated[
        Outcome, Key("Outcome: calibrated, provisional, reduced_model, already_good, borrowed or refused")
    ]
    model: Annotated[str | None, Key("Model that was fitted")]
    row: Annotated[RowLength, Key("Length of a row")]
    rows: Annotated[RowColumns, Key("One list for each column, with a value for each row of time")]
    units: Annotated[Mapping[str, str], Key("Unit of each column")]
    points: Annotated[PointColumns, Key("The averaged points that were fitted")]
    postures: Annotated[PostureErrors | None, Key("Error by orientation")]
    convergence: Annotated[
        Sequence[float] | None,
        Key("Mean error of the fitted points after each step", "mg", least=0, digits=4),
    ]


def quality_schema() -> dict[str, Any]:
    """Return the JSON Schema of the document."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "accelcal quality of a recording",
        "description": QualityView.__doc__,
        **schema_of(QualityView),
    }


def quality_json(made: QualityInput) -> dict[str, Any]:
    """Return the document."""
    data = made.data
    judgement, rate_hz = data.judgement, data.recording.rate_hz
    length = made.rows.block_samples
    document = QualityView(
        **identity(QUALITY),
        sha256=data.sha256,
        outcome=judgement.outcome,
        model=None if judgement.calibration is None else judgement.calibration.model,
        row=RowLength(length, length / rate_hz, rate_hz),
        rows=_rows(made),
        units=UNITS,
        points=_points(made.points),
        postures=_postures(judgement.holdout, made.folds),
        convergence=made.convergence,
    )
    return as_json(document)


def _rows(made: QualityInput) -> RowColumns:
    rows, offset_s = made.rows, made.data.facts.utc_offset_s
    errors = [made.errors.get(number) for number in range(len(rows))]
    before = _columns(errors, lambda one: one.before)
    after = None
    if made.data.judgement.calibration is not None:
        after = _columns(errors, lambda one: one.after)
    return RowColumns(
        start=[iso_time(begun, offset_s) for begun in made.begun_us],
        samples=list(rows.samples),
        still=list(rows.still),
        moving=list(rows.moving),
        windows=[0 if one is None else one.windows for one in errors],
        before_mg=Sizes(*before[:2]),
        after_mg=None if after is None else Sizes(*after[:2]),
        before_off_mg=Percentiles(*before[2:]),
        after_off_mg=None if after is None else Percentiles(*after[2:]),
        temperature_c=[None if heat is None else heat / 1000 for heat in rows.temperature_mc],
        gap_s=[_short(us / 1e6) for us in rows.gap_us],
        filled=list(rows.filled),
        clipped=list(rows.clipped),
        recovered=list(rows.recovered),
        lost_bytes=list(rows.lost_bytes),
        worn=list(rows.worn),
    )


def _columns(
    errors: Sequence[BlockErrors | None], of: Callable[[BlockErrors], Errors | None]
) -> list[Numbers]:
    """Return the columns of `Errors`, with None for blocks without still windows."""
    rows = [None if one is None else of(one) for one in errors]
    return [[None if one is None else one[place] for one in rows] for place in range(5)]


def _short(seconds: float) -> float | int:
    """Round a length of time; nearly all are 0, and whole numbers are shorter in JSON."""
    shown = round(seconds, 3)
    return int(shown) if shown == int(shown) else shown


def _points(made: PointErrors) -> PointColumns:
    points = made.points
    x, y, z = (_whole(points.xyz[:, axis] / ONE * 1000) for axis in range(3))
    return PointColumns(
        x=x,
        y=y,
        z=z,
        windows=points.windows.tolist(),
        weight=_whole(points.weights / WEIGHT_ONE * 1000),
        temperature=None if made.celsius is None else _whole(10 * made.celsius),
        posture=made.posture.tolist(),
        before=_whole(100 * made.before_mg),
        after=None if made.after_mg is None else _whole(100 * made.after_mg),
    )


def _whole(values: NDArray[np.float64]) -> list[int]:
    numbers: list[int] = np.rint(values).astype(np.int64).tolist()
    return numbers


def _postures(holdout: Holdout | None, folds: int | None) -> PostureErrors | None:
    if holdout is None:
        return None
    before, after = ([pair[place] for pair in holdout.per_posture] for place in range(2))
    return PostureErrors(holdout.method, folds, before, after)


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


if __name__ == "__main__":
    sys.stdout.write(json.dumps(quality_schema(), indent=1) + "\n")
