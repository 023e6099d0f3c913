"""Reports read from their files: whole documents, and their sections checked against the schema.

`fault` knows the part of JSON Schema that `report_schema` uses; keys that the schema does not know are
passed over, since a later version may add some.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import stat
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from math import inf, isfinite
from pathlib import Path
from typing import Any

from accelcal_cli.core.declared import from_json, schema_of
from accelcal_cli.core.errors import UnreadableError, unread
from accelcal_cli.core.formats import EVERY_ROW
from accelcal_cli.core.identity import REPORT, is_ours, refuse_other
from accelcal_cli.core.paths import stat_or_none as look
from accelcal_cli.core.results import Outcome
from accelcal_cli.output.files import looking_at, parsed
from accelcal_cli.output.sections import RecordingSection, ReportView

FAILURES = {2: "wrong_usage", 3: "unreadable", 5: "not_written", 70: "bug", 71: "out_of_memory"}
"""Codes of failures, by exit code."""

LARGEST_BYTES = 64 << 20
"""Size of a file above which it cannot be a report, which has some thousand entries at most."""
NAME_ONE = "name a report, NAME.calibration.json"


@dataclass(frozen=True, slots=True)
class Document:
    """A report as its file has it: `sha256` of the file, and its content."""

    path: Path
    sha256: str
    report: dict[str, Any]

    @property
    def recording(self) -> RecordingSection:
        """Section `recording`, once that has been checked."""
        return from_json(RecordingSection, self.report["recording"])

    @property
    def content_sha256(self) -> str:
        """SHA-256 of the content except `provenance`, as JSON with sorted keys."""
        content = {name: value for name, value in self.report.items() if name != "provenance"}
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def read_document(path: Path) -> Document:
    """Read a report; its sections are not checked.

    Raises:
        UnreadableError: it cannot be read, is not JSON, or is not a report that this version knows.
    """
    data = document_bytes(path)
    try:
        report = parsed(data.decode())
    except UnicodeDecodeError as error:
        start = error.start
        raise UnreadableError("is not UTF-8 text", path=path, byte_offset=start, hint=NAME_ONE) from error
    except ValueError as error:
        raise UnreadableError(f"is not valid JSON ({error})", path=path, hint=NAME_ONE) from error
    refuse_other(report, REPORT, path)
    return Document(path, hashlib.sha256(data).hexdigest(), report)


def document_bytes(path: Path) -> bytes:
    """Read the bytes of a report, or of a file that lies next to it.

    Raises:
        UnreadableError: it cannot be read, or is larger than any of ours.
    """
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST_BYTES + 1)
    except OSError as error:
        raise unread(error, path) from error
    if len(data) > LARGEST_BYTES:
        raise UnreadableError("is too large for a report", path=path, hint=NAME_ONE)
    return data


def check_sections(document: Document, names: tuple[str, ...]) -> None:
    """Raise UnreadableError if sections of a report are missing or not what they should be."""
    schema = report_schema()
    wrong = fault(
        document.report,
        {
            "type": "object",
            "properties": {name: schema["properties"][name] for name in names},
            "required": [name for name in schema["required"] if name in names],
        },
    )
    if wrong:
        raise damaged(document, wrong)


def damaged(document: Document, what: str) -> UnreadableError:
    """Return the error of a report that accelcal did not write as it is now."""
    hint = "calibrate its recording again: accelcal did not write this report as it is now"
    return UnreadableError(f"is a damaged report: {what}", path=document.path, hint=hint)


def load_our_json(path: Path) -> dict[str, Any] | None:
    """Read a JSON file that accelcal wrote; None if the file is anything else.

    Raises:
        OutputError: it is there and cannot be read.
    """
    with looking_at(path):
        found = look(path)
        if found is None or not stat.S_ISREG(found.st_mode) or found.st_size > LARGEST_BYTES:
            return None
        return our_json(path.read_bytes())


def our_json(text: bytes) -> dict[str, Any] | None:
    """Return the content of a JSON file that accelcal wrote; None if it is anything else."""
    try:
        report = parsed(text.decode())
    except ValueError:
        return None
    return report if is_ours(report) else None


def section(report: dict[str, Any], *names: str) -> dict[str, Any]:
    """Return an object in a report, by the keys that lead to it; an empty one if there is none."""
    value: Any = report
    for name in names:
        value = value.get(name) if isinstance(value, dict) else None
    return value if isinstance(value, dict) else {}


def sensor_of(report: dict[str, Any]) -> str | None:
    """Return the sensor of its file that a report is of; None if it is of all the file."""
    sensor = section(report, "settings", "input").get("sensor")
    return sensor if isinstance(sensor, str) and sensor != EVERY_ROW else None


def file_place(report: dict[str, Any], name: str) -> str | None:
    """Return where a file was that a report was made of; None where its provenance does not say it."""
    files = section(report, "provenance", "files")
    place, folder = files.get(name), files.get("folder")
    if not isinstance(place, str) or place == "-":
        return None
    return os.path.join(folder, place) if isinstance(folder, str) else place  # noqa: PTH118 (text stays text)


def load_report(path: Path) -> dict[str, Any] | None:
    """Read a report of ours that names its recording's path, hash and size; None for any other file."""
    report, needed = load_our_json(path), ("path", "sha256", "bytes")
    if report is None:
        return None
    known = report_schema()["properties"]["recording"]["properties"]
    asked = {"type": "object", "required": needed, "properties": {name: known[name] for name in needed}}
    return report if fault(report.get("recording"), asked) is None else None


