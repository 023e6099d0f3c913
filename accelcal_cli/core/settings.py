"""Every setting of the method: name, unit, default, bounds, source, and its option, declared once.

Command-line options (cli/options.py) and the checks of settings that are read back from a report
(pipeline/options.py) are made from what is declared here.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any

from accelcal_cli.core.gravity import Gravity

SETTING = "setting"
"""Key of a field's metadata under which its Setting is found."""

BY_NAME = "-R "
"""Beginning of the names of options that are given as `-R NAME=VALUE`."""

SIX_POSE = "six-pose"
"""Name of the profile in reports of known orientations."""


@dataclass(frozen=True, slots=True)
class Option:
    """The command-line option that sets a field.

    Attributes:
        name: as it is typed, with `--no-` for one that switches off: `--unit`, or `-R zero` for one that is
            given by name, as `-R zero=512`.
        metavar: name of its value in the help; None: by the type.
        default: the default as shown in the help; None: the field's own.
        bounds: narrower bounds for a typed number than for one in a report; None: the setting's.
        above: a typed number must only be above this, instead of the lower bound; None: the bound holds.
        rare: only `--help-all` shows it.
    """

    name: str
    help: str
    metavar: str | None = None
    default: str | None = None
    bounds: tuple[float, float] | None = None
    above: float | None = None
    rare: bool = False

    @property
    def by_name(self) -> bool:
        """True if it is given as `-R NAME=VALUE`."""
        return self.name.startswith(BY_NAME)

    @property
    def keyword(self) -> str:
        """Its name in files and in Python: `lsb_per_g`."""
        return self.name.removeprefix(BY_NAME).removeprefix("--").replace("-", "_")

    def with_value(self, text: str) -> str:
        """Return the words to type: `--unit mg`, `-R zero=512`."""
        return f"{self.name}{'=' if self.by_name else ' '}{text}"


@dataclass(frozen=True, slots=True)
class Setting:
    """The values that a field may have, besides None if its type allows it, and the option that sets it.

    Attributes:
        low, high: bounds of a number, or of every number of a tuple; None: unbounded.
        choices: possible names; empty: any.
    """

    low: float | None = None
    high: float | None = None
    option: Option | None = None
    choices: tuple[str, ...] = ()

    def allows(self, value: Any) -> bool:
        """Return True if a value of the field's type, not None, is within the choices and bounds."""
        if self.choices:
            return value in self.choices
        numbers = value if isinstance(value, tuple) else (value,)
        return self.low is None or self.high is None or all(self.low <= v <= self.high for v in numbers)


def setting(
    default: Any,
    /,
    *option: Any,
    within: tuple[float, float] | None = None,
    choices: tuple[str, ...] = (),
    **shown: Any,
) -> Any:
    """Return a field of a dataclass with its Setting.

    Args:
        option, shown: arguments of its Option; without any it has none.
        within: bounds of a number, or of every number of a tuple.
    """
    low, high = within or (None, None)
    made = Setting(low, high, Option(*option, **shown) if option else None, choices)
    return field(default=default, metadata={SETTING: made})


def setting_of(kind: Any, name: str) -> Setting:
    """Return the Setting of a dataclass's field."""
    declared: Setting = kind.__dataclass_fields__[name].metadata.get(SETTING, Setting())
    return declared


@dataclass(frozen=True, slots=True)
class Adaptive:
    """Numbers of stillness rule `adaptive` (G: Grammenos, Mascolo, Crowcroft 2018, section 4.4).

    Attributes:
        acceleration_factor: largest standard deviation of |a|, in multiples of its minimum (G: 2).
        rotation_factor: largest standard deviation of the gyroscope, in multiples of its minimum (G: 3).
        min_samples: fewest samples of a window, however long they take (the standard deviation of 100
            values is known to 7 %, so that the minimum over a week of windows is about two thirds of the
            usual one; of 30 values it would be less than half).
        min_windows: fewest windows of a state (G gathers more once a first window has passed; 2, since |a|
            alone does not show a slow turn, but the means of two windows do).
        max_windows: most windows of a state, after which another begins (60: a minute at 100 Hz), so that
            hours in one posture stay many windows with their own temperatures.
        held_windows: number of further windows that a candidate waits for, so that an early one is judged
            by a settled minimum (measured: 16384 are about 4.5 h of rest; 3 MB).
    """

    acceleration_factor: int = setting(2, within=(1, 30))
    rotation_factor: int = setting(3, within=(1, 30))
    min_samples: int = setting(100, within=(1, 1_000_000))
    min_windows: int = setting(2, within=(1, 1_000_000))
    max_windows: int = setting(60, within=(1, 1_000_000))
    held_windows: int = setting(1 << 14, within=(1, 1_000_000))


