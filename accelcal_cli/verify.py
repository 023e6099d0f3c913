"""Verify a report: make it again from its recording and compare bit for bit; nothing is written.

`inputs` of a report (layout, poses, coefficients, pool) are looked for where they were and next to it. The
calibrated Parquet file next to a report is compared with the report, and on demand value by value.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.declared import from_json
from accelcal_cli.core.errors import UnreadableError, UsageError, printable, significant
from accelcal_cli.core.identity import SAMPLES, identity
from accelcal_cli.core.input_files import files_of, is_pattern
from accelcal_cli.core.paths import is_file, is_folder
from accelcal_cli.core.settings import PoseSettings, Settings
from accelcal_cli.core.version import __version__
from accelcal_cli.judge.errors import difference_mg, directions
from accelcal_cli.output.coefficients import Coefficients, calibration_of, learnt_prior_of, read_coefficients
from accelcal_cli.output.columns import described, schema_of, values_of
from accelcal_cli.output.files import metadata_of, stored_schema
from accelcal_cli.output.registry import held_in
from accelcal_cli.output.report import ReportInput, build, result_json
from accelcal_cli.output.report_reading import Document, check_sections, file_place, read_document, section
from accelcal_cli.output.sections import AppliedCoefficients, PoolSection
from accelcal_cli.parquet import ParquetSource
from accelcal_cli.pipeline import calibrate, jobs
from accelcal_cli.pipeline.apply import DonorCoefficients, relation_of
from accelcal_cli.pipeline.calibrate import Judge, OwnCalibration, RecordingRun, open_run
from accelcal_cli.pipeline.export import calibrated, columns_of, transform_of
from accelcal_cli.pipeline.jobs import Job, ProgressMaker, Request, no_progress, sha256
from accelcal_cli.pipeline.options import POINTS, NamedFile, ReportSettings, settings_from_report
from accelcal_cli.pipeline.outputs import json_round_trip
from accelcal_cli.pipeline.pool import PoolCoefficients
from accelcal_cli.pipeline.windows import fit_points
from accelcal_cli.six_pose.run import known_orientations

NOT_COMPARED = ("provenance", "accelcal_version")
"""Keys that are not compared: the provenance differs from run to run, versions are shown apart."""

PROSE = ("message", "note")
"""Keys of sentences, wherever they stand, which no program compares; so are the notes on the recording."""

DUMP = "raw"
"""Format whose recordings `--layout` describes; the sidecars of others are found by their names."""

_ABSENT = object()


@dataclass(frozen=True, slots=True)
class VerifyOptions:
    """Options of a verification: extent of the comparison, and files that have moved.

    Attributes:
        layout: layout file, if it is not next to the recording.
        poses: list of poses of a session, if it is not next to the recording.
        coefficients: coefficient file of a report of `apply`, if it has moved.
        values: also compare every value of the Parquet file.
    """

    layout: Path | None = None
    poses: Path | None = None
    coefficients: Path | None = None
    values: bool = False
    chunk_samples: int = jobs.DEFAULT_CHUNK_SAMPLES


@dataclass(frozen=True, slots=True)
class Values:
    """Result of comparing every value: the first row that differs and its column, None if none does."""

    rows: int
    first_row: int | None = None
    column: str | None = None


@dataclass(frozen=True, slots=True)
class ParquetCheck:
    """The Parquet file next to a report.

    Attributes:
        differs: keys of its metadata that differ from the report.
        values: None if they were not asked for.
    """

    path: Path
    differs: tuple[str, ...]
    values: Values | None

    @property
    def differing(self) -> tuple[str, ...]:
        """Keys of the metadata that differ, and `values` where these do."""
        apart = self.values is not None and self.values.first_row is not None
        return (*self.differs, *(("values",) if apart else ()))


@dataclass(frozen=True, slots=True)
class Verified:
    """Result of a verification.

    Attributes:
        differs: keys of the report that differ from those made now.
        largest_mg, mean_mg: differences of the two calibrations, over 162 directions at the reference
            temperature; None if there are not two.
        made_by: version that wrote the report.
        missing, unknown: settings that the report lacks, and that this version does not have.
        parquet: None if there is none next to the report.
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
        """Keys that differ, in the report and (with `parquet.` before them) in the Parquet file."""
        of_parquet = () if self.parquet is None else self.parquet.differing
        return (*self.differs, *(f"parquet.{name}" for name in of_parquet))

    @property
    def identical(self) -> bool:
        """True if the report, and the Parquet file where there is one, are reproduced."""
        return not self.all_differing


