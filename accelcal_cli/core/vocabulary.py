"""The units, and the names of sensors and times, that recordings use: one home for all formats.

A unit is known by any of its names, however it is punctuated (`find_unit`). A unit of acceleration is one
entry of `ACCELERATION_UNITS`: --unit, all formats, lists of poses and the advice in messages follow from it.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from fractions import Fraction
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.gravity import STANDARD_GRAVITY


@lru_cache(maxsize=4096)
def normalized(name: str) -> str:
    """Return a name in lower case without punctuation: `Sample_Rate [Hz]` gives `sampleratehz`."""
    return "".join(letter for letter in name.lower() if letter.isalnum())


@dataclass(frozen=True, slots=True)
class AccelerationUnit:
    """A unit of acceleration.

    Attributes:
        per_g: how much of it is one standard g, exactly.
        rest: between these the median length of acceleration at rest lies, in the unit; None if no length
            tells it, since the unit is always stated.
        names: in lower case.
        pose_ending: the end of the names of columns in a list of poses; None if it is not used there.
    """

    per_g: Fraction
    rest: tuple[float, float] | None
    names: tuple[str, ...]
    pose_ending: str | None = None


GRAVITY = Fraction(str(STANDARD_GRAVITY))
ACCELERATION_UNITS = {
    "g": AccelerationUnit(
        per_g=Fraction(1),
        rest=(0.7, 1.4),
        names=(*("g", "gravity", "gs", "gn", "g0", "gee", "grav", "gravities", "gforce"), "standardgravity"),
        pose_ending="_g",
    ),
    "mg": AccelerationUnit(
        per_g=Fraction(1000),
        rest=(700.0, 1400.0),
        names=("mg", "millig", "milli-g", "mgn", "milligs", "milligee", "mgravity"),
    ),
    "m/s2": AccelerationUnit(
        per_g=GRAVITY,
        rest=(7.0, 13.0),
        names=(
            *("m/s2", "m/s^2", "m/s²", "m/s/s", "ms-2", "m/ss", "m/sec2", "m/(s^2", "mps2", "mpss"),
            *("mpers2", "m/secs2", "meterpersecondsquared", "meterspersecondsquared"),
            *("meterspersecond2", "meterpersecond2", "metrespersecondsquared"),
        ),
        pose_ending="_ms2",
    ),
    "cm/s2": AccelerationUnit(
        per_g=100 * GRAVITY, rest=None, names=("cm/s2", "cm/s²", "cm/s/s", "gal", "gals", "cm/sec2")
    ),
    "mm/s2": AccelerationUnit(per_g=1000 * GRAVITY, rest=None, names=("mm/s2", "mm/s²", "mm/s/s", "mm/sec2")),
    "ft/s2": AccelerationUnit(
        per_g=GRAVITY / Fraction("0.3048"), rest=None, names=("ft/s2", "ft/s²", "ft/s/s", "ft/sec2")
    ),
}
"""The units of acceleration by their names on the command line and in reports."""

PER_G = {name: float(unit.per_g) for name, unit in ACCELERATION_UNITS.items()}
"""How much of each unit is one standard g."""

COUNTS = "counts"
"""The name of raw counts of a sensor in place of a unit."""

USUAL_UNITS = tuple(name for name, unit in ACCELERATION_UNITS.items() if unit.rest is not None)
"""The units that people name, and that the length of gravity can tell."""

UNIT_CHOICES = (*USUAL_UNITS, COUNTS)
"""The choices of --unit."""

PHYSICAL_UNITS = f"{', '.join(USUAL_UNITS[:-1])} or {USUAL_UNITS[-1]}"
"""The units in words, for advice."""

GIVE_UNIT = f"give --unit {PHYSICAL_UNITS}, or --unit counts with --lsb-per-g"
"""Advice where the unit of a file is not known."""

COUNT_NAMES = (
    *("counts", "count", "lsb", "lsbs", "raw", "adc", "adccounts", "adu", "digit", "digits", "bits"),
    "rawcounts",
)
"""Names of counts in place of a unit."""

ROTATIONS: Mapping[float, tuple[str, ...]] = {
    1.0: (
        *("deg/s", "dps", "°/s", "deg/sec", "degree/s", "degrees/s", "degps", "degpersec", "deg/s1"),
        *("degreespersecond", "degpersecond"),
    ),
    1000.0: ("mdps", "mdeg/s", "mdeg/sec", "millideg/s"),
    math.pi / 180: (
        *("rad/s", "rad/sec", "rps", "radps", "radianspersecond", "radians/s", "rad/s1", "radpersec"),
    ),
}
"""Names of units of rotation rate, by how much of them is 1 deg/s."""

TEMPERATURES: Mapping[float, tuple[str, ...]] = {
    1.0: (
        *("c", "degc", "°c", "celsius", "degreescelsius", "degreesc", "degreec", "degreecelsius"),
        *("gradc", "gradcelsius", "ºc"),
    ),
    1000.0: (*("mc", "mdegc", "millidegc", "millicelsius", "millidegreescelsius", "millidegreecelsius"),),
}
"""Names of units of temperature, by how much of them is 1 degree Celsius."""

OTHER_TEMPERATURES = ("f", "degf", "°f", "fahrenheit", "degreesfahrenheit", "k", "degk", "kelvin")
"""Names of units of temperature with another zero."""

PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
"""How many of each unit of time are one second."""

DURATIONS: Mapping[str, tuple[str, ...]] = {
    "s": ("s", "sec", "secs", "second", "seconds"),
    "ms": ("ms", "msec", "millisecond", "milliseconds", "millis", "millisec"),
    "us": ("us", "usec", "microsecond", "microseconds", "µs", "μs", "micros"),
    "ns": ("ns", "nsec", "nanosecond", "nanoseconds", "nanos"),
}
"""Names of units of time."""

OTHER_UNITS = (
    *("gauss", "mgauss", "ut", "µt", "μt", "nt", "mt", "tesla", "microtesla"),
    *("deg", "°", "rad", "degrees", "radians", "rad/s2", "rad/s^2", "deg/s2", "m/s", "km/h", "m/s3", "m"),
    *("mm", "cm", "km", "hz", "v", "mv", "volt", "volts", "a", "ma", "pa", "hpa", "kpa", "mbar", "bar"),
    *("lux", "lx", "db", "dbm", "bpm", "%", "percent", "ohm", "kohm", "us/cm", "cal", "kcal", "rpm"),
    *("local_flux",),
)
"""Names of units of other quantities: what has one is not acceleration."""


class Quantity(Enum):
    """The quantity that a unit is of."""

    ACCELERATION = "acceleration"
    COUNTS = "counts"
    ROTATION = "rotation"
    TIME = "time"
    TEMPERATURE = "temperature"
    OTHER = "other"


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit by its quantity.

    Attributes:
        name: as in options and reports: g, mg, m/s2, counts, s, ms, us, ns; of other quantities as written.
        per: how much of it is 1 g, 1 deg/s, 1 s or 1 degree Celsius.
    """

    quantity: Quantity
    name: str
    per: float = 1.0


