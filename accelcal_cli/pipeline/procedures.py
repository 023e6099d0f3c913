"""How a recording's stillness is found and judged: the segmenter and the procedure of the settings' profile.

`make_method` joins both. A `Procedure` is an observer of the first pass: it takes still windows in, makes
points of them, and judges what they hold.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from accelcal_cli.collect.cells import CellCollector
from accelcal_cli.collect.subsets import PaperCollector
from accelcal_cli.core.calibration import Correction
from accelcal_cli.core.errors import Reason, UsageError
from accelcal_cli.core.points import Optimizer, PointSet, TimedMeans, WindowCounts, Windows, WindowUses
from accelcal_cli.core.prior import POPULATION, Prior
from accelcal_cli.core.recording import Chunk, Recording
from accelcal_cli.core.results import PROBABLE, Change, Facts, Judgement
from accelcal_cli.core.settings import DEFAULT, LEARNT_PRIORS, NEVER, NO_PRIOR, PAPER, Settings
from accelcal_cli.judge.change import ChangeSearch
from accelcal_cli.judge.model_ladder import Fitting
from accelcal_cli.judge.verdict import (
    FAR_FROM_1_G,
    FEWEST_CONTROL_POINTS,
    NOTHING_STILL,
    judge,
    judge_paper,
    with_errors_before,
)
from accelcal_cli.optimize import named_optimizer
from accelcal_cli.output.sections import WindowUse
from accelcal_cli.pipeline.survey import Observer
from accelcal_cli.segment import chosen_rule, short_gaps, window_length
from accelcal_cli.segment.segmenter import Segmenter, TimedSegmenter

APART_G = PAPER.min_distance_g
"""Distance [g] between the points that `SubsetCounter` counts."""

BLOCK_S = 3600
"""Length [s] of a block of time within which the sensor is assumed constant."""


def fitting(settings: Settings, learnt: Prior | None = None) -> Fitting:
    """Return how points are fitted by the settings.

    Args:
        learnt: the prior, if the settings name one that is learnt from other recordings.

    Raises:
        UsageError: the optimizer is unknown or knows no prior, or what must be learnt is not given.
    """
    optimizer = named_optimizer(settings.optimizer)
    numbers = _numbers(optimizer, settings)
    penalized = None if settings.prior == NO_PRIOR else optimizer.fit_penalized
    if penalized is None and settings.prior != NO_PRIOR:
        raise UsageError(f"optimizer {optimizer.name} fits without a prior only", hint="add --prior none")
    if learnt is None and settings.prior in LEARNT_PRIORS:
        raise UsageError(f"prior {settings.prior} is learnt from other recordings", hint="use accelcal study")
    fit = partial(optimizer.fits, settings=numbers)
    judging = named_optimizer(DEFAULT.optimizer).fit_penalized if settings.profile == PAPER.profile else None
    return Fitting(settings, fit, optimizer.models, penalized, learnt or POPULATION, judging)


def optimizer_json(settings: Settings) -> dict[str, Any]:
    """Return the report's `optimizer` object; raises UsageError for an unknown optimizer."""
    optimizer = named_optimizer(settings.optimizer)
    numbers = asdict(_numbers(optimizer, settings))
    return {"name": optimizer.name, "arithmetic": optimizer.arithmetic, "settings": numbers}


def _numbers(optimizer: Optimizer, settings: Settings) -> Any:
    return optimizer.settings.get(settings.profile, optimizer.settings["default"])