def verify(
    report: Path, recording: Path, options: VerifyOptions, progress: ProgressMaker = no_progress
) -> Verified:
    """Make a report again from its recording, writing nothing, and compare.

    Raises:
        UnreadableError: the report or the recording cannot be read.
        UsageError: the recording is not the report's, or what the report was made with is not here.
    """
    document = read_document(report)
    check_sections(document, ("recording",))
    refuse_kind(document)
    refuse_other(document, recording)
    made_with = settings_from_report(document)
    report_now, parquet = reproduced(document, made_with, recording, options, progress)
    return _verified(document, made_with, json_round_trip(report_now), parquet)


def word(identical: bool) -> str:
    """Return the word for a result."""
    return "identical" if identical else "differs"


def as_json(report: Path, recording: Path, verified: Verified) -> dict[str, Any]:
    """Return the result as a JSON object."""
    return {
        "report": printable(report),
        "recording": printable(recording),
        "result": word(verified.identical),
        "differs": list(verified.differs),
        "largest_mg": verified.largest_mg,
        "mean_mg": verified.mean_mg,
        "versions": {"report": verified.made_by, "this": __version__},
        "settings_assumed": list(verified.missing),
        "settings_unknown": list(verified.unknown),
        "parquet": None if verified.parquet is None else _parquet(verified.parquet),
    }


def _parquet(check: ParquetCheck) -> dict[str, Any]:
    values = check.values
    return {
        "path": printable(check.path),
        "metadata": word(not check.differs),
        "differs": list(check.differs),
        "values": None if values is None else word(values.first_row is None),
        "rows": None if values is None else values.rows,
        "first_row": None if values is None else values.first_row,
        "column": None if values is None else values.column,
    }


def reproduced(
    document: Document,
    made_with: ReportSettings,
    recording: Path,
    options: VerifyOptions,
    progress: ProgressMaker = no_progress,
) -> tuple[dict[str, Any], ParquetCheck | None]:
    """Make the report again, without `provenance`, and check the Parquet file next to it.

    Raises:
        UnreadableError: the recording, or a file that the report was made with, cannot be read.
        UsageError: a file that the report was made with is not here, or was changed.
    """
    settings = made_with.settings
    session = isinstance(settings, PoseSettings)
    if session or document.recording.format == POINTS:
        check_parquet(None, document, values=options.values)
    if isinstance(settings, Settings) and document.recording.format == POINTS:
        return fit_points(recording, settings), None
    layout = _unchanged(made_with.layout, recording, options.layout, "layout")
    is_dump = document.recording.format == DUMP
    request = Request(
        options=replace(made_with.options, layout=(layout if is_dump else None) or options.layout),
        settings=settings,
        poses=_unchanged(made_with.poses, recording, options.poses, "poses"),
        chunk_samples=options.chunk_samples,
        report_only=session or made_with.report_only,
        effect=made_with.effect,
        coefficients=donor_of(document, options.coefficients),
        any_device=True,
        unused=made_with.unused,
        parts=True,
        joined=True,
        ignore_sidecars=True,
    )
    with open_run(Job(recording, recording, document.path), request, progress) as run:
        data = run.count_beyond(run.result(judge_of(run, document)).data)
        written = (run, data) if calibrate.writes_parquet(data) else None
        return build(data), check_parquet(written, document, values=options.values)


def judge_of(run: RecordingRun, document: Document) -> Judge:
    """Return the judge that made a report.

    Raises:
        UsageError, UnreadableError: the pool whose coefficients it has is not there, or was changed.
    """
    request = run.request
    if isinstance(request.settings, PoseSettings):
        return known_orientations(request)
    pool, donor = pool_of(document), request.coefficients
    if pool is not None:
        return PoolCoefficients(request.settings, pool)
    if donor is None:
        return OwnCalibration(request.settings, learnt_prior_of(document, request.settings.prior))
    relation = relation_of(donor, run.reader.recording, run.path_to_read, request)
    return DonorCoefficients(request.settings, donor, relation)


def _verified(
    document: Document, made_with: ReportSettings, now: dict[str, Any], parquet: ParquetCheck | None
) -> Verified:
    missing, unknown, then = made_with.missing, made_with.unknown, document.report
    _keep_paths(now, then)
    elsewhere = (*missing, *unknown) if then["accelcal_version"] != __version__ else ()
    passed = tuple(f"settings.{name}" for name in elsewhere)
    keys = tuple(
        key
        for key in differing(_compared(then), _compared(now))
        if not any(key == name or key.startswith((f"{name}.", f"{name}[")) for name in passed)
    )
    largest, mean = _difference(then.get("calibration"), now["calibration"])
    return Verified(keys, largest, mean, str(then["accelcal_version"]), missing, unknown, parquet)


