"""Exports that are folders: one file holds the accelerations, the others what other sensors measured.

Only the file of accelerations is a recording. Sensor Logger writes several accelerations, of which one has
gravity; phyphox keeps the start of the experiment in `meta/time.csv`; an Empatica E4 session is `ACC.csv`
with a file for each other sensor, of which `tags.csv` is empty if the button was not pressed; Polar Sensor
Logger writes `..._ACC.txt` next to `..._GYRO.txt`, `..._ECG.txt` and others. Sources: formats/tables/vendors;
phyphox.org, "Data format"; Empatica, "info.txt" of every E4 session; heads of files of Polar Sensor Logger.
"""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from decimal import Decimal, InvalidOperation
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import FIRST_US, LAST_US, MICROSECONDS
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.input_files import read_text
from accelcal_cli.core.paths import has_file, is_file, matching, open_found
from accelcal_cli.core.recording import FLOAT_LSB_PER_G, Chunk, Counts, Device, Reader
from accelcal_cli.core.written_times import written_start
from accelcal_cli.formats.tables.clock import FASTEST_HZ
from accelcal_cli.formats.tables.header import Start, Stated
from accelcal_cli.formats.tables.names import AXES
from accelcal_cli.formats.tables.signatures import BIDS_CHANNELS, BIDS_MOTION, bids_channels_path

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


# Rotation rates from a file of their own, next to the accelerations of a phone or a chest strap.
#
# The two sensors have their own times: a row gets the rates that were measured nearest to it. Where
# none was measured nearby, the row is a break, so that nothing is concluded from a turn that was not
# seen whole.

READ_AS = {"rad/s": ("g", 180 / pi / FLOAT_LSB_PER_G), "deg/s": ("mg", 1000 / FLOAT_LSB_PER_G)}
"""Unit of acceleration as which rates of each unit are read, and deg/s in one count then."""

NEAR_PERIODS = 2.5
"""Farthest distance of a row from its rates, in periods of the slower sensor."""

LONGEST_DELAY_S = 5.0
"""Longest time that one sensor begins after the other."""


class WithGyroscope(Reader):
    """Reads accelerations, and the rates that were measured nearest to each row.

    Args:
        unit: of the rates, as in `-R gyro_unit`.
    """

    def __init__(self, reader: Reader, gyro: Reader, name: str, unit: str) -> None:
        self._reader, self._gyro = reader, gyro
        self._near_us = NEAR_PERIODS * MICROSECONDS / min(reader.recording.rate_hz, gyro.recording.rate_hz)
        scale = READ_AS[unit][1]
        notes = (*reader.recording.notes, f"gyroscope: {name}")
        self.recording = replace(reader.recording, gyro_dps_per_lsb=(scale,) * 3, notes=notes)

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """See `Reader`."""
        rates = _Rates(self._gyro.chunks(chunk_samples))
        far_before, self._reader.with_others = False, self.with_others
        for chunk in self._reader.chunks(chunk_samples):
            times = chunk.clock.times(0, len(chunk))
            counts, far = rates.nearest(times, self._near_us)
            changes = np.flatnonzero(np.diff(far, prepend=far_before)) if len(far) else np.empty(0, np.int64)
            far_before = bool(far[-1]) if len(far) else far_before
            changes = changes[chunk.first_sample + changes > 0]
            breaks = np.union1d(chunk.breaks, changes).astype(np.int64, copy=False)
            yield replace(chunk, gyro_counts=counts, breaks=breaks)


class _Rates:
    """Rates in the order of their times, as far as they have been needed."""

    def __init__(self, chunks: Iterator[Chunk]) -> None:
        self._chunks = chunks
        self._times: NDArray[np.int64] = np.empty(0, np.int64)
        self._counts = np.empty((0, 3), np.int32)

    def nearest(self, times: NDArray[np.int64], near_us: float) -> tuple[Counts, NDArray[np.bool_]]:
        """Return the rates (n, 3) nearest to times (n,) [us], zeros where none are near; and where so."""
        if not len(times):
            return np.empty((0, 3), np.int32), np.empty(0, np.bool_)
        self._read_to(int(times.max()) + round(near_us), int(times.min()) - round(near_us))
        if not len(self._times):
            return np.zeros((len(times), 3), np.int32), np.ones(len(times), np.bool_)
        after = np.searchsorted(self._times, times).clip(1, max(1, len(self._times) - 1))
        before = after - 1
        after = np.minimum(after, len(self._times) - 1)
        later = np.abs(self._times[after] - times) < np.abs(self._times[before] - times)
        place = np.where(later, after, before)
        far = np.abs(self._times[place] - times) > near_us
        counts = self._counts[place]
        counts[far] = 0
        return counts, far

    def _read_to(self, last_us: int, first_us: int) -> None:
        """Read rates up to a time, and forget those before another but the last."""
        keep = max(0, int(np.searchsorted(self._times, first_us)) - 1)
        times, counts = [self._times[keep:]], [self._counts[keep:]]
        newest = int(self._times[-1]) if len(self._times) else first_us - 1
        while newest <= last_us and (chunk := next(self._chunks, None)) is not None:
            if len(chunk):
                times.append(np.maximum.accumulate(np.maximum(chunk.clock.times(0, len(chunk)), newest)))
                counts.append(chunk.counts.astype(np.int32, copy=False))
                newest = int(times[-1][-1])
        self._times = np.concatenate(times)
        self._counts = np.concatenate(counts)