class Procedure(Observer):
    """Takes still windows in, makes points of them, and judges these."""

    def result(self) -> PointSet:
        """Return the points that are fitted."""
        raise NotImplementedError

    def judge(self, how: Fitting) -> Judgement:
        """Return the judgement of all windows so far."""
        raise NotImplementedError

    def window_use(self, counts: WindowCounts) -> WindowUse:
        """Return how many windows were used, or left out and why, from the segmenter's counts."""
        raise NotImplementedError

    def orientations(self) -> int:
        """Return the number of known orientations; with more of them a fit is better."""
        raise NotImplementedError

    def window_uses(self, windows: Windows) -> WindowUses:
        """Return what became of each of the windows that were taken in."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True, eq=False)
class Method:
    """How one recording's stillness is found and judged.

    Attributes:
        rest_lsb: raw counts that rest should measure.
    """

    segmenter: Segmenter
    procedure: Procedure
    rest_lsb: float

    def completed(self, facts: Facts) -> Facts:
        """Return the facts with those that the segmenter knows."""
        own = self.segmenter
        return replace(facts, gone_over=own.gone_over, windows=own.counts.complete, quietest=own.quietest)

    def timed(self, rate_hz: float) -> Method:
        """Return the method with windows that carry their times."""
        plain = self.segmenter
        return replace(self, segmenter=TimedSegmenter(plain.length, plain.rule, rate_hz, plain.gaps))


def make_method(recording: Recording, settings: Settings) -> Method:
    """Return the method of the settings for one recording."""
    length = window_length(settings, recording.rate_hz)
    rule = chosen_rule(settings, recording.lsb_per_g, length)
    gaps = short_gaps(settings, length, recording.rate_hz)
    lsb_per_g = local_lsb_per_g(recording, settings)
    procedure: Procedure
    if settings.profile == "paper":
        procedure = PaperProcedure(PaperCollector(lsb_per_g, settings))
    else:
        procedure = TimedCellProcedure(recording, settings)
    return Method(Segmenter(length, rule, gaps), procedure, lsb_per_g)


def local_lsb_per_g(recording: Recording, settings: Settings) -> float:
    """Return the raw counts of one local g, which rest should measure."""
    return recording.lsb_per_g * float(settings.gravity.local_g())


class CellProcedure(Procedure):
    """The default procedure: orientation cells, model ladder, hold-out by postures."""

    def __init__(self, collector: CellCollector) -> None:
        self.collector = collector

    def see_still(self, windows: Windows) -> None:
        """Take windows in."""
        self.collector.add(windows)

    def result(self) -> PointSet:
        """Return one point for each cell."""
        return self.collector.points()

    def orientations(self) -> int:
        """Return the number of groups of cells."""
        return self.collector.orientations()

    def judge(self, how: Fitting) -> Judgement:
        """Choose a model, fit it and judge it."""
        saturated = self.collector.saturated()
        why_none = self._why_none(how.settings)
        return judge(self.result(), how, why_none, saturated=saturated, means=self.along_time())

    def along_time(self) -> TimedMeans | None:
        """Return the points' rests along time; None where that is not known."""
        return None

    def _why_none(self, settings: Settings) -> Reason:
        counts = self.collector.counts()
        if settings.adaptive is not None:
            return Reason("nothing_near_quietest")
        if counts.implausible:
            return FAR_FROM_1_G
        if counts.constant:
            return Reason("constant_values")
        if counts.saturated:
            return Reason("nothing_but_saturated")
        return NOTHING_STILL

    def window_use(self, counts: WindowCounts) -> WindowUse:
        """See `Procedure`."""
        cells = self.collector.counts()
        constant = 0 if cells.constant_used else cells.constant
        return window_use(counts, cells.implausible, constant, cells.far_temperature, cells.saturated)

    def window_uses(self, windows: Windows) -> WindowUses:
        """See `Procedure`."""
        return self.collector.window_uses(windows)


