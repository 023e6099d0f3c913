"""Reports against the schema, by the jsonschema package."""

from __future__ import annotations

from functools import cache
from typing import Any

from jsonschema import Draft202012Validator

from accelcal_cli.output.report_reading import report_schema


def check_report(report: dict[str, Any]) -> None:
    """Raise ValidationError where a report is not what the schema says."""
    _validator().validate(report)


@cache
def _validator() -> Draft202012Validator:
    """Made once: that the schema is one takes ten times as long to check as a report does."""
    schema = report_schema()
    Draft202012Validator.check_schema(schema)
    return Draft202012Validator(schema)
