"""Reports as documents, read back from their files."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.output.report import LARGEST_BYTES, SCHEMA_VERSION, report_schema
from accelcal_cli.output.schema import fault

NAME_ONE = "name a report, STEM.calibration.json"


@dataclass(frozen=True, slots=True)
class Document:
    """A report as it lies in its file: `sha256` of the file, and what it says."""

    path: Path
    sha256: str
    report: dict[str, Any]

    @property
    def content_sha256(self) -> str:
        """SHA-256 of what it says but for `provenance`, as JSON with sorted keys."""
        said = {name: value for name, value in self.report.items() if name != "provenance"}
        return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()


def read_document(path: Path) -> Document:
    """A report of this schema version; its sections are not looked at.

    Raises:
        UnreadableError: it cannot be read, is not JSON, or no report of ours that this version knows.
    """
    data = _bytes(path)
    try:
        report = json.loads(data.decode(), parse_constant=_refuse_constant)
    except UnicodeDecodeError as error:
        at = error.start
        raise UnreadableError("is not UTF-8 text", path=path, byte_offset=at, hint=NAME_ONE) from error
    except (ValueError, RecursionError) as error:
        raise UnreadableError(f"is damaged JSON ({error})", path=path, hint=NAME_ONE) from error
    if not isinstance(report, dict) or not {"accelcal_version", "schema_version"} <= report.keys():
        raise UnreadableError("is not a report of accelcal", path=path, hint=NAME_ONE)
    version, made = report["schema_version"], report["accelcal_version"]
    if version != SCHEMA_VERSION or isinstance(version, bool):
        raise UnreadableError(
            f"has schema version {version!r} (of accelcal {made!r}), this version reads {SCHEMA_VERSION}",
            path=path,
            hint="calibrate its recording again with this version, or use the version that wrote it",
        )
    return Document(path, hashlib.sha256(data).hexdigest(), report)


def _bytes(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST_BYTES + 1)
    except OSError as error:
        raise UnreadableError(
            f"cannot be read ({error.strerror or error})", path=path, hint="check the path and permissions"
        ) from error
    if len(data) > LARGEST_BYTES:
        raise UnreadableError("is too long for a report", path=path, hint=NAME_ONE)
    return data


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is no JSON number")


def check_sections(document: Document, names: tuple[str, ...]) -> None:
    """Raise UnreadableError where sections of a report are missing or not what they should be."""
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
    """The error of a report that was not written so."""
    hint = "calibrate its recording again: the report was not written so"
    return UnreadableError(f"is a damaged report: {what}", path=document.path, hint=hint)
