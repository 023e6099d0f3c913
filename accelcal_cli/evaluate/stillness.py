"""The rules of stillness compared on one recording.

Each rule finds its own points, and its calibration is judged on them by held-out error. Since easy
points flatter a rule, every calibration is also judged on the points of every other rule.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.fixed import ONE
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.points import IDENTITY, PointSet, TemperatureScale
from accelcal_cli.core.recording import Reader
from accelcal_cli.core.results import Judgement
from accelcal_cli.core.settings import STILLNESS, Settings, with_stillness
from accelcal_cli.evaluate.methods import Truth, truth_beside
from accelcal_cli.judge.errors import deviations_mg, mean, per_posture
from accelcal_cli.judge.model_ladder import postures
from accelcal_cli.pipeline.jobs import ProgressMaker, no_progress
from accelcal_cli.pipeline.stated import options_of
from accelcal_cli.pipeline.survey import fitting, make_method, open_marked, survey

RAW = "raw"
"""Instead of a rule: no calibration."""


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What one rule of stillness found in a recording, and the calibration that came of it.

    Attributes:
        rule: a key of STILLNESS.
        windows: still windows that were used; joined ones count once.
        still_s: their seconds.
        label: (n,) postures of the points.
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
    """All rules on one recording; the truth where it is known."""

    found: tuple[Found, ...]
    truth: Truth | None

    def errors_mg(self) -> dict[str, dict[str, float | None]]:
        """Mean over postures of | |a| - 1 g |, by rule that calibrated (or `raw`) and by rule of the points.

        None if there is no calibration, or no point.
        """
        return {
            rule: {on.rule: _error_mg(by, on) for on in self.found}
            for rule, by in [(RAW, None), *((found.rule, found) for found in self.found)]
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
    truth = truth_beside(path)
    with open_marked(path, options_of(path, options)) as reader:
        found = [
            _by_rule(reader, with_stillness(settings, rule), chunk_samples, progress) for rule in STILLNESS
        ]
    return Comparison(tuple(found), truth)


def _by_rule(reader: Reader, settings: Settings, chunk_samples: int, progress: ProgressMaker) -> Found:
    recording = reader.recording
    method = make_method(recording, settings)
    shown = progress(f"by rule {settings.stillness}", recording.total_bytes)
    survey(reader.chunks(chunk_samples), method.segmenter, (method.procedure,), shown)
    use, points = method.procedure.window_use(method.segmenter.counts), method.procedure.result()
    still_s = (use.used + use.joined) * method.segmenter.length / recording.rate_hz
    label = postures(points, settings.posture_degrees)
    return Found(
        settings.stillness, use.used, still_s, points, label, method.procedure.judge(fitting(settings))
    )


def _error_mg(by: Found | None, on: Found) -> float | None:
    """Error on one rule's points with the calibration of another, or with none."""
    if not len(on.points):
        return None
    parameters, points = IDENTITY, on.points
    if by is not None:
        if by.judgement.fit is None or by.judgement.calibration is None:
            return None
        parameters, points = by.judgement.fit.parameters, on_scale(points, by.points.temperature)
    return mean(list(per_posture(deviations_mg(points, parameters), points.weights, on.label).values()))


def on_scale(points: PointSet, scale: TemperatureScale | None) -> PointSet:
    """Points with their temperatures scaled in another way, as a fit to other points understands them."""
    own_scale = points.temperature
    if points.tau is None or own_scale is None or scale is None:
        return points
    milli = points.tau * round(1000 * own_scale.span_c) + (own_scale.reference_mc - scale.reference_mc) * ONE
    return replace(points, tau=milli // round(1000 * scale.span_c), temperature=scale)
