"""The datasets of an HDF5 file that can be read as rows of one or three numbers, and which of them hold what.

Acceleration, time, temperature and rates of turn are found by name.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from posixpath import basename, dirname
from typing import Any

import h5py
import numpy as np

from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.formats.hdf5.file import H5PY_ERRORS, members, normal

_ACCEL = (
    "accel accels acceleration accelerations acc accelerometer accelerometers accelerometerdata "
    "acceldata accdata accelraw rawaccel rawacc accelxyz accxyz accelerationxyz xyz raw"
)
_GYRO = "gyro gyros gyr gyroscope gyroscopes gyrodata gyroraw gyroxyz gyroscopexyz angularvelocity"
_TIME = "time times timestamp timestamps t unixtime epoch epochtime datetime"
_VALUES = "data values value samples xyz"
_ACCEL_PREFIXES = ("", "a", "acc", "accel", "acceleration", "accelerometer")
_GYRO_PREFIXES = ("g", "gyr", "gyro", "gyroscope")
_OTHER_SENSORS = ("gyr", "mag", "angular", "orient", "quat")


@dataclass(frozen=True, slots=True)
class Track:
    """A dataset of `rows` rows of `width` numbers; the rows run along its axis `axis`."""

    path: str
    rows: int
    width: int
    axis: int
    dtype: np.dtype[Any]

    @property
    def name(self) -> str:
        """The last part of the path."""
        return basename(self.path)

    @property
    def parent(self) -> str:
        """The group that holds it, `/` for the file itself."""
        return dirname(self.path)


def as_track(path: str, dataset: Any) -> Track | None:
    """How a dataset can be read as rows of 1 or 3 numbers; None if it cannot.

    (n,), (n, 1) and (1, n) are rows of one, (n, 3) and (3, n) rows of three; (3, 3) and (1, 3)
    are read with the rows along the first axis.
    """
    shape = dataset.shape
    if shape is None or len(shape) not in (1, 2) or dataset.dtype.kind not in "iuf":
        return None
    if len(shape) == 1:
        return Track(path, shape[0], 1, 0, dataset.dtype)
    for axis in (0, 1):
        if shape[1 - axis] in (1, 3):
            return Track(path, shape[axis], shape[1 - axis], axis, dataset.dtype)
    return None


Group = tuple[Track, ...]


def all_tracks(file: Any) -> tuple[tuple[Track, ...], int]:
    """Every dataset that can be read as rows of 1 or 3 numbers, by path; and how many are damaged."""
    found: list[Track] = []
    damaged = 0
    seen: set[int] = set()
    groups = [("", file["/"])]
    while groups:
        parent, group = groups.pop()
        nodes, lost = members(group)
        damaged += lost
        for name, node in nodes:
            address = hash(node.id)
            if address in seen:
                continue
            seen.add(address)
            if isinstance(node, h5py.Group):
                groups.append((f"{parent}/{name}", node))
            elif isinstance(node, h5py.Dataset) and (track := _track(f"{parent}/{name}", node)):
                found.append(track)
    return tuple(sorted(found, key=lambda track: track.path)), damaged


def _track(path: str, dataset: Any) -> Track | None:
    try:
        return as_track(path, dataset)
    except H5PY_ERRORS:
        return None


def described(tracks: Iterable[Track]) -> str:
    """Datasets as people read them: `/a (100 x 3), /b (100)`."""
    shown = [f"{item.path} ({item.rows}{' x 3' if item.width == 3 else ''})" for item in tracks]
    return ", ".join(shown[:20] + ["..."] * (len(shown) > 20)) or "none"


def chosen_axes(tracks: tuple[Track, ...], columns: tuple[str, str, str], path: Path) -> Group:
    """The datasets that `--columns` names: three of one column, or one of three named thrice.

    Raises:
        UsageError: a name fits no dataset or several, or the lengths differ.
    """
    named = tuple(named_track(tracks, column, path) for column in columns)
    if len(set(named)) == 1 and named[0].width == 3:
        return named[:1]
    if any(item.width != 1 for item in named) or len({item.rows for item in named}) != 1:
        raise UsageError(
            f"--columns must name three datasets of one length, or one of three columns three times, "
            f"not {described(named)}",
            path=path,
        )
    return named


def named_track(tracks: tuple[Track, ...], name: str, path: Path) -> Track:
    """The dataset of this path, or else the only one whose last part is this name.

    Raises:
        UsageError: there is none, or several.
    """
    full = "/" + name.strip().strip("/")
    exact = [item for item in tracks if item.path == full]
    found = exact or [item for item in tracks if normal(item.name) == normal(name)]
    if len(found) != 1:
        what = "several datasets" if found else "no dataset"
        raise UsageError(
            f"{what} named {name!r}", path=path, hint=f"datasets of the file: {described(found or tracks)}"
        )
    return found[0]


def find_accel(tracks: tuple[Track, ...], path: Path, sensor: str | None) -> Group:
    """The acceleration datasets, by name; `sensor` is a group on their path.

    Raises:
        UsageError: several fit, or none of the named sensor.
        UnreadableError: none fits.
    """
    found = [
        group
        for group in _groups(tracks, _ACCEL, _ACCEL_PREFIXES)
        if not _of_other_sensor(group[0]) and _within(group[0], sensor)
    ]
    if len(found) == 1:
        return found[0]
    if found:
        listed = ", ".join("+".join(item.path for item in group) for group in found)
        raise UnreadableError(
            f"several datasets may hold the acceleration: {listed}",
            path=path,
            hint="choose with --columns PATH,PATH,PATH (one dataset of three columns: its path three times)",
        )
    _refuse_without_accel(tracks, path, sensor)
    return ()


def _refuse_without_accel(tracks: tuple[Track, ...], path: Path, sensor: str | None) -> None:
    if sensor is not None:
        raise UsageError(
            f"no acceleration in a group named {sensor!r}",
            path=path,
            hint=f"datasets of the file: {described(tracks)}",
        )
    if not tracks:
        raise UnreadableError("no dataset of numbers can be found", path=path)
    raise UnreadableError(
        "no dataset has a name known for acceleration",
        path=path,
        hint=f"name it with --columns PATH,PATH,PATH; datasets of the file: {described(tracks)}",
    )


def find_gyro(tracks: tuple[Track, ...], accel: Track) -> tuple[Group, ...]:
    """The nearest gyroscope datasets of the same length."""
    groups = _groups(tracks, _GYRO, _GYRO_PREFIXES)
    own = sorted({item.parent for item in tracks if normal(basename(item.parent)) in _GYRO.split()})
    groups += [triple for parent in own if (triple := _triple(tracks, parent, ""))]
    groups = [group for group in groups if group[0].rows == accel.rows]
    return _nearest(groups, accel) or _beside(groups, accel)


def find_named(tracks: tuple[Track, ...], accel: Track, names: str) -> tuple[Group, ...]:
    """The nearest datasets of one of these names with one number for each row of the acceleration."""
    return _nearest(_columns(tracks, accel, lambda name: name in names.split()), accel)


def find_time(tracks: tuple[Track, ...], accel: Track) -> tuple[Group, ...]:
    """The nearest time datasets of the same length."""
    return _nearest(_columns(tracks, accel, lambda name: split_time_name(name)[0] in _TIME.split()), accel)


def split_time_name(name: str) -> tuple[str, str | None]:
    """A name without its unit, and the unit: `timestamp_us` gives timestamp and us."""
    plain, known = normal(name), _TIME.split()
    for unit in ("us", "ms", "ns", "s"):
        if plain not in known and plain.removesuffix(unit) in known:
            return plain.removesuffix(unit), unit
    return plain, None


def _columns(tracks: tuple[Track, ...], accel: Track, fits: Callable[[str], bool]) -> list[Group]:
    return [
        (item,) for item in tracks if item.width == 1 and item.rows == accel.rows and fits(normal(item.name))
    ]


def _groups(tracks: tuple[Track, ...], names: str, prefixes: tuple[str, ...]) -> list[Group]:
    """Datasets of three columns, and triples of one column each, whose names fit."""
    wide: list[Group] = [(item,) for item in tracks if item.width == 3 and _is_named(item, names)]
    parents = sorted({item.parent for item in tracks})
    return wide + [
        triple for parent in parents for prefix in prefixes if (triple := _triple(tracks, parent, prefix))
    ]


def _is_named(track: Track, names: str) -> bool:
    parent = normal(basename(track.parent))
    own, known = normal(track.name), names.split()
    return own in known or (own in _VALUES.split() and parent in known)


def _triple(tracks: tuple[Track, ...], parent: str, prefix: str) -> Group | None:
    """x, y and z of one length in one group, such as acc_x or x_acc; None unless all are there once."""
    here = [item for item in tracks if item.parent == parent and item.width == 1]
    axes = [[item for item in here if normal(item.name) in (prefix + axis, axis + prefix)] for axis in "xyz"]
    if any(len(items) != 1 for items in axes) or len({items[0].rows for items in axes}) != 1:
        return None
    return tuple(items[0] for items in axes)


def _of_other_sensor(track: Track) -> bool:
    parts = [normal(part) for part in track.path.split("/")]
    return any(part.startswith(_OTHER_SENSORS) for part in parts)


def _within(track: Track, sensor: str | None) -> bool:
    parts = track.path.lower().split("/")
    return sensor is None or sensor.strip("/").lower() in parts[:-1]


def _nearest(groups: list[Group], accel: Track) -> tuple[Group, ...]:
    """Those in the innermost group around the acceleration."""
    around = [group for group in groups if f"{accel.parent}/".startswith(group[0].parent.rstrip("/") + "/")]
    depth = max((len(group[0].parent) for group in around), default=0)
    return tuple(group for group in around if len(group[0].parent) == depth)


def _beside(groups: list[Group], accel: Track) -> tuple[Group, ...]:
    """Those in a gyroscope's own group, beside the acceleration or its group."""
    places = (accel.parent, dirname(accel.parent))
    return tuple(
        group
        for group in groups
        if dirname(group[0].parent) in places and normal(basename(group[0].parent)) in _GYRO.split()
    )
