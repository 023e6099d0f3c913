"""Motion-BIDS: the sidecars that describe a table without a head, `*_motion.tsv`.

`*_channels.tsv` says what each column is (type ACCEL, component, tracked point, units), `*_motion.json` the
rate and the device (Motion-BIDS, bids-specification.readthedocs.io); the start is in `*_scans.tsv`, in the
folder above or the same.
"""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

from accelcal_cli.core.door import has_file
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.input_files import read_text
from accelcal_cli.core.recording import Device
from accelcal_cli.core.written_times import written_start
from accelcal_cli.formats.tables.header import Start, Stated
from accelcal_cli.formats.tables.names import AXES
from accelcal_cli.formats.tables.pace import FASTEST_HZ
from accelcal_cli.formats.tables.signatures import BIDS_CHANNELS, BIDS_MOTION, bids_channels_path

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
