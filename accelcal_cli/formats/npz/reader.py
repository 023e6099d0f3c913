"""Reads archives of NumPy arrays as tables; members are read in place, packed or not.

Source: NumPy's documentation, "numpy.lib.format" (the head of an array), and PKWARE's APPNOTE.TXT, 4.3.7 (the
head of a member, whose bytes begin 30 bytes and the lengths of its name and its extra field later).
"""

from __future__ import annotations

import io
import tokenize
import zipfile
import zlib
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats._bytes import PIECE_BYTES, ByteSource, PackedStream, PlainStream
from accelcal_cli.formats._tables.arrays import (
    Array,
    ArrayReader,
    ArrayTable,
    Stream,
    array_of,
    text_array_of,
)
from accelcal_cli.formats._tables.reader import plan_of, source_of
from accelcal_cli.formats._tables.table import readable

LOCAL_HEAD, LOCAL_LENGTHS = 30, slice(26, 30)
HEAD_BYTES = 1 << 14
"""Bytes read for the head of an array; NumPy's own limit is 10 000 characters."""

LONGEST_TEXT = 1 << 16
MOST_MEMBERS = 4096
AGAIN = "copy it again from its source"
ZIP_ERRORS = (
    OSError, RuntimeError, ValueError, LookupError, EOFError, OverflowError, SyntaxError, MemoryError,
    RecursionError, TypeError, zipfile.BadZipFile, zlib.error, tokenize.TokenError,
)  # fmt: skip
"""Errors that zipfile and NumPy raise for damaged files."""


def open_recording(path: Path, options: ReadOptions) -> ArrayReader:
    """Open an archive whose acceleration is an (n, 3) array or three of length n.

    Raises:
        UnreadableError: damaged, cut short, or nothing in it is known as acceleration.
        UsageError: an option names no array.
    """
    table = _opened(path)
    with table.explaining(table.damaged):
        return ArrayReader(plan_of(source_of(table, table.tracks, options, table.damaged), "npz"), table)


def _opened(path: Path) -> ArrayTable:
    with ByteSource(path) as source:
        if source.compressed:
            raise UnreadableError("is an archive inside gzip", path=path, hint="unpack it first with gunzip")
    try:
        with zipfile.ZipFile(path) as archive:
            members = [item for item in archive.infolist() if item.filename.endswith(".npy")]
    except ZIP_ERRORS as error:
        what = f"its list of arrays cannot be read ({' '.join(str(error).split())[:200]})"
        raise UnreadableError(what, path=path, hint=f"the file is damaged or cut short: {AGAIN}") from error
    table, size = ArrayTable(path), path.stat().st_size
    for member in members[:MOST_MEMBERS]:
        name = f"/{readable(member.filename.removesuffix('.npy'))}"
        try:
            _add(table, name, member, size)
        except ZIP_ERRORS:
            table.damaged += 1
    return table


def _add(table: ArrayTable, name: str, member: zipfile.ZipInfo, size: int) -> None:
    """Take a member in, as an array or as a single number or text. Raises as NumPy does."""
    stream = _stream(table.path, member)
    head = b"".join(stream.copy().pieces(HEAD_BYTES))
    shape, column_major, dtype, length = _head(head)
    if dtype.hasobject or dtype.names:
        table.objects.append(name)
        return
    if np.prod(shape, dtype=np.float64) == 1 or not shape:
        table.scalars[name] = _scalar(head, length, dtype)
        return
    clock = dtype.kind == "M"
    if dtype.kind in "mM":
        unit = np.datetime_data(dtype)
        table.scalars.setdefault(f"{name}_unit", unit[0])
        dtype = np.dtype(np.int64).newbyteorder(dtype.byteorder)
        if unit[1] != 1:
            return

    def begin() -> Stream:
        values = stream.copy()
        values.skip(length)
        return values

    offset = None if member.compress_type else _offset(table.path, member) + length
    read_as = dtype.newbyteorder("=")
    array: Array | None = text_array_of(name, shape, dtype, begin, offset) or array_of(
        name, shape, (dtype, read_as), column_major, begin, offset
    )
    if array is not None:
        true = partial(_is_true, table.path, member)
        table.add(replace(array, track=replace(array.track, clock=clock), is_true=true), size)


def _head(data: bytes) -> tuple[tuple[int, ...], bool, np.dtype[Any], int]:
    """Return shape, whether the first axis runs fastest, type, and bytes of the head of an array."""
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, column_major, dtype = read(stream)
    if any(length < 0 for length in shape):
        raise ValueError("a negative length")
    return shape, column_major, dtype, stream.tell()


def _scalar(head: bytes, length: int, dtype: np.dtype[Any]) -> object:
    if dtype.hasobject or not 0 < dtype.itemsize <= LONGEST_TEXT:
        raise ValueError("no plain value")
    try:
        return np.frombuffer(head, dtype, 1, length)[0]
    except SystemError as error:  # a text holds an invalid character
        raise ValueError("no text") from error


def _stream(path: Path, member: zipfile.ZipInfo) -> Stream:
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) or member.flag_bits & 1:
        raise ValueError("encrypted, or packed in another way")
    begin = _offset(path, member)
    if member.compress_type == zipfile.ZIP_STORED:
        return PlainStream(path, begin, member.file_size)
    return PackedStream(path, begin, member.compress_size, bare=True)


def _offset(path: Path, member: zipfile.ZipInfo) -> int:
    """Return the byte in the file at which a member's own bytes begin."""
    with path.open("rb") as file:
        file.seek(member.header_offset)
        lengths = file.read(LOCAL_HEAD)[LOCAL_LENGTHS]
    if len(lengths) < 4:
        raise ValueError("a member beyond the end")
    name, extra = int.from_bytes(lengths[:2], "little"), int.from_bytes(lengths[2:], "little")
    return member.header_offset + LOCAL_HEAD + name + extra


def _is_true(path: Path, member: zipfile.ZipInfo) -> bool:
    """Return True if the checksum of a member is right."""
    crc, stream, left = 0, _stream(path, member), member.file_size
    while left > 0:
        pieces = [*stream.pieces(min(left, PIECE_BYTES))]
        if not pieces:
            return False
        for piece in pieces:
            crc = zlib.crc32(piece, crc)
            left -= len(piece)
    return crc == member.CRC
