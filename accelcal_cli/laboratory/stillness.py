"""`accelcal evaluate stillness`: the rules of stillness compared on one recording.

Each rule finds its own points, and its calibration is judged on them by held-out error. Since easy
points flatter a rule, every calibration is also judged on the points of every other rule.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from accelcal_cli.cli import exit_codes, options
from accelcal_cli.cli.help import Command
from accelcal_cli.cli.output import aligned, each_recording, refuse_both
from accelcal_cli.core.arithmetic import ONE, mean
from accelcal_cli.core.calibration import IDENTITY, Calibration, TemperatureScale
from accelcal_cli.core.errors import printable
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.points import PointSet
from accelcal_cli.core.results import Judgement
from accelcal_cli.core.settings import STILLNESS, Settings, with_stillness
from accelcal_cli.judge.errors import deviations_mg, per_posture
from accelcal_cli.judge.model_ladder import postures
from accelcal_cli.output.files import csv_text
from accelcal_cli.output.numbers import formatted
from accelcal_cli.pipeline.jobs import ProgressMaker, no_progress
from accelcal_cli.pipeline.options import fit_settings, read_options, recording_options
from accelcal_cli.pipeline.procedures import fitting, make_method
from accelcal_cli.pipeline.survey import open_marked, survey
from accelcal_cli.simulate import TrueParameters, true_parameters

RAW = "raw"
"""Name of no calibration in the place of a rule's."""


@dataclass(frozen=True, slots=True, eq=False)
class RuleResult:
    """The still windows that one rule found in a recording, and their calibration.

    Attributes:
        rule: key of STILLNESS.
        windows: number of still windows that were used; joined ones count once.
        still_s: duration of these [s].
        label: (n,) posture of each point.
    """

    rule: str
    windows: int
    still_s: float
    points: PointSet
    label: NDArray[np.int64]
    judgement: Judgement

    @property
    def postures(self) -> int:
        """Number of postures."""
        return int(self.label.max(initial=-1)) + 1


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """All rules on one recording; the truth if it is known."""

    results: tuple[RuleResult, ...]
    truth: TrueParameters | None

    def errors_mg(self) -> dict[str, dict[str, float | None]]:
        """Return the mean error over postures, by rule of the calibration (or `raw`) and of the points.

        None if there is no calibration, or no point.
        """
        return {
            rule: {on.rule: _error_mg(by, on) for on in self.results}
            for rule, by in [(RAW, None), *((result.rule, result) for result in self.results)]
        }


def compare(
    path: Path,
    options: ReadOptions,
    settings: Settings,
    chunk_samples: int,
    progress: ProgressMaker = no_progress,
) -> Comparison:
    """Calibrate a recording by every rule of stillness; reads it once for each.

    Raises:
        AccelcalError: it cannot be read, or its truth file cannot.
    """
    truth = true_parameters(path)
    with open_marked(path, recording_options(path, options)) as reader:
        recording, found = reader.recording, []
        for rule in STILLNESS:
            chosen = with_stillness(settings, rule)
            method = make_method(recording, chosen)
            shown = progress(f"by rule {rule}", recording.total_bytes)
            survey(reader.chunks(chunk_samples), method.segmenter, (method.procedure,), shown)
            use, points = method.procedure.window_use(method.segmenter.counts), method.procedure.result()
            still_s = (use.used + use.joined) * method.segmenter.length / recording.rate_hz
            label = postures(points, chosen.posture_degrees)
            judgement = method.procedure.judge(fitting(chosen))
            found.append(RuleResult(rule, use.used, still_s, points, label, judgement))
    return Comparison(tuple(found), truth)


def _error_mg(by: RuleResult | None, on: RuleResult) -> float | None:
    """Return the error on one rule's points with another's calibration, or with none."""
    if not len(on.points):
        return None
    parameters, points = IDENTITY, on.points
    if by is not None:
        if by.judgement.fit is None or by.judgement.calibration is None:
            return None
        fit = by.judgement.fit
        parameters, points = fit.parameters, on_scale(points, by.points.temperature).straightened(fit.bend)
    return mean(list(per_posture(deviations_mg(points, parameters), points.weights, on.label).values()))


