"""The typed view of a report: its fields are the schema's, and older reports can be read."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest

from accelcal_cli.core.results import Outcome
from accelcal_cli.output.report_reading import report_schema
from accelcal_cli.output.report_view import ReportView, report_view
from tests.device_recordings import donor

Object = dict[str, Any]


def objects(schema: Object) -> Iterator[Object]:
    """The schemas of the objects that a value, or an entry of a list, may be."""
    for part in (schema, *schema.get("anyOf", ())):
        if "properties" in part:
            yield part
        if "items" in part:
            yield from objects(part["items"])


def records(
    kind: type[Any], schemas: list[Object], place: str = ""
) -> Iterator[tuple[str, type[Any], list[Object]]]:
    """Each record within a record, its place in the report, and the schemas of its object."""
    yield place, kind, schemas
    hints = get_type_hints(kind)
    for field in fields(kind):
        parts = [hints[field.name], *get_args(hints[field.name])]
        parts += [one for part in parts for one in get_args(part)]
        inner = next((one for one in parts if is_dataclass(one)), None)
        if isinstance(inner, type):
            found = [one for schema in schemas for one in objects(schema["properties"].get(field.name, {}))]
            yield from records(inner, found, f"{place}.{field.name}".removeprefix("."))


ALL = list(records(ReportView, [report_schema()]))


@pytest.mark.parametrize(("place", "kind", "schemas"), ALL, ids=[place or "report" for place, *_ in ALL])
def test_fields_are_keys_of_the_schema(place: str, kind: type[Any], schemas: list[Object]) -> None:
    assert schemas
    for field in fields(kind):
        default = field.default is not MISSING or field.default_factory is not MISSING
        assert all(field.name in schema["properties"] for schema in schemas)
        needed = all(field.name in schema.get("required", ()) for schema in schemas)
        assert default or needed, "a report may lack it"


def test_a_report_is_read_with_its_numbers(tmp_path: Path) -> None:
    report = json.loads(donor(tmp_path, warm=True).read_text())
    view = report_view(report)
    assert view.outcome is Outcome.CALIBRATED and view.holdout is not None and view.calibration is not None
    assert view.holdout.after_mg.mean == report["holdout"]["after_mg"]["mean"]
    assert view.calibration.parameters == report["calibration"]["parameters"]
    assert [trial.model for trial in view.models_tried] == [one["model"] for one in report["models_tried"]]
    assert view.recording.as_json() == report["recording"]
    assert view.setting("max_error_mg", 1.0) == report["settings"]["max_error_mg"]
    assert view.setting("profile", 1.0) == view.setting("no such", 1.0) == 1.0
