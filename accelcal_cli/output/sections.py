"""The report, declared once: its sections as records, of which its JSON, schema and documentation are made.

`core/declared.py` writes, reads, checks and describes them. A section that only some reports have is at the
end of `Report`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

from accelcal_cli.core.arithmetic import FRACTION_BITS
from accelcal_cli.core.declared import SHA256, Key, from_json
from accelcal_cli.core.errors import Reason
from accelcal_cli.core.gyroscope import TurnHoldout
from accelcal_cli.core.identity import REPORT, SCHEMA_VERSION
from accelcal_cli.core.points import Operations
from accelcal_cli.core.recording import Device, FactoryCalibration, ThermometerWord
from accelcal_cli.core.results import ErrorSummary, Misfit, Outcome, TimeHoldout, UncertaintyPart

Pair = tuple[float, float]
Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]
Integers = tuple[int, int, int]

NO_DEVICE = Device()
SETTINGS = (
    *("profile", "optimizer", "model", "temperature", "stillness", "segment_seconds"),
    *("stillness_threshold_g", "report_only", "input"),
)
"""Settings that reports of all kinds state."""

EQUATION = "a = K (v + q v^2 + o + s (T - Tref))"


def vector(values: Iterable[float]) -> Vector:
    """Return three numbers, of x, y and z."""
    x, y, z = map(float, values)
    return x, y, z


def matrix(rows: Iterable[Iterable[float]]) -> Matrix:
    """Return three rows of three numbers."""
    x, y, z = map(vector, rows)
    return x, y, z


BELOW = {
    **{f"k_{axis}{axis}": f"Scale of {axis}" for axis in "xyz"},
    **{
        f"k_{row}{column}": f"Misalignment: factor of {column} in {row}" for row, column in ("yx", "zx", "zy")
    },
    **{f"o{axis}": f"Offset of {axis} [g]" for axis in "xyz"},
}
SLOPES = {f"s{axis}": f"Change of the offset of {axis} with temperature [g per degree C]" for axis in "xyz"}
ABOVE = {
    f"k_{row}{column}": f"Misalignment: factor of {column} in {row}" for row, column in ("xy", "xz", "yz")
}
COEFFICIENTS, PRIOR_PARAMETERS, ALL_PARAMETERS = BELOW | ABOVE, BELOW | SLOPES, BELOW | SLOPES | ABOVE
"""Parameters of the model; those above the diagonal of K only where there are any."""

FIGURES = {
    "enmo_mg": "Mean ENMO [mg]",
    "mad_mg": "Mean MAD [mg]",
    "mvpa_min": "Minutes of moderate to vigorous activity",
    "pim_mg_s": "Mean PIM [mg s]",
    "zcm": "Mean zero-crossing count",
    "angle_deg": "Mean angle of the arm [degrees]",
}
"""Measures of activity that have an interval."""

VERSIONS = {
    "raw": "Raw values",
    "calibrated": "Calibrated values",
    "without_misalignment": "Values calibrated without misalignment",
}


@dataclass(frozen=True, slots=True)
class Gap:
    """`recording.gaps`."""

    sample: Annotated[int, Key("Index of the first sample after the gap")]
    start_time: Annotated[str | None, Key("Time of that sample")]
    seconds: Annotated[float, Key("Length of the gap", "s", digits=6)]


@dataclass(frozen=True, slots=True)
class RecordingSection:
    """`recording`."""

    path: Annotated[str, Key("Name of the recording's file")]
    sha256: Annotated[str, Key("SHA-256 of its content", pattern=SHA256)]
    bytes: Annotated[int, Key("Size of the file", least=0)]
    format: Annotated[str, Key("Format of the file")]
    device: Annotated[Device, Key("The device, as far as the file names it")] = NO_DEVICE
    sample_rate_hz: Annotated[
        float | None, Key("Sampling rate [Hz], from the file or measured", positive=True)
    ] = None
    lsb_per_g: Annotated[float | None, Key("Counts per g; null if values are in g", positive=True)] = None
    range_g: Annotated[
        float | None, Key("Range of the sensor [g]: values lie within plus and minus this; null if not known")
    ] = None
    start_time: Annotated[str | None, Key("Time of the first sample by the device clock")] = None
    timezone: Annotated[str | None, Key("Time zone of the device clock; null if not known")] = None
    time_zone: Annotated[
        str | None, Key("What `time` in the calibrated file is in: UTC or unknown", words=("UTC", "unknown"))
    ] = None
    samples: Annotated[int, Key("Number of samples", least=0)] = 0
    duration_s: Annotated[float | None, Key("Length", "s", least=0, digits=6)] = None
    gaps: Annotated[tuple[Gap, ...], Key("Gaps, the first of them one by one")] = ()
    gaps_omitted: Annotated[int, Key("Number of gaps that are not listed")] = 0
    notes: Annotated[Sequence[str], Key("Remarks of the reader")] = ()
    thermometer: Annotated[
        ThermometerWord | None,
        Key(
            "Only where the reader makes degrees C of raw words (.cwa): celsius_per_count word + "
            "celsius_at_zero",
            absent=True,
        ),
    ] = None
    factory_calibration: Annotated[
        FactoryCalibration | None,
        Key(
            "Only where the reader applied the maker's calibration first: its numbers (docs/gt3x-files.md)",
            absent=True,
        ),
    ] = None

    @property
    def all_gaps(self) -> int:
        """Number of gaps, those that are not listed included."""
        return len(self.gaps) + self.gaps_omitted


@dataclass(frozen=True, slots=True)
class Slopes:
    """`calibration.temperature`."""

    slope_g_per_c: Annotated[
        Vector, Key("Change of the offsets with temperature [g per degree C], x, y and z")
    ]
    reference_c: Annotated[float, Key("Temperature at which the offsets hold", "degrees C")]


@dataclass(frozen=True, slots=True)
class IntegerKnot:
    """`calibration.course.knots.fixed_point`."""

    stretch: Annotated[Integers, Key("Factors as integers")]
    shift: Annotated[Integers, Key("Shifts as integers")]


@dataclass(frozen=True, slots=True)
class Knot:
    """`calibration.course.knots`."""

    sample: Annotated[int, Key("Index of the sample", least=0)]
    stretch: Annotated[Vector, Key("Factors of the axes from here on")]
    shift_g: Annotated[Vector, Key("Shifts of the axes from here on", "g")]
    fixed_point: Annotated[IntegerKnot, Key("The same as integers")]


@dataclass(frozen=True, slots=True)
class Course:
    """`calibration.course`."""

    between: Annotated[str, Key("How it goes between knots", words=("jumps", "lines"))]
    knots: Annotated[tuple[Knot, ...], Key("Times at which the sensor changed", fewest=1)]


@dataclass(frozen=True, slots=True)
class FixedPoint:
    """`calibration.fixed_point`."""

    fraction_bits: Annotated[
        int, Key("Number of bits after the point: divide the integers by 2 to this power", only=FRACTION_BITS)
    ]
    parameters: Annotated[
        Mapping[str, int], Key("The parameters as integers", entries=ALL_PARAMETERS, needed=12)
    ]
    temperature_reference_mc: Annotated[int | None, Key("Reference temperature", "thousandths of a degree C")]
    temperature_span_c: Annotated[
        float | None, Key("Temperature span that one unit of a slope refers to", "degrees C")
    ]
    bend: Annotated[tuple[int, int, int], Key("q as integers")]


@dataclass(frozen=True, slots=True)
class OptimizerUse:
    """`calibration.optimizer`."""

    name: Annotated[str, Key("Name")]
    arithmetic: Annotated[str, Key("Kind of numbers: integer or float", words=("integer", "float"))]
    settings: Annotated[Mapping[str, Any], Key("Its settings")]
    iterations: Annotated[int, Key("Number of steps")]
    stop: Annotated[str, Key("Why it ended")]
    converged: Annotated[bool | None, Key("True if it reached the minimum")]
    operations: Annotated[Operations, Key("Number of operations, where they were counted")]
    predicted_seconds: Annotated[
        Mapping[str, float] | None,
        Key("Time that a microcontroller would need", "s", positive=True, significant=True),
    ]


@dataclass(frozen=True, slots=True)
class GravitySection:
    """`calibration.gravity`."""

    local_g: Annotated[float, Key("Gravity at the place of the recording, in standard g")]
    latitude: Annotated[float | None, Key("Latitude that was given")]
    altitude: Annotated[float | None, Key("Altitude that was given", "m")]


@dataclass(frozen=True, slots=True)
class BendSection:
    """`calibration.bend`."""

    quadratic: Annotated[
        Vector, Key("q of x, y and z: v + q v^2 takes the place of v, axis by axis", "per g")
    ]


@dataclass(frozen=True, slots=True)
class Coefficients:
    """`without_misalignment.calibration`."""

    model: Annotated[
        str,
        Key(
            "Model: number of parameters, with T for temperature slopes",
            words=("0", "3", "6", "9", "3T", "6T", "9T", "12"),
        ),
    ]
    gain: Annotated[Matrix, Key("K, row by row: scale on the diagonal, misalignment next to it")]
    offset_g: Annotated[Vector, Key("o: offsets of x, y and z", "g")]
    parameters: Annotated[
        Mapping[str, float],
        Key(
            "k_RC is the entry of K in row R and column C of the equation: k_yx multiplies x in "
            "the equation of y. Farago et al. (2024), and schema version 1, write kxy for k_yx, "
            "kxz for k_zx, kyz for k_zy",
            entries=COEFFICIENTS,
            needed=9,
        ),
    ]
    bend: Annotated[BendSection | None, Key("Bend of the response; null where none was fitted")]
    temperature: Annotated[Slopes | None, Key("s and Tref; null without temperature slopes")]
    course: Annotated[
        Course | None,
        Key("How the coefficients follow a sensor that changed; null for nearly all recordings"),
    ]
    equation: Annotated[str, Key("The model as an equation", only=EQUATION)]
    fixed_point: Annotated[FixedPoint, Key("The optimizer's integers, from which all other numbers follow")]
    gravity: Annotated[GravitySection, Key("Local gravity")]


@dataclass(frozen=True, slots=True)
class CalibrationSection(Coefficients):
    """`calibration`."""

    standard_errors: Annotated[
        Mapping[str, float] | None,
        Key("Standard error of each parameter", entries=ALL_PARAMETERS, needed=9, significant=True),
    ]
    covariance: Annotated[
        tuple[tuple[float, ...], ...] | None,
        Key(
            "Covariance of the parameters, in the order of `standard_errors`, then of the bend; null "
            "without a posterior",
            significant=True,
        ),
    ]
    optimizer: Annotated[OptimizerUse, Key("The optimizer, and how it ended")]


@dataclass(frozen=True, slots=True)
class CalibrationError:
    """`calibration_error_mg`."""

    mean: Annotated[float, Key("Mean over all orientations", "mg", significant=True)]
    ci95: Annotated[Pair, Key("95 % interval of the mean", "mg", significant=True)]
    worst_direction: Annotated[
        float, Key("Error in the orientation where it is largest", "mg", significant=True)
    ]
    worst_direction_at: Annotated[Vector, Key("That orientation, as a unit vector", digits=4)]
    before: Annotated[float, Key("The same mean for the raw data", "mg", significant=True)]


@dataclass(frozen=True, slots=True)
class Probability:
    """`probability`."""

    better_than_raw: Annotated[
        float,
        Key(
            "That the error is lower than that of the raw data, over all orientations and in those that "
            "were recorded",
            digits=3,
        ),
    ]
    below_limit: Annotated[float, Key("That the error over all orientations is within the limit", digits=3)]


@dataclass(frozen=True, slots=True)
class Factor:
    """`without_misalignment.holdout.improvement_factor`."""

    value: Annotated[float, Key("Ratio of the errors before and after", least=0, significant=True)]
    ci95: Annotated[Pair | None, Key("Its 95 % interval", least=0, significant=True)]


@dataclass(frozen=True, slots=True)
class HoldoutSection:
    """`holdout`."""

    method: Annotated[str, Key("Name of the method")]
    points: Annotated[int, Key("Number of points")]
    postures: Annotated[int, Key("Number of orientations")]
    before_mg: Annotated[ErrorSummary, Key("Error of the raw data", "mg")]
    after_mg: Annotated[ErrorSummary, Key("Error after calibration", "mg")]
    improvement_percent: Annotated[
        float | None, Key("By how much the error became smaller, in percent of the error after", digits=1)
    ]
    ci95_mg: Annotated[Pair, Key("95 % interval of the mean error after calibration", "mg", digits=4)]
    improvement_factor: Annotated[Factor | None, Key("How many times smaller the error became")] = None


@dataclass(frozen=True, slots=True)
class WithoutMisalignmentSection:
    """`without_misalignment`."""

    calibration: Annotated[Coefficients, Key("Its coefficients")]
    calibration_error_mg: Annotated[CalibrationError | None, Key("Its error over all orientations", "mg")]
    holdout: Annotated[HoldoutSection | None, Key("Its error on held-out orientations")]


@dataclass(frozen=True, slots=True)
class ChangeSection:
    """`change`."""

    kind: Annotated[
        str,
        Key(
            "Kind of change: none, step or drift of some parameters",
            words=("none", "drift", "step", "gain", "device", "walk"),
        ),
    ]
    unchecked: Annotated[str | None, Key("Code of the reason why it was not looked for")]
    probability: Annotated[
        float | None, Key("Probability of a change, beyond what the calibration follows", digits=3)
    ]
    at: Annotated[str | None, Key("When it happened, or most probably did")]
    size_mg: Annotated[float | None, Key("Its size over all orientations", "mg", significant=True)]
    offset_mg: Annotated[Vector | None, Key("Change of the offsets", "mg", significant=True)]
    scale_percent: Annotated[Vector | None, Key("Change of the scales", "%", significant=True)]
    holdout: Annotated[TimeHoldout | None, Key("Errors on stretches of time that were held out")]


@dataclass(frozen=True, slots=True)
class WindowUse:
    """`fit.windows`: all but `complete` add up to it.

    Where still windows that agree are joined, the joint one counts once, by its use, and the others as
    `joined`.
    """

    complete: Annotated[int, Key("All complete windows", least=0)]
    moving: Annotated[int, Key("Windows with movement", least=0)] = 0
    filled: Annotated[int, Key("Windows with filled samples", least=0)] = 0
    clipped: Annotated[int, Key("Windows with clipped samples", least=0)] = 0
    recovered: Annotated[int, Key("Windows from damaged blocks", least=0)] = 0
    joined: Annotated[int, Key("Windows that were joined to the one before", least=0)] = 0
    repeated: Annotated[int, Key("Windows that repeat earlier ones exactly", least=0)] = 0
    implausible: Annotated[int, Key("Windows that are not near 1 g", least=0)] = 0
    constant_left_out: Annotated[int, Key("Windows that never change", least=0)] = 0
    temperature_left_out: Annotated[int, Key("Windows with a temperature that cannot be", least=0)] = 0
    saturated_left_out: Annotated[int, Key("Windows near where an axis saturates", least=0)] = 0
    used: Annotated[int, Key("Windows that the fit used", least=0)] = 0
    raw_error_mg: Annotated[
        float | None, Key("Mean error of the used windows before calibration", "mg", digits=4)
    ] = None
    after_error_mg: Annotated[
        float | None, Key("The same after calibration", "mg", digits=4, absent=True)
    ] = None


@dataclass(frozen=True, slots=True)
class FitSection:
    """`fit`."""

    points: Annotated[int, Key("Number of points")]
    postures: Annotated[int | None, Key("Number of orientations")]
    before_mg: Annotated[float | None, Key("Error of the raw points", "mg", digits=4)]
    after_mg: Annotated[float | None, Key("Error of the calibrated points", "mg", digits=4)]
    windows: Annotated[WindowUse, Key("Number of windows by use")]


@dataclass(frozen=True, slots=True)
class SaturatedAxis:
    """`coverage.saturated`."""

    axis: Annotated[str, Key("Axis", words=("x", "y", "z"))]
    at_g: Annotated[float, Key("Value at which it saturates", "g", digits=4)]


@dataclass(frozen=True, slots=True)
class CoverageSection:
    """`coverage`."""

    subsets: Annotated[
        tuple[Integers, Integers, Integers],
        Key("Number of points near -1, 0 and +1 g on each axis (Faragó et al. 2024)"),
    ]
    axis_min_g: Annotated[Vector, Key("Lowest point on x, y and z", "g", digits=4)]
    axis_max_g: Annotated[Vector, Key("Highest point on x, y and z", "g", digits=4)]
    cells: Annotated[int, Key("Number of points")]
    condition_number: Annotated[float | None, Key("Condition number of the fit", significant=True)]
    worst_direction_mg: Annotated[
        float | None, Key("Standard error of |a| in the least certain direction", "mg", significant=True)
    ]
    distinct_orientations: Annotated[int, Key("Number of points that are at least 15 degrees apart")]
    subsets_full_after_h: Annotated[
        float | None, Key("Hours after which all nine subsets were full", least=0)
    ]
    saturated: Annotated[tuple[SaturatedAxis, ...], Key("Axes that saturate within the range")]


@dataclass(frozen=True, slots=True)
class TrialSection:
    """`models_tried`."""

    model: Annotated[str, Key("Model")]
    after_mg: Annotated[float | None, Key("Its error on held-out orientations", "mg", digits=4)]
    reason: Annotated[str | None, Key("Code of the reason why it was not fitted or not used")]
    compared_mg: Annotated[float | None, Key("Error by which the models were compared", "mg", digits=4)]
    values: Annotated[Mapping[str, Any], Key("Values of the reason")]
    prior: Annotated[str | None, Key("Name of the prior, if there was one", absent=True)] = None


@dataclass(frozen=True, slots=True)
class ProblemSection:
    """`file_health.problems`."""

    code: Annotated[str, Key("Code of the problem", pattern="^[a-z0-9_]+$")]
    message: Annotated[str, Key("The problem in words")]
    byte_offset: Annotated[int | None, Key("Place in the file")]
    sample: Annotated[int, Key("Index of the sample")]
    count: Annotated[int, Key("How often it was found")]


@dataclass(frozen=True, slots=True)
class ZoneChangeSection:
    """`file_health.clock.dst_change`."""

    time: Annotated[str | None, Key("When")]
    utc_offset_s_before: Annotated[int, Key("Offset from UTC before", "s")]
    utc_offset_s_after: Annotated[int, Key("Offset from UTC after", "s")]
    followed: Annotated[bool | None, Key("True if the device clock followed it")]
    note: Annotated[str, Key("The same in words")]


@dataclass(frozen=True, slots=True)
class ClockSection:
    """`file_health.clock`."""

    rate_hz_nominal: Annotated[float, Key("Sampling rate that the file states", "Hz")]
    rate_hz_measured: Annotated[float | None, Key("Sampling rate by the time stamps", "Hz", digits=6)]
    drift_s_per_day: Annotated[float | None, Key("Drift", "s per day", digits=3)]
    gaps: Annotated[int | None, Key("Number of gaps")]
    gap_seconds: Annotated[float | None, Key("Length of all gaps together", "s", digits=6)]
    backward: Annotated[int | None, Key("Number of steps back")]
    dst_change: Annotated[ZoneChangeSection | None, Key("Change to or from summer time during the recording")]


@dataclass(frozen=True, slots=True)
class RestSection:
    """`file_health.rest`."""

    windows: Annotated[int, Key("Number of windows")]
    median_g: Annotated[float, Key("Median of |a|", "g")]
    p5_g: Annotated[float, Key("5th percentile of |a|", "g")]
    p95_g: Annotated[float, Key("95th percentile of |a|", "g")]
    axis_min_g: Annotated[Vector, Key("Lowest mean on x, y and z", "g", digits=4)]
    axis_max_g: Annotated[Vector, Key("Highest mean on x, y and z", "g", digits=4)]


@dataclass(frozen=True, slots=True)
class HealthSection:
    """`file_health`."""

    problems: Annotated[tuple[ProblemSection, ...], Key("Damage that was found")] = ()
    filled_samples: Annotated[int, Key("Samples that the device filled while it measured nothing")] = 0
    clipped_samples_before: Annotated[int, Key("Raw samples at the end of the range")] = 0
    clipped_samples_after: Annotated[int | None, Key("Calibrated samples beyond the range")] = None
    rate_hz_measured: Annotated[float | None, Key("Sampling rate by the time stamps", "Hz", digits=6)] = None
    lost_bytes: Annotated[int, Key("Bytes that are damaged or missing")] = 0
    lost_percent: Annotated[float, Key("The same in percent of the file", least=0, digits=4)] = 0.0
    missing_bytes: Annotated[int | None, Key("Bytes that the file states and does not have", least=0)] = 0
    clock: Annotated[ClockSection | None, Key("The device clock")] = None
    rest: Annotated[RestSection | None, Key("Windows of rest before calibration")] = None


@dataclass(frozen=True, slots=True)
class PoseSection:
    """`poses`."""

    face: Annotated[str, Key("Side that points up", words=("+x", "-x", "+y", "-y", "+z", "-z", "listed"))]
    start_s: Annotated[float, Key("Begin", "s")]
    end_s: Annotated[float, Key("End", "s")]
    windows: Annotated[int, Key("Number of windows", least=0)]
    mean_raw_g: Annotated[Vector, Key("Mean raw acceleration", "g")]
    reference_g: Annotated[Vector, Key("True acceleration", "g")]
    raw_mg: Annotated[float, Key("Error of the raw vector", "mg", least=0, digits=4)]
    residual_mg: Annotated[float | None, Key("Error of the fit", "mg", least=0, digits=4)]
    held_out_mg: Annotated[float | None, Key("Error with this position held out", "mg", least=0, digits=4)]
    held_out_norm_mg: Annotated[float | None, Key("Error of its length, held out", "mg", least=0, digits=4)]
    held_out_tilt_degrees: Annotated[
        float | None, Key("Error of its direction, held out", "degrees", least=0, digits=4)
    ]
    repeat_mg: Annotated[
        float | None, Key("Distance from the mean of its orientation", "mg", least=0, digits=4)
    ]
    file: Annotated[str | None, Key("File of the session", absent=True)] = None


@dataclass(frozen=True, slots=True)
class OrientationErrors:
    """`known_orientations.standard_errors`."""

    K: Annotated[Matrix, Key("Standard errors of the gain matrix", significant=True)]
    O: Annotated[Vector, Key("Standard errors of the offsets", "g", significant=True)]  # noqa: E741 (the name of its authors)


@dataclass(frozen=True, slots=True)
class ErrorPair:
    """`known_orientations.holdout_vector_mg`."""

    before: Annotated[ErrorSummary, Key("Before calibration")]
    after: Annotated[ErrorSummary, Key("After calibration")]


@dataclass(frozen=True, slots=True)
class LeftOutPoses:
    """`known_orientations.left_out`."""

    between_faces: Annotated[int, Key("Rests between sides", least=0)]
    between_faces_norm_mg: Annotated[float | None, Key("Error of their lengths", "mg", least=0, digits=4)]
    short: Annotated[int, Key("Rests that are too short", least=0)]


@dataclass(frozen=True, slots=True)
class Level:
    """`known_orientations.rolls.level_mg.before`."""

    mean: Annotated[float, Key("Mean", digits=4)]
    sd: Annotated[float, Key("Standard deviation", least=0, digits=4)]


@dataclass(frozen=True, slots=True)
class LevelPair:
    """`known_orientations.rolls.level_mg`."""

    before: Annotated[Level, Key("Before calibration")]
    after: Annotated[Level | None, Key("After calibration")]


@dataclass(frozen=True, slots=True)
class LengthPair:
    """`known_orientations.rolls.length_g`."""

    before: Annotated[float, Key("Before calibration", least=0, digits=4)]
    after: Annotated[float | None, Key("After calibration", least=0, digits=4)]


@dataclass(frozen=True, slots=True)
class Roll:
    """`known_orientations.rolls`."""

    axis: Annotated[str, Key("Level axis", words=("x", "y", "z"))]
    start_s: Annotated[float, Key("Begin", "s")]
    end_s: Annotated[float, Key("End", "s")]
    samples: Annotated[int, Key("Number of samples", least=1)]
    level_mg: Annotated[LevelPair, Key("Mean on the level axis [mg], which should be 0")]
    length_g: Annotated[LengthPair, Key("Mean of |a|", "g")]
    file: Annotated[str | None, Key("File", absent=True)] = None


@dataclass(frozen=True, slots=True)
class SessionFile:
    """`known_orientations.files`."""

    name: Annotated[str, Key("Name")]
    start_time: Annotated[str | None, Key("Time of the first sample")]
    samples: Annotated[int, Key("Number of samples", least=1)]
    problems: Annotated[int, Key("Number of problems", least=0)]
    lost_bytes: Annotated[int, Key("Bytes that are lost", least=0)]


@dataclass(frozen=True, slots=True)
class KnownOrientations:
    """`known_orientations`."""

    equation: Annotated[str, Key("The model as an equation", only="z = K a + O")]
    K: Annotated[Matrix | None, Key("Gain matrix")]
    O: Annotated[Vector | None, Key("Offsets", "g")]  # noqa: E741 (the name of its authors)
    standard_errors: Annotated[OrientationErrors | None, Key("Standard errors of both")]
    holdout_vector_mg: Annotated[ErrorPair | None, Key("Error of held-out vectors, direction included", "mg")]
    repeat_spread_mg: Annotated[float | None, Key("Spread of repeated positions", "mg", least=0, digits=4)]
    orientations: Annotated[int, Key("Number of different orientations", least=0)]
    missing_faces: Annotated[Sequence[str], Key("Sides that were not found")]
    left_out: Annotated[LeftOutPoses, Key("Rests that were not used")]
    unchecked: Annotated[
        str | None, Key("Code of the reason why nothing was held out", pattern=".", absent=True)
    ] = None
    rolls: Annotated[tuple[Roll, ...] | None, Key("Rolls about a level axis", absent=True)] = None
    files: Annotated[tuple[SessionFile, ...] | None, Key("Files of the session", absent=True)] = None


@dataclass(frozen=True, slots=True)
class GyroscopeSlopes:
    """`gyroscope.temperature`."""

    slope_dps_per_c: Annotated[
        Vector, Key("Change of the bias with temperature [deg/s per degree C], x, y and z")
    ]
    reference_c: Annotated[float, Key("Temperature at which the offsets hold", "degrees C")]


@dataclass(frozen=True, slots=True)
class GyroscopeErrors:
    """`gyroscope.standard_errors`."""

    scale: Annotated[Matrix | None, Key("Standard errors of the scale matrix", significant=True)]
    bias_dps: Annotated[Vector | None, Key("Standard errors of the bias", "deg/s", significant=True)]


@dataclass(frozen=True, slots=True)
class RestingRates:
    """`gyroscope.rest`."""

    seconds: Annotated[float, Key("Length of rest", "s", least=0, digits=3)]
    raw_dps: Annotated[float, Key("Rate at rest before calibration", "deg/s", least=0, significant=True)]
    constant_dps: Annotated[
        float | None, Key("The same with the bias removed", "deg/s", least=0, significant=True)
    ]
    slope_dps: Annotated[
        float | None, Key("The same with a bias that follows temperature", "deg/s", least=0, significant=True)
    ]


@dataclass(frozen=True, slots=True)
class GyroscopeSection:
    """`gyroscope`."""

    outcome: Annotated[str, Key("calibrated or refused", words=("calibrated", "refused"))]
    reason: Annotated[str, Key("Code of the reason", pattern=".")]
    values: Annotated[Mapping[str, Any], Key("Values of the reason")]
    message: Annotated[str, Key("The reason in words", pattern=".")]
    equation: Annotated[str, Key("The model as an equation")]
    scale: Annotated[Matrix | None, Key("Scale matrix S, row by row")]
    bias_dps: Annotated[Vector | None, Key("Bias of x, y and z", "deg/s")]
    temperature: Annotated[GyroscopeSlopes | None, Key("Change of the bias with temperature; null without")]
    standard_errors: Annotated[GyroscopeErrors, Key("Standard errors")]
    pairs: Annotated[int, Key("Number of turns between two rests", least=0)]
    pairs_left_out: Annotated[int, Key("Turns that were not used", least=0)]
    holdout_deg: Annotated[
        TurnHoldout | None, Key("Error of gravity's direction after a turn [degrees], on held-out turns")
    ]
    rest: Annotated[RestingRates | None, Key("Rates at rest")]


@dataclass(frozen=True, slots=True)
class Provenance:
    """`provenance`."""

    command: Annotated[Sequence[str], Key("Command line")] = ()
    versions: Annotated[Mapping[str, str], Key("Versions of Python and packages")] = field(
        default_factory=dict
    )
    time: Annotated[str, Key("When the report was written (UTC)")] = ""
    host: Annotated[str, Key("Name of the computer")] = ""
    platform: Annotated[str, Key("System and processor")] = ""
    files: Annotated[
        Mapping[str, str] | None,
        Key(
            "Where the files were that the report was made of, such as recording and "
            "coefficients, seen from folder",
            absent=True,
        ),
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class AppliedCoefficients:
    """`coefficients`."""

    path: Annotated[str, Key("File of the coefficients")]
    sha256: Annotated[str, Key("SHA-256 of that file", pattern=SHA256)]
    without_provenance: Annotated[bool | None, Key("True if the hash leaves provenance out", absent=True)] = (
        None
    )
    recording_path: Annotated[str, Key("Recording that they were found from")]
    recording_sha256: Annotated[str, Key("SHA-256 of that recording", pattern=SHA256)]
    device: Annotated[Device, Key("Device of that recording")]
    accelcal_version: Annotated[str, Key("Version of accelcal that found them")]


@dataclass(frozen=True, slots=True)
class PoolMember:
    """`pool.recordings`."""

    path: Annotated[str, Key("File")]
    sha256: Annotated[str, Key("SHA-256 of its content", pattern=SHA256)]


@dataclass(frozen=True, slots=True)
class LeftOutMember:
    """`pool.left_out`."""

    path: Annotated[str, Key("File of the recording")]
    sha256: Annotated[str, Key("Its SHA-256", pattern=SHA256)]
    reason: Annotated[str, Key("Code of the reason")]
    values: Annotated[Mapping[str, Any], Key("Values of the reason")]


@dataclass(frozen=True, slots=True)
class OwnWindows:
    """`pool.own_windows`."""

    points: Annotated[int, Key("Number of points", least=0)]
    postures: Annotated[int, Key("Number of orientations", least=0)]
    before_mg: Annotated[ErrorSummary, Key("Error before calibration", "mg")]
    after_mg: Annotated[ErrorSummary, Key("Error after calibration", "mg")]


@dataclass(frozen=True, slots=True)
class PoolSection:
    """`pool`."""

    serial: Annotated[str, Key("Serial number of the device")]
    recordings: Annotated[tuple[PoolMember, ...], Key("Recordings in the pool")]
    left_out: Annotated[tuple[LeftOutMember, ...], Key("Recordings that were left out")]
    copies: Annotated[
        tuple[PoolMember, ...] | None, Key("Files with the content of one of the recordings", absent=True)
    ] = None
    path: Annotated[str | None, Key("File of the pool's report", absent=True)] = None
    sha256: Annotated[str | None, Key("Hash of the pool's report", pattern=SHA256, absent=True)] = None
    own_windows: Annotated[OwnWindows | None, Key("Error on the recording's own points", absent=True)] = None


@dataclass(frozen=True, slots=True)
class PriorNoise:
    """`prior.noise`."""

    g: Annotated[float, Key("Usual scatter", "g", positive=True)]
    spread: Annotated[float, Key("Scale parameter of its logarithm", positive=True)]
    freedom: Annotated[float, Key("Degrees of freedom", positive=True)]


@dataclass(frozen=True, slots=True)
class PriorModel:
    """`prior.model`."""

    name: Annotated[str | None, Key("Model of the devices")]
    devices: Annotated[int, Key("Number of devices", least=0)]
    recordings: Annotated[int, Key("Number of recordings", least=0)]
    sha256: Annotated[str | None, Key("Hash of these recordings", pattern=SHA256)]


@dataclass(frozen=True, slots=True)
class PriorSection:
    """`prior`."""

    kind: Annotated[str, Key("study or device", words=("study", "device"))]
    centre: Annotated[
        Mapping[str, float], Key("Centre of each parameter", entries=PRIOR_PARAMETERS, needed=12)
    ]
    width: Annotated[
        Mapping[str, float],
        Key("Scale parameter of each parameter", positive=True, entries=PRIOR_PARAMETERS, needed=12),
    ]
    freedom: Annotated[float, Key("Degrees of freedom", positive=True)]
    noise: Annotated[PriorNoise, Key("Usual scatter of orientations")]
    reference_c: Annotated[float | None, Key("Temperature at which the offsets hold", "degrees C")]
    model: Annotated[PriorModel, Key("The devices of the model that it was learnt from")]
    device: Annotated[tuple[PoolMember, ...], Key("The device's other recordings that it was learnt from")]


@dataclass(frozen=True, slots=True)
class LeftOutSamples:
    """`effect.left_out`."""

    filled: Annotated[int, Key("Filled samples", least=0)]
    clipped: Annotated[int, Key("Clipped samples", least=0)]
    recovered: Annotated[int, Key("Samples from damaged blocks", least=0)]


@dataclass(frozen=True, slots=True)
class ActivitySection:
    """`effect.versions.raw`."""

    model: Annotated[str | None, Key("Model")]
    enmo_mg: Annotated[float | None, Key("Mean ENMO", "mg")]
    mad_mg: Annotated[float | None, Key("Mean MAD", "mg")]
    mvpa_min: Annotated[float, Key("Minutes of moderate to vigorous activity")]
    pim_mg_s: Annotated[float | None, Key("Mean PIM", "mg s")]
    zcm: Annotated[float | None, Key("Mean zero-crossing count")]
    angle_deg: Annotated[float | None, Key("Mean angle of the arm", "degrees")]
    inactive_min: Annotated[float, Key("Minutes of inactivity")]
    enmo_differs_mg: Annotated[
        float | None, Key("Mean difference of ENMO from the raw values by epoch", "mg")
    ]


@dataclass(frozen=True, slots=True)
class Excess:
    """`effect.raw_bias.NAME`."""

    value: Annotated[float, Key("By how much the raw value is too large", digits=4)]
    ci95: Annotated[Pair, Key("Its 95 % interval", digits=4)]


@dataclass(frozen=True, slots=True)
class EffectSection:
    """`effect`."""

    epoch_s: Annotated[int, Key("Length of an epoch", "s", least=1)]
    epochs: Annotated[int, Key("Number of epochs", least=0)]
    short_epochs: Annotated[int, Key("Epochs that are not complete", least=0)]
    left_out: Annotated[LeftOutSamples, Key("Samples that take no part")]
    left_out_percent: Annotated[float, Key("The same in percent", least=0, digits=4)]
    versions: Annotated[
        Mapping[str, ActivitySection], Key("Measures by version of the values", entries=VERSIONS, needed=2)
    ]
    ci95: Annotated[
        Mapping[str, Pair] | None,
        Key(
            "95 % intervals of the calibrated figures: what plausible calibrations of the "
            "posterior make of the same epochs; null where no posterior is known, as for "
            "coefficients of another recording",
            entries=FIGURES,
            needed=0,
        ),
    ]
    raw_bias: Annotated[
        Mapping[str, Excess] | None,
        Key("By how much the raw figures are too large, with a 95 % interval", entries=FIGURES, needed=0),
    ]


@dataclass(frozen=True, slots=True)
class ReportView:
    """One recording's calibration.

    Errors are mean | |a| - 1 g | in mg; `calibration_error_mg` is the number to quote. Without
    `provenance` the report is the same for the same input, settings and version.
    """

    kind: Annotated[str, Key("Kind of the file", only=REPORT)]
    schema_version: Annotated[int, Key("Version of the form of all outputs", only=SCHEMA_VERSION)]
    accelcal_version: Annotated[str, Key("Version of accelcal that wrote the file")]
    recording: Annotated[RecordingSection, Key("The recording as read: file, device, rate, time")]
    settings: Annotated[Mapping[str, Any], Key("Every setting that affected the result", needs=SETTINGS)]
    outcome: Annotated[
        Outcome, Key("Outcome: calibrated, provisional, reduced_model, already_good, borrowed or refused")
    ]
    reason: Annotated[str, Key("Why the outcome is what it is: a stable code (docs/reasons.md)", pattern=".")]
    values: Annotated[Mapping[str, Any], Key("The numbers and names that the sentence of the reason needs")]
    message: Annotated[
        str,
        Key(
            "A sentence made of `reason`, `values` and `notes`, for people; no program compares it",
            pattern=".",
        ),
    ]
    notes: Annotated[tuple[Reason, ...], Key("What else is to be known of the result")]
    cautions: Annotated[tuple[Reason, ...], Key("What speaks against trusting the result without a look")]
    advice: Annotated[tuple[Reason, ...], Key("What to do about a refusal")]
    calibration: Annotated[
        CalibrationSection | None, Key("The coefficients; null if the recording was refused")
    ]
    without_misalignment: Annotated[
        WithoutMisalignmentSection | None,
        Key(
            "The same points fitted without misalignment, for tools that cannot use it; null "
            "where there is none"
        ),
    ]
    calibration_error_mg: Annotated[
        CalibrationError | None,
        Key(
            "Expected mean | |a| - 1 g | of the coefficients over all orientations, from the "
            "posterior, without the scatter of rests"
        ),
    ]
    probability: Annotated[
        Probability | None,
        Key("What decides between calibrated, provisional and refused; from the posterior"),
    ]
    uncertainty: Annotated[
        tuple[UncertaintyPart, ...] | None,
        Key("Parts of the standard uncertainty of |a| at rest; null where the error over all is unknown"),
    ]
    rest_scatter_mg: Annotated[
        float | None,
        Key(
            "Mean | |a| - 1 g | that the scatter of rests makes from orientation to orientation",
            least=0,
            significant=True,
        ),
    ]
    change: Annotated[
        ChangeSection | None,
        Key("Change of the sensor during the recording; null where it was not looked for"),
    ]
    misfits: Annotated[
        tuple[Misfit, ...] | None,
        Key(
            "Behaviours of the sensor that the parameters do not describe, and whether each was "
            "found; null where they were not looked for"
        ),
    ]
    holdout: Annotated[
        HoldoutSection | None,
        Key("Error on data that took no part in the fit; null where nothing was held out"),
    ]
    fit: Annotated[FitSection, Key("Error on the fitted points, and the number of windows by use")]
    coverage: Annotated[CoverageSection, Key("Orientations in which the device was still")]
    models_tried: Annotated[
        tuple[TrialSection, ...],
        Key("Each model that was fitted, with its error, or the reason why it was not"),
    ]
    file_health: Annotated[
        HealthSection, Key("State of the file: damage, gaps, clock, filled and clipped samples")
    ]
    provenance: Annotated[
        Provenance, Key("Command, versions, time and computer; the only part that differs between runs")
    ] = Provenance()
    poses: Annotated[
        tuple[PoseSection, ...] | None, Key("The positions of a six-position session", absent=True)
    ] = None
    known_orientations: Annotated[
        KnownOrientations | None, Key("Calibration from known orientations", absent=True)
    ] = None
    gyroscope: Annotated[GyroscopeSection | None, Key("Calibration of the gyroscope", absent=True)] = None
    coefficients: Annotated[
        AppliedCoefficients | None,
        Key(
            "Only with coefficients of another recording: where they come from (docs/outputs.md)", absent=True
        ),
    ] = None
    pool: Annotated[
        PoolSection | None,
        Key(
            "Only in a pool: its recordings, and the errors on the own windows of this one (docs/outputs.md)",
            absent=True,
        ),
    ] = None
    prior: Annotated[
        PriorSection | None,
        Key("Only with a learnt prior: its parameters and their origin (docs/outputs.md)", absent=True),
    ] = None
    effect: Annotated[
        EffectSection | None,
        Key("Only with --effect and with a calibration: measures of activity (docs/effect.md)", absent=True),
    ] = None

    def setting(self, name: str, default: float) -> float:
        """Return a number among the settings; the default where the report has none."""
        value = self.settings.get(name, default)
        return float(value) if type(value) in (int, float) else default


@dataclass(frozen=True, slots=True)
class Errors:
    """Sections with the errors to quote, of a report or of its `without_misalignment`."""

    holdout: HoldoutSection | None = None
    calibration_error_mg: CalibrationError | None = None


def report_view(report: Mapping[str, Any]) -> ReportView:
    """Return a report, which has been checked or is being built, as records."""
    return from_json(ReportView, report)
