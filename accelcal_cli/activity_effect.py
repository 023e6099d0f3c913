"""Measures of activity of one recording, raw and calibrated, with epochs of any length.

For a simulated recording, measures with its true parameters are compared too.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from accelcal_cli.core.calibration import Transform
from accelcal_cli.core.errors import UsageError, printable
from accelcal_cli.core.recording import Recording
from accelcal_cli.output.sentences import explained
from accelcal_cli.pipeline.activity import TRUE, EffectMeter, Version, drawn_of, versions_of
from accelcal_cli.pipeline.apply import with_coefficients
from accelcal_cli.pipeline.calibrate import OwnCalibration, open_run
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


def _truth(path: Path, recording: Recording) -> list[Version]:
    """Return the version by the true parameters of a simulated recording, if they are known."""
    if (truth := true_parameters(path)) is None:
        return []
    parameters = (truth.gain, truth.offset_g, truth.slope_g_per_c, truth.reference_c)
    return [Version(TRUE, None, Transform(*parameters, recording.lsb_per_g))]
