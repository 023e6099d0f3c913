"""A report against the recording it was made of: fitted again, and compared bit for bit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from accelcal_cli.judge.borrowed import difference_mg
from accelcal_cli.judge.uncertainty import directions
from accelcal_cli.output.coefficients import calibration_of
from accelcal_cli.output.document import Document, check_sections, read_document
from accelcal_cli.output.sections import significant
from accelcal_cli.pipeline.again import refuse_kind, refuse_other
from accelcal_cli.pipeline.compare import differing
from accelcal_cli.pipeline.existing import as_stored
from accelcal_cli.pipeline.rebuild import Rebuilt, rebuild
from accelcal_cli.pipeline.remake import Wanted, remade
from accelcal_cli.pipeline.request import ProgressMaker, no_progress
from accelcal_cli.pipeline.values import ParquetCheck

NOT_COMPARED = ("provenance", "accelcal_version")
"""The report's provenance differs from run to run; the versions are named beside the result."""


@dataclass(frozen=True, slots=True)
class Verified:
    """What came of it.

    Attributes:
        differs: keys of the report that are not what they would be now.
        largest_mg, mean_mg: between the two calibrations, over 162 directions at the reference
            temperature; None where there are not two.
        made_by: version that wrote the report.
        missing, unknown: settings that the report lacks, and that this version does not have.
        parquet: None where there is none beside the report.
    """

    differs: tuple[str, ...]
    largest_mg: float | None
    mean_mg: float | None
    made_by: str
    missing: tuple[str, ...]
    unknown: tuple[str, ...]
    parquet: ParquetCheck | None

    @property
    def all_differing(self) -> tuple[str, ...]:
        """What differs, in the report and (with `parquet.` before it) in the Parquet file."""
        beside = () if self.parquet is None else self.parquet.differing
        return (*self.differs, *(f"parquet.{name}" for name in beside))

    @property
    def identical(self) -> bool:
        """Whether the report, and the Parquet file where there is one, are reproduced."""
        return not self.all_differing


def verify(report: Path, recording: Path, wanted: Wanted, progress: ProgressMaker = no_progress) -> Verified:
    """Make a report again from its recording, writing nothing, and compare.

    Raises:
        UnreadableError: the report or the recording cannot be read.
        UsageError: the recording is not the report's, or what the report was made with is not here.
    """
    document = read_document(report)
    check_sections(document, ("recording",))
    refuse_kind(document)
    refuse_other(document, recording)
    held = rebuild(document)
    made, parquet = remade(document, held, recording, wanted, progress)
    return _verified(document, held, made, parquet)


def _verified(
    document: Document, held: Rebuilt, made: dict[str, Any], parquet: ParquetCheck | None
) -> Verified:
    odd = {f"settings.{name}" for name in (*held.missing, *held.unknown)}
    said, now = document.report, as_stored(made)
    _keep_places(now, said)
    keys = tuple(
        key
        for key in differing(_compared(said), _compared(now))
        if not any(key == name or key.startswith((f"{name}.", f"{name}[")) for name in odd)
    )
    largest, mean = _apart(said.get("calibration"), now["calibration"])
    return Verified(keys, largest, mean, str(said["accelcal_version"]), held.missing, held.unknown, parquet)


def _keep_places(now: dict[str, Any], said: dict[str, Any]) -> None:
    """Files that have moved are the same files: their hashes are compared."""
    for section in ("recording", "coefficients"):
        if section in now and section in said:
            now[section]["path"] = said[section]["path"]
    pairs = ((now["settings"]["input"], said["settings"]["input"], "layout"),)
    for made, told, name in (*pairs, (now["settings"], said["settings"], "poses")):
        if made.get(name) is not None and name in told:
            made[name] = told[name]


def _compared(report: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in report.items() if name not in NOT_COMPARED}


def _apart(said: Any, now: Any) -> tuple[float | None, float | None]:
    """Largest and mean difference [mg] of two `calibration` sections, where both hold one."""
    try:
        one, other = calibration_of(said), calibration_of(now)
    except (ValueError, TypeError):
        return None, None
    largest, mean = difference_mg(one, other, directions())
    return significant(largest), significant(mean)