def _keep_paths(now: dict[str, Any], then: dict[str, Any]) -> None:
    """Take over the paths of files that may have moved: their hashes are compared."""
    for name in ("recording", "coefficients"):
        if name in now and name in then:
            now[name]["path"] = then[name]["path"]
    settings, before = now["settings"], then["settings"]
    for new, old, name in ((settings["input"], before["input"], "layout"), (settings, before, "poses")):
        if new.get(name) is not None and name in old:
            new[name] = old[name]


def _compared(report: dict[str, Any], left_out: Sequence[str] = NOT_COMPARED) -> dict[str, Any]:
    kept = {name: value for name, value in report.items() if name not in left_out}
    recording = {name: value for name, value in section(kept, "recording").items() if name != "notes"}
    compared: dict[str, Any] = _without_prose(kept | {"recording": recording})
    return compared


def _without_prose(value: Any) -> Any:
    """Return a JSON value without the sentences in it."""
    if isinstance(value, dict):
        return {name: _without_prose(one) for name, one in value.items() if name not in PROSE}
    return [_without_prose(one) for one in value] if isinstance(value, list) else value


def _difference(then: Any, now: Any) -> tuple[float | None, float | None]:
    try:
        one, other = map(calibration_of, (then, now))
    except (ValueError, TypeError):
        return None, None
    largest, mean = difference_mg(one, other, directions())
    return significant(largest), significant(mean)


def differing(one: Any, other: Any, where: str = "") -> Iterator[str]:
    """Find the places, such as `calibration.gain[1][0]`, where two JSON values differ in any bit."""
    if isinstance(one, dict) and isinstance(other, dict):
        for name in [*one, *(name for name in other if name not in one)]:
            place = f"{where}.{name}" if where else str(name)
            yield from differing(one.get(name, _ABSENT), other.get(name, _ABSENT), place)
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for index, (left, right) in enumerate(zip(one, other, strict=True)):
            yield from differing(left, right, f"{where}[{index}]")
    elif one is _ABSENT or other is _ABSENT or json.dumps(one) != json.dumps(other):
        yield where


def check_parquet(
    written: tuple[RecordingRun, ReportInput] | None, document: Document, *, values: bool
) -> ParquetCheck | None:
    """Compare the Parquet file next to a report with the report, and with its recording.

    Args:
        written: the recording's run and result; None if the result has no calibrated data.
        values: compare every value too.

    Returns:
        None if no such file lies there.

    Raises:
        UsageError: values are to be compared, but there are none.
    """
    path = None if written is None else jobs.parquet_of(document.path)
    if path is None or written is None:
        if values:
            raise UsageError(
                "no calibrated Parquet file lies next to it", path=document.path, hint="omit --values"
            )
        return None
    metadata, stored = metadata_of(path, UnreadableError), stored_schema(path, UnreadableError)
    wanted = schema_of(columns_of(written[1]), {})
    names = (*identity(SAMPLES), "calibration", "recording", *({"gyroscope"} & {*metadata, *document.report}))
    expected = {name: document.report.get(name) for name in names}
    expected |= {"kind": SAMPLES, "result": result_json(document.report)}
    keys = (
        *differing(_compared(metadata, ()), _compared(expected, ())),
        *(() if stored is None else differing(described(stored), described(wanted))),
    )
    return ParquetCheck(path, keys, compare_values(*written, path) if values else None)


def compare_values(run: RecordingRun, data: ReportInput, path: Path) -> Values:
    """Compare every value of every column.

    Raises:
        UnreadableError: the Parquet file or the recording cannot be read.
    """
    columns = columns_of(data)
    with ParquetSource(path) as source:
        wrong = source.other_column(schema_of(columns, {}))
        if wrong is not None:
            return Values(0, 0, wrong)
        done, shown = 0, run.progress("comparing", data.recording.total_bytes)
        run.reader.with_others = bool(data.recording.others)
        chunks = run.reader.chunks(run.request.chunk_samples)
        for chunk, xyz in calibrated(chunks, transform_of(data), shown):
            pairs = zip(source.take(len(chunk)), values_of(columns, chunk, xyz), strict=True)
            first = [_first_row(stored, expected) for stored, expected in pairs]
            known = [(row, column) for column, row in enumerate(first) if row is not None]
            if known:
                row, column = min(known)
                return Values(done + row, done + row, source.names[column])
            done += len(chunk)
        return Values(done) if source.rows == done else Values(done, done, source.names[0])


