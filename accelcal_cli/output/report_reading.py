"""Reports read from their files: whole documents, their sections checked against the schema, older versions.

`fault` knows the part of JSON Schema that report.schema.json uses; keys that the schema does not know are
passed over, since a later version may add some.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import stat
from collections.abc import Callable, Iterable, Iterator
from copy import deepcopy
from dataclasses import dataclass
from functools import cache, lru_cache
from math import inf, isfinite
from pathlib import Path
from typing import Any

from accelcal_cli.core.calibration import FIRST_NAMES
from accelcal_cli.core.door import look
from accelcal_cli.core.errors import UnreadableError, unread
from accelcal_cli.core.formats import EVERY_ROW
from accelcal_cli.output.files import looking_at, parsed
from accelcal_cli.output.report_view import ReportRecording, record

SCHEMA_VERSION = 3
LARGEST_BYTES = 64 << 20
"""Size of a file above which it cannot be a report, which has some thousand entries at most."""
NAME_ONE = "name a report, NAME.calibration.json"

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
    "recording.thermometer": "0.3.0",
    "holdout.improvement_factor": "0.2.0",
    "holdout.improvement_factor.ci95": "0.3.0",
    "without_misalignment.holdout.improvement_factor.ci95": "0.3.0",
    "settings.prior": "0.2.0",
    "calibration.optimizer.converged": "0.3.0",
    "calibration_error_mg": "0.3.0",
    "rest_scatter_mg": "0.3.0",
    "settings.strict": "0.3.0",
    "reason": "0.3.0",
    "values": "0.3.0",
    "notes": "0.3.0",
    "cautions": "0.3.0",
    "advice": "0.3.0",
    "models_tried.values": "0.3.0",
    "pool.left_out.values": "0.3.0",
    "gyroscope.reason": "0.3.0",
    "gyroscope.values": "0.3.0",
    "without_misalignment": "0.2.0",
    "without_misalignment.calibration_error_mg": "0.3.0",
    "change": "0.2.0",
    "misfits": "0.2.0",
    "gyroscope": "0.2.0",
    "settings.recalibrate": "0.2.0",
    "settings.longest_gap_s": "0.2.0",
    "settings.input.unused": "0.3.0",
    "settings.other_stillness": "0.3.0",
    "calibration.course": "0.2.0",
    "fit.windows.temperature_left_out": "0.2.0",
    "fit.windows.saturated_left_out": "0.2.0",
    "coverage.saturated": "0.2.0",
    "fit.windows.repeated": "0.2.0",
    "coverage.subsets_full_after_h": "0.2.0",
    "effect.left_out_percent": "0.3.0",
    "effect.ci95": "0.3.0",
    "effect.raw_bias": "0.3.0",
    "effect.versions.raw.angle_deg": "0.3.0",
    "effect.versions.without_misalignment.angle_deg": "0.3.0",
    "effect.versions.calibrated.angle_deg": "0.3.0",
    "file_health.missing_bytes": "0.3.0",
}
"""Keys that reports of versions before the given one may lack (docs/outputs.md)."""


@dataclass(frozen=True, slots=True)
class Document:
    """A report as its file has it: `sha256` of the file, and its content.

    Attributes:
        report: content with the names of this schema version.
        first: content as the file has it, if that is of an earlier schema version; else None.
    """

    path: Path
    sha256: str
    report: dict[str, Any]
    first: dict[str, Any] | None = None

    @property
    def recording(self) -> ReportRecording:
        """Section `recording`, once that has been checked."""
        return record(ReportRecording, self.report["recording"])

    @property
    def content_sha256(self) -> str:
        """SHA-256 of the content except `provenance`, as JSON with sorted keys."""
        original = self.report if self.first is None else self.first
        content = {name: value for name, value in original.items() if name != "provenance"}
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def read_document(path: Path) -> Document:
    """Read a report of this schema version or an earlier one; its sections are not checked.

    Raises:
        UnreadableError: it cannot be read, is not JSON, or no report of ours that this version knows.
    """
    data = document_bytes(path)
    try:
        report = parsed(data.decode())
    except UnicodeDecodeError as error:
        start = error.start
        raise UnreadableError("is not UTF-8 text", path=path, byte_offset=start, hint=NAME_ONE) from error
    except ValueError as error:
        raise UnreadableError(f"is not valid JSON ({error})", path=path, hint=NAME_ONE) from error
    if not isinstance(report, dict) or not {"accelcal_version", "schema_version"} <= report.keys():
        raise UnreadableError("is not a report of accelcal", path=path, hint=NAME_ONE)
    version, writer = report["schema_version"], report["accelcal_version"]
    if version not in (1, 2, SCHEMA_VERSION) or isinstance(version, bool):
        raise UnreadableError(
            f"has schema version {version!r} (of accelcal {writer!r}), not one of 1 to {SCHEMA_VERSION}",
            path=path,
            hint="calibrate its recording again with this version, or use the version that wrote it",
        )
    now = upgraded(report)
    return Document(path, hashlib.sha256(data).hexdigest(), now, None if now is report else report)


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
    schema = schema_of_version(str(document.report["accelcal_version"]))
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
    return report if isinstance(report, dict) and "accelcal_version" in report else None


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


def upgraded(report: dict[str, Any]) -> dict[str, Any]:
    """Return a report of an earlier schema version with this one's names; any other as it is.

    What only this version has (reasons as codes, the error without the scatter of rests) stays missing; the
    sentence on a model that was not used takes the place of its code.
    """
    version = report.get("schema_version")
    if version not in (1, 2) or isinstance(version, bool):
        return report
    old = version == 1 and "calibration" in report
    renamed: dict[str, Any] = {"calibration": with_new_names(report["calibration"])} if old else {}
    tried = report.get("models_tried")
    if isinstance(tried, list):
        renamed["models_tried"] = [{"values": {}} | one if isinstance(one, dict) else one for one in tried]
    renamed |= {"holdout": _with_factor(report["holdout"])} if "holdout" in report else {}
    if simpler := section(report, "without_misalignment"):
        renamed["without_misalignment"] = simpler | {"holdout": _with_factor(simpler.get("holdout"))}
    return report | {"schema_version": SCHEMA_VERSION} | renamed


def _with_factor(holdout: Any) -> Any:
    """Return a `holdout` whose factor, a plain number before schema version 3, is an object."""
    factor = holdout.get("improvement_factor") if isinstance(holdout, dict) else None
    if not isinstance(factor, int | float):
        return holdout
    return holdout | {"improvement_factor": {"value": factor}}


def with_new_names(calibration: Any) -> Any:
    """Return the `calibration` of schema version 1 with today's names of the parameters."""
    if not isinstance(calibration, dict):
        return calibration
    inner = {
        name: _renamed(calibration[name]) for name in ("parameters", "standard_errors") if name in calibration
    }
    integers = section(calibration, "fixed_point")
    if "parameters" in integers:
        inner["fixed_point"] = {**integers, "parameters": _renamed(integers["parameters"])}
    return calibration | inner


