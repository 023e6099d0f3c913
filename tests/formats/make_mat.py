"""Writes small MATLAB files of level 5 byte by byte.

Source: MathWorks, "MAT-File Format", chapter 1: tags, data types, classes, and the parts of an array.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from tests.formats.expected import Expected
from tests.formats.make_hdf5 import even_times

TYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 9, "i8": 12, "u8": 13}
CLASSES = {"f8": 6, "f4": 7, "i1": 8, "u1": 9, "i2": 10, "u2": 11, "i4": 12, "u4": 13, "i8": 14, "u8": 15}
CELL, STRUCTURE, LETTERS, OPAQUE = 1, 2, 4, 17


def make(folder: Path, counts: np.ndarray, rate_hz: float, lsb_per_g: float) -> Expected:
    """A packed structure with whole counts, their scale, and times."""
    path, times = folder / "made.mat", even_times(len(counts), rate_hz)
    about = {"accel": counts, "time": times / 1e6, "lsb_per_g": lsb_per_g, "fs": rate_hz, "serial": "0042"}
    write(path, {"recording": about}, packed=True)
    return Expected(path, counts / lsb_per_g, rate_hz, times, 0, "0042")


def element(kind: int, data: bytes, order: str = "<") -> bytes:
    """Tag and data, filled up to eight bytes; short ones in their tag."""
    if 0 < len(data) <= 4:
        return struct.pack(f"{order}I", len(data) << 16 | kind) + data.ljust(4, b"\0")
    return struct.pack(f"{order}II", kind, len(data)) + data + bytes(-len(data) % 8)


def matrix(name: str, value: Any, order: str = "<", stored: str | None = None) -> bytes:
    """An array, a text, or a structure; `stored`: the type of its numbers in the file."""
    if isinstance(value, dict):
        names = b"".join(key.encode().ljust(32, b"\0") for key in value)
        fields = b"".join(matrix("", one, order) for one in value.values())
        parts = element(5, struct.pack(f"{order}i", 32), order) + element(1, names, order) + fields
        return array(STRUCTURE, (1, 1), name, parts, order)
    if isinstance(value, str):
        text = value.encode(f"utf-16-{'le' if order == '<' else 'be'}")
        return array(LETTERS, (1, len(value)), name, element(4, text, order), order)
    values = np.atleast_2d(np.asarray(value))
    values = values.T if np.ndim(value) == 1 else values
    own = values.dtype.str[1:]
    kept = stored or own
    raw = values.astype(order + kept).tobytes("F")
    return array(CLASSES[own], values.shape, name, element(TYPES[kept], raw, order), order)


def array(
    kind: int, shape: tuple[int, ...], name: str, parts: bytes, order: str = "<", flags: int = 0
) -> bytes:
    """What all arrays begin with, and their parts."""
    head = element(6, struct.pack(f"{order}II", kind | flags << 8, 0), order)
    head += element(5, struct.pack(f"{order}{len(shape)}i", *shape), order)
    head += element(1, name.encode(), order) if name else struct.pack(f"{order}II", 1, 0)
    return struct.pack(f"{order}II", 14, len(head + parts)) + head + parts


def file_of(elements: list[bytes], order: str = "<", packed: bool = False) -> bytes:
    """Head and elements."""
    text = b"MATLAB 5.0 MAT-file, made for tests".ljust(116) + bytes(8)
    version = b"\x00\x01IM" if order == "<" else b"\x01\x00MI"
    if packed:
        elements = [struct.pack(f"{order}II", 15, len(data)) + data for data in map(zlib.compress, elements)]
    return text + version + b"".join(elements)


def write(path: Path, variables: dict[str, Any], order: str = "<", packed: bool = False) -> Path:
    """A file of these variables."""
    path.write_bytes(file_of([matrix(name, one, order) for name, one in variables.items()], order, packed))
    return path
