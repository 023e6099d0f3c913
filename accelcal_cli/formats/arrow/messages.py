"""Where the record batches of an Arrow IPC file or stream are, and how many rows each has.

A file's footer says where they are. A stream has none, and a file that was cut short has lost it: there one
message follows the other. Nothing but their heads is read.

Source: the Arrow columnar format, "Encapsulated message format" and "IPC file format", and its FlatBuffers
schemas: Message (version, header type, header, length of the body), RecordBatch (length, nodes, buffers,
compression), Footer (version, schema, dictionaries, record batches: each 24 bytes, with the offset first).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from accelcal_cli.formats.arrow import CONTINUATION, FEATHER_MAGIC

BATCH = 3
HEADER_TYPE, HEADER, BODY_LENGTH = 1, 2, 3
ROWS, COMPRESSION = 0, 3
FOOTER_BATCHES = 3
BLOCK_BYTES = 24
FILE_END = FEATHER_MAGIC.rstrip(b"\0")
LARGEST_HEAD = 1 << 26


@dataclass(frozen=True, slots=True)
class Batch:
    """A record batch: where its message begins, its rows, bytes of its body, and whether these are packed."""

    offset: int
    rows: int
    body_bytes: int
    packed: bool


@dataclass(frozen=True, slots=True)
class Messages:
    """What follows one another in a file.

    Attributes:
        first: byte at which the first message, the schema, begins.
        missing: bytes that the last message should have beyond the end of the file; -1 where a file ends
            without its footer; 0 for a whole one.
        damaged: how many batches cannot be found; they stand as batches without rows.
    """

    batches: tuple[Batch, ...]
    first: int
    missing: int
    damaged: int = 0


def scan(path: Path) -> Messages:
    """Find the batches of an Arrow IPC file or stream; of one that is cut short, the first ones."""
    with path.open("rb") as file:
        size = path.stat().st_size
        if file.read(len(FEATHER_MAGIC)) != FEATHER_MAGIC:
            return _one_by_one(file, size, 0)
        offsets = _listed(file, size)
        if offsets is None:
            return _one_by_one(file, size, len(FEATHER_MAGIC))
        found = [_read(file, offset) for offset in offsets]
        batches = [one.batch if one and one.batch and one.end <= size else None for one in found]
        known = tuple(batch or Batch(0, 0, 0, False) for batch in batches)
        return Messages(known, len(FEATHER_MAGIC), 0, batches.count(None))


def _listed(file: BinaryIO, size: int) -> list[int] | None:
    """Where the messages of batches begin, as the footer says; None without a footer."""
    tail = len(FILE_END) + 4
    file.seek(max(0, size - tail))
    end = file.read(tail)
    length = int.from_bytes(end[:4], "little")
    if end[4:] != FILE_END or length + tail > size:
        return None
    file.seek(size - tail - length)
    footer = file.read(length)
    try:
        at = _field(footer, _at("<I", footer, 0), FOOTER_BATCHES)
        vector = at + _at("<I", footer, at)
        places = range(vector + 4, vector + 4 + BLOCK_BYTES * _at("<I", footer, vector), BLOCK_BYTES)
        return [_at("<q", footer, place) for place in places] if at and places.stop <= length else None
    except (struct.error, ValueError):
        return None


def _one_by_one(file: BinaryIO, size: int, first: int) -> Messages:
    """From message to message, up to the end or to what is no message."""
    batches: list[Batch] = []
    place, missing = first, -1 if first else 0
    while place < size:
        found = _read(file, place)
        if found is None:
            return Messages(tuple(batches), first, -1)
        if not found.kind:
            break
        if found.end > size:
            return Messages(tuple(batches), first, found.end - size)
        batches += [found.batch] if found.batch else []
        place = found.end
    return Messages(tuple(batches), first, missing)


@dataclass(frozen=True, slots=True)
class _Message:
    """Kind (0: the end of a stream), byte behind its body, and what it is as a batch."""

    kind: int
    end: int
    batch: Batch | None = None


def _read(file: BinaryIO, place: int) -> _Message | None:
    """The message that begins at a byte; None if none does."""
    if place < 0:
        return None
    file.seek(place)
    head = file.read(8)
    length = int.from_bytes(head[4:], "little", signed=True)
    if len(head) < 8 or head[:4] != CONTINUATION or not 0 <= length <= LARGEST_HEAD:
        return None
    if not length:
        return _Message(0, place + 8)
    return _message(file.read(length), place, place + 8 + length)


def _message(data: bytes, offset: int, body: int) -> _Message | None:
    """A message whose body begins at a byte; None if it makes no sense."""
    try:
        root = _at("<I", data, 0)
        kind = _at("<B", data, _field(data, root, HEADER_TYPE))
        body_bytes = _at("<q", data, where) if (where := _field(data, root, BODY_LENGTH)) else 0
        batch = _batch(data, _field(data, root, HEADER), offset, body_bytes) if kind == BATCH else None
    except (struct.error, ValueError):
        return None
    sound = body_bytes >= 0 and kind and (batch is None or batch.rows >= 0)
    return _Message(kind, body + body_bytes, batch) if sound else None


def _batch(data: bytes, at: int, offset: int, body_bytes: int) -> Batch:
    table = at + _at("<I", data, at)
    rows = _at("<q", data, where) if (where := _field(data, table, ROWS)) else 0
    return Batch(offset, rows, body_bytes, bool(_field(data, table, COMPRESSION)))


def _field(data: bytes, table: int, number: int) -> int:
    """Where a field of a FlatBuffers table is; 0 if it has its default."""
    fields = table - _at("<i", data, table)
    place = 4 + 2 * number
    if fields < 0 or place + 2 > _at("<H", data, fields):
        return 0
    offset = _at("<H", data, fields + place)
    return table + offset if offset else 0


def _at(form: str, data: bytes, place: int) -> int:
    if place < 0:
        raise ValueError("before the beginning")
    (value,) = struct.unpack_from(form, data, place)
    return int(value)
