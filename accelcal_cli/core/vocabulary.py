"""The units, and the names of sensors and times, that recordings use: one home for all formats.

Each name stands with the kinds of files in which it is understood (`In`). They differ, because a name that is
new to a kind of file could change what such a file means. A reader takes the `Vocabulary` of its files. A
unit of acceleration is one entry of `ACCELERATION_UNITS`: --unit, all formats, lists of poses and the advice
in messages follow from it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Flag, auto
from fractions import Fraction
from functools import lru_cache
from typing import TypeVar

from accelcal_cli.core.gravity import STANDARD_GRAVITY

Unit = TypeVar("Unit", str, float)


class In(Flag):
    """The kinds of files that understand a name."""

    CSV = auto()
    TABLES = auto()
    """HDF5, Parquet, Feather, NumPy and MATLAB files; names are compared as `normalized` gives them."""

    AXES = auto()
    """Columns of one axis in these files: the name stands before or behind x, y or z."""

    EDF = auto()
    UNISENS = auto()
    ALL = CSV | TABLES | AXES | EDF | UNISENS


Names = Mapping[In, tuple[str, ...]]
"""Names in lower case, by the kinds of files that understand them."""


@lru_cache(maxsize=4096)
def normalized(name: str) -> str:
    """Return a name in lower case without punctuation: `Sample_Rate [Hz]` gives `sampleratehz`."""
    return "".join(letter for letter in name.lower() if letter.isalnum())


@dataclass(frozen=True, slots=True)
class AccelerationUnit:
    """A unit of acceleration.

    Attributes:
        per_g: how much of it is one standard g, exactly.
        rest: between these the median length of acceleration at rest lies, in the unit.
        ending: a pattern of the unit at the end of a column's name in a table, such as `acc_x_mg`.
        pose_ending: the end of the names of columns in a list of poses; None if it is not used there.
    """

    per_g: Fraction
    rest: tuple[float, float]
    names: Names
    ending: str
    pose_ending: str | None = None


ACCELERATION_UNITS = {
    "g": AccelerationUnit(
        per_g=Fraction(1),
        rest=(0.7, 1.4),
        names={
            In.ALL: ("g",),
            In.CSV | In.TABLES | In.EDF: ("gravity",),
            In.CSV | In.TABLES: ("gs",),
            In.CSV | In.EDF: ("gn", "g0"),
            In.TABLES: ("gee", "grav", "gravities", "gforce", "standardgravity"),
        },
        ending="g",
        pose_ending="_g",
    ),
    "mg": AccelerationUnit(
        per_g=Fraction(1000),
        rest=(700.0, 1400.0),
        names={
            In.ALL: ("mg",),
            In.CSV | In.TABLES | In.EDF: ("millig", "milli-g"),
            In.EDF: ("mgn",),
            In.TABLES: ("milligs", "milligee", "mgravity"),
        },
        ending="mg",
    ),
    "m/s2": AccelerationUnit(
        per_g=Fraction(str(STANDARD_GRAVITY)),
        rest=(7.0, 13.0),
        names={
            In.ALL: ("m/s2", "m/s^2", "m/s²"),
            In.CSV | In.TABLES | In.EDF: ("m/s/s", "ms-2"),
            In.CSV | In.TABLES: (
                *("m/s**2", "m/(s^2)", "m/(s^2", "mps2", "ms2", "ms^-2", "m.s-2", "m s-2", "m s^-2"),
            ),
            In.EDF: ("m/ss", "m/sec2", "m/sec^2"),
            In.TABLES: (
                "mpss",
                "mpers2",
                "meterpersecondsquared",
                "meterspersecondsquared",
                "meterspersecond2",
            ),
        },
        ending=r"m[/_ ]?s(?:ec)?(?:\^|\*\*)?-?[2²]|m/s/s",
        pose_ending="_ms2",
    ),
}
"""The units of acceleration by their names on the command line and in reports."""

PER_G = {name: float(unit.per_g) for name, unit in ACCELERATION_UNITS.items()}
"""How much of each unit is one standard g."""

COUNTS = "counts"
"""The name of raw counts of a sensor in place of a unit."""

UNIT_CHOICES = (*ACCELERATION_UNITS, COUNTS)
"""The choices of --unit."""

PHYSICAL_UNITS = f"{', '.join([*ACCELERATION_UNITS][:-1])} or {[*ACCELERATION_UNITS][-1]}"
"""The units in words, for advice."""

GIVE_UNIT = f"give --unit {PHYSICAL_UNITS}, or --unit counts with --lsb-per-g"
"""Advice where the unit of a file is not known."""

ACCELERATIONS: Mapping[str, Names] = {
    **{name: unit.names for name, unit in ACCELERATION_UNITS.items()},
    COUNTS: {
        In.CSV | In.TABLES: ("counts", "count", "lsb", "raw", "adc", "digits"),
        In.TABLES: ("lsbs", "adccounts", "adu", "digit", "bits", "rawcounts"),
    },
}
"""Names of units of acceleration, and of counts."""

ROTATIONS: Mapping[float, Names] = {
    1.0: {
        In.ALL: ("deg/s", "dps", "°/s"),
        In.CSV | In.TABLES | In.EDF: ("deg/sec",),
        In.EDF: ("degree/s",),
        In.TABLES: ("degps", "degpersec", "degreespersecond", "degreess", "degs1", "degpersecond"),
    },
    1000.0: {In.TABLES: ("mdps", "mdegs", "mdegsec", "millidegs")},
    math.pi / 180: {
        In.CSV | In.TABLES: ("rad/s",),
        In.TABLES: ("radsec", "rps", "radps", "radianspersecond", "radianss", "rads1", "radpersec"),
    },
}
"""Names of units of rotation rate, by how much of them is 1 deg/s."""

TEMPERATURES: Mapping[float, Names] = {
    1.0: {
        In.CSV | In.TABLES | In.EDF: ("c", "degc", "°c", "celsius"),
        In.TABLES | In.EDF: ("deg c",),
        In.TABLES: ("degreescelsius", "degreesc", "degreec", "degreecelsius"),
    },
    1000.0: {
        In.TABLES: (
            *("mc", "mdegc", "millidegc", "millicelsius"),
            *("millidegreescelsius", "millidegreecelsius"),
        )
    },
}
"""Names of units of temperature, by how much of them is 1 degree Celsius."""

PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
"""How many of each unit of time are one second."""

DURATIONS: Mapping[str, Names] = {
    "s": {In.CSV | In.TABLES: ("s", "sec", "secs", "second", "seconds")},
    "ms": {
        In.CSV | In.TABLES: ("ms", "msec", "millisecond", "milliseconds", "millis", "millisec"),
    },
    "us": {
        In.CSV | In.TABLES: ("us", "usec", "microsecond", "microseconds", "µs", "μs", "micros"),
    },
    "ns": {In.CSV | In.TABLES: ("ns", "nsec", "nanosecond", "nanoseconds", "nanos")},
}
"""Names of units of time."""

UNIT_AT_END = re.compile(
    r"(.*[a-z0-9\])]?)[\s_\[(./:-]+("
    + "|".join(unit.ending for unit in ACCELERATION_UNITS.values())
    + r"|counts?|lsb|dps|deg[/_]?s(?:ec)?|°/s|rad[/_]?s(?:ec)?)[\])]?",
    re.IGNORECASE,
)
"""The name of a column in a table, and the unit at its end."""

ACCELEROMETER: Names = {
    In.ALL: ("acc",),
    In.CSV | In.TABLES | In.AXES | In.EDF: ("accel", "acceleration", "accelerometer"),
    In.CSV | In.TABLES: ("accelerations",),
    In.CSV | In.AXES: ("a",),
    In.AXES: ("",),
    In.EDF: ("accelero",),
    In.TABLES: (
        *("accels", "accelerometers", "accelerometerdata", "acceldata", "accdata", "accelraw", "rawaccel"),
        *("rawacc", "accelxyz", "accxyz", "accelerationxyz", "xyz", "raw"),
    ),
}
"""Names of an accelerometer's columns."""