def _units() -> dict[str, Unit]:
    """Return all units by their names in lower case; the first of two of one name counts."""
    units = [
        *(
            (name, unit.names, Quantity.ACCELERATION, PER_G[name])
            for name, unit in ACCELERATION_UNITS.items()
        ),
        (COUNTS, COUNT_NAMES, Quantity.COUNTS, 1.0),
        *(("deg/s", names, Quantity.ROTATION, per) for per, names in ROTATIONS.items()),
        *((name, names, Quantity.TIME, PER_SECOND[name]) for name, names in DURATIONS.items()),
        *(("C", names, Quantity.TEMPERATURE, per) for per, names in TEMPERATURES.items()),
        *((name, (name,), Quantity.TEMPERATURE, 1.0) for name in OTHER_TEMPERATURES),
        *((name, (name,), Quantity.OTHER, 1.0) for name in OTHER_UNITS),
    ]
    found: dict[str, Unit] = {}
    for name, names, quantity, per in units:
        for one in names:
            found.setdefault(one, Unit(quantity, name, per))
    return found


UNITS = _units()
"""All units by their names as they are written, in lower case."""

UNITS_WITHOUT_MARKS = {
    normalized(name): unit
    for name, unit in reversed(UNITS.items())
    if normalized(name) and not (unit.quantity is Quantity.OTHER and not name.isalpha())
}
"""The same by names without punctuation: `m/(s^2)` and `ms2` are one; of two the first counts."""


