"""Good calibrations of a study, or of another registry, added to a registry of devices."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from accelcal_cli.core.door import is_file
from accelcal_cli.core.errors import OutputError, UsageError, counted, printable
from accelcal_cli.output.registry import (
    RegistryEntry,
    entry_of,
    is_registry,
    merged,
    read_registry,
    write_registry,
)
from accelcal_cli.output.study_table import NAME, read_columns
from accelcal_cli.pipeline.jobs import QUALITY_SUFFIX, REPORT_SUFFIX, refuse_misnamed


def added(out: Path, path: Path) -> str:
    """Add the good calibrations of a study's folder, or of a registry, to a registry; return what was done.

    Raises:
        UsageError: the folder has no table, or the registry's name is that of another kind of file.
        OutputError: there is a file that is not a registry, or it cannot be written.
        UnreadableError: the study or a registry cannot be read.
    """
    refuse_misnamed(path, ".json")
    if is_file(path) and not is_registry(path):
        raise OutputError(
            "is there, and is not a registry of devices", path=path, hint="give the name of a new file"
        )
    held = read_registry(path) if is_file(path) else []
    entries = merged([*held, *(read_registry(out) if is_registry(out) else _of_study(out))])
    write_registry(path, entries)
    devices = len({one.order()[0] for one in entries})
    more = len(entries) - len(merged(held))
    calibrations = counted(len(entries), "good calibration")
    return f"{printable(path)}: {calibrations} of {counted(devices, 'device')}, {more} of them new"


def _of_study(out: Path) -> Iterator[RegistryEntry]:
    """Yield the entries of the reports in a study's table."""
    path = out / NAME
    if not is_file(path):
        hint = "give the folder that was given to `accelcal study` with -d, or a registry"
        raise UsageError("does not exist", path=path, hint=hint)
    for name in read_columns(path, ["report"])["report"].to_pylist():
        if isinstance(name, str):
            report = out / name
            quality = report.with_name(report.name.removesuffix(REPORT_SUFFIX) + QUALITY_SUFFIX)
            if (entry := entry_of(report, quality)) is not None:
                yield entry
