"""The columns of a study's table, declared once: order, types and meanings, and which of them people read.

`study.parquet` has all of them, and `study.csv` those of `READ`, of which two are made for it from others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

from accelcal_cli.core.calibration import PARAMETER_NAMES
from accelcal_cli.core.settings import LEARNT_PRIORS
from accelcal_cli.output.sections import HoldoutSection, ReportView

AXES = ("x", "y", "z")
PARAMETERS = (
    *PARAMETER_NAMES[:6], *(f"offset_{axis}_g" for axis in AXES),
    *(f"slope_{axis}_g_per_c" for axis in AXES),
)  # fmt: skip
"""Columns of the parameters, in the order of PARAMETER_NAMES."""

GAIN = tuple(f"k_{row}{column}" for row in AXES for column in AXES)

FACTOR_COLUMNS = ("improvement_factor", "improvement_factor_low", "improvement_factor_high")
ERROR_COLUMNS = (
    "calibration_error_mg",
    "calibration_error_low_mg",
    "calibration_error_high_mg",
    "calibration_error_worst_mg",
    "calibration_error_before_mg",
    "probability_better",
)
"""Columns that hold a report's `calibration_error_mg`, and how probably that is lower than before."""

READ = (
    "path", "use", "why", "calibration_error_mg", "calibration_error_low_mg", "calibration_error_high_mg",
    "calibration_error_before_mg", "probability_better", "wear_hours", "start_time", "duration_hours",
    "device_serial", "device_model", "outcome", "decided_by", "decided_at", "note",
    "reason", "cautions", "message", "copy_of", "learnt_from", "model", "orientations", "before_mg",
    "after_mg", "change", "change_at", "change_mg", "misfits", "filled_percent", "lost_percent", "gaps",
    "rate_hz", "time_zone", "format", "sensor", "enmo_raw_mg", "enmo_mg", "mvpa_raw_min", "mvpa_min",
    "parquet", "report", "accelcal_version", "result",
)  # fmt: skip
"""Columns of `study.csv`, in its order: first those to decide by."""

OF_CSV = {
    "duration_hours": "length [hours]",
    "learnt_from": "the recording, pool or kind of prior that its coefficients come from, besides itself",
}
"""Columns that `study.csv` alone has."""


@dataclass(frozen=True, slots=True)
class Column:
    """A column: its name, what its values mean, and their kind; they may be empty."""

    name: str
    meaning: str
    kind: Literal["text", "whole", "number"]


_text, _whole = partial(Column, kind="text"), partial(Column, kind="whole")
_number = partial(Column, kind="number")

