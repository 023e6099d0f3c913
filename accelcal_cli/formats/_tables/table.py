"""An open file as a table: its columns (`Track`), what is stated of them (`Attributes`), and their rows.

Acceleration, time, temperature and rotation rates are found by name. A format says which tracks its files
have (`Table`) and gives the rows of each (`RowSource`); `RowSelection` notes which rows are kept.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from posixpath import basename, dirname
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import AccelcalError, NoRecordingError, UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.thermometers import BARE, find_thermometer
from accelcal_cli.core.vocabulary import AXES, BARE_TIMES, CSV, TABLES, UNIT_AT_END, normalized
from accelcal_cli.formats._problems import Event, Kind, ProblemLog

BLOCK_ROWS = 65_536
"""Rows that are read at a time."""

REFUSE_ABOVE_BYTES = 128 << 20
"""Bytes of all columns that may be unpacked whole together; at moments it takes three times as much."""

READ_ERRORS = (
    OSError, RuntimeError, ValueError, TypeError, LookupError, ArithmeticError, AttributeError, MemoryError,
    SystemError,
)  # fmt: skip
"""Errors to which libraries that read files map their failures: almost any of Python's own kinds."""

VALUE_NAMES = frozenset({"data", "values", "value", "samples", "xyz"})
"""Names of a track that say nothing; the group around it then tells what it holds."""

OTHER_SENSORS = ("gyr", "mag", "angular", "orient", "quat")
"""Beginnings of names that rule out acceleration."""

MORE_TIMES = (CSV.times | BARE_TIMES) - TABLES.times
"""Names of columns of times in text files, which mean times in tables that have no other name for them."""

DURATION_WORDS = sorted(TABLES.durations, key=lambda word: (-len(word), word))
"""Names of units of time, the longest first."""

MOST_SHOWN = 20
"""Number of tracks, and of objects, that a message names."""

OBJECTS = (
    "(tables, timetables, cells and dates are objects): save their columns as plain arrays, with times in "
    "seconds (in MATLAB: posixtime)"
)

TEXT = np.dtype(object)
"""Type of a track of texts."""

Offset = Callable[[int], int | None]


def readable(text: str) -> str:
    """Return a name or text of a file, with bytes that are not UTF-8, which h5py passes on, replaced."""
    return text.encode("utf-8", "surrogateescape").decode("utf-8", "replace")


def plain_value(value: object) -> str | float | None:
    """Return an attribute as text or number; None if it is neither, empty or a list."""
    if isinstance(value, np.ndarray):
        value = value.ravel()[0] if value.size == 1 else None
    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    if isinstance(value, str):
        return readable(value).replace("\0", " ").strip() or None
    if isinstance(value, bool | int | float | np.number | np.bool_) and not np.iscomplexobj(value):
        return float(value)
    return None


