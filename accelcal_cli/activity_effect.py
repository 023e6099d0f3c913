"""Measures of activity of one recording, raw and calibrated, with epochs of any length.

For a simulated recording, measures with its true parameters are compared too.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from accelcal_cli.core.calibration import Transform
from accelcal_cli.core.errors import printable
from accelcal_cli.core.recording import Recording
from accelcal_cli.output.words import explained
from accelcal_cli.pipeline.activity import TRUE, EffectMeter, Version, drawn_of, versions_of
from accelcal_cli.pipeline.apply import with_coefficients
from accelcal_cli.pipeline.calibrate import OwnCalibration, open_run
from accelcal_cli.pipeline.jobs import Job, ProgressMaker, Request, no_progress
from accelcal_cli.pipeline.simulate import true_parameters


@dataclass(frozen=True, slots=True)
class MeasuredEffect:
    """The effect of a calibration on one recording.

    Attributes:
        outcome, message: outcome of the calibration, and its message.
        effect: measures of activity, as in a report; empty if it failed.
    """

    path: Path
    outcome: str
    message: str
    effect: dict[str, Any]


def effect(
    path: Path,
    request: Request,
    epoch_s: int,
    progress: ProgressMaker = no_progress,
    source: Path | None = None,
) -> MeasuredEffect:
    """Measure a recording raw and calibrated, by its own calibration or the request's coefficients.

    Args:
        epoch_s: length of an epoch, whole seconds.
        source: where the recording's bytes are, if not at its path.

    Raises:
        AccelcalError: it cannot be read, or the coefficients cannot be applied to it (see `apply`).
    """
    with open_run(Job(path, path, path), request, progress, source) as run:
        donor, judge = request.coefficients, OwnCalibration(request.recording_settings)
        ready, used = (run, judge) if donor is None else with_coefficients(run, donor)
        found = ready.result(used)
        made = [*versions_of(found.data), *_truth(path, found.data.recording)]
        meter = EffectMeter(made, found.data.recording, epoch_s, drawn_of(found.data))
        shown = progress("measuring", found.data.recording.total_bytes)
        for chunk in meter.watch(ready.reader.chunks(request.chunk_samples)):
            shown(chunk.end_byte)
        meter.finish()
    judgement = found.data.judgement
    message = explained(judgement.reason, judgement.notes)
    return MeasuredEffect(path, str(judgement.outcome), message, meter.result())


def _truth(path: Path, recording: Recording) -> list[Version]:
    """Return the version by the true parameters of a simulated recording, if they are known."""
    if (truth := true_parameters(path)) is None:
        return []
    parameters = (truth.gain, truth.offset_g, truth.slope_g_per_c, truth.reference_c)
    return [Version(TRUE, None, Transform(*parameters, recording.lsb_per_g))]


def as_json(found: MeasuredEffect) -> dict[str, Any]:
    """Return the effect as a JSON object."""
    return {
        "recording": printable(found.path),
        "outcome": found.outcome,
        "message": found.message,
        "effect": found.effect or None,
    }
