"""Reasons: why a result is what it is, what speaks against it and what to do, as codes with values.

A reason is data: programs compare codes and values, and `output/words.py` alone makes sentences of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import floor, isfinite, log10
from typing import Any

DIGITS = 4
"""Significant digits of a value: the last bits of linear algebra differ from machine to machine."""


def significant(value: float, digits: int = DIGITS) -> float:
    """Round to significant digits; numbers that are not finite stay as they are."""
    if value == 0:
        return 0.0
    return round(value, digits - 1 - floor(log10(abs(value)))) if isfinite(value) else value


@dataclass(frozen=True, slots=True)
class Reason:
    """A stable code, and the JSON values that its sentence needs."""

    code: str
    values: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, code: str, **values: Any) -> Reason:
        """Make a reason; floats are rounded, tuples become lists, and reasons among the values objects."""
        return cls(code, {name: _json_value(value) for name, value in values.items()})

    def as_json(self) -> dict[str, Any]:
        """Return the object that reports have."""
        return {"code": self.code, "values": dict(self.values)}


def _json_value(value: Any) -> Any:
    if isinstance(value, Reason):
        return value.as_json()
    if isinstance(value, float):
        return significant(value) if isfinite(value) else None
    if isinstance(value, list | tuple):
        return [_json_value(one) for one in value]
    return value
