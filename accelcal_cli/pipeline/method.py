"""How a recording's stillness is found and judged: segmenter and procedure, by the settings' profile."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from accelcal_cli.collect.cells import CellCollector
from accelcal_cli.core.points import Fit, Model, Optimizer, PointSet, WindowCounts, Windows
from accelcal_cli.core.recording import Chunk, Recording
from accelcal_cli.core.results import Judgement
from accelcal_cli.core.settings import Settings
from accelcal_cli.judge.model_ladder import FitFunction
from accelcal_cli.judge.verdict import NO_STILLNESS, judge, judge_paper
from accelcal_cli.optimize import named_optimizer
from accelcal_cli.output.report import WindowUse
from accelcal_cli.pipeline.survey import Observer
from accelcal_cli.segment import chosen_rule, window_length
from accelcal_cli.segment.segmenter import Rule, Segmenter

if TYPE_CHECKING:  # few runs use profile `paper`
    from accelcal_cli.collect.subsets import PaperCollector


@dataclass(frozen=True, slots=True, eq=False)
class Fitting:
    """How points are fitted and judged.

    Attributes:
        fit: the optimizer with its numbers for the settings' profile.
        models: names of the models that it can fit.
    """

    settings: Settings
    fit: FitFunction
    models: tuple[str, ...]


def fitting(settings: Settings) -> Fitting:
    """The fitting of the settings; raises UsageError for an unknown optimizer."""
    optimizer = named_optimizer(settings.optimizer)
    return Fitting(settings, fit_function(optimizer, settings), optimizer.models)


class Procedure(Observer):
    """Takes still windows in, and judges what they hold."""

    def result(self) -> PointSet:
        """The points that are fitted."""
        raise NotImplementedError

    def judge(self, how: Fitting) -> Judgement:
        """The verdict on all windows so far."""
        raise NotImplementedError

    def window_use(self, counts: WindowCounts) -> WindowUse:
        """Windows by fate, of so many from the segmenter."""
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


def make_method(recording: Recording, settings: Settings) -> Method:
    """The method of the settings for one recording."""
    lsb_per_g = local_lsb_per_g(recording, settings)
    return Method(make_segmenter(recording, settings), make_procedure(recording, settings), lsb_per_g)


def make_procedure(recording: Recording, settings: Settings) -> Procedure:
    """The procedure of the settings' profile for one recording."""
    lsb_per_g = local_lsb_per_g(recording, settings)
    if settings.profile == "paper":
        from accelcal_cli.collect.subsets import PaperCollector

        return PaperProcedure(PaperCollector(lsb_per_g, settings))
    temperature = settings.temperature and recording.has_temperature
    return CellProcedure(CellCollector(lsb_per_g, settings, temperature=temperature))


def local_lsb_per_g(recording: Recording, settings: Settings) -> float:
    """Raw counts in one local g: what rest should measure."""
    return recording.lsb_per_g * float(settings.gravity.local_g())


def make_segmenter(recording: Recording, settings: Settings) -> Segmenter:
    """The segmenter of the settings for one recording."""
    length = window_length(settings, recording.rate_hz)
    return Segmenter(length, chosen_rule(settings, recording.lsb_per_g, length))


class TimedSegmenter(Segmenter):
    """A segmenter whose windows carry their times.

    Its rule must decide on a window as soon as that is complete (`adaptive` does not): the clock of the
    chunk at hand knows the time of the window's last sample.
    """

    def __init__(self, length: int, rule: Rule, rate_hz: float) -> None:
        super().__init__(length, rule)
        self.rate_hz = rate_hz

    def feed(self, chunk: Chunk) -> Iterator[Windows]:
        """See `Segmenter`."""
        for windows in super().feed(chunk):
            yield with_times(windows, chunk, self.rate_hz)