def _renamed(named: Any) -> Any:
    if not isinstance(named, dict):
        return named
    return {FIRST_NAMES.get(name, name): value for name, value in named.items()}


@cache
def report_schema() -> dict[str, Any]:
    """Read the JSON Schema of the report."""
    from importlib import resources  # most runs check no report

    text = resources.files("accelcal_cli.output").joinpath("report.schema.json").read_text("utf-8")
    schema: dict[str, Any] = json.loads(text)
    return schema


def release(version: Any) -> tuple[float, ...]:
    """Return the sort key of a version; anything that is not a version sorts last."""
    numbers = re.fullmatch(r"(\d{1,6})\.(\d{1,6})\.(\d{1,6})", str(version))
    return (inf,) if numbers is None else tuple(map(int, numbers.groups()))


@lru_cache(8)
def schema_of_version(version: str) -> dict[str, Any]:
    """Return the schema of reports that a version of accelcal wrote, which may lack later keys."""
    schema = deepcopy(report_schema())
    for place, since in LATER.items():
        *outer, name = place.split(".")
        if release(version) < release(since):
            for part in _objects(schema, outer):
                part["required"] = [key for key in part.get("required", ()) if key != name]
    return schema


def _objects(schema: dict[str, Any], names: list[str]) -> Iterator[dict[str, Any]]:
    """Find the schemas of the objects at the end of a path of keys."""
    for choice in (*schema.get("anyOf", ()), *([schema["items"]] if "items" in schema else [])):
        yield from _objects(choice, names)
    if not names:
        yield schema
    elif names[0] in schema.get("properties", {}):
        yield from _objects(schema["properties"][names[0]], names[1:])


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