def on_scale(points: PointSet, scale: TemperatureScale | None) -> PointSet:
    """Return points with their temperatures scaled as those of another fit."""
    own_scale = points.temperature
    if points.tau is None or own_scale is None or scale is None:
        return points
    milli = points.tau * round(1000 * own_scale.span_c) + (own_scale.reference_mc - scale.reference_mc) * ONE
    return replace(points, tau=milli // round(1000 * scale.span_c), temperature=scale)


def true_errors(calibration: Calibration, truth: TrueParameters) -> tuple[float, float]:
    """Return the largest error of an entry of K, and of an offset [mg] at the true reference."""
    offsets_g = calibration.offset_at(truth.reference_c) - truth.offset_g
    return float(np.abs(calibration.gain() - truth.gain).max()), float(np.abs(offsets_g).max() * 1000)


Row = dict[str, Any]
FIGURES = {
    "windows": "d", "still_h": ".2f", "points": "d", "postures": "d", "outcome": "", "model": "",
    "before_mg": ".2f", "after_mg": ".3f", "gain_error": ".1e", "offset_error_mg": ".3f",
}  # fmt: skip
"""Columns of the first table, and how their values are shown."""


@click.command(
    "stillness",
    cls=Command,
    examples=("evaluate stillness recording.cwa", "evaluate stillness recording.cwa --csv"),
)
@click.argument("recordings", nargs=-1, required=True, type=options.FILE)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per line.")
@click.option("--csv", "as_csv", is_flag=True, help="Print a CSV table.")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
@options.laboratory_reading_options
@options.fitting_options
def command(recordings: tuple[Path, ...], **values: Any) -> int:
    """Calibrate each RECORDING by every stillness rule and compare the results.

    Shows what each rule found and the held-out error on its own points, then the mean error that each
    calibration leaves on the points of every rule. For a simulated recording with NAME.truth.json
    next to it, also the largest error of a gain term and of an offset.
    """
    refuse_both(as_json=values["as_json"], as_csv=values["as_csv"])

    def work(path: Path, bars: ProgressMaker) -> tuple[str, list[Row]]:
        chosen, chunk_samples = fit_settings(values), values["chunk_samples"]
        compared = compare(path, read_options(values), chosen, chunk_samples, bars)
        return printable(path), rows(compared)

    found, code = each_recording(recordings, work, quiet=values["quiet"])
    if found:
        exit_codes.show(_shown(dict(found), values))
    return code


def _shown(results: dict[str, list[Row]], values: dict[str, Any]) -> str:
    if values["as_json"]:
        return "\n".join(json.dumps({"recording": path, "rules": rules}) for path, rules in results.items())
    if values["as_csv"]:
        head = ["recording", "rule", *FIGURES, *(f"on_{rule}_mg" for rule in STILLNESS)]
        cells = [
            [path, row["rule"], *(row.get(name) for name in FIGURES), *row["on_points_of_mg"].values()]
            for path, rules in results.items()
            for row in rules
        ]
        return csv_text(head, cells).rstrip("\n")
    return "\n\n".join(f"{path}\n{text(rules)}" for path, rules in results.items())


def rows(comparison: Comparison) -> list[Row]:
    """Return a row for raw data and for each rule."""
    own = {item.rule: _row(item, comparison) for item in comparison.results}
    return [
        own.get(rule, {"rule": RAW})
        | {"on_points_of_mg": {name: _rounded(error) for name, error in on.items()}}
        for rule, on in comparison.errors_mg().items()
    ]


def _row(result: RuleResult, comparison: Comparison) -> Row:
    holdout, calibration = result.judgement.holdout, result.judgement.calibration
    gain, offset_mg = None, None
    if calibration is not None and comparison.truth is not None:
        gain, offset_mg = true_errors(calibration, comparison.truth)
    return {
        "rule": result.rule,
        "windows": result.windows,
        "still_h": round(result.still_s / 3600, 4),
        "points": len(result.points),
        "postures": result.postures,
        "outcome": str(result.judgement.outcome),
        "model": None if calibration is None else calibration.model,
        "before_mg": None if holdout is None else _rounded(holdout.before.mean),
        "after_mg": None if holdout is None else _rounded(holdout.after.mean),
        "gain_error": None if gain is None else round(gain, 8),
        "offset_error_mg": _rounded(offset_mg),
    }


def text(shown: list[Row]) -> str:
    """Return the two tables for people."""
    known = any(row.get("gain_error") is not None for row in shown)
    columns = [name for name in FIGURES if known or name not in ("gain_error", "offset_error_mg")]
    first = [
        [row["rule"], *(formatted(row[name], FIGURES[name]) for name in columns)]
        for row in shown
        if row["rule"] != RAW
    ]
    cross = [
        [row["rule"], *(formatted(error, ".3f") for error in row["on_points_of_mg"].values())]
        for row in shown
    ]
    head = ["rule", *(name.replace("_", " ") for name in columns)]
    return f"{aligned(head, first)}\n\n{aligned(['mg on the points of', *STILLNESS], cross)}"


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 4)
