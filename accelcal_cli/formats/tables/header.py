"""A table as its source shows it: its columns, what is stated of it, and its rows block by block.

A *source* is a file of named columns of any kind: text, Arrow, HDF5, NumPy, MATLAB. It gives `Block`s of the
columns that are wanted, in the order of the rows; all that these mean is decided by the chain of `roles.py`,
`clock.py`, `units.py`, `sensors.py` and `rows.py`, which is the same for all sources.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import date
from enum import Enum
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.errors import NoRecordingError, Reason, UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Calibrated, Device, Problem
from accelcal_cli.core.vocabulary import normalized
from accelcal_cli.core.written_times import ORDERS, read_date
from accelcal_cli.formats.tables.names import Name

SAMPLE_ROWS = 200
"""First rows by which the form of times is known."""

DAY_US = 86_400 * MICROSECONDS
EPOCH = date(1970, 1, 1)
FLOAT = np.dtype(np.float64)
MOST_SHOWN = 20
"""Number of columns, and of objects, that a message names."""

DECIMAL, BETWEEN_GROUPS, UNKNOWN = ".", "", ","
"""A comma alone in the numbers of a file becomes one of these."""


class Kind(Enum):
    """The kind of a cell, or of a column whose cells are nearly all of it."""

    NUMBER = "number"
    TIME = "time"
    MISSING = "missing"
    TEXT = "text"


class As(Enum):
    """The form in which the values of a column are wanted."""

    NUMBER = "number"
    """Numbers (n,) or (n, 3), NaN where a cell is empty."""

    MOMENT = "moment"
    """ISO times without a zone, as whole microseconds (n,), NO_TIME where a cell is empty.

    IMPOSSIBLE stands for a time that does not exist.
    """

    ZONED_MOMENT = "zoned moment"
    """ISO times with Z or an offset, as MOMENT, in UTC."""

    TEXT = "text"
    """Texts, an array of Arrow (n,), null where a cell is empty."""

    CODES = "codes"
    """`CellTexts`."""


Wanted = Mapping[int, As]
"""How the values of columns are wanted, by the numbers of these."""


class CellTexts(NamedTuple):
    """A column of consecutive rows: its texts, and for each row (n,) the number of its text, -1 if empty."""

    texts: Sequence[str]
    codes: NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table.

    Attributes:
        number: its place, from 0.
        rows: how many it has; None where all columns have as many.
        width: numbers in a row, 1 or 3.
        dtype: of its numbers; decimal fractions in a text file.
        is_moment: its type says that its numbers count from 1970; is_clock: on a clock of an unknown zone.
        zone: in which its type shows its moments; None for UTC.
        described: the column for people: `column 3 ('x')`, `/left/acc`.
        unit: its unit by a line of units or an attribute, besides what the name says; empty if none does.
        group: the path of the group that holds it, `/` for the file itself.
    """

    number: int
    name: Name
    kind: Kind
    described: str
    unit: str = ""
    group: str = "/"
    rows: int | None = None
    width: int = 1
    dtype: np.dtype[Any] = FLOAT
    is_moment: bool = False
    is_clock: bool = False
    zone: str | None = None

    @property
    def groups(self) -> tuple[str, ...]:
        """The names of the groups around it, the outermost first."""
        return tuple(part for part in self.group.split("/") if part)

    @property
    def path(self) -> str:
        """The column as an option names it."""
        return readable("/".join((*self.groups, self.name.text.strip())))


@dataclass(frozen=True, slots=True)
class Start:
    """When a header says that its recording began.

    Attributes:
        time_us: microseconds since midnight of its date; without a date, since 1970.
        written: its date, as it is written.
        line: the line of the date, from 1.
    """

    time_us: int
    written: str | None = None
    line: int = 1

    def days(self, order: str | None) -> set[date]:
        """Return the dates that it may be: in this order, or in any order if none is given."""
        orders = ORDERS if order is None else (order,)
        return {day for item in orders if (day := read_date(self.written or "", item))}

    def us(self, order: str | None, path: Path) -> int:
        """Return the start in microseconds since 1970.

        Raises:
            UnreadableError: the date does not fit the order, or no order is known and several fit.
        """
        if self.written is None:
            return self.time_us
        days = self.days(order)
        if len(days) != 1:
            fitting = [item for item in ORDERS if self.days(item)]
            raise unclear_date(self.written, fitting, path, self.line)
        return self.time_us + (days.pop() - EPOCH).days * DAY_US


def unclear_date(text: str, fitting: Sequence[str], path: Path, line: int | None) -> UnreadableError:
    """Return the error that asks for the order of a date.

    Args:
        fitting: the orders in which it, and its like, can be read.
    """
    words, options = " or ".join(fitting), " or ".join(f"-R date_format={order}" for order in fitting)
    fault, hint = f"the date {text!r} can be read as {words}", f"say which with {options}"
    if len(fitting) == 1:
        fault, hint = f"the date {text!r} can only be read as {words}", f"give {options}"
    elif not fitting:
        fault, hint = f"{text!r} and the like are not dates", "give -R time_column=none and --rate"
    return UnreadableError(fault, path=path, line=line, hint=hint)


