"""Coefficients as JSON, for reports and for other tools: exact integers, and numbers as people read them."""

from __future__ import annotations

from typing import Any

from accelcal_cli.core.course import Course
from accelcal_cli.core.fixed import FRACTION_BITS, to_float
from accelcal_cli.core.points import PARAMETER_NAMES, UPPER_NAMES, Calibration

EQUATION = "a = K (v + o + s (T - Tref))"


def coefficients_json(calibration: Calibration) -> dict[str, Any]:
    """What is needed to apply a calibration."""
    return {
        "model": calibration.model,
        "gain": calibration.gain().tolist(),
        "offset_g": calibration.offset_g().tolist(),
        "parameters": {name: to_float(value) for name, value in _integers(calibration, 9).items()},
        "temperature": _temperature(calibration),
        "course": _course(calibration.course),
        "equation": EQUATION,
        "fixed_point": _fixed_point(calibration),
        "gravity": {
            "local_g": float(calibration.gravity.local_g()),
            "latitude": calibration.gravity.latitude,
            "altitude": calibration.gravity.altitude_m,
        },
    }


def _course(course: Course | None) -> dict[str, Any] | None:
    """What takes the place of v, knot by knot."""
    if course is None:
        return None
    knots = zip(course.samples, course.stretch, course.shift, strict=True)
    return {
        "between": "lines" if course.lines else "jumps",
        "knots": [
            {
                "sample": sample,
                "stretch": [to_float(value) for value in stretch],
                "shift_g": [to_float(value) for value in shift],
                "fixed_point": {"stretch": list(stretch), "shift": list(shift)},
            }
            for sample, stretch, shift in knots
        ],
    }


def _integers(calibration: Calibration, number: int) -> dict[str, int]:
    """Parameters by name; those above K's diagonal only where there are any."""
    named = dict(zip(PARAMETER_NAMES[:number], calibration.parameters, strict=False))
    return named | dict(zip(UPPER_NAMES, calibration.upper, strict=True)) if any(calibration.upper) else named


def _temperature(calibration: Calibration) -> dict[str, Any] | None:
    if calibration.temperature is None:
        return None
    return {"slope_g_per_c": calibration.slope_g_per_c().tolist(), "reference_c": calibration.reference_c()}


def _fixed_point(calibration: Calibration) -> dict[str, Any]:
    scale = calibration.temperature
    return {
        "fraction_bits": FRACTION_BITS,
        "parameters": _integers(calibration, 12),
        "temperature_reference_mc": None if scale is None else scale.reference_mc,
        "temperature_span_c": None if scale is None else scale.span_c,
    }
