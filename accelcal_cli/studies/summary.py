"""The summary of a study: a table with a row for each recording as Parquet and CSV, and counts as JSON.

Rows are sorted and have no times, so that an interrupted study ends with the same bytes as another.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from accelcal_cli.core.calibration import PARAMETER_NAMES
from accelcal_cli.core.errors import Reason, printable
from accelcal_cli.core.identity import STUDY, identity
from accelcal_cli.core.points import MODELS
from accelcal_cli.core.recording import METADATA_KEY
from accelcal_cli.core.results import Outcome
from accelcal_cli.core.version import __version__
from accelcal_cli.output import files
from accelcal_cli.output.advice import MILD, page_verdict
from accelcal_cli.output.decisions import CONTENT, MOST_LISTED, WORD, Merged, alike, words_of
from accelcal_cli.output.files import json_text, replacing, write_text
from accelcal_cli.output.report import failure_code
from accelcal_cli.output.report_reading import sensor_of
from accelcal_cli.output.sections import CalibrationSection, CoverageSection, ReportView, report_view
from accelcal_cli.output.sentences import sentence
from accelcal_cli.studies.columns import (
    ALL,
    AXES,
    GAIN,
    NAMES,
    PARAMETERS,
    READ,
    error_columns,
    factor_columns,
    read_by_people,
)
from accelcal_cli.studies.records import FAILED, Entry, Item
from accelcal_cli.studies.study import POOL

if TYPE_CHECKING:
    import pyarrow as pa

DEVICE = ("model", "serial", "firmware")
EFFECT = {
    ("raw", "enmo_mg"): "enmo_raw_mg", ("calibrated", "enmo_mg"): "enmo_mg",
    ("raw", "enmo_differs_mg"): "enmo_differs_mg", ("calibrated", "mad_mg"): "mad_mg",
    ("raw", "mvpa_min"): "mvpa_raw_min", ("calibrated", "mvpa_min"): "mvpa_min",
    ("raw", "inactive_min"): "inactive_raw_min", ("calibrated", "inactive_min"): "inactive_min",
}  # fmt: skip
"""Columns of measures of activity, by version and name in the report's `effect`."""
EFFECT_INTERVALS = {
    "enmo_mg": ("enmo_low_mg", "enmo_high_mg"), "mad_mg": ("mad_low_mg", "mad_high_mg"),
    "mvpa_min": ("mvpa_low_min", "mvpa_high_min"),
}  # fmt: skip
"""Columns of their 95 % intervals, calibrated."""
COPIES = frozenset(("copy", "copies", "copie", "copia", "kopie", "duplicate", "backup"))
"""Words in the names of copies."""


def _as_original(path: str) -> tuple[int, bool, str]:
    """Return the place of a recording among those of the same content, of which the first counts."""
    named, _ = words_of(path)
    return len(named), not COPIES.isdisjoint(WORD.findall(path.lower())), path


def copies(rows: Mapping[str, Mapping[str, Any]], excluded: Collection[str] = ()) -> dict[str, str]:
    """Return the names of copies, each with that of the recording of the same content and device that counts.

    That is the one whose name has the fewest words, of those that people did not exclude if there are any.

    Args:
        rows: rows by name; those of files that could not be read have no hash.
        excluded: paths of excluded recordings.
    """
    firsts: dict[str, str] = {}
    for names in alike(rows, "device_serial", *CONTENT).values():
        if len(names) > 1:
            best = min(names, key=lambda one: (rows[one].get("path") in excluded, *_as_original(one)))
            firsts |= dict.fromkeys(names, best)
    return {name: one for name, one in sorted(firsts.items()) if name != one}


KINDS = {"text": (str, type(None)), "whole": (int, type(None)), "number": (int, float, type(None))}
"""Types of the values in a row, by the kind of their column; True and False are not numbers."""