class TimedCellProcedure(CellProcedure):
    """The default procedure along one recording: it also finds a change of the sensor, and corrects for it.

    Attributes:
        hour_samples: samples in a block of BLOCK_S.
    """

    def __init__(self, recording: Recording, settings: Settings) -> None:
        lsb_per_g = local_lsb_per_g(recording, settings)
        temperature = settings.temperature and recording.has_temperature
        self.hour_samples = max(1, round(BLOCK_S * recording.rate_hz))
        super().__init__(
            CellCollector(lsb_per_g, settings, temperature=temperature, block_samples=self.hour_samples)
        )
        self._correction: Correction | None = None
        self._rate_hz, self._gravity = recording.rate_hz, settings.gravity.local_g()
        self._begun_us: list[int] = []
        self._means: TimedMeans | None = None
        self._points: tuple[Correction | None, PointSet] | None = None

    def see(self, chunk: Chunk) -> None:
        """Note when hours begin; if a preview leaves the first row of one out, its next row counts."""
        while (row := max(0, len(self._begun_us) * self.hour_samples - chunk.first_sample)) < len(chunk):
            self._begun_us += chunk.clock.times(row, row + 1).tolist()

    def see_still(self, windows: Windows) -> None:
        """Take windows in."""
        super().see_still(windows)
        self._means = self._points = None

    def begun_us(self, sample: int) -> int:
        """Return when the hour of a sample began [us since 1970, device clock]."""
        return self._begun_us[sample // self.hour_samples]

    def judge(self, how: Fitting) -> Judgement:
        """Choose a model, judge it, look for a change of the sensor, and correct for one if that helps."""
        self._correction = None
        verdict = super().judge(how)
        about = verdict.candidate or verdict.calibration
        if about is None:
            return verdict
        search = ChangeSearch(self.means())
        change = search.find(about)
        if verdict.changed is not None:
            change = self._borne_out(change, *verdict.changed)
        if change.at_block is not None:
            at_us = self.begun_us(change.at_block * self.collector.block_samples)
            change = replace(change, at_us=at_us)
        verdict = replace(verdict, change=change)
        return verdict if how.settings.recalibrate == NEVER else self._corrected(verdict, how, search)

    def result(self) -> PointSet:
        """Return one point for each cell, corrected where the sensor changed."""
        if self._points is None or self._points[0] is not self._correction:
            in_local_g = None if self._correction is None else self._correction.in_local_g(self._gravity)
            self._points = self._correction, self.collector.points(in_local_g)
        return self._points[1]

    def _borne_out(self, change: Change, probability: float, before: float) -> Change:
        """Return a change as the posterior bears it out: orientations that alternate look like one, too."""
        if change.kind != "none" and probability < PROBABLE:
            assert change.holdout is not None
            still = replace(change.holdout, changing_mg=None, standard_error_mg=None)
            change = Change("none", None, still)
        if change.kind == "none" and probability >= PROBABLE:
            change = replace(change, at_block=round(before * self.means().blocks()))
        return replace(change, probability=probability)

    def _corrected(self, verdict: Judgement, how: Fitting, search: ChangeSearch) -> Judgement:
        """Return the judgement of corrected points if that gives a calibration, else `verdict`."""
        if verdict.change is None or verdict.change.correction is None:
            return verdict
        change = verdict.change
        better = self._judge_with(change, how)
        about = better.candidate or better.calibration
        if about is not None:
            change = search.refined(about, change)
            better = self._judge_with(change, how)
        if better.calibration is None:
            self._correction = None
            return verdict
        calibration = replace(better.calibration, correction=change.correction)
        left = replace(change, probability=None if better.changed is None else better.changed[0])
        corrected = replace(better, calibration=calibration, change=left)
        if (simpler := better.without_misalignment) is not None:
            calibration = replace(simpler.calibration, correction=change.correction)
            corrected = replace(corrected, without_misalignment=replace(simpler, calibration=calibration))
        return with_errors_before(corrected, verdict)

    def _judge_with(self, change: Change, how: Fitting) -> Judgement:
        self._correction = change.correction
        return super().judge(how)

    def along_time(self) -> TimedMeans:
        """See `CellProcedure`; corrected where the sensor changed."""
        return self.means() if self._correction is None else self.means().corrected(self._correction)

    def means(self) -> TimedMeans:
        """Return the mean of each orientation in each block of time, where it can be used."""
        if self._means is not None:
            return self._means
        timed, collector = self.collector.timed(), self.collector
        sums = [one for _, one in timed]
        samples = np.array([one.samples for one in sums], np.int64)
        scale = samples[:, np.newaxis] * (collector.lsb_per_g / float(self._gravity))
        celsius = np.array([one.temperature_mc for one in sums], np.int64) / (1000 * samples)
        self._means = TimedMeans(
            block=np.array([block for block, _ in timed], np.int64),
            mean_g=np.array([one.xyz for one in sums], np.int64).reshape(-1, 3) / scale,
            celsius=celsius if collector.temperature else None,
            block_samples=collector.block_samples,
            block_h=collector.block_samples / self._rate_hz / BLOCK_S,
            windows=np.array([one.windows for one in sums], np.int64),
        )
        return self._means


class PaperProcedure(Procedure):
    """The procedure of profile `paper`: F's nine subsets, nine parameters, control points."""

    def __init__(self, collector: PaperCollector) -> None:
        self.collector = collector

    def see_still(self, windows: Windows) -> None:
        """Take windows in."""
        self.collector.add(windows)

    def result(self) -> PointSet:
        """Return the points of the first set."""
        return self.collector.fit.points()

    def judge(self, how: Fitting) -> Judgement:
        """Fit the first set, and judge the fit by the second."""
        first, second = self.collector.fit, self.collector.control
        missing = first.missing(), second.missing()
        return judge_paper(first.points(), second.points(), missing, how)

    def window_use(self, counts: WindowCounts) -> WindowUse:
        """See `Procedure`; few of the still windows are used."""
        return window_use(counts, self.collector.implausible, 0)

    def orientations(self) -> int:
        """Return the number of points of both sets, once these can be fitted and judged."""
        held = self.collector
        judged = not held.fit.missing() and sum(map(sum, held.control.filled())) >= FEWEST_CONTROL_POINTS
        return len(held) if judged else 0

    def window_uses(self, windows: Windows) -> WindowUses:
        """See `Procedure`."""
        return self.collector.window_uses(windows)


class SubsetCounter(Observer):
    """Fills F's nine subsets during another procedure, to tell how far they are and when they were full."""

    def __init__(self, recording: Recording, settings: Settings) -> None:
        apart = replace(settings, min_distance_g=APART_G)
        self.collector = PaperCollector(local_lsb_per_g(recording, settings), apart)

    def see_still(self, windows: Windows) -> None:
        """Take windows in, until the subsets are full."""
        if self.collector.full_after is None:
            self.collector.add(windows)


def window_use(
    counts: WindowCounts, implausible: int, constant: int, far: int = 0, saturated: int = 0
) -> WindowUse:
    """Return how many windows were used, or left out and why, from counts of segmenter and collector."""
    window_uses = asdict(counts)
    return WindowUse(
        **{name: number for name, number in window_uses.items() if name != "still"},
        implausible=implausible,
        constant_left_out=constant,
        temperature_left_out=far,
        saturated_left_out=saturated,
        used=window_uses["still"] - implausible - constant - far - saturated,
    )
