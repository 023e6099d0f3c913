"""Opens HDF5 files, lists their nodes and reads attributes; no error of h5py leaves this module.

The HDF5 library (1.14 and 2.0) loops forever over a global heap whose object sizes are damaged, and refuses
a file that was cut short even where what is left could be read: `SoundBytes` stands between it and the file.
`bounded_memory` keeps it from asking for gigabytes where the length of a text is damaged.
"""

from __future__ import annotations

import io
import re
import struct
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.system import bounded_memory
from accelcal_cli.core.vocabulary import normalized
from accelcal_cli.formats._bytes import ByteSource
from accelcal_cli.formats.tables.header import Attributes, plain_value
from accelcal_cli.formats.tables.tracks import READ_ERRORS

HEAP_MAGIC = b"GCOL\x01\0\0\0"
HEAP_HEADER = OBJECT_HEADER = 16
LARGEST_HEAP_READ = 1 << 20
"""Reads up to this size [bytes] are searched for heaps; larger ones are of data."""

LARGEST_ATTRIBUTE = LONGEST_TEXT = 1 << 16
SPARE_BYTES = 256 << 20
"""Memory that the HDF5 library may ask for to read a text.

A text whose length is damaged makes it (1.14 and 2.0) ask for up to 4 GB before it checks that the text is
there.
"""

H5PY_ERRORS = READ_ERRORS
"""h5py maps the failures of the HDF5 library to almost any of Python's own kinds."""


class SoundBytes(io.FileIO):
    """A file that may claim to be longer than it is.

    Attributes:
        claimed: its size according to its header, once it is known to be cut short.

    Raises:
        OSError: from `readinto`, for bytes that are not there and for a damaged heap.
    """

    claimed = 0

    def seek(self, offset: int, whence: int = io.SEEK_SET, /) -> int:
        """Move; the end is where the file claims to end."""
        if whence == io.SEEK_END:
            offset += max(super().seek(0, io.SEEK_END), self.claimed)
            whence = io.SEEK_SET
        return super().seek(offset, whence)

    def readinto(self, buffer: Any, /) -> int:
        """Fill the whole buffer."""
        view = memoryview(buffer).cast("B")
        done = 0
        while done < len(view):
            count = super().readinto(view[done:])
            if not count:
                raise OSError("the file ends before its data")
            done += count
        if len(view) <= LARGEST_HEAP_READ and not heaps_are_sound(bytes(view)):
            raise OSError("a heap of texts is damaged")
        return done