def fits(entry: Entry) -> bool:
    """Return True if the row of an entry is one that a study writes; a ledger may have been changed."""
    row = entry.row or {}
    if entry.round == POOL:
        return all(isinstance(row.get(name), str) for name in ("outcome", "message"))
    if row.get("outcome") not in (*Outcome, FAILED) or type(row.get("exit_code")) is not int:
        return False
    if row.get("accelcal_version") == __version__ and len(row.keys() & set(NAMES)) < len(NAMES):
        return False
    return all(type(row.get(column.name)) in KINDS[column.kind] for column in ALL)


def failed(item: Item, code: int, message: str) -> dict[str, Any]:
    """Return the row of a recording that has no report."""
    failure = {"outcome": FAILED, "reason": failure_code(code), "message": message}
    failure |= {"use": USES["bad"], "why": message}
    file = {"path": printable(item.name), "exit_code": code, "bytes": item.size, "sensor": item.sensor}
    return with_result(dict.fromkeys(NAMES) | file | failure | {"accelcal_version": __version__})


def of_report(
    item: Item,
    code: int,
    report: dict[str, Any],
    outputs: dict[str, str | None],
    wear_hours: float | None = None,
) -> dict[str, Any]:
    """Return the row of a recording from its report.

    Args:
        outputs: `parquet` and `report`, their names under OUT.
        wear_hours: hours in which it was worn; None if that is not known.
    """
    view = report_view(report)
    row: dict[str, Any] = dict.fromkeys(NAMES) | {
        "path": printable(item.name),
        "exit_code": code,
        "wear_hours": wear_hours,
        "outcome": str(view.outcome),
        "reason": view.reason or None,
        "cautions": " ".join(one.code for one in view.cautions) or None,
        "message": view.message,
        "accelcal_version": view.accelcal_version,
        "prior": view.settings.get("prior"),
        "sensor": sensor_of(report),
    }
    row |= _use(view) | _recording(view) | _errors(view) | _coverage(view.coverage)
    row |= _calibration(view.calibration) | _gyroscope(view) | _effect(view)
    if (change := view.change) is not None and change.unchecked is None:
        row |= {"change": change.kind, "change_at": change.at, "change_mg": change.size_mg}
    if view.misfits is not None:
        row["misfits"] = ", ".join(one.kind for one in view.misfits if one.found) or "none"
    return with_result(row | outputs)


DECIDED_ON = (
    "sha256", "use", "outcome", "model",
    *GAIN, *PARAMETERS[6:],
)  # fmt: skip
"""Columns that are another result if they differ."""


def with_result(row: dict[str, Any]) -> dict[str, Any]:
    """Return a row with the name of its result, by which a decision knows it, never a number."""
    values = [f"{value:.6f}" if isinstance(value, float) else value for value in map(row.get, DECIDED_ON)]
    digest = hashlib.sha256(json.dumps(values).encode()).hexdigest()
    return row | {"result": f"r{digest[:10]}"}


USES = {"good": "yes", "care": "with care", "bad": "no"}
"""Values of `use`, by the level of the verdict on a recording's page."""


def _use(report: ReportView) -> dict[str, str | None]:
    """Return whether to use a recording, and why not, or why with care."""
    verdict, why = page_verdict(report), None
    if verdict.level != "good":
        doubts = () if verdict.level == "bad" else report.cautions
        why = next((sentence(one) for one in doubts if one.code not in MILD), verdict.reason)
    return {"use": USES[verdict.level], "why": why and printable(why)}


def own(line: dict[str, Any]) -> dict[str, Any]:
    """Return the columns of an own result that another one has replaced."""
    return {f"own_{name}": line[name] for name in ("outcome", "message", "after_mg")}


def _recording(report: ReportView) -> dict[str, Any]:
    recording, health = report.recording, report.file_health
    same = ("format", "start_time", "duration_s", "samples", "bytes", "sha256", "lsb_per_g", "range_g")
    counts = ("filled_samples", "clipped_samples_before", "clipped_samples_after")
    figures = ("rate_hz_measured", "lost_percent")
    return {
        **{name: getattr(recording, name) for name in (*same, "time_zone")},
        **{name: getattr(health, name) for name in counts + figures},
        **{f"device_{name}": getattr(recording.device, name) for name in DEVICE},
        "filled_percent": round(100 * health.filled_samples / max(1, recording.samples), 4),
        "rate_hz": recording.sample_rate_hz,
        "gaps": recording.all_gaps,
        "problems": sum(problem.count or 1 for problem in health.problems),
    }


