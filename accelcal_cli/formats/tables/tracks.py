"""Sources whose columns can be entered at any row: the datasets, fields and arrays of a file as tracks.

A format lists its tracks and opens the rows of each (`RowSource`); `TrackSource` makes pieces and blocks of
them, reads what attributes state, and finds the kind of columns of texts.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from posixpath import basename, dirname
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import utc_offset_s
from accelcal_cli.core.errors import AccelcalError, UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Device, Problem
from accelcal_cli.core.vocabulary import GIVE_UNIT, PER_SECOND, acceleration_unit, find_unit
from accelcal_cli.core.written_times import written_start
from accelcal_cli.formats.tables.cells import KIND_SHARE, column_kind, shows_decimal_comma
from accelcal_cli.formats.tables.header import (
    DECIMAL,
    FLOAT,
    SAMPLE_ROWS,
    As,
    Attributes,
    Block,
    CellTexts,
    Column,
    First,
    Kind,
    Piece,
    Source,
    Start,
    Stated,
    Wanted,
    readable,
    shown,
)
from accelcal_cli.formats.tables.names import name_of
from accelcal_cli.formats.tables.units import EMPTY
from accelcal_cli.formats.tables.values import MOMENTS, as_texts, told, values_of_texts
from accelcal_cli.formats.tables.vendors import Head, names_description

BLOCK_ROWS = 65_536
"""Rows that are read at a time."""

PIECE_BYTES = 16 << 20
"""Bytes of values that are read at a time, however many samples are wanted: wide numbers take memory."""

HIGHEST_RATIO = 1032
"""Most rows, or bytes of an array, for each byte of a file: deflate makes no more of one byte."""

AGAIN = "copy it again from its source"

REFUSE_ABOVE_BYTES = 128 << 20
"""Bytes of all columns that may be unpacked whole together; at moments it takes three times as much."""

PLACES, PLACE_ROWS = 4, 1024
"""Further places of a file that are looked at for its unit, and rows at each."""

MOST_LOOKED_AT = 1000
"""Most columns whose units and texts are looked at."""

READ_ERRORS = (
    OSError, RuntimeError, ValueError, TypeError, LookupError, ArithmeticError, AttributeError, MemoryError,
    SystemError,
)  # fmt: skip
"""Errors to which libraries that read files map their failures: almost any of Python's own kinds."""

OBJECTS = (
    "(tables, timetables, cells and dates are objects): save their columns as plain arrays, with times in "
    "seconds (in MATLAB: posixtime)"
)

TEXT = np.dtype(object)
"""Type of a track of texts."""

UNIT_NAMES = ("units", "unit")
LSB_NAMES = ("lsb_per_g", "counts_per_g", "count_per_g", "lsbs_per_g", "sensitivity_lsb_per_g")
RANGE_NAMES = ("range_g", "accel_range_g", "full_scale_g", "dynamic_range_g")
SERIAL_NAMES = ("serial", "serial_number", "device_serial", "device_id", "sensor_id")
MODEL_NAMES = ("model", "device_model", "device", "device_type", "sensor_model")
FIRMWARE_NAMES = ("firmware", "firmware_version", "device_firmware")
ZONE_NAMES = ("timezone", "time_zone", "tz")
RATE_NAMES = (
    *("sample_rate", "sample_rate_hz", "sampling_rate", "sampling_rate_hz", "rate_hz"),
    *("sampling_frequency", "sampling_frequency_hz", "sample_frequency", "frequency_hz", "sfreq"),
    *("fs", "fs_hz", "hz", "rate", "frequency"),
)
START_NAMES = (
    *("start_time", "start", "start_timestamp", "start_datetime"),
    *("recording_start", "recording_start_time", "start_time_utc"),
)
LSB_PER_DPS = ("lsb_per_dps", "counts_per_dps", "gyro_lsb_per_dps", "lsb_per_deg_s")
DPS_PER_LSB = ("dps_per_lsb", "dps_per_count", "gyro_dps_per_lsb")
LARGEST_RANGE_G = 1000.0
"""A stated range above this is not believed."""

EARLIEST_S, LATEST_S = 315_532_800, 4_102_444_800
"""1980-01-01 and 2100-01-01: a number between these, in some unit of time since 1970, is a moment."""


