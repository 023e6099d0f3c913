"""Where two JSON documents differ.

The calibrated Parquet file beside a report, against the report and against its recording, bit for bit.

What a report was made of and with, found again; or why it cannot be.

Making a report again from its recording, whatever command made it; nothing is written.

A report against the recording it was made of: fitted again, and compared bit for bit.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.settings import PoseSettings, Settings
from accelcal_cli.formats import open_recording
from accelcal_cli.judge.errors import directions
from accelcal_cli.judge.verdict import difference_mg
from accelcal_cli.output.files import metadata_of
from accelcal_cli.output.parquet import Column, ParquetSource, schema_of, values_of
from accelcal_cli.output.report import ReportInput, build, significant
from accelcal_cli.output.report_reading import (
    Coefficients,
    Document,
    calibration_of,
    check_sections,
    read_coefficients,
    read_document,
)
from accelcal_cli.pipeline import apply, calibrate
from accelcal_cli.pipeline import pool as pooled
from accelcal_cli.pipeline.apply import relation
from accelcal_cli.pipeline.calibrate import Passes, writes_parquet
from accelcal_cli.pipeline.export import calibrated, columns_of, transform_of
from accelcal_cli.pipeline.fit import fit_points
from accelcal_cli.pipeline.jobs import (
    DEFAULT_CHUNK_SAMPLES,
    PARQUET_SUFFIX,
    REPORT_SUFFIX,
    Job,
    ProgressMaker,
    Request,
    no_progress,
    sha256,
)
from accelcal_cli.pipeline.outputs import as_stored
from accelcal_cli.pipeline.report_settings import POINTS, NamedFile, Rebuilt, rebuild
from accelcal_cli.six_pose.run import PoseRequest, session_report

_ABSENT = object()


def differing(one: Any, other: Any, where: str = "") -> Iterator[str]:
    """Places such as `calibration.gain[1][0]` where two JSON values are not the same, bit for bit."""
    if isinstance(one, dict) and isinstance(other, dict):
        for name in [*one, *(name for name in other if name not in one)]:
            place = f"{where}.{name}" if where else str(name)
            yield from differing(one.get(name, _ABSENT), other.get(name, _ABSENT), place)
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for index, (left, right) in enumerate(zip(one, other, strict=True)):
            yield from differing(left, right, f"{where}[{index}]")
    elif one is _ABSENT or other is _ABSENT or json.dumps(one) != json.dumps(other):
        yield where


@dataclass(frozen=True, slots=True)
class Values:
    """What the comparison found: the first row that differs and its column, None where none does."""

    rows: int
    first_row: int | None = None
    column: str | None = None


@dataclass(frozen=True, slots=True)
class ParquetCheck:
    """The Parquet file beside a report.

    Attributes:
        differs: keys of its metadata that are not the report's.
        values: None where they were not asked for.
    """

    path: Path
    differs: tuple[str, ...]
    values: Values | None

    @property
    def differing(self) -> tuple[str, ...]:
        """Keys of the metadata that differ, and `values` where these do."""
        apart = self.values is not None and self.values.first_row is not None
        return (*self.differs, *(("values",) if apart else ()))


def check_parquet(
    made: tuple[Passes, ReportInput] | None, document: Document, *, values: bool
) -> ParquetCheck | None:
    """Compare the Parquet file beside a report with the report, and with its recording.

    Args:
        made: the recording's passes and result; None where the result has no calibrated data.
        values: compare every value too.

    Returns:
        None where no such file lies there.

    Raises:
        UsageError: values are to be compared, but there are none.
    """
    path = None if made is None else _parquet_beside(document.path)
    if path is None or made is None:
        if values:
            raise UsageError(
                "no calibrated Parquet file lies beside it", path=document.path, hint="leave --values out"
            )
        return None
    held, named = metadata_of(path), ("accelcal_version", "calibration", "recording")
    said = {name: document.report.get(name) for name in named}
    keys = tuple(differing({name: held.get(name) for name in named}, said))
    return ParquetCheck(path, keys, compare_values(*made, path) if values else None)


def _parquet_beside(report: Path) -> Path | None:
    stem = report.name.removesuffix(REPORT_SUFFIX)
    names = (stem + PARQUET_SUFFIX, stem + ".parquet", stem)
    found = (report.with_name(name) for name in names if name != report.name)
    return next((path for path in found if path.is_file()), None)


def compare_values(passes: Passes, data: ReportInput, path: Path) -> Values:
    """Compare every value of every column.

    Raises:
        UnreadableError: the Parquet file or the recording cannot be read.
    """
    columns = columns_of(data)
    with ParquetSource(path) as source:
        wrong = source.other_column(schema_of(columns, {}))
        if wrong is not None:
            return Values(0, 0, wrong)
        done = 0
        for held, made in _pairs(passes, data, source, columns):
            found = _first_difference(held, made)
            if found is not None:
                return Values(done + found[0], done + found[0], source.names[found[1]])
            done += len(made[0])
        return Values(done) if source.rows == done else Values(done, done, source.names[0])


def _pairs(
    passes: Passes, data: ReportInput, source: ParquetSource, columns: list[Column]
) -> Iterator[tuple[list[NDArray[Any]], list[NDArray[Any]]]]:
    """Columns as they are in the file and as they should be, some rows at a time."""
    shown = passes.progress("comparing", data.recording.total_bytes)
    chunks = passes.reader.chunks(passes.request.chunk_samples)
    for chunk, xyz in calibrated(data.recording, chunks, transform_of(data), shown):
        yield source.take(len(chunk)), values_of(columns, chunk, xyz)


def _first_difference(held: list[NDArray[Any]], made: list[NDArray[Any]]) -> tuple[int, int] | None:
    """Row and column of the first bits that differ; rows that the file lacks differ."""
    places = [_row(a, b) for a, b in zip(held, made, strict=True)]
    found = [(row, column) for column, row in enumerate(places) if row is not None]
    return min(found) if found else None


def _row(held: NDArray[Any], made: NDArray[Any]) -> int | None:
    common = min(len(held), len(made))
    same = _bits(held[:common]) == _bits(made[:common])
    if not same.all():
        return int(np.argmin(same))
    return common if len(held) != len(made) else None


def _bits(values: NDArray[Any]) -> NDArray[Any]:
    """Values as integers, so that a NaN equals itself and the two zeros differ."""
    held = np.ascontiguousarray(values)
    return held.view(f"i{held.dtype.itemsize}")


def donor_of(document: Document, named: Path | None) -> Coefficients | None:
    """The coefficients that a report of `apply` used; None for any other report.

    Args:
        named: where the user says their file is; else it is looked for where it was, and beside the
            report.

    Raises:
        UsageError: it is not there.
        UnreadableError: it cannot be used.
    """
    if "coefficients" not in document.report:
        return None
    check_sections(document, ("coefficients",))
    used = document.report["coefficients"]
    by_content = used.get("without_provenance", False)
    then = Path(used["path"])
    beside = document.path.with_name(then.name)
    told = document.path.parent / then if by_content else then
    places = (named,) if named is not None else (told, beside)
    there = [path for path in places if path.is_file()]
    unchanged = [path for path in there if _known_by(path, by_content=by_content) == used["sha256"]]
    for path in unchanged or [path for path in there if path is not beside]:
        return read_coefficients(path, by_content=by_content)
    raise UsageError(
        f"was made with the coefficients of {named or then}, which is not there",
        path=document.path,
        hint="name the file with --coefficients",
    )


def pool_of(document: Document) -> Document | None:
    """The report of the pool whose coefficients a report has; None for any other report.

    Raises:
        UsageError: it is not where it was, seen from the report.
        UnreadableError: it cannot be used.
    """
    if "pool" not in document.report:
        return None
    check_sections(document, ("pool",))
    used = document.report["pool"]
    path = document.path.parent / used.get("path", "")
    if not path.is_file():
        raise UsageError(f"was made with the pool {path}, which is not there", path=document.path)
    found = read_document(path)
    if found.content_sha256 != used.get("sha256"):
        raise UsageError(f"was made with the pool {path}, which was changed since", path=document.path)
    return found


def _known_by(path: Path, *, by_content: bool) -> str:
    return read_document(path).content_sha256 if by_content else sha256(path)


def refuse_kind(document: Document) -> None:
    """Raise UsageError for a report that does not say how its recording was read."""
    used = document.report.get("settings")
    if isinstance(used, dict) and "input" not in used:
        raise UsageError(
            "does not say how its recording was read, and cannot be made again",
            path=document.path,
            hint="name a report of calibrate, apply, fit or six-pose",
        )


def refuse_other(document: Document, recording: Path) -> None:
    """Raise UsageError for a recording that is not the report's, byte for byte."""
    if sha256(recording) != document.report["recording"]["sha256"]:
        raise UsageError(
            f"is not the recording of {document.path}, or was changed since: its SHA-256 is another",
            path=recording,
            hint=f"that report is of {document.report['recording']['path']}",
        )


