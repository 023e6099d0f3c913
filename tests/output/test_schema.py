"""Our check of a document against that of the jsonschema package, on every damage of a real report."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from typing import Any

import jsonschema
import pytest

from accelcal_cli.core.settings import PoseSettings, Settings
from accelcal_cli.output.report_reading import fault, report_schema
from tests.device_recordings import donor

WRONG: list[Any] = [None, True, -1, 1.5, "", [], {}]


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> dict:
    held = json.loads(donor(tmp_path_factory.mktemp("donor"), warm=True).read_text())
    return held | {"models_tried": held["models_tried"][-1:]}


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    yield path
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in inner:
        yield from places(part, (*path, key))


def changed(report: dict, path: tuple[Any, ...], value: Any, *, drop: bool = False) -> dict:
    held = copy.deepcopy(report)
    inside = held
    for key in path[:-1]:
        inside = inside[key]
    if drop:
        del inside[path[-1]]
    else:
        inside[path[-1]] = value
    return held


def tolerant(schema: Any) -> Any:
    """The schema without its ban on further keys."""
    if isinstance(schema, dict):
        return {key: tolerant(part) for key, part in schema.items() if key != "additionalProperties"}
    return [tolerant(part) for part in schema] if isinstance(schema, list) else schema


def test_a_real_report_has_no_fault(report: dict) -> None:
    assert fault(report, report_schema()) is None
    assert fault({**report, "later": 1}, report_schema()) is None


def test_the_settings_that_every_report_needs_are_those_that_are_declared() -> None:
    needed = set(report_schema()["properties"]["settings"]["required"]) - {"report_only", "input"}
    for settings in (Settings(), PoseSettings()):
        assert needed <= settings.as_json().keys()


@pytest.mark.parametrize("step", [5, pytest.param(1, marks=pytest.mark.nightly)])
def test_every_missing_key_is_named(report: dict, step: int) -> None:
    oracle = jsonschema.Draft202012Validator(tolerant(report_schema()))
    for path in list(places(report))[::step]:
        if path and isinstance(path[-1], str):
            damaged = changed(report, path, None, drop=True)
            found = fault(damaged, report_schema())
            assert (found is None) == oracle.is_valid(damaged), path
            assert found is None or f"{path[-1]} is missing" in found


@pytest.mark.parametrize("step", [37, pytest.param(1, marks=pytest.mark.nightly)])
def test_every_wrong_value_is_found_as_jsonschema_finds_it(report: dict, step: int) -> None:
    oracle = jsonschema.Draft202012Validator(tolerant(report_schema()))
    for path in list(places(report))[::step]:
        for value in WRONG if path and path[0] not in ("settings", "provenance") else ():
            damaged = changed(report, path, value)
            assert (fault(damaged, report_schema()) is None) == oracle.is_valid(damaged), (path, value)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ([[1, 0, 0], [0, "x", 0], [0, 0, 1]], "calibration.gain[1][1] is not a number"),
        ([[1, 0], [0, 1, 0], [0, 0, 1]], "calibration.gain[0] has 2 entries"),
        ("x", "calibration.gain is not a list"),
    ],
)
def test_the_place_is_named(report: dict, value: Any, text: str) -> None:
    assert fault(changed(report, ("calibration", "gain"), value), report_schema()) == text


def test_a_number_that_is_not_finite_is_none(report: dict) -> None:
    for value in (float("nan"), float("inf")):
        damaged = changed(report, ("calibration", "offset_g", 1), value)
        assert fault(damaged, report_schema()) == "calibration.offset_g[1] is not a number"


def test_conditions_hold(report: dict) -> None:
    assert fault({**report, "outcome": "refused"}, report_schema()) is not None
    assert fault({**report, "outcome": "refused", "calibration": None}, report_schema()) is None
    assert fault({**report, "calibration": None}, report_schema()) is not None
    assert fault({**report, "holdout": None}, report_schema()) is not None
    assert "coefficients is missing" in str(fault({**report, "outcome": "borrowed"}, report_schema()))


def test_the_schema_uses_nothing_that_is_not_checked() -> None:
    known = {
        "$schema", "title", "description", "type", "properties", "required", "additionalProperties", "items",
        "minItems", "maxItems", "minimum", "exclusiveMinimum", "minLength", "pattern", "enum", "const",
        "anyOf", "allOf", "if", "then", "else", "$defs",
    }  # fmt: skip

    def words(schema: Any) -> Iterator[str]:
        if isinstance(schema, list):
            for part in schema:
                yield from words(part)
        elif isinstance(schema, dict):
            for key, part in schema.items():
                yield key
                inner = part.values() if key in ("properties", "$defs") else [part]
                for item in inner:
                    yield from words(item)

    assert set(words(report_schema())) <= known


def arrays(schema: Any, path: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    if isinstance(schema, dict):
        if schema.get("type") == "array":
            yield path, schema
        for key, part in schema.items():
            yield from arrays(part, f"{path}/{key}")
    elif isinstance(schema, list):
        for part in schema:
            yield from arrays(part, path)


def test_every_list_of_numbers_has_its_length() -> None:
    """Who reads them takes them apart by place."""
    held = [(path, part) for path, part in arrays(report_schema()) if part.get("maxItems") != 0]
    numbers = [(path, part) for path, part in held if part["items"].get("type") != "object"]
    free = {path for path, part in numbers if "maxItems" not in part and part["items"]["type"] != "string"}
    covariance = {path for path in free if "/covariance/" in path}  # of as many parameters as are fitted
    assert numbers and covariance and free == covariance