_FIXED: dict[str, Any] = {
    "segment_seconds": 5.0,
    "stillness_threshold_g": 0.12,
    "stillness_deviation_g": 0.013,
    "stillness_axes": (0, 1, 2),
    "adaptive": None,
}
_UNUSED: dict[str, Any] = {"stillness_threshold_g": None, "stillness_axes": ()}
STILLNESS: dict[str, dict[str, Any]] = {
    "both": _FIXED,
    "range": {**_FIXED, "stillness_deviation_g": None, "stillness_axes": (0,)},
    "deviation": {**_FIXED, **_UNUSED, "segment_seconds": 10.0},
    "adaptive": {**_UNUSED, "segment_seconds": 1.0, "stillness_deviation_g": None, "adaptive": Adaptive()},
}
"""Rules of stillness, as in `--stillness`, and the settings that each stands for."""

RANGE_RULES = tuple(
    name for name, numbers in STILLNESS.items() if numbers["stillness_threshold_g"] is not None
)
"""Rules that limit max - min."""


NO_PRIOR = "none"
STUDY_PRIOR, DEVICE_PRIOR = "study", "device"
LEARNT_PRIORS = (STUDY_PRIOR, DEVICE_PRIOR)
"""Priors that a study learns from other recordings."""

NEVER = "never"