def layout_of(held: Rebuilt, recording: Path, named: Path | None) -> Path | None:
    """The layout file that the report was made with; raises UsageError where it is not there."""
    return named if held.layout is None else _unchanged(held.layout, recording, named, "layout")


def poses_of(held: Rebuilt, recording: Path, named: Path | None) -> Path | None:
    """The list of poses that the report was made with; raises UsageError where it is not there."""
    return None if held.poses is None else _unchanged(held.poses, recording, named, "poses")


def _unchanged(then: NamedFile, recording: Path, named: Path | None, what: str) -> Path:
    """A file that lies beside the recording, or where the user says."""
    path = named or recording.with_name(then.name)
    if not path.is_file() or sha256(path) != then.sha256:
        raise UsageError(
            f"is not the {what} {then.name} that the report was made with",
            path=path,
            hint=f"name it with --{what}",
        )
    return path


@dataclass(frozen=True, slots=True)
class Wanted:
    """What to verify by.

    Attributes:
        layout: layout file, where it does not lie beside the recording.
        poses: list of poses of a session, where it does not lie beside the recording.
        coefficients: coefficient file of a report of `apply`, where it is not where it was.
        values: also compare every value of the Parquet file.
    """

    layout: Path | None = None
    poses: Path | None = None
    coefficients: Path | None = None
    values: bool = False
    chunk_samples: int = DEFAULT_CHUNK_SAMPLES


