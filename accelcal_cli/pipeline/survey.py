"""The first pass over a recording: how its stillness is found and judged, and what else is found on the way.

`make_method` gives segmenter and procedure, by the settings' profile. `survey` shows every chunk and every
still window, once, to all observers: an `Observer` collects facts about a recording as it is read, and a
procedure is one, too. Still windows reach the observers in batches of a few thousand; the results depend
neither on how they are batched nor on the length of the chunks.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from accelcal_cli.collect.cells import CellCollector
from accelcal_cli.collect.repetition import Repetitions
from accelcal_cli.collect.subsets import PaperCollector
from accelcal_cli.core.calibration import Correction
from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.parallel import prefetch
from accelcal_cli.core.points import (
    Fates,
    Fit,
    Model,
    Optimizer,
    PointSet,
    TimedMeans,
    WindowCounts,
    Windows,
    joined_windows,
)
from accelcal_cli.core.prior import POPULATION, Prior
from accelcal_cli.core.recording import Chunk, Intake, PlacedFile, Reader, Recording, clipped_at, in_columns
from accelcal_cli.core.results import Change, Facts, Judgement
from accelcal_cli.core.settings import LEARNT_PRIORS, NEVER, NO_PRIOR, PAPER, Settings
from accelcal_cli.formats import open_recording
from accelcal_cli.judge.change import ChangeSearch
from accelcal_cli.judge.model_ladder import Fitting
from accelcal_cli.judge.verdict import (
    FAR_FROM_1_G,
    NO_STILLNESS,
    judge,
    judge_paper,
    with_errors_before,
)
from accelcal_cli.optimize import named_optimizer
from accelcal_cli.output.report import WindowUse
from accelcal_cli.pipeline.jobs import Progress
from accelcal_cli.segment import chosen_rule, short_gaps, window_length
from accelcal_cli.segment.segmenter import Segmenter, TimedSegmenter

APART_G = PAPER.min_distance_g
BATCH_WINDOWS = 4096
BLOCK_S = 3600
"""Samples of so long make a block of time, in which a sensor is taken not to change."""


class Observer:
    """Finds something out along a recording; a subclass overrides what it needs."""

    def see(self, chunk: Chunk) -> None:
        """Take a chunk in, in the order of time."""

    def see_still(self, windows: Windows) -> None:
        """Take still windows in, in the order of time; their chunk has been seen."""

    def result(self) -> Any:
        """What was found; call after the last chunk."""
        raise NotImplementedError


def fitting(settings: Settings, learnt: Prior | None = None) -> Fitting:
    """The fitting of the settings.

    Args:
        learnt: the prior of settings that name one that is learnt.

    Raises:
        UsageError: the optimizer is unknown or knows no prior, or what must be learnt is not given.
    """
    optimizer = named_optimizer(settings.optimizer)
    numbers = _numbers(optimizer, settings)
    penalized = None if settings.prior == NO_PRIOR else optimizer.fit_penalized
    if penalized is None and settings.prior != NO_PRIOR:
        raise UsageError(f"optimizer {optimizer.name} fits without a prior only", hint="add --prior none")

    def fit(sets: Sequence[PointSet], model: Model) -> list[Fit]:
        return optimizer.fits(sets, model, numbers)

    if learnt is None and settings.prior in LEARNT_PRIORS:
        raise UsageError(f"prior {settings.prior} is learnt from other recordings", hint="use accelcal study")
    return Fitting(settings, fit, optimizer.models, penalized, learnt or POPULATION)


def optimizer_json(settings: Settings) -> dict[str, Any]:
    """The report's `optimizer` object, before the fit; raises UsageError for an unknown optimizer."""
    optimizer = named_optimizer(settings.optimizer)
    numbers = asdict(_numbers(optimizer, settings))
    return {"name": optimizer.name, "arithmetic": optimizer.arithmetic, "settings": numbers}


def _numbers(optimizer: Optimizer, settings: Settings) -> Any:
    """The optimizer's own numbers for the settings' profile."""
    return optimizer.settings.get(settings.profile, optimizer.settings["default"])


class StillWindows(Observer):
    """Keeps all still windows, some 90 bytes each."""

    def __init__(self) -> None:
        self._parts: list[Windows] = []

    def see_still(self, windows: Windows) -> None:
        """Take windows in."""
        self._parts.append(windows)

    def result(self) -> Windows:
        """All of them."""
        return joined_windows(self._parts)


