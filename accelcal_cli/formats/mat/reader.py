"""MATLAB files of versions 5 to 7 as tables: variables and fields of structures by their names."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from accelcal_cli.core.errors import AccelcalError, UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats._bytes import ByteSource
from accelcal_cli.formats._tables.arrays import ArrayReader, ArrayTable
from accelcal_cli.formats._tables.plan import plan_of, source_of
from accelcal_cli.formats.mat import BIG, HEAD_BYTES, LITTLE, VERSION
from accelcal_cli.formats.mat.elements import Elements

AS_NUMBERS = "save its columns as plain arrays, with times in seconds (posixtime) or days (datenum)"


def open_recording(path: Path, options: ReadOptions) -> ArrayReader:
    """Open a MATLAB file whose acceleration is an (n, 3) array or three of length n.

    Raises:
        UnreadableError: damaged, or nothing in it is known as acceleration.
        UsageError: an option names no array.
    """
    table = _opened(path)
    with _explaining(table):
        return ArrayReader(plan_of(source_of(table, table.tracks, options, table.damaged), "mat"), table)


def _opened(path: Path) -> ArrayTable:
    with ByteSource(path) as source:
        if source.compressed:
            raise UnreadableError(
                "is a MATLAB file inside gzip", path=path, hint="unpack it first with gunzip"
            )
        version = source.read_exact(HEAD_BYTES)[VERSION]
    if version not in (LITTLE, BIG):
        what, hint = "is no MATLAB file of version 5 to 7", "save it again with -v7, or try --format hdf5"
        raise UnreadableError(what, path=path, byte_offset=VERSION.start, hint=hint)
    table = ArrayTable(path)
    Elements(table, "<" if version == LITTLE else ">").all()
    return table


@contextmanager
def _explaining(table: ArrayTable) -> Iterator[None]:
    """Add to any error of ours what of the file could not be read."""
    try:
        yield
    except AccelcalError as error:
        what, hint = error.message, error.hint
        if table.missing:
            what, hint = f"is cut short, so that {what}", "copy the whole file again from its source"
        elif table.damaged:
            what = f"is damaged in {table.damaged} places, so that {what}"
        elif table.unknown:
            what = f"{what}; its tables, timetables, cells and dates cannot be read"
            hint = AS_NUMBERS
        raise type(error)(what, path=table.path, hint=hint) from error
