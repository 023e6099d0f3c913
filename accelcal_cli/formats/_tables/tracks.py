"""What of a file can be read as rows of one or three numbers, and which of it holds what.

Acceleration, time, temperature and rates of turn are found by name.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from posixpath import basename, dirname
from typing import Any, Protocol

import numpy as np

from accelcal_cli.core.errors import NoRecordingError, UnreadableError, UsageError
from accelcal_cli.core.vocabulary import (
    ACCELEROMETER,
    GYROSCOPE,
    TIMES,
    UNIT_AT_END,
    In,
    names_in,
    normalized,
)

_ACCEL = names_in(ACCELEROMETER, In.TABLES)
_GYRO = names_in(GYROSCOPE, In.TABLES)
_TIME = names_in(TIMES, In.TABLES)
_VALUES = frozenset({"data", "values", "value", "samples", "xyz"})
_ACCEL_PREFIXES = sorted(names_in(ACCELEROMETER, In.AXES))
_GYRO_PREFIXES = sorted(names_in(GYROSCOPE, In.AXES))
_OTHER_SENSORS = ("gyr", "mag", "angular", "orient", "quat")


class File(Protocol):
    """What errors say of a file: where it is, and what its tracks are called there."""

    path: Path
    word: str


@dataclass(frozen=True, slots=True)
class Track:
    """`rows` rows of `width` numbers; the rows run along its axis `axis`.

    Attributes:
        clock: its numbers count from 1970 on a clock of an unknown zone.
    """

    path: str
    rows: int
    width: int
    axis: int
    dtype: np.dtype[Any]
    clock: bool = False

    @property
    def name(self) -> str:
        """The last part of the path."""
        return basename(self.path)

    @property
    def parent(self) -> str:
        """The group that holds it, `/` for the file itself."""
        return dirname(self.path)


def track_of_shape(path: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Track | None:
    """How an array can be read as rows of 1 or 3 numbers; None if it cannot.

    (n,), (n, 1) and (1, n) are rows of one, (n, 3) and (3, n) rows of three; (3, 3) and (1, 3)
    are read with the rows along the first axis.
    """
    if len(shape) not in (1, 2) or dtype.kind not in "iuf":
        return None
    if len(shape) == 1:
        return Track(path, shape[0], 1, 0, dtype)
    for axis in (0, 1):
        if shape[1 - axis] in (1, 3):
            return Track(path, shape[axis], shape[1 - axis], axis, dtype)
    return None


Group = tuple[Track, ...]


def described(tracks: Iterable[Track]) -> str:
    """Tracks as people read them: `/a (100 x 3), /b (100)`."""
    shown = [f"{item.path} ({item.rows}{' x 3' if item.width == 3 else ''})" for item in tracks]
    return ", ".join(shown[:20] + ["..."] * (len(shown) > 20)) or "none"


def chosen_axes(
    tracks: tuple[Track, ...], columns: tuple[str, str, str], file: File, option: str = "--columns"
) -> Group:
    """The tracks that an option names: three of one column, or one of three named thrice.

    Raises:
        UsageError: a name fits no dataset or several, or the lengths differ.
    """
    named = tuple(named_track(tracks, column, file) for column in columns)
    if len(set(named)) == 1 and named[0].width == 3:
        return named[:1]
    if any(item.width != 1 for item in named) or len({item.rows for item in named}) != 1:
        raise UsageError(
            f"{option} must name three {file.word}s of one length, or one of three numbers a row thrice, "
            f"not {described(named)}",
            path=file.path,
        )
    return named


def named_track(tracks: tuple[Track, ...], name: str, file: File) -> Track:
    """The track of this path, or else the only one whose last part is this name.

    Raises:
        UsageError: there is none, or several.
    """
    full = "/" + name.strip().strip("/")
    exact = [item for item in tracks if item.path == full]
    found = exact or [item for item in tracks if normalized(item.name) == normalized(name)]
    if len(found) != 1:
        what = f"several {file.word}s" if found else f"no {file.word}"
        raise UsageError(
            f"{what} named {name!r}",
            path=file.path,
            hint=f"{file.word}s of the file: {described(found or tracks)}",
        )
    return found[0]


def find_accel(tracks: tuple[Track, ...], file: File, sensor: str | None) -> Group:
    """The tracks of acceleration, by name; `sensor` is a group on their path.

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
            f"several {file.word}s may hold the acceleration: {listed}",
            path=file.path,
            hint=f"choose with --columns PATH,PATH,PATH (one {file.word} of three numbers a row: its path "
            "three times)",
        )
    _refuse_without_accel(tracks, file, sensor)
    return ()


