"""Several sensors or people in one table: the column that tells their rows apart, and which are wanted.

A column of texts or whole numbers can say whose each row is, or what its wearer did. `Division` sees its
values with the times of the rows, and takes them for sensors by one of these: the times repeat or go back as
the value changes, and are in order for each value alone; each value alone has a steady rate, and all together
have none; or the column has the name of a device, a person or a place, and the values take turns, or the
times jump as they change. A label that changes while the times continue divides nothing.
"""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.errors import UnreadableError, UsageError, printable
from accelcal_cli.core.formats import EACH, EVERY_ROW
from accelcal_cli.core.vocabulary import LABELS, MEASURES, NEUTRAL, OWNERS, PLACES
from accelcal_cli.formats._stamps import LOST
from accelcal_cli.formats.tables.header import As, Block, CellTexts, Column, Piece, Source

LEAST_ROWS = 3
"""Rows of a value below which it is treated as damage."""

MOST_VALUES, ROWS_A_VALUE = 64, 8
"""Most sensors in one table, and fewest rows that each has on average; people may be more."""

LONGEST_TURN_S, LONGEST_TURN_ROWS = 2.0, 64
"""Longest mean turn [s, rows] of sensors that take turns; activities last longer."""

GAP_STEPS = 5
"""Number of usual steps above which a step is a jump of the times."""

NEAR, NEARER = 0.5, 0.2
"""Steps whose length is within these shares of the usual one are near it, and nearer."""

SHOWN = 12
"""Number of values that a message names."""

MOST_TEXTS = 1 << 14
"""Values of a column that are compared with --sensor; one with more counts rows, or measures something."""

SEARCH_ROWS = 1 << 16
"""Rows that are read at a time to find the first ones of a sensor."""

ONLY = "only rows of "
"""Beginning of the note on which rows are read."""

WHOLE = re.compile(r"[+-]?\d+(\.0*)?")


class Meaning(IntEnum):
    """Meaning of a column's values, by its name."""

    MEASURED = 0
    LABEL = 1
    UNKNOWN = 2
    PLACE = 3
    OWNER = 4


def meaning_of(name: str) -> Meaning:
    """Return the meaning of a name: `sensorID`, `device_id` and `Subject No` are owners."""
    words = {word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)}
    words |= {word.removesuffix(end) for word in words for end in ("id", "name", "no", "s") if word != end}
    words = words - NEUTRAL or words
    for known, meaning in (
        (MEASURES, Meaning.MEASURED),
        (LABELS, Meaning.LABEL),
        (OWNERS, Meaning.OWNER),
        (PLACES, Meaning.PLACE),
    ):
        if known & words:
            return meaning
    return Meaning.UNKNOWN


class _Steps:
    """Counts steps between times: those ahead, those near the usual one, and those that are not ahead."""

    def __init__(self) -> None:
        self.ahead = self.near = self.nearer = self.others = 0

    def add(self, steps: NDArray[np.int64]) -> None:
        """Take some steps [us]."""
        ahead = steps[steps > 0]
        self.ahead += len(ahead)
        self.others += len(steps) - len(ahead)
        if len(ahead):
            off = np.abs(ahead / float(np.median(ahead)) - 1)
            self.near += int(np.count_nonzero(off <= NEAR))
            self.nearer += int(np.count_nonzero(off <= NEARER))


@dataclass(slots=True)
class _OneValue:
    """The rows of one value: how many were seen, and the time of the last [us]."""

    rows: int = 0
    last_us: int | None = None