ALL = (
    _text("path", "the recording, relative to the study's folder"),
    _text("use", "yes, with care, or no"),
    _text("why", "why not, or why with care"),
    _number("calibration_error_mg", "calibration error over all orientations [mg]"),
    _number("calibration_error_low_mg", "lower end of its 95 % interval"),
    _number("calibration_error_high_mg", "upper end of its 95 % interval"),
    _number("calibration_error_worst_mg", "the same error in the worst direction"),
    _number("calibration_error_before_mg", "error over all orientations before calibration [mg]"),
    _number("probability_better", "probability that the calibrated data are better than the raw data"),
    _number("wear_hours", "hours in which the device was worn"),
    _text("start_time", "time of the first sample by the device clock"),
    _number("duration_s", "length [s]"),
    _text("device_serial", "serial number of the device"),
    _text("device_model", "model of the device"),
    _text("device_firmware", "version of its firmware"),
    _text("outcome", "calibrated, provisional, reduced_model, already_good, borrowed, refused or failed"),
    _text("decided_by", "the person who decided on its use"),
    _text("decided_at", "when that was decided"),
    _text("note", "remark of that person"),
    _whole("exit_code", "exit code that `calibrate` would have"),
    _text("reason", "code of the reason for the outcome"),
    _text("cautions", "codes of all cautions"),
    _text("message", "the reason in sentences"),
    _text("copy_of", "the recording with the same bytes that counts"),
    _text("borrowed_from", "the recording whose coefficients are used"),
    _text("pool", "report of the pool"),
    _whole("pool_recordings", "number of recordings in the pool"),
    _number("windows_before_mg", "error of its own still windows before the pool's coefficients [mg]"),
    _number("windows_after_mg", "the same after them [mg]"),
    _text("own_outcome", "outcome of its own calibration, where another one took its place"),
    _text("own_message", "reason of its own calibration"),
    _number("own_after_mg", "held-out error of its own calibration [mg]"),
    _text("prior", "prior that was used"),
    _text("model", "model that was fitted"),
    _whole("orientations", "number of orientations that were held out"),
    _whole("points", "number of points that were held out"),
    _number("before_mg", "|r - 1| of held-out orientations before calibration [mg]"),
    _number("after_mg", "the same after calibration [mg]"),
    _number("ci95_low_mg", "lower end of the 95 % interval of after_mg"),
    _number("ci95_high_mg", "upper end of the 95 % interval of after_mg"),
    _number("improvement_percent", "error before in percent of the error after, so that 100 means no change"),
    _number("improvement_factor", "how many times smaller the held-out error became"),
    _number("improvement_factor_low", "lower end of its 95 % interval"),
    _number("improvement_factor_high", "upper end of its 95 % interval"),
    _text("change", "change of the sensor during the recording"),
    _text("change_at", "when it changed"),
    _number("change_mg", "size of the change [mg]"),
    _text("misfits", "sensor errors outside the model that were found"),
    _text("gyroscope", "outcome of the gyroscope's calibration"),
    _number("gyro_before_deg", "error of gravity's direction after held-out turns, raw [degrees]"),
    _number("gyro_after_deg", "the same, calibrated [degrees]"),
    _whole("gyro_pairs", "number of turns"),
    _number("enmo_raw_mg", "mean ENMO of the raw values [mg]"),
    _number("enmo_mg", "mean ENMO of the calibrated values [mg]"),
    _number("enmo_low_mg", "lower end of the 95 % interval of enmo_mg"),
    _number("enmo_high_mg", "upper end of the 95 % interval of enmo_mg"),
    _number("enmo_differs_mg", "mean difference of ENMO by epoch [mg]"),
    _number("mad_mg", "mean MAD, calibrated [mg]"),
    _number("mad_low_mg", "lower end of the 95 % interval of mad_mg"),
    _number("mad_high_mg", "upper end of the 95 % interval of mad_mg"),
    _number("mvpa_raw_min", "minutes of moderate to vigorous activity, raw"),
    _number("mvpa_min", "the same, calibrated"),
    _number("mvpa_low_min", "lower end of the 95 % interval of mvpa_min"),
    _number("mvpa_high_min", "upper end of the 95 % interval of mvpa_min"),
    _number("inactive_raw_min", "minutes of inactivity, raw"),
    _number("inactive_min", "the same, calibrated"),
    _text("format", "format of the file"),
    _text("time_zone", "what `time` in the Parquet file is in: UTC or unknown"),
    _number("rate_hz", "sampling rate [Hz]"),
    _number("rate_hz_measured", "sampling rate by the time stamps [Hz]"),
    _number("lsb_per_g", "counts per g"),
    _number("range_g", "range of the sensor [g]"),
    _whole("samples", "number of samples"),
    _whole("gaps", "number of gaps"),
    _whole("filled_samples", "samples that the device filled"),
    _number("filled_percent", "share of samples that the device filled without measuring [%]"),
    _whole("clipped_samples_before", "raw samples at the end of the range"),
    _whole("clipped_samples_after", "calibrated samples beyond the range"),
    _whole("problems", "number of problems found in the file"),
    _number("lost_percent", "share of the file that is damaged or missing [%]"),
    _whole("cells", "number of points of the fit"),
    _number("condition_number", "condition number of the fit"),
    *(_number(f"min_{axis}_g", f"lowest point on {axis} [g]") for axis in AXES),
    *(_number(f"max_{axis}_g", f"highest point on {axis} [g]") for axis in AXES),
    *(_number(name, "entry of the gain matrix") for name in GAIN),
    *(_number(f"offset_{axis}_g", f"offset of {axis} [g]") for axis in AXES),
    *(_number(f"slope_{axis}_g_per_c", f"slope of the offset of {axis} [g per degree C]") for axis in AXES),
    _number("reference_c", "temperature at which the offsets hold [degrees C]"),
    *(_number(f"se_{name}", f"standard error of {name}") for name in PARAMETERS),
    _whole("bytes", "size of the file"),
    _text("sha256", "SHA-256 of the file"),
    _text("sensor", "the value of `--sensor`, if the file holds several recordings"),
    _text("accelcal_version", "version that made the result"),
    _text("parquet", "file of the calibrated values"),
    _text("report", "file of the report"),
    _text("result", "name of the result, by which a decision knows it"),
)
"""Columns of `study.parquet`, and of a row wherever one is kept."""

NAMES = tuple(column.name for column in ALL)
"""Their names, in order."""


def read_by_people(row: Mapping[str, Any]) -> list[Any]:
    """Return the cells of a row in `study.csv`."""
    seconds, prior = row.get("duration_s"), row.get("prior")
    learnt = prior if prior in LEARNT_PRIORS else None
    made = {
        "duration_hours": None if seconds is None else round(seconds / 3600, 2),
        "learnt_from": row.get("borrowed_from") or row.get("pool") or learnt,
    }
    return [made[name] if name in made else row.get(name) for name in READ]


def meaning_of(name: str) -> str:
    """Return what a column of either table means; raises KeyError for another name."""
    return OF_CSV.get(name) or {column.name: column.meaning for column in ALL}[name]


def factor_columns(holdout: HoldoutSection) -> dict[str, float | None]:
    """Return the columns that say how many times smaller the held-out error is."""
    factor = holdout.improvement_factor
    if factor is None:
        return dict.fromkeys(FACTOR_COLUMNS)
    low, high = factor.ci95 or (None, None)
    return dict(zip(FACTOR_COLUMNS, (factor.value, low, high), strict=True))


def error_columns(report: ReportView) -> dict[str, float | None]:
    """Return the columns that hold the error over all orientations; empty ones without a calibration."""
    error, probability = report.calibration_error_mg, report.probability
    if error is None or report.calibration is None:
        return dict.fromkeys(ERROR_COLUMNS)
    better = None if probability is None else probability.better_than_raw
    values = (error.mean, *error.ci95, error.worst_direction, error.before, better)
    return dict(zip(ERROR_COLUMNS, values, strict=True))
