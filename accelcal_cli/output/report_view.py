"""A report as typed, frozen records, for all who read one: pages, tables, the terminal, other commands.

Fields have the names of the report's keys; docs/outputs.md says what each of them means. A field with a
default is one that reports of some kinds lack.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, is_dataclass
from functools import cache
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from accelcal_cli.core.reasons import Reason
from accelcal_cli.core.recording import Device
from accelcal_cli.core.results import ErrorSummary, Outcome

FACTOR_COLUMNS = ("improvement_factor", "improvement_factor_low", "improvement_factor_high")
ERROR_COLUMNS = (
    "calibration_error_mg",
    "calibration_error_low_mg",
    "calibration_error_high_mg",
    "calibration_error_worst_mg",
    "calibration_error_before_mg",
)
"""Columns of tables that hold a report's `calibration_error_mg`."""

Record = TypeVar("Record")


@dataclass(frozen=True, slots=True)
class ReportRecording:
    """`recording`, in the order of its keys; by default that of no samples."""

    path: str
    sha256: str
    bytes: int
    format: str
    device: Device = field(default_factory=Device)
    sample_rate_hz: float | None = None
    lsb_per_g: float | None = None
    range_g: float | None = None
    start_time: str | None = None
    timezone: str | None = None
    time_zone: str | None = None
    samples: int = 0
    duration_s: float | None = None
    gaps: Sequence[Mapping[str, Any]] = ()
    gaps_omitted: int = 0
    notes: Sequence[str] = ()
    thermometer: Mapping[str, float] | None = None
    factory_calibration: Mapping[str, Any] | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the object; the last two are keys only where there is something to say."""
        keys = asdict(self) | {"gaps": list(self.gaps), "notes": list(self.notes)}
        for name in ("thermometer", "factory_calibration"):
            if keys[name] is None:
                del keys[name]
        return keys

    @property
    def all_gaps(self) -> int:
        """Number of gaps, those that are not listed included."""
        return len(self.gaps) + self.gaps_omitted


@dataclass(frozen=True, slots=True)
class TemperatureView:
    """`calibration.temperature`: change of the offsets with temperature."""

    slope_g_per_c: Sequence[float]
    reference_c: float


@dataclass(frozen=True, slots=True)
class CalibrationView:
    """`calibration`: numbers for people; `output/coefficients.py` reads the exact ones."""

    model: str
    gain: Sequence[Sequence[float]]
    offset_g: Sequence[float]
    parameters: Mapping[str, float]
    temperature: TemperatureView | None
    optimizer: Mapping[str, Any]
    gravity: Mapping[str, Any]
    course: Mapping[str, Any] | None
    standard_errors: Mapping[str, float] | None


@dataclass(frozen=True, slots=True)
class CalibrationErrorView:
    """`calibration_error_mg`: expected error over all orientations [mg]."""

    mean: float
    ci95: Sequence[float]
    worst_direction: float
    before: float
    worst_direction_at: Sequence[float]


@dataclass(frozen=True, slots=True)
class FactorView:
    """`holdout.improvement_factor`: error before over error after."""

    value: float
    ci95: Sequence[float] | None


@dataclass(frozen=True, slots=True)
class HoldoutView:
    """`holdout`: errors on postures that took no part in the fit [mg]."""

    method: str
    points: int
    postures: int
    before_mg: ErrorSummary
    after_mg: ErrorSummary
    improvement_percent: float | None
    ci95_mg: Sequence[float]
    improvement_factor: FactorView | None = None


@dataclass(frozen=True, slots=True)
class FitView:
    """`fit`: numbers of windows by fate."""

    windows: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class SaturatedAxis:
    """An entry of `coverage.saturated`."""

    axis: str
    at_g: float


@dataclass(frozen=True, slots=True)
class CoverageView:
    """`coverage`: where on the sphere the points lie."""

    subsets: Sequence[Sequence[int]]
    axis_min_g: Sequence[float]
    axis_max_g: Sequence[float]
    cells: int
    condition_number: float | None
    distinct_orientations: int | None = None
    saturated: tuple[SaturatedAxis, ...] = ()


@dataclass(frozen=True, slots=True)
class TrialView:
    """An entry of `models_tried`."""

    model: str
    after_mg: float | None
    reason: str | None
    values: Mapping[str, Any]
    prior: str | None = None


@dataclass(frozen=True, slots=True)
class ChangeView:
    """`change`: whether the sensor changed while it recorded."""

    kind: str
    unchecked: str | None
    at: str | None
    size_mg: float | None
    holdout: Mapping[str, Any] | None


@dataclass(frozen=True, slots=True)
class MisfitView:
    """An entry of `misfits`: something that the parameters do not describe, looked for."""

    kind: str
    found: bool
    unit: str
    size: Sequence[float]
    before_mg: float
    after_mg: float
    largest_mg: float


@dataclass(frozen=True, slots=True)
class ProblemView:
    """An entry of `file_health.problems`."""

    code: str
    message: str
    byte_offset: int | None
    count: int


@dataclass(frozen=True, slots=True)
class ClockView:
    """`file_health.clock`."""

    gap_seconds: float | None
    drift_s_per_day: float | None


@dataclass(frozen=True, slots=True)
class RestView:
    """`file_health.rest`: |a| of still windows."""

    median_g: float


@dataclass(frozen=True, slots=True)
class HealthView:
    """`file_health`: the state of the file.

    Attributes:
        missing_bytes: None for a file that is cut short by an unknown amount.
    """

    problems: tuple[ProblemView, ...]
    filled_samples: int
    clipped_samples_before: int
    clipped_samples_after: int | None
    rate_hz_measured: float | None
    lost_bytes: int
    lost_percent: float
    missing_bytes: int | None
    clock: ClockView | None
    rest: RestView | None = None


@dataclass(frozen=True, slots=True)
class PoseView:
    """An entry of `poses`."""

    face: str | None
    start_s: float
    end_s: float
    reference_g: Sequence[float]
    raw_mg: float
    residual_mg: float | None
    held_out_mg: float | None
    repeat_mg: float | None
    file: str | None = None


@dataclass(frozen=True, slots=True)
class LevelView:
    """Mean and standard deviation of a level axis [mg]."""

    mean: float
    sd: float


@dataclass(frozen=True, slots=True)
class LevelPair:
    """A level axis before and after calibration; after: None without one."""

    before: LevelView
    after: LevelView | None


@dataclass(frozen=True, slots=True)
class RollView:
    """An entry of `known_orientations.rolls`."""

    axis: str
    start_s: float
    end_s: float
    level_mg: LevelPair
    file: str | None = None


@dataclass(frozen=True, slots=True)
class ErrorPair:
    """Errors before and after calibration [mg]."""

    before: ErrorSummary
    after: ErrorSummary


@dataclass(frozen=True, slots=True)
class KnownOrientationsView:
    """`known_orientations`; unchecked: why nothing was held out, None where something was."""

    orientations: int
    holdout_vector_mg: ErrorPair | None
    unchecked: str | None = None
    rolls: tuple[RollView, ...] = ()


@dataclass(frozen=True, slots=True)
class TurnErrors:
    """`gyroscope.holdout_deg`: error of the direction of gravity after turns that took no part [degrees]."""

    before: float
    after: float
    ci95: Sequence[float]


@dataclass(frozen=True, slots=True)
class RestingRates:
    """`gyroscope.rest`: angular rates of a device at rest [degrees/s]."""

    raw_dps: float
    constant_dps: float | None
    slope_dps: float | None


@dataclass(frozen=True, slots=True)
class GyroscopeSlope:
    """`gyroscope.temperature`."""

    slope_dps_per_c: Sequence[float]


@dataclass(frozen=True, slots=True)
class GyroscopeErrors:
    """`gyroscope.standard_errors`."""

    scale: Sequence[Sequence[float]] | None
    bias_dps: Sequence[float] | None


@dataclass(frozen=True, slots=True)
class GyroscopeView:
    """`gyroscope`."""

    outcome: str
    message: str
    equation: str
    scale: Sequence[Sequence[float]] | None
    bias_dps: Sequence[float] | None
    temperature: GyroscopeSlope | None
    standard_errors: GyroscopeErrors
    pairs: int
    holdout_deg: TurnErrors | None
    rest: RestingRates | None


@dataclass(frozen=True, slots=True)
class PoolMember:
    """An entry of `pool.recordings`."""

    path: str
    sha256: str


@dataclass(frozen=True, slots=True)
class LeftOutMember:
    """An entry of `pool.left_out`."""

    path: str
    sha256: str
    reason: str
    values: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class OwnWindows:
    """`pool.own_windows`: errors of a member's own windows [mg]."""

    before_mg: ErrorSummary
    after_mg: ErrorSummary