@lru_cache(maxsize=4096)
def find_unit(text: str) -> Unit | None:
    """Return the unit of a text such as `m/s^2`, `[mg]` or `Meters per Second squared`; None without one."""
    plain = text.strip().strip("[](){}").strip().lower()
    return UNITS.get(plain) or UNITS_WITHOUT_MARKS.get(normalized(plain))


def unit_of(text: str, quantity: Quantity) -> Unit | None:
    """Return the unit of a text if it is one of a quantity, else None."""
    unit = find_unit(text)
    return unit if unit is not None and unit.quantity is quantity else None


def acceleration_unit(text: str) -> str | None:
    """Return g, mg, m/s2, ... or counts for a text such as `m/s^2`; None for any other text."""
    unit = find_unit(text)
    known = unit is not None and unit.quantity in (Quantity.ACCELERATION, Quantity.COUNTS)
    return unit.name if unit is not None and known else None


ACCELEROMETER = frozenset({
    *("acc", "accel", "acceleration", "accelerometer", "accelerations", "accelero", "accels"),
    *("accelerometers", "accelerometerdata", "acceldata", "accdata", "accelraw", "rawaccel", "rawacc"),
    *("accelxyz", "accxyz", "accelerationxyz"),
})  # fmt: skip
"""Words of an accelerometer's columns."""

BARE_ACCELEROMETER = frozenset({"raw", "xyz"})
"""Words that name an accelerometer where nothing else is said."""

GYROSCOPE = frozenset({
    *("gyro", "gyr", "gyroscope", "gyros", "gyroscopes", "omega", "gyrodata", "gyroraw", "gyroxyz"),
    *("gyroscopexyz", "angularvelocity", "angularrate", "rotationrate"),
})  # fmt: skip
"""Words of a gyroscope's columns."""

THERMOMETER = ("temp", "temperature")
"""Words of a column of temperatures."""

TIMES = frozenset({
    *("time", "timestamp", "timestamps", "datetime", "epoch", "unixtime", "unix", "utc", "ts", "date"),
    *("times", "epochtime", "epoc"),
})  # fmt: skip
"""Words of a column of times."""

BARE_TIMES = frozenset({
    *("t", "s", "ms", "us", "seconds", "millis", "micros", "milliseconds", "microseconds", "elapsed"),
})  # fmt: skip
"""Names of a column of times that consist of this word alone."""

NOT_RAW = frozenset({"gravity", "linear", "lin", "free"})
"""Words of an acceleration that was computed from the measured one."""

OWNERS = frozenset({
    *("sensor", "device", "imu", "accelerometer", "node", "serial", "mac", "watch", "subject", "subj"),
    *("sub", "participant", "person", "patient", "user", "wearer", "volunteer", "child", "infant"),
    *("animal", "dog", "pid", "sid", "uid", "uuid", "sn", "ppt", "ppid"),
})  # fmt: skip
"""Words in the name of a column that tells whose its rows are."""

PLACES = frozenset({
    *("id", "location", "loc", "position", "pos", "placement", "place", "site", "side", "limb", "body"),
    *("bodypart", "part", "segment", "channel", "source", "stream", "group", "module", "board", "port"),
    *("joint", "who", "hand", "wrist", "arm", "foot", "leg", "ankle", "name", "file", "filename"),
    *("recording", "tag"),
})  # fmt: skip
"""Words in the name of a column that may tell whose its rows are, or where their wearer was."""

LABELS = frozenset({
    *("activity", "label", "class", "event", "marker", "mark", "button", "annotation", "state", "status"),
    *("flag", "wear", "worn", "nonwear", "sleep", "wake", "posture", "behavior", "behaviour", "motion"),
    *("mode", "valid", "validity", "quality", "task", "condition", "exercise", "phase", "period", "block"),
    *("session", "trial", "window", "bout", "lap", "rep", "set", "day", "weekday", "date", "week", "month"),
    *("year", "night", "hour", "minute", "run", "visit", "stage", "target", "moving", "charging"),
    *("comment", "note"),
})  # fmt: skip
"""Words in the name of a column that tells what went on, or in which part of a recording its rows are."""