@dataclass(frozen=True, slots=True)
class Settings:
    """All that decides the result besides the recording; it is part of the report.

    Attributes:
        profile: `default`, or `paper` for F's procedure (docs/evaluation.md lists the additions).
        optimizer: as in `--optimizer`.
        model: `auto`, or the model (9, 6, 3) that the user insists on.
        prior: knowledge of sensors before any point is seen (docs/prior.md). `population` is that of DEFAULT;
            `none`: the simplest model that held-out postures support; `study`, `device`: learnt from other
            recordings, and part of the report.
        recalibrate: `auto`, as in DEFAULT: the calibration follows a sensor that changes while it records
            (docs/change.md); `never`: a change is only reported.
        temperature: True if a slope per axis may be fitted when the recording has temperature.
        stillness: rule of stillness, a key of STILLNESS, which sets the next five.
        segment_seconds: length of a window [s] (F II.B.1: 5 s; van Hees et al. 2014: 10 s; G 4.4:
            at least 1 s).
        stillness_threshold_g: max - min of a still window is below this [g] (F II.B.1: 0.12 g); None: no
            limit.
        stillness_deviation_g: standard deviation of every axis is below this [g] (van Hees et al. 2014:
            13 mg); None: no limit.
        stillness_axes: axes of the max - min rule (F: one, of its choice; here all, since slow movement
            across the other two passes a rule that looks at one).
        adaptive: numbers of rule `adaptive`; None for the others.
        other_stillness: True if the other axes and then rule `both` are tried where profile `paper` refuses a
            recording by its axis; the rule in the report is the one that was used.
        longest_gap_s: longest gap, or step back of the clock, that a window may span [s]; together they are
            no longer than the window. 0: none (docs/stillness.md; phones lose up to
            0.2 s at a time, and what is still before and after half a second hardly moved in between).
        cells_per_g: orientation cells per g on each axis (measured: 20; 10 leaves a bias).
        norm_low_g, norm_high_g: bounds of a plausible still window's |mean| [g].
        posture_degrees: largest angle between a point and the first of its posture [degrees].
        folds: number of posture-blocked folds.
        min_postures: fewest postures for nine unknowns (F II.B.1: nine distinct points).
        coverage_g: raw values [g] that a scale needs on both sides of every axis (van Hees et al. 2014:
            0.3 g).
        max_error_mg: error over all orientations, without a prior on held-out ones, that a calibration stays
            below [mg] (van Hees: 10 mg).
        strict: True to refuse what would be provisional: better than raw, but perhaps above that error.
        min_temperature_range_c: smallest range of temperatures for a slope [degrees C].
        temperature_block_c: range of temperatures within which a posture is one block when models are
            compared [degrees C], so that a slope shows where one posture had different temperatures.
        precision_mg: longest step of calibrated values [mg]; the step is a power of two of g, so that they
            compress. None: single precision.
        latitude: of the place of recording [degrees]; None: rest measures 1 standard g.
        altitude_m: of the place of recording, above the sea [m].
        max_damage_percent: share that damage may take of a recording before it is refused [%]; the rest of it
            may not be what was worn.
        min_distance_g: smallest distance between points of profile `paper` [g] (F II.B.1: a mean "differs
            sufficiently from the already acquired"; measured: 0.2); 0: any.
        min_subset_points, max_subset_points: points in each of the nine subsets of profile `paper` (F II.B.1:
            2 and 2, 18 in all). With fewer in any, nothing is fitted; no subset takes more.
    """

    profile: str = setting(
        "default", "--profile", "paper: the published procedure.", choices=("default", "paper")
    )
    optimizer: str = setting(
        "fixed32", "--optimizer", "Optimizer that finds the parameters.", "NAME", rare=True
    )
    model: str = setting("auto", "--model", "Number of parameters.", choices=("auto", "9", "6", "3"))
    prior: str = setting(
        NO_PRIOR, "--prior", "none: fit only what the recording supports.",
        choices=("population", NO_PRIOR, *LEARNT_PRIORS), default="population")  # fmt: skip
    recalibrate: str = setting(
        NEVER, "--recalibrate", "auto: adapt the calibration when the sensor changes during the recording. "
        "never: only report the change.", choices=("auto", NEVER), default="auto", rare=True)  # fmt: skip
    temperature: bool = setting(True, "--no-temperature", "Leave temperature out.")
    stillness: str = setting(
        "both", "--stillness", "Rule by which a window counts as still.", choices=tuple(STILLNESS),
        default="both; profile paper: range, or both if no axis calibrates", rare=True)  # fmt: skip
    segment_seconds: float = setting(
        5.0, "--segment-seconds", "Length of a window.", within=(1e-6, 3600),
        default="depends on --stillness", above=0, rare=True)  # fmt: skip
    stillness_threshold_g: float | None = setting(
        0.12, "--stillness-threshold-g",
        f"Largest max - min in a still window (rules {', '.join(RANGE_RULES)}).", within=(1e-9, 4), above=0,
        rare=True)  # fmt: skip
    stillness_deviation_g: float | None = setting(0.013, within=(1e-9, 4))
    stillness_axes: tuple[int, ...] = setting(
        (0, 1, 2), "--stillness-axis", "Axis that --stillness range checks.", within=(0, 2),
        default="x; profile paper: the first that calibrates", rare=True)  # fmt: skip
    adaptive: Adaptive | None = None
    other_stillness: bool = False
    longest_gap_s: float = setting(
        0.0, "--longest-gap", "Longest gap between time stamps that a window may span; 0 for none.",
        "SECONDS", within=(0, 10), default="0.5; profile paper: 0", rare=True)  # fmt: skip
    cells_per_g: int = setting(20, within=(1, 1000))
    norm_low_g: float = setting(0.5, within=(0, 10))
    norm_high_g: float = setting(1.5, within=(0, 10))
    posture_degrees: float = setting(15.0, within=(1e-3, 180))
    folds: int = setting(5, within=(2, 1000))
    min_postures: int = setting(9, within=(2, 1_000_000))
    coverage_g: float = setting(0.3, within=(0, 4))
    max_error_mg: float = setting(
        10.0, "--max-error", "Limit of the calibration error.", "MG", within=(0, 1e6), above=0
    )
    strict: bool = setting(False, "--strict", "Refuse provisional calibrations.")
    min_temperature_range_c: float = setting(2.0, within=(0, 1e3))
    temperature_block_c: float = setting(2.0, within=(1e-3, 1e3))
    precision_mg: float | None = setting(
        None, "--precision", "Round values to steps of at most MG, for smaller files.", "MG", "exact",
        within=(1e-3, 1000), rare=True)  # fmt: skip
    latitude: float | None = setting(
        None, "--latitude", "Latitude of the place where the recording was made, for local gravity.",
        "DEGREES", within=(-90, 90), rare=True)  # fmt: skip
    altitude_m: float | None = setting(
        None, "--altitude", "Altitude above sea level.", "METRES", "0", within=(-500, 9000), rare=True
    )
    max_damage_percent: float = setting(
        50.0, "-R max_damage", "Refuse a recording if more of it is damaged.", "PERCENT", within=(0, 100)
    )
    min_distance_g: float = setting(
        0.0, "--min-distance-g",
        "Smallest distance between two points (--profile paper only); 0 for no limit.", within=(0, 2),
        default="profile paper: 0.2", rare=True)  # fmt: skip
    min_subset_points: int = setting(
        2, "--min-subset-points", "Minimum number of points per subset (--profile paper only).", "N",
        within=(1, 100), rare=True)  # fmt: skip
    max_subset_points: int = setting(
        2, "--max-subset-points", "Maximum number of points per subset (--profile paper only).", "N",
        within=(1, 100), rare=True)  # fmt: skip

    @property
    def gravity(self) -> Gravity:
        """The place of recording, which determines what rest measures."""
        return Gravity(self.latitude, self.altitude_m)

    def as_json(self) -> dict[str, Any]:
        """The report's `settings` object."""
        return asdict(self)


