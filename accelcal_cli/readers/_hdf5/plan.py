"""What readers of HDF5 files find out about chosen datasets before the rows stream."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Problem
from accelcal_cli.readers._hdf5.file import H5PY_ERRORS, Attributes
from accelcal_cli.readers._hdf5.find import Group
from accelcal_cli.readers._hdf5.rows import BLOCK_ROWS, TrackRows
from accelcal_cli.readers._hdf5.scale import millicelsius
from accelcal_cli.readers._hdf5.stream import Axes, Stamps, Temperature
from accelcal_cli.readers._hdf5.time import StampScale, typical_step
from accelcal_cli.readers._hdf5.track import Track

SLOWEST_HZ, FASTEST_HZ = 0.01, 100_000.0


@dataclass(frozen=True, slots=True)
class Source:
    """A file being opened: all its datasets, where the acceleration is, what is said about it."""

    file: Any
    path: Path
    options: ReadOptions
    tracks: tuple[Track, ...]
    group: Group
    attributes: Attributes
    damaged: int = 0

    @property
    def accel(self) -> Track:
        """The dataset of acceleration, or of its x axis."""
        return self.group[0]


def good_rows(rows: TrackRows, start: int, stop: int) -> NDArray[Any]:
    """Rows start..stop-1 without the lost ones, (n, width)."""
    values, good = rows.read(start, stop)
    return values[good]


def head_rows(file: Any, track: Track, path: Path) -> NDArray[Any]:
    """The first rows of a dataset, at most one block, without lost ones."""
    return good_rows(TrackRows(file, track, path), 0, min(track.rows, BLOCK_ROWS))


def spread_rows(file: Any, track: Track, path: Path, places: int = 5, each: int = 1024) -> NDArray[Any]:
    """Some rows from the beginning, the end and between, without lost ones."""
    rows = TrackRows(file, track, path)
    last = max(0, track.rows - each)
    starts = sorted({place * last // (places - 1) for place in range(places)})
    return np.concatenate([good_rows(rows, start, min(start + each, track.rows)) for start in starts])


def is_readable(file: Any, track: Track, path: Path) -> bool:
    """Whether the rows of a dataset can be reached at all."""
    try:
        TrackRows(file, track, path)
    except (UnreadableError, *H5PY_ERRORS):
        return False
    return True


def first_temperature(file: Any, track: Track, factor: float, path: Path) -> Temperature | None:
    """A temperature dataset with its first value; None where it has no value at all."""
    rows = TrackRows(file, track, path)
    for start in range(0, track.rows, BLOCK_ROWS):
        degrees = millicelsius(*rows.read(start, min(start + BLOCK_ROWS, track.rows)), factor)
        known = degrees[~np.isnan(degrees)]
        if len(known):
            return Temperature(track, factor, int(known[0]))
    return None


def measured_stamps(
    file: Any, track: Track, scale: StampScale, path: Path
) -> tuple[Stamps, int, int, float | None]:
    """A time dataset, its first and last times [us] and the mean step between samples [us].

    Raises:
        UnreadableError: its first rows hold no time at all.
    """
    rows = TrackRows(file, track, path)
    times = _believable(rows, scale, 0, min(track.rows, BLOCK_ROWS))
    if not len(times):
        raise UnreadableError(
            f"dataset {track.path} holds no time that can be believed",
            path=path,
            hint="leave it aside with --time-column none and give --rate HZ",
        )
    final = _believable(rows, scale, max(0, track.rows - BLOCK_ROWS), track.rows)
    last = int(final[-1]) if len(final) else int(times[-1])
    step, coarse = typical_step(times) or (None, 0)
    return Stamps(track, scale, coarse), int(times[0]), max(last, int(times[0])), step


def _believable(rows: TrackRows, scale: StampScale, start: int, stop: int) -> NDArray[np.int64]:
    times, good = scale.times(good_rows(rows, start, stop)[:, 0])
    return times[good]


def whole_rows_known(*parts: Axes | Stamps | None) -> bool:
    """Whether every row is usable, as far as the kinds of numbers tell: only whole counts."""
    return all(isinstance(part, Axes) and part.scale.exact is not None for part in parts if part is not None)


def checked_rate(rate_hz: float | None, path: Path) -> float:
    """A sampling rate that can be worked with.

    Raises:
        UsageError: none is known.
        UnreadableError: it is no rate of a recorder.
    """
    if rate_hz is None:
        raise UnreadableError(
            "the file does not tell the sampling rate", path=path, hint="give it with --rate HZ"
        )
    if not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
        raise UnreadableError(
            f"a sampling rate of {rate_hz:g} Hz cannot be right", path=path, hint="give it with --rate HZ"
        )
    return rate_hz


def known_zone(name: str | None) -> str | None:
    """The name of a time zone if it is one, else None."""
    if name is None or name.upper() in ("UTC", "Z"):
        return name and "UTC"
    try:
        return ZoneInfo(name).key
    except (ZoneInfoNotFoundError, ValueError, OSError):
        return None


def header_problems(attributes: Attributes, damaged: int = 0) -> tuple[Problem, ...]:
    """One problem where attributes, datasets or groups could not be read."""
    count = len(attributes.damaged) + damaged
    if not count:
        return ()
    what = f"{count} attributes, datasets or groups cannot be read and count as absent"
    return (Problem("damaged_header", what, None, 0, count),)
