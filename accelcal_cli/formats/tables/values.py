"""Columns of Arrow as numbers, times and codes in numpy, of any kind of file.

Times are whole microseconds since 1970. Arrow's own ways to numpy load pandas, which takes a third of a
second; these do without.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from accelcal_cli.core.written_times import COLONS
from accelcal_cli.formats._stamps import IMPOSSIBLE, NO_TIME, WITH_HOUR_24
from accelcal_cli.formats.tables.cells import MISSING, Written, number_of
from accelcal_cli.formats.tables.header import DECIMAL, As, CellTexts

TOLD = 64
"""Stretches of lost rows in a block whose first line is reported with its fault."""

NOT_ROWS = "lines that are not rows of this table"
"""The fault of the others."""

NULLS = sorted(MISSING)
NO_ROWS = np.empty(0, np.int64)
SHOWN = 40
"""Letters of a line that a message shows."""

UNTIDY = r"^ | $|  "
"""Cells that more changes may mend: with blanks."""

RARE = 8
"""Texts of a length that one in this number, or fewer, have are looked at by themselves."""

LONGEST_TIME = 64
ARROW_NUMBER = (
    r"^[+-]?([0-9]+\.?[0-9]*([eE][+-]?[0-9]+)?|\.[0-9]+([eE][+-]?[0-9]+)?"
    r"|(?i:inf|infinity|nan|nan\([a-z0-9_]*\)))$"
)
"""Texts of which Arrow makes numbers."""

HOUR, CLOCK = r"([01][0-9]|2[0-3])", r"[T ][0-9]{2}:[0-9]{2}(:[0-9]{2}(\.[0-9]+)?)?"
STAMPS = (
    rf"^[0-9]{{4}}[-/][0-9]{{2}}[-/][0-9]{{2}}({CLOCK})?$",
    rf"^[0-9]{{4}}[-/][0-9]{{2}}[-/][0-9]{{2}}{CLOCK}(Z|[+-][0-9]{{2}}(:?[0-9]{{2}})?)$",
)
"""Times in ISO 8601 with the year first, without a zone and with one; they need not exist."""

ARROW_CLOCK = rf"[T ]{HOUR}(:[0-5][0-9](:[0-5][0-9](\.[0-9]{{1,9}})?)?)?"
ARROW_TIMES = (
    rf"^[0-9]{{4}}-[0-9]{{2}}-[0-9]{{2}}({ARROW_CLOCK})?$",
    rf"^[0-9]{{4}}-[0-9]{{2}}-[0-9]{{2}}{ARROW_CLOCK}(Z|[+-]{HOUR}(:?[0-5][0-9])?)$",
)
"""Texts of which Arrow makes times, if the day exists."""

FIRST_DAY, LAST_DAY = date(1677, 9, 23), date(2262, 4, 10)
"""Days that nanoseconds in 64 bits reach in every zone."""

AT_THE_EDGE = r":60|^(1677|2262)|[T ]24:"
"""Times of which Arrow makes none, or not everywhere, and which yet exist."""

FARTHEST_NS_US = 9_223_372_036_854_775
EMPTY_NS = -(1 << 63)
"""Stands for an empty cell among Arrow's times."""

TYPES = {
    As.NUMBER: pa.float64(),
    As.MOMENT: pa.timestamp("ns"),
    As.ZONED_MOMENT: pa.timestamp("ns", tz="UTC"),
    As.TEXT: pa.string(),
    As.CODES: pa.dictionary(pa.int32(), pa.string()),
}
MOMENTS = (As.MOMENT, As.ZONED_MOMENT)
UNREAD = TYPES | dict.fromkeys((As.NUMBER, *MOMENTS), pa.string())
"""The types that pyarrow gives the columns, and those of columns with cells that it does not understand."""


def wrong_cell(column: int, cell: str, what: str) -> str:
    """Return the fault of a line whose cell in a column is not a number, or not a time."""
    return f"column {column} holds {shortened(cell)!r}, which is not a {what}"


def shortened(text: str) -> str:
    """Return a text short enough for a message."""
    return text if len(text) <= SHOWN else text[:SHOWN] + "..."