def _errors(report: ReportView) -> dict[str, Any]:
    holdout = report.holdout
    if holdout is None:
        return {}
    low, high = holdout.ci95_mg
    before = {"before_mg": holdout.before_mg.mean, "orientations": holdout.postures, "points": holdout.points}
    if report.calibration is None:
        return before
    after = {"after_mg": holdout.after_mg.mean, "ci95_low_mg": low, "ci95_high_mg": high}
    ratio = {"improvement_percent": holdout.improvement_percent} | factor_columns(holdout)
    return before | after | ratio | error_columns(report)


def _gyroscope(report: ReportView) -> dict[str, Any]:
    gyroscope = report.gyroscope
    if gyroscope is None:
        return {}
    errors = gyroscope.holdout_deg
    return {
        "gyroscope": gyroscope.outcome,
        "gyro_pairs": gyroscope.pairs,
        "gyro_before_deg": None if errors is None else errors.before,
        "gyro_after_deg": None if errors is None else errors.after,
    }


def _effect(report: ReportView) -> dict[str, Any]:
    """Return measures of activity, if they were asked for."""
    if report.effect is None:
        return {}
    versions, intervals = report.effect.versions, report.effect.ci95 or {}
    figures = {column: getattr(versions[name], key) for (name, key), column in EFFECT.items()}
    for key, columns in EFFECT_INTERVALS.items():
        figures |= dict(zip(columns, intervals.get(key, ()), strict=False))
    return figures


def _coverage(coverage: CoverageSection) -> dict[str, Any]:
    ends = {
        f"{end}_{axis}_g": value
        for end, values in (("min", coverage.axis_min_g), ("max", coverage.axis_max_g))
        for axis, value in zip(AXES, values or (), strict=False)
    }
    return {"cells": coverage.cells, "condition_number": coverage.condition_number, **ends}


def _calibration(calibration: CalibrationSection | None) -> dict[str, Any]:
    if calibration is None:
        return {}
    row: dict[str, Any] = {"model": calibration.model}
    row |= dict(zip(GAIN, (value for line in calibration.gain for value in line), strict=True))
    row |= dict(zip(PARAMETERS[6:9], calibration.offset_g, strict=True))
    if (temperature := calibration.temperature) is not None:
        row |= dict(zip(PARAMETERS[9:], temperature.slope_g_per_c, strict=True))
        row["reference_c"] = temperature.reference_c
    errors, model = calibration.standard_errors or {}, MODELS.get(calibration.model)
    for index in range(len(PARAMETERS)) if model is None else model.free:
        row[f"se_{PARAMETERS[index]}"] = errors.get(PARAMETER_NAMES[index])
    return row


TOGETHER = 1 << 14
"""Number of rows of a row group of `study.parquet`."""