def with_times(windows: Windows, chunk: Chunk, rate_hz: float) -> Windows:
    """Windows that end in a chunk, with their times."""
    last = windows.first_sample + windows.samples - 1 - chunk.first_sample
    low, high = (int(last[0]), int(last[-1]) + 1) if len(last) else (0, 0)
    last_us = chunk.clock.times(low, high)[last - low]
    lengths_us = np.rint((windows.samples - 1) * 1e6 / rate_hz).astype(np.int64)
    return replace(windows, start_us=last_us - lengths_us, end_us=last_us + round(1e6 / rate_hz))


def optimizer_settings(optimizer: Optimizer, settings: Settings) -> Any:
    """The optimizer's own numbers for the settings' profile."""
    return optimizer.settings.get(settings.profile, optimizer.settings["default"])


def optimizer_json(optimizer: Optimizer, settings: Settings) -> dict[str, Any]:
    """The report's `optimizer` object, before the fit."""
    numbers = asdict(optimizer_settings(optimizer, settings))
    return {"name": optimizer.name, "arithmetic": optimizer.arithmetic, "settings": numbers}


def fit_function(optimizer: Optimizer, settings: Settings) -> FitFunction:
    """The optimizer with its numbers for the settings' profile."""
    return partial(_fit, optimizer, optimizer_settings(optimizer, settings))


def _fit(optimizer: Optimizer, numbers: Any, points: PointSet, model: Model) -> Fit:
    return optimizer.fit(points, model, numbers)


class CellProcedure(Procedure):
    """The default: orientation cells, model ladder, posture-blocked hold-out."""

    def __init__(self, collector: CellCollector) -> None:
        self.collector = collector

    def see_still(self, windows: Windows) -> None:
        """Take windows in."""
        self.collector.add(windows)

    def result(self) -> PointSet:
        """One point a cell."""
        return self.collector.points()

    def judge(self, how: Fitting) -> Judgement:
        """Choose a model and judge it."""
        return judge(self.result(), how.settings, how.fit, how.models, self._why_none(how.settings))

    def _why_none(self, settings: Settings) -> str:
        """Why there are no points, if there are none."""
        counts = self.collector.counts()
        if settings.adaptive is not None:
            return "no rest comes near the quietest window of the recording; use another rule of --stillness"
        if counts.implausible:
            return "still windows measure far from 1 g; check the unit with --unit and --lsb-per-g"
        if counts.constant:
            return "still windows hold nothing but constant values: the device did not measure"
        return NO_STILLNESS

    def window_use(self, counts: WindowCounts) -> WindowUse:
        """Windows by fate."""
        cells = self.collector.counts()
        constant = 0 if cells.constant_used else cells.constant
        return window_use(counts, cells.implausible, constant)


class PaperProcedure(Procedure):
    """Profile `paper`: F's nine subsets, nine parameters, control points."""

    def __init__(self, collector: PaperCollector) -> None:
        self.collector = collector

    def see_still(self, windows: Windows) -> None:
        """Take windows in."""
        self.collector.add(windows)

    def result(self) -> PointSet:
        """The points of the first set."""
        return self.collector.fit.points()

    def judge(self, how: Fitting) -> Judgement:
        """Fit the first set, judge by the second."""
        control, missing = self.collector.control, self.collector.fit.missing()
        return judge_paper(self.result(), control.points(), missing, how.settings, how.fit, how.models)

    def window_use(self, counts: WindowCounts) -> WindowUse:
        """Windows by fate; few of the still ones are used."""
        return window_use(counts, self.collector.implausible, 0)


def window_use(counts: WindowCounts, implausible: int, constant: int) -> WindowUse:
    """Windows by fate, from the segmenter's counts and the collector's."""
    return WindowUse(
        complete=counts.complete,
        moving=counts.moving,
        filled=counts.filled,
        clipped=counts.clipped,
        recovered=counts.recovered,
        joined=counts.joined,
        implausible=implausible,
        constant_left_out=constant,
        used=counts.still - implausible - constant,
    )
