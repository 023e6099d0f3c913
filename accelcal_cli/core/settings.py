"""The one place for every setting of the method: name, unit, default, bounds, source, and its option.

Command-line options (cli/options.py) and the checks of settings that are read back from a report
(pipeline/report_settings.py) are made from what is declared here.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any

from accelcal_cli.core.gravity import Gravity

SETTING = "setting"
"""Key of a field's metadata that holds its Setting."""

SIX_POSE = "six-pose"
"""The profile that reports of known orientations name."""


@dataclass(frozen=True, slots=True)
class Option:
    """The command-line option that sets a field.

    Attributes:
        name: with `--no-` for one that switches off.
        metavar: what the help calls its value; None: by the type.
        default: as shown in the help; None: the field's own.
        bounds: narrower ones for a number that is typed than for one in a report; None: the setting's.
        above: a typed number need only be above this, in place of the lower bound; None: the bound holds.
    """

    name: str
    help: str
    metavar: str | None = None
    default: str | None = None
    bounds: tuple[float, float] | None = None
    above: float | None = None


@dataclass(frozen=True, slots=True)
class Setting:
    """What a field may hold, besides None if its type allows it, and the option that sets it.

    Attributes:
        low, high: bounds of a number, or of every number of a tuple; None: unbounded.
        choices: names that are possible; empty: any.
    """

    low: float | None = None
    high: float | None = None
    option: Option | None = None
    choices: tuple[str, ...] = ()

    def allows(self, value: Any) -> bool:
        """Whether a value, of the field's type and not None, is among the choices and within the bounds."""
        if self.choices:
            return value in self.choices
        numbers = value if isinstance(value, tuple) else (value,)
        return self.low is None or self.high is None or all(self.low <= v <= self.high for v in numbers)


def setting(
    default: Any,
    low: float | None = None,
    high: float | None = None,
    option: Option | None = None,
    choices: tuple[str, ...] = (),
) -> Any:
    """A field of a dataclass with its Setting."""
    return field(default=default, metadata={SETTING: Setting(low, high, option, choices)})


def setting_of(kind: Any, name: str) -> Setting:
    """The Setting of a dataclass's field."""
    declared: Setting = kind.__dataclass_fields__[name].metadata.get(SETTING, Setting())
    return declared


@dataclass(frozen=True, slots=True)
class Adaptive:
    """Numbers of stillness rule `adaptive` (G: Grammenos, Mascolo, Crowcroft 2018, section 4.4).

    Attributes:
        acceleration_factor: standard deviation of |a| stays below so many times its minimum (G: 2).
        rotation_factor: the same for the gyroscope, where there is one (G: 3).
        min_samples: a window has at least so many samples, however long they take (the standard
            deviation of 100 values is known to 7 %, so that the minimum over a week of windows is
            about two thirds of the usual one; of 30 values it would be less than half).
        min_windows: a state has at least so many windows (G gathers more once a first window has
            passed; 2, since |a| alone does not see a slow turn, but the means of two windows do).
        max_windows: a state has at most so many windows, then another begins (60: a minute at
            100 Hz), so that hours in one posture stay many windows with their own temperatures.
        held_windows: candidates wait until so many more have come, so that an early one is judged
            by a minimum that has settled (measured: 16384 are about 4.5 h of rest; 3 MB).
    """

    acceleration_factor: int = setting(2, 1, 30)
    rotation_factor: int = setting(3, 1, 30)
    min_samples: int = setting(100, 1, 1_000_000)
    min_windows: int = setting(2, 1, 1_000_000)
    max_windows: int = setting(60, 1, 1_000_000)
    held_windows: int = setting(1 << 14, 1, 1_000_000)


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
"""Rules of stillness, as in `--stillness`, and the settings that make them."""

RANGE_RULES = tuple(
    name for name, numbers in STILLNESS.items() if numbers["stillness_threshold_g"] is not None
)
"""Those that limit max - min."""


NO_PRIOR = "none"
STUDY_PRIOR, DEVICE_PRIOR = "study", "device"
LEARNT_PRIORS = (STUDY_PRIOR, DEVICE_PRIOR)
"""Priors that a study learns from other recordings."""

NEVER = "never"


