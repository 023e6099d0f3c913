"""A review as one JSON object, and as rows of recordings."""

from __future__ import annotations

from dataclasses import asdict
from math import isfinite
from typing import Any

from accelcal_cli import __version__
from accelcal_cli.fleet.parameters import OFFSETS, PARAMETERS
from accelcal_cli.fleet.records import Floats
from accelcal_cli.fleet.review import Review
from accelcal_cli.fleet.trends import Trend
from accelcal_cli.fleet.unit import Unit

DEVICE = ("serial", "device_model", "format", "device_firmware")
TEMPERATURES = ("reference_c", "one_temperature_c")
SAID = ("path", "start_time", "outcome")
ERRORS = ("before_mg", "after_mg", "ci95_low_mg", "ci95_high_mg", "lost_percent")
AT_ONE = tuple(f"{parameter.column}_at_one_temperature" for parameter in PARAMETERS[OFFSETS])


def as_json(review: Review, units: tuple[Unit, ...]) -> dict[str, Any]:
    """All that is known of some devices; null for what is not."""
    kinds = [
        {"model": model or None, "format": name or None, **asdict(known)}
        for (model, name), known in review.kinds.items()
    ]
    return {
        "accelcal_version": __version__,
        "recordings": len(review.records) + review.records.nameless,
        "without_serial": review.records.nameless,
        "failed_without_serial": review.records.failed,
        "rules": asdict(review.rules),
        "kinds": kinds,
        "devices": [_device(review, unit) for unit in units],
    }


def _device(review: Review, unit: Unit) -> dict[str, Any]:
    return {
        "serial": unit.device.serial,
        "model": unit.device.model or None,
        "format": unit.device.format or None,
        "firmware": list(unit.firmware),
        "verdict": str(unit.verdict),
        "reasons": [asdict(one) for one in unit.reasons],
        "recordings": unit.recordings,
        "uses": {str(use): number for use, number in sorted(unit.counts.items())},
        "damaged": unit.damaged,
        "first": unit.begin,
        "last": unit.end,
        "held_out_mg": unit.held_out_mg,
        "reference_c": unit.reference_c,
        "parameters": {trend.parameter.name: _trend(trend) for trend in unit.trends},
        "history": [row(review, unit, at) for at in unit.rows],
    }


def _trend(trend: Trend) -> dict[str, Any]:
    return {
        "unit": trend.parameter.unit,
        "value": trend.value,
        "standard_error": trend.error,
        "recordings": trend.number,
        "drift": None if trend.drift is None else asdict(trend.drift),
    }


def row(review: Review, unit: Unit, at: int) -> dict[str, Any]:
    """One recording of a device: a row of the CSV, in the study's units."""
    records = review.records
    device = {"serial": unit.device.serial, "device_model": unit.device.model or None}
    own = {"format": unit.device.format or None, "device_firmware": records.text["device_firmware"][at]}
    said = {name: records.text[name][at] for name in SAID}
    numbers = {name: _number(records.number[name], at) for name in ERRORS}
    return {
        **device,
        **own,
        "verdict": str(unit.verdict),
        **said,
        "use": str(review.use[at]),
        "model": records.text["model"][at],
        **numbers,
        **_parameters(review, at),
        "message": records.text["message"][at],
    }


def columns() -> list[str]:
    """Names of a row's columns, in their order."""
    parameters = [name for one in PARAMETERS for name in (one.column, f"se_{one.column}")]
    moved = [name for one in AT_ONE for name in (one, f"se_{one}")]
    return [*DEVICE, "verdict", *SAID, "use", "model", *ERRORS, *parameters, *TEMPERATURES, *moved, "message"]


def _parameters(review: Review, at: int) -> dict[str, float | None]:
    """Parameters with their standard errors, and the offsets at the device's one temperature."""
    records, moved = review.records, review.referred.records
    told: dict[str, float | None] = {}
    for index, parameter in enumerate(PARAMETERS):
        told[parameter.column] = _number(records.values[:, index], at)
        told[f"se_{parameter.column}"] = _number(records.errors[:, index], at)
    told["reference_c"] = _number(records.number["reference_c"], at)
    device = int(records.first.searchsorted(at, side="right")) - 1
    told["one_temperature_c"] = _number(review.referred.temperature_c, device)
    for name, index in zip(AT_ONE, range(12)[OFFSETS], strict=True):
        told[name] = _number(moved.values[:, index], at)
        told[f"se_{name}"] = _number(moved.errors[:, index], at)
    return told


def _number(held: Floats, at: int) -> float | None:
    found = float(held[at])
    return found if isfinite(found) else None