@dataclass(frozen=True, slots=True)
class PoolView:
    """`pool`; path, sha256 and own_windows: in the report of a member."""

    serial: str
    recordings: tuple[PoolMember, ...]
    left_out: tuple[LeftOutMember, ...]
    path: str = ""
    sha256: str | None = None
    own_windows: OwnWindows | None = None


@dataclass(frozen=True, slots=True)
class AppliedView:
    """`coefficients`: the report whose coefficients were applied, and the recording that they come from."""

    path: str
    sha256: str
    recording_path: str
    recording_sha256: str
    device: Device
    accelcal_version: str
    without_provenance: bool = False


@dataclass(frozen=True, slots=True)
class ErrorsView:
    """Sections with the errors to quote, of a report or of its `without_misalignment`."""

    holdout: HoldoutView | None = None
    calibration_error_mg: CalibrationErrorView | None = None


@dataclass(frozen=True, slots=True)
class ProvenanceView:
    """`provenance`: who made the report, when and with what."""

    command: Sequence[str] = ()
    versions: Mapping[str, str] = field(default_factory=dict)
    time: str | None = None
    host: str | None = None
    platform: str | None = None


@dataclass(frozen=True, slots=True)
class ReportView:
    """A report of any kind: whole and valid, as checked against the schema or built by this version."""

    accelcal_version: str
    recording: ReportRecording
    settings: Mapping[str, Any]
    outcome: Outcome
    message: str
    calibration: CalibrationView | None
    holdout: HoldoutView | None
    fit: FitView
    coverage: CoverageView
    models_tried: tuple[TrialView, ...]
    file_health: HealthView
    reason: str
    values: Mapping[str, Any]
    notes: tuple[Reason, ...]
    cautions: tuple[Reason, ...]
    advice: tuple[Reason, ...]
    calibration_error_mg: CalibrationErrorView | None
    rest_scatter_mg: float | None
    change: ChangeView | None
    misfits: tuple[MisfitView, ...] | None
    poses: tuple[PoseView, ...] | None = None
    known_orientations: KnownOrientationsView | None = None
    gyroscope: GyroscopeView | None = None
    pool: PoolView | None = None
    effect: Mapping[str, Any] | None = None
    provenance: ProvenanceView = ProvenanceView()

    def setting(self, name: str, default: float) -> float:
        """Return a number among the settings; the default where the report has none."""
        value = self.settings.get(name, default)
        return float(value) if type(value) in (int, float) else default