def _first_row(stored: NDArray[Any], expected: NDArray[Any]) -> int | None:
    """Return the first row whose bits differ; rows that the file lacks differ."""
    common = min(len(stored), len(expected))
    same = _bits(stored[:common]) == _bits(expected[:common])
    if not same.all():
        return int(np.argmin(same))
    return common if len(stored) != len(expected) else None


def _bits(values: NDArray[Any]) -> NDArray[Any]:
    """Return values as integers, so that a NaN equals itself and the two zeros differ."""
    return np.ascontiguousarray(values).view(f"i{values.dtype.itemsize}")


def donor_of(document: Document, stated: Path | None) -> Coefficients | None:
    """Return the coefficients that a report of `apply` used; None for any other report.

    Args:
        stated: where the user says their file is; else it is looked for where it was, and next to the
            report.

    Raises:
        UsageError: it is not there.
        UnreadableError: it cannot be used.
    """
    if "coefficients" not in document.report:
        return None
    check_sections(document, ("coefficients",))
    used = from_json(AppliedCoefficients, document.report["coefficients"])
    by_content, then, folder = bool(used.without_provenance), Path(used.path), document.path.parent
    original = folder / then if by_content else place_of(document, "coefficients") or then
    places = [original, folder / then.name] if stated is None else [stated]
    existing = [*filter(is_file, places)]
    for path in existing if by_content else ():
        if (held := held_in(path, used.sha256)) is not None:
            return held
    unchanged = [
        path
        for path in existing
        if (read_document(path).content_sha256 if by_content else sha256(path)) == used.sha256
    ]
    for path in unchanged or [path for path in existing if path == places[0]]:
        return read_coefficients(path, by_content=by_content)
    raise UsageError(
        f"was made with the coefficients in {stated or then}, which is missing",
        path=document.path,
        hint="name the file with --coefficients",
    )


def place_of(document: Document, name: str) -> Path | None:
    """Return where a file was that a report was made of; None where the report does not say it."""
    place = file_place(document.report, name)
    return None if place is None else Path(place)


def recording_of(report: Path) -> Path:
    """Return the recording that a report names: the one next to it, else the one that it was made of.

    Raises:
        UnreadableError: the report cannot be read.
        UsageError: neither is there.
    """
    document = read_document(report)
    check_sections(document, ("recording",))
    name = Path(document.recording.path).name
    places = [report.with_name(name)] if name else []
    then = place_of(document, "recording") or Path(document.recording.path)
    for place in (*places, then):
        if is_file(place) or is_folder(place) or (is_pattern(place) and files_of(place)):
            return place
    hint = f"accelcal verify {shlex.quote(printable(report))} RECORDING"
    raise UsageError(f"its recording, {document.recording.path}, is not next to it", path=report, hint=hint)


def pool_of(document: Document) -> Document | None:
    """Return the report of the pool whose coefficients a report has; None for any other report.

    Raises:
        UsageError: it is not where it was, seen from the report.
        UnreadableError: it cannot be used.
    """
    if "pool" not in document.report:
        return None
    check_sections(document, ("pool",))
    used = from_json(PoolSection, document.report["pool"])
    path = document.path.parent / (used.path or "")
    if not is_file(path):
        raise UsageError(f"was made with the pool {path}, which is missing", path=document.path)
    pool = read_document(path)
    if pool.content_sha256 != used.sha256:
        raise UsageError(f"was made with the pool {path}, which has changed since", path=document.path)
    return pool


def refuse_kind(document: Document) -> None:
    """Raise UsageError for a report that does not say how its recording was read."""
    used = document.report.get("settings")
    if isinstance(used, dict) and "input" not in used:
        raise UsageError(
            "does not say how its recording was read, and cannot be reproduced",
            path=document.path,
            hint="name a report of calibrate, apply, fit or six-pose",
        )


def refuse_other(document: Document, recording: Path) -> None:
    """Raise UsageError for a recording that is not the report's, byte for byte."""
    if sha256(recording) != document.recording.sha256:
        raise UsageError(
            f"is not the recording of {document.path}, or has changed since: its SHA-256 differs",
            path=recording,
            hint=f"that report is of {document.recording.path}",
        )


def _unchanged(then: NamedFile | None, recording: Path, stated: Path | None, what: str) -> Path | None:
    """Find a file that the report was made with: where the user says, or in or next to the recording."""
    if then is None:
        return None
    inside = recording / then.name
    path = stated or (inside if is_file(inside) else recording.parent / then.name)
    if not is_file(path) or sha256(path) != then.sha256:
        raise UsageError(
            f"is not the {what} {then.name} that the report was made with",
            path=path,
            hint=f"name it with --{what}",
        )
    return path