def remade(
    document: Document, held: Rebuilt, recording: Path, wanted: Wanted, progress: ProgressMaker
) -> tuple[dict[str, Any], ParquetCheck | None]:
    """The report without `provenance`, and what the Parquet file beside it is worth.

    Raises:
        UnreadableError: the recording, or a file that the report was made with, cannot be read.
        UsageError: a file that the report was made with is not here, or was changed.
    """
    settings = held.settings
    if not isinstance(settings, PoseSettings) and document.report["recording"].get("format") != POINTS:
        request = _request(document, held, settings, recording, wanted)
        return _of_recording(document, request, recording, wanted, progress)
    none = check_parquet(None, document, values=wanted.values)
    if isinstance(settings, PoseSettings):
        return _of_session(held, settings, recording, wanted, progress), none
    return fit_points(recording, settings), none


def _request(
    document: Document, held: Rebuilt, settings: Settings, recording: Path, wanted: Wanted
) -> Request:
    return Request(
        options=replace(held.options, layout=layout_of(held, recording, wanted.layout)),
        settings=settings,
        chunk_samples=wanted.chunk_samples,
        report_only=held.report_only,
        coefficients=donor_of(document, wanted.coefficients),
        any_device=True,
    )


def _of_recording(
    document: Document, request: Request, recording: Path, wanted: Wanted, progress: ProgressMaker
) -> tuple[dict[str, Any], ParquetCheck | None]:
    with open_recording(recording, request.options, request.threads) as reader:
        passes = Passes(Job(recording, recording, document.path), request, progress, reader, recording)
        data = passes.count_beyond(_judged(passes, request.coefficients, pool_of(document)))
        made = (passes, data) if writes_parquet(data) else None
        return build(data), check_parquet(made, document, values=wanted.values)


def _judged(passes: Passes, donor: Coefficients | None, pool: Document | None) -> ReportInput:
    if pool is not None:
        return pooled.judged(passes, pool)[0]
    if donor is None:
        return calibrate.judged(passes)[0]
    found = relation(donor, passes.reader.recording, passes.bytes_at, passes.request)
    return apply.judged(passes, donor, found)


def _of_session(
    held: Rebuilt, settings: PoseSettings, recording: Path, wanted: Wanted, progress: ProgressMaker
) -> dict[str, Any]:
    request = PoseRequest(
        options=replace(held.options, layout=layout_of(held, recording, wanted.layout)),
        settings=settings,
        poses=poses_of(held, recording, wanted.poses),
        chunk_samples=wanted.chunk_samples,
    )
    return session_report(recording, request, progress)


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
