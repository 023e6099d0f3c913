"""A registry of devices: good calibrations of many recordings in one file, for recordings that have none.

An entry is the report of a recording, without what only concerns its file, and the range of temperatures in
which it was found. Registries merge in any order to the same file: each recording counts once, with its
smallest expected error, and the JSON is canonical.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import UnreadableError, printable
from accelcal_cli.core.identity import OLD_REGISTRY, REGISTRY, REPORT, identity, refuse_other
from accelcal_cli.core.paths import is_file
from accelcal_cli.core.results import Outcome
from accelcal_cli.output.coefficients import Coefficients, coefficients_in
from accelcal_cli.output.files import json_text, parsed, write_text
from accelcal_cli.output.report_reading import (
    Document,
    document_bytes,
    fault,
    load_report,
    report_schema,
    section,
)
from accelcal_cli.output.sections import ReportView, report_view

GOOD = (Outcome.CALIBRATED, Outcome.REDUCED_MODEL, Outcome.ALREADY_GOOD)


@dataclass(frozen=True, eq=False)
class RegistryEntry:
    """One good calibration of a device.

    Attributes:
        temperature_c: lowest and highest temperature of its recording; None if unknown.
        path: the registry that it is read from.
    """

    report: Mapping[str, Any]
    temperature_c: tuple[float, float] | None
    path: Path

    @property
    def serial(self) -> str:
        """Serial number of its device."""
        return str(self.report["recording"]["device"]["serial"])

    @cached_property
    def view(self) -> ReportView:
        """Typed view of the report; raises UnreadableError if it is damaged."""
        if wrong := fault(self.report, report_schema()):
            what = f"is a damaged registry: in an entry of device {printable(self.serial)}, {wrong}"
            raise UnreadableError(what, path=self.path, hint=HOW)
        return report_view(self.report)

    def coefficients(self) -> Coefficients:
        """Return its coefficients; raises UnreadableError if the entry is damaged."""
        text = json_text(dict(self.report))
        document = Document(self.path, hashlib.sha256(text.encode()).hexdigest(), dict(self.report))
        return coefficients_in(document, by_content=True)

    def as_json(self) -> dict[str, Any]:
        """Return the entry of the file."""
        heat = self.temperature_c
        return {"temperature_c": None if heat is None else list(heat), "report": self.report}

    def order(self) -> tuple[str, str, float, str]:
        """Return what sorts entries; of one recording the first is kept."""
        error = section(dict(self.report), "calibration_error_mg")
        text = json.dumps(self.as_json(), sort_keys=True)
        return self.serial, self.report["recording"]["sha256"], float(error["mean"]), text


def entry_of(report_path: Path, quality_path: Path) -> RegistryEntry | None:
    """Return the entry of a recording's report; None if its calibration is not a good one of a known device.

    It must be the recording's own, with an error over all orientations, of a sensor that did not change.

    Args:
        quality_path: its NAME.quality.json, for the temperatures.

    Raises:
        OutputError: a file is there and cannot be read.
        UnreadableError: the report is of another version, which this one does not read.
    """
    if (report := load_report(report_path)) is not None:
        refuse_other(report, REPORT, report_path)
    if report is None or report.get("outcome") not in GOOD:
        return None
    device = section(report, "recording", "device")
    borrowed = "coefficients" in report or "pool" in report
    changed = section(report, "change").get("kind", "none") != "none"
    if borrowed or changed or not device.get("serial") or not report.get("calibration_error_mg"):
        return None
    # an entry keeps what every report must have, and nothing else
    kept = {name: report[name] for name in report_schema()["required"] if name in report}
    kept["recording"] = {**report["recording"], "gaps": [], "notes": []}
    kept["file_health"] = {**report["file_health"], "problems": []}
    return RegistryEntry(kept, temperatures_c(quality_path), report_path)


def temperatures_c(quality_path: Path) -> tuple[float, float] | None:
    """Return the lowest and highest temperature of the hours of a recording; None if they are not known."""
    if not is_file(quality_path):
        return None
    try:
        rows = parsed(document_bytes(quality_path).decode())["rows"]["temperature_c"]
        known = [float(one) for one in rows if one is not None]
    except (ValueError, KeyError, TypeError, UnreadableError):
        return None
    return (min(known), max(known)) if known else None


def merged(entries: Iterable[RegistryEntry]) -> list[RegistryEntry]:
    """Return entries sorted, each recording once; the same for any order of them."""
    found: dict[tuple[str, str], RegistryEntry] = {}
    for one in sorted(entries, key=RegistryEntry.order):
        found.setdefault(one.order()[:2], one)
    return list(found.values())


def read_registry(path: Path) -> list[RegistryEntry]:
    """Read a registry.

    Raises:
        UnreadableError: it cannot be read, or is not a registry of this version.
    """
    data, path = document_bytes(path), path.absolute()
    try:
        held = parsed(data.decode())
    except ValueError as error:
        raise UnreadableError(f"is not a registry of devices ({error})", path=path, hint=HOW) from error
    refuse_other(held, REGISTRY, path)
    try:
        return [_entry(one, path) for device in held["devices"].values() for one in device]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise UnreadableError(f"is a damaged registry ({error!r})", path=path, hint=HOW) from error


HOW = "accelcal devices OUT --registry FILE.json makes one of the results of a study"


def _entry(held: Mapping[str, Any], path: Path) -> RegistryEntry:
    heat, report = held["temperature_c"], held["report"]
    entry = RegistryEntry(report, None if heat is None else (float(heat[0]), float(heat[1])), path)
    entry.order()  # which fails for what cannot be used
    return entry


def is_registry(path: Path) -> bool:
    """Return True for a file that begins as a registry does, whatever comes then."""
    try:
        with path.open("rb") as file:
            start = file.read(64)
            return any(f'"{word}"'.encode() in start for word in (REGISTRY, OLD_REGISTRY))
    except OSError:
        return False


def held_in(path: Path, sha256: str) -> Coefficients | None:
    """Return the coefficients that a registry has under the hash of their content; None if it has none.

    Raises:
        UnreadableError: it is a registry, and damaged.
    """
    if not is_registry(path):
        return None
    found = (one.coefficients() for one in read_registry(path))
    return next((one for one in found if one.sha256 == sha256), None)


def write_registry(path: Path, entries: Iterable[RegistryEntry]) -> None:
    """Write a registry as canonical JSON.

    Raises:
        OutputError: it cannot be written.
    """
    devices: dict[str, list[Any]] = {}
    for one in merged(entries):
        devices.setdefault(one.order()[0], []).append(one.as_json())
    ordered = json.loads(json.dumps(devices, sort_keys=True))  # whichever version wrote an entry
    write_text(path, json_text(identity(REGISTRY) | {"devices": ordered}, indent=1) + "\n")


def content_sha256(entries: Iterable[RegistryEntry]) -> str:
    """Return a hash of what a registry holds."""
    return hashlib.sha256("\n".join(one.order()[3] for one in merged(entries)).encode()).hexdigest()
