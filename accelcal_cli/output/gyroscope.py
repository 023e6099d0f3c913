"""The report's section `gyroscope`, which only recordings with a gyroscope have."""

from __future__ import annotations

from typing import Any

from accelcal_cli.core.gyroscope import EQUATION, Bias, Gyroscope, TurnHoldout
from accelcal_cli.output.report import significant


def gyroscope_json(found: Gyroscope) -> dict[str, Any]:
    """The object: coefficients as exact as they are applied, errors to four digits."""
    bias, errors = found.bias, found.standard_errors
    of_bias = None if bias is None else bias.standard_errors
    return {
        "outcome": found.outcome,
        "message": found.message,
        "equation": EQUATION,
        "scale": None if found.scale is None else [list(row) for row in found.scale],
        "bias_dps": None if bias is None else list(bias.dps),
        "temperature": None if bias is None else _temperature(bias),
        "standard_errors": {
            "scale": None if errors is None else [[significant(one) for one in row] for row in errors],
            "bias_dps": None if of_bias is None else [significant(one) for one in of_bias],
        },
        "pairs": found.pairs,
        "pairs_left_out": found.left_out,
        "holdout_deg": None if found.holdout is None else _holdout(found.holdout),
        "rest": None if bias is None else _rest(bias),
    }


def _temperature(bias: Bias) -> dict[str, Any] | None:
    if bias.reference_c is None:
        return None
    return {"slope_dps_per_c": list(bias.slope_dps_per_c), "reference_c": bias.reference_c}


def _holdout(holdout: TurnHoldout) -> dict[str, Any]:
    return {
        "before": significant(holdout.before),
        "after": significant(holdout.after),
        "ci95": [significant(one) for one in holdout.ci95],
        "mean_before": significant(holdout.mean_before),
        "mean_after": significant(holdout.mean_after),
        "rms_before": significant(holdout.rms_before),
        "rms_after": significant(holdout.rms_after),
    }


def _rest(bias: Bias) -> dict[str, Any]:
    held = {"raw_dps": bias.raw_dps, "constant_dps": bias.constant_dps, "slope_dps": bias.slope_dps}
    figures = {name: None if value is None else significant(value) for name, value in held.items()}
    return {"seconds": round(bias.rest_s, 3), **figures}