@dataclass(frozen=True, slots=True)
class Settings:
    """What decides the result, besides the recording. All of it is in the report.

    Attributes:
        profile: `default`, or `paper` for F's procedure (docs/evaluation.md says what is added to it).
        optimizer: as in `--optimizer`.
        model: `auto`, or the model (9, 6, 3) the user insists on.
        prior: what is known of sensors before any point is seen (docs/prior.md): `population`, which DEFAULT
            has; `none`: the simplest model that held-out postures support; `study`, `device`: learnt from
            other recordings, and in the report. Older reports had none.
        recalibrate: `auto`, which DEFAULT has: the calibration follows a sensor that changes while it records
            (docs/change.md); or `never`: that is only told. Older reports did neither.
        temperature: whether a slope per axis may be fitted where the recording has temperature.
        stillness: rule of stillness, a key of STILLNESS, which sets the next five.
        segment_seconds: length of a window [s] (F II.B.1: 5 s; van Hees et al. 2014: 10 s; G 4.4:
            at least 1 s).
        stillness_threshold_g: max - min of a still window stays below [g] (F II.B.1: 0.12 g);
            None: not looked at.
        stillness_deviation_g: standard deviation of every axis stays below [g] (van Hees et al.
            2014: 13 mg); None: not looked at.
        stillness_axes: axes of the max - min rule (F: one, of its choice; here all, since slow movement
            across the other two passes a rule that looks at one).
        adaptive: numbers of rule `adaptive`; None for the others.
        longest_gap_s: a window goes on over gaps and steps back of the clock of at most so much [s], together
            no more than its own length; 0, which older reports had: over none (docs/stillness.md; phones
            lose up to 0.2 s at a time, and what is still before and after half a second hardly moved
            in between).
        cells_per_g: orientation cells per g on each axis (measured: 20; 10 leaves a bias).
        norm_low_g, norm_high_g: still windows with |mean| outside are implausible [g].
        posture_degrees: points within so many degrees are one posture.
        folds: number of posture-blocked folds.
        min_postures: fewer cannot hold nine unknowns (F II.B.1: nine distinct points).
        coverage_g: scale needs raw values beyond -this and +this on every axis [g] (van Hees
            et al. 2014: 0.3 g).
        max_error_mg: held-out error that a usable calibration stays below [mg] (van Hees: 10 mg).
        min_temperature_range_c: a slope needs at least this range of temperatures [degrees C].
        temperature_block_c: models are compared on postures within so many degrees C, so that what
            a slope brings shows where one posture was held at different temperatures.
        precision_mg: calibrated values are written in steps of at most so much [mg], a power of two
            of g, so that they compress; None: as exact as single precision is.
        latitude: where the recording was made [degrees]; None: rest measures 1 standard g.
        altitude_m: metres above the sea there.
        max_damage_percent: a recording of which damage has taken a larger share is refused [%]; what
            is left of it may not be what was worn.
        min_distance_g: every point of profile `paper` is at least so far from all others [g] (F II.B.1:
            a mean "differs sufficiently from the already acquired"; measured: 0.2); 0: anything goes.
        min_subset_points, max_subset_points: points in each of the nine subsets of profile `paper` (F II.B.1:
            2 and 2, 18 in all). With fewer in any, nothing is fitted; no subset takes more.
    """

    profile: str = setting(
        "default",
        option=Option("--profile", "`paper`: the published procedure, 18 points and 50 iterations."),
        choices=("default", "paper"),
    )
    optimizer: str = setting(
        "fixed32",
        option=Option("--optimizer", "Optimizer that finds the parameters, see docs/optimizers.md.", "NAME"),
    )
    model: str = setting(
        "auto",
        option=Option(
            "--model",
            "Parameters to fit, a number without a prior; auto: all, or with --prior none as many as help.",
        ),
        choices=("auto", "9", "6", "3"),
    )
    prior: str = setting(
        NO_PRIOR,
        option=Option(
            "--prior",
            "population: fit all parameters, helped by what is usual for sensors; none: use the simplest "
            "model that the recording supports; `accelcal study` also has study: what is usual for "
            "devices of the model, and device: the device's other recordings as well (docs/prior.md).",
            default="population; none with --model, --profile paper, and optimizers that know no prior",
        ),
        choices=("population", NO_PRIOR, *LEARNT_PRIORS),
    )
    recalibrate: str = setting(
        NEVER,
        option=Option(
            "--recalibrate",
            "auto: follow a sensor that changes while it records; never: only say so (docs/change.md).",
            default="auto",
        ),
        choices=("auto", NEVER),
    )
    temperature: bool = setting(
        True, option=Option("--no-temperature", "Do not use the recording's temperature.")
    )
    stillness: str = setting(
        "both",
        option=Option(
            "--stillness",
            "What counts as still, see docs/stillness.md.",
            default="both; profile paper: range",
        ),
        choices=tuple(STILLNESS),
    )
    segment_seconds: float = setting(
        5.0,
        1e-6,
        3600,
        Option("--segment-seconds", "Length of a window.", default="depends on --stillness", above=0),
    )
    stillness_threshold_g: float | None = setting(
        0.12,
        1e-9,
        4,
        Option(
            "--stillness-threshold-g",
            f"Largest max - min in a still window (rules {', '.join(RANGE_RULES)}).",
            above=0,
        ),
    )
    stillness_deviation_g: float | None = setting(0.013, 1e-9, 4)
    stillness_axes: tuple[int, ...] = setting(
        (0, 1, 2), 0, 2, Option("--stillness-axis", "Axis that rule range looks at: x, y or z.", default="x")
    )
    adaptive: Adaptive | None = None
    longest_gap_s: float = setting(
        0.0,
        0,
        10,
        Option(
            "--longest-gap",
            "Windows go on over gaps and steps back of stamps of at most this; 0: over none.",
            "SECONDS",
            default="0.5; profile paper: 0",
        ),
    )
    cells_per_g: int = setting(20, 1, 1000)
    norm_low_g: float = setting(0.5, 0, 10)
    norm_high_g: float = setting(1.5, 0, 10)
    posture_degrees: float = setting(15.0, 1e-3, 180)
    folds: int = setting(5, 2, 1000)
    min_postures: int = setting(9, 2, 1_000_000)
    coverage_g: float = setting(0.3, 0, 4)
    max_error_mg: float = setting(10.0, 0, 1e6)
    min_temperature_range_c: float = setting(2.0, 0, 1e3)
    temperature_block_c: float = setting(2.0, 1e-3, 1e3)
    precision_mg: float | None = setting(
        None,
        1e-3,
        1000,
        Option("--precision", "Round values to steps of at most MG, for smaller files.", "MG", "exact"),
    )
    latitude: float | None = setting(
        None, -90, 90, Option("--latitude", "Latitude of the place where the recording was made.", "DEGREES")
    )
    altitude_m: float | None = setting(
        None, -500, 9000, Option("--altitude", "Altitude above sea level.", "METRES", "0")
    )
    max_damage_percent: float = setting(
        50.0, 0, 100, Option("--max-damage", "Refuse a recording with more damage than this.", "PERCENT")
    )
    min_distance_g: float = setting(
        0.0,
        0,
        2,
        Option(
            "--min-distance-g",
            "Least distance between two points of profile paper; 0: none.",
            default="profile paper: 0.2",
        ),
    )
    min_subset_points: int = setting(
        2,
        1,
        100,
        Option("--min-subset-points", "Fewest points in each of the nine subsets of profile paper.", "N"),
    )
    max_subset_points: int = setting(
        2,
        1,
        100,
        Option("--max-subset-points", "Most points in each of the nine subsets of profile paper.", "N"),
    )

    @property
    def gravity(self) -> Gravity:
        """What rest measures."""
        return Gravity(self.latitude, self.altitude_m)

    def as_json(self) -> dict[str, Any]:
        """The report's `settings` object."""
        return asdict(self)


