"""What the first megabyte of a text file tells, with what the user said."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.readers._csv.blocks import Block, LineFile, lone_block
from accelcal_cli.readers._csv.columns import Roles, column_name, find_roles
from accelcal_cli.readers._csv.dialect import Dialect, find_dialect
from accelcal_cli.readers._csv.rate import Pace, find_pace
from accelcal_cli.readers._csv.sheet import Cells, Sheet
from accelcal_cli.readers._csv.time import NO_TIME, find_time_format
from accelcal_cli.readers._csv.units import Scale, guess_unit, said_unit, scale_for

HEAD_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class Opened:
    """Everything that the head of a file told."""

    sheet: Sheet
    scale: Scale
    pace: Pace
    temperature_c: float | None
    line_bytes: float
    guessed_unit: bool

    @property
    def dated(self) -> bool:
        """Whether its times count from 1970 rather than from its first row."""
        return self.sheet.time is not None and self.sheet.time.since_1970

    def notes(self) -> tuple[str, ...]:
        """How the file was understood, for people."""
        return _notes(self)


def examine(path: Path, options: ReadOptions) -> Opened:
    """Understand a text file of numbers from its beginning.

    Raises:
        UnreadableError: it holds no rows of numbers, or they can be read in several ways; the
            hint says which option settles it.
        UsageError: an option names no column, or counts come without their scale.
    """
    _refuse_not_positive(options)
    head = _head(path, False)
    dialect = find_dialect(head)
    if dialect is None:
        raise _no_rows(path, head)
    if dialect.bare_returns:
        head = _head(path, True)
    block = _head_block(head, dialect)
    roles = find_roles(dialect, options, path)
    sheet = _sheet(path, dialect, roles, options)
    cells = sheet.cells(block)
    unit = said_unit(options, set(roles.hints))
    scale = scale_for(unit or guess_unit(cells.values, path), options)
    pace = _pace(cells, options, path)
    line_bytes = len(block.data) / max(len(cells.line), 1) or 1.0
    return Opened(sheet, scale, pace, _first_temperature(cells), line_bytes, unit is None)


def _refuse_not_positive(options: ReadOptions) -> None:
    for name, value in (("--rate", options.rate_hz), ("--lsb-per-g", options.lsb_per_g)):
        if value is not None and not 0 < value < np.inf:
            raise UsageError(
                f"{name} {value:g} is not a positive number", hint="give it as a number such as 100"
            )


def _head(path: Path, bare_returns: bool) -> bytes:
    file = LineFile(path, bare_returns)
    try:
        return file.read(HEAD_BYTES)
    finally:
        file.close()


def _head_block(head: bytes, dialect: Dialect) -> Block:
    """The whole lines of the head; in a file of one unfinished line, that one."""
    end = head.rfind(b"\n") + 1
    end = end if end > dialect.offset else len(head)
    return lone_block(head[dialect.offset : end], dialect.skipped + 1, dialect.offset)


def _no_rows(path: Path, head: bytes) -> UnreadableError:
    hint = "name its format with --format"
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        hint = "it is written in UTF-16; save it again as UTF-8"
    return UnreadableError("holds no rows of three or more numbers", path=path, line=1, hint=hint)


def _sheet(path: Path, dialect: Dialect, roles: Roles, options: ReadOptions) -> Sheet:
    if roles.time is None:
        return Sheet(path, dialect, roles, None)
    cells, line = dialect.cells(roles.time), dialect.skipped + 1
    time = find_time_format(cells, roles.time_unit_us, options.rate_hz, path, line)
    return Sheet(path, dialect, roles, time)


def _pace(cells: Cells, options: ReadOptions, path: Path) -> Pace:
    if cells.time_us is not None:
        return find_pace(cells.time_us[cells.time_us != NO_TIME], options.rate_hz, path)
    if options.rate_hz is None:
        raise UnreadableError(
            "no column is known to hold the time",
            path=path,
            hint="name it with --time-column, or give the sampling rate with --rate",
        )
    return Pace(options.rate_hz)


def _first_temperature(cells: Cells) -> float | None:
    """The first temperature in the head; None where the column is absent or empty there."""
    if cells.temperature is None:
        return None
    known = cells.temperature[np.isfinite(cells.temperature)]
    return float(known[0]) if len(known) else None


def _notes(opened: Opened) -> tuple[str, ...]:
    dialect, roles = opened.sheet.dialect, opened.sheet.roles
    axes = ", ".join(column_name(dialect, column) for column in roles.xyz)
    how = " (judged by the length of gravity)" if opened.guessed_unit else ""
    notes = [f"x, y, z: {axes}", f"unit: {opened.scale.unit}{how}"]
    if roles.time is not None:
        notes.append(f"time: {column_name(dialect, roles.time)}")
    if opened.pace.stamp_period_us:
        notes.append("several rows share a time stamp; they were spread evenly until the next one")
    above = dialect.skipped - (dialect.names is not None) - (dialect.units is not None)
    if above > 0:
        notes.append(f"{above} lines before the header or the first row were not used")
    return tuple(notes)