# Motion-BIDS: the sidecars that describe a table without a head, `*_motion.tsv`.
#
# `*_channels.tsv` says what each column is (type ACCEL, component, tracked point, units),
# `*_motion.json` the rate and the device (Motion-BIDS, bids-specification.readthedocs.io); the start
# is in `*_scans.tsv`, in the folder above or the same.

ABOUT = "_motion.json"
"""End of the name of the sidecar with rate and device."""

LARGEST_SIDECAR = 1 << 20
ACCEL, GYRO = "ACCEL", "GYRO"
CELSIUS = ("oC", "\u00b0C", "degC")

Sidecar = list[dict[str, str]]
"""Rows of a table of Motion-BIDS, by the names of its columns."""


def bids_description(path: Path) -> Stated | None:
    """Return what the sidecars of a file of Motion-BIDS say; None if it has no `*_channels.tsv`.

    Raises:
        UnreadableError: a sidecar is damaged, or its channels have no accelerometer, or several.
        UsageError: a sidecar cannot be read.
    """
    table = bids_channels_path(path)
    if table is None or not has_file(table):
        return None
    stem = table.name.removesuffix(BIDS_CHANNELS)
    channels, about = _sidecar_rows(table), _sidecar_object(table.with_name(stem + ABOUT))
    written = _acquisition_time(path.parent, stem)
    accel, gyro = _axes_by_point(channels, ACCEL), _axes_by_point(channels, GYRO)
    if not accel:
        hint = "name three columns with --columns if one of other types is acceleration"
        raise UnreadableError("lists no channels of type ACCEL for x, y and z", path=table, hint=hint)
    point = next(iter(accel)) if len(accel) == 1 else None
    rates = [one.get("sampling_frequency", "") for one in channels if one.get("type") == ACCEL]
    rates.append(str(about.get("SamplingFrequency")))
    return Stated(
        title="Motion-BIDS",
        device=Device(_text(about, "ManufacturersModelName"), _text(about, "DeviceSerialNumber")),
        names=tuple(_title(channel) for channel in channels),
        xyz=None if point is None else accel[point],
        gyro=None if point is None else gyro.get(point),
        time=next((at for at, one in enumerate(channels) if one.get("type") == "LATENCY"), None),
        rate_hz=next((rate for rate in map(_positive, rates) if rate is not None), None),
        start=_start(written),
        timezone="UTC" if written.endswith("Z") else None,
        companion=table,
    )


def _sidecar_rows(path: Path) -> Sidecar:
    """Return the rows of a table with tabs, by the names in its first line."""
    text = read_text(path, "the sidecar", LARGEST_SIDECAR, "utf-8-sig")
    try:
        rows = list(csv.DictReader(io.StringIO(text), delimiter="\t"))
    except csv.Error as error:
        raise UnreadableError(f"is damaged ({error})", path=path, hint="correct it") from error
    return [{str(key): value for key, value in row.items() if isinstance(value, str)} for row in rows]


def _sidecar_object(path: Path) -> dict[str, Any]:
    if not has_file(path):
        return {}
    try:
        found = json.loads(read_text(path, "the sidecar", LARGEST_SIDECAR, "utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise UnreadableError(f"is not valid JSON ({error})", path=path, hint="correct it") from error
    return found if isinstance(found, dict) else {}


def _text(about: dict[str, Any], key: str) -> str | None:
    value = about.get(key)
    return value if isinstance(value, str) else None


def _positive(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if 0 < value <= FASTEST_HZ else None


def _title(channel: dict[str, str]) -> str:
    name, unit = channel.get("name", ""), channel.get("units", "n/a")
    unit = "C" if unit in CELSIUS else unit
    return name if unit in ("", "n/a") else f"{name} [{unit}]"


def _axes_by_point(channels: Sidecar, kind: str) -> dict[str, tuple[int, int, int]]:
    """Return the columns of x, y and z of a type by their tracked point, where all three are there."""
    points: dict[str, dict[str, int]] = {}
    for number, channel in enumerate(channels):
        axis = channel.get("component", "").lower()
        if channel.get("type") == kind and axis in AXES:
            points.setdefault(channel.get("tracked_point", ""), {})[axis] = number
    whole = {point: axes for point, axes in points.items() if len(axes) == len(AXES)}
    return {point: (axes["x"], axes["y"], axes["z"]) for point, axes in whole.items()}


def _acquisition_time(folder: Path, stem: str) -> str:
    """Return the time in the list of scans of a subject or session: local, or in UTC with Z; "" if none."""
    whose = "_".join(part for part in stem.split("_") if part.startswith(("sub-", "ses-")))
    lists = (place / f"{whose}_scans.tsv" for place in (folder.parent, folder))
    rows = next((_sidecar_rows(path) for path in lists if has_file(path)), [])
    file = stem + BIDS_MOTION
    times = (row.get("acq_time", "") for row in rows if Path(row.get("filename", "")).name == file)
    return next(times, "")


def _start(written: str) -> Start | None:
    start = written_start(written.removesuffix("Z"))
    return None if start is None else Start(start.start_us)