class Procedure(Observer):
    """Takes still windows in, and judges what they hold."""

    def result(self) -> PointSet:
        """The points that are fitted."""
        raise NotImplementedError

    def judge(self, how: Fitting) -> Judgement:
        """The verdict on all windows so far."""
        raise NotImplementedError

    def window_use(self, counts: WindowCounts) -> WindowUse:
        """How many windows had which fate, of so many from the segmenter."""
        raise NotImplementedError

    def subsets_full_after(self) -> int | None:
        """Samples of the recording that filled F's nine subsets; None where they are not full."""
        return None

    def orientations(self) -> int:
        """How many orientations are known; with more of them a fit is better."""
        raise NotImplementedError

    def fates(self, windows: Windows) -> Fates:
        """What became of each of the windows that were taken in."""
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
        """The facts with what the segmenter has seen."""
        seen = self.segmenter
        return replace(facts, gone_over=seen.gone_over, windows=seen.counts.complete, quietest=seen.quietest)

    def timed(self, rate_hz: float) -> Method:
        """The same with windows that carry their times."""
        plain = self.segmenter
        return replace(self, segmenter=TimedSegmenter(plain.length, plain.rule, rate_hz, plain.gaps))


def make_method(recording: Recording, settings: Settings) -> Method:
    """The method of the settings for one recording."""
    length = window_length(settings, recording.rate_hz)
    rule = chosen_rule(settings, recording.lsb_per_g, length)
    gaps = short_gaps(settings, length, recording.rate_hz)
    lsb_per_g = local_lsb_per_g(recording, settings)
    return Method(Segmenter(length, rule, gaps), _procedure(recording, settings, lsb_per_g), lsb_per_g)


def _procedure(recording: Recording, settings: Settings, lsb_per_g: float) -> Procedure:
    if settings.profile == "paper":
        return PaperProcedure(PaperCollector(lsb_per_g, settings))
    return TimedCellProcedure(recording, settings)


def local_lsb_per_g(recording: Recording, settings: Settings) -> float:
    """Raw counts in one local g: what rest should measure."""
    return recording.lsb_per_g * float(settings.gravity.local_g())


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

    def orientations(self) -> int:
        """Groups of cells."""
        return self.collector.orientations()

    def judge(self, how: Fitting) -> Judgement:
        """Choose a model and judge it."""
        saturated = self.collector.saturated()
        return judge(self.result(), how, self._why_none(how.settings), saturated=saturated)

    def _why_none(self, settings: Settings) -> str:
        """Why there are no points, if there are none."""
        counts = self.collector.counts()
        if settings.adaptive is not None:
            return "no rest comes near the quietest window of the recording; use another rule of --stillness"
        if counts.implausible:
            return FAR_FROM_1_G
        if counts.constant:
            return "still windows hold nothing but constant values: the device did not measure"
        return NO_STILLNESS

    def window_use(self, counts: WindowCounts) -> WindowUse:
        """Windows by fate."""
        cells = self.collector.counts()
        constant = 0 if cells.constant_used else cells.constant
        return window_use(counts, cells.implausible, constant, cells.far_temperature, cells.saturated)

    def fates(self, windows: Windows) -> Fates:
        """By the cells."""
        return self.collector.fates(windows)