def _as_in_settings(name: str) -> Any:
    """Return a field with the default, bounds and option that it has in Settings."""
    same = Settings.__dataclass_fields__[name]
    return field(default=same.default, metadata=same.metadata)


POSES_IF_ASKED = ("unchecked", "roll")
"""Fields of PoseSettings that a report has only if they were asked for."""


@dataclass(frozen=True, slots=True)
class PoseSettings:
    """All that decides a calibration from known orientations, besides the recording and its list of poses.

    Attributes:
        segment_seconds: length of a window [s]; short, since a face is held for seconds.
        stillness_threshold_g, stillness_deviation_g: as in `Settings`, on every axis.
        longest_gap_s: as in `Settings`.
        norm_low_g, norm_high_g: as in `Settings`; not required of listed poses.
        face_degrees: largest angle between a state and the axis of its face [degrees]; wide, since raw values
            have the errors that are sought.
        state_degrees: largest angle between a window and the mean of its state [degrees].
        min_state_seconds: shortest state [s]; not required of listed poses.
        posture_degrees: largest angle between listed references that are held out together [degrees].
        max_condition: condition number of the matrix [a 1] above which the poses do not determine the
            parameters.
        max_error_mg: as in `Settings`.
        max_vector_error_mg: held-out |a - reference| that a usable calibration stays below [mg]; one face
            tilted by a degree contributes 12 mg.
        latitude, altitude_m, max_damage_percent: as in `Settings`.
        unchecked: True to fit poses that leave none to judge the fit by.
        roll: where the device was rolled about a level axis, as typed: `z,80,95`.
    """

    segment_seconds: float = setting(
        1.0, "--segment-seconds", "Length of a window.", within=(1e-6, 3600), bounds=(0.1, 60)
    )
    stillness_threshold_g: float = setting(
        0.12, "--stillness-threshold-g", "Largest max - min in a still window.", within=(1e-9, 4), above=0
    )
    stillness_deviation_g: float = _as_in_settings("stillness_deviation_g")
    longest_gap_s: float = _as_in_settings("longest_gap_s")
    norm_low_g: float = _as_in_settings("norm_low_g")
    norm_high_g: float = _as_in_settings("norm_high_g")
    face_degrees: float = setting(
        15.0, "--face-degrees", "Largest angle between the raw mean of a face and its axis.",
        within=(0.1, 90), bounds=(1, 45))  # fmt: skip
    state_degrees: float = setting(2.0, within=(1e-3, 180))
    min_state_seconds: float = setting(2.0, within=(0, 3600))
    posture_degrees: float = _as_in_settings("posture_degrees")
    max_condition: float = setting(1000.0, within=(1, 1e9))
    max_error_mg: float = _as_in_settings("max_error_mg")
    max_vector_error_mg: float = setting(20.0, within=(0, 1e6))
    latitude: float | None = _as_in_settings("latitude")
    altitude_m: float | None = _as_in_settings("altitude_m")
    max_damage_percent: float = _as_in_settings("max_damage_percent")
    unchecked: bool = setting(False, "--unchecked", "Fit four poses too, of which none can be held out.")
    roll: tuple[str, ...] = ()

    @property
    def gravity(self) -> Gravity:
        """The place of recording, which determines what rest measures."""
        return Gravity(self.latitude, self.altitude_m)

    @property
    def profile(self) -> str:
        """Name of the profile in the report's `settings`."""
        return SIX_POSE

    @property
    def stillness(self) -> Settings:
        """The settings of the segmenter."""
        names = (
            *("segment_seconds", "stillness_threshold_g", "stillness_deviation_g", "longest_gap_s"),
            *("norm_low_g", "norm_high_g", "latitude", "altitude_m"),
        )
        return Settings(**{name: getattr(self, name) for name in names})

    def as_json(self) -> dict[str, Any]:
        """The report's `settings` object."""
        fixed = {"profile": self.profile, "optimizer": "least-squares", "model": "12", "temperature": False}
        fields = {name: value for name, value in asdict(self).items() if value or name not in POSES_IF_ASKED}
        return {**fixed, "stillness": self.stillness.stillness, **fields}


