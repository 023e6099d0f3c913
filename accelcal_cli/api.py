"""The package from Python: the work of the commands, with arrays and tables in place of files.

    import accelcal_cli as accelcal

Options are those of the commands, with underscores: `--lsb-per-g` is `lsb_per_g`. Results are the same bits
as those of the commands. Nothing is written unless `Result.write` or `study` is called.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from accelcal_cli.core.calibration import RawRows, Transform
from accelcal_cli.core.clock import MICROSECONDS, utc_offset_s
from accelcal_cli.core.errors import AccelcalError, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.reasons import Reason
from accelcal_cli.core.recording import Chunk, Reader, Recording
from accelcal_cli.core.settings import POSES, PoseSettings, Settings
from accelcal_cli.output import report as reports
from accelcal_cli.output.coefficients import calibration_of, read_coefficients
from accelcal_cli.output.report import ReportInput
from accelcal_cli.output.report_reading import read_document
from accelcal_cli.output.words import sentence
from accelcal_cli.pipeline import export, jobs, outputs, survey
from accelcal_cli.pipeline.activity import EPOCH_S, LONGEST_EPOCH_S
from accelcal_cli.pipeline.calibrate import FirstPass, OwnCalibration, open_run
from accelcal_cli.pipeline.calibrate import calibrate as run_job
from accelcal_cli.pipeline.jobs import DEFAULT_CHUNK_SAMPLES, FileStamp, Job, Request, file_stamp
from accelcal_cli.pipeline.options import (
    chosen_settings,
    field_values,
    fit_settings,
    folder_rules,
    option_fields,
    read_options,
    recipient_settings,
    recording_options,
    with_values,
)
from accelcal_cli.pipeline.windows import fit_frame, fit_points

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

AnyPath = str | PathLike[str]


def _values(options: dict[str, Any], *kinds: type) -> dict[str, Any]:
    """Return the options by field, None for those that are not given, as a command line would.

    Raises:
        TypeError, UsageError: see `field_values`.
    """
    nothing: dict[str, Any] = {name: None for _, name in option_fields(ReadOptions, Settings).values()}
    return nothing | {"no_temperature": False, "force_timezone": False} | field_values(options, *kinds)


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """n consecutive rows of a recording.

    Attributes:
        first_sample: number of the first of them within the recording.
        time: (n,) datetime64[us], UTC if `Reading.recording.timezone` is known, else the device's clock.
        xyz: (n, 3) raw acceleration [g].
        temperature: (n,) [degrees C], or None.
        gyroscope: (n, 3) [degrees/s], or None.
        validity: (n,) 0 measured, 1 filled by the device, 2 clipped at its range, 3 recovered from damage.
        problems: messages of the problems found in these rows.
    """

    first_sample: int
    time: NDArray[np.datetime64]
    xyz: NDArray[np.float64]
    temperature: NDArray[np.float64] | None
    gyroscope: NDArray[np.float64] | None
    validity: NDArray[np.uint8]
    problems: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.xyz)


class Reading:
    """An open recording: iterate over it for its samples, as often as wanted; close it, or use `with`.

    Attributes:
        recording: facts from its header: format, device, rate, range, time zone.
    """

    def __init__(self, reader: Reader, chunk_samples: int) -> None:
        self.recording: Recording = reader.recording
        self._reader, self._chunk_samples = reader, chunk_samples

    def __iter__(self) -> Iterator[Samples]:
        """Yield all rows in order, in pieces.

        Raises:
            UnreadableError: the recording cannot be read on.
        """
        offset_s, dated = None, True
        for chunk in self._reader.chunks(self._chunk_samples):
            dated &= all(problem.code != "no_start_time" for problem in chunk.problems)
            if len(chunk):
                time_us = chunk.time_us
                if offset_s is None:
                    zone = self.recording.timezone if dated else None
                    offset_s = utc_offset_s(zone, int(time_us[0])) or 0
                yield _samples(chunk, self.recording, time_us - MICROSECONDS * offset_s)

    def close(self) -> None:
        """Release the file."""
        self._reader.close()

    def __enter__(self) -> Reading:
        return self

    def __exit__(self, *_failure: object) -> None:
        self.close()


def _samples(chunk: Chunk, recording: Recording, time_us: NDArray[np.int64]) -> Samples:
    gyro, scale = chunk.gyro_counts, recording.gyro_dps_per_lsb
    return Samples(
        chunk.first_sample,
        time_us.astype("datetime64[us]"),
        chunk.counts / recording.lsb_per_g,
        None if chunk.temperature_mc is None else chunk.temperature_mc / 1000,
        None if gyro is None or scale is None else gyro * np.array(scale),
        np.zeros(len(chunk), np.uint8) if chunk.validity is None else chunk.validity,
        tuple(problem.message for problem in chunk.problems),
    )


def read(path: AnyPath, *, chunk_samples: int = DEFAULT_CHUNK_SAMPLES, **options: Any) -> Reading:
    """Open a recording of any format.

    Args:
        chunk_samples: approximate number of rows in a piece.
        options: reading options: `format`, `rate`, `unit`, `lsb_per_g`, `columns`, `timezone`, ...

    Raises:
        AccelcalError: it cannot be read.
    """
    source = Path(path)
    wanted = recording_options(source, read_options(_values(options, ReadOptions)))
    return Reading(survey.open_marked(source, wanted), chunk_samples)


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """One recording's calibration.

    Attributes:
        report: as the command writes it (docs/outputs.md).
    """

    report: dict[str, Any]
    _data: ReportInput = field(repr=False)
    _request: Request = field(repr=False)
    _first_pass: FirstPass = field(repr=False)
    _path: Path
    _before: FileStamp | None = field(repr=False)

    @property
    def outcome(self) -> str:
        """`calibrated`, `provisional`, `reduced_model`, `already_good` or `refused`."""
        return str(self.report["outcome"])

    @property
    def reason(self) -> str:
        """Code of why the outcome is what it is (docs/reasons.md)."""
        return str(self.report["reason"])

    @property
    def values(self) -> dict[str, Any]:
        """Values of the reason, by name."""
        return dict(self.report["values"])

    @property
    def message(self) -> str:
        """Reason of the outcome, in sentences for people."""
        return str(self.report["message"])

    @property
    def cautions(self) -> tuple[Reason, ...]:
        """Return the reasons not to trust the result without a look."""
        return tuple(Reason(**one) for one in self.report["cautions"])

    @property
    def advice(self) -> tuple[Reason, ...]:
        """Return the steps to take next."""
        return tuple(Reason(**one) for one in self.report["advice"])

    def batches(self) -> Iterator[pa.RecordBatch]:
        """Yield the calibrated recording in pieces with the columns of the Parquet file; reads it once more.

        Raises:
            AccelcalError: the recording was refused, changed while it was read, or cannot be read on.
        """
        import pyarrow as pa

        from accelcal_cli.output.columns import schema_of, values_of

        if self._data.judgement.calibration is None:
            raise UsageError(f"there are no calibrated values: refused: {self.message}", path=self._path)
        jobs.check_unchanged(self._path, self._before)
        columns = export.columns_of(self._data)
        schema = schema_of(columns, reports.parquet_metadata(self._data))
        with survey.open_marked(self._path, self._request.options, self._request.threads) as reader:
            chunks = reader.chunks(self._request.chunk_samples)
            for chunk, xyz in export.calibrated(chunks, export.transform_of(self._data), lambda _byte: None):
                values = values_of(columns, chunk, xyz)
                arrays = [pa.array(part, item.type) for part, item in zip(values, schema, strict=True)]
                yield pa.record_batch(arrays, schema=schema)

    def table(self) -> pa.Table:
        """Return all of it, in memory (a week of 100 Hz: 1.3 GB); raises what `batches` raises."""
        import pyarrow as pa

        return pa.Table.from_batches(self.batches())

    def to_pandas(self) -> pd.DataFrame:
        """Return all of it as a data frame, with `time` as index; raises what `batches` raises."""
        return self.table().to_pandas().set_index("time")

    def windows(self) -> pd.DataFrame:
        """Return all still windows and what became of them, with the columns of `calibrate --windows`."""
        from accelcal_cli.output.windows import arrow

        first = self._first_pass
        assert first.log is not None
        table: pd.DataFrame = arrow(first.log.table(self._data, first.points)).to_pandas()
        return table

    def quality(self) -> dict[str, Any] | None:
        """Return the recording along time (docs/quality.md); None with profile `paper`."""
        from accelcal_cli.output.quality import dumps_quality, quality_json

        made = self._first_pass.quality()
        return None if made is None else json.loads(dumps_quality(quality_json(made)))

    def write(self, folder: AnyPath | None = None, *, force: bool = False) -> tuple[Path | None, Path]:
        """Write the files of the command `calibrate` next to the recording, or into a folder.

        Returns:
            the Parquet file (None without calibrated values) and the report.

        Raises:
            OutputError: a file cannot be written, or another program's is in its place.
        """
        (job,) = jobs.plan([self._path], None if folder is None else Path(folder), None)
        result = run_job(job, replace(self._request, force=force))
        return result.parquet, job.report

    def plot(self, axes: Any = None) -> Any:
        """Plot |a| of still windows along time, before and after; needs matplotlib.

        Args:
            axes: axes of matplotlib; None for new ones.

        Returns:
            the axes.
        """
        import matplotlib.pyplot as plt

        windows = self.windows()
        axes = plt.subplots(figsize=(9, 3.5))[1] if axes is None else axes
        time = windows["time"].to_numpy()
        axes.plot(time, windows["raw_g"], ".", markersize=2, color="0.6", label="before")
        if self._data.judgement.calibration is not None:
            axes.plot(time, windows["calibrated_g"], ".", markersize=2, color="C0", label="after")
        axes.axhline(1.0, color="k", linewidth=0.5)
        axes.set_ylabel("|a| of still windows [g]")
        axes.set_title(self._path.name)
        axes.legend(loc="upper right")
        return axes


def calibrate(path: AnyPath, *, report_only: bool = False, **options: Any) -> Result:
    """Calibrate a recording from its own stillness.

    Args:
        report_only: skip the second pass, which alone counts `clipped_samples_after`.
        options: options of `accelcal calibrate` for reading and calibrating.

    Raises:
        AccelcalError: it cannot be read, or the options do not go together.
    """
    values, source = _values(options, ReadOptions, Settings), Path(path)
    request = Request(
        options=read_options(values),
        settings=chosen_settings(values),
        report_only=report_only,
        parts=True,
    )
    before = file_stamp(source)
    with open_run(Job(source, source, source), request) as run:
        first_pass = run.result(OwnCalibration(request.recording_settings), logged=True)
        data = run.count_beyond(first_pass.data)
    jobs.check_unchanged(source, before)
    report = outputs.with_provenance(reports.build(data), ("accelcal_cli.calibrate",))
    return Result(_as_written(report), data, run.request, first_pass, source, before)


def _as_written(report: dict[str, Any]) -> dict[str, Any]:
    """Return a report as it would be read from its file."""
    read_again: dict[str, Any] = json.loads(reports.dumps(report, pretty=False))
    return read_again


def fit(points: Any, **options: Any) -> dict[str, Any]:
    """Fit still-window means, as `accelcal fit` does.

    Args:
        points: a path; or a data frame (or what makes one, such as a dictionary of columns, or an Arrow
            table) with columns x, y, z [g] and optionally temperature_c, weight and posture, or those of
            `Result.windows`; or an array (n, 3) [g].
        options: `optimizer`, `model`, `prior`, `no_temperature`, `latitude`, `altitude`.

    Returns:
        the report.

    Raises:
        AccelcalError: it is not a table of points, or the options do not go together.
    """
    settings = fit_settings(_values(options, Settings))
    if isinstance(points, str | PathLike):
        report = fit_points(Path(points), settings)
    else:
        report = fit_frame(_frame(points), settings)
    return _as_written(outputs.with_provenance(report, ("accelcal_cli.fit",)))


def from_poses(
    recordings: AnyPath | Sequence[AnyPath],
    *,
    poses: AnyPath | None = None,
    roll: Sequence[str] = (),
    **options: Any,
) -> dict[str, Any]:
    """Calibrate from a session of known orientations, as `accelcal six-pose` does.

    Args:
        recordings: the session: a recording, or the folder or the paths of several of one device.
        poses: list of poses; None: the six faces are found.
        roll: where the device was rolled with one axis level, such as `z,80,95`.
        options: `unchecked`, and others of `accelcal six-pose`.

    Returns:
        the report.

    Raises:
        AccelcalError: it cannot be read, the poses do not determine the parameters, or the options do not go
            together.
    """
    # few programs have such a session
    from accelcal_cli.six_pose.run import known_orientations, session_of

    several = [recordings] if isinstance(recordings, str | PathLike) else recordings
    source = session_of([Path(one) for one in several], None if poses is None else Path(poses))
    values = _values(options, ReadOptions, PoseSettings)
    request = Request(
        options=read_options(values),
        settings=replace(with_values(POSES, values), roll=tuple(roll)),
        poses=None if poses is None else Path(poses),
        report_only=True,
        parts=True,
    )
    judge, before = known_orientations(request), file_stamp(source)
    with open_run(Job(source, source, source), request) as run:
        data = run.count_beyond(run.result(judge).data)
    jobs.check_unchanged(source, before)
    return _as_written(outputs.with_provenance(reports.build(data), ("accelcal_cli.from_poses",)))


def _frame(points: Any) -> pd.DataFrame:
    import pandas as pd

    if hasattr(points, "to_pandas"):
        points = points.to_pandas()
    if isinstance(points, np.ndarray | list | tuple):
        return pd.DataFrame(np.asarray(points, np.float64).reshape(-1, 3), columns=list("xyz"))
    return pd.DataFrame(points)


def apply(
    report: dict[str, Any] | AnyPath | Result,
    xyz: ArrayLike,
    temperature: ArrayLike | None = None,
    *,
    first_sample: int = 0,
) -> NDArray[np.float32]:
    """Calibrate raw values: a = K (v + o + s (T - Tref)).

    Args:
        report: a result or report with a calibration, or the path of one.
        xyz: (n, 3) raw acceleration [g].
        temperature: (n,) [degrees C], taken to the nearest thousandth; needed where the offsets depend on it.
        first_sample: number of the first row in its recording, where the calibration follows a change.

    Returns:
        (n, 3) [g], the same bits as in the Parquet file.

    Raises:
        UsageError: there is no calibration, or it needs temperatures.
        ValueError: an array has another shape.
    """
    content = report.report if isinstance(report, Result) else report
    if not isinstance(content, dict):
        content = read_document(Path(content)).report
    if content["calibration"] is None:
        raise UsageError(f"there is nothing to apply: {content['message']}")
    calibration = calibration_of(content["calibration"])
    v = np.asarray(xyz, np.float64)
    if v.ndim != 2 or v.shape[1] != 3:
        raise ValueError(f"xyz has the shape {v.shape}, not (n, 3)")
    warmth = None
    if temperature is not None:
        warmth = np.rint(np.asarray(temperature, np.float64) * 1000).astype(np.int32)
        if warmth.shape != v.shape[:1]:
            raise ValueError(f"temperature has the shape {warmth.shape}, not {v.shape[:1]}")
    elif calibration.temperature is not None:
        raise UsageError("the calibration needs temperatures", hint="give one for each row")
    transform = Transform.of(calibration, lsb_per_g=1.0)
    return np.stack(transform.apply(RawRows(v, warmth, first_sample)), axis=1)


def effect(
    path: AnyPath,
    *,
    coefficients: AnyPath | None = None,
    any_device: bool = False,
    epoch: int = EPOCH_S,
    **options: Any,
) -> dict[str, Any]:
    """Compute what calibration changes in a recording's measures of activity, as `accelcal effect` does.

    Args:
        coefficients: a report whose coefficients are applied; None: the recording's own calibration.
        any_device: accept coefficients of any device.
        epoch: length of an epoch [s], 1 to 3600.
        options: options of `accelcal effect` for reading and calibrating.

    Returns:
        what `accelcal effect --json` prints: `recording`, `outcome`, `message` and `effect`, whose `versions`
        have the measures of the raw and the calibrated values (docs/effect.md).

    Raises:
        AccelcalError: it cannot be read, the options do not go together, or the coefficients are not for it.
    """
    from accelcal_cli.activity_effect import as_json
    from accelcal_cli.activity_effect import effect as measured

    if isinstance(epoch, bool) or not isinstance(epoch, int | np.integer):
        raise TypeError(f"epoch cannot be {epoch!r}")
    if not 1 <= epoch <= LONGEST_EPOCH_S:
        raise UsageError(f"epoch cannot be {epoch}", hint=f"possible: 1 to {LONGEST_EPOCH_S}")
    if any_device and coefficients is None:
        raise UsageError("any_device is for coefficients only", hint="omit it")
    values = _values(options, ReadOptions, Settings)
    request = Request(
        options=read_options(values),
        settings=chosen_settings(values) if coefficients is None else recipient_settings(values),
        coefficients=None if coefficients is None else read_coefficients(Path(coefficients)),
        any_device=any_device,
        report_only=True,
        parts=True,
    )
    return _as_written(as_json(measured(Path(path), request, int(epoch))))


def study(
    folder: AnyPath, output: AnyPath, *, report_only: bool = False, jobs: int | None = None, **options: Any
) -> pd.DataFrame:
    """Calibrate all recordings below a folder, as `accelcal study` does; resumes an earlier run.

    Args:
        output: folder into which the outputs are written.
        report_only: write reports but no Parquet.
        jobs: workers; None for as many as CPUs and memory allow.
        options: options of `calibrate`, for all recordings.

    Returns:
        the table of the study, one row a recording (docs/study.md).

    Raises:
        AccelcalError: the options do not go together, or the folder cannot be used.
    """
    # few programs do both
    import pandas as pd

    from accelcal_cli.studies.discovery import Where
    from accelcal_cli.studies.run import run
    from accelcal_cli.studies.study import Study

    values = _values(options, ReadOptions, Settings)
    request = Request(
        options=read_options(values),
        settings=chosen_settings(values, in_study=True),
        report_only=report_only,
        several=True,
        command=("accelcal_cli.study",),
        rules=folder_rules([Path(folder)]),
        parts=True,
    )
    run(Study(Where((Path(folder),), Path(output), (), ()), request, jobs=jobs), _Silent())
    return pd.read_parquet(Path(output) / "study.parquet")


class _Silent:
    """Observer of a study that says nothing."""

    def begin(self, items: Any) -> None:
        """See `StudyObserver`."""

    def advance(self, bytes_done: float) -> None:
        """See `StudyObserver`."""

    def finished(self, item: Any, result: Any) -> None:
        """See `StudyObserver`."""

    def note(self, text: str) -> None:
        """See `StudyObserver`."""


__all__ = [
    "AccelcalError", "Reading", "Reason", "Result", "Samples",
    "apply", "calibrate", "effect", "fit", "from_poses", "read", "sentence", "study",
]  # fmt: skip