class TimedCellProcedure(CellProcedure):
    """The same along one recording: also whether its sensor changed, and then with what puts that right.

    Attributes:
        hour_samples: samples that make an hour.
    """

    def __init__(self, recording: Recording, settings: Settings) -> None:
        lsb_per_g = local_lsb_per_g(recording, settings)
        temperature = settings.temperature and recording.has_temperature
        self.hour_samples = max(1, round(BLOCK_S * recording.rate_hz))
        super().__init__(
            CellCollector(lsb_per_g, settings, temperature=temperature, block_samples=self.hour_samples)
        )
        self.subsets = PaperCollector(lsb_per_g, replace(settings, min_distance_g=APART_G))
        self._correction: Correction | None = None
        self._rate_hz, self._local_g = recording.rate_hz, float(settings.gravity.local_g())
        self._begun_us: list[int] = []
        self._means: TimedMeans | None = None
        self._found: tuple[Correction | None, PointSet] | None = None

    def see(self, chunk: Chunk) -> None:
        """Note when hours begin; of one that a preview leaves out, when the next row comes."""
        while (row := max(0, self._next_hour() - chunk.first_sample)) < len(chunk):
            self._begun_us += chunk.clock.times(row, row + 1).tolist()

    def see_still(self, windows: Windows) -> None:
        """Take windows in."""
        super().see_still(windows)
        if self.subsets.full_after is None:
            self.subsets.add(windows)
        self._means = self._found = None

    def subsets_full_after(self) -> int | None:
        """By points as far apart as those of profile `paper`."""
        return self.subsets.full_after

    def begun_us(self, sample: int) -> int:
        """When the hour of a sample began, on the device's clock."""
        return self._begun_us[sample // self.hour_samples]

    def _next_hour(self) -> int:
        """The first sample of the hour that has not begun."""
        return len(self._begun_us) * self.hour_samples

    def judge(self, how: Fitting) -> Judgement:
        """Choose a model, judge it, look for a change of the sensor, and follow it where there is one."""
        self._correction = None
        verdict = super().judge(how)
        about = verdict.candidate or verdict.calibration
        if about is None:
            return verdict
        search = ChangeSearch(self.means())
        change = search.find(about)
        if change.at_block is not None:
            at_us = self.begun_us(change.at_block * self.collector.block_samples)
            change = replace(change, at_us=at_us)
        verdict = replace(verdict, change=change)
        return verdict if how.settings.recalibrate == NEVER else self._followed(verdict, how, search)

    def result(self) -> PointSet:
        """One point a cell, put right where the sensor changed."""
        if self._found is None or self._found[0] is not self._correction:
            self._found = self._correction, self.collector.points(self._correction)
        return self._found[1]

    def _followed(self, verdict: Judgement, how: Fitting, search: ChangeSearch) -> Judgement:
        """The verdict on the points of a sensor that is put right, if that gives a calibration."""
        if verdict.change is None or verdict.change.correction is None:
            return verdict
        change = verdict.change
        better = self._along(change, how)
        about = better.candidate or better.calibration
        if about is not None:
            change = search.refined(about, change)
            better = self._along(change, how)
        if better.calibration is None:
            self._correction = None
            return verdict
        followed = replace(
            better, calibration=replace(better.calibration, correction=change.correction), change=change
        )
        if (simpler := better.without_misalignment) is not None:
            along = replace(simpler, calibration=replace(simpler.calibration, correction=change.correction))
            followed = replace(followed, without_misalignment=along)
        return with_errors_before(followed, verdict)

    def _along(self, change: Change, how: Fitting) -> Judgement:
        """The verdict on points that are put right."""
        assert change.correction is not None
        self._correction = change.correction.in_local_g(how.settings.gravity.local_g())
        return super().judge(how)

    def means(self) -> TimedMeans:
        """What each orientation measured in each block of time, where it can be used."""
        if self._means is None:
            self._means = self._timed_means()
        return self._means

    def _timed_means(self) -> TimedMeans:
        timed, collector = self.collector.timed(), self.collector
        sums = [one for _, one in timed]
        samples = np.array([one.samples for one in sums], np.int64)
        scale = samples[:, np.newaxis] * (collector.lsb_per_g / self._local_g)
        mean_g = np.array([one.xyz for one in sums], np.int64).reshape(-1, 3) / scale
        celsius = np.array([one.temperature_mc for one in sums], np.int64) / (1000 * samples)
        return TimedMeans(
            np.array([block for block, _ in timed], np.int64),
            mean_g,
            celsius if collector.temperature else None,
            collector.block_samples,
            collector.block_samples / self._rate_hz / BLOCK_S,
            np.array([one.windows for one in sums], np.int64),
        )


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
        first, second = self.collector.fit, self.collector.control
        missing = first.missing(), second.missing()
        return judge_paper(first.points(), second.points(), missing, how)

    def window_use(self, counts: WindowCounts) -> WindowUse:
        """Windows by fate; few of the still ones are used."""
        return window_use(counts, self.collector.implausible, 0)

    def orientations(self) -> int:
        """Points of both sets, once these can be fitted and judged."""
        return len(self.collector) if self.collector.complete else 0

    def subsets_full_after(self) -> int | None:
        """By the set that is fitted."""
        return self.collector.full_after

    def fates(self, windows: Windows) -> Fates:
        """By the two sets."""
        return self.collector.fates(windows)


def window_use(
    counts: WindowCounts, implausible: int, constant: int, far: int = 0, saturated: int = 0
) -> WindowUse:
    """Windows by fate, from the segmenter's counts and the collector's."""
    fates = asdict(counts)
    return WindowUse(
        **{name: number for name, number in fates.items() if name != "still"},
        implausible=implausible,
        constant_left_out=constant,
        temperature_left_out=far,
        saturated_left_out=saturated,
        used=fates["still"] - implausible - constant - far - saturated,
    )


def survey(
    chunks: Iterable[Chunk],
    segmenter: Segmenter,
    observers: Sequence[Observer],
    progress: Progress = lambda _end_byte: None,
    threads: int = 1,
) -> None:
    """Show a recording's chunks, and its still windows but for exact repetitions, to all observers.

    Args:
        chunks: of `open_marked`, so that rows at the sensor's range are no stillness.

    Raises:
        UnreadableError: the recording cannot be read on.
    """

    def still() -> Iterator[Windows]:
        for chunk in prefetch(iter(chunks), threads):
            for observer in observers:
                observer.see(chunk)
            yield from segmenter.feed(chunk)
            progress(chunk.end_byte)
        yield from segmenter.finish()

    repetitions = Repetitions()
    for windows in repetitions.once(_batched(still())):
        for observer in observers:
            observer.see_still(windows)
    segmenter.counts += WindowCounts(still=-repetitions.windows, repeated=repetitions.windows)


def _batched(still: Iterable[Windows]) -> Iterator[Windows]:
    """The same windows a few thousand at a time; a batch has temperatures throughout, or none."""
    batch: list[Windows] = []
    number = 0
    for windows in still:
        if batch and (batch[0].temperature_sums is None) != (windows.temperature_sums is None):
            yield joined_windows(batch)
            batch, number = [], 0
        batch.append(windows)
        number += len(windows)
        if number >= BATCH_WINDOWS:
            yield joined_windows(batch)
            batch, number = [], 0
    if batch:
        yield joined_windows(batch)


def open_marked(
    path: Path,
    options: ReadOptions,
    threads: int = 1,
    unused: tuple[str, ...] = (),
    *,
    session: bool = False,
) -> Reader:
    """Open a recording; rows at the sensor's range are marked in their chunks' `validity`.

    Args:
        session: see `formats.open_recording`.

    Raises:
        UnreadableError, UsageError: see `formats.open_recording`.
    """
    return MarkingReader(open_recording(path, options, threads, unused, session=session))


class MarkingReader(Reader):
    """A reader of another one's chunks, with rows at the sensor's range marked."""

    def __init__(self, reader: Reader) -> None:
        self.reader, self.recording, self.threads = reader, reader.recording, reader.threads

    @property
    def files(self) -> tuple[PlacedFile, ...]:  # type: ignore[override]
        """See `Reader`."""
        return self.reader.files

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """See `Reader`."""
        chunks = map(in_columns, self.reader.chunks(chunk_samples))
        return (with_clipping(chunk, self.recording) for chunk in chunks)

    def intake(self) -> Intake:
        """See `Reader`."""
        return MarkingIntake(self.reader.intake(), self.recording)

    def preview(self, chunk_samples: int, pieces: int) -> Iterator[Chunk]:
        """See `Reader`."""
        return (with_clipping(chunk, self.recording) for chunk in self.reader.preview(chunk_samples, pieces))

    def close(self) -> None:
        """Release the file."""
        self.reader.close()


class MarkingIntake(Intake):
    """An intake of another one's chunks, with rows at the sensor's range marked."""

    def __init__(self, intake: Intake, recording: Recording) -> None:
        self._intake, self._recording = intake, recording

    def take(self, data: bytes, *, last: bool) -> Iterator[Chunk]:
        """See `Intake`."""
        return (with_clipping(chunk, self._recording) for chunk in self._intake.take(data, last=last))


def with_clipping(chunk: Chunk, recording: Recording) -> Chunk:
    """The chunk with rows at the sensor's range marked in `validity`.

    Behind the maker's calibration counts no longer tell: the reader marked the rows.
    """
    if recording.range_g is None or recording.of_bare_sensor:
        return chunk
    limit = int(recording.range_g * recording.lsb_per_g)
    return clipped_at(chunk, -limit, limit - 1)
