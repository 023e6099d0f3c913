"""Small tables as people keep them, each of which every container must give as one and the same recording.

A table is named columns and the options with which it is read. Text holds its values exactly: most are
multiples of 1/4096 of their unit. What a vendor writes in lines above a table exists in text alone, and has
no place here.
"""

from __future__ import annotations

import gzip
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import scipy.io
from pyarrow import feather

from accelcal_cli.core.formats import ReadOptions

ROWS = 2400
HALF = ROWS // 2
POSE_ROWS = 150
START_S = 1_709_546_400
"""2024-03-04T10:00:00Z."""

DAY_S = 86_400
STANDARD_GRAVITY = 9.80665
RANDOM = np.random.default_rng(20240304)

Column = np.ndarray[Any, Any]
Columns = dict[str, Column]


@dataclass(frozen=True, eq=False)
class Table:
    """A table and how it is read.

    Attributes:
        columns: (n,) numbers or texts by the names of their columns, in the order of a text file.
        refused: a pattern of the error with its hint if it must not be read with these options.
        says: what `Recording` must say of it, where a rule of tables decides that.
    """

    name: str
    columns: Columns
    options: ReadOptions = field(default_factory=ReadOptions)
    refused: str | None = None
    says: Mapping[str, object] = field(default_factory=dict)

    @property
    def has_texts(self) -> bool:
        """True if a column holds texts."""
        return any(values.dtype.kind == "U" for values in self.columns.values())


# --- values ---------------------------------------------------------------------------------------------


def on_grid(values: Column, steps: int = 4096) -> Column:
    """Values rounded to whole parts of 1/steps."""
    return np.asarray(np.rint(values * steps) / steps)