@dataclass(frozen=True, slots=True)
class Track:
    """A column of `rows` rows of `width` numbers; the rows run along its axis `axis`.

    Attributes:
        path: with a `/` before its name and after each group around it; none within a name.
        is_moment: its type says that its numbers count from 1970; is_clock: on a clock of an unknown zone.
        unit: of its type; empty if the type states none. zone: in which its type shows its moments.
    """

    path: str
    rows: int
    width: int
    axis: int
    dtype: np.dtype[Any]
    is_moment: bool = False
    is_clock: bool = False
    unit: str = ""
    zone: str | None = None


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


class RowSource(Protocol):
    """The rows of a track, read in order.

    Attributes:
        row_bytes: bytes of one row.
        kept_bytes: bytes that have to be kept unpacked.
    """

    row_bytes: int
    kept_bytes: int

    def read(self, start: int, stop: int) -> tuple[Any, NDArray[np.bool_]]:
        """Return rows start..stop-1, and flags of those that are not lost.

        Numbers have the shape (stop - start, width); texts are an array of Arrow (n,), null where empty.
        """

    def chunk_offset(self, row: int) -> int | None:
        """Return the byte in the file of the part that holds a row; None if that is not known."""


OpenRows = Callable[[Track], RowSource]
"""Opens the rows of a track; raises UnreadableError where they cannot be read in parts."""


@dataclass(frozen=True, slots=True)
class TrackPiece(Piece):
    """Consecutive rows of some tracks.

    Attributes:
        row: number of the first, from 0.
        values: by the number of the column; what is not there is read when it is asked for.
        lost: flags (n,) of rows that a column has lost.
    """

    row: int
    rows: int
    offset: int
    end_byte: int
    last: bool
    values: Mapping[int, Any]
    lost: Mapping[int, NDArray[np.bool_]]

    def emptied(self) -> TrackPiece:
        """See `Piece`."""
        return replace(self, values={}, lost={})


