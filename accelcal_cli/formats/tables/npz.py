"""Reads archives of NumPy arrays as tables; members that are not packed are read in place.

Source: NumPy's documentation, "numpy.lib.format" (the head of an array).
"""

from __future__ import annotations

import io
import math
import tokenize
import weakref
import zipfile
from collections.abc import Iterator
from copy import copy
from dataclasses import replace
from functools import partial
from pathlib import Path
from posixpath import basename
from typing import Any

import numpy as np

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats._bytes import ShortReads
from accelcal_cli.formats.tables import arrays
from accelcal_cli.formats.tables.arrays import Array, Arrays, ArraySource, StoredBytes
from accelcal_cli.formats.tables.reader import TableReader, open_table
from accelcal_cli.formats.tables.tracks import AGAIN, READ_ERRORS, TEXT, Track, track_of_shape

HEAD_BYTES = 1 << 14
"""Bytes read for the head of an array; NumPy's own limit is 10 000 characters."""

WIDEST = 512
"""Most bytes of a text in an array; NumPy takes four for each letter of the longest."""

MOST_MEMBERS, MOST_DIRECTORY_BYTES = 4096, 1 << 20
ZIP_ERRORS = (*READ_ERRORS, *arrays.UNPACK_ERRORS, SyntaxError, tokenize.TokenError)
"""Errors that zipfile and NumPy raise for damaged files."""


def open_recording(path: Path, options: ReadOptions) -> TableReader:
    """Open an archive whose acceleration is an (n, 3) array or three of length n.

    Raises:
        UnreadableError: damaged, cut short, or nothing in it is known as acceleration.
        UsageError: an option names no array.
    """
    arrays.head_of(path, "an archive")
    table, file = Arrays(path), path.open("rb")
    weakref.finalize(table, file.close)
    try:
        archive = zipfile.ZipFile(ShortReads(file, MOST_DIRECTORY_BYTES))
    except ZIP_ERRORS as error:
        what = f"its list of arrays cannot be read ({' '.join(str(error).split())[:200]})"
        hint = f"the file is damaged, cut short, or has too many arrays: {AGAIN}"
        raise UnreadableError(what, path=path, hint=hint) from error
    members = [item for item in archive.infolist() if item.filename.endswith(".npy")]
    table.damaged = len(members[MOST_MEMBERS:])
    for member in members[:MOST_MEMBERS]:
        try:
            with archive.open(_unchecked(member)) as stream:
                place = file.tell()
                _add(table, archive, member, place, stream.read(HEAD_BYTES))
        except ZIP_ERRORS:
            table.damaged += 1
    return open_table(ArraySource("npz", table), options)


def _unchecked(member: zipfile.ZipInfo) -> zipfile.ZipInfo:
    """Return a member whose checksum zipfile does not look at; raise ValueError if it cannot be unpacked."""
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError("packed in another way")
    member = copy(member)
    del member.CRC
    return member


def _pieces(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> Iterator[bytes]:
    with archive.open(member) as stream:
        while piece := stream.read(arrays.PIECE_BYTES):
            yield piece


def _add(table: Arrays, archive: zipfile.ZipFile, member: zipfile.ZipInfo, place: int, head: bytes) -> None:
    """Take a member in, as an array or as a single number or text; raise what zipfile and NumPy raise.

    Args:
        place: byte of the file at which the member's own bytes begin.
        head: the first of these.
    """
    path = arrays.array_path(member.filename.removesuffix(".npy"))
    shape, column_major, dtype, length = _head(head)
    is_true, single = partial(arrays.is_sound, partial(_pieces, archive, member)), math.prod(shape) == 1
    if dtype.hasobject or dtype.names or (dtype.itemsize > WIDEST and not single):
        table.objects.append(path)
    elif single:
        if member.file_size > HEAD_BYTES or not is_true():
            raise ValueError("damaged, or too long")
        table.beside(path)[basename(path)] = _scalar(head, length, dtype)
    else:
        packed = member.compress_type != zipfile.ZIP_STORED
        pieces = partial(_pieces, archive, _unchecked(member)) if packed else None
        source = StoredBytes(table.path, place + member.file_size, pieces, is_true)
        if (track := _track(path, shape, dtype)) is not None:
            stored = np.dtype(np.int64).newbyteorder(dtype.byteorder) if dtype.kind in "mM" else dtype
            array = Array(track, stored, column_major, source, length if packed else place + length)
            table.add(array, min(member.compress_size, table.path.stat().st_size))


def _track(path: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Track | None:
    """Return an array of numbers, times or texts as a track, None for any other; times state their unit."""
    if dtype.kind in "US" and dtype.itemsize and len(shape) == 1:
        return Track(path, shape[0], 1, 0, TEXT)
    if dtype.kind not in "mM":
        return track_of_shape(path, shape, dtype.newbyteorder("="))
    unit, step = np.datetime_data(dtype)
    track = track_of_shape(path, shape, np.dtype(np.int64)) if step == 1 else None
    return track and replace(track, unit=unit, is_moment=dtype.kind == "M", is_clock=dtype.kind == "M")


def _head(data: bytes) -> tuple[tuple[int, ...], bool, np.dtype[Any], int]:
    """Return shape, whether the first axis runs fastest, type, and bytes of the head of an array."""
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, column_major, dtype = read(stream)
    return shape, column_major, dtype, stream.tell()


def _scalar(head: bytes, length: int, dtype: np.dtype[Any]) -> object:
    values = np.frombuffer(head, dtype, 1, length).astype(dtype.newbyteorder("="))
    if dtype.kind == "U" and arrays.replace_no_letters(values):
        raise ValueError("no text")
    return values[0]
