"""Claims held against data that were not seen: segments of a recording, judged on the rest of it.

A segment of a few hours is calibrated as if it were all there is. What its report claims is then compared
with the error that the calibration leaves on the still windows of the rest of the recording, where the wrist
was in other postures too. Segments on which a simulated sensor was worn: evaluate/sensors.py.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.collect.cells import CellCollector
from accelcal_cli.collect.table import read_table, windows_of
from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.points import Windows
from accelcal_cli.core.results import Judgement
from accelcal_cli.core.settings import Settings
from accelcal_cli.judge.errors import mean
from accelcal_cli.judge.verdict import held_out
from accelcal_cli.pipeline.jobs import ProgressMaker, no_progress
from accelcal_cli.pipeline.stated import options_of
from accelcal_cli.pipeline.survey import (
    CellProcedure,
    StillWindows,
    fitting,
    local_lsb_per_g,
    make_method,
    open_marked,
    survey,
)

REST = "the rest of the recording"
HOUR_S = 3600.0


@dataclass(frozen=True, slots=True, eq=False)
class Stillness:
    """The still windows of a recording.

    Attributes:
        hours: (m,) when each began, from the start of the recording.
        lsb_per_g: counts of one local g.
    """

    windows: Windows
    hours: NDArray[np.float64]
    span_h: float
    lsb_per_g: float
    has_temperature: bool


@dataclass(frozen=True, slots=True)
class Segment:
    """What became of one segment.

    Attributes:
        hours, start_h: length, and start in the recording.
        raw_mg: error on the rest without calibration; None if there is too little of it. Of a simulated
            sensor: the true one over the whole sphere.
        true_mg: the same with the segment's calibration, None without one.
        claimed_mg, ci95_mg: the report's headline, None without one.
        holdout_mg: held-out error within the segment.
        sensor: number of the simulated sensor, None if it is the recording's own.
        measured_mg: of a simulated sensor, `true_mg` as rests on a wrist would show it, whose |a| scatters.
    """

    hours: float
    start_h: float
    outcome: str
    model: str | None
    raw_mg: float | None
    true_mg: float | None
    claimed_mg: float | None
    ci95_mg: tuple[float, float] | None
    holdout_mg: float | None
    sensor: int | None = None
    measured_mg: float | None = None

    @property
    def holds(self) -> bool | None:
        """Whether the interval holds the error, with the scatter of rests, of which the claim is."""
        error_mg = self.true_mg if self.measured_mg is None else self.measured_mg
        if self.ci95_mg is None or error_mg is None:
            return None
        return self.ci95_mg[0] <= error_mg <= self.ci95_mg[1]


@dataclass(frozen=True, slots=True)
class Summary:
    """Segments together; None where there is none to say it of.

    Attributes:
        usable: how many have a calibration.
        true_mg: mean error of these on the rest; raw_mg without calibration.
        above_limit: how many have an error on the rest of `max_error_mg` or more.
        worse: how many have a larger error on the rest than without calibration.
        holds: share of the intervals that hold the error on the rest.
        measured_mg: of simulated sensors, the mean error as rests show it.
    """

    segments: int
    usable: int
    raw_mg: float | None
    true_mg: float | None
    claimed_mg: float | None
    above_limit: int
    worse: int
    holds: float | None
    measured_mg: float | None = None


def stillness(
    path: Path,
    options: ReadOptions,
    settings: Settings,
    chunk_samples: int,
    progress: ProgressMaker = no_progress,
) -> Stillness:
    """All still windows of a recording.

    Raises:
        AccelcalError: it cannot be read.
    """
    with open_marked(path, options_of(path, options)) as reader:
        recording = reader.recording
        kept = StillWindows()
        shown = progress("finding stillness", recording.total_bytes)
        segmenter = make_method(recording, settings).segmenter
        survey(reader.chunks(chunk_samples), segmenter, (kept,), shown)
        windows = kept.result()
        hours = windows.first_sample / (recording.rate_hz * HOUR_S)
        temperature = settings.temperature and recording.has_temperature
        lsb_per_g = local_lsb_per_g(recording, settings)
        return Stillness(windows, hours, float(hours.max(initial=0)), lsb_per_g, temperature)


def stillness_of_table(path: Path, settings: Settings, span_h: float) -> Stillness:
    """The windows of a table in the order of time, spread evenly over so many hours.

    Raises:
        UnreadableError: it is no table of points.
    """
    table = read_table(path)
    windows = windows_of(table)
    hours = windows.first_sample / max(1, len(table)) * span_h
    temperature = settings.temperature and table.temperature_mc is not None
    lsb_per_g = table.lsb_per_g * float(settings.gravity.local_g())
    return Stillness(windows, hours, span_h, lsb_per_g, temperature)


def segments(still: Stillness, hours: float, number: int, settings: Settings) -> Iterator[Segment]:
    """Segments of so many hours, at most `number` of them and half overlapping at most, evenly spread.

    Raises:
        UsageError: the settings have a profile without orientation cells.
    """
    for start in starts(still, hours, number, settings):
        yield _segment(still, start, hours, settings)


def starts(still: Stillness, hours: float, number: int, settings: Settings) -> list[float]:
    """When segments begin [h]; raises UsageError for a profile without orientation cells."""
    if settings.profile != "default":
        raise UsageError("segments are judged with --profile default only", hint="omit --profile")
    room = still.span_h - hours
    if room < 0:
        return []
    count = min(number, max(1, int(2 * room / hours) + 1))
    found: list[float] = np.linspace(0, room, count).tolist()
    return found


def _segment(still: Stillness, start_h: float, hours: float, settings: Settings) -> Segment:
    which = inside(still, start_h, hours)
    judgement = collected(still, which, settings).judge(fitting(settings))
    rest = collected(still, ~which, settings).result()
    raw = true = None
    if judgement.calibration is not None:
        held = held_out(rest, judgement.calibration, settings.gravity, settings.posture_degrees, REST)
        raw, true = (None, None) if held is None else (held.before.mean, held.after.mean)
    return claimed(judgement, hours, start_h, raw, true)


def inside(still: Stillness, start_h: float, hours: float) -> NDArray[np.bool_]:
    """Which windows lie in a segment, (m,)."""
    return np.asarray((still.hours >= start_h) & (still.hours < start_h + hours))


def claimed(
    judgement: Judgement, hours: float, start_h: float, raw: float | None, true: float | None
) -> Segment:
    """A segment's own claim, beside the errors without and with its calibration."""
    calibration, sphere, holdout = judgement.calibration, judgement.sphere, judgement.holdout
    claimed, interval = None, None
    if calibration is not None and sphere is not None:
        claimed, interval = sphere.mean, sphere.ci95
    elif calibration is not None and holdout is not None:
        claimed, interval = holdout.after.mean, holdout.ci95
    return Segment(
        hours=hours,
        start_h=start_h,
        outcome=str(judgement.outcome),
        model=None if calibration is None else calibration.model,
        raw_mg=raw,
        true_mg=true,
        claimed_mg=claimed,
        ci95_mg=interval,
        holdout_mg=None if holdout is None else holdout.after.mean,
    )


def collected(still: Stillness, which: NDArray[np.bool_], settings: Settings) -> CellProcedure:
    """Some windows, as the procedure takes them in."""
    collector = CellCollector(still.lsb_per_g, settings, temperature=still.has_temperature)
    collector.add(still.windows.select(which))
    return CellProcedure(collector)


def summary(found: list[Segment], limit_mg: float) -> Summary:
    """All segments together."""
    usable = [item for item in found if item.true_mg is not None and item.raw_mg is not None]
    held = [item.holds for item in usable if item.holds is not None]
    return Summary(
        segments=len(found),
        usable=len(usable),
        raw_mg=_mean([item.raw_mg for item in usable]),
        true_mg=_mean([item.true_mg for item in usable]),
        claimed_mg=_mean([item.claimed_mg for item in usable]),
        above_limit=sum((item.true_mg or 0) >= limit_mg for item in usable),
        worse=sum((item.true_mg or 0) > (item.raw_mg or 0) for item in usable),
        holds=sum(held) / len(held) if held else None,
        measured_mg=_mean([item.measured_mg for item in usable]),
    )


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return mean(known) if known else None
