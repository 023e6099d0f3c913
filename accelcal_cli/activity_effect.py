"""Measures of activity of one recording, raw and calibrated, with epochs of any length.

For a simulated recording, measures with its true parameters are compared too.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.calibration import Transform
from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.errors import UsageError, printable
from accelcal_cli.core.recording import Chunk, Recording, Validity
from accelcal_cli.output.report import ReportInput
from accelcal_cli.output.sentences import explained
from accelcal_cli.pipeline.activity import (
    LEAST_MEASURED,
    MG,
    ONE_G,
    TRUE,
    DrawnActivity,
    EffectMeter,
    EpochCutter,
    EpochMeasures,
    Version,
    WholeEpochs,
    drawn_of,
    ends,
    fixed,
    lengths,
    versions_of,
)
from accelcal_cli.pipeline.apply import with_coefficients
from accelcal_cli.pipeline.calibrate import OwnCalibration, open_run
from accelcal_cli.pipeline.export import calibrated, transform_of
from accelcal_cli.pipeline.jobs import Job, Request
from accelcal_cli.simulate import true_parameters


def effect(path: Path, request: Request, epoch_s: int, source: Path | None = None) -> dict[str, Any]:
    """Measure a recording raw and calibrated, by its own calibration or the request's coefficients.

    Args:
        epoch_s: length of an epoch, whole seconds.
        source: where the recording's bytes are, if not at its path.

    Returns:
        `recording`, `outcome`, `message`, and `effect` as in a report.

    Raises:
        AccelcalError: it cannot be read, it is calibrated already, or the coefficients cannot be applied to
            it (see `apply`).
    """
    with open_run(Job(path, path, path), request, source=source) as run:
        if (before := run.reader.recording.calibrated) is not None:
            hint = f"give the raw recording, {before.name}"
            raise UsageError(f"holds values {before.sentence()}", path=path, hint=hint)
        donor, judge = request.coefficients, OwnCalibration(request.recording_settings)
        ready, used = (run, judge) if donor is None else with_coefficients(run, donor)
        found = ready.result(used)
        made = [*versions_of(found.data), *_truth(path, found.data.recording)]
        meter = EffectMeter(made, found.data.recording, epoch_s, drawn_of(found.data))
        for _ in meter.watch(ready.reader.chunks(request.chunk_samples)):
            pass
        meter.finish()
    judgement = found.data.judgement
    return {
        "recording": printable(path),
        "outcome": str(judgement.outcome),
        "message": explained(judgement.reason, judgement.notes),
        "effect": meter.result(),
    }


def epochs(chunks: Iterable[Chunk], data: ReportInput, epoch_s: int) -> dict[str, NDArray[Any]]:
    """Measure the epochs of a calibrated recording as `effect` does; those without a value are left out.

    Args:
        epoch_s: length of an epoch, whole seconds.

    Returns:
        columns (m,): `time_us`, its start on the device's clock; `sample`, the number of its first row;
        `samples`, how many were measured; ENMO, MAD and the arm's angle, with the ends of their 95 %
        intervals (NaN without a posterior); and the mean temperature (NaN without any).
    """
    drawn, rate_hz = drawn_of(data), data.recording.rate_hz
    cut, parts, least = EpochCutter.of(epoch_s, rate_hz), [], LEAST_MEASURED * epoch_s * rate_hz
    for chunk, xyz in calibrated(chunks, transform_of(data), lambda _byte: None):
        kept = slice(None) if chunk.validity is None else chunk.validity == Validity.MEASURED
        warm = np.zeros(len(chunk), np.int64) if chunk.temperature_mc is None else chunk.temperature_mc
        samples = chunk.first_sample + np.arange(len(chunk))
        columns: list[NDArray[Any]] = [chunk.time_us, samples, warm.astype(np.int64), *xyz]
        parts += [_measured(one, drawn, least) for one in cut.feed(*(each[kept] for each in columns))]
    parts += [_measured(one, drawn, least) for one in cut.finish()]
    made = {name: np.concatenate([one[name] for one in parts]) for name in parts[0]} if parts else {}
    if made:
        made["time_us"] *= epoch_s * MICROSECONDS
        if not data.facts.has_temperature:
            made["temperature_c"] = np.full(len(made["samples"]), np.nan)
    return made


def _measured(epochs: WholeEpochs, drawn: DrawnActivity, least: float) -> dict[str, NDArray[Any]]:
    samples, warm, *xyz = epochs.columns
    own = EpochMeasures.of(lengths(xyz), epochs)
    mean = np.stack([np.add.reduceat(fixed(axis), epochs.start) for axis in xyz], axis=1)
    mean = mean / epochs.rows[:, np.newaxis] / ONE_G
    celsius = np.add.reduceat(warm, epochs.start) / epochs.rows / 1000
    figures = {
        "enmo_mg": own.enmo * MG, "mad_mg": own.mad * MG,
        "angle_deg": np.degrees(np.arctan2(mean[:, 2], np.hypot(mean[:, 0], mean[:, 1]))),
    }  # fmt: skip
    limits = [np.full((2, len(celsius)), np.nan)] * len(figures)
    if drawn.draws:
        other = drawn.measured(epochs, [*xyz, (warm / 1000).astype(np.float32)])
        several = (other.enmo * MG, other.mad * MG, drawn.angles(mean, celsius))
        limits = [ends(np.vstack(pair)) for pair in zip(several, figures.values(), strict=True)]
    columns = {"time_us": epochs.number, "sample": samples[epochs.start], "samples": epochs.rows}
    for (name, values), (low, high) in zip(figures.items(), limits, strict=True):
        stem, unit = name.rsplit("_", 1)
        columns |= {name: values, f"{stem}_low_{unit}": low, f"{stem}_high_{unit}": high}
    valued = epochs.rows >= least
    return {name: values[valued] for name, values in (columns | {"temperature_c": celsius}).items()}


def _truth(path: Path, recording: Recording) -> list[Version]:
    """Return the version by the true parameters of a simulated recording, if they are known."""
    if (truth := true_parameters(path)) is None:
        return []
    parameters = (truth.gain, truth.offset_g, truth.slope_g_per_c, truth.reference_c)
    return [Version(TRUE, None, Transform(*parameters, recording.lsb_per_g))]
