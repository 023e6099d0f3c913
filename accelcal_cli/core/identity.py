"""Every output states what it is and which version made it, in one place that no later version moves.

The outermost keys of a JSON document are `kind`, `schema_version` and `accelcal_version`. So are those of the
JSON that a Parquet file has in its metadata (`accelcal`), and of each line of a ledger. For `study.csv`,
`study.json` next to it states them. The decisions.csv of a person has no version.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import UnreadableError, printable
from accelcal_cli.core.version import __version__

SCHEMA_VERSION = 4
"""Version of the form of all outputs. 1.0.0 began with 4; lower ones are of development versions."""

REPORT, QUALITY, INTEGERS, DRAWS = "report", "quality", "integers", "draws"
SAMPLES, WINDOWS, STUDY, REGISTRY, LEDGER = "samples", "windows", "study", "registry", "ledger"

OLD_REGISTRY = "accelcal_registry"
"""Key of registries of development versions, which did not say which version made them."""

_CALIBRATE = "calibrate the recording again: accelcal calibrate RECORDING"
_READ = {
    REPORT: ("a report", "name a report, NAME.calibration.json", _CALIBRATE),
    SAMPLES: (
        "a calibrated recording",
        "name a Parquet file that accelcal wrote, NAME.calibrated.parquet",
        _CALIBRATE,
    ),
    STUDY: ("the table of a study", "name the output folder of a study", "run accelcal study again"),
    REGISTRY: (
        "a registry of devices",
        "accelcal devices OUT --registry FILE.json makes one of the results of a study",
        "make it again of a study's results: accelcal devices OUT --registry FILE.json",
    ),
}
"""Kinds that are read: what they are, a hint for a file that is not one, and how they are made again."""


def identity(kind: str) -> dict[str, Any]:
    """Return the keys with which an output says what it is and which version made it."""
    return {"kind": kind, "schema_version": SCHEMA_VERSION, "accelcal_version": __version__}


def is_ours(held: Any) -> bool:
    """Return True for what accelcal wrote, of any kind and version."""
    return isinstance(held, Mapping) and ("accelcal_version" in held or OLD_REGISTRY in held)


def can_be_read(held: Any, kind: str) -> bool:
    """Return True for what accelcal wrote of this kind, in a form that this version knows."""
    known = is_ours(held) and held.get("kind") == kind
    return known and type(held.get("schema_version")) is int and held["schema_version"] == SCHEMA_VERSION


def refuse_other(held: Any, kind: str, path: Path) -> None:
    """Raise UnreadableError for a file of another kind, or of a form that this version does not know.

    Args:
        held: what the file says of itself, with the keys of `identity`.
    """
    if can_be_read(held, kind):
        return
    name, hint, again = _READ[kind]
    if not is_ours(held) or held.get("kind", kind) != kind:
        raise UnreadableError(f"is not {name} of accelcal", path=path, hint=hint)
    stated = held.get("accelcal_version")
    version = f" ({printable(stated)[:80]})" if isinstance(stated, str) else ""
    if "kind" not in held:
        text = f"was made by a development version{version} of accelcal"
        raise UnreadableError(text, path=path, hint=again)
    text = f"has schema version {held.get('schema_version')!r}, of another version{version} of accelcal"
    raise UnreadableError(text, path=path, hint=f"use that version, or {again}")