@dataclass(frozen=True, slots=True)
class Doubt:
    """Message and hint for a file of a known vendor that holds no raw acceleration; `epochs`: but counts."""

    message: str
    hint: str
    epochs: bool = False


@dataclass(frozen=True, slots=True)
class Stated:
    """The facts that are stated of a table: by the header of a vendor's export, a sidecar or attributes.

    The rest is found out as in any other file.

    Attributes:
        title: whose export this is, for people.
        preamble: lines before the names of the columns, or before the first row.
        names: of the columns, where no line of the file names them.
        xyz, time: numbers of the columns, or of one of three numbers a row, where the names need not tell.
        gyro: numbers of the columns of a gyroscope; gyro_unit: its unit, where no name says it;
            lsb_per_dps: its counts in one deg/s.
        unit: of the acceleration, as in `--unit`; `lsb_per_g` where they are counts, and `zero`, the count
            that stands for 0 g. unit_is_inferred: from the layout, so that values have to fit it.
        rate_hz: sampling rate; hint_hz: a rate that a line above the table names.
        start: of the recording; used where rows carry no times.
        timezone: of its clock; has_offsets: the start was written with an offset.
        range_g: the sensor clips at +- this.
        date_order: of day, month and year, such as `mdy`.
        repeats_idle: the device sleeps, and then writes zeros, or repeats a row for a second or more.
        time_unit_us: microseconds in one unit of the numbers of the time column.
        counts_from_start: these count from `start`, which has a date.
        companion: the sidecar that says all this, if it is not in the file itself.
        counts_from_zero: numbers of the time column count from `start`, which is that of the time 0.
        pauses: how often it was paused without its times saying so.
        notes: on what the header says, for people.
        doubt: why it cannot be calibrated as it is; None for raw data.
        calibrated: origin of a file of ours with calibrated values; marks: the column of their validity.
    """

    title: str = ""
    device: Device = field(default_factory=Device)
    preamble: int = 0
    names: tuple[str, ...] | None = None
    xyz: tuple[int, ...] | None = None
    time: int | None = None
    unit: str | None = None
    lsb_per_g: float | None = None
    zero: int = 0
    unit_is_inferred: bool = True
    rate_hz: float | None = None
    hint_hz: float | None = None
    start: Start | None = None
    timezone: str | None = None
    has_offsets: bool = False
    range_g: float | None = None
    date_order: str | None = None
    repeats_idle: bool = False
    companion: Path | None = None
    time_unit_us: float | None = None
    counts_from_start: bool = False
    counts_from_zero: bool = False
    pauses: int = 0
    notes: tuple[str, ...] = ()
    doubt: Doubt | None = None
    gyro: tuple[int, ...] | None = None
    gyro_unit: str | None = None
    lsb_per_dps: float | None = None
    calibrated: Calibrated | None = None
    marks: int | None = None


@dataclass(frozen=True, slots=True)
class Block:
    """Consecutive rows of a table.

    Attributes:
        line: (n,) the line of each row in a text file, or its number in the table, from 1.
        values: of the columns that were asked for, by their numbers, in the form that was asked for.
        bad: what is wrong with lines that are not rows, by the number of the row, which has no values.
        damage: flags (n,) of the rows that columns have lost in damaged or missing parts of the file.
    """

    line: NDArray[np.int64]
    values: Mapping[int, Any]
    bad: Mapping[int, str] = field(default_factory=dict)
    damage: Mapping[int, NDArray[np.bool_]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.line)


class Piece:
    """Consecutive rows as they are taken from a file, before they are parsed.

    Attributes:
        offset: byte at which they begin, in the uncompressed stream; of tables that are not text, about that.
        end_byte: how far the file on the disk has been read.
        last: nothing follows.
        restarts: lines up to here from which a second head of the file says when the recording went on, and
            that time [us since 1970].
    """

    offset: int
    end_byte: int
    last: bool
    restarts: Sequence[tuple[int, int]] = ()

    def emptied(self) -> Piece:
        """Return the place of the piece, without the memory of its rows."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class First:
    """The first rows of a table, by which it is understood.

    Attributes:
        lines: of those that are looked at, in a table of which only some rows are read; None for all.
    """

    piece: Piece
    lines: frozenset[int] | None = None


Cut = Callable[[bytes, bool], Piece | None]
"""Takes the next bytes of a growing file, and True if they are the last ones.

