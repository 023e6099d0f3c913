"""Every optimizer on the same points and the same hold-out (F section III.B, Table 3)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

from accelcal_cli.core.errors import AccelcalError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.judgement import Judgement
from accelcal_cli.core.names import printable
from accelcal_cli.core.points import Fit, Model, PointSet
from accelcal_cli.core.settings import Settings
from accelcal_cli.pipeline.profiles import Procedure, fitting, make_method
from accelcal_cli.pipeline.request import DEFAULT_CHUNK_SAMPLES, ProgressMaker
from accelcal_cli.pipeline.survey import survey
from accelcal_cli.readers import open_recording

TABLE_3_OF_F = (
    ("our method", 25.1, 3.06, 820),
    ("non-iterative (Gietzelt et al.)", 25.1, 4.08, 615),
    ("MATLAB fminunc", 25.1, 3.16, 794),
    ("LabVIEW global", 25.1, 3.27, 768),
)
"""Method, error before and after [mg], improvement [%], as printed."""


@dataclass(frozen=True, slots=True)
class Row:
    """One optimizer on one recording.

    Attributes:
        message: the verdict's sentence.
        model: the model that was chosen, None where it was refused.
        before_mg, after_mg: mean held-out error.
        iterations, additions, multiplications: of the fit to all points; None where not counted.
        seconds: wall time of that fit.
    """

    recording: str
    optimizer: str
    outcome: str
    message: str
    model: str | None = None
    points: int = 0
    postures: int | None = None
    before_mg: float | None = None
    after_mg: float | None = None
    improvement_percent: float | None = None
    iterations: int | None = None
    additions: int | None = None
    multiplications: int | None = None
    seconds: float | None = None


class Timed:
    """An optimizer's fit that remembers how long its last call took."""

    def __init__(self, fit: Callable[[PointSet, Model], Fit]) -> None:
        self.fit = fit
        self.seconds = 0.0

    def __call__(self, points: PointSet, model: Model) -> Fit:
        """Fit, and take the time."""
        start = perf_counter()
        found = self.fit(points, model)
        self.seconds = perf_counter() - start
        return found


def compare(
    path: Path, options: ReadOptions, settings: Settings, optimizers: tuple[str, ...], progress: ProgressMaker
) -> Iterator[Row]:
    """One row an optimizer; the recording is read once.

    Raises:
        AccelcalError: it cannot be read.
    """
    procedure = collected(path, options, settings, progress)
    for name in optimizers:
        yield _row(path, procedure, replace(settings, optimizer=name))


def collected(path: Path, options: ReadOptions, settings: Settings, progress: ProgressMaker) -> Procedure:
    """The still windows of a recording, ready to be judged.

    Raises:
        AccelcalError: it cannot be read.
    """
    with open_recording(path, options) as reader:
        method = make_method(reader.recording, settings)
        shown = progress("reading", reader.recording.total_bytes)
        survey(reader.recording, reader.chunks(DEFAULT_CHUNK_SAMPLES), method, shown)
    return method.procedure


def _row(path: Path, procedure: Procedure, settings: Settings) -> Row:
    how = fitting(settings)
    timed = Timed(how.fit)
    try:
        verdict = procedure.judge(replace(how, fit=timed))
    except AccelcalError as error:
        return Row(printable(path), settings.optimizer, "failed", str(error))
    return _judged(Row(printable(path), settings.optimizer, "", ""), verdict, timed.seconds)


def _judged(row: Row, verdict: Judgement, seconds: float) -> Row:
    held, found = verdict.holdout, verdict.fit
    said = replace(row, outcome=str(verdict.outcome), message=verdict.message, points=verdict.coverage.cells)
    if held is not None:
        said = replace(said, postures=held.postures, before_mg=held.before.mean)
    if held is None or found is None or verdict.calibration is None:
        return said
    done = found.operations
    return replace(
        said,
        model=verdict.calibration.model,
        after_mg=held.after.mean,
        improvement_percent=held.improvement_percent(),
        iterations=found.iterations,
        additions=done.additions or None,
        multiplications=done.multiplications or None,
        seconds=seconds,
    )


def as_json(rows: list[Row]) -> dict[str, Any]:
    """All rows, and the published ones beside them."""
    names = ("method", "before_mg", "after_mg", "improvement_percent")
    return {
        "rows": [{name: getattr(row, name) for name in row.__dataclass_fields__} for row in rows],
        "published": [dict(zip(names, row, strict=True)) for row in TABLE_3_OF_F],
    }
