"""Every tunable of the method: name, unit, default, source. One place."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

from accelcal_cli.core.gravity import Gravity


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

    acceleration_factor: int = 2
    rotation_factor: int = 3
    min_samples: int = 100
    min_windows: int = 2
    max_windows: int = 60
    held_windows: int = 1 << 14


@dataclass(frozen=True, slots=True)
class Settings:
    """What decides the result, besides the recording. All of it is in the report.

    Attributes:
        profile: `default`, or `paper` for F's procedure to the letter.
        optimizer: as in `--optimizer`.
        model: `auto`, or the model (9, 6, 3) the user insists on.
        temperature: whether a slope per axis may be fitted where the recording has temperature.
        stillness: rule of stillness, a key of STILLNESS, which sets the next five.
        segment_seconds: length of a window [s] (F II.B.1: 5 s; van Hees et al. 2014: 10 s; G 4.4:
            at least 1 s).
        stillness_threshold_g: max - min of a still window stays below [g] (F II.B.1: 0.12 g);
            None: not looked at.
        stillness_deviation_g: standard deviation of every axis stays below [g] (van Hees et al.
            2014: 13 mg); None: not looked at.
        stillness_axes: axes of the max - min rule (F: one; here all, since slow movement across
            the other two passes a rule that looks at one).
        adaptive: numbers of rule `adaptive`; None for the others.
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
    """

    profile: str = "default"
    optimizer: str = "fixed32"
    model: str = "auto"
    temperature: bool = True
    stillness: str = "both"
    segment_seconds: float = 5.0
    stillness_threshold_g: float | None = 0.12
    stillness_deviation_g: float | None = 0.013
    stillness_axes: tuple[int, ...] = (0, 1, 2)
    adaptive: Adaptive | None = None
    cells_per_g: int = 20
    norm_low_g: float = 0.5
    norm_high_g: float = 1.5
    posture_degrees: float = 15.0
    folds: int = 5
    min_postures: int = 9
    coverage_g: float = 0.3
    max_error_mg: float = 10.0
    min_temperature_range_c: float = 2.0
    temperature_block_c: float = 2.0
    precision_mg: float | None = None
    latitude: float | None = None
    altitude_m: float | None = None
    max_damage_percent: float = 50.0

    @property
    def gravity(self) -> Gravity:
        """What rest measures."""
        return Gravity(self.latitude, self.altitude_m)

    def as_json(self) -> dict[str, Any]:
        """The report's `settings` object."""
        return asdict(self)


SIX_POSE = "six-pose"
"""The profile that reports of known orientations name."""


@dataclass(frozen=True, slots=True)
class PoseSettings:
    """What decides a calibration from known orientations, besides the recording and its list of poses.

    Attributes:
        segment_seconds: length of a window [s]; short, since a face is held for seconds.
        stillness_threshold_g, stillness_deviation_g: as in `Settings`, on every axis.
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
    """

    segment_seconds: float = 1.0
    stillness_threshold_g: float = 0.12
    stillness_deviation_g: float = 0.013
    norm_low_g: float = 0.5
    norm_high_g: float = 1.5
    face_degrees: float = 15.0
    state_degrees: float = 2.0
    min_state_seconds: float = 2.0
    posture_degrees: float = 15.0
    max_condition: float = 1000.0
    max_error_mg: float = 10.0
    max_vector_error_mg: float = 20.0
    latitude: float | None = None
    altitude_m: float | None = None
    max_damage_percent: float = 50.0

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
            "latitude",
            "altitude_m",
        )
        bounds = ("norm_low_g", "norm_high_g")
        return Settings(**{name: getattr(self, name) for name in names + bounds})

    def as_json(self) -> dict[str, Any]:
        """The report's `settings` object."""
        fixed = {"profile": self.profile, "optimizer": "least-squares", "model": "12", "temperature": False}
        return {**fixed, "stillness": self.stillness.stillness, **asdict(self)}


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
    "adaptive": {
        **_UNUSED,
        "segment_seconds": 1.0,
        "stillness_deviation_g": None,
        "adaptive": Adaptive(),
    },
}
"""Rules of stillness, as in `--stillness`, and the settings that make them."""


def with_stillness(settings: Settings, name: str) -> Settings:
    """The settings with a rule of stillness and its own numbers."""
    return replace(settings, stillness=name, **STILLNESS[name])


DEFAULT = Settings()
PAPER = replace(with_stillness(DEFAULT, "range"), profile="paper", temperature=False)
PROFILES = {"default": DEFAULT, "paper": PAPER}
