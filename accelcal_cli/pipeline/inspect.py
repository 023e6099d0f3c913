"""A look at a recording without reading all of it (`accelcal inspect`)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from accelcal_cli.core import declared
from accelcal_cli.core.clock import iso_time
from accelcal_cli.core.errors import Reason, printable
from accelcal_cli.core.identity import identity
from accelcal_cli.core.local_time import zone_changes, zone_of_times
from accelcal_cli.core.points import WindowCounts
from accelcal_cli.core.recording import Chunk, Reader, Recording
from accelcal_cli.core.results import Facts, Judgement
from accelcal_cli.core.settings import DEFAULT, NO_PRIOR, Settings
from accelcal_cli.judge.errors import coverage
from accelcal_cli.judge.model_ladder import postures
from accelcal_cli.judge.verdict import (
    damage_verdict,
    judge_calibrated,
    refuse_provisional_if_rest_is_odd,
    with_advice,
)
from accelcal_cli.output import report as reports
from accelcal_cli.output.advice import of_file, of_rows
from accelcal_cli.output.report import (
    clock_section,
    failure_code,
    holdout_section,
    losses,
    notes_json,
    problem_section,
    rest_section,
)
from accelcal_cli.output.sentences import explained
from accelcal_cli.pipeline.facts import FactsObserver
from accelcal_cli.pipeline.jobs import Request
from accelcal_cli.pipeline.options import chosen_settings, name_options_as_in_file
from accelcal_cli.pipeline.procedures import fitting, make_method
from accelcal_cli.pipeline.survey import Observer, open_marked, survey

PREVIEW_PIECES = 64
PREVIEW_SAMPLES = 1 << 15
SMALL_BYTES = 8 << 20
"""Files up to this size [bytes] are read as a whole, which takes no longer."""

QUICK = "gauss-newton"
"""Optimizer that finds the default one's parameters to a few micro-g, a hundred times as fast."""

FIRST_ROWS = 3


@dataclass(frozen=True, slots=True)
class Values:
    """Raw values of the rows that were read; without rows, only `first` has a meaning.

    Attributes:
        low_g, mean_g, high_g: of x, y, z [g].
        first: time of each of the first rows [us, device clock], and its x, y, z [g].
    """

    low_g: tuple[float, ...] = ()
    mean_g: tuple[float, ...] = ()
    high_g: tuple[float, ...] = ()
    first: tuple[tuple[int, tuple[float, ...]], ...] = ()


@dataclass(frozen=True, slots=True)
class Inspection:
    """The findings of a look at a recording.

    Attributes:
        whole: every sample was read, so that the facts are the recording's own.
        prediction: judgement on the samples that were read.
        values: raw values of the samples that were read.
    """

    recording: Recording
    facts: Facts
    windows: WindowCounts
    prediction: Judgement
    whole: bool
    values: Values


class ValuesObserver(Observer):
    """Summarises raw values, which show people whether columns and unit are the right ones."""

    def __init__(self, lsb_per_g: float) -> None:
        self._lsb_per_g, self._samples = lsb_per_g, 0
        self._low, self._high = np.full(3, np.inf), np.full(3, -np.inf)
        self._sums = np.zeros(3, np.int64)
        self._first: list[tuple[int, tuple[float, ...]]] = []

    def see(self, chunk: Chunk) -> None:
        """Take a chunk's values in."""
        if not len(chunk):
            return
        number = min(len(chunk), FIRST_ROWS - len(self._first))
        rows = (chunk.counts[:number] / self._lsb_per_g).tolist()
        self._first += zip(chunk.clock.times(0, number).tolist(), map(tuple, rows), strict=True)
        self._low = np.minimum(self._low, chunk.counts.min(axis=0))
        self._high = np.maximum(self._high, chunk.counts.max(axis=0))
        self._sums += chunk.counts.sum(axis=0, dtype=np.int64)
        self._samples += len(chunk)

    def result(self) -> Values:
        """Return the summary."""
        if not self._samples:
            return Values()
        parts = (self._low, self._sums / self._samples, self._high)
        low, mean, high = (tuple((part / self._lsb_per_g).tolist()) for part in parts)
        return Values(low, mean, high, tuple(self._first))


