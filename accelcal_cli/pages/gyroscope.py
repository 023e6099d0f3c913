"""The part of a recording's page that is about its gyroscope."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from accelcal_cli.core.errors import counted
from accelcal_cli.pages.rendering import Rows, Table, decimals
from accelcal_cli.pages.svg import number


@dataclass(frozen=True, slots=True)
class Part:
    """What it says.

    Attributes:
        verdict: a sentence; reason: the report's message.
        coefficients: None if it was refused; errors: None if it never rested.
    """

    verdict: str
    reason: str
    coefficients: Table | None
    errors: Table | None


def gyroscope_of(report: Mapping[str, Any]) -> Part | None:
    """The part; None for a recording without a gyroscope, and for a report of before."""
    found = report.get("gyroscope")
    if found is None:
        return None
    verdict = "Calibrated: angular rates in the calibrated recording are put right."
    if found["outcome"] == "refused":
        verdict = "Not calibrated: angular rates in the calibrated recording are as measured."
    return Part(verdict, found["message"], _coefficients(found), _errors(found))


def _coefficients(found: Mapping[str, Any]) -> Table | None:
    if found["scale"] is None:
        return None
    errors = found["standard_errors"]
    rows: Rows = [
        [f"s_{row}{column}", _meaning(row, column), decimals(value), decimals(error)]
        for row, values, off in zip("xyz", found["scale"], errors["scale"], strict=True)
        for column, value, error in zip("xyz", values, off, strict=True)
    ]
    of_bias = errors["bias_dps"] or [None] * 3
    for axis, value, error in zip("xyz", found["bias_dps"], of_bias, strict=True):
        rows.append([f"b{axis}", f"bias of {axis} [deg/s]", decimals(value), decimals(error)])
    if found["temperature"] is not None:
        for axis, value in zip("xyz", found["temperature"]["slope_dps_per_c"], strict=True):
            rows.append([f"c{axis}", f"change of the bias of {axis} [deg/s per °C]", decimals(value), "–"])
    head = ["Name", "What it is", "Value", "Standard error"]
    return Table(f"Coefficients of {found['equation']}", head, rows, (0, 1))


def _meaning(row: str, column: str) -> str:
    return f"scale of {row}" if row == column else f"{column} in {row}"


def _errors(found: Mapping[str, Any]) -> Table | None:
    held, rest = found["holdout_deg"], found["rest"]
    rows: Rows = []
    if held is not None:
        turns = counted(found["pairs"], "turn")
        low, high = held["ci95"]
        rows += [
            [f"Gravity after a turn, raw, median of {turns}", f"{number(held['before'])} degrees off"],
            [
                "The same on turns that took no part, calibrated",
                f"{number(held['after'])} degrees off (95 % interval {number(low)} to {number(high)})",
            ],
        ]
    if rest is not None:
        rows.append(["At rest, raw", f"{number(rest['raw_dps'])} deg/s"])
        for name, text in (("constant_dps", "less a bias"), ("slope_dps", "less a bias with a slope")):
            if rest[name] is not None:
                rows.append([f"At rest, {text}, on time that took no part", f"{number(rest[name])} deg/s"])
    return Table("Errors of the gyroscope", ["", ""], rows, (0, 1)) if rows else None
