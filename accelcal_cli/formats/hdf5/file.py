"""Opens HDF5 files, lists their nodes and reads attributes; no error of h5py leaves this module.

The HDF5 library (1.14 and 2.0) loops forever over a global heap whose object sizes are damaged, and refuses
a file that was cut short even where what is left could be read: `SoundBytes` stands between it and the file.
`bounded_memory` keeps it from asking for gigabytes where the length of a text is damaged.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from math import prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.system import bounded_memory
from accelcal_cli.core.vocabulary import normalized
from accelcal_cli.formats._bytes import ByteSource
from accelcal_cli.formats._tables.table import READ_ERRORS, Attributes, plain_value

HEAP_MAGIC = b"GCOL\x01\0\0\0"
HEAP_HEADER = OBJECT_HEADER = 16
LARGEST_HEAP_READ = 1 << 20
"""Reads up to this size [bytes] are searched for heaps; larger ones are of data."""

LARGEST_ATTRIBUTE = 1 << 16
SPARE_BYTES = 256 << 20
"""Memory that the HDF5 library may ask for to read a text.

A text whose length is damaged makes it (1.14 and 2.0) ask for up to 4 GB before it checks that the text is
there.
"""

LONGEST_TEXT = 1 << 16
MATLAB_CLASS = "MATLAB_class"
H5PY_ERRORS = READ_ERRORS
"""h5py maps the failures of the HDF5 library to almost any of Python's own kinds."""


