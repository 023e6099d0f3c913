"""Every optimizer on the same points and the same hold-out (F section III.B, Table 3).

Also what is known of a simulated recording, and how far a calibration is from that truth.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import AccelcalError, UnreadableError, printable
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.points import MODELS, Calibration
from accelcal_cli.core.results import Judgement
from accelcal_cli.core.settings import NO_PRIOR, Settings
from accelcal_cli.judge.errors import mean
from accelcal_cli.judge.model_ladder import Fitting
from accelcal_cli.output.files import parsed
from accelcal_cli.pipeline.jobs import DEFAULT_CHUNK_SAMPLES, ProgressMaker, stem
from accelcal_cli.pipeline.stated import options_of
from accelcal_cli.pipeline.survey import Procedure, fitting, make_method, open_marked, survey

TRUTH_SUFFIX = ".truth.json"
SLOPE, NO_SLOPE = "temp_slope_g_per_c", (0.0, 0.0, 0.0)
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
        model: the model that was chosen, None if it was refused.
        before_mg, after_mg: mean held-out error.
        iterations, additions, multiplications: of the fit to all points; None if not counted.
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


def compare(
    path: Path, options: ReadOptions, settings: Settings, optimizers: tuple[str, ...], progress: ProgressMaker
) -> Iterator[Row]:
    """One row an optimizer; the recording is read once.

    Raises:
        AccelcalError: it cannot be read.
    """
    procedure = collected(path, options, settings, progress)
    for name in optimizers:
        yield _row(path, procedure, replace(settings, optimizer=name, prior=NO_PRIOR))


def collected(path: Path, options: ReadOptions, settings: Settings, progress: ProgressMaker) -> Procedure:
    """The still windows of a recording, ready to be judged.

    Raises:
        AccelcalError: it cannot be read.
    """
    with open_marked(path, options_of(path, options)) as reader:
        method = make_method(reader.recording, settings)
        shown = progress("reading", reader.recording.total_bytes)
        survey(reader.chunks(DEFAULT_CHUNK_SAMPLES), method.segmenter, (method.procedure,), shown)
    return method.procedure


def _row(path: Path, procedure: Procedure, settings: Settings) -> Row:
    fitter = fitting(settings)
    try:
        verdict = procedure.judge(fitter)
    except AccelcalError as error:
        return Row(printable(path), settings.optimizer, "failed", str(error))
    seconds = None if verdict.fit is None else _seconds(procedure, fitter, verdict)
    cells = verdict.coverage.cells
    row = Row(printable(path), settings.optimizer, str(verdict.outcome), verdict.message, points=cells)
    return _judged(row, verdict, seconds)


def _seconds(procedure: Procedure, fitter: Fitting, verdict: Judgement) -> float:
    """How long the fit to all points takes alone."""
    assert verdict.calibration is not None
    points, model = procedure.result(), MODELS[verdict.calibration.model]
    start = perf_counter()
    fitter.fit((points,), model)
    return perf_counter() - start


def _judged(row: Row, verdict: Judgement, seconds: float | None) -> Row:
    """The row with the errors, and with what it cost where there is a calibration."""
    holdout, fit = verdict.holdout, verdict.fit
    if holdout is None:
        return row
    row = replace(row, postures=holdout.postures, before_mg=holdout.before.mean)
    if fit is None or verdict.calibration is None:
        return row
    operations = fit.operations
    return replace(
        row,
        model=verdict.calibration.model,
        after_mg=holdout.after.mean,
        improvement_percent=holdout.improvement_percent(),
        iterations=fit.iterations,
        additions=operations.additions or None,
        multiplications=operations.multiplications or None,
        seconds=seconds,
    )


@dataclass(frozen=True, slots=True)
class Mean:
    """One optimizer over several recordings.

    Attributes:
        recordings: how many it could calibrate; the others are left out.
        improvement_percent: ratio of the means, as all R of F are.
    """

    optimizer: str
    recordings: int
    before_mg: float
    after_mg: float
    improvement_percent: float


def means(rows: Sequence[Row]) -> list[Mean]:
    """Of each optimizer that calibrated a recording; none if there is only one recording."""
    found = []
    for name in dict.fromkeys(row.optimizer for row in rows):
        pairs = [
            (row.before_mg, row.after_mg)
            for row in rows
            if row.optimizer == name and row.before_mg is not None and row.after_mg is not None
        ]
        if pairs and len({row.recording for row in rows}) > 1:
            before, after = (mean(list(column)) for column in zip(*pairs, strict=True))
            found.append(Mean(name, len(pairs), before, after, 100 * before / after))
    return found


def as_json(rows: list[Row]) -> dict[str, Any]:
    """All rows, their means over recordings, and the published ones beside them."""
    names = ("method", "before_mg", "after_mg", "improvement_percent")
    return {
        "rows": [{name: getattr(row, name) for name in row.__dataclass_fields__} for row in rows],
        "means": [asdict(one) for one in means(rows)],
        "published": [dict(zip(names, row, strict=True)) for row in TABLE_3_OF_F],
    }


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """True parameters: a = K (v + o + s (T - Tref)).

    Attributes:
        gain: K, (3, 3).
        offset_g: o, (3,) at the reference temperature.
        reference_c: Tref.
        slope_g_per_c: s, (3,).
    """

    gain: NDArray[np.float64]
    offset_g: NDArray[np.float64]
    reference_c: float
    slope_g_per_c: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))


def truth_beside(recording: Path) -> Truth | None:
    """The content of STEM.truth.json beside a recording, None if there is no such file.

    Either as `accelcal simulate` writes it, or with the keys `K` and `b` (and `temp_ref_c`) of
    a = K (v - b - s (T - Tref)).

    Raises:
        UnreadableError: the file holds something else.
    """
    path = recording.with_name(stem(recording) + TRUTH_SUFFIX)
    if not path.is_file():
        return None
    try:
        return _truth(parsed(path.read_text("utf-8")))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UnreadableError(
            f"does not hold the truth of a simulated recording ({error})",
            path=path,
            hint="move it away, or write it again with accelcal simulate",
        ) from error


def _truth(known: dict[str, Any]) -> Truth:
    if "sensor" in known:
        sensor = known["sensor"]
        slope = sensor.get("slope_g_per_c", NO_SLOPE)
        return _checked(sensor["gain"], sensor["offset_g"], sensor["reference_c"], slope)
    offset, slope = ([-value for value in values] for values in (known["b"], known.get(SLOPE, NO_SLOPE)))
    return _checked(known["K"], offset, known.get("temp_ref_c", 0.0), slope)


def _checked(gain: Any, offset_g: Any, reference_c: Any, slope_g_per_c: Any) -> Truth:
    k, offset, slope = (np.array(value, np.float64) for value in (gain, offset_g, slope_g_per_c))
    truth = Truth(k, offset, float(reference_c), slope)
    if truth.gain.shape != (3, 3) or not truth.offset_g.shape == truth.slope_g_per_c.shape == (3,):
        raise ValueError("K is not 3 x 3, or o or s not three numbers")
    return truth


def true_errors(calibration: Calibration, truth: Truth) -> tuple[float, float]:
    """The largest error of an entry of K, and of an offset [mg] at the truth's reference temperature."""
    drift_g = calibration.slope_g_per_c() * (truth.reference_c - calibration.reference_c())
    offsets_g = calibration.offset_g() + drift_g - truth.offset_g
    return float(np.abs(calibration.gain() - truth.gain).max()), float(np.abs(offsets_g).max() * 1000)