@dataclass(frozen=True, slots=True)
class Summary:
    """A study's result.

    Attributes:
        rows: one row a recording, by path.
        waiting: number of recordings that were not tried yet: too new, too old, or another shard's.
        ahead: number of waiting recordings that were changed in the future by this machine's clock; not
            written.
        left_out: number of files that are not recordings; files_left_out: why, by name, with those left out
            by their names.
        orphans: results whose recording is gone, as objects of `study.json`.
        decisions: what a person decided, put to the rows; None if nobody did.
        kept: number of recordings that this run does not name, whose rows are from one with other options.
        up_to_date: number of recordings for which nothing had to be done; not written.
        pools: device, number of recordings, outcome and message of each pool, by name.
        provenance: where the recordings were.
        findings: what a person must act on, as an object of `study.json`.
    """

    rows: Sequence[Mapping[str, Any]]
    settings: dict[str, Any]
    waiting: int = 0
    ahead: int = 0
    left_out: int = 0
    orphans: Sequence[Mapping[str, Any]] = ()
    files_left_out: Mapping[str, Reason] = field(default_factory=dict)
    kept: int = 0
    up_to_date: int = 0
    pools: dict[str, dict[str, Any]] = field(default_factory=dict)
    decisions: Merged | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    findings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def once(self) -> list[Mapping[str, Any]]:
        """Rows without those of copies."""
        return [row for row in self.rows if not row.get("copy_of")]

    @property
    def copies(self) -> int:
        """Number of recordings that are copies of others."""
        return len(self.rows) - len(self.once)

    def outcomes(self) -> dict[str, int]:
        """Return the number of recordings by outcome, copies left out."""
        return dict(sorted(Counter(row["outcome"] for row in self.once).items()))

    def counts(self) -> dict[str, Any]:
        """Return the content of `study.json`."""
        return {
            **identity(STUDY),
            "recordings": len(self.rows),
            "copies": self.copies,
            "outcomes": self.outcomes(),
            "uses": dict(sorted(Counter(row["use"] for row in self.once if row.get("use")).items())),
            "models": dict(sorted(Counter(row["model"] for row in self.once if row["model"]).items())),
            "time_zones": time_zones(self.rows),
            "waiting": self.waiting,
            "left_out": self.left_out,
            "files_left_out": [
                {"path": printable(name), **why.as_json(), "message": sentence(why)}
                for name, why in islice(self.files_left_out.items(), MOST_LISTED)
            ],
            "not_listed": {
                name: len(them) - MOST_LISTED
                for name, them in (("files_left_out", self.files_left_out), ("orphans", self.orphans))
                if len(them) > MOST_LISTED
            },
            "orphans": list(self.orphans[:MOST_LISTED]),
            "findings": dict(self.findings),
            "decisions": None if self.decisions is None else self.decisions.as_json(),
            "kept": self.kept,
            "pools": self.pools,
            "settings": self.settings,
            "provenance": dict(self.provenance),
        }


def time_zones(rows: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """Return the number of Parquet files with times in UTC, and in an unknown zone."""
    zones = (row.get("time_zone") for row in rows if row["parquet"])
    return dict(sorted(Counter(zone for zone in zones if zone).items()))


def write(summary: Summary, out: Path, name: str) -> None:
    """Write `NAME.parquet`, `NAME.csv`, and last `NAME.json`; raises OutputError if one cannot be written."""
    with replacing(out / f"{name}.parquet") as temporary, temporary.open("wb") as file:
        _write_parquet(summary.rows, file)
    write_csv(summary.rows, out, name)
    write_text(out / f"{name}.json", json_text(summary.counts(), indent=2) + "\n")


def write_csv(rows: Sequence[Mapping[str, Any]], out: Path, name: str) -> None:
    """Write `NAME.csv` alone; raises OutputError if it cannot be written."""
    files.write_csv(out / f"{name}.csv", READ, map(read_by_people, rows))


def _write_parquet(rows: Sequence[Mapping[str, Any]], file: IO[bytes]) -> None:
    """Write some rows at a time: as text they take ten times the memory."""
    import pyarrow as pa  # which `study --help` does not need
    import pyarrow.parquet as pq

    types = {"text": "string", "whole": "int64", "number": "float64"}
    kinds = {column.name: types[column.kind] for column in ALL}
    about = {METADATA_KEY: json.dumps(identity(STUDY))}
    schema = pa.schema([pa.field(column, kind) for column, kind in kinds.items()], about)
    with pq.ParquetWriter(file, schema, compression="zstd") as writer:
        for first in range(0, len(rows), TOGETHER):
            writer.write_table(_table(rows[first : first + TOGETHER], schema))
        if not rows:
            writer.write_table(schema.empty_table())


def _table(rows: Sequence[Mapping[str, Any]], schema: pa.Schema) -> pa.Table:
    """Read rows from JSON lines: `pa.array` would load pandas, which takes half a second."""
    import pyarrow.json

    lines = "\n".join(json.dumps({name: row.get(name) for name in NAMES}) for row in rows).encode()
    one_block = pyarrow.json.ReadOptions(block_size=len(lines) + 1)
    return pyarrow.json.read_json(BytesIO(lines), one_block, pyarrow.json.ParseOptions(schema))