GYROSCOPE: Names = {
    In.ALL: ("gyro",),
    In.CSV | In.TABLES | In.AXES | In.EDF: ("gyr", "gyroscope"),
    In.CSV | In.TABLES: ("gyros", "gyroscopes"),
    In.CSV: ("omega",),
    In.AXES: ("g",),
    In.TABLES: ("gyrodata", "gyroraw", "gyroxyz", "gyroscopexyz", "angularvelocity"),
    In.UNISENS: ("angularrate",),
}
"""Names of a gyroscope's columns."""

THERMOMETER: Names = {
    In.ALL: ("temp", "temperature"),
    In.TABLES: ("temperaturec", "tempc", "temperaturedegc"),
}
"""Names of a column of temperatures."""

TIMES: Names = {
    In.CSV | In.TABLES: ("time", "timestamp", "timestamps", "datetime", "epoch", "unixtime"),
    In.CSV: ("unix", "utc", "ts", "date"),
    In.TABLES: ("times", "t", "epochtime"),
}
"""Names of a column of times."""

BARE_TIMES = frozenset({
    *("t", "s", "ms", "us", "seconds", "millis", "micros", "milliseconds", "microseconds", "elapsed"),
})  # fmt: skip
"""Names of a column of times that consist of this word alone."""

NOT_RAW = frozenset({"gravity", "linear", "lin", "free"})
"""Words of an acceleration that was computed from the measured one."""


