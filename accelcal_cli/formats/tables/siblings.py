"""Exports that are folders: one file holds the accelerations, the others what other sensors measured.

Only the file of accelerations is a recording. Sensor Logger writes several accelerations, of which one has
gravity; phyphox keeps the start of the experiment in `meta/time.csv`; an Empatica E4 session is `ACC.csv`
with a file for each other sensor, of which `tags.csv` is empty if the button was not pressed; Polar Sensor
Logger writes `..._ACC.txt` next to `..._GYRO.txt`, `..._ECG.txt` and others. Sources: formats/tables/vendors;
phyphox.org, "Data format"; Empatica, "info.txt" of every E4 session; heads of files of Polar Sensor Logger.
"""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path

from accelcal_cli.core.clock import FIRST_US, LAST_US, MICROSECONDS
from accelcal_cli.core.door import is_file, matching, open_found
from accelcal_cli.core.errors import UnreadableError

LOOKED_BYTES = 200
LONGEST_TIMES = 1 << 16
SUFFIXES = (".csv", ".txt")
MOST_FILES = 100
"""Most files of a folder that are looked at."""

E4 = ("bvp.csv", "eda.csv", "hr.csv", "ibi.csv", "temp.csv", "tags.csv", "info.txt")
E4_ACC = "ACC.csv"
E4_HEAD = re.compile(rb"\s*(\d{9,10}(?:\.\d+)?)(?:, *\1){2}\s+(\d+(?:\.\d+)?)(?:, *\2){2}\s")

LOGGER_ACC = ("TotalAcceleration.csv", "AccelerometerUncalibrated.csv")
"""Files of Sensor Logger with gravity, the better first."""

LOGGER_GYRO = ("Gyroscope.csv", "GyroscopeUncalibrated.csv")
LOGGER_HEAD = re.compile(rb'"?time"?,"?seconds_elapsed"?,|version,device name,recording')

PHYPHOX_META = ("time.csv", "device.csv")
PHYPHOX_HEAD = re.compile(rb'(?:\xef\xbb\xbf)?"?Time \(s\)"?[,;\t]', re.IGNORECASE)
PHYPHOX_ACC = re.compile(PHYPHOX_HEAD.pattern + rb'"?Acceleration x \(m/s', re.IGNORECASE)
PHYPHOX_GYRO = re.compile(PHYPHOX_HEAD.pattern + rb'"?Gyroscope x \(rad/s', re.IGNORECASE)

POLAR = re.compile(r"(.+?)((?:_\d{8}_\d{6})?_)(?!ACC)[A-Za-z0-9]+(\.(?:txt|csv))", re.IGNORECASE)
POLAR_HEAD = b"Phone timestamp;"


@dataclass(frozen=True, slots=True)
class SiblingGyroscope:
    """A file of rotation rates next to one of accelerations.

    Attributes:
        columns: of x, y and z, by name or number.
        unit: of the rates, as in `-R gyro_unit`.
    """

    path: Path
    columns: tuple[str, str, str]
    unit: str


def belongs_to(path: Path) -> Path | None:
    """Return the recording that a file belongs to; None for a file that may be one itself."""
    if not path.name.lower().endswith(SUFFIXES):
        return None
    try:
        for find in (_of_e4, _of_logger, _of_phyphox, _of_polar):
            if (found := find(path)) is not None:
                return None if found == path else found
    except (OSError, ValueError, UnreadableError):
        pass
    return None


def _head(path: Path) -> bytes:
    """Return the beginning of a plain file; nothing of any other."""
    if not is_file(path):
        return b""
    with open_found(path) as file:
        return file.read(LOOKED_BYTES)


def _of_e4(path: Path) -> Path | None:
    acc = path.with_name(E4_ACC)
    return acc if path.name.lower() in E4 and E4_HEAD.match(_head(acc)) else None


def _of_logger(path: Path) -> Path | None:
    acc = next((one for name in LOGGER_ACC if is_file(one := path.with_name(name))), None)
    known = acc is not None and LOGGER_HEAD.match(_head(acc)) and LOGGER_HEAD.match(_head(path))
    return acc if known else None


def _of_phyphox(path: Path) -> Path | None:
    folder = path.parent.parent if path.parent.name == "meta" and path.name in PHYPHOX_META else path.parent
    acc = _in_phyphox(folder, PHYPHOX_ACC)
    return acc if folder != path.parent or PHYPHOX_HEAD.match(_head(path)) else None


def _in_phyphox(folder: Path, head: re.Pattern[bytes]) -> Path | None:
    """Return the first table of an export whose head matches; None in other folders."""
    if not any(is_file(folder / "meta" / name) for name in PHYPHOX_META):
        return None
    tables = matching(folder, "*.[cC][sS][vV]")
    return next((one for one in tables[:MOST_FILES] if head.match(_head(one))), None)


def _of_polar(path: Path) -> Path | None:
    match = POLAR.fullmatch(path.name)
    if match is None or not _head(path).startswith(POLAR_HEAD):
        return None
    beside = path.with_name(f"{match[1]}{match[2]}ACC{match[3]}")
    if is_file(beside):
        return beside
    pattern = re.escape(match[1]) + r"(?:_\d{8}_\d{6})?_ACC" + re.escape(match[3])
    return next((one for one in matching(path.parent, "*_*") if re.fullmatch(pattern, one.name)), None)


def sibling_gyroscope(path: Path) -> SiblingGyroscope | None:
    """Return the rotation rates next to a file of accelerations; None if there are none."""
    try:
        if path.name in LOGGER_ACC:
            beside = (path.with_name(name) for name in LOGGER_GYRO)
            found = next((one for one in beside if LOGGER_HEAD.match(_head(one))), None)
            return None if found is None else SiblingGyroscope(found, ("x", "y", "z"), "rad/s")
        if path.stem.upper().endswith("_ACC"):
            found = path.with_name(f"{path.stem[:-3]}GYRO{path.suffix}")
            polar = _head(found).startswith(POLAR_HEAD)
            return SiblingGyroscope(found, ("2", "3", "4"), "deg/s") if polar else None
        found = _in_phyphox(path.parent, PHYPHOX_GYRO)
    except (OSError, ValueError, UnreadableError):
        return None
    return None if found is None else SiblingGyroscope(found, ("1", "2", "3"), "rad/s")


def experiment_start(path: Path) -> tuple[int, int] | None:
    """Return when the time 0 of a phyphox experiment was [us since 1970], and how often it was paused.

    None if `meta/time.csv` does not say so; times do not count pauses.
    """
    times = path.parent / "meta" / PHYPHOX_META[0]
    try:
        with open_found(times) as file:
            lines = file.read(LONGEST_TIMES).decode("utf-8-sig").splitlines()
        delimiter = next((one for one in "\t;" if one in lines[0]), ",")
        rows = list(csv.reader(lines[1:], delimiter=delimiter))
        starts = [(_number(row[1]), _number(row[2])) for row in rows if row[:1] == ["START"]]
        since, system = starts[0]
        us = round((system - since) * MICROSECONDS)
    except (OSError, ValueError, IndexError, InvalidOperation, csv.Error, UnreadableError):
        return None
    return (us, len(starts) - 1) if FIRST_US < us < LAST_US else None


def _number(text: str) -> Decimal:
    return Decimal(text.replace(",", "."))