def _as_in_settings(name: str) -> Any:
    """A field with the default, the bounds and the option that it has in Settings."""
    same = Settings.__dataclass_fields__[name]
    return field(default=same.default, metadata=same.metadata)


POSES_IF_ASKED = ("unchecked", "roll")
"""Fields of PoseSettings that a report has only where they were asked for."""


@dataclass(frozen=True, slots=True)
class PoseSettings:
    """What decides a calibration from known orientations, besides the recording and its list of poses.

    Attributes:
        segment_seconds: length of a window [s]; short, since a face is held for seconds.
        stillness_threshold_g, stillness_deviation_g: as in `Settings`, on every axis.
        longest_gap_s: as in `Settings`.
        norm_low_g, norm_high_g: as in `Settings`; not asked of listed poses.
        face_degrees: a state within so many degrees of an axis lies on that face; wide, since raw
            values carry the very errors that are sought.
        state_degrees: windows within so many degrees of their state's mean belong to it.
        min_state_seconds: shorter states are left out [s]; not asked of listed poses.
        posture_degrees: listed references within so many degrees are held out together.
        max_condition: of the matrix [a 1]; the poses do not determine the parameters beyond.
        max_error_mg: as in `Settings`.
        max_vector_error_mg: held-out |a - reference| that a usable calibration stays below [mg]; one
            face tilted by a degree makes 12 mg of it.
        latitude, altitude_m, max_damage_percent: as in `Settings`.
        unchecked: poses that leave none to judge a fit by are fitted all the same.
        roll: where the device was rolled about a level axis, as given: `z,80,95`.
    """

    segment_seconds: float = setting(
        1.0, 1e-6, 3600, Option("--segment-seconds", "Length of a window.", bounds=(0.1, 60))
    )
    stillness_threshold_g: float = setting(
        0.12, 1e-9, 4, Option("--stillness-threshold-g", "Largest max - min in a still window.", above=0)
    )
    stillness_deviation_g: float = _as_in_settings("stillness_deviation_g")
    longest_gap_s: float = _as_in_settings("longest_gap_s")
    norm_low_g: float = _as_in_settings("norm_low_g")
    norm_high_g: float = _as_in_settings("norm_high_g")
    face_degrees: float = setting(
        15.0,
        0.1,
        90,
        Option(
            "--face-degrees", "Largest angle between the raw mean of a face and its axis.", bounds=(1, 45)
        ),
    )
    state_degrees: float = setting(2.0, 1e-3, 180)
    min_state_seconds: float = setting(2.0, 0, 3600)
    posture_degrees: float = _as_in_settings("posture_degrees")
    max_condition: float = setting(1000.0, 1, 1e9)
    max_error_mg: float = _as_in_settings("max_error_mg")
    max_vector_error_mg: float = setting(20.0, 0, 1e6)
    latitude: float | None = _as_in_settings("latitude")
    altitude_m: float | None = _as_in_settings("altitude_m")
    max_damage_percent: float = _as_in_settings("max_damage_percent")
    unchecked: bool = setting(
        False, option=Option("--unchecked", "Fit four poses too, of which none can be held out.")
    )
    roll: tuple[str, ...] = ()

    @property
    def gravity(self) -> Gravity:
        """What rest measures."""
        return Gravity(self.latitude, self.altitude_m)

    @property
    def profile(self) -> str:
        """What the report's `settings` call these."""
        return SIX_POSE

    @property
    def stillness(self) -> Settings:
        """The same as settings of the segmenter."""
        names = (
            "segment_seconds",
            "stillness_threshold_g",
            "stillness_deviation_g",
            "longest_gap_s",
            "norm_low_g",
            "norm_high_g",
            "latitude",
            "altitude_m",
        )
        return Settings(**{name: getattr(self, name) for name in names})

    def as_json(self) -> dict[str, Any]:
        """The report's `settings` object."""
        fixed = {"profile": self.profile, "optimizer": "least-squares", "model": "12", "temperature": False}
        held = {name: value for name, value in asdict(self).items() if value or name not in POSES_IF_ASKED}
        return {**fixed, "stillness": self.stillness.stillness, **held}


