"""Tables with a column that may tell whose each row is: the watch over it, and one sensor's rows as a table.

The column is one of texts or whole numbers, as long as the acceleration and not farther away in the file.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.formats import EVERY_ROW
from accelcal_cli.core.vocabulary import TABLES
from accelcal_cli.formats._tables.sensors import (
    CellTexts,
    Meaning,
    Watch,
    counted_texts,
    matched,
    meaning_of,
    no_such_sensor,
    note_of,
)
from accelcal_cli.formats._tables.table import (
    BLOCK_ROWS,
    Attributes,
    RowSource,
    SensorTable,
    Track,
    split_time_name,
)

MOST_TEXTS = 1 << 14
"""A column with more values counts rows, or measures something."""

MOST_TRACKS = 1000
"""Most columns that are watched."""


def dividing_tracks(
    table: SensorTable, tracks: tuple[Track, ...], accel: Track, used: tuple[Track, ...] = ()
) -> tuple[Track, ...]:
    """Return the tracks that may tell whose each row is, but those that are used otherwise.

    Where there are more than MOST_TRACKS, those with the most telling names.
    """
    paths = {track.path for track in used}
    named = [
        track
        for track in (*table.text_tracks, *tracks)
        if track.rows == accel.rows and track.width == 1 and track.path not in paths
        if f"{accel.parent}/".startswith(track.parent.rstrip("/") + "/")
        if meaning_of(track.name) is not Meaning.MEASURED
        if split_time_name(track.name)[0] not in TABLES.times and not track.clock
    ]
    if len(named) > MOST_TRACKS:
        named = sorted(named, key=lambda track: meaning_of(track.name), reverse=True)[:MOST_TRACKS]
    return tuple(track for track in named if track.dtype.kind != "f" or _is_whole(table, track))


def _is_whole(table: SensorTable, track: Track) -> bool:
    """Return True if the first numbers of a track are whole, as pandas has those in columns with empty
    cells."""
    values, good = table.rows(track).read(0, min(track.rows, BLOCK_ROWS))
    values = values[good]
    values = values[np.isfinite(values)]
    return bool(len(values) and np.all(values == np.rint(values)))


class DividingRows:
    """Reads the values of a track, in order."""

    def __init__(self, table: SensorTable, track: Track) -> None:
        self._table, self._track, self._rows = table, track, table.rows(track)

    def read(self, start: int, stop: int) -> CellTexts:
        """Return the values of rows start..stop-1."""
        values, good = self._rows.read(start, stop)
        column = values[:, 0]
        if (read := self._table.texts_of(self._track)) is not None:
            return CellTexts(read, np.where(good, column, -1).astype(np.int32))
        known = good & np.isfinite(column) & (np.abs(column.astype(np.float64)) < 1 << 53)
        numbers, codes = np.unique(np.where(known, column, 0), return_inverse=True)
        texts = [f"{value:.0f}" if value == np.rint(value) else repr(float(value)) for value in numbers]
        return CellTexts(texts, np.where(known, codes, -1).astype(np.int32))


@dataclass(frozen=True, slots=True)
class Divided:
    """The tracks of a table that may tell whose each row is.

    Attributes:
        since_1970: the times of its rows are moments.
        wanted: what --sensor has chosen.
    """

    tracks: tuple[Track, ...] = ()
    since_1970: bool = False
    wanted: str | None = None

    def watch(self, table: SensorTable) -> SensorWatch | None:
        """Return a watch over the tracks; None without any."""
        return SensorWatch(table, self) if self.tracks else None


class SensorWatch:
    """The watch over a table whose rows may turn out to be of several sensors: see `Watch`."""

    def __init__(self, table: SensorTable, divided: Divided) -> None:
        self._table, self._divided = table, divided
        self._rows = [DividingRows(table, track) for track in divided.tracks]
        names = [track.name for track in divided.tracks]
        self._watch = Watch(names, divided.since_1970, (table.path, divided.wanted), self._values)

    def _values(self, number: int) -> Counter[str]:
        """Return the values of a track, with how many rows have each."""
        track = self._divided.tracks[number]
        return counted_texts(blocks["it"] for blocks in _blocks(self._table, {"it": track}))

    def see(self, start: int, stop: int, times: NDArray[np.int64] | None) -> None:
        """Take rows start..stop-1 and their times; raise UnreadableError if they are of several sensors."""
        self._watch.see([rows.read(start, stop) for rows in self._rows], times)

    def worth_watching(self) -> Divided:
        """Return the tracks of which more rows may show several sensors."""
        tracks = tuple(self._divided.tracks[number] for number in self._watch.worth_watching())
        return replace(self._divided, tracks=tracks)


@dataclass(frozen=True, slots=True)
class ChosenRows:
    """Which rows of a table are wanted.

    Attributes:
        bits: flags of the rows of each block of `BLOCK_ROWS`, packed.
        first: how many wanted rows are before each block, and in all.
        all_rows: how many rows the table has.
        note: says which these are.
    """

    bits: tuple[NDArray[np.uint8], ...]
    first: NDArray[np.int64]
    all_rows: int
    note: str

    @property
    def rows(self) -> int:
        """The number of wanted rows."""
        return int(self.first[-1])

    def places(self, start: int, stop: int) -> Iterator[NDArray[np.int64]]:
        """Yield the rows of the table that are rows start..stop-1 of the wanted ones, block by block."""
        while start < stop:
            block = int(np.searchsorted(self.first, start, "right")) - 1
            end = min(stop, int(self.first[block + 1]))
            rows = np.flatnonzero(np.unpackbits(self.bits[block])) + block * BLOCK_ROWS
            yield rows[start - self.first[block] : end - self.first[block]]
            start = end


class _RowsOfSensor:
    """The wanted rows of a track, as a source of rows."""

    def __init__(self, source: RowSource, chosen: ChosenRows) -> None:
        self._source, self._chosen = source, chosen
        self.kept_bytes = source.kept_bytes

    @property
    def path(self) -> str:
        """The track's path."""
        return self._source.path

    @property
    def row_bytes(self) -> int:
        """Bytes of one row."""
        return self._source.row_bytes

    def read(self, start: int, stop: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Return rows start..stop-1, and flags of those that are not lost."""
        found = []
        for rows in self._chosen.places(start, stop):
            values, good = self._source.read(int(rows[0]), int(rows[-1]) + 1)
            found.append((values[rows - rows[0]], good[rows - rows[0]]))
        if not found:
            return self._source.read(0, 0)
        return np.concatenate([one for one, _ in found]), np.concatenate([flags for _, flags in found])

    def chunk_offset(self, row: int) -> int | None:
        """Return the byte in the file of the part that holds a row; None if that is not known."""
        return self._source.chunk_offset(int(next(self._chosen.places(row, row + 1))[0]))


class SensorRowsTable(SensorTable):
    """The rows of one sensor in a table of several.

    Attributes:
        chosen: which these are.
    """

    def __init__(self, table: SensorTable, chosen: ChosenRows) -> None:
        self.path, self.word, self._table, self.chosen = table.path, table.word, table, chosen
        self.text_tracks = self.shortened(table.text_tracks)

    def shortened(self, tracks: tuple[Track, ...]) -> tuple[Track, ...]:
        """Return tracks of all rows as those of the sensor's."""
        return tuple(replace(track, rows=self.chosen.rows) for track in tracks)

    def missing_bytes(self) -> int:
        """See `SensorTable`."""
        return self._table.missing_bytes()

    def own(self, path: str) -> Attributes:
        """See `SensorTable`."""
        return self._table.own(path)

    def stated(self, path: str) -> Attributes:
        """See `SensorTable`."""
        return self._table.stated(path)

    def texts_of(self, track: Track) -> list[str] | None:
        """See `SensorTable`."""
        return self._table.texts_of(track)

    def rows(self, track: Track) -> RowSource:
        """Return the wanted rows of a track."""
        return _RowsOfSensor(self._table.rows(replace(track, rows=self.chosen.all_rows)), self.chosen)

    def guard(self, what: str) -> AbstractContextManager[None]:
        """See `SensorTable`."""
        return self._table.guard(what)

    @contextmanager
    def explaining(self, damaged: int = 0) -> Iterator[None]:
        """See `SensorTable`."""
        with self._table.explaining(damaged):
            yield


def chosen_rows(table: SensorTable, tracks: tuple[Track, ...], wanted: str) -> ChosenRows | None:
    """Find the rows of a sensor by the tracks that may tell; None for `all`.

    Raises:
        UsageError: no row is of that sensor.
    """
    by_name = {track.name: track for track in tracks}
    texts: dict[str, list[str]] = {name: [] for name in by_name}
    found = None
    for blocks in _blocks(table, by_name):
        for name, values in blocks.items():
            if len(texts[name]) < MOST_TEXTS:
                texts[name] += [text for text in values.texts if text not in texts[name]]
        found = matched(wanted, texts)
        if found is not None:
            break
        if wanted == EVERY_ROW:
            return None
    if found is None:
        raise no_such_sensor(wanted, texts, table.path)
    bits, counts = [], [0]
    for blocks in _blocks(table, {name: by_name[name] for name in found}):
        flags = np.logical_and.reduce([_has(blocks[name], some) for name, some in found.items()])
        bits.append(np.packbits(flags))
        counts.append(int(np.count_nonzero(flags)))
    first = np.cumsum(counts, dtype=np.int64)
    return ChosenRows(tuple(bits), first, tracks[0].rows, note_of(found))


def _blocks(table: SensorTable, tracks: dict[str, Track]) -> Iterator[dict[str, CellTexts]]:
    """Yield the values of tracks of one length, block by block."""
    sources = {name: DividingRows(table, track) for name, track in tracks.items()}
    rows = next(iter(tracks.values())).rows
    for start in range(0, rows, BLOCK_ROWS):
        yield {name: source.read(start, min(start + BLOCK_ROWS, rows)) for name, source in sources.items()}


def _has(values: CellTexts, texts: set[str]) -> NDArray[np.bool_]:
    """Return flags (n,) of the rows that have one of the texts."""
    return np.isin(values.codes, [code for code, text in enumerate(values.texts) if text in texts])
