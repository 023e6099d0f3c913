"""Arrow IPC files and streams of the tables that Parquet is tried with, and damaged messages."""

from __future__ import annotations

import contextlib
import io
from random import Random

import pyarrow as pa
import pyarrow.feather

from tests.fuzz.blind import blind, replace_number
from tests.fuzz.mutant import Mutant
from tests.fuzz.mutate_parquet import OPTIONS, ROWS, absurd, sound

SUFFIX = ".feather"
CONTINUATION = b"\xff\xff\xff\xff"


def bytes_of(made: pa.Table, random: Random) -> bytes:
    """A file or a stream; what the library refuses is empty."""
    rows, packing = random.choice([7, 100, ROWS]), random.choice([None, "lz4", "zstd"])
    buffer = io.BytesIO()
    with contextlib.suppress(pa.ArrowException, ValueError, TypeError, OSError):
        options = pa.ipc.IpcWriteOptions(compression=packing)
        new = random.choice([pa.ipc.new_file, pa.ipc.new_file, pa.ipc.new_stream])
        with new(buffer, made.schema, options=options) as writer:
            writer.write_table(made, rows)
        return buffer.getvalue()
    return b""


def messages(data: bytes, random: Random) -> bytes:
    """Numbers in the heads of messages, or in the footer, replaced."""
    new, places, at = bytearray(data), [], data.find(CONTINUATION)
    while at >= 0 and len(places) < 100:
        places.append(at)
        at = data.find(CONTINUATION, at + 8)
    for _ in range(random.choice([1, 1, 3])):
        start = random.choice([*places, max(0, len(data) - 600)])
        at = min(start + random.randrange(random.choice([8, 300])), len(new) - 8)
        words = [0, 1, (1 << 64) - 1, 1 << 62, len(new), random.getrandbits(64)]
        replace_number(new, at, words, random)
    return bytes(new)


def mutant(random: Random) -> Mutant:
    choice = random.random()
    made, truth = sound(random)
    if choice < 0.35:
        return Mutant(bytes_of(made, random), "sound", truth)
    if choice < 0.6:
        return Mutant(
            bytes_of(absurd(random), random) or b"ARROW1\0\0", "absurd", None, random.choice(OPTIONS)
        )
    how = random.choice([messages, messages, blind])
    return Mutant(how(bytes_of(made, random), random), how.__name__, None, random.choice(OPTIONS))
