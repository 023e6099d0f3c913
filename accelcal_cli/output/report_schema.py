"""The schema of the report, and what is wrong with a document by it.

`fault` knows the part of JSON Schema that report.schema.json uses; keys that the schema does not know are
passed over, since a later version may add some.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from copy import deepcopy
from functools import cache, lru_cache
from math import inf, isfinite
from typing import Any


@cache
def report_schema() -> dict[str, Any]:
    """The JSON Schema of the report."""
    from importlib import resources  # only what is there already is held against it

    text = resources.files("accelcal_cli.output").joinpath("report.schema.json").read_text("utf-8")
    schema: dict[str, Any] = json.loads(text)
    return schema


LATER = {
    "settings.precision_mg": "0.1.0",
    "settings.max_damage_percent": "0.1.0",
    "settings.min_distance_g": "0.2.0",
    "settings.min_subset_points": "0.2.0",
    "settings.max_subset_points": "0.2.0",
    "settings.input.date_format": "0.1.0",
    "coverage.distinct_orientations": "0.2.0",
    "settings.input.force_timezone": "0.2.0",
    "recording.time_zone": "0.2.0",
    "file_health.clock": "0.1.0",
    "file_health.clock.dst_change.followed": "0.2.0",
    "file_health.lost_bytes": "0.1.0",
    "file_health.lost_percent": "0.1.0",
    "file_health.rest": "0.2.0",
    "holdout.improvement_factor": "0.2.0",
    "settings.prior": "0.2.0",
    "sphere_mg": "0.2.0",
    "without_misalignment": "0.2.0",
    "change": "0.2.0",
    "misfits": "0.2.0",
    "gyroscope": "0.2.0",
    "settings.recalibrate": "0.2.0",
    "settings.longest_gap_s": "0.2.0",
    "calibration.course": "0.2.0",
    "fit.windows.temperature_left_out": "0.2.0",
    "fit.windows.saturated_left_out": "0.2.0",
    "coverage.saturated": "0.2.0",
    "fit.windows.repeated": "0.2.0",
    "coverage.subsets_full_after_h": "0.2.0",
}
"""Keys that reports of versions before the named one may lack (docs/outputs.md); others were taken out."""


def release(version: Any) -> tuple[float, ...]:
    """A version in order; one that is none comes after all, so that nothing is excused by it."""
    numbers = re.fullmatch(r"(\d{1,6})\.(\d{1,6})\.(\d{1,6})", str(version))
    return (inf,) if numbers is None else tuple(map(int, numbers.groups()))


@lru_cache(8)
def schema_of_version(version: str) -> dict[str, Any]:
    """The schema of a report that this version of accelcal wrote: it may lack what came later."""
    schema = deepcopy(report_schema())
    for place, since in LATER.items():
        *outer, name = place.split(".")
        if release(version) < release(since):
            for held in _objects(schema, outer):
                held["required"] = [key for key in held.get("required", ()) if key != name]
    return schema


def _objects(schema: dict[str, Any], names: list[str]) -> Iterator[dict[str, Any]]:
    """What the schema says of the objects at the end of these keys."""
    for choice in schema.get("anyOf", ()):
        yield from _objects(choice, names)
    if not names:
        yield schema
    elif names[0] in schema.get("properties", {}):
        yield from _objects(schema["properties"][names[0]], names[1:])


_NAMES = {
    "object": "an object",
    "array": "a list",
    "string": "a text",
    "number": "a number",
    "integer": "a whole number",
    "boolean": "true or false",
    "null": "null",
}


def fault(value: Any, schema: dict[str, Any], where: str = "") -> str | None:
    """The first thing wrong with a value, such as `calibration.gain[0][2] is not a number`, or None."""
    kind = schema.get("type")
    if kind is not None and not _is(value, kind):
        return f"{where or 'it'} is not {_NAMES[kind]}"
    for check in _CHECKS:
        wrong = check(value, schema, where)
        if wrong is not None:
            return wrong
    return None


def _is(value: Any, kind: str) -> bool:
    if kind == "number":
        return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)
    if kind == "integer":
        return isinstance(value, int) and not isinstance(value, bool)
    types = {"object": dict, "array": list, "string": str, "boolean": bool, "null": type(None)}
    return isinstance(value, types[kind])


def _choice(value: Any, schema: dict[str, Any], where: str) -> str | None:
    if "enum" in schema and value not in schema["enum"]:
        return f"{where} is {value!r}, not one of {', '.join(map(str, schema['enum']))}"
    if "const" in schema and (value != schema["const"] or isinstance(value, bool)):
        return f"{where} is {value!r}, not {schema['const']!r}"
    return None


def _size(value: Any, schema: dict[str, Any], where: str) -> str | None:
    too_small = value < schema.get("minimum", value)
    if too_small or ("exclusiveMinimum" in schema and value <= schema["exclusiveMinimum"]):
        return f"{where} is {value}, which is too small"
    return None


def _text(value: Any, schema: dict[str, Any], where: str) -> str | None:
    if len(value) < schema.get("minLength", 0) or not re.search(schema.get("pattern", ""), value):
        return f"{where} is {value[:80]!r}, which is not valid"
    return None


def _scalar(value: Any, schema: dict[str, Any], where: str) -> str | None:
    if schema.get("type") in ("number", "integer"):
        return _size(value, schema, where)
    return _text(value, schema, where) if schema.get("type") == "string" else None


def _keys(value: Any, schema: dict[str, Any], where: str) -> str | None:
    if not isinstance(value, dict):
        return None
    start = f"{where}." if where else ""
    for name in schema.get("required", ()):
        if name not in value:
            return f"{start}{name} is missing"
    parts = ((name, part) for name, part in schema.get("properties", {}).items() if name in value)
    return _first((value[name], part, f"{start}{name}") for name, part in parts)


def _items(value: Any, schema: dict[str, Any], where: str) -> str | None:
    if not isinstance(value, list):
        return None
    if not schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", len(value)):
        return f"{where} has {len(value)} entries"
    part = schema.get("items", {})
    return _first((item, part, f"{where}[{index}]") for index, item in enumerate(value))


def _first(parts: Any) -> str | None:
    return next((wrong for part in parts if (wrong := fault(*part)) is not None), None)


def _branches(value: Any, schema: dict[str, Any], where: str) -> str | None:
    """`anyOf`: the fault of the branch that the value is of the kind of, else of the first."""
    faults = [(branch, fault(value, branch, where)) for branch in schema.get("anyOf", ())]
    if any(wrong is None for _, wrong in faults) or not faults:
        return None
    alike = (wrong for branch, wrong in faults if _is(value, branch.get("type", "null")))
    return next(alike, faults[0][1])


def _conditions(value: Any, schema: dict[str, Any], where: str) -> str | None:
    for part in schema.get("allOf", ()):
        chosen = "then" if fault(value, part.get("if", {}), where) is None else "else"
        wrong = fault(value, part.get(chosen, {}), where)
        if wrong is not None:
            return wrong
    return None


_CHECKS: tuple[Callable[[Any, dict[str, Any], str], str | None], ...] = (
    _choice, _scalar, _keys, _items, _branches, _conditions,
)  # fmt: skip