class Attributes:
    """Values that are stated of a column, of the groups around it and of the file: the nearest wins.

    Names are compared without case and punctuation. A value that cannot be read counts as absent; its name
    is kept in `damaged`.

    Args:
        layers: values by their names, the nearest first.
    """

    def __init__(self, layers: Sequence[Mapping[str, object]] = ()) -> None:
        self.damaged: list[str] = []
        self._layers = [{normalized(name): value for name, value in layer.items()} for layer in layers]

    def value(self, *names: str) -> str | float | None:
        """Return the value of the first of these names that has one."""
        for depth in range(len(self._layers)):
            for name in names:
                if (found := self.read(depth, normalized(name))) is not None:
                    return found
        return None

    def read(self, depth: int, name: str) -> str | float | None:
        """Return the value of a normalized name in a layer, None if there is none."""
        return plain_value(self._layers[depth].get(name))

    def text(self, *names: str) -> str | None:
        """Return the value as text; a whole number is written without a decimal point."""
        value = self.value(*names)
        if isinstance(value, float):
            return f"{value:.0f}" if value.is_integer() else str(value)
        return value

    def number(self, *names: str) -> float | None:
        """Return the value as a number, also from text such as `100 Hz`; None if it is not one."""
        value = self.value(*names)
        if isinstance(value, str):
            found = re.match(r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?", value)
            value = float(found[0]) if found else None
        return value if value is not None and np.isfinite(value) else None


@dataclass(frozen=True, slots=True)
class Track:
    """A column of `rows` rows of `width` numbers; the rows run along its axis `axis`.

    Attributes:
        clock: its numbers count from 1970 on a clock of an unknown zone.
        written: how texts become its numbers; None for a track of numbers.
    """

    path: str
    rows: int
    width: int
    axis: int
    dtype: np.dtype[Any]
    clock: bool = False
    written: WrittenNumbers | None = None

    @property
    def name(self) -> str:
        """The last part of the path."""
        return basename(self.path)

    @property
    def parent(self) -> str:
        """The group that holds it, `/` for the file itself."""
        return dirname(self.path)


class WrittenNumbers(Protocol):
    """How texts of a column become numbers; it can be hashed."""

    def values(self, cells: Any) -> NDArray[Any]:
        """Return texts, an array of Arrow (n,), as numbers (n,)."""


Group = tuple[Track, ...]
"""One track of three numbers a row, or three tracks of one."""


def track_of_shape(path: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Track | None:
    """Return an array as a track of rows of 1 or 3 numbers; None if it cannot be read so.

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


def shown(names: Sequence[str]) -> str:
    """Return names with commas between them; of many, the first ones."""
    return ", ".join(map(readable, names[:MOST_SHOWN])) + ", ..." * (len(names) > MOST_SHOWN)


def described(tracks: Iterable[Track]) -> str:
    """Return tracks as people read them: `/a (100 x 3), /b (100)`."""
    return shown([f"{item.path} ({item.rows}{' x 3' * (item.width == 3)})" for item in tracks]) or "none"


class RowSource(Protocol):
    """The rows of a track, read in order.

    Attributes:
        path: the track's.
        row_bytes: bytes of one row.
        kept_bytes: bytes that have to be kept unpacked.
    """

    kept_bytes: int

    @property
    def path(self) -> str: ...

    @property
    def row_bytes(self) -> int: ...

    def read(self, start: int, stop: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Return rows start..stop-1, shape (stop - start, width), and flags of those that are not lost."""

    def chunk_offset(self, row: int) -> int | None:
        """Return the byte in the file of the part that holds a row; None if that is not known."""


class SensorTable:
    """An open file whose tracks are known.

    Attributes:
        word: the word for a track in messages.
        text_tracks: columns of texts; their rows are numbers of the texts that `texts_of` returns.
        objects: names of what holds neither numbers nor texts.
    """

    path: Path
    word = "column"
    text_tracks: tuple[Track, ...] = ()
    objects: Sequence[str] = ()

    @property
    def unread(self) -> str:
        """Names what of the file cannot be read, and says how to save it; empty if there is nothing."""
        return f"{shown(sorted(self.objects))} cannot be read {OBJECTS}" if self.objects else ""

    def described(self, tracks: Iterable[Track]) -> str:
        """Return these tracks, and what cannot be read of the file, for people."""
        return "; ".join(filter(None, (f"{self.word}s of the file: {described(tracks)}", self.unread)))

    def texts_of(self, track: Track) -> list[str] | None:
        """Return the texts of a column that were read so far; None for one of numbers."""
        return None

    def missing_bytes(self) -> int:
        """Return the number of bytes that a file that was cut short lacks; -1 if that is not known."""
        return 0

    def own(self, path: str) -> Attributes:
        """Return what is stated of a track alone."""
        raise NotImplementedError

    def stated(self, path: str) -> Attributes:
        """Return what is stated of a track, then of all that is around it, up to the file."""
        raise NotImplementedError

    def rows(self, track: Track) -> RowSource:
        """Return the rows of a track; raise UnreadableError where they cannot be read in parts."""
        raise NotImplementedError

    def guard(self, what: str) -> AbstractContextManager[None]:
        """Turn errors of a library into an UnreadableError that names the part concerned."""
        return nullcontext()

    @contextmanager
    def explaining(self, damaged: int = 0) -> Iterator[None]:
        """Add to any error of ours that the file is cut short or damaged, if it is."""
        missing, size = self.missing_bytes(), None
        try:
            yield
        except AccelcalError as error:
            what, hint = error.message, error.hint
            if missing:
                size = self.path.stat().st_size
                to = f" to {size} of {size + missing} bytes" if missing > 0 else ""
                what = f"is cut short{to}, so that {what}"
                hint = "; or ".join(filter(None, (hint, "copy the whole file again from its source")))
            elif damaged:
                what = f"is damaged in {damaged} places, so that {what}"
            error.message, error.byte_offset, error.hint = what, size, hint
            raise


@dataclass(frozen=True, slots=True)
class TableSource:
    """A table being opened: all its tracks, where the acceleration is, and what is stated of it.

    Attributes:
        damaged: number of parts of the file that cannot be read.
    """

    table: SensorTable
    options: ReadOptions
    tracks: tuple[Track, ...]
    group: Group
    attributes: Attributes
    damaged: int = 0

    @property
    def path(self) -> Path:
        """The file."""
        return self.table.path

    @property
    def accel(self) -> Track:
        """The track of acceleration, or of its x axis."""
        return self.group[0]


def good_rows(rows: RowSource, start: int, stop: int) -> NDArray[Any]:
    """Return rows start..stop-1 without the lost ones, (n, width)."""
    values, good = rows.read(start, stop)
    return values[good]


def nowhere(_row: int) -> None:
    """Return no byte offset, for a fault that lies in values, not in bytes."""


class RowSelection:
    """Notes which of the rows start..stop-1 of the tracks are kept, and what is wrong with others.

    Args:
        row_bytes: bytes of a row in all tracks together.
    """

    def __init__(self, start: int, stop: int, row_bytes: int) -> None:
        self.start = start
        self.stop = stop
        self.row_bytes = row_bytes
        self.keep = np.ones(stop - start, np.bool_)
        self._as_one: set[Kind] = set()
        self._empty: set[Kind] = set()
        self._faults: dict[tuple[Kind, Offset, int], list[NDArray[np.int64]]] = {}

    def read(self, source: RowSource) -> NDArray[Any]:
        """Return all rows of a track (n, width); lost ones are zero and left out."""
        values, good = source.read(self.start, self.stop)
        self.lose(source, ~good)
        return values

    def lose(self, source: RowSource, lost: NDArray[np.bool_]) -> None:
        """Drop rows that a track has lost."""
        if lost.any():
            kind = ("bad_page", f"rows lost in damaged or missing parts of {readable(source.path)}")
            self.leave_out(kind, lost, source.chunk_offset)

    def leave_out(self, kind: Kind, bad: NDArray[np.bool_], offset: Offset = nowhere) -> None:
        """Drop rows; those dropped before are not noted again."""
        bad = bad & self.keep
        self.note(kind, np.flatnonzero(bad), offset, self.row_bytes)
        self.keep &= ~bad

    def leave_out_empty(self, kind: Kind, empty: NDArray[np.bool_]) -> None:
        """Drop rows without values, which are not damage."""
        self._empty.add(kind)
        self.leave_out(kind, empty)

    def note(self, kind: Kind, rows: NDArray[np.int64], offset: Offset = nowhere, row_bytes: int = 0) -> None:
        """Note rows, given by their numbers within the selection, without dropping them."""
        if len(rows):
            self._faults.setdefault((kind, offset, row_bytes), []).append(rows)

    def note_as_one(self, kind: Kind, rows: NDArray[np.int64]) -> None:
        """Note rows, all of them in a single record, however many."""
        self._as_one.add(kind)
        self.note(kind, rows)

    def kept(self, values: Any) -> Any:
        """Return the kept ones of the rows of an array."""
        return values if self.keep.all() else values[self.keep]

    def rows(self) -> NDArray[np.int64]:
        """Return the numbers of the kept rows within the selection, (n,)."""
        return np.arange(len(self.keep)) if self.keep.all() else np.flatnonzero(self.keep)

    def events(self, log: ProblemLog, first_sample: int) -> Iterator[Event]:
        """Yield what was noted, as the log takes it; `first_sample` is the number of the first kept row.

        Rows with one fault are a run wherever it lies, in the acceleration or in the gyroscope.
        """
        kept = self.rows() if self._faults else np.empty(0, np.int64)
        for (kind, offset, row_bytes), parts in self._faults.items():
            rows = np.sort(np.concatenate(parts))
            runs = [(0, len(rows), True)] if kind in self._as_one else log.runs(kind, rows)
            for index, count, scattered in runs:
                row = int(rows[index])
                start, sample = self.start + row, first_sample + int(np.searchsorted(kept, row))
                amounts = (count, 0, count * row_bytes)
                made = Event(start, count, *kind, offset(start), sample, *amounts, scattered=scattered)
                yield replace(made, lost_bytes=0, empty_rows=count) if kind in self._empty else made


def chosen_axes(
    tracks: tuple[Track, ...], columns: tuple[str, str, str], table: SensorTable, option: str = "--columns"
) -> Group:
    """Return the tracks that an option names: three of one number a row, or one of three.

    Raises:
        UsageError: a name fits no track or several, or the lengths differ.
    """
    named = tuple(named_track(tracks, column, table) for column in columns)
    if len(set(named)) == 1 and named[0].width == 3:
        return named[:1]
    if any(item.width != 1 for item in named) or len({item.rows for item in named}) != 1:
        raise UsageError(
            f"{option} must name three {table.word}s of one length, or one of three numbers a row, "
            f"not {described(named)}",
            path=table.path,
        )
    return named


def named_track(tracks: tuple[Track, ...], name: str, table: SensorTable) -> Track:
    """Return the track of this path, or else the only one whose last part is this name.

    Raises:
        UsageError: there is none, or several.
    """
    full = "/" + name.strip().strip("/")
    exact = [item for item in tracks if item.path == full]
    found = exact or [item for item in tracks if normalized(item.name) == normalized(name)]
    if len(found) != 1:
        what = f"several {table.word}s" if found else f"no {table.word}"
        raise UsageError(
            f"{what} named {name!r}",
            path=table.path,
            hint=table.described(found or tracks),
        )
    return found[0]


def is_in_group(track: Track, sensor: str) -> bool:
    """Return True if a group around a track has this name, or this path: `Test5/Trial1`."""
    return f"/{sensor.strip().strip('/')}/".lower() in f"{track.parent.rstrip('/')}/".lower()


def find_accel(tracks: tuple[Track, ...], table: SensorTable, sensor: str | None) -> Group:
    """Find the tracks of acceleration by name; `sensor` names a group around them.

    Raises:
        UsageError: several fit, or none of the named sensor.
        UnreadableError: none fits.
    """
    found = [
        group
        for group in _groups(tracks, TABLES.accelerometer, sorted(AXES.accelerometer))
        if not any(normalized(part).startswith(OTHER_SENSORS) for part in group[0].path.split("/"))
        and (sensor is None or is_in_group(group[0], sensor))
    ]
    if len(found) == 1:
        return found[0]
    if found:
        listed = shown(["+".join(item.path for item in group) for group in found])
        groups = [group[0].parent.strip("/") for group in found]
        raise UnreadableError(
            f"several {table.word}s may hold the acceleration: {listed}",
            path=table.path,
            hint=f"choose one: {' or '.join(map(_choice, found[:2]))}",
            sensors=groups if all(groups) and len({*groups}) == len(groups) else (),
        )
    if sensor is not None:
        raise UsageError(
            f"no acceleration in a group named {sensor!r}",
            path=table.path,
            hint=table.described(tracks),
        )
    if not tracks:
        raise NoRecordingError(
            f"no {table.word} of numbers can be found",
            path=table.path,
            hint=table.unread or "give it x, y and z, and times, as numbers",
        )
    wide = [(track,) for track in tracks if track.width == 3]
    columns = _choice(wide[0]) if wide else "--columns PATH,PATH,PATH"
    raise NoRecordingError(
        f"no {table.word} has a name known for acceleration",
        path=table.path,
        hint=f"name it, as in {columns}; {table.described(tracks)}",
    )


def _choice(group: Group) -> str:
    """Return the option that chooses the acceleration."""
    return f"--columns {shlex.quote(','.join(readable(track.path) for track in group))}"


def find_gyro(tracks: tuple[Track, ...], accel: Track) -> tuple[Group, ...]:
    """Find the nearest gyroscope tracks of the same length."""
    groups = _groups(tracks, TABLES.gyroscope, sorted(AXES.gyroscope))
    by_parent = _by_parent(tracks)
    own = sorted({item.parent for item in tracks if normalized(basename(item.parent)) in TABLES.gyroscope})
    groups += [triple for parent in own if (triple := _triple(by_parent.get(parent, {}), ""))]
    groups = [group for group in groups if group[0].rows == accel.rows]
    places = (accel.parent, dirname(accel.parent))
    return _nearest(groups, accel) or tuple(
        group for group in groups if group[0].parent in own and dirname(group[0].parent) in places
    )


def find_heat(tracks: tuple[Track, ...], accel: Track) -> tuple[tuple[Group, ...], tuple[Track, ...]]:
    """Find the nearest tracks of temperatures of the same length, and those that only look like one."""
    groups = _columns(tracks, accel, lambda _name: True)
    timed = any(_is_time(group[0].name) and group[0].name != BARE for group in groups)
    free = [group for group in groups if timed or group[0].name != BARE]
    named = tuple(group for group in free if find_thermometer([(group[0].name, None)])[0])
    near = [*_nearest([*named], accel)]
    found, _ = find_thermometer([(group[0].name, None) for group in near])
    best = (near[found.number],) if found is not None else tuple(near)
    _, like = find_thermometer([(group[0].name, None) for group in free if group not in named])
    others = [group for group in free if group not in named]
    left = [group[0] for group in near if group not in best]
    return best, (*left, *(others[number][0] for number in like))


def find_time(tracks: tuple[Track, ...], accel: Track) -> tuple[Group, ...]:
    """Find the nearest tracks of times of the same length."""
    found = _nearest(_columns(tracks, accel, _is_time), accel)
    named = tuple(group for group in found if group[0].name != BARE)
    return named or found or _nearest(_columns(tracks, accel, _may_be_time), accel)


def _is_time(name: str) -> bool:
    return split_time_name(name)[0] in TABLES.times


def _may_be_time(name: str) -> bool:
    """Return True for names that mean times in text files, and here where no other column does."""
    return split_time_name(name)[0] in MORE_TIMES


def split_unit(name: str) -> tuple[str, str | None]:
    """Return a sensor's name without its unit, and the unit: `acc_x_mg` gives accx and mg."""
    found = UNIT_AT_END.fullmatch(name.strip())
    return (normalized(name), None) if found is None else (normalized(found[1]), found[2])


def split_time_name(name: str) -> tuple[str, str | None]:
    """Return a name without its unit, and the unit: `timestamp_us` gives timestamp and us."""
    plain = normalized(name)
    if plain in TABLES.times or plain in CSV.times:
        return plain, None
    if plain in BARE_TIMES:
        return plain, TABLES.durations.get(plain)
    for word in DURATION_WORDS:
        stem = plain.removesuffix(word)
        if stem != plain and (stem in TABLES.times or stem in MORE_TIMES):
            return stem, TABLES.durations[word]
    return plain, None


def _columns(tracks: tuple[Track, ...], accel: Track, fits: Callable[[str], bool]) -> list[Group]:
    same = (item for item in tracks if item.width == 1 and item.rows == accel.rows)
    return [(item,) for item in same if fits(normalized(item.name))]


def _groups(tracks: tuple[Track, ...], names: frozenset[str], prefixes: list[str]) -> list[Group]:
    """Return tracks of three columns, and triples of one column each, whose names fit."""
    wide: list[Group] = [(item,) for item in tracks if item.width == 3 and _has_name(item, names)]
    by_parent = _by_parent(tracks)
    return wide + [
        triple
        for parent in sorted(by_parent)
        for prefix in prefixes
        if (triple := _triple(by_parent[parent], prefix))
    ]


def _by_parent(tracks: Iterable[Track]) -> dict[str, dict[str, list[Track]]]:
    """Return the tracks of one number a row, by the group that holds them and their name without a unit."""
    found: dict[str, dict[str, list[Track]]] = {}
    for item in tracks:
        if item.width == 1:
            found.setdefault(item.parent, {}).setdefault(split_unit(item.name)[0], []).append(item)
    return found


def _has_name(track: Track, names: frozenset[str]) -> bool:
    own = split_unit(track.name)[0]
    return own in names or (own in VALUE_NAMES and normalized(basename(track.parent)) in names)


def _triple(by_name: Mapping[str, list[Track]], prefix: str) -> Group | None:
    """Return x, y and z of one length in a group, such as acc_x or x_acc; None unless all are there once."""
    axes = [
        [item for name in {prefix + axis, axis + prefix} for item in by_name.get(name, ())] for axis in "xyz"
    ]
    if any(len(items) != 1 for items in axes) or len({items[0].rows for items in axes}) != 1:
        return None
    return tuple(items[0] for items in axes)


def _nearest(groups: list[Group], accel: Track) -> tuple[Group, ...]:
    """Return the groups in the innermost group around the acceleration."""
    around = [group for group in groups if f"{accel.parent}/".startswith(group[0].parent.rstrip("/") + "/")]
    depth = max((len(group[0].parent) for group in around), default=0)
    return tuple(group for group in around if len(group[0].parent) == depth)