def inspection_settings(values: dict[str, Any], *, full: bool) -> Settings:
    """Return the settings, as for `calibrate`; pieces are fitted by a quicker optimizer if none is named.

    Raises:
        UsageError: see `chosen_settings`.
    """
    wanted = chosen_settings(values)
    quick = not full and values["optimizer"] is None and wanted.profile == DEFAULT.profile
    return replace(wanted, optimizer=QUICK) if quick else wanted


def inspect(path: Path, request: Request, *, full: bool) -> Inspection:
    """Read a recording's description and pieces spread over it; read all with `full`, or if it is small.

    Raises:
        AccelcalError: it cannot be read.
    """
    said, settings = request.choices_of(path), request.recording_settings
    request = request.for_recording(path)
    opened = partial(open_marked, path, request.options, unused=request.unused, joined=request.joined)
    with name_options_as_in_file(said), opened() as reader:
        recording = reader.recording
        full |= recording.total_bytes <= SMALL_BYTES
        method = make_method(recording, settings)
        pieces = reader.chunks(PREVIEW_SAMPLES * 8) if full else _pieces(reader)
        observer = FactsObserver(recording, method.rest_lsb, method.segmenter.gaps)
        values = ValuesObserver(recording.lsb_per_g)
        survey(pieces, method.segmenter, (observer, values, method.procedure))
    facts = method.completed(observer.result())
    whole = full or facts.samples == recording.samples
    points = method.procedure.result()
    covered = coverage(points, postures(points, settings.posture_degrees))
    damage = damage_verdict(facts, settings.max_damage_percent, covered)
    fitter = fitting(replace(refuse_provisional_if_rest_is_odd(settings, facts, recording), prior=NO_PRIOR))
    if settings.prior != NO_PRIOR:  # by the default optimizer, where pieces are fitted by a quicker one
        fitter = replace(fitter, penalized=fitting(DEFAULT).penalized)
    prediction = damage
    if prediction is None and recording.calibrated is not None:
        prediction = judge_calibrated(points, fitter, recording.calibrated.sentence())
    if prediction is None:
        prediction = with_advice(method.procedure.judge(fitter), facts, recording, settings)
    facts = facts if whole else _to_its_end(facts, recording)
    return Inspection(recording, facts, method.segmenter.counts, prediction, whole, values.result())


def _to_its_end(facts: Facts, recording: Recording) -> Facts:
    """Add a change of the zone's offset that lies behind the pieces or between them."""
    start_us, lasts_s, change = recording.start_us, recording.duration_s, facts.zone_change
    if change is None and start_us is not None and lasts_s is not None:
        change = next(zone_changes(recording.timezone, start_us, start_us + round(1e6 * lasts_s)), None)
    if change is None or change.followed:
        return replace(facts, zone_change=change)
    return replace(facts, zone_change=replace(change, followed=None if recording.stamped else False))


def _pieces(reader: Reader) -> Iterator[Chunk]:
    """Yield pieces that are apart, so that no window and no measured rate spans two of them."""
    for chunk in reader.preview(PREVIEW_SAMPLES, PREVIEW_PIECES):
        breaks = np.union1d(chunk.breaks, np.zeros(min(1, len(chunk)), np.int64))
        yield replace(chunk, breaks=breaks, clock_jumps=chunk.clock_jumps[chunk.clock_jumps > 0])


