"""Columns of texts in tables, as numbers of the texts that are met, or as the times that they write."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.vocabulary import TABLES
from accelcal_cli.core.written_times import ORDERS, is_time
from accelcal_cli.formats._tables.table import RowSource, SensorTable, Track, WrittenNumbers, readable

SAMPLE_ROWS, SAMPLE_TEXTS = 4096, 300
"""First rows, and different texts of these, by which the form of written times is known."""

LEAST_SHARE = 0.9
"""Share of the texts that must be times."""


def text_codes(texts: Sequence[str], numbers: dict[str, int]) -> NDArray[np.int32]:
    """Return the numbers of texts, given as they are met, and -1 at the end; -1 for empty ones as well."""
    clean = [readable(text).strip("\0 ") for text in texts]
    return np.array(
        [*(numbers.setdefault(text, len(numbers)) if text else -1 for text in clean), -1], np.int32
    )


class TextRows:
    """Rows of a track of texts, as numbers of the texts, -1 for empty ones.

    Args:
        source: gives the texts.
        numbers: of the texts; it grows with them.
    """

    kept_bytes = 0

    def __init__(self, source: RowSource, numbers: dict[str, int]) -> None:
        self._source, self._numbers = source, numbers
        self.path, self.row_bytes, self.chunk_offset = source.path, source.row_bytes, source.chunk_offset

    def read(self, start: int, stop: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Return rows start..stop-1 (n, 1), and flags of those that are not lost."""
        values, good = self._source.read(start, stop)
        column = values[:, 0]
        if len(column) and (column == column[0]).all():
            found, codes = column[:1], np.zeros(len(column), np.int64)
        else:
            found, codes = np.unique(column, return_inverse=True)
        texts = [text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text) for text in found]
        return text_codes(texts, self._numbers)[codes].reshape(-1, 1), good


class WrittenRows:
    """Rows of a track of texts, as the numbers that they write."""

    kept_bytes = 0

    def __init__(self, source: RowSource, written: WrittenNumbers) -> None:
        self._source, self._written = source, written
        self.path, self.row_bytes, self.chunk_offset = source.path, source.row_bytes, source.chunk_offset

    def read(self, start: int, stop: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Return rows start..stop-1 (n, 1), and flags of those that are not lost."""
        import pyarrow as pa  # only where times are written

        values, good = self._source.read(start, stop)
        texts = (
            one.decode("utf-8", "replace") if isinstance(one, bytes) else str(one) for one in values[:, 0]
        )
        cells = pa.array([text.strip("\0 ") or None for text in texts], pa.string())
        return self._written.values(cells).reshape(-1, 1), good


@dataclass(frozen=True, slots=True)
class WrittenTimes:
    """Texts that are times, as microseconds.

    Attributes:
        form: a `Written` of `formats/_written.py`.
    """

    form: Any

    def values(self, cells: Any) -> NDArray[np.int64]:
        """Return texts (n,) as times (n,) [us]; NO_TIME where empty, or not written so."""
        import pyarrow as pa

        try:
            times: NDArray[np.int64] = self.form.times(cells.cast(pa.string()))
        except pa.ArrowInvalid:
            known = [text if text is not None and self._fits(text) else None for text in cells.to_pylist()]
            times = self.form.times(pa.array(known, pa.string()))
        return times

    def _fits(self, text: str) -> bool:
        found = self.form.cell(text)
        return found is not None and self.form.fits(found)


@dataclass(frozen=True, slots=True)
class WrittenFractions:
    """Texts that are numbers, as such."""

    def values(self, cells: Any) -> NDArray[np.float64]:
        """Return texts (n,) as numbers (n,), NaN for any other text."""
        return np.array([_number(text) for text in cells.to_pylist()], np.float64)


def _number(text: str | None) -> float:
    try:
        return float(text) if text is not None else np.nan
    except ValueError:
        return np.nan


def written_times(table: SensorTable, track: Track, asked: str | None) -> Track | None:
    """Return a track of texts as one of times; None if they are not times of one form.

    Args:
        asked: the form by --time-format, or the unit of numbers.

    Raises:
        UsageError: that form is not understood.
    """
    codes, _ = table.rows(track).read(0, min(track.rows, SAMPLE_ROWS))
    texts = table.texts_of(track) or []
    sample = [texts[code] for code in dict.fromkeys(codes[:, 0].tolist()) if code >= 0][:SAMPLE_TEXTS]
    if not sample:
        return None
    if not np.isnan([_number(text) for text in sample]).any():
        return replace(track, dtype=np.dtype(np.float64), written=WrittenFractions())
    pattern = None if asked is None or asked.lower() in TABLES.durations else asked
    form = _common_form(sample) if pattern is None else _asked_form(pattern, sample)
    if form is None:
        return None
    return replace(track, dtype=np.dtype(np.int64), written=WrittenTimes(form), clock=not form.offsets)


def _common_form(sample: Sequence[str]) -> Any:
    """Return the form of texts, a few of which may be none; None if the others have no common one."""
    from accelcal_cli.formats._written import written_form

    times = [text for text in sample if is_time(text)]
    if len(times) < LEAST_SHARE * len(sample):
        return None
    forms = (_settled(written_form(times, order), times) for order in (None, *ORDERS))
    found = [form for form in forms if form is not None]
    return found[0] if found and (found[0].order is None or len(found) == 1) else None


def _asked_form(asked: str, sample: Sequence[str]) -> Any:
    from accelcal_cli.formats._written import strptime_form

    try:
        return _settled(strptime_form(asked), sample)
    except ValueError as error:
        what = f"--time-format {asked!r} is not understood: {error}"
        raise UsageError(what, hint="write it as strptime does, such as '%d/%m/%Y %H:%M:%S.%f'") from error


def _settled(form: Any, times: Sequence[str]) -> Any:
    """Return the form with what the zones of times say; None if dates or zones are not of one kind."""
    around = [] if form is None else [form.cell(text) for text in times]
    found = [one for one in around if one is not None and (one.day is not None or not one.dated)]
    if form is None or len(found) < len(times) or len({one.dated for one in found}) > 1:
        return None
    vague = any(one.vague for one in found)
    zoned = {one.offset_s is not None for one in found}
    return (
        None
        if len(zoned) > 1 and not vague
        else replace(form, offsets=not vague and True in zoned, vague=vague)
    )
