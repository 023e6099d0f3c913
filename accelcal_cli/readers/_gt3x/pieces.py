"""Stretches of rows as they come out of log.bin, and chunks made of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, PageClock
from accelcal_cli.core.recording import Chunk, Problem, Validity
from accelcal_cli.readers._gt3x.sensor import Samples


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """Consecutive rows, evenly spread from the beginning of a second on.

    Attributes:
        rows: how many.
        second: since 1970, when the first one was taken.
        per_second: rows in a second.
        broken: the row before does not continue.
        first: number of the first row among the samples of the batch; without meaning where filled.
        validity: where the rows come from.
        sample: (3,) what the device repeats, where it filled the rows.
    """

    rows: int
    second: int
    per_second: int
    broken: bool
    first: int = 0
    validity: Validity = Validity.MEASURED
    sample: NDArray[np.int16] | None = None


@dataclass(frozen=True, slots=True)
class Place:
    """Where a chunk lies: number of its first row, how far the file has been read, bytes of its records."""

    first_sample: int
    end_byte: int
    used_bytes: int = 0


def groups(pieces: Sequence[Piece], most: int) -> Iterator[list[Piece]]:
    """Pieces in order, together up to about `most` rows."""
    group: list[Piece] = []
    rows = 0
    for piece in pieces:
        if group and rows + piece.rows > most:
            yield group
            group, rows = [], 0
        group.append(piece)
        rows += piece.rows
    if group:
        yield group


def chunk_of(
    pieces: Sequence[Piece], samples: Samples, place: Place, problems: tuple[Problem, ...] = ()
) -> Chunk:
    """Rows of pieces in order."""
    rows = np.array([piece.rows for piece in pieces], np.int64)
    first_row = np.cumsum(rows) - rows
    broken = np.array([piece.broken for piece in pieces], np.bool_)
    return Chunk(
        first_sample=place.first_sample,
        counts=_column(samples.counts, pieces),
        clock=_clock(pieces, first_row),
        end_byte=place.end_byte,
        breaks=first_row[broken],
        temperature_mc=None if samples.temperature_mc is None else _column(samples.temperature_mc, pieces),
        gyro_counts=None if samples.gyro is None else _column(samples.gyro, pieces),
        validity=_validity(pieces, rows),
        problems=problems,
        used_bytes=place.used_bytes,
    )


def _clock(pieces: Sequence[Piece], first_row: NDArray[np.int64]) -> PageClock:
    time_us = np.array([piece.second for piece in pieces], np.int64) * MICROSECONDS
    span_rows = np.array([piece.per_second for piece in pieces], np.int64)
    return PageClock(first_row, time_us, span_rows, np.full(len(pieces), MICROSECONDS, np.int64))


def _column(values: NDArray[Any], pieces: Sequence[Piece]) -> NDArray[Any]:
    """The pieces' rows of a column; a view where they are one stretch of it."""
    if all(piece.sample is None for piece in pieces) and _adjoin(pieces):
        begin = pieces[0].first if pieces else 0
        return values[begin : begin + sum(piece.rows for piece in pieces)]
    return np.concatenate([_rows_of(values, piece) for piece in pieces])


def _adjoin(pieces: Sequence[Piece]) -> bool:
    return all(after.first == before.first + before.rows for before, after in pairwise(pieces))


def _rows_of(values: NDArray[Any], piece: Piece) -> NDArray[Any]:
    if piece.sample is None:
        return values[piece.first : piece.first + piece.rows]
    return np.broadcast_to(piece.sample, (piece.rows, 3))


def _validity(pieces: Sequence[Piece], rows: NDArray[np.int64]) -> NDArray[np.uint8] | None:
    known = np.array([piece.validity for piece in pieces], np.uint8)
    return np.repeat(known, rows) if known.any() else None


def cut(chunk: Chunk, most: int) -> Iterator[Chunk]:
    """A chunk in parts of at most so many rows; the problems go with the first."""
    if len(chunk) <= most:
        yield chunk
        return
    for start in range(0, len(chunk), most):
        yield _part(chunk, start, min(start + most, len(chunk)))


def _part(chunk: Chunk, start: int, stop: int) -> Chunk:
    inside = (chunk.breaks >= start) & (chunk.breaks < stop)
    return replace(
        chunk,
        first_sample=chunk.first_sample + start,
        counts=chunk.counts[start:stop],
        clock=_pages(chunk.clock, start, stop),
        breaks=chunk.breaks[inside] - start,
        temperature_mc=None if chunk.temperature_mc is None else chunk.temperature_mc[start:stop],
        gyro_counts=None if chunk.gyro_counts is None else chunk.gyro_counts[start:stop],
        validity=None if chunk.validity is None else chunk.validity[start:stop],
        problems=() if start else chunk.problems,
        used_bytes=0 if start else chunk.used_bytes,
    )


def _pages(clock: Any, start: int, stop: int) -> PageClock:
    """The pages of a clock that rows start..stop-1 lie on."""
    page = slice(
        int(np.searchsorted(clock.first_row, start, side="right")) - 1,
        int(np.searchsorted(clock.first_row, stop, side="left")),
    )
    return PageClock(
        clock.first_row[page] - start, clock.time_us[page], clock.span_rows[page], clock.span_us[page]
    )