def as_json(inspection: Inspection) -> dict[str, Any]:
    """Return the inspection as a JSON object."""
    recording, facts, prediction = inspection.recording, inspection.facts, inspection.prediction
    return {
        **identity("inspection"),
        "recording": {
            "path": printable(recording.path),
            "bytes": recording.total_bytes,
            "format": recording.format,
            "device": declared.as_json(recording.device),
            "sample_rate_hz": recording.rate_hz,
            "lsb_per_g": recording.lsb_per_g,
            "range_g": recording.range_g,
            "start_time": iso_time(recording.start_us, facts.utc_offset_s),
            "timezone": recording.timezone,
            "time_zone": zone_of_times(facts.utc_offset_s),
            "samples": facts.samples if inspection.whole else recording.samples,
            "duration_s": duration_s(inspection),
            "temperature": recording.has_temperature,
            "gyroscope": recording.gyro_dps_per_lsb is not None,
            "gaps": len(facts.gaps) + facts.gaps_omitted if inspection.whole else None,
            "notes": notes_json(recording, facts),
        },
        "file_health": {
            "problems": [declared.as_json(problem_section(problem)) for problem in facts.problems],
            "filled_samples": facts.counts.filled_samples,
            "clipped_samples": facts.counts.clipped_samples_before,
            "rate_hz_measured": None if facts.rate_hz is None else round(facts.rate_hz, 6),
            **losses(facts) | {"lost_percent": round(facts.lost_percent(), 4)},
            "clock": declared.as_json(clock_section(recording, facts, whole=inspection.whole)),
        },
        "read": {
            "whole": inspection.whole,
            "samples": facts.samples,
            "windows": inspection.windows.complete,
            "still_windows": inspection.windows.still + inspection.windows.joined,
        },
        "values": _values(inspection),
        "prediction": {
            "outcome": str(prediction.outcome),
            "reason": prediction.reason.code,
            "values": dict(prediction.reason.values),
            "message": explained(prediction.reason, prediction.notes),
            "cautions": [one.as_json() for one in (*_of_the_file(facts), *prediction.cautions)],
            "advice": [one.as_json() for one in prediction.advice],
            "holdout": declared.json_or_null(holdout_section(prediction.holdout)),
        },
    }


RECORDING = (
    "path", "bytes", "format", "device", "sample_rate_hz", "lsb_per_g", "range_g", "start_time", "timezone",
    "time_zone", "samples", "duration_s", "temperature", "gyroscope", "gaps", "notes",
)  # fmt: skip
"""Keys of the recording in the object of an inspection."""


def failed_json(path: Path, exit_code: int, message: str) -> dict[str, Any]:
    """Return the object of a file that cannot be read: the same keys, null where nothing is known."""
    prediction = {"outcome": "failed", "reason": failure_code(exit_code), "values": {"exit_code": exit_code}}
    return {
        **identity("inspection"),
        "recording": dict.fromkeys(RECORDING) | {"path": printable(path)},
        **dict.fromkeys(("file_health", "read", "values")),
        "prediction": prediction
        | {"message": printable(message), "cautions": [], "advice": [], "holdout": None},
    }


def _of_the_file(facts: Facts) -> list[Reason]:
    lost = (facts.lost_bytes, facts.lost_percent())
    health = of_file(facts.missing_if_known, *lost, facts.counts.filled_samples, facts.samples)
    return [*health, *of_rows(facts)]


def _values(inspection: Inspection) -> dict[str, Any] | None:
    """Return the raw values, and the mean of rest; None without samples."""
    values, facts = inspection.values, inspection.facts
    if not values.first:
        return None
    return {
        "first": [
            {"time": iso_time(time_us, facts.utc_offset_s), "g": [round(value, 4) for value in row]}
            for time_us, row in values.first
        ],
        **{name: [round(v, 4) for v in getattr(values, name)] for name in ("low_g", "mean_g", "high_g")},
        "rest": declared.json_or_null(rest_section(facts.rest)),
    }


def duration_s(inspection: Inspection) -> float | None:
    """Return the length [s], None if only reading everything would show it."""
    recording, facts = inspection.recording, inspection.facts
    known = inspection.whole and facts.first_us is not None
    return round(reports.duration_s(recording, facts), 6) if known else recording.duration_s