@dataclass(frozen=True, slots=True)
class Vocabulary:
    """The names that one kind of files understands, in lower case; in TABLES, normalized.

    Attributes:
        accelerometer, gyroscope, thermometer, times: names of their columns.
        accelerations: unit of acceleration, or `counts`, by its names.
        rotations, temperatures: how much of a unit is 1 deg/s or 1 degree Celsius, by the unit's names.
        durations: unit of time by its names.
    """

    accelerometer: frozenset[str]
    gyroscope: frozenset[str]
    thermometer: frozenset[str]
    times: frozenset[str]
    accelerations: Mapping[str, str]
    rotations: Mapping[str, float]
    temperatures: Mapping[str, float]
    durations: Mapping[str, str]


def _vocabulary(files: In) -> Vocabulary:
    return Vocabulary(
        accelerometer=frozenset(_names(ACCELEROMETER, files)),
        gyroscope=frozenset(_names(GYROSCOPE, files)),
        thermometer=frozenset(_names(THERMOMETER, files)),
        times=frozenset(_names(TIMES, files)),
        accelerations=_by_name(ACCELERATIONS, files),
        rotations=_by_name(ROTATIONS, files),
        temperatures=_by_name(TEMPERATURES, files),
        durations=_by_name(DURATIONS, files),
    )


def _names(names: Names, files: In) -> list[str]:
    return [name for known, some in names.items() if known & files for name in some]


def _by_name(units: Mapping[Unit, Names], files: In) -> dict[str, Unit]:
    found = {name: unit for unit, names in units.items() for name in _names(names, files)}
    return {normalized(name): unit for name, unit in found.items()} if files is In.TABLES else found


CSV = _vocabulary(In.CSV)
"""Text files understand these names."""

TABLES = _vocabulary(In.TABLES)
"""HDF5, Parquet, Feather, NumPy and MATLAB files understand these names."""

AXES = _vocabulary(In.AXES)
"""Columns of one axis in tables have these names before or behind x, y or z."""

EDF = _vocabulary(In.EDF)
"""EDF files understand these names."""

UNISENS = _vocabulary(In.UNISENS)
"""Descriptions of Unisens recordings understand these names."""

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

ABOUT_PEOPLE = frozenset({
    *("age", "sex", "gender", "birth", "weight", "height", "bmi", "kg", "cm", "bed", "nap", "naps", "onset"),
    *("getup", "lights", "bedtime", "waketime", "wakeup", "score", "distance", "systolic", "diastolic", "rr"),
    *("spo2", "duration", "calendar", "hours", "minutes", "steps", "gps", "hrv", "rmssd", "respiration"),
    *("questionnaire", "item", "answer", "comments", "start", "end", "spt", "sib", "bouts", "hz", "valid"),
})  # fmt: skip
"""Words in the name of a column of a diary, a questionnaire or a summary."""
