"""The fit as integers: points in, coefficients out, for firmware and for a check bit by bit."""

from __future__ import annotations

from typing import Any

from accelcal_cli import __version__
from accelcal_cli.core.fixed import FRACTION_BITS
from accelcal_cli.core.points import PARAMETER_NAMES, WEIGHT_ONE, PointSet
from accelcal_cli.output.report import ReportInput


def integers_json(data: ReportInput, points: PointSet) -> dict[str, Any] | None:
    """Points and parameters as fixed-point integers; None where the recording was refused."""
    verdict = data.judgement
    if verdict.calibration is None or verdict.fit is None:
        return None
    scale = points.temperature
    return {
        "accelcal_version": __version__,
        "sha256": data.sha256,
        "fraction_bits": FRACTION_BITS,
        "weight_one": WEIGHT_ONE,
        "optimizer": data.optimizer,
        "model": verdict.calibration.model,
        "points": points.xyz.tolist(),
        "weights": points.weights.tolist(),
        "temperatures": None if points.tau is None else points.tau.tolist(),
        "temperature_reference_mc": None if scale is None else scale.reference_mc,
        "temperature_span_c": None if scale is None else scale.span_c,
        "parameters": dict(zip(PARAMETER_NAMES, verdict.fit.parameters, strict=True)),
        "iterations": verdict.fit.iterations,
        "stop": verdict.fit.stop,
    }
