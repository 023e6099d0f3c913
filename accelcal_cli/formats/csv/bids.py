"""Motion-BIDS: `*_motion.tsv` without a head, described by `*_channels.tsv` and `*_motion.json` beside it.

The first says what each column is (type ACCEL, component, tracked point, units), the second the rate and the
device (Motion-BIDS, bids-specification.readthedocs.io); the start is in `*_scans.tsv`, in the folder above or
the same.
"""

from __future__ import annotations

import csv
import io
import json
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.input_files import read_text
from accelcal_cli.core.recording import Device
from accelcal_cli.formats.csv import CHANNELS, MOTION, channels_beside
from accelcal_cli.formats.csv.vendors import ExportDescription, Start

ABOUT = "_motion.json"
LARGEST_SIDECAR = 1 << 20
ACCEL, GYRO, AXES = "ACCEL", "GYRO", ("x", "y", "z")
CELSIUS = ("oC", "\u00b0C", "degC")
FASTEST_HZ = 100_000.0
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)

Table = list[dict[str, str]]


def bids_description(path: Path) -> ExportDescription | None:
    """What the sidecars of a file say; None if it has no `*_channels.tsv`.

    Raises:
        UnreadableError: a sidecar is damaged, or its channels have no accelerometer, or several.
        UsageError: a sidecar cannot be read.
    """
    beside = channels_beside(path)
    if beside is None or not beside.is_file():
        return None
    stem = beside.name.removesuffix(CHANNELS)
    channels, about = _table(beside), _object(beside.with_name(stem + ABOUT))
    rates = [one.get("sampling_frequency", "") for one in channels if one.get("type") == ACCEL]
    rates.append(str(about.get("SamplingFrequency")))
    rate_hz = next((rate for rate in map(_positive, rates) if rate is not None), None)
    written, xyz = _acquired(path.parent, stem), _axes(channels, beside)
    model, serial = (about.get(key) for key in ("ManufacturersModelName", "DeviceSerialNumber"))
    return ExportDescription(
        title="Motion-BIDS",
        device=Device(model if isinstance(model, str) else None, serial if isinstance(serial, str) else None),
        names=tuple(_title(channel) for channel in channels),
        xyz=xyz,
        gyro=None if xyz is None else _gyroscope(channels, channels[xyz[0]].get("tracked_point", "")),
        time=next((at for at, one in enumerate(channels) if one.get("type") == "LATENCY"), None),
        rate_hz=rate_hz,
        start=_start(written),
        timezone="UTC" if written.endswith("Z") else None,
        companion=beside,
    )


def _table(path: Path) -> Table:
    """The rows of a table with tabs, by the names in its first line."""
    text = read_text(path, "the sidecar", LARGEST_SIDECAR, "utf-8-sig")
    try:
        rows = list(csv.DictReader(io.StringIO(text), delimiter="\t"))
    except csv.Error as error:
        raise UnreadableError(f"is damaged ({error})", path=path, hint="correct it") from error
    return [{str(key): value for key, value in row.items() if isinstance(value, str)} for row in rows]


def _object(path: Path) -> dict[str, Any]:
    if not path.is_file():
        return {}
    try:
        found = json.loads(read_text(path, "the sidecar", LARGEST_SIDECAR, "utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise UnreadableError(f"is not valid JSON ({error})", path=path, hint="correct it") from error
    return found if isinstance(found, dict) else {}


def _positive(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if 0 < value <= FASTEST_HZ else None


def _title(channel: dict[str, str]) -> str:
    """A column's name with its unit."""
    name, unit = channel.get("name", ""), channel.get("units", "n/a")
    unit = "C" if unit in CELSIUS else unit
    return name if unit in ("", "n/a") else f"{name} [{unit}]"


def _axes(channels: Table, path: Path) -> tuple[int, int, int] | None:
    """The columns of the one accelerometer; None where several tracked points have one."""
    whole = [*_whole(channels, ACCEL).values()]
    if not whole:
        hint = "name three columns with --columns if one of other types is acceleration"
        raise UnreadableError("lists no channels of type ACCEL for x, y and z", path=path, hint=hint)
    return whole[0] if len(whole) == 1 else None


def _gyroscope(channels: Table, point: str) -> tuple[int, int, int] | None:
    """The columns of the gyroscope of a tracked point."""
    return _whole(channels, GYRO).get(point)


def _whole(channels: Table, kind: str) -> dict[str, tuple[int, int, int]]:
    """The columns of x, y and z of a type, by their tracked point; of those that have all three."""
    points: dict[str, dict[str, int]] = {}
    for number, channel in enumerate(channels):
        axis = channel.get("component", "").lower()
        if channel.get("type") == kind and axis in AXES:
            points.setdefault(channel.get("tracked_point", ""), {})[axis] = number
    whole = {point: axes for point, axes in points.items() if len(axes) == len(AXES)}
    return {point: (axes["x"], axes["y"], axes["z"]) for point, axes in whole.items()}


def _acquired(folder: Path, stem: str) -> str:
    """The time in the list of scans of a subject or session: local, or with Z in UTC; empty if none."""
    whose = "_".join(part for part in stem.split("_") if part.startswith(("sub-", "ses-")))
    lists = (place / f"{whose}_scans.tsv" for place in (folder.parent, folder))
    rows = next((_table(path) for path in lists if path.is_file()), [])
    times = (row.get("acq_time", "") for row in rows if Path(row.get("filename", "")).name == stem + MOTION)
    return next(times, "")


def _start(written: str) -> Start | None:
    try:
        moment = datetime.fromisoformat(written.removesuffix("Z"))
    except ValueError:
        return None
    return Start((moment.replace(tzinfo=UTC) - EPOCH) // timedelta(microseconds=1))