class Division:
    """Sees the values of one column in the order of the rows, and tells whether they are several sensors.

    Args:
        name: of the column, or its number.
        since_1970: the times are moments; else they count from some start, and may do so more than once.
    """

    def __init__(self, name: str, since_1970: bool) -> None:
        self.name, self.meaning = name, meaning_of(name)
        self._since_1970 = since_1970
        self._streams: dict[str, _OneValue] = {}
        self._whole, self._each = _Steps(), _Steps()
        self._rows = self._changes = self._not_ahead = self._jumps = self._again = 0
        self._last: tuple[str, int | None] | None = None
        self._first_us = self._begin_us = 0
        self._usual_us = 0.0

    @property
    def texts(self) -> list[str]:
        """The values that have been seen, but those of a few rows."""
        return [text for text, stream in self._streams.items() if stream.rows >= LEAST_ROWS]

    def add(self, values: CellTexts, times: NDArray[np.int64] | None) -> None:
        """Take the next rows with their times (n,) [us], None where they have none."""
        codes = values.codes
        known = codes >= 0 if times is None else (codes >= 0) & (times > LOST)
        if not known.all():
            codes, times = codes[known], None if times is None else times[known]
        if not len(codes):
            return
        self._rows += len(codes)
        if self._goes_on(values.texts[codes[0]], codes, times):
            return
        present = np.unique(codes)
        if times is not None:
            self._add_times(values.texts, codes, times, present)
        else:
            before = None if self._last is None else self._last[0]
            self._changes += int(np.count_nonzero(np.diff(codes)))
            self._changes += before not in (None, values.texts[codes[0]])
        for code in present.tolist():
            stream = self._streams.setdefault(values.texts[code], _OneValue())
            stream.rows += int(np.count_nonzero(codes == code))
        self._last = (values.texts[codes[-1]], None if times is None else int(times[-1]))

    def _goes_on(self, text: str, codes: NDArray[np.int32], times: NDArray[np.int64] | None) -> bool:
        """Take rows that all have the last value, without a jump of the times, which tell nothing new."""
        if self._last is None or self._last[0] != text or (codes != codes[0]).any():
            return False
        if times is not None:
            steps = np.diff(times, prepend=times[0] if self._last[1] is None else self._last[1])
            if steps.min() < 0 or steps.max() > GAP_STEPS * self._usual_us:
                return False
        stream = self._streams[text]
        stream.rows += len(codes)
        stream.last_us = None if times is None else int(times[-1])
        self._last = (text, stream.last_us)
        return True

    def _add_times(
        self,
        texts: Sequence[str],
        codes: NDArray[np.int32],
        times: NDArray[np.int64],
        present: NDArray[np.int32],
    ) -> None:
        if self._last is None or self._last[1] is None:
            self._first_us = self._begin_us = int(times[0])
            before, changed = int(times[0]) - 1, False  # a first step that goes ahead
        else:
            before, changed = self._last[1], self._last[0] != texts[codes[0]]
        steps = np.diff(times, prepend=before)
        changes = np.diff(codes, prepend=codes[:1]) != 0
        changes[0] = changed
        self._usual_us = self._usual_us or (float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0)
        jumps = (steps <= 0) | (steps > GAP_STEPS * self._usual_us)
        self._changes += int(np.count_nonzero(changes))
        self._not_ahead += int(np.count_nonzero(changes & (steps <= 0)))
        self._jumps += int(np.count_nonzero(changes & jumps))
        self._whole.add(steps)
        for row in np.flatnonzero(jumps & (steps != 0)).tolist():
            # the times go back into the stretch without jumps before them
            self._again += bool(changes[row] and steps[row] < 0 and times[row] >= self._begin_us)
            self._begin_us = int(times[row])
        for code in present.tolist():
            own = times[codes == code]
            stream = self._streams.setdefault(texts[code], _OneValue())
            self._each.add(np.diff(own) if stream.last_us is None else np.diff(own, prepend=stream.last_us))
            stream.last_us = int(own[-1])

    def is_several(self) -> bool:
        """Return True if the values are those of several sensors or people."""
        values = len(self._streams)
        most = max(MOST_VALUES, self._rows if self.meaning is Meaning.OWNER else 0)
        if self.meaning is Meaning.MEASURED or len(self.texts) < 2 or values > most:
            return False
        if values * ROWS_A_VALUE > max(self._rows, 2 * ROWS_A_VALUE):
            return False
        if self._last is None or self._last[1] is None:
            return self.meaning >= Meaning.PLACE
        return self._times_divide(self._last[1])

    def _times_divide(self, last_us: int) -> bool:
        """Return True if the times show that the values are of several; `last_us` is the last one."""
        rows, changes, whole, each = self._rows, self._changes, self._whole, self._each
        # the times do not go ahead where the value changes, and do for each value alone
        contradict = 5 * self._not_ahead >= 2 * max(changes, 1) and 10 * each.others <= whole.others
        contradict = contradict and 10 * each.near >= 6 * each.ahead
        if self.meaning is Meaning.LABEL:
            in_turn = LONGEST_TURN_ROWS * changes >= rows
            return contradict and (in_turn or (self._since_1970 and 2 * self._again >= changes))
        steady_apart = 10 * each.nearer >= 9 * each.ahead > 0 and 10 * whole.nearer <= 6 * whole.ahead
        if self.meaning is Meaning.OWNER or contradict or (steady_apart and 4 * changes >= rows):
            return True
        take_turns = abs(last_us - self._first_us) <= LONGEST_TURN_S * MICROSECONDS * changes
        return self.meaning is Meaning.PLACE and (take_turns or 0 < changes <= 2 * self._jumps)

    def is_worth_watching(self) -> bool:
        """Return True if more rows may show several sensors; a column that always changes did already."""
        several = len(self._streams) > MOST_VALUES or LONGEST_TURN_ROWS * self._changes > self._rows
        return self.meaning is not Meaning.MEASURED and not several

    def fault(self, path: Path, chosen: str | None, sensors: Sequence[str] = ()) -> UnreadableError:
        """Return the error that asks for one of the sensors; `chosen` is what was given before."""
        texts = self.texts
        given = "" if chosen is None else f"{chosen},".removesuffix(f"{EACH},")
        options = [f"--sensor {shlex.quote(printable(given + text))}" for text in texts[:2]]
        return UnreadableError(
            f"holds several sensors or people: column {printable(self.name)!r} has {_shown(texts)} "
            "and perhaps more",
            path=path,
            hint=f"choose one: {' or '.join(options)} (--sensor {EVERY_ROW} if all are of one sensor, "
            f"--sensor {EACH} in a study for a recording of each)",
            sensors=sensors,
        )