Returns the rows that are complete with them; None if there are none yet.
"""


class Source:
    """A file of named columns.

    Attributes:
        format: name of the format, as in `--format`.
        columns: all columns that can be read.
        stated: what is known of the table before its rows are looked at.
        rows: number of rows; None where only reading all shows it.
        row_bytes: bytes of a row in the file, or about that.
        place_word: the word for the place of a row, `line` or `row`.
        has_names: the columns have names.
        names_line, first_line: in a text file, the lines of the names and of the first row.
        unread: what of the file cannot be read, and how to save it, for people; empty if there is nothing.
        problems: go with the first rows.
        last_notes: the last notes on how the file was understood; width_notes: on names and rows.
        can_be_entered: the file can be read from any row on.
        comma: what a comma alone in its numbers becomes.
    """

    path: Path
    format: str
    columns: tuple[Column, ...]
    stated: Stated
    rows: int | None = None
    row_bytes: float = 1.0
    place_word = "row"
    has_names = True
    names_line: int | None = None
    first_line: int | None = None
    unread = ""
    problems: tuple[Problem, ...] = ()
    last_notes: tuple[str, ...] = ()
    width_notes: tuple[str, ...] = ()
    can_be_entered = False
    comma = UNKNOWN

    def head(self, wanted: Wanted) -> Piece:
        """Return the first rows, by which the file is understood."""
        raise NotImplementedError

    def more(self, wanted: Wanted) -> Iterator[Piece]:
        """Yield some rows of other places of the file, where it can be entered."""
        return iter(())

    def last(self, wanted: Wanted) -> Piece | None:
        """Return the last rows; None where the end cannot be reached without reading all."""
        return None

    def pieces(
        self, wanted: Wanted, samples: int, start: int = 0, stop: int | None = None, threads: int = 1
    ) -> Generator[Piece]:
        """Yield the rows of a file in order, about `samples` at a time; raise UnreadableError where they end.

        Args:
            start, stop: rows of the table, where it can be entered.
        """
        raise NotImplementedError

    def parse(self, piece: Piece, wanted: Wanted) -> Block:
        """Return the columns of a piece; this may run in any order, on several threads."""
        raise NotImplementedError

    def cells(
        self, first: First, column: Column, most: int | None = SAMPLE_ROWS
    ) -> list[tuple[str, int | None]]:
        """Return the first cells of a column as texts, with their lines in a text file; all for None."""
        raise NotImplementedError

    def settle(self, xyz: Sequence[Column], gyro: Sequence[Column], options: ReadOptions) -> None:
        """Take the columns of both sensors: what is stated of them, and how many rows there are.

        Args:
            options: of the user, against which nothing that is stated counts.

        Raises:
            UnreadableError: what is stated contradicts itself, or is of another quantity.
        """

    def check(self, wanted: Wanted) -> None:
        """Look at the columns that will be read; raise UnreadableError for those that cannot be."""

    def row_bytes_of(self, wanted: Wanted) -> float:
        """Return the bytes of a row in the file, as far as its columns are wanted, or about that."""
        return self.row_bytes

    def joined(self, pieces: Sequence[Piece]) -> Piece:
        """Return pieces that follow one another as one."""
        raise NotImplementedError

    def with_date_order(self, column: Column, order: str) -> Source | None:
        """Return a source that reads the dates of a column in this order by itself; None if it cannot."""
        return None

    def offset_of(self, column: int, row: int) -> int | None:
        """Return the byte in the file of the part that holds a row of a column; None if it is not known."""
        return None

    def end_problems(self, piece: Piece, samples: int, lost_bytes: int) -> tuple[Problem, ...]:
        """Return what is wrong with the end of the file, after its last piece."""
        return ()

    def intake(self) -> Cut | None:
        """Return what cuts the bytes of a growing file into pieces; None for a file that does not grow."""
        return None

    @contextmanager
    def explaining(self) -> Iterator[None]:
        """Add to any error of ours that the file is cut short or damaged, if it is."""
        yield

    def place(self, number: int) -> str:
        """Return the place of a row: `line 12`, `row 11`."""
        return f"{self.place_word} {number}"


def refuse_doubtful(stated: Stated, options: ReadOptions, path: Path, line: int | None = 1) -> None:
    """Raise UnreadableError for the export of a known vendor that holds no raw acceleration.

    Counts of epochs raise a NoRecordingError. Who gives a unit insists on it.
    """
    doubt = stated.doubt
    if doubt is None or options.unit is not None:
        return
    if doubt.epochs:
        reason = Reason("epochs", {"whose": f"{stated.title}'s"})
        raise NoRecordingError(doubt.message, path=path, line=line, hint=doubt.hint, reason=reason)
    raise UnreadableError(doubt.message, path=path, line=line, hint=doubt.hint)


def readable(text: str) -> str:
    """Return a name or text of a file, with bytes that are not UTF-8, which h5py passes on, replaced."""
    return text.encode("utf-8", "surrogateescape").decode("utf-8", "replace")


def shown(names: Sequence[str]) -> str:
    """Return names with commas between them; of many, the first ones."""
    return ", ".join(map(readable, names[:MOST_SHOWN])) + ", ..." * (len(names) > MOST_SHOWN)


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