IF_REFUSED = {"properties": {"outcome": {"const": str(Outcome.REFUSED)}}}
IF_HELD_OUT = {
    "properties": {"outcome": {"enum": ["calibrated", "provisional", "reduced_model", "already_good"]}}
}
HELD_OUT = [
    {"properties": {"holdout": {"type": "object"}}},
    {"properties": {"known_orientations": {"required": ["unchecked"]}}, "required": ["known_orientations"]},
]
CONDITIONS = [
    {
        "if": IF_REFUSED,
        "then": {"properties": {"calibration": {"type": "null"}}},
        "else": {"properties": {"calibration": {"type": "object"}}},
    },
    {"if": IF_HELD_OUT, "then": {"anyOf": HELD_OUT}},
    {
        "if": {"properties": {"outcome": {"const": str(Outcome.BORROWED)}}},
        "then": {"required": ["coefficients"]},
    },
]
"""The conditions that the outcome of a report sets for its sections."""


@cache
def report_schema() -> dict[str, Any]:
    """Return the JSON Schema of the report, as `sections.py` declares it."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "accelcal calibration report",
        "description": " ".join((ReportView.__doc__ or "").split()),
        **schema_of(ReportView),
        "allOf": CONDITIONS,
        "$defs": {"failure": _failure_schema()},
    }


def _failure_schema() -> dict[str, Any]:
    """Return the schema of what `--json` prints for a recording that has no report."""
    report = schema_of(ReportView)
    known, unknown = report["properties"], {"description": "Not known.", "type": "null"}
    recording = known["recording"]
    own = {
        "recording": {
            "description": "The recording, of which no more than the name is known.",
            "type": "object",
            "required": recording["required"],
            "properties": {"path": recording["properties"]["path"]},
            "additionalProperties": unknown,
        },
        "outcome": {"description": "Outcome.", "const": "failed"},
        "reason": {"description": "Why it failed.", "enum": [*FAILURES.values(), "failed"]},
        "values": {
            "description": "The path as it was given, and the exit code of this recording.",
            "type": "object",
        },
    }
    same = ("kind", "schema_version", "accelcal_version", "message", "notes", "cautions", "advice")
    return {
        "description": "A line of `--json` for a recording that failed and has no report: the same keys, "
        "null where nothing is known. It is never written into a file.",
        "type": "object",
        "required": report["required"],
        "properties": {name: known[name] for name in same} | own,
        "additionalProperties": unknown,
    }


_TYPES: dict[str, tuple[tuple[type, ...], str]] = {
    "object": ((dict,), "an object"),
    "array": ((list,), "a list"),
    "string": ((str,), "a text"),
    "number": ((int, float), "a number"),
    "integer": ((int,), "a whole number"),
    "boolean": ((bool,), "true or false"),
    "null": ((type(None),), "null"),
}
"""Types of JSON Schema: the Python types of their values, and their names in messages."""


def fault(value: Any, schema: dict[str, Any], where: str = "") -> str | None:
    """Return the first thing wrong with a value, such as `calibration.gain[0][2] is not a number`."""
    kind = schema.get("type")
    if kind is not None and not _is(value, kind):
        return f"{where or 'it'} is not {_TYPES[kind][1]}"
    return _first(check(value, schema, where) for check in _CHECKS)


def _first(faults: Iterable[str | None]) -> str | None:
    return next((wrong for wrong in faults if wrong is not None), None)


def _is(value: Any, kind: str) -> bool:
    if isinstance(value, bool):
        return kind == "boolean"
    return isinstance(value, _TYPES[kind][0]) and not (isinstance(value, float) and not isfinite(value))


def _plain_value(value: Any, schema: dict[str, Any], where: str) -> str | None:
    if "enum" in schema and value not in schema["enum"]:
        return f"{where} is {value!r}, not one of {', '.join(map(str, schema['enum']))}"
    if "const" in schema and (value != schema["const"] or isinstance(value, bool)):
        return f"{where} is {value!r}, not {schema['const']!r}"
    if schema.get("type") in ("number", "integer"):
        if value < schema.get("minimum", value) or value <= schema.get("exclusiveMinimum", -inf):
            return f"{where} is {value}, which is too small"
    elif schema.get("type") == "string" and (
        len(value) < schema.get("minLength", 0) or not re.search(schema.get("pattern", ""), value)
    ):
        return f"{where} is {value[:80]!r}, which is not valid"
    return None


def _parts(value: Any, schema: dict[str, Any], where: str) -> str | None:
    if isinstance(value, list):
        if not schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", len(value)):
            return f"{where} has {len(value)} entries"
        part = schema.get("items", {})
        return _first(fault(item, part, f"{where}[{index}]") for index, item in enumerate(value))
    if not isinstance(value, dict):
        return None
    start = f"{where}." if where else ""
    missing = next((name for name in schema.get("required", ()) if name not in value), None)
    if missing is not None:
        return f"{start}{missing} is missing"
    known = ((name, part) for name, part in schema.get("properties", {}).items() if name in value)
    return _first(fault(value[name], part, f"{start}{name}") for name, part in known)


def _any_of(value: Any, schema: dict[str, Any], where: str) -> str | None:
    """Return the fault of the branch of `anyOf` that the value's type belongs to, else of the first."""
    faults = [(branch, fault(value, branch, where)) for branch in schema.get("anyOf", ())]
    if not faults or any(wrong is None for _, wrong in faults):
        return None
    return next((wrong for branch, wrong in faults if _is(value, branch.get("type", "null"))), faults[0][1])


def _conditions(value: Any, schema: dict[str, Any], where: str) -> str | None:
    return _first(
        fault(value, part.get("else" if fault(value, part.get("if", {}), where) else "then", {}), where)
        for part in schema.get("allOf", ())
    )


_CHECKS: tuple[Callable[[Any, dict[str, Any], str], str | None], ...] = (
    _plain_value, _parts, _any_of, _conditions,
)  # fmt: skip


if __name__ == "__main__":
    sys.stdout.write(json.dumps(report_schema(), indent=1) + "\n")
