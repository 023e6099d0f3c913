"""Making a report again from its recording, whatever command made it; nothing is written."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from accelcal_cli.core.settings import PoseSettings, Settings
from accelcal_cli.output.coefficients import Coefficients
from accelcal_cli.output.document import Document
from accelcal_cli.output.report import ReportInput, build
from accelcal_cli.pipeline import apply, calibrate, pooled
from accelcal_cli.pipeline.again import donor_of, layout_of, pool_of, poses_of
from accelcal_cli.pipeline.donor import relation
from accelcal_cli.pipeline.fit import fit_points
from accelcal_cli.pipeline.passes import Passes, writes_parquet
from accelcal_cli.pipeline.plan import Job
from accelcal_cli.pipeline.rebuild import POINTS, Rebuilt
from accelcal_cli.pipeline.request import DEFAULT_CHUNK_SAMPLES, ProgressMaker, Request
from accelcal_cli.pipeline.six_pose import PoseRequest, session_report
from accelcal_cli.pipeline.values import ParquetCheck, check_parquet
from accelcal_cli.readers import open_recording


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