NEUTRAL = frozenset({"id", "name", "number", "n", "nr", "no", "num", "label", "class", "type", "code", "key"})
"""Words in the name of a column that add nothing to others."""

MEASURES = frozenset({
    *("temp", "temperature", "light", "lux", "battery", "bat", "batt", "voltage", "volt", "vbat"),
    *("pressure", "humidity", "hr", "heart", "heartrate", "bpm", "ppg", "eda", "gsr", "ecg", "emg", "ibi"),
    *("rssi", "steps", "gyro", "gyr", "gyroscope", "mag", "magnetometer", "magnitude", "vm", "enmo", "lat"),
    *("latitude", "lon", "longitude", "altitude", "speed", "index", "idx", "row", "sample", "samples"),
    *("count", "counter", "packet", "seq", "sequence", "frame", "line", "number", "n", "nr", "checksum"),
    *("crc", "time", "timestamp", "step", "second", "seconds", "ms", "millis", "tick", "ticks", "roll"),
    *("pitch", "yaw", "qw", "qx", "qy", "qz"),
})  # fmt: skip
"""Words in the name of a column that measures or counts something."""

QUANTITIES: Mapping[str, tuple[str, ...]] = {
    "light": ("light", "lux", "lx", "illuminance", "lightadc", "ambientlight", "als"),
    "button": ("button", "btn", "pushbutton"),
    "battery": ("battery", "batt", "bat", "vbat", "vbatt", "batteryadc"),
    "pressure": ("pressure", "press", "baro", "barometer", "barometric"),
    "humidity": ("humidity", "rh"),
    "heart_rate": ("heartrate", "hr", "bpm"),
    "capsense": ("capsense", "capacitive", "capacitance"),
    "skin_contact": ("skincontact",),
    "eda": ("eda", "gsr"),
    "ppg": ("ppg", "bvp"),
    "ecg": ("ecg", "ekg"),
}
"""Further quantities that are recorded with motion, by words of their columns' names; the first counts."""

UNKNOWN_UNIT = "unknown"
"""The unit of a quantity for which a file states none."""


def quantity_of(words: Sequence[str]) -> str | None:
    """Return the quantity of QUANTITIES that the words of a name are of; None for other names."""
    own = {*words, *(first + second for first, second in pairwise(words))}
    if own & {*THERMOMETER}:
        return None
    return next((name for name, known in QUANTITIES.items() if own & {*known}), None)


ABOUT_PEOPLE = frozenset({
    *("age", "sex", "gender", "birth", "weight", "height", "bmi", "kg", "cm", "bed", "nap", "naps", "onset"),
    *("getup", "lights", "bedtime", "waketime", "wakeup", "score", "distance", "systolic", "diastolic", "rr"),
    *("spo2", "duration", "calendar", "hours", "minutes", "steps", "gps", "hrv", "rmssd", "respiration"),
    *("questionnaire", "item", "answer", "comments", "start", "end", "spt", "sib", "bouts", "hz", "valid"),
})  # fmt: skip
"""Words in the name of a column of a diary, a questionnaire or a summary."""


# Columns of temperatures: their names and units, in tables of all kinds.

NEAR = "(?:device|die|chip|sensor|board|imu|mcu|cpu|internal|case|accelerometer|accel|acc)*"
HEAT = re.compile(rf"{NEAR}(temperatur(?:e|es|a)?|temperatuur|temps?|tmp|温度|온도|температура){NEAR}")
"""Normalized names of the temperature of a device."""

WORD = re.compile(r"(?:^|[^a-z])(?:temp|tmp|temperatur\w*|therm\w*)(?:$|[^a-z])")
"""A word for temperature in a name in lower case."""

BARE = "T"
"""The name that actipy gives to temperatures; where it is the only column of times, it is one of these."""