def is_same(text: str, wanted: str) -> bool:
    """Return True if a cell has the wanted value; 1 is 1.0."""
    if text == wanted:
        return True
    return bool(WHOLE.fullmatch(text) and WHOLE.fullmatch(wanted)) and float(text) == float(wanted)


def matched(wanted: str, columns: Mapping[str, Sequence[str]]) -> dict[str, set[str]] | None:
    """Return which texts of which columns a value of --sensor chooses; None if it is not among them.

    Args:
        wanted: a value, or `COLUMN=VALUE`, or several of different columns with commas between them.
        columns: the texts of each column.
    """
    named = any(wanted.startswith(f"{name}=") for name in columns)
    for parts in ([wanted], wanted.split(",")):
        found = [_column_with(part if named else part.strip(), columns, named=named) for part in parts]
        if all(found) and len({one[0] for one in found if one}) == len(parts):
            return dict(one for one in found if one)
    return None


def _column_with(
    wanted: str, columns: Mapping[str, Sequence[str]], *, named: bool
) -> tuple[str, set[str]] | None:
    having = {
        name: texts
        for name, all_texts in columns.items()
        if not named or wanted.startswith(f"{name}=")
        if (texts := {one for one in all_texts if is_same(one, wanted[len(name) + 1 :] if named else wanted)})
    }
    best = max(having, key=meaning_of, default=None)
    return None if best is None else (best, having[best])


def no_such_sensor(wanted: str, columns: Mapping[str, Sequence[str]], path: Path) -> UsageError:
    """Return the error for a value that no column has."""
    names = sorted(columns, key=lambda name: (-meaning_of(name), name))
    known = "; ".join(f"{printable(name)} has {_shown(columns[name])}" for name in names)
    hint = f"give a value of a column with --sensor: {known}" if known else "omit --sensor"
    return UsageError(f"no row is of the sensor {wanted!r}", path=path, hint=hint)


def _shown(texts: Sequence[str]) -> str:
    return ", ".join(map(printable, texts[:SHOWN])) + ", ..." * (len(texts) > SHOWN)


@dataclass(frozen=True, slots=True)
class Chosen:
    """The rows of a table that --sensor chooses.

    Attributes:
        texts: of columns, by their numbers; the rows have one of each.
        piece: the first rows of the table among which they are.
        note: says which rows these are.
    """

    texts: tuple[tuple[int, frozenset[str]], ...]
    piece: Piece
    note: str

    @property
    def wanted(self) -> dict[int, As]:
        """How the columns that tell are asked for."""
        return codes_of(number for number, _ in self.texts)

    def rows(self, block: Block) -> NDArray[np.bool_]:
        """Return flags (n,) of the rows of a block that are chosen."""
        wanted = np.ones(len(block), np.bool_)
        for number, texts in self.texts:
            values: CellTexts = block.values[number]
            wanted &= np.isin(values.codes, [code for code, text in enumerate(values.texts) if text in texts])
        return wanted


def _names(source: Source, columns: Sequence[Column]) -> list[str]:
    """Return the names of columns, each once; numbers where the table has none."""
    own = [column.name.text if source.has_names else "" for column in source.columns]
    names = ((own[column.number], column.number) for column in columns)
    return [name if name and own.count(name) == 1 else str(number) for name, number in names]


