"""Every key of the files that accelcal writes has a description in its schema."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from accelcal_cli.core.results import Outcome
from accelcal_cli.output.quality import quality_schema
from accelcal_cli.output.report_reading import report_schema


def schema(name: str) -> Any:
    """Return a schema of the package."""
    return report_schema() if name == "report" else quality_schema()


def keys(node: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield each key of a schema with its node; conditions are left out."""
    for name, child in node.get("properties", {}).items():
        yield f"{path}.{name}", child
        yield from keys(child, f"{path}.{name}")
    for inner in (node.get("items"), node.get("additionalProperties")):
        if isinstance(inner, dict):
            yield from keys(inner, f"{path}[]")
    for branch in ("anyOf", "oneOf") if path else ():
        for one in node.get(branch, ()):
            yield from keys(one, path)


@pytest.mark.parametrize("name", ["report", "quality"])
def test_every_key_is_described(name: str) -> None:
    found = list(keys(schema(name)))
    assert len(found) > 40
    assert [path for path, node in found if not node.get("description", "").endswith((".", "]"))] == []


@pytest.mark.parametrize("name", ["report", "quality"])
def test_every_outcome_is_allowed(name: str) -> None:
    assert set(schema(name)["properties"]["outcome"]["enum"]) == set(Outcome)