class SoundBytes(io.RawIOBase):
    """A file read in places, that may claim to be longer than it is.

    Args:
        path: the file.
        claimed: its size according to its header, for one that was cut short.

    Raises:
        OSError: from `readinto`, for bytes that are not there and for a damaged heap.
    """

    def __init__(self, path: Path, claimed: int = 0) -> None:
        super().__init__()
        self._file = path.open("rb", buffering=0)
        self._claimed = claimed

    def readable(self) -> bool:
        """Return True always."""
        return True

    def seekable(self) -> bool:
        """Return True always."""
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Move; the end is where the file claims to end."""
        if whence == io.SEEK_END:
            end = max(self._file.seek(0, io.SEEK_END), self._claimed)
            offset, whence = end + offset, io.SEEK_SET
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """Return the place of the next read."""
        return self._file.tell()

    def readinto(self, buffer: Any, /) -> int:
        """Fill the whole buffer."""
        view = memoryview(buffer).cast("B")
        done = 0
        while done < len(view):
            count = self._file.readinto(view[done:])
            if not count:
                raise OSError("the file ends before its data")
            done += count
        if len(view) <= LARGEST_HEAP_READ and not heaps_are_sound(bytes(view)):
            raise OSError("a heap of texts is damaged")
        return done

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()


def heaps_are_sound(block: bytes) -> bool:
    """Return True if the objects of every global heap that begins in a block lie within it.

    Source: HDF5 File Format Specification, III.E (Global Heap), with 8-byte lengths.
    """
    start = block.find(HEAP_MAGIC)
    while start >= 0:
        if not _heap_is_sound(block[start:]):
            return False
        start = block.find(HEAP_MAGIC, start + 1)
    return True


def _heap_is_sound(heap: bytes) -> bool:
    size = int.from_bytes(heap[8:16], "little")
    place = HEAP_HEADER
    while place + OBJECT_HEADER <= min(size, len(heap)):
        number = int.from_bytes(heap[place : place + 2], "little")
        length = int.from_bytes(heap[place + 8 : place + 16], "little")
        if number == 0 and length < OBJECT_HEADER:
            return False
        # Object 0 is the free space, whose length includes its header.
        place += length if number == 0 else OBJECT_HEADER + -(-length // 8) * 8
    return place <= size


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
    with _opened(path) as file:
        yield file


@contextmanager
def _opened(path: Path, claimed: int = 0) -> Iterator[Any]:
    with SoundBytes(path, claimed) as stream:
        try:
            file = h5py.File(stream, "r")
        except H5PY_ERRORS as error:
            ends = re.search(r"truncated file: eof = (\d+).*stored_eof = (\d+)", str(error))
            if ends is None or claimed:
                raise _open_error(path, error, claimed) from error
            claimed = int(ends[2])
        else:
            with file:
                yield file
            return
    with _opened(path, claimed) as file:
        yield file


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
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                continue
            node = group[name]
        except H5PY_ERRORS:
            node = None
        yield name, node


def _member_names(group: Any) -> list[str]:
    """Return the names in a group, without those that MATLAB gives to what cells and objects refer to."""
    return [name for name in group if not name.startswith("#")]


def text_list(value: object) -> list[str]:
    """Return the texts of a list attribute, each without padding."""
    return [str(plain_value(item) or "") for item in np.atleast_1d(np.asarray(value, dtype=object))]


def _is_plain(node: Any, name: str) -> bool:
    """Return True if an attribute is one number or text; damaged ones of other kinds are not safe to read."""
    attribute = h5py.h5a.open(node.id, name.encode())
    kinds = (h5py.h5t.TypeIntegerID, h5py.h5t.TypeFloatID, h5py.h5t.TypeStringID)
    small = attribute.get_storage_size() <= LARGEST_ATTRIBUTE
    return small and isinstance(attribute.get_type(), kinds) and np.prod(attribute.shape) == 1


class NodeAttributes(Attributes):
    """Attributes of HDF5 nodes, and datasets of one number or text in groups, as MATLAB writes them.

    Args:
        nodes: the nearest first.
    """

    def __init__(self, nodes: Iterable[Any]) -> None:
        super().__init__()
        self._nodes = [*nodes]
        self._layers = [self._names(node) for node in self._nodes]
        self._members = [_members_by_name(node) for node in self._nodes]

    def _names(self, node: Any) -> dict[str, object]:
        try:
            return {normalized(name): name for name in node.attrs}
        except H5PY_ERRORS:
            self.damaged.append("*")
            return {}

    def read(self, depth: int, name: str) -> str | float | None:
        """Return the attribute, or else the dataset, of this name."""
        found = None
        if (known := self._layers[depth].get(name)) is not None:
            found = self._attribute(self._nodes[depth], str(known))
        if found is None:
            named = members(self._nodes[depth], self._members[depth].get(name, ()))
            scalars = [dataset for _, dataset in named if is_scalar(dataset)]
            found = _scalar(scalars[-1]) if scalars else None
        return found

    def _attribute(self, node: Any, name: str) -> str | float | None:
        try:
            with bounded_memory(SPARE_BYTES):
                return plain_value(node.attrs[name]) if _is_plain(node, name) else None
        except H5PY_ERRORS:
            self.damaged.append(name)
            return None


def _members_by_name(node: Any) -> dict[str, list[str]]:
    """Return the names in a group, by their normalized form; none in a dataset."""
    found: dict[str, list[str]] = {}
    with suppress(*H5PY_ERRORS):
        for name in _member_names(node) if isinstance(node, h5py.Group) else ():
            found.setdefault(normalized(name), []).append(name)
    return found


def is_scalar(node: Any) -> bool:
    """Return True for a small dataset of one number, or of MATLAB's letters."""
    try:
        most = LONGEST_TEXT if _is_letters(node) else 1
        small = isinstance(node, h5py.Dataset) and node.dtype.kind in "iufb" and 0 < node.size <= most
        return bool(small and prod(node.chunks or (1,)) <= LONGEST_TEXT and not node.external)
    except H5PY_ERRORS:
        return False


def _is_letters(node: Any) -> bool:
    return plain_value(node.attrs.get(MATLAB_CLASS)) == "char"


def _scalar(dataset: Any) -> str | float | None:
    try:
        with bounded_memory(SPARE_BYTES):
            values = dataset[()]
            if _is_letters(dataset):
                # MATLAB keeps a row of letters as a column of UTF-16.
                return plain_value(np.asarray(values, "<u2").tobytes().decode("utf-16-le", "replace"))
            return plain_value(values)
    except H5PY_ERRORS:
        return None


def attributes_of(file: Any, path: str) -> NodeAttributes:
    """Return the attributes of a dataset or group, then of the groups that hold it, up to the file."""
    nodes = []
    parts = [part for part in path.split("/") if part]
    for depth in range(len(parts), -1, -1):
        try:
            nodes.append(file["/" + "/".join(parts[:depth])])
        except H5PY_ERRORS:
            continue
    return NodeAttributes(nodes)