def codes_of(columns: Iterable[Column | int]) -> dict[int, As]:
    """Return how the texts of columns are asked for."""
    return {one if isinstance(one, int) else one.number: As.CODES for one in columns}


def find_chosen(source: Source, wanted: str | None, columns: Sequence[Column]) -> Chosen | None:
    """Find the rows of a sensor, however far from the beginning; None if all rows are wanted.

    Args:
        columns: that may tell whose each row is.

    Raises:
        UsageError: no row is of that sensor.
    """
    if wanted is None or (wanted == EVERY_ROW and not columns):
        return None
    named, asked = dict(zip(_names(source, columns), columns, strict=True)), codes_of(columns)
    texts: dict[str, list[str]] = {name: [] for name in named}
    pieces = source.pieces(asked, SEARCH_ROWS) if columns else iter(())
    for piece in pieces:
        block = source.parse(piece, asked)
        for name, column in named.items():
            if len(texts[name]) < MOST_TEXTS:
                texts[name] += [one for one in block.values[column.number].texts if one not in texts[name]]
        if (found := matched(wanted, texts)) is not None:
            chosen = tuple((named[name].number, frozenset(some)) for name, some in found.items())
            note = ONLY + ", ".join(f"{name} {' or '.join(sorted(some))}" for name, some in found.items())
            return Chosen(chosen, source.joined([piece, *islice(pieces, 1)]), note)
        if wanted == EVERY_ROW:
            return None
    raise no_such_sensor(wanted, texts, source.path)


class SensorWatch:
    """Refuses a table whose rows turn out to be of several sensors; takes rows in their order.

    Args:
        columns: that may tell whose each row is.
        wanted: what --sensor has chosen, and the rows that it chooses.
        since_1970: see `Division`.
    """

    def __init__(
        self,
        source: Source,
        columns: Sequence[Column],
        wanted: tuple[str | None, Chosen | None],
        since_1970: bool,
    ) -> None:
        self._source, self.columns, self._since_1970 = source, columns, since_1970
        self._wanted, self._chosen = wanted
        self._divisions = [Division(name, since_1970) for name in _names(source, columns)]

    def again(self) -> SensorWatch | None:
        """Return a watch from the beginning over the columns that are worth it; None if none is."""
        pairs = zip(self.columns, self._divisions, strict=True)
        columns = [column for column, division in pairs if division.is_worth_watching()]
        wanted = self._wanted, self._chosen
        return SensorWatch(self._source, columns, wanted, self._since_1970) if columns else None

    def look(self, block: Block) -> tuple[CellTexts, ...]:
        """Return the columns of a block."""
        return tuple(block.values[column.number] for column in self.columns)

    def see(self, seen: Sequence[CellTexts], times: NDArray[np.int64] | None) -> None:
        """Take the columns of the next block; raise UnreadableError if they show several sensors.

        The column that tells most by its name is named, then the one with the fewest values.
        """
        for division, cells in zip(self._divisions, seen, strict=True):
            division.add(cells, times)
        several = [one for one in self._divisions if one.is_several()]
        if several:
            found = max(several, key=lambda one: (one.meaning, -len(one.texts)))
            raise found.fault(self._source.path, self._wanted, self._sensors(found))

    def _sensors(self, found: Division) -> list[str]:
        """Return values of --sensor that choose each sensor, those seen unless all are to be listed."""
        *chosen, last = (self._wanted or EACH).rsplit(",", 1)
        texts = found.texts
        if self._wanted is not None and last == EACH:
            rows = self._values(self.columns[self._divisions.index(found)].number)
            texts = [text for text, number in rows.items() if number >= LEAST_ROWS]
        before = chosen if last == EACH else [self._wanted or ""]
        return [",".join([*before, f"{found.name}={text}"]) for text in texts]

    def _values(self, column: int) -> Counter[str]:
        """Return the values of a column in the rows that are read, with how many have each."""
        asked = {column: As.CODES} | ({} if self._chosen is None else self._chosen.wanted)
        rows = Counter[str]()
        for piece in self._source.pieces(asked, SEARCH_ROWS):
            block = self._source.parse(piece, asked)
            texts, codes = block.values[column]
            codes = codes if self._chosen is None else codes[self._chosen.rows(block)]
            for code, number in enumerate(np.bincount(codes[codes >= 0], minlength=len(texts)).tolist()):
                rows[texts[code]] += number
        return rows
