"""HDF5 files opened, listed and asked for attributes, without an error of h5py ever leaving.

The HDF5 library (1.14 and 2.0) loops forever over a global heap whose object sizes are damaged, and refuses
a file that was cut short even where what is left could be read: `SoundBytes` stands between it and the file.
`bounded_memory` keeps it from asking for gigabytes where the length of a text is damaged.
"""

from __future__ import annotations

import io
import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.formats._bytes import ByteSource

HEAP_MAGIC = b"GCOL\x01\0\0\0"
HEAP_HEADER = OBJECT_HEADER = 16
LARGEST_HEAP_READ = 1 << 20
LARGEST_ATTRIBUTE = 1 << 16
SPARE_BYTES = 256 << 20
STATUS = Path("/proc/self/statm")
H5PY_ERRORS = (
    OSError, RuntimeError, ValueError, TypeError, LookupError, ArithmeticError, AttributeError, MemoryError,
    SystemError,
)  # fmt: skip
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
        """Always."""
        return True

    def seekable(self) -> bool:
        """Always."""
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Move; the end is where the file claims to end."""
        if whence == io.SEEK_END:
            end = max(self._file.seek(0, io.SEEK_END), self._claimed)
            offset, whence = end + offset, io.SEEK_SET
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """The place of the next read."""
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
    """Whether the objects of every global heap that begins in a block lie within it.

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
def bounded_memory() -> Iterator[None]:
    """Let larger allocations in the block fail, on systems that can say how much is in use.

    A text whose length is damaged makes the HDF5 library (1.14 and 2.0) ask for up to 4 GB before it
    looks whether there is so much.
    """
    if sys.platform == "win32" or not STATUS.exists():
        yield
        return
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    used = int(STATUS.read_text().split()[0]) * resource.getpagesize()
    limits = [bound for bound in (soft, used + SPARE_BYTES) if bound != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_AS, (min(limits), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


@contextmanager
def h5py_guard(path: Path, what: str) -> Iterator[None]:
    """Turn whatever h5py raises into an UnreadableError that names the part concerned."""
    try:
        yield
    except H5PY_ERRORS as error:
        raise UnreadableError(
            f"the {what} cannot be read ({_brief(error)})",
            path=path,
            hint="the file is damaged: copy it again from its source",
        ) from error


@contextmanager
def open_hdf5(path: Path) -> Iterator[Any]:
    """An open h5py.File, closed afterwards; of one that was cut short, what is left.

    Raises:
        UnreadableError: it is compressed, damaged, or not an HDF5 file.
    """
    _refuse_gzip(path)
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


def missing_bytes(file: Any, path: Path) -> int:
    """How many bytes at the end of a file that was cut short are not there."""
    try:
        return max(0, int(file.id.get_filesize()) - path.stat().st_size)
    except H5PY_ERRORS:
        return 0


def _refuse_gzip(path: Path) -> None:
    with ByteSource(path) as source:
        compressed = source.compressed
    if compressed:
        raise UnreadableError("is an HDF5 file inside gzip", path=path, hint="unpack it first with gunzip")


def _open_error(path: Path, error: Exception, claimed: int) -> UnreadableError:
    """What h5py's complaint means for the person who has the file."""
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
        what = f"the structure of the HDF5 file is damaged ({_brief(error)})"
    return UnreadableError(what, path=path, byte_offset=size, hint=hint)


def _brief(error: Exception) -> str:
    return (" ".join(str(error).split()) or type(error).__name__)[:200]


@contextmanager
def explaining(path: Path, missing: int, damaged: int = 0) -> Iterator[None]:
    """Add to any error of ours that the file is cut short or damaged, if it is."""
    try:
        yield
    except (UnreadableError, UsageError) as error:
        if missing:
            size = path.stat().st_size
            what = f"is cut short to {size} of {size + missing} bytes, so that"
            hint = "; or ".join(filter(None, (error.hint, "copy the whole file again from its source")))
            raise type(error)(f"{what} {error.message}", path=path, byte_offset=size, hint=hint) from error
        if damaged:
            what = f"is damaged in {damaged} places, so that"
            raise type(error)(f"{what} {error.message}", path=path, hint=error.hint) from error
        raise


def members(group: Any) -> tuple[list[tuple[str, Any]], int]:
    """Groups and datasets directly in a group, without links elsewhere; and how many are damaged."""
    found, damaged = [], 0
    try:
        names = list(group)
    except H5PY_ERRORS:
        return [], 1
    for name in names:
        try:
            if isinstance(group.get(name, getlink=True), h5py.HardLink):
                found.append((name, group[name]))
        except H5PY_ERRORS:
            damaged += 1
    return found, damaged


@lru_cache(maxsize=4096)
def normal(name: str) -> str:
    """A name without case and punctuation: `Sample_Rate [Hz]` gives `sampleratehz`."""
    return "".join(letter for letter in name.lower() if letter.isalnum())


def readable(text: str) -> str:
    """A name or text of a file; bytes that are not UTF-8, which h5py passes on, are replaced."""
    return text.encode("utf-8", "surrogateescape").decode("utf-8", "replace")


def plain_value(value: object) -> str | float | None:
    """An attribute as text or number; None if it is neither, empty or a list."""
    if isinstance(value, np.ndarray):
        value = value.ravel()[0] if value.size == 1 else None
    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    if isinstance(value, str):
        return readable(value).replace("\0", " ").strip() or None
    if isinstance(value, bool | int | float | np.number | np.bool_) and not np.iscomplexobj(value):
        return float(value)
    return None


def text_list(value: object) -> list[str]:
    """A list attribute of texts, each without padding."""
    return [str(plain_value(item) or "") for item in np.atleast_1d(np.asarray(value, dtype=object))]


def _is_plain(node: Any, name: str) -> bool:
    """Whether an attribute is one number or text; reading damaged ones of other kinds is not safe."""
    attribute = h5py.h5a.open(node.id, name.encode())
    kinds = (h5py.h5t.TypeIntegerID, h5py.h5t.TypeFloatID, h5py.h5t.TypeStringID)
    small = attribute.get_storage_size() <= LARGEST_ATTRIBUTE
    return small and isinstance(attribute.get_type(), kinds) and np.prod(attribute.shape) == 1


class Attributes:
    """Attributes of a dataset, of the groups around it and of the file: the nearest wins.

    Names are compared without case and punctuation. An attribute that cannot be read counts as
    absent and its name is kept in `damaged`.
    """

    def __init__(self, nodes: Iterable[Any]) -> None:
        self.damaged: list[str] = []
        self._nodes = [(node, self._names(node)) for node in nodes]

    def _names(self, node: Any) -> dict[str, str]:
        try:
            return {normal(name): name for name in node.attrs}
        except H5PY_ERRORS:
            self.damaged.append("*")
            return {}

    def value(self, *names: str) -> str | float | None:
        """The first attribute of these names that says something."""
        for node, known in self._nodes:
            for name in names:
                if normal(name) in known:
                    found = self._read(node, known[normal(name)])
                    if found is not None:
                        return found
        return None

    def _read(self, node: Any, name: str) -> str | float | None:
        try:
            with bounded_memory():
                return plain_value(node.attrs[name]) if _is_plain(node, name) else None
        except H5PY_ERRORS:
            self.damaged.append(name)
            return None

    def text(self, *names: str) -> str | None:
        """As text; a whole number is written without a decimal point."""
        value = self.value(*names)
        if isinstance(value, float):
            return f"{value:.0f}" if value.is_integer() else str(value)
        return value

    def number(self, *names: str) -> float | None:
        """As a number, also from text such as `100 Hz`; None if it is not one."""
        value = self.value(*names)
        if isinstance(value, str):
            found = re.match(r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?", value)
            value = float(found[0]) if found else None
        return value if value is not None and np.isfinite(value) else None


def attributes_of(file: Any, path: str) -> Attributes:
    """The attributes of a dataset or group, then of the groups that hold it, up to the file."""
    nodes = []
    parts = [part for part in path.split("/") if part]
    for depth in range(len(parts), -1, -1):
        try:
            nodes.append(file["/" + "/".join(parts[:depth])])
        except H5PY_ERRORS:
            continue
    return Attributes(nodes)