def heaps_are_sound(block: bytes) -> bool:
    """Return True if the objects of every global heap that begins in a block lie within it.

    Source: HDF5 File Format Specification, III.E (Global Heap), with 8-byte lengths.
    """
    start = block.find(HEAP_MAGIC)
    while start >= 0:
        size = int.from_bytes(block[start + 8 : start + 16], "little")
        place = HEAP_HEADER
        while place + OBJECT_HEADER <= min(size, len(block) - start):
            number, length = struct.unpack_from("<H6xQ", block, start + place)
            if number == 0 and length < OBJECT_HEADER:
                return False
            # Object 0 is the free space, whose length includes its header.
            place += length if number == 0 else OBJECT_HEADER + -(-length // 8) * 8
        if place > size:
            return False
        start = block.find(HEAP_MAGIC, start + 1)
    return True


@contextmanager
def open_hdf5(path: Path) -> Iterator[Any]:
    """Open an h5py.File, and close it afterwards; of one that was cut short, the rest can be read.

    Raises:
        UnreadableError: it is compressed, damaged, or not an HDF5 file.
    """
    with ByteSource(path) as source:
        compressed = source.compressed
    if compressed:
        raise UnreadableError("is an HDF5 file inside gzip", path=path, hint="unpack it first with gunzip")
    with SoundBytes(path) as stream, _opened(path, stream) as file:
        yield file


def _opened(path: Path, stream: SoundBytes) -> Any:
    try:
        return h5py.File(stream, "r")
    except H5PY_ERRORS as error:
        ends = re.search(r"truncated file: eof = (\d+).*stored_eof = (\d+)", str(error))
        if ends is None or stream.claimed:
            raise _open_error(path, error, stream.claimed) from error
        stream.claimed = int(ends[2])
    return _opened(path, stream)


def _open_error(path: Path, error: Exception, claimed: int) -> UnreadableError:
    """Return h5py's complaint as an error for the person who has the file."""
    text, size, hint = str(error), 0, "copy it again from its source"
    if claimed:
        size = path.stat().st_size
        what = f"is cut short: it has {size} of {claimed} bytes, and these cannot be read"
    elif "signature not found" in text:
        what = "is not an HDF5 file, or its beginning is damaged"
    elif "consistency flags" in text or "already open for write" in text:
        what = "was not closed by the program that wrote it"
        hint = "close that program, or mark a copy as closed with `h5clear -s`"
    else:
        what = f"the structure of the HDF5 file is damaged ({brief(error)})"
    return UnreadableError(what, path=path, byte_offset=size, hint=hint)


def brief(error: Exception) -> str:
    """Return the text of an error on one line, cut to 200 letters."""
    return (" ".join(str(error).split()) or type(error).__name__)[:200]


def members(group: Any, names: Iterable[str] | None = None) -> Iterator[tuple[str, Any]]:
    """Yield groups and datasets directly in a group, all or some, with their names; None for a damaged one.

    Links elsewhere are left out. One member is open at a time, since each takes some 16 KB.
    """
    try:
        names = _member_names(group) if names is None else names
    except H5PY_ERRORS:
        yield "", None
        return
    for name in names:
        try:
            if group.id.links.get_info(name.encode()).type != h5py.h5l.TYPE_HARD:
                continue
            opened = h5py.h5o.open(group.id, name.encode())
            if isinstance(opened, h5py.h5t.TypeID):
                continue
            node = h5py.Group(opened) if isinstance(opened, h5py.h5g.GroupID) else h5py.Dataset(opened)
        except H5PY_ERRORS:
            node = None
        yield name, node


def _member_names(group: Any) -> list[str]:
    """Return the names in a group, without those that MATLAB gives to what cells and objects refer to."""
    return [name for name in group if not name.startswith("#")]


class NodeAttributes(Attributes):
    """Attributes of HDF5 nodes, and datasets of one number or text in groups, as MATLAB writes them.

    No node stays open: a dataset that is opened again keeps the cache that it was opened with first.

    Args:
        paths: of the nodes, the nearest first; those that cannot be opened are left out.
    """

    def __init__(self, file: Any, paths: Iterable[str]) -> None:
        super().__init__()
        self._file = file
        self._nodes: list[tuple[str, dict[str, list[str]]]] = []
        for path in paths:
            try:
                node = file[path]
            except H5PY_ERRORS:
                continue
            try:
                self._layers.append({normalized(name): name for name in node.attrs})
            except H5PY_ERRORS:
                self.damaged.append("*")
                self._layers.append({})
            self._nodes.append((path, _members_by_name(node)))

    def read(self, depth: int, name: str) -> str | float | None:
        """Return the attribute, or else the dataset, of this name."""
        path, around = self._nodes[depth]
        known = self._layers[depth].get(name)
        found = None if known is None else self._attribute(path, str(known))
        if found is None and name in around:
            values = (scalar(node) for _, node in members(self._file[path], reversed(around[name])))
            found = next((value for value in values if value is not None), None)
        return found

    def _attribute(self, path: str, name: str) -> str | float | None:
        """Return an attribute of one number or text; damaged ones of other kinds are not safe to read."""
        try:
            node = self._file[path]
            stored = h5py.h5a.open(node.id, name.encode())
            kinds = (h5py.h5t.TypeIntegerID, h5py.h5t.TypeFloatID, h5py.h5t.TypeStringID)
            plain = isinstance(stored.get_type(), kinds) and prod(stored.shape) == 1
            if not plain or stored.get_storage_size() > LARGEST_ATTRIBUTE:
                return None
            with bounded_memory(SPARE_BYTES):
                return plain_value(node.attrs[name])
        except H5PY_ERRORS:
            self.damaged.append(name)
            return None


def _members_by_name(node: Any) -> dict[str, list[str]]:
    """Return the names in a group by their normalized form; none in a dataset, or a damaged group."""
    found: dict[str, list[str]] = {}
    try:
        for name in _member_names(node) if isinstance(node, h5py.Group) else ():
            found.setdefault(normalized(name), []).append(name)
    except H5PY_ERRORS:
        return {}
    return found


def scalar(node: Any) -> str | float | None:
    """Return what a small dataset of one number, or of MATLAB's letters, holds; None for any other node."""
    try:
        with bounded_memory(SPARE_BYTES):
            letters = plain_value(node.attrs.get("MATLAB_class")) == "char"
            most = LONGEST_TEXT if letters else 1
            if node.dtype.kind not in "iufb" or not 0 < node.size <= most or node.external:
                return None
            if prod(node.chunks or (1,)) > LONGEST_TEXT:
                return None
            # MATLAB keeps a row of letters as a column of UTF-16.
            values = node[()]
            text = np.asarray(values, "<u2").tobytes().decode("utf-16-le", "replace") if letters else None
            return plain_value(values if text is None else text)
    except H5PY_ERRORS:
        return None


def attributes_of(file: Any, path: str) -> NodeAttributes:
    """Return the attributes of a dataset or group, then of the groups that hold it, up to the file."""
    parts = [part for part in path.split("/") if part]
    return NodeAttributes(file, ["/" + "/".join(parts[:depth]) for depth in range(len(parts), -1, -1)])
