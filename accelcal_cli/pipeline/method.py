"""The two procedures: from a recording's windows to a judgement, by profile."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Protocol

from accelcal_cli.collect.cells import CellCollector
from accelcal_cli.collect.subsets import PaperCollector
from accelcal_cli.core.points import Fit, Model, Optimizer, PointSet, WindowCounts, Windows
from accelcal_cli.core.recording import Recording
from accelcal_cli.core.results import Judgement
from accelcal_cli.core.settings import Settings
from accelcal_cli.judge.model_ladder import FitFunction
from accelcal_cli.judge.verdict import NO_STILLNESS, judge, judge_paper
from accelcal_cli.optimize import named_optimizer
from accelcal_cli.output.report import WindowUse
from accelcal_cli.segment import chosen_rule, window_length
from accelcal_cli.segment.segmenter import Segmenter


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


class Procedure(Protocol):
    """Takes still windows in, in the order of time, and judges what they hold."""

    def add(self, windows: Windows) -> None:
        """Take windows in."""

    def points(self) -> PointSet:
        """The points that are fitted."""

    def judge(self, how: Fitting) -> Judgement:
        """The verdict on all windows so far."""

    def window_use(self, counts: WindowCounts) -> WindowUse:
        """Windows by fate."""


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
        return PaperProcedure(PaperCollector(lsb_per_g, settings))
    warm = settings.temperature and recording.has_temperature
    return CellProcedure(CellCollector(lsb_per_g, settings, temperature=warm))


def local_lsb_per_g(recording: Recording, settings: Settings) -> float:
    """Raw counts in one local g: what rest should measure."""
    return recording.lsb_per_g * float(settings.gravity.local_g())


def make_segmenter(recording: Recording, settings: Settings) -> Segmenter:
    """The segmenter of the settings for one recording."""
    length = window_length(settings, recording.rate_hz)
    return Segmenter(length, chosen_rule(settings, recording.lsb_per_g, length))


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


class CellProcedure:
    """The default: orientation cells, model ladder, posture-blocked hold-out."""

    def __init__(self, collector: CellCollector) -> None:
        self.collector = collector
        self.add = collector.add
        self.points = collector.points

    def judge(self, how: Fitting) -> Judgement:
        """Choose a model and judge it."""
        return judge(self.points(), how.settings, how.fit, how.models, self._why_none(how.settings))

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


class PaperProcedure:
    """Profile `paper`: F's nine subsets, nine parameters, control points."""

    def __init__(self, collector: PaperCollector) -> None:
        self.collector = collector
        self.add = collector.add
        self.points = collector.fit.points

    def judge(self, how: Fitting) -> Judgement:
        """Fit the first set, judge by the second."""
        control, missing = self.collector.control, self.collector.fit.missing()
        return judge_paper(self.points(), control.points(), missing, how.settings, how.fit, how.models)

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