@dataclass(frozen=True, slots=True)
class HeatUnit:
    """A unit of temperature: how many of it are 1 degree, and how many are 0 degrees Celsius."""

    name: str
    per_degree: float
    zero: float = 0.0

    def celsius(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return values (n,) in degrees Celsius."""
        if self == CELSIUS:
            return values
        return (values - self.zero) / self.per_degree


CELSIUS, FAHRENHEIT = HeatUnit("degrees Celsius", 1.0), HeatUnit("degrees Fahrenheit", 1.8, 32.0)
KELVIN, MILLI = HeatUnit("kelvin", 1.0, 273.15), HeatUnit("thousandths of a degree Celsius", 1000.0)

TEMPERATURE_UNITS: dict[str, HeatUnit] = {
    **{
        normalized(name): CELSIUS if size == 1 else MILLI
        for size, names in TEMPERATURES.items()
        for name in names
    },
    "deg": CELSIUS,
    **dict.fromkeys(("f", "degf", "fahrenheit", "degreesfahrenheit", "degreesf", "ºf"), FAHRENHEIT),
    **dict.fromkeys(("k", "degk", "kelvin"), KELVIN),
}
"""Units by their normalized names."""

WHOLE_WORDS = ("celsius", "kelvin", "fahrenheit")
"""Names of units that say by themselves that a column `t_celsius` is a temperature."""

BY_VALUES = ((CELSIUS, -40.0, 60.0), (FAHRENHEIT, 60.0, 120.0), (KELVIN, 263.0, 333.0))
"""Units by the median of values in them; what is beyond Celsius must have decimals: raw counts have none."""


@dataclass(frozen=True, slots=True)
class Thermometer:
    """A column of temperatures.

    Attributes:
        number: of the column among those that were looked at.
        unit: None if only its values can tell.
    """

    number: int
    unit: HeatUnit | None


def find_thermometer(columns: Sequence[tuple[str, str | None]]) -> tuple[Thermometer | None, tuple[int, ...]]:
    """Return the temperature of the device, None if there is none or several, and columns that look like one.

    Args:
        columns: name and stated unit of each, that of times left out.
    """
    known, looking = [], []
    for number, (name, stated) in enumerate(columns):
        found = _named(name)
        if found is not None:
            rank, unit = found
            known.append((rank, number, stated or unit))
        elif WORD.search(re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower()):
            looking.append(number)
    best = [(number, unit) for rank, number, unit in known if rank == min(known)[0]]
    if len(best) != 1:
        return None, tuple(sorted([*looking, *(number for _, number, _ in known)]))
    (number, unit), others = best[0], [one for _, one, _ in known if one != best[0][0]]
    if unit and normalized(unit) not in TEMPERATURE_UNITS and unit.strip():
        return None, tuple(sorted([*looking, number, *others]))
    return Thermometer(number, TEMPERATURE_UNITS.get(normalized(unit or ""))), tuple(
        sorted([*looking, *others])
    )


def _named(name: str) -> tuple[int, str | None] | None:
    """Return how far a name is from `temperature`, and the unit in it; None for other names."""
    bracket = re.fullmatch(r"([^\[(]*)[\[(]([^\])]*)[\])]?\s*", name)
    plain, unit = (bracket[1], bracket[2]) if bracket else (name, None)
    text = normalized(_unaccented(plain))
    endings = ["", *sorted(TEMPERATURE_UNITS, key=len, reverse=True)] if unit is None else [""]
    for ending in endings:
        rest = text.removesuffix(ending)
        if ending and not text.endswith(ending):
            continue
        if rest == "t" and (plain.strip().startswith(BARE) or ending in WHOLE_WORDS):
            return 1, unit or ending or None
        if found := HEAT.fullmatch(rest):
            return (0 if found[1] == rest else 2), unit or ending or None
    return None


def _unaccented(name: str) -> str:
    """Return a name without accents and marks: `température` gives `temperature`."""
    return "".join(one for one in unicodedata.normalize("NFD", name) if not unicodedata.combining(one))


def unit_by_values(values: NDArray[np.float64]) -> HeatUnit | None:
    """Return the unit of temperatures (n,) that is the only possible one; None if none is."""
    known = values[np.isfinite(values)]
    if not len(known):
        return None
    middle, whole = float(np.median(known)), bool((known == np.rint(known)).all())
    fitting = [
        unit for unit, low, high in BY_VALUES if low <= middle <= high and not (whole and unit != CELSIUS)
    ]
    return fitting[0] if fitting else None