@dataclass(frozen=True, slots=True)
class EffectiveSettings:
    """All that decides a result besides the recording; the report's `settings`.

    Attributes:
        report_only: no calibrated recording is written.
        input: how the recording was read.
        poses: a session's list of poses, by name and hash; None in both: its faces were found.
        effect: what the calibration changes in measures of activity is found, too.
    """

    method: Settings | PoseSettings
    report_only: bool
    input: dict[str, Any]
    poses: tuple[str | None, str | None] = (None, None)
    effect: bool = False

    @property
    def precision_mg(self) -> float | None:
        """Longest step between calibrated values that are written; None: exact."""
        return self.method.precision_mg if isinstance(self.method, Settings) else None

    def as_json(self) -> dict[str, Any]:
        """The report's `settings` object."""
        names = ("poses", "poses_sha256") if isinstance(self.method, PoseSettings) else ()
        poses = dict(zip(names, self.poses, strict=False))
        asked = {"report_only": self.report_only, **({"effect": True} if self.effect else {})}
        return {**self.method.as_json(), **asked, **poses, "input": self.input}


def with_stillness(settings: Settings, name: str) -> Settings:
    """The settings with a rule of stillness and its own numbers."""
    return replace(settings, stillness=name, **STILLNESS[name])


DEFAULT = Settings(prior="population", recalibrate="auto", longest_gap_s=0.5)
PAPER = replace(with_stillness(Settings(), "range"), profile="paper", temperature=False, min_distance_g=0.2)
PROFILES = {"default": DEFAULT, "paper": PAPER}
POSES = PoseSettings(longest_gap_s=DEFAULT.longest_gap_s)
