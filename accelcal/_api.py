"""The functions for one recording: the work of the commands, with arrays and tables in place of files.

Results are the same bits as those of the commands. Nothing is written unless a path is given.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from accelcal._calling import Answering, check_number, public, speaking_python
from accelcal._options import CalibrationOptions, FitOptions, PoseOptions, ReadingOptions
from accelcal._results import Calibration, Report, Result
from accelcal._sources import (
    AnyPath,
    Given,
    Source,
    Times,
    array_of,
    arrow_of,
    as_file,
    in_local_time,
    paths_of,
    refuse_own,
    texts_of,
    values_of_result,
)
from accelcal_cli.core.clock import MICROSECONDS, utc_offset_s
from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Chunk, Reader, Recording
from accelcal_cli.core.settings import POSES, PoseSettings, Settings
from accelcal_cli.output import report as reports
from accelcal_cli.output.coefficients import read_coefficients
from accelcal_cli.output.report import ReportInput
from accelcal_cli.pipeline import jobs, outputs, survey
from accelcal_cli.pipeline.activity import EPOCH_S, LONGEST_EPOCH_S
from accelcal_cli.pipeline.calibrate import OwnCalibration, open_run
from accelcal_cli.pipeline.jobs import DEFAULT_CHUNK_SAMPLES, Job, Request, file_stamp
from accelcal_cli.pipeline.options import (
    MOST_DRAWS,
    check_draws,
    chosen_settings,
    field_values,
    fit_settings,
    read_options,
    recipient_settings,
    recording_options,
    with_values,
)
from accelcal_cli.pipeline.windows import fit_frame, fit_points

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """n consecutive rows of a recording.

    Attributes:
        first_sample: number of the first row within the recording.
        time: (n,) datetime64[us], UTC if `Reading.recording.timezone` is known, else the device's clock.
        xyz: (n, 3) raw acceleration [g].
        temperature: (n,) [degrees C], or None.
        gyroscope: (n, 3) [degrees/s], or None.
        validity: (n,) 0 measured, 1 filled by the device, 2 clipped at its range, 3 recovered from damage.
        problems: messages of the problems found in these rows.
        others: (n,) of light, battery and the like, by the names of `Reading.recording.others`; NaN for none.
    """

    first_sample: int
    time: NDArray[np.datetime64]
    xyz: NDArray[np.float64]
    temperature: NDArray[np.float64] | None
    gyroscope: NDArray[np.float64] | None
    validity: NDArray[np.uint8]
    problems: tuple[str, ...]
    others: dict[str, NDArray[np.float32]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.xyz)


class Reading(Answering):
    """An open recording: iterate over it to get its `Samples`, as often as you like; close it, or use `with`.

    Attributes:
        recording: facts from its header: format, device, rate, range, time zone.
    """

    def __init__(self, reader: Reader, chunk_samples: int, given: Given) -> None:
        self.recording: Recording = replace(reader.recording, path=given.job.source)
        self._reader, self._chunk_samples, self._given = reader, chunk_samples, given

    def __iter__(self) -> Iterator[Samples]:
        """Yield all rows in order, in pieces.

        Raises:
            UnreadableError: the recording cannot be read on.
        """
        offset_s, dated = None, True
        self._reader.with_others = bool(self.recording.others)
        with speaking_python():
            for chunk in self._reader.chunks(self._chunk_samples):
                dated &= all(problem.code != "no_start_time" for problem in chunk.problems)
                if len(chunk):
                    time_us = chunk.time_us
                    if offset_s is None:
                        zone = self.recording.timezone if dated else None
                        offset_s = utc_offset_s(zone, int(time_us[0])) or 0
                    yield _samples(chunk, self.recording, time_us - MICROSECONDS * offset_s)

    def to_pandas(self, *, local: bool = False) -> pd.DataFrame:
        """Return all raw values as a data frame, with `time` as index and the columns of the Parquet file.

        Args:
            local: times in the recording's zone instead of UTC, if that is known.
        """
        import pandas as pd

        frame, zone = pd.concat([_frame_of(one) for one in self]).set_index("time"), self.recording.timezone
        if zone is not None and self.recording.start_us is not None:
            frame = in_local_time(frame.tz_localize("UTC"), zone if local else None)
        if (before := self.recording.calibrated) is not None:
            recording = {"path": before.name, "sample_rate_hz": self.recording.rate_hz}
            result = {"outcome": before.outcome, "held_out_mg": before.held_out_mg}
            frame.attrs |= values_of_result(recording, result)
        return frame

    def to_polars(self) -> pl.DataFrame:
        """Return all raw values as a polars data frame, with `time` as its first column."""
        import polars as pl

        return pl.from_pandas(self.to_pandas().reset_index())

    @property
    def _instead(self) -> str:
        return f"it is an open one; give what was opened, {str(self.recording.path)!r}"

    def close(self) -> None:
        """Release the file."""
        self._reader.close()
        self._given.close()

    def __enter__(self) -> Reading:
        return self

    def __exit__(self, *_failure: object) -> None:
        self.close()


def _samples(chunk: Chunk, recording: Recording, time_us: NDArray[np.int64]) -> Samples:
    gyro, scale = chunk.gyro_counts, recording.gyro_dps_per_lsb
    others = () if chunk.others is None else zip(recording.others, chunk.others.T, strict=True)
    return Samples(
        chunk.first_sample,
        time_us.astype("datetime64[us]"),
        chunk.counts / recording.lsb_per_g,
        None if chunk.temperature_mc is None else chunk.temperature_mc / 1000,
        None if gyro is None or scale is None else gyro * np.array(scale),
        np.zeros(len(chunk), np.uint8) if chunk.validity is None else chunk.validity,
        tuple(problem.message for problem in chunk.problems),
        {one.name: column for one, column in others},
    )


def _frame_of(piece: Samples) -> pd.DataFrame:
    import pandas as pd

    columns = {"time": piece.time, **dict(zip("xyz", piece.xyz.T, strict=True)), "validity": piece.validity}
    if piece.temperature is not None:
        columns["temperature"] = piece.temperature
    if piece.gyroscope is not None:
        columns |= dict(zip(("gx", "gy", "gz"), piece.gyroscope.T, strict=True))
    columns |= piece.others
    return pd.DataFrame(columns)


@public
def read(
    source: Source,
    *,
    name: str | None = None,
    serial: str | None = None,
    parts: bool = False,
    chunk_samples: int = DEFAULT_CHUNK_SAMPLES,
    **options: Unpack[ReadingOptions],
) -> Reading:
    """Open a recording of any format.

    Args:
        source: a path, bytes, an open file, an (n, 3) array or a table.
        name, serial, parts: see `calibrate`.
        chunk_samples: approximate number of rows in a piece.
        options: options for reading, as in `calibrate`.

    Raises:
        AccelcalError: it cannot be read.

    Example:
        >>> import accelcal
        >>> with accelcal.read("sample_data/recording.bin") as reading:
        ...     next(iter(reading)).xyz.shape[1]
        3
    """
    given = as_file(source, name, serial)
    wanted = recording_options(given.path, read_options(field_values(options, ReadOptions)))
    return Reading(survey.open_marked(given.path, wanted, joined=parts), chunk_samples, given)


@public
def calibrate(
    source: Source,
    *,
    temperature: ArrayLike | None = None,
    gyroscope: ArrayLike | None = None,
    time: Times | None = None,
    name: str | None = None,
    serial: str | None = None,
    parts: bool = False,
    report_only: bool = False,
    keep_refused: bool = False,
    draws: int = 0,
    **options: Unpack[CalibrationOptions],
) -> Result:
    """Calibrate a recording from its own periods without movement.

    Args:
        source: a path; the content of a file as bytes, or an open file; an (n, 3) array of x, y, z, which
            needs `rate` or `time`; or a table (pandas, polars, pyarrow, xarray, a dictionary of columns)
            with columns x, y, z and time. Anything but a path is written to a temporary file (in TMPDIR).
        temperature: (n,) [degrees C], if `source` is an array.
        gyroscope: (n, 3) [degrees/s], or in `gyro_unit`, if `source` is an array.
        time: (n,) datetime64, or datetimes with or without a zone, if `source` is an array.
        name: of a recording in memory, by which its outputs are called: `P001`. Not for paths.
        serial: serial number of its device, for an array or a table.
        parts: read the files in a folder, a pattern (`S01/*.csv`) or an archive as parts of one recording.
        report_only: skip the second pass over the file; `clipped_samples_after` is then None.
        keep_refused: for `write`: also the raw data of a refused recording, marked as raw.
        draws: for `write`: plausible sets of coefficients, 0 to 100 000, in NAME.draws.json.
        options: for reading and calibrating: `rate` [Hz], `start`, `unit`, `timezone`, `prior`, ...

    Raises:
        AccelcalError: it cannot be read, or the options do not go together. A refusal is a result.
        ValueError: an array has the wrong shape.

    Example:
        >>> import accelcal
        >>> accelcal.calibrate("sample_data/recording.bin").outcome
        'calibrated'
    """
    values = field_values(options, ReadOptions, Settings)
    if gyroscope is not None and values["gyro_unit"] is None:
        values["gyro_unit"] = "deg/s"
    settings, more = chosen_settings(values), {"keep_refused": keep_refused, "draws": draws}
    check_number("draws", draws, 0, MOST_DRAWS, whole=True)
    if draws:
        check_draws(settings)
    request = _request(values, settings, parts=parts, report_only=report_only, **more)
    given = as_file(source, name, serial, temperature=temperature, gyroscope=gyroscope, time=time)
    before = file_stamp(given.path)
    with open_run(given.job, request, source=given.path) as run:
        first_pass = run.result(OwnCalibration(request.recording_settings), logged=True)
        data = run.count_beyond(first_pass.data)
    jobs.check_unchanged(given.path, before)
    return Result(_report(data, "accelcal.calibrate"), data, run.request, first_pass, given, before)


def _request(values: dict[str, Any], settings: Settings, *, parts: bool, **more: Any) -> Request:
    """Return the request for one recording."""
    return Request(read_options(values), settings, parts=parts, joined=parts, **more)


def _report(data: ReportInput, command: str) -> dict[str, Any]:
    return _as_written(outputs.with_provenance(reports.build(data), (command,)))


def _as_written(report: dict[str, Any]) -> dict[str, Any]:
    """Return a report as it would be read from its file."""
    read_again: dict[str, Any] = json.loads(reports.dumps(report, pretty=False))
    return read_again


@public
def inspect(
    source: Source,
    *,
    full: bool = False,
    name: str | None = None,
    serial: str | None = None,
    parts: bool = False,
    **options: Unpack[CalibrationOptions],
) -> dict[str, Any]:
    """Look at a recording and predict the outcome of calibrating it, as `accelcal inspect` does.

    Args:
        source: as in `calibrate`.
        full: read all of it, not just pieces.
        name, serial, parts: see `calibrate`.
        options: those of `calibrate`.

    Returns:
        what `accelcal inspect --json` prints, with `recording`, `file_health`, `values`, `prediction`, ...

    Raises:
        AccelcalError: it cannot be read, or the options do not go together.

    Example:
        >>> import accelcal
        >>> accelcal.inspect("sample_data/recording.bin")["prediction"]["outcome"]
        'calibrated'
    """
    from accelcal_cli.pipeline import inspect as inspection  # few programs do both

    values = field_values(options, ReadOptions, Settings)
    given = as_file(source, name, serial)
    settings = inspection.inspection_settings(values, full=full)
    request = _request(values, settings, parts=parts)
    found = inspection.inspect(given.path, request, full=full)
    return inspection.as_json(replace(found, recording=replace(found.recording, path=given.job.source)))


@public
def fit(points: Source | Result, **options: Unpack[FitOptions]) -> Report:
    """Fit still-window means, as `accelcal fit` does.

    Args:
        points: a path; or a table with columns x, y, z [g] and optionally temperature_c, weight and
            posture; or an array (n, 3) [g]; or a result, whose `windows()` are taken.
        options: for the fit.

    Raises:
        AccelcalError: it is not a table of points but, for example, raw samples, or the options do not go
            together.
        ValueError: an array has another shape.

    Example:
        >>> import accelcal
        >>> result = accelcal.calibrate("sample_data/recording.bin")
        >>> accelcal.fit(result.windows())["calibration"] == result["calibration"]
        True
    """
    settings = fit_settings(field_values(options, Settings))
    if isinstance(points, Result):
        points = points.windows()
    if isinstance(points, str | PathLike):
        report = fit_points(Path(points), settings)
    else:
        report = fit_frame(_points(points), settings)
    return Report(_as_written(outputs.with_provenance(report, ("accelcal.fit",))))


def _points(points: Any) -> pd.DataFrame:
    import pandas as pd

    refuse_own(points)
    if isinstance(points, pd.DataFrame):
        return points
    table = arrow_of(points)
    frame: pd.DataFrame = (
        pd.DataFrame(array_of(points, "points"), columns=list("xyz")) if table is None else table.to_pandas()
    )
    return frame


@public
def from_poses(
    recordings: AnyPath | Sequence[AnyPath],
    *,
    poses: AnyPath | None = None,
    roll: str | Sequence[str] = (),
    **options: Unpack[PoseOptions],
) -> Report:
    """Calibrate from a session of known orientations, as `accelcal six-pose` does.

    Args:
        recordings: the session: a recording, or the folder or the paths of several of one device.
        poses: list of poses; None: the six faces are found.
        roll: where the device was rolled with one axis level, such as `z,80,95`.
        options: for reading and for the fit.

    Raises:
        AccelcalError: it cannot be read, the poses do not determine the parameters, or the options do not go
            together.

    Example:
        >>> import accelcal
        >>> accelcal.from_poses("sample_data/six_faces.csv.gz").calibration.model
        '12'
    """
    # few programs have such a session
    from accelcal_cli.six_pose.run import known_orientations, session_of

    several = paths_of(recordings, 'write it first: frame.to_parquet("session.parquet")')
    source = session_of(several, None if poses is None else Path(poses))
    values = field_values(options, ReadOptions, PoseSettings)
    request = Request(
        options=read_options(values),
        settings=replace(with_values(POSES, values), roll=texts_of(roll)),
        poses=None if poses is None else Path(poses),
        report_only=True,
        parts=True,
    )
    judge, before = known_orientations(request), file_stamp(source)
    with open_run(Job(source, source, source), request) as run:
        data = run.count_beyond(run.result(judge).data)
    jobs.check_unchanged(source, before)
    return Report(_report(data, "accelcal.from_poses"))


@public
def apply(
    report: Report | Mapping[str, Any] | AnyPath,
    xyz: ArrayLike,
    temperature: ArrayLike | None = None,
    *,
    first_sample: int = 0,
) -> NDArray[np.float32]:
    """Calibrate raw values: a = K (v + q v^2 + o + s (T - Tref)).

    Args:
        report: a result or report with a calibration, or the path of one.
        xyz: (n, 3) or (3,) raw acceleration [g].
        temperature: (n,), or one number for all rows [degrees C]; see `Calibration.__call__`.
        first_sample: number of the first row in its recording, for a calibration that follows a change.

    Returns:
        calibrated values [g], in the shape of `xyz`, identical to those in the Parquet file.

    Raises:
        UsageError: there is no calibration, or it needs temperatures.
        ValueError: an array has another shape.
    """
    return Calibration(report)(xyz, temperature, first_sample=first_sample)


@public
def effect(
    source: Source | Result,
    *,
    coefficients: AnyPath | None = None,
    any_device: bool = False,
    epoch: int = EPOCH_S,
    name: str | None = None,
    serial: str | None = None,
    parts: bool = False,
    **options: Unpack[CalibrationOptions],
) -> dict[str, Any]:
    """Compute what calibration changes in a recording's measures of activity, as `calibrate --effect` does.

    Args:
        source: as in `calibrate`; or a result, with the options that it was found with.
        coefficients: a report whose coefficients are applied; None: the recording's own calibration.
        any_device: accept coefficients of any device.
        epoch: length of an epoch [s], 1 to 3600.
        name, serial, parts: see `calibrate`.
        options: those of `calibrate`.

    Returns:
        `recording`, `outcome`, `message` and, as in a report, `effect`, whose `versions`
        have the measures of the raw and the calibrated values (docs/effect.md).

    Raises:
        AccelcalError: it cannot be read, the options do not go together, or the coefficients are not for it.
    """
    from accelcal_cli.activity_effect import effect as measured

    check_number("epoch", epoch, 1, LONGEST_EPOCH_S, whole=True)
    if any_device and coefficients is None:
        raise UsageError("any_device is for coefficients only", hint="omit it")
    if isinstance(source, Result):
        if options or parts or (coefficients, name, serial) != (None, None, None):
            raise UsageError("a result has its own options", hint="give the recording in its place")
        given, request = source._given, source._request
        jobs.check_unchanged(given.path, source._before)
    else:
        values = field_values(options, ReadOptions, Settings)
        settings = chosen_settings(values) if coefficients is None else recipient_settings(values)
        donor = None if coefficients is None else read_coefficients(Path(coefficients))
        request = _request(values, settings, parts=parts, coefficients=donor, any_device=any_device)
        given = as_file(source, name, serial)
    request = replace(request, report_only=True)
    return _as_written(measured(given.job.source, request, int(epoch), source=given.path))