@dataclass(frozen=True, slots=True)
class EffectiveSettings:
    """The report's `settings`: all that decides a result besides the recording.

    Attributes:
        report_only: True if no calibrated recording is written.
        input: how the recording was read.
        poses: a session's list of poses, by name and hash; None in both: its faces were found.
        effect: True if the effect on measures of activity is reported.
    """

    method: Settings | PoseSettings
    report_only: bool
    input: dict[str, Any]
    poses: tuple[str | None, str | None] = (None, None)
    effect: bool = False

    @property
    def precision_mg(self) -> float | None:
        """Longest step of calibrated values that are written [mg]; None: exact."""
        return self.method.precision_mg if isinstance(self.method, Settings) else None

    def as_json(self) -> dict[str, Any]:
        """The report's `settings` object."""
        names = ("poses", "poses_sha256") if isinstance(self.method, PoseSettings) else ()
        poses = dict(zip(names, self.poses, strict=False))
        asked = {"report_only": self.report_only, **({"effect": True} if self.effect else {})}
        return {**self.method.as_json(), **asked, **poses, "input": self.input}


def with_stillness(settings: Settings, name: str) -> Settings:
    """Return the settings with a rule of stillness and its numbers."""
    return replace(settings, stillness=name, **STILLNESS[name])


VARIED = ("stillness", "stillness_deviation_g", "stillness_axes")
"""Settings in which the rules of `other_rules` differ."""


def other_rules(settings: Settings) -> tuple[Settings, ...]:
    """Return settings with rule `range` on x, y and z, and with rule `both`, without those that are given."""
    base = settings if settings.stillness in RANGE_RULES else with_stillness(settings, "both")
    rules = [{**STILLNESS["range"], "stillness": "range", "stillness_axes": (axis,)} for axis in range(3)]
    rules.append({**STILLNESS["both"], "stillness": "both"})
    varied = (replace(base, **{name: rule[name] for name in VARIED}) for rule in rules)
    return tuple(other for other in varied if other != settings)


def rule_options(settings: Settings) -> str:
    """Return the options that choose the rule of stillness of settings."""
    axes = settings.stillness_axes
    axis = f" --stillness-axis {'xyz'[axes[0]]}" if len(axes) == 1 else ""
    return f"--stillness {settings.stillness}{axis}"


DEFAULT = Settings(prior="population", recalibrate="auto", longest_gap_s=0.5)
PAPER = replace(
    with_stillness(Settings(), "range"),
    profile="paper",
    other_stillness=True,
    temperature=False,
    min_distance_g=0.2,
)
PROFILES = {"default": DEFAULT, "paper": PAPER}
POSES = PoseSettings(longest_gap_s=DEFAULT.longest_gap_s)