class TrackSource(Source):
    """A file whose tracks are known.

    Args:
        tracks: in the order in which their columns are numbered.
        objects: names of what holds neither numbers nor texts.

    Attributes:
        damaged: number of parts of the file that cannot be read.
        missing_bytes: that the file lacks at its end; -1 if that is not known.
        repack: advice on a file whose parts are too large to unpack at once.
    """

    can_be_entered = True
    missing_bytes = 0
    repack = "write it again in smaller parts"
    _size = 0

    def __init__(
        self, path: Path, tracks: Sequence[Track], *, objects: Sequence[str] = (), damaged: int = 0
    ) -> None:
        self.path, self.tracks, self.damaged, self.stated = path, tracks, damaged, Stated()
        self._size = path.stat().st_size
        self.unread = f"{shown(sorted(objects))} cannot be read {OBJECTS}" if objects else ""
        self._open_rows: Mapping[int, RowSource] = {}
        with self.explaining(), self.opened() as open_rows:
            self.columns = self._described(open_rows)
        names = tuple(column.name.text for column in self.columns)
        first = First(self._piece(0, SAMPLE_ROWS, {}))
        head = Head(names, lambda number: [cell for cell, _ in self.cells(first, self.columns[number])])
        self.stated = names_description(head, path.name) or self.stated

    @contextmanager
    def opened(self) -> Iterator[OpenRows]:
        """Open the file, and close it afterwards."""
        raise NotImplementedError
        yield

    def own(self, path: str) -> Attributes:
        """Return what is stated of a track alone; the file is open."""
        raise NotImplementedError

    def around(self, path: str) -> Attributes:
        """Return what is stated of a track, then of all that is around it, up to the file."""
        raise NotImplementedError

    @contextmanager
    def explaining(self) -> Iterator[None]:
        """See `Source`."""
        try:
            yield
        except AccelcalError as error:
            missing, size = self.missing_bytes, None
            if missing:
                size = self.path.stat().st_size
                to = f" to {size} of {size + missing} bytes" if missing > 0 else ""
                error.message = f"is cut short{to}, so that {error.message}"
                error.hint = "; or ".join(
                    filter(None, (error.hint, "copy the whole file again from its source"))
                )
            elif self.damaged:
                error.message = f"is damaged in {self.damaged} places, so that {error.message}"
            error.byte_offset = size
            raise

    def _described(self, open_rows: OpenRows) -> tuple[Column, ...]:
        """Return the columns, with the units that are stated of them, and the kinds of those of texts."""
        columns = []
        for number, track in enumerate(self.tracks):
            looked_at = number < MOST_LOOKED_AT
            stated = self.own(track.path).text(*UNIT_NAMES) if looked_at and not track.unit else None
            name, group = readable(basename(track.path)), readable(dirname(track.path))
            unit = track.unit or stated or ""
            kind = Kind.TIME if track.is_moment else Kind.NUMBER
            if track.dtype == TEXT:
                kind = self._kind_of(open_rows, track) if looked_at else Kind.TEXT
            described = (
                f"column {readable(track.path)}" if group.strip("/") else f"column {number} ({name!r})"
            )
            dtype = track.dtype if track.dtype != TEXT else FLOAT
            size = track.rows, track.width, dtype, track.is_moment, track.is_clock, track.zone
            columns.append(Column(number, name_of(name, unit or None), kind, described, unit, group, *size))
        return tuple(columns)

    def _kind_of(self, open_rows: OpenRows, track: Track) -> Kind:
        try:
            texts, _ = open_rows(track).read(0, min(track.rows, SAMPLE_ROWS))
        except (UnreadableError, *READ_ERRORS):
            return Kind.TEXT
        cells = [text or "" for text in texts.to_pylist()]
        kind = column_kind(cells, KIND_SHARE)
        if kind is Kind.NUMBER and any(map(shows_decimal_comma, cells)):
            self.comma = DECIMAL
        return kind

    def settle(self, xyz: Sequence[Column], gyro: Sequence[Column], options: ReadOptions) -> None:
        """See `Source`."""
        with self.explaining(), self.opened():
            about = self.around(self.tracks[xyz[0].number].path)
            scales = {self.around(self.tracks[one.number].path).number(*LSB_NAMES) for one in xyz} - {None}
            if len(scales) > 1 and options.lsb_per_g is None:
                what, hint = "the axes have different counts per g", "give --lsb-per-g N"
                raise UnreadableError(what, path=self.path, hint=hint)
            if options.unit is None and not any(one.unit or one.name.stated for one in xyz):
                text = about.text(*UNIT_NAMES)  # of the acceleration, or around it
                if text and find_unit(text) is not None and acceleration_unit(text) is None:
                    what = f"the unit {text!r}, which is stated of it, is not one of acceleration"
                    raise UnreadableError(what, path=self.path, hint=GIVE_UNIT)
            self.stated = stated_of(about, self.stated)
            if gyro:
                lsb = _lsb_per_dps(self.around(self.tracks[gyro[0].number].path))
                self.stated = replace(self.stated, lsb_per_dps=lsb or self.stated.lsb_per_dps)
            self.problems = (*self.problems, *header_problems(about, self.damaged))
        self.rows = xyz[0].rows

    def row_bytes_of(self, wanted: Wanted) -> float:
        """See `Source`."""
        sizes = (self.tracks[number] for number in wanted)
        return float(sum(16 if one.dtype == TEXT else one.dtype.itemsize * one.width for one in sizes))

    def head(self, wanted: Wanted) -> TrackPiece:
        """See `Source`."""
        return self._piece(0, min(BLOCK_ROWS, self.rows or BLOCK_ROWS), {})

    def more(self, wanted: Wanted) -> Iterator[TrackPiece]:
        """See `Source`."""
        last = max(0, (self.rows or 0) - PLACE_ROWS)
        for place in range(1, PLACES + 1):
            row = place * last // PLACES
            yield self._piece(row, min(PLACE_ROWS, (self.rows or 0) - row), {})

    def last(self, wanted: Wanted) -> TrackPiece:
        """See `Source`."""
        rows = self.rows or 0
        return self._piece(max(0, rows - BLOCK_ROWS), min(rows, BLOCK_ROWS), {})

    def pieces(
        self, wanted: Wanted, samples: int, start: int = 0, stop: int | None = None, threads: int = 1
    ) -> Generator[TrackPiece]:
        """See `Source`."""
        end = self.rows or 0
        end = end if stop is None else min(stop, end)
        with self.opened() as open_rows:
            rows = self._open_rows = {number: open_rows(self.tracks[number]) for number in wanted}
            if (kept := sum(one.kept_bytes for one in rows.values())) > REFUSE_ABOVE_BYTES:
                size = f"parts of {kept >> 20} MB together, too large to unpack at once"
                what = f"its columns are packed in {size}"
                raise UnreadableError(what, path=self.path, hint=self.repack)
            row_bytes = max(1, sum(one.row_bytes for one in rows.values()))
            step = max(1, min(samples, PIECE_BYTES // row_bytes))
            for row in range(start, end, step):
                yield self._piece(row, min(step, end - row), rows)

    def _piece(self, row: int, rows: int, sources: Mapping[int, RowSource]) -> TrackPiece:
        read = {number: source.read(row, row + rows) for number, source in sources.items()}
        size, whole = self._size, max(1, self.rows or 1)
        place = size * row // whole, size * (row + rows) // whole, row + rows >= whole
        values = {number: values for number, (values, _) in read.items()}
        lost = {number: ~good for number, (_, good) in read.items() if not good.all()}
        return TrackPiece(row, rows, *place, values, lost)

    def parse(self, piece: Piece, wanted: Wanted) -> Block:
        """See `Source`."""
        assert isinstance(piece, TrackPiece)
        missing = [number for number in wanted if number not in piece.values]
        if missing:
            left = (self.rows or piece.rows) - piece.row  # the first piece is made before that is known
            piece = replace(piece, rows=min(piece.rows, left))
            with self.opened() as open_rows:
                sources = {number: open_rows(self.tracks[number]) for number in missing}
                more = self._piece(piece.row, piece.rows, sources)
            piece = replace(piece, values={**piece.values, **more.values}, lost={**piece.lost, **more.lost})
        values, bad = {}, dict[int, str]()
        for number, how in wanted.items():
            if isinstance(piece.values[number], np.ndarray):
                values[number] = _as_wanted(piece.values[number], how)
                continue
            values[number], wrong = values_of_texts(piece.values[number], how, self.comma)
            what = "time" if how in MOMENTS else "number"
            bad = bad | told(number, piece.values[number], wrong, what) | bad  # the first reason holds
        lines = np.arange(piece.row + 1, piece.row + piece.rows + 1)
        damage = {number: lost for number, lost in piece.lost.items() if number in wanted}
        return Block(lines, values, bad, damage)

    def joined(self, pieces: Sequence[Piece]) -> TrackPiece:
        """See `Source`."""
        rows = [piece for piece in pieces if isinstance(piece, TrackPiece)]
        return self._piece(rows[0].row, rows[-1].row + rows[-1].rows - rows[0].row, {})

    def cells(
        self, first: First, column: Column, most: int | None = SAMPLE_ROWS
    ) -> list[tuple[str, int | None]]:
        """See `Source`."""
        assert isinstance(first.piece, TrackPiece)
        row, length = first.piece.row, column.rows or 0
        there = range(min(first.piece.rows, max(0, length - row)))
        rows = [one for one in there if first.lines is None or row + one + 1 in first.lines][:most]
        if not rows or column.width != 1:
            return []
        with self.opened() as open_rows:
            values, good = open_rows(self.tracks[column.number]).read(row, row + rows[-1] + 1)
        texts = texts_of(values)
        return [(texts[one] if good[one] else "", None) for one in rows]

    def offset_of(self, column: int, row: int) -> int | None:
        """See `Source`."""
        rows = self._open_rows.get(column)
        return None if rows is None else rows.chunk_offset(row)

    def end_problems(self, piece: Piece, samples: int, lost_bytes: int) -> tuple[Problem, ...]:
        """Return, after the last rows, the problem that the file was cut short."""
        missing = self.missing_bytes
        if not missing:
            return ()
        end = f"last {missing} bytes are" if missing > 0 else "end is"
        what = f"the file is cut short: its {end} missing"
        more = max(0, missing - lost_bytes)  # rows that were announced are lost already
        return (Problem("truncated", what, self.path.stat().st_size, samples, max(1, missing), 0, more),)


def texts_of(values: Any) -> list[str]:
    """Return numbers (n, 1), or texts of Arrow (n,), as texts; empty ones as empty texts."""
    if not isinstance(values, np.ndarray):
        return [text or "" for text in values.to_pylist()]
    column = values[:, 0]
    if column.dtype.kind in "iu":
        return ["" if value == EMPTY else str(value) for value in column.tolist()]
    return ["" if np.isnan(value) else repr(float(value)) for value in column.tolist()]


def _as_wanted(values: NDArray[Any], how: As) -> Any:
    """Return numbers (n, width) in the form in which they are wanted."""
    if how is As.TEXT:
        return as_texts(texts_of(values))
    column = values[:, 0]
    if how is not As.CODES:
        return column if values.shape[1] == 1 else values
    wide = column.astype(np.float64)
    known = np.isfinite(wide) & (np.abs(wide) < 1 << 53)
    numbers, codes = np.unique(np.where(known, column, 0), return_inverse=True)
    texts = [f"{value:.0f}" if value == np.rint(value) else repr(float(value)) for value in numbers.tolist()]
    return CellTexts(texts, np.where(known, codes, -1).astype(np.int32))


def header_problems(attributes: Attributes, damaged: int = 0) -> tuple[Problem, ...]:
    """Return a problem if attributes, columns or groups could not be read."""
    count = len(attributes.damaged) + damaged
    if not count:
        return ()
    what = f"{count} attributes, columns or groups cannot be read and count as absent"
    return (Problem("damaged_header", what, None, 0, count),)


def known_zone(name: str | None) -> str | None:
    """Return the name or offset of a time zone if it is one, else None."""
    if name is None or name.upper() in ("UTC", "Z"):
        return name and "UTC"
    try:
        utc_offset_s(name, 0)
    except UsageError:
        return None
    return name


def parse_moment(value: str | float) -> tuple[int, bool, bool] | None:
    """Return a start [us since 1970], if it is UTC for certain, and if it was written with an offset.

    A number counts s, ms, us or ns since 1970, by its size, and is UTC. A text is a date and time; only one
    with a zone is UTC for certain. None if it is not a moment.
    """
    if isinstance(value, str) and re.fullmatch(r"\d+(\.\d*)?", value):
        value = float(value)
    if isinstance(value, float):
        seconds = (value / per_second for per_second in PER_SECOND.values())
        found = next((one for one in seconds if EARLIEST_S <= one < LATEST_S), None)
        return None if found is None else (round(found * 1_000_000), True, False)
    start = written_start(value)
    if start is None or not 0 <= start.start_us < LATEST_S * 1_000_000:
        return None
    return start.start_us, start.timezone == "UTC", start.had_offset


def _lsb_per_dps(attributes: Attributes) -> float | None:
    per_count, lsb = attributes.number(*DPS_PER_LSB), attributes.number(*LSB_PER_DPS)
    lsb = 1 / per_count if lsb is None and per_count else lsb
    return lsb if lsb is not None and lsb > 0 else None


def stated_of(attributes: Attributes, known: Stated) -> Stated:
    """Return what the attributes of the acceleration and of what is around it state.

    Args:
        known: what the names of the columns tell already; attributes take precedence.
    """
    notes, range_g = list(known.notes), attributes.number(*RANGE_NAMES)
    zone, moment = _stated_times(attributes, notes)
    unit_name, scale = attributes.text(*UNIT_NAMES) or "", attributes.number(*LSB_NAMES)
    unit = acceleration_unit(unit_name)
    if unit_name and unit is None:
        notes.append(f"its unit {unit_name!r} is not known and was not used")
    stated = replace(
        known,
        device=Device(
            attributes.text(*MODEL_NAMES) or known.device.model,
            attributes.text(*SERIAL_NAMES) or known.device.serial,
            attributes.text(*FIRMWARE_NAMES) or known.device.firmware,
        ),
        rate_hz=attributes.number(*RATE_NAMES) or known.rate_hz,
        range_g=range_g if range_g is not None and 0 < range_g <= LARGEST_RANGE_G else known.range_g,
        timezone=zone or known.timezone,
        notes=tuple(notes),
    )
    if unit is not None or scale is not None:
        stated = replace(stated, unit=unit, lsb_per_g=scale, zero=0, unit_is_inferred=False)
    if moment is not None:
        stated = replace(stated, start=Start(moment[0]), has_offsets=moment[2], counts_from_zero=True)
    return stated


def _stated_times(
    attributes: Attributes, notes: list[str]
) -> tuple[str | None, tuple[int, bool, bool] | None]:
    """Return the stated zone and start, and add to the notes what of these cannot be used."""
    zone_name, start = attributes.text(*ZONE_NAMES), attributes.value(*START_NAMES)
    zone, moment = known_zone(zone_name), None if start is None else parse_moment(start)
    if start is not None and moment is None:
        notes.append(f"the start time {start!r} is not a date and time")
    if moment is not None and moment[1]:
        if zone_name is not None and zone != "UTC":
            notes.append(f"its start is UTC; it names the time zone {zone or zone_name}")
        return "UTC", moment
    if zone_name is not None and zone is None:
        notes.append(f"its time zone {zone_name!r} is not known and was not used")
    return zone, moment