def told_of(rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return those of some lost rows that are reported with their fault: the first ones of stretches."""
    return rows[np.diff(rows, prepend=-2) > 1][:TOLD]


def values_of(column: Any, how: As) -> Any:
    """Return a column of pyarrow's type as it is wanted."""
    if how is As.NUMBER:
        return filled(column, np.float64, np.nan)
    if how is As.CODES:
        return codes_of_texts(column)
    if how is As.TEXT:
        return clean_texts(whole(column))
    ticks = filled(column, np.int64, EMPTY_NS)
    return np.where(ticks == EMPTY_NS, NO_TIME, (ticks + 500) // 1000)


def read_as(column: Any, how: As, comma: str) -> tuple[Any, NDArray[np.int64], NDArray[np.int64]]:
    """Return a column of texts as it is wanted, the rows of those that do not fit, and of untidy ones."""
    if how in (As.TEXT, As.CODES):
        return values_of(column, how), NO_ROWS, NO_ROWS
    cells = whole(column)
    read: Any = numbers(cells, comma) if how is As.NUMBER else moments(cells, how is As.ZONED_MOMENT)
    values, rows = read
    if not len(rows):
        return values, rows, rows
    import pyarrow.compute as pc

    return values, rows, rows[flags(pc.match_substring_regex(cells.take(in_arrow(rows)), UNTIDY))]


def whole(column: Any) -> Any:
    """Return a chunked column as one array."""
    return column.chunk(0) if column.num_chunks == 1 else column.combine_chunks()


def numbers(cells: Any, comma: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return texts (n,) as numbers (n,), NaN where empty, and the rows of all others."""
    import pyarrow.compute as pc

    plain = pc.replace_substring(cells, ",", comma) if comma == DECIMAL else cells
    starts, text = _letters(plain)
    odd = text - np.uint8(ord("-")) > ord("9") - ord("-")  # what is left is - . / and digits
    signs = text == ord("-")
    signs[starts[starts < len(text)]] = False
    doubtful = np.searchsorted(starts, np.flatnonzero(odd | signs), side="right") - 1
    values, others = _read_apart(plain, As.NUMBER, np.unique(doubtful))
    if not len(others):
        return values, others
    coded = cells.take(in_arrow(others)).dictionary_encode()
    read = [number_of(text, comma) for text in coded.dictionary.to_pylist()]
    found = np.array(read, np.float64)[np.from_dlpack(coded.indices)]  # NaN where there is none
    values[others] = found
    return values, others[np.isnan(found)]


def moments(cells: Any, zoned: bool) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return texts (n,) in ISO 8601 as times (n,) [us], and the rows of all others.

    NO_TIME stands where a text is empty or no time, IMPOSSIBLE where it is written right and does not exist.
    Second 60, a leap second or a rounded number, is the next minute. HOUR_24 is added in the hour 24.

    Args:
        zoned: the texts have a zone, and the times are UTC.
    """
    size = np.minimum(np.diff(_letters(cells)[0]), LONGEST_TIME)
    rare = RARE * np.bincount(size, minlength=1) < len(size)
    doubtful = np.flatnonzero(rare[size] & (size > 0))
    times, rest = _read_apart(cells, As.ZONED_MOMENT if zoned else As.MOMENT, doubtful)
    if not len(rest):
        return times, rest
    import pyarrow.compute as pc

    others = cells.take(in_arrow(rest))
    right = flags(pc.match_substring_regex(others, STAMPS[zoned]))
    times[rest[right]] = IMPOSSIBLE
    edge = right & flags(pc.match_substring_regex(others, AT_THE_EDGE))
    if edge.any():
        found, _ = Written(COLONS, offsets=zoned).read(others.filter(in_arrow(edge)))
        far = (np.abs(found) > FARTHEST_NS_US) & (found < WITH_HOUR_24)
        times[rest[edge]] = np.where(far, IMPOSSIBLE, found)
    return times, rest[~right]


def _read_apart(cells: Any, how: As, doubtful: NDArray[np.int64]) -> tuple[Any, NDArray[np.int64]]:
    """Return texts (n,) as numbers or times (n,), and the rows of all others, which are empty.

    Args:
        doubtful: rows of which each has to be looked at; all, if Arrow does not understand the others.
    """
    import pyarrow.compute as pc  # takes a tenth of a second, and sound files need none of it

    try:
        values = _cast(_without(cells, doubtful), how)
    except pa.ArrowInvalid:
        doubtful = np.flatnonzero(flags(cells.is_valid()))
        values = _cast(pa.nulls(len(cells), pa.string()), how)
    if len(doubtful):
        others = pc.utf8_trim(cells.take(in_arrow(doubtful)), " \t" if how is As.NUMBER else "")
        good = _understood(others, how)
        if good.any():
            values[doubtful[good]] = _cast(others.filter(in_arrow(good)), how)
        doubtful = doubtful[~good]
    return values, doubtful


def _understood(cells: Any, how: As) -> NDArray[np.bool_]:
    """Return flags (n,) of the texts of which Arrow makes numbers or times."""
    import pyarrow.compute as pc

    if how is As.NUMBER:
        return flags(pc.match_substring_regex(cells, ARROW_NUMBER))
    written = flags(pc.match_substring_regex(cells, ARROW_TIMES[how is As.ZONED_MOMENT]))
    coded = pc.utf8_slice_codeunits(cells, 0, 10).dictionary_encode()
    days = np.array([*map(_is_day, coded.dictionary.to_pylist())], np.bool_)
    found: NDArray[np.bool_] = written & days[np.from_dlpack(coded.indices)]
    return found


def flags(values: Any) -> NDArray[np.bool_]:
    """Return an array of Arrow's flags (n,), False where empty."""
    values = values.fill_null(False) if values.null_count else values
    found: NDArray[np.bool_] = np.from_dlpack(values.cast(pa.uint8())) > 0
    return found


def in_arrow(values: NDArray[Any]) -> Any:
    """Return numbers or flags (n,) as an array of Arrow, whose own way loads pandas."""
    kind = pa.from_numpy_dtype(values.dtype)
    held = np.packbits(values, bitorder="little") if values.dtype == np.bool_ else values
    return pa.Array.from_buffers(kind, len(values), [None, pa.py_buffer(np.ascontiguousarray(held))])


def _cast(cells: Any, how: As) -> Any:
    """Return texts that Arrow understands as numbers or times (n,)."""
    return values_of(pa.chunked_array([cells.cast(TYPES[how])]), how)


def _without(cells: Any, rows: NDArray[np.int64]) -> Any:
    """Return texts (n,), empty in some rows."""
    kept = np.zeros(cells.offset + len(cells), np.bool_)
    kept[cells.offset :] = flags(cells.is_valid()) if cells.null_count else True
    kept[cells.offset + rows] = False
    validity = pa.py_buffer(np.packbits(kept, bitorder="little"))
    buffers = [validity, *cells.buffers()[1:]]
    return pa.Array.from_buffers(cells.type, len(cells), buffers, offset=cells.offset)


def _letters(cells: Any) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Return where each of some texts (n,) begins, and the last one ends (n + 1,), and their bytes."""
    _, places, letters = cells.buffers()
    starts = np.frombuffer(places, np.int32, len(cells) + 1, 4 * cells.offset)
    text = np.frombuffer(letters or b"", np.uint8)[starts[0] : starts[-1]]
    return starts - starts[0], text


def _is_day(text: str) -> bool:
    try:
        return FIRST_DAY <= date.fromisoformat(text) <= LAST_DAY
    except ValueError:
        return False


def clean_texts(cells: Any) -> Any:
    """Return texts without blanks around them, null where they then stand for a missing value."""
    import pyarrow.compute as pc

    cells = pc.utf8_trim_whitespace(cells)
    return pc.if_else(pc.is_in(cells, pa.array(NULLS, pa.string())), None, cells)


def codes_of_texts(column: Any) -> CellTexts:
    """Return a chunked column of texts, whose chunks have a dictionary each."""
    codes: dict[str, int] = {}
    parts = [np.empty(0, np.int32)]
    for chunk in column.chunks:
        texts = [text.strip() for text in chunk.dictionary.to_pylist()]
        own = [codes.setdefault(text, len(codes)) if text else -1 for text in texts]
        indices = pa.chunked_array([chunk.indices.cast(pa.int64())])
        parts.append(np.array([*own, -1], np.int32)[filled(indices, np.int64, -1)])
    return CellTexts(tuple(codes), np.concatenate(parts))


def filled(column: Any, kind: type[np.generic], null: float) -> NDArray[Any]:
    """Return a chunked column of numbers or times of eight bytes, (n,), with `null` where a cell is empty."""
    parts = []
    for chunk in (one for one in column.chunks if len(one)):
        values = np.frombuffer(chunk.buffers()[1], kind, len(chunk), 8 * chunk.offset)
        if chunk.null_count:
            empty = np.from_dlpack(chunk.is_null().cast(pa.uint8())) > 0
            values = np.where(empty, np.asarray(null, kind), values)
        parts.append(values)
    if len(parts) == 1:
        return parts[0]
    return np.concatenate(parts) if parts else np.empty(0, kind)


def as_texts(texts: Sequence[str]) -> Any:
    """Return texts as an array of Arrow (n,), null where they stand for a missing value."""
    return pa.array([None if text.strip() in MISSING else text for text in texts], pa.string())


def values_of_texts(cells: Any, how: As, comma: str) -> tuple[Any, NDArray[np.int64]]:
    """Return an array of Arrow's texts (n,) as it is wanted, and the rows of those that do not fit."""
    cells = clean_texts(cells)
    if how is As.NUMBER:
        return numbers(cells, comma)
    if how in MOMENTS:
        return moments(cells, how is As.ZONED_MOMENT)
    codes = how is As.CODES
    return codes_of_texts(pa.chunked_array([cells.dictionary_encode()])) if codes else cells, NO_ROWS


def told(column: int, cells: Any, wrong: NDArray[np.int64], what: str) -> dict[int, str]:
    """Return what is wrong with some rows of a column of texts, by their numbers; of many, with the first."""
    first = {row: wrong_cell(column, str(cells[row].as_py()), what) for row in told_of(wrong).tolist()}
    return dict.fromkeys(wrong.tolist(), NOT_ROWS) | first