def report_view(report: Mapping[str, Any]) -> ReportView:
    """Make the typed view of a report."""
    return record(ReportView, report)


def factor_columns(holdout: HoldoutView) -> dict[str, float | None]:
    """Return the columns of tables that say how many times smaller the held-out error is."""
    factor = holdout.improvement_factor
    if factor is None:
        return dict.fromkeys(FACTOR_COLUMNS)
    low, high = factor.ci95 or (None, None)
    return dict(zip(FACTOR_COLUMNS, (factor.value, low, high), strict=True))


def error_columns(error: CalibrationErrorView | None) -> dict[str, float | None]:
    """Return the columns of tables that hold the error over all orientations."""
    if error is None:
        return dict.fromkeys(ERROR_COLUMNS)
    values = (error.mean, *error.ci95, error.worst_direction, error.before)
    return dict(zip(ERROR_COLUMNS, values, strict=True))


def record(kind: Callable[..., Record], section: Mapping[str, Any]) -> Record:
    """Make a record from an object of a report by the names of its fields; further keys are passed over."""
    return kind(**{name: read(section[name]) for name, read in _readers(kind) if name in section})


@cache
def _readers(kind: Any) -> tuple[tuple[str, Callable[[Any], Any]], ...]:
    return tuple((name, _reader(hint)) for name, hint in get_type_hints(kind).items())


def _reader(hint: Any) -> Callable[[Any], Any]:
    """Return what reads a field of a type: a record, a tuple of records, or the value as it is."""
    parts = [hint, *get_args(hint), *(one for part in get_args(hint) for one in get_args(part))]
    kind: Any = next((one for one in parts if is_dataclass(one)), None)
    if hint is Outcome:
        return Outcome
    if kind is None:
        return lambda value: value
    if any(get_origin(part) is tuple for part in parts):
        return lambda values: None if values is None else tuple(record(kind, one) for one in values)
    return lambda value: None if value is None else record(kind, value)