def _refuse_without_accel(tracks: tuple[Track, ...], file: File, sensor: str | None) -> None:
    if sensor is not None:
        raise UsageError(
            f"no acceleration in a group named {sensor!r}",
            path=file.path,
            hint=f"{file.word}s of the file: {described(tracks)}",
        )
    if not tracks:
        raise NoRecordingError(
            f"no {file.word} of numbers can be found",
            path=file.path,
            hint="give it x, y and z, and times, as numbers",
        )
    raise NoRecordingError(
        f"no {file.word} has a name known for acceleration",
        path=file.path,
        hint=f"name it with --columns PATH,PATH,PATH; {file.word}s of the file: {described(tracks)}",
    )


def find_gyro(tracks: tuple[Track, ...], accel: Track) -> tuple[Group, ...]:
    """The nearest gyroscope tracks of the same length."""
    groups = _groups(tracks, _GYRO, _GYRO_PREFIXES)
    own = sorted({item.parent for item in tracks if normalized(basename(item.parent)) in _GYRO})
    groups += [triple for parent in own if (triple := _triple(tracks, parent, ""))]
    groups = [group for group in groups if group[0].rows == accel.rows]
    return _nearest(groups, accel) or _beside(groups, accel)


def find_named(tracks: tuple[Track, ...], accel: Track, names: frozenset[str]) -> tuple[Group, ...]:
    """The nearest tracks of one of these names with one number for each row of the acceleration."""
    return _nearest(_columns(tracks, accel, lambda name: name in names), accel)


def find_time(tracks: tuple[Track, ...], accel: Track) -> tuple[Group, ...]:
    """The nearest tracks of times of the same length."""
    return _nearest(_columns(tracks, accel, lambda name: split_time_name(name)[0] in _TIME), accel)


def split_unit(name: str) -> tuple[str, str | None]:
    """A sensor's name without its unit, and the unit: `acc_x_mg` gives accx and mg."""
    found = UNIT_AT_END.fullmatch(name.strip())
    return (normalized(name), None) if found is None else (normalized(found[1]), found[2])


def split_time_name(name: str) -> tuple[str, str | None]:
    """A name without its unit, and the unit: `timestamp_us` gives timestamp and us."""
    plain, known = normalized(name), _TIME
    for unit in ("us", "ms", "ns", "s"):
        if plain not in known and plain.removesuffix(unit) in known:
            return plain.removesuffix(unit), unit
    return plain, None


def _columns(tracks: tuple[Track, ...], accel: Track, fits: Callable[[str], bool]) -> list[Group]:
    return [
        (item,)
        for item in tracks
        if item.width == 1 and item.rows == accel.rows and fits(normalized(item.name))
    ]


def _groups(tracks: tuple[Track, ...], names: frozenset[str], prefixes: list[str]) -> list[Group]:
    """Tracks of three columns, and triples of one column each, whose names fit."""
    wide: list[Group] = [(item,) for item in tracks if item.width == 3 and _is_named(item, names)]
    parents = sorted({item.parent for item in tracks})
    return wide + [
        triple for parent in parents for prefix in prefixes if (triple := _triple(tracks, parent, prefix))
    ]


def _is_named(track: Track, names: frozenset[str]) -> bool:
    parent = normalized(basename(track.parent))
    own = split_unit(track.name)[0]
    return own in names or (own in _VALUES and parent in names)


def _triple(tracks: tuple[Track, ...], parent: str, prefix: str) -> Group | None:
    """x, y and z of one length in one group, such as acc_x or x_acc; None unless all are there once."""
    here = [item for item in tracks if item.parent == parent and item.width == 1]
    names = [split_unit(item.name)[0] for item in here]
    axes = [
        [item for item, name in zip(here, names, strict=True) if name in (prefix + axis, axis + prefix)]
        for axis in "xyz"
    ]
    if any(len(items) != 1 for items in axes) or len({items[0].rows for items in axes}) != 1:
        return None
    return tuple(items[0] for items in axes)


def _of_other_sensor(track: Track) -> bool:
    parts = [normalized(part) for part in track.path.split("/")]
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
        if dirname(group[0].parent) in places and normalized(basename(group[0].parent)) in _GYRO
    )