def resting() -> Column:
    """Acceleration in g of a sensor that is turned every three seconds, (n, 3)."""
    poses = RANDOM.normal(size=(ROWS // POSE_ROWS, 3))
    poses /= np.linalg.norm(poses, axis=1)[:, np.newaxis]
    return on_grid(np.repeat(poses, POSE_ROWS, axis=0) + RANDOM.normal(0, 0.003, (ROWS, 3)))


G = resting()
RATES = on_grid(RANDOM.normal(0, 1, (ROWS, 3)), 64)
WARM = np.round(np.linspace(22, 30, ROWS), 2)
IN_UNIT = {
    "g": G,
    "mg": on_grid(G * 1000, 16),
    "m/s2": on_grid(G * STANDARD_GRAVITY),
    "cm/s2": on_grid(G * STANDARD_GRAVITY * 100, 16),
    "whole mg": np.rint(G * 1000).astype(np.int64),
    "counts": np.rint(G * 256).astype(np.int64),
    "ten bits": np.rint(G * 102 + 512).astype(np.int64),
}


def three(names: str, values: Column | str = "g") -> Columns:
    """Three columns of values (n, 3), or of the acceleration in a unit; `*` or `%` is where x or X stands."""
    found = IN_UNIT[values] if isinstance(values, str) else values
    letters = zip("xyz", "XYZ", range(3), strict=True)
    return {names.replace("*", low).replace("%", high): found[:, axis] for low, high, axis in letters}


def changed(values: Column, rows: slice, to: float) -> Column:
    """A copy with other values in some rows."""
    made = values.copy()
    made[rows] = to
    return made


def micros(rate_hz: float = 50, start_s: int = START_S) -> Column:
    """Times in microseconds since 1970, (n,); those of a start at 0 count from the first row."""
    return np.asarray(start_s * 10**6 + np.rint(np.arange(ROWS) * 1e6 / rate_hz).astype(np.int64))


def millis(rate_hz: float = 50, start_s: int = START_S) -> Column:
    return micros(rate_hz, start_s) // 1000


def seconds(rate_hz: float = 50, start_s: int = START_S) -> Column:
    """Times in seconds, exact to the microsecond."""
    return micros(rate_hz, start_s) / 1e6


def jumping(jump_ms: int) -> Column:
    """Milliseconds whose clock jumps once in the middle."""
    return millis() + np.where(np.arange(ROWS) < HALF, 0, jump_ms)


def iso(end: str = "", between: str = " ") -> Column:
    """Times as ISO 8601 writes them, to the millisecond."""
    texts = np.datetime_as_string(millis().astype("datetime64[ms]"))
    return np.array([text.replace("T", between) + end for text in texts.tolist()])


def written(form: str) -> Column:
    """Times in a form of the letters d m y H: date in three parts, and the time of day."""
    parts = (text.replace("T", "-", 1).split("-", 3) for text in iso(between="T").tolist())
    return np.array([form.format(y=y, m=m, d=d, H=clock) for y, m, d, clock in parts])


# --- tables of all kinds --------------------------------------------------------------------------------


def table(name: str, *parts: Columns, refused: str | None = None, **options: Any) -> Table:
    """A table of columns in this order; `says_...` are what its recording must say, others are options."""
    says = {key.removeprefix("says_"): options.pop(key) for key in [*options] if key.startswith("says_")}
    columns = {title: values for part in parts for title, values in part.items()}
    return Table(name, columns, ReadOptions(**options), refused, says)


def timed(name: str, *parts: Columns, **options: Any) -> Table:
    """A table whose first column is `time` in milliseconds since 1970."""
    return table(name, {"time": millis()}, *parts, **options)


def kinds() -> Iterator[Table]:
    """Tables whose rates, numbers, times, channels and columns differ."""
    yield from rates_and_numbers()
    yield from gaps_and_clocks()
    yield from times()
    yield from channels()
    yield from columns()


def rates_and_numbers() -> Iterator[Table]:
    xyz = three("*")
    yield timed("plain", xyz, says_rate_hz=50.0, says_duration_s=ROWS / 50)
    yield table("99.6 Hz", {"time": seconds(99.6)}, xyz, says_rate_hz=99.6)
    yield table("49.98 Hz", {"time": seconds(49.98)}, xyz, says_rate_hz=50.0)
    yield table("12.5 Hz", {"time": millis(12.5)}, xyz, says_rate_hz=12.5)
    yield timed("whole mg, named", three("% [mg]", "whole mg"), says_lsb_per_g=1000.0)
    yield timed("whole mg, no unit", three("*", "whole mg"), says_lsb_per_g=1000.0)
    yield timed("counts with their scale", three("*", "counts"), lsb_per_g=256.0, says_lsb_per_g=256.0)
    yield timed("counts without a scale", three("*", "counts"), refused=r"\(256 would fit")
    yield timed("counts above zero", three("*", "ten bits"), lsb_per_g=102.0, says_lsb_per_g=102.0)
    yield timed(
        "counts above zero without a scale", three("*", "ten bits"), refused="-R zero=512 --lsb-per-g"
    )
    yield timed(
        "averages of counts", three("*", on_grid(G * 256, 4)), lsb_per_g=256.0, says_lsb_per_g=2.0**24
    )
    yield timed(
        "fractions of counts",
        three("*", on_grid(G * 9999, 4)),
        lsb_per_g=256.0,
        refused="is not a whole number",
    )
    wide = changed(IN_UNIT["counts"][:, 0], slice(7, 8), -(2**40))
    yield timed(
        "a count of 41 bits",
        {**three("*", "counts"), "x": wide},
        lsb_per_g=256.0,
        says_codes=["out_of_range"],
        says_breaks=[7],
    )
    yield timed("gauss", three("% [G]"), refused=UNNAMED)
    yield timed("rotation rates as x y z", three("% (dps)"), refused=UNNAMED)
    yield timed("cm/s2", three("a* (cm/s2)", "cm/s2"))
    yield timed("m/s2", three("a* (m/s^2)", "m/s2"))
    texts = {name: np.array([f"{cell:.12f}" for cell in cells.tolist()]) for name, cells in xyz.items()}
    yield timed("numbers as texts", texts)


def gaps_and_clocks() -> Iterator[Table]:
    xyz, lost = three("*"), slice(HALF, HALF + 20)
    y = slice(HALF // 2, HALF // 2 + 10)
    yield timed(
        "rows without y",
        {**xyz, "y": changed(G[:, 1], y, np.nan)},
        says_codes=["missing_value"],
        says_rows=ROWS - 10,
    )
    yield timed(
        "a value out of range",
        {**xyz, "x": changed(G[:, 0], slice(HALF, HALF + 1), 500)},
        says_codes=["out_of_range"],
        says_breaks=[HALF],
    )
    yield table("gap of 10 s", {"time": jumping(10_000)}, xyz, says_codes=["clock_gap"], says_breaks=[HALF])
    yield table(
        "clock goes back 10 s", {"time": jumping(-10_000)}, xyz, says_codes=["clock_back"], says_breaks=[HALF]
    )
    yield table(
        "rows without values before a gap", {"time": jumping(10_000)}, three("*", changed(G, lost, np.nan))
    )
    yield timed("no values at first", three("*", changed(G, slice(0, 100), np.nan)))
    yield timed("no values that can be", three("*", G + 500), unit="g", refused="usable values|none of its")
    own = np.arange(ROWS) % 3 == 0
    own[600:1200] = False
    shared = three("*", np.where(own[:, np.newaxis], G, np.nan))
    yield table("one row in three has values", {"time": seconds(75)}, shared, says_rate_hz=25.0,
                says_rows=600, says_breaks=[200])  # fmt: skip
    untimed = changed(changed(seconds(), slice(50, 52), np.nan), slice(99, 100), 1e30)
    yield table(
        "rows without a time",
        {"time": untimed},
        xyz,
        says_codes=["missing_value", "impossible_time"],
        says_breaks=[50, 97],
    )
    uneven = micros(100) + np.rint(RANDOM.normal(0, 5000, ROWS)).astype(np.int64)
    yield table("jitter", {"time_us": uneven}, xyz, says_rate_hz=100.0)
    jumps = micros(100) + 40_000 * (np.arange(ROWS) >= 100) - 13_000 * (np.arange(ROWS) >= 200)
    gone = three("*", changed(G, slice(300, 301), np.nan))
    yield table(
        "jumps of the clock and a lost row",
        {"time_us": jumps + 40_000 * (np.arange(ROWS) > 300)},
        gone,
        says_breaks=[100, 200, 300],
        says_clock_jumps=[100, 200],
    )
    yield table("counter of 16 bits", {"ms": (40_000 + 20 * np.arange(ROWS)) % 65_536}, xyz)
    yield table(
        "newest row first", {"time": millis()[::-1]}, three("*", G[::-1]), refused="order newest first"
    )


def times() -> Iterator[Table]:
    xyz = three("*")
    days = 719_529 + START_S / DAY_S + np.arange(ROWS) / 50 / DAY_S
    yield table("whole seconds", {"time": seconds().astype(np.int64)}, xyz, says_rate_hz=50.0)
    yield from shared_stamps()
    yield table("written", {"timestamp": iso()}, xyz)
    yield table("written, UTC in the name", {"Timestamp UTC": iso()}, xyz, says_timezone="UTC")
    yield table("written with Z", {"timestamp": iso("Z")}, xyz, says_timezone="UTC")
    yield table("written with +02:00", {"timestamp": iso("+02:00")}, xyz, says_has_offsets=True)
    yield table("day first", {"timestamp": written("{d}/{m}/{y} {H}")}, xyz, date_format="dmy")
    yield table("date and time", {"date": written("{y}-{m}-{d}"), "time": written("{H}")}, xyz,
                says_start_us=START_S * 10**6)  # fmt: skip
    yield table("elapsed_s", {"elapsed_s": seconds(start_s=0)}, xyz, says_stamped=False)
    yield table("s", {"s": seconds(start_s=0)}, xyz, says_stamped=False)
    yield table("no times", xyz, rate_hz=50.0, says_rate_hz=50.0)
    gone = three("*", changed(G, slice(HALF, HALF + 2), np.nan))
    yield table("no times and no values", gone, rate_hz=50.0, says_breaks=[HALF],
                says_codes=["no_start_time", "missing_value"])  # fmt: skip
    yield table(
        "no times and no rate", xyz, refused="-R time_column=NAME, or give the sampling rate with --rate"
    )
    ticks, asked = {"time": np.arange(ROWS)}, "may be seconds or milliseconds; give the right --rate"
    yield table("seconds or milliseconds", ticks, xyz, refused=asked)
    yield table("milliseconds by the rate", ticks, xyz, rate_hz=1000.0, says_rate_hz=1000.0)
    yield table("neither by the rate", ticks, xyz, rate_hz=30.0, refused="does not fit 30 Hz")
    still = {"time": np.full(ROWS, START_S)}
    yield table("a clock that stands still", still, xyz, refused="2024-03-04T10:00:00.* in each of the first")
    yield timed("rate against the times", xyz, rate_hz=25.0, refused="50 Hz, not 25 Hz")
    yield table("days as MATLAB counts them", {"time": days}, xyz)
    yield table("written as MATLAB does", {"time": written("{d}-Mar-{y} {H}")}, xyz)
    yield table("written as UK Biobank does", {"time": iso("+0100 [Europe/Paris]")}, xyz, says_timezone="UTC")
    late = np.array([one.replace("-04 ", "-14 ") for one in iso().tolist()])
    yield table(
        "a day above 12", {"time": np.array([f"{t[8:10]}/{t[5:7]}/{t[:4]}{t[10:]}" for t in late])}, xyz
    )
    yield table(
        "numbers of seconds as texts", {"time": np.char.mod("%.2f", seconds())}, xyz, says_timezone="UTC"
    )
    odd = iso()
    odd[[100, 150, 151]] = "junk", "", ""
    yield table(
        "texts that are no times",
        {"time": odd},
        xyz,
        says_codes=["bad_line", "missing_value"],
        says_breaks=[100, 149],
    )
    yield table(
        "times of no known form",
        {"time": np.char.mod("%d~s", np.arange(ROWS))},
        xyz,
        refused="not written as .* -R time_format",
    )
    both = {"time": millis(), "utc": millis() + DAY_S * 1000}
    yield table("two times", both, xyz, refused="several columns may be the time .*-R time_column")
    yield table("one of two times", both, xyz, time_column="time", says_start_us=START_S * 10**6)
    for name, in_s in COUNTERS.items():
        ticks = np.rint(np.arange(ROWS) / 50 * in_s).astype(np.int64)
        time = {name: ticks if in_s > 1 else np.arange(ROWS) / 50}
        yield table(f"counter {name}", time, xyz, says_rate_hz=50.0, says_start_us=None)


UNNAMED = "no column has a name known for acceleration"
COUNTERS = {
    **{"micros": 1e6, "millis": 1e3, "seconds": 1, "elapsed": 1e3, "elapsed_ms": 1e3, "Timestamp (us)": 1e6},
    **{"timestamp_millis": 1e3, "time_micros": 1e6, "time [ms]": 1e3, "Time since start in ms": 1e3},
}
"""Names of columns that count from the start, and how often in a second."""


def shared_stamps() -> Iterator[Table]:
    """Tables whose rows share stamps, which are spread, around gaps too."""
    trying = [7, 10, 10, 3, 10, 95, 10, 0, 0, 10, 10, 1, 10, 10, 4]
    for name, sizes, step, missing in (
        ("seconds", trying, 1, []),
        ("seconds, some of them missing", trying, 1, [0, 50, 51, 130]),
        ("seconds of 25 rows", [13, *[25, 26, 24] * 4, 8], 1, [3, 77]),
        ("minutes", [40, 120, 120, 119, 120, 70], 60, []),
        ("pairs", [2, 2, 2, 1, 2, 2, 0, 0, 2, 2], 1, []),
        ("hardly shared", [1, 2, 1, 1, 2, 1, 1, 2], 1, []),
    ):
        stamps = START_S + step * np.repeat(np.arange(len(sizes)), sizes).astype(float)
        stamps[missing] = np.nan
        yield table(f"shared: {name}", {"time": stamps}, three("*", G[: len(stamps)]))


def channels() -> Iterator[Table]:
    xyz, acc = three("*"), three("acc_*")
    yield timed("temperature", xyz, {"temperature": WARM}, says_has_temperature=True)
    fahrenheit = np.round(WARM * 1.8 + 32, 2)
    yield timed("Fahrenheit", xyz, {"Temperature (F)": fahrenheit}, says_has_temperature=True)
    yield timed("T", xyz, {"T": WARM}, says_has_temperature=True)
    yield timed(
        "temperature with holes",
        xyz,
        {"temperature": changed(WARM, slice(100, 200), np.nan)},
        says_codes=["missing_value"],
    )
    yield timed("gyroscope in dps", acc, three("gyro_*_dps", RATES))
    yield timed("gyroscope in rad/s", three("acc_* (g)"), three("gyro_* (rad/s)", RATES))
    holes = changed(changed(RATES, slice(HALF + 1, HALF + 9, 2), np.nan), slice(9, 10), 40_000)
    moved = changed(G, slice(HALF, HALF + 9, 2), np.nan)
    yield timed("either sensor without values", three("acc_*", moved), three("gyro_*_dps", holes))
    rare = three("gyro_*_dps", changed(RATES, slice(0, 99), np.nan))
    yield timed("gyroscope often without values", acc, rare, says_gyro_dps_per_lsb=None)
    yield timed("gyroscope without a unit", three("a*"), three("g*", RATES), says_gyro_dps_per_lsb=None)


def columns() -> Iterator[Table]:
    xyz, pqr = three("*"), dict(zip("pqr", G.T, strict=True))
    yield timed("columns by number", pqr, columns=("1", "2", "3"))
    yield timed("columns by name", pqr, columns=("p", "q", "r"))
    yield timed(
        "left and right",
        three("Acc%_L"),
        three("Acc%_R", on_grid(G * 1.01)),
        refused="--columns AccX_L,AccY_L,AccZ_L",
    )
    pairs = {"time": np.repeat(millis()[:HALF], 2), "sensor": np.array(["left", "right"] * HALF)}
    yield table("column of sensors", pairs, xyz, refused="--sensor left or --sensor right")
    yield table("one of two sensors", pairs, xyz, sensor="left", says_rate_hz=50.0)
    yield timed("activities", {"activity": np.repeat(["walk", "sit", "stand", "lie"], ROWS // 4)}, xyz)
    yield timed("without gravity", three("userAcceleration.*", on_grid(RANDOM.normal(0, 0.1, (ROWS, 3)))),
                refused="--columns")  # fmt: skip
    steps = np.abs(np.rint(G * 300)).astype(np.int64)
    yield timed(
        "counts of epochs", {f"Axis{axis + 1}": steps[:, axis] for axis in range(3)}, refused="epochs"
    )


# --- heads as people write them -------------------------------------------------------------------------


def heads() -> Iterator[Table]:
    """Tables whose names of columns are those of 35 kinds of programs, with times under many names."""
    for names, time, unit, *more in (*TIMED_BY_NUMBERS, *TIMED_BY_TEXTS, *WITH_MORE):
        yield table(head_name(names, time), time, three(names, unit), *more)
    for names in ("userAcceleration.*", "linear_acceleration_*"):
        moves = on_grid(RANDOM.normal(0, 0.1, (ROWS, 3)))
        time = {"ts": millis()}
        yield table(head_name(names, time), time, three(names, moves), refused="--columns")


def head_name(names: str, time: Columns) -> str:
    """The name of a table, such as `acc_x at timestamp`."""
    return f"{next(iter(three(names)))} at {next(iter(time))}"


FROM_0 = {"start_s": 0}
TIMED_BY_NUMBERS: tuple[tuple[Any, ...], ...] = (
    ("acc_*", {"t": seconds(**FROM_0)}, "g"),
    ("Acc%", {"unix": seconds()}, "g"),
    ("accel% (g)", {"time": millis()}, "g"),
    ("Accel_LN_%", {"Timestamp": millis()}, "m/s2"),
    ("imu_a*", {"ts": micros()}, "m/s2"),
    ("gF*", {"timestamp": seconds()}, "g"),
    ("Acceleration * (m/s^2)", {"elapsed (s)": seconds(**FROM_0)}, "m/s2"),
    ("*-axis (g)", {"epoch_ms": millis()}, "g"),
    ("Acc_%", {"SampleTimeFine": 10 * millis(**FROM_0)}, "m/s2"),
    ("* [mg]", {"time_us": micros()}, "mg"),
    ("acc_*_mg", {"timestamp_ms": millis()}, "mg"),
    ("Acc_%_g", {"epoch": seconds()}, "g"),
    ("accelerometer_*_g", {"time_s": seconds(**FROM_0)}, "g"),
    ("Accel % (m/s²)", {"Time (s)": seconds(**FROM_0)}, "m/s2"),
    ("a_*", {"t": seconds()}, "g"),
    ("%_acc", {"time_ms": millis(**FROM_0)}, "g"),
    ("acc *", {"time [s]": seconds(**FROM_0)}, "g"),
    ("acc%[m/s2]", {"timestamp [us]": micros()}, "m/s2"),
    ("Accelerometer%", {"unixtime": seconds()}, "g"),
    ("raw_*", {"ms": millis(**FROM_0)}, "g"),
    ("acceleration_*", {"seconds": seconds(**FROM_0)}, "m/s2"),
    ("acc_*_ms2", {"Time": seconds()}, "m/s2"),
)
"""Names of the axes, the column of times, and the unit of the values."""

TIMED_BY_TEXTS: tuple[tuple[Any, ...], ...] = (
    ("acc.*", {"datetime": iso()}, "g"),
    ("Accelerometer %", {"Timestamp": iso()}, "g"),
    ("Accelerometer_%", {"Timestamp UTC": iso()}, "g"),
    ("a*_g", {"utc": iso("Z", "T")}, "g"),
    ("*acc", {"date": iso()}, "g"),
    ("ACC-%", {"TIME": iso(between="T")}, "g"),
)
WITH_MORE: tuple[tuple[Any, ...], ...] = (
    ("%", {"timestamp": millis()}, "g", {"Temp": WARM}),
    ("accel_*_g", {"time": seconds()}, "g", three("gyro_*_dps", RATES), {"temp_c": WARM}),
    ("Accelerometer * (m/s^2)", {"Time (s)": seconds(**FROM_0)}, "m/s2", three("Gyroscope * (rad/s)", RATES),
     {"Temperature (°C)": WARM}),
    ("a*", {"timestamp_us": micros()}, "g", three("w* (rad/s)", RATES), {"device_temp": WARM}),
    ("left_acc_*", {"time": millis()}, "g", three("left_gyr_* (deg/s)", RATES), {"light": WARM}),
)  # fmt: skip


# --- options --------------------------------------------------------------------------------------------


def options() -> Iterator[Table]:
    """Tables of which options say what their names do not."""
    xyz, acc = three("*"), three("a*")
    plain, gyro = millis(), three("g*", RATES)
    yield timed("--unit mg", three("*", "mg"), unit="mg")
    yield timed("--unit m/s2", three("*", "m/s2"), unit="m/s2")
    yield timed("--unit counts --lsb-per-g", three("acc_*", "counts"), unit="counts", lsb_per_g=256.0,
                says_lsb_per_g=256.0)  # fmt: skip
    yield timed("--zero --lsb-per-g", three("*", "ten bits"), zero=512, lsb_per_g=102.0)
    yield table("--time-column by name", {"recorded": plain}, xyz, time_column="recorded")
    yield table("--time-column by number", xyz, {"recorded": plain}, time_column="3")
    yield timed("--time-column none --rate", xyz, time_column="none", rate_hz=100.0, says_rate_hz=100.0)
    yield timed("--rate that agrees", xyz, rate_hz=50.0, says_rate_hz=50.0)
    yield timed("-R time_format ms", xyz, time_format="ms")
    form = {"time": written("{d}|{m}|{y} {H}")}
    yield table("-R time_format of letters", form, xyz, time_format="%d|%m|%Y %H:%M:%S.%f")
    yield table("--date-format mdy", {"time": written("{m}/{d}/{y} {H}")}, xyz, date_format="mdy")
    yield table("no --date-format", {"time": written("{d}/{m}/{y} {H}")}, xyz, refused="dmy or mdy")
    yield timed("--gyro-unit deg/s", acc, gyro, gyro_unit="deg/s", says_gyro_dps_per_lsb=(2.0**-16,) * 3)
    yield timed("--gyro-unit rad/s", acc, gyro, gyro_unit="rad/s")
    yield timed("--gyro-unit none", acc, gyro, gyro_unit="none", says_gyro_dps_per_lsb=None)
    pqr = dict(zip("pqr", RATES.T, strict=True))
    yield timed("--gyro-columns by name", xyz, pqr, gyro_columns=("p", "q", "r"), gyro_unit="deg/s")
    yield timed("--gyro-columns by number", xyz, pqr, gyro_columns=("4", "5", "6"), gyro_unit="deg/s")
    number = np.array([7, 9] * HALF)
    pairs = {"time": np.repeat(plain[:HALF], 2), "id": number}
    yield table("--sensor of numbers", pairs, xyz, sensor="9")
    yield table("--sensor by column", pairs, xyz, sensor="id=7")
    yield timed("--columns of one column twice", xyz, columns=("x", "x", "z"), refused="twice")
    yield timed("--columns of texts", xyz, {"label": np.full(ROWS, "walk")}, columns=("x", "y", "label"),
                refused="does not hold numbers")  # fmt: skip
    yield timed("--gyro-columns of no column", xyz, pqr, gyro_columns=("p", "q", "w"), refused="'w' is not")
    yield timed("--gyro-columns of one twice", xyz, pqr, gyro_columns=("p", "p", "r"), refused="column twice")
    yield timed("--columns of no column", xyz, columns=("x", "y", "w"), refused="'w' is not a column")


# --- exports of vendors whose facts are in names --------------------------------------------------------


def vendors() -> Iterator[Table]:
    """Exports that are known by the names of their columns."""
    yield from of_phones()
    index, days = np.arange(ROWS), 45_355 + np.arange(ROWS) / 20 / DAY_S
    for bits, scale, zero in ((8, 63, 127), (10, 127.375, 513)):
        counts = np.rint(G * scale + zero).astype(np.int64)
        yield table(f"activPAL of {bits} bits", {"Time": days, "Index": index}, three("%", counts),
                    says_lsb_per_g=float(scale))  # fmt: skip
    skipping = index + (index > 5)
    yield table(
        "activPAL, compressed",
        {"Time": days, "Index": skipping},
        three("%", counts),
        refused="it is compressed",
    )
    stamps = iso(between="T")
    for epoch, time in (("epoc (ms)", "timestamp (+0100)"), ("epoch (ms)", "time (01:00)")):
        three_times = {epoch: millis(), time: stamps, "elapsed (s)": seconds(start_s=0)}
        yield table(f"MetaWear, {epoch}", three_times, three("*-axis (g)"))
    polar = {"Phone timestamp": stamps, "sensor timestamp [ns]": 7 * 10**17 + 1000 * micros(start_s=0)}
    yield table("Polar, acceleration", polar, three("% [mg]", "whole mg"))
    yield table("Polar, magnetometer", polar, three("% [G]"), refused=UNNAMED)
    yield table("mHealth", {"HEADER_TIME_STAMP": iso()}, three("%"))
    ticks = {"PacketCounter": index, "SampleTimeFine": 2_268_972_329 + 200 * index}
    free = three("FreeAcc_%", on_grid(RANDOM.normal(0, 0.1, (ROWS, 3))))
    yield table("Xsens MT Manager", ticks, free, three("Acc_%", "m/s2"), three("Gyr_%", RATES))


def of_phones() -> Iterator[Table]:
    """Exports of apps on phones."""
    moves = on_grid(RANDOM.normal(0, 0.2, (ROWS, 3)))
    linear = three("a*", moves)
    yield table("Physics Toolbox", {"time": seconds(start_s=0)}, three("gF*"), linear, three("w*", RATES))
    for name, values, refused in (
        ("TotalAcceleration", IN_UNIT["m/s2"], None), ("Accelerometer", moves, "TotalAcceleration"),
        ("AccelerometerUncalibrated", G, None),
    ):  # fmt: skip
        both = {"time": 1000 * micros(), "seconds_elapsed": seconds(start_s=0)}
        backwards = dict(zip("zyx", values.T[::-1], strict=True))
        yield table(f"Sensor Logger, {name}", both, backwards, refused=refused)
    for kind, values, refused in (("", IN_UNIT["m/s2"], None), ("Linear ", moves, "without gravity.*with g")):
        length = {f"Absolute {kind.lower()}acceleration (m/s^2)": np.linalg.norm(values, axis=1)}
        names = three(f"{kind}Acceleration * (m/s^2)", values)
        title = f"phyphox, {kind or 'with '}g"
        yield table(title, {"Time (s)": seconds(start_s=0)}, names, length, refused=refused)


# --- containers -----------------------------------------------------------------------------------------


@lru_cache(2)
def rows_of(made: Table) -> list[tuple[str, ...]]:
    """The cells of all rows."""
    return [*zip(*map(as_texts, made.columns.values()), strict=True)]


def as_texts(values: Column) -> list[str]:
    """Cells of a text file that hold values exactly; a missing one is empty."""
    if values.dtype.kind == "f":
        return ["" if math.isnan(cell) else repr(cell) for cell in values.tolist()]
    return [str(cell) for cell in values.tolist()]


def text(made: Table, delimiter: str = ",") -> str:
    """A line of names and a line for each row."""
    return "\n".join(map(delimiter.join, [tuple(made.columns), *rows_of(made)])) + "\n"


def write_utf_16(path: Path, made: Table) -> None:
    path.write_bytes(text(made).encode("utf-16"))


def write_gzip(path: Path, made: Table) -> None:
    path.write_bytes(gzip.compress(text(made).encode(), 1))


def arrow(made: Table, *, nulls: bool = False) -> pa.Table:
    """An Arrow table, whose missing values are nulls, as pandas writes them, or NaN, as NumPy has them."""
    arrays = [pa.array(values, from_pandas=nulls) for values in made.columns.values()]
    return pa.Table.from_arrays(arrays, names=list(made.columns))


def plain_names(made: Table) -> Columns:
    """Columns for files of arrays, in whose names a slash would be a group."""
    return {name.replace("/", "_"): values for name, values in made.columns.items()}


def write_hdf5(path: Path, made: Table) -> None:
    """Datasets in the order of the columns, with texts as bytes."""
    with h5py.File(path, "w", track_order=True) as file:
        for name, values in plain_names(made).items():
            file[name] = np.char.encode(values, "utf-8") if values.dtype.kind == "U" else values


@dataclass(frozen=True)
class Container:
    """A kind of file for tables: its suffix, how a table is written, and whether it holds texts."""

    suffix: str
    write: Callable[[Path, Table], object]
    holds_texts: bool = True

    def holds(self, made: Table) -> bool:
        """Return True if it can hold a table: arrays of letters in MATLAB files do not stand for a column."""
        return self.holds_texts or not made.has_texts

    def file(self, folder: Path, made: Table, name: str = "table") -> Path:
        """Write a table."""
        path = folder / f"{name}{self.suffix}"
        self.write(path, made)
        return path


CONTAINERS = {
    "csv": Container(".csv", lambda path, made: path.write_text(text(made), "utf-8")),
    "tsv": Container(".tsv", lambda path, made: path.write_text(text(made, "\t"), "utf-8")),
    "semicolons": Container(".csv", lambda path, made: path.write_text(text(made, ";"), "utf-8")),
    "utf-16": Container(".csv", write_utf_16),
    "csv.gz": Container(".csv.gz", write_gzip),
    "parquet": Container(".parquet", lambda path, made: pq.write_table(arrow(made, nulls=True), path)),
    "feather": Container(".feather", lambda path, made: feather.write_feather(arrow(made), path)),
    "h5": Container(".h5", write_hdf5),
    "npz": Container(".npz", lambda path, made: np.savez(path, allow_pickle=False, **plain_names(made))),
    "mat": Container(
        ".mat", lambda path, made: scipy.io.savemat(path, plain_names(made), long_field_names=True), False
    ),
}  # fmt: skip

TABLES = {made.name: made for make in (kinds, heads, options, vendors) for made in make()}
