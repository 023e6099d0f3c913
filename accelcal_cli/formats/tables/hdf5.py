"""Reads HDF5 files of laboratories as tables; docs/tables.md lists what is understood.

`TrackRows` reads rows in bounded memory, whole HDF5 chunks at a time, without damaged ones. The HDF5 library
makes up what a file does not hold: chunks that were never written, and the ends of those that are too short.
Its index of chunks (`stored_chunks`) tells which these are.
"""

from __future__ import annotations

import io
import re
import struct
from array import array
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from math import prod
from pathlib import Path
from posixpath import dirname
from typing import Any, NamedTuple

import h5py
import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.system import bounded_memory
from accelcal_cli.core.vocabulary import normalized
from accelcal_cli.formats._bytes import refuse_packed
from accelcal_cli.formats.tables.header import Attributes, plain_value, readable
from accelcal_cli.formats.tables.reader import TableReader, open_table
from accelcal_cli.formats.tables.tracks import (
    AGAIN,
    BLOCK_ROWS,
    HIGHEST_RATIO,
    READ_ERRORS,
    REFUSE_ABOVE_BYTES,
    TEXT,
    OpenRows,
    Track,
    TrackSource,
    track_of_shape,
)

# Opens HDF5 files, lists their nodes and reads attributes; no error of h5py leaves this module.
#
# The HDF5 library (1.14 and 2.0) loops forever over a global heap whose object sizes are damaged, and
# refuses a file that was cut short even where what is left could be read: `SoundBytes` stands between
# it and the file. `bounded_memory` keeps it from asking for gigabytes where the length of a text is
# damaged.

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
    refuse_packed(path, "an HDF5 file")
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
    text, size, hint = str(error), 0, AGAIN
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


# Reads HDF5 files of laboratories as tables; docs/tables.md lists what is understood.

MATLAB_EMPTY, MATLAB_OBJECT = b"MATLAB_empty", b"MATLAB_object_decode"
"""Attributes of MATLAB's empty arrays, and of its tables, dates and other objects: their numbers are lengths
of axes, or say where the content is."""

DEEPEST = 64
"""Groups within groups that are entered; each costs as many steps again as it lies deep."""

MOST_NODES = 100_000
"""Most datasets and groups in a file."""

MOST_CHUNKS = 4096
"""Chunks that are read at a time: the HDF5 library keeps a kilobyte and more of notes on each."""

SMALLEST_LOSS_ROWS = 16
"""Rows around damage that are lost together where chunks are smaller."""

MOST_CLAIMED = 200
"""Most rows that a dataset may claim for each one that was written, lest going through it takes too long."""

CACHE_SLOTS, SPARE_CACHE_BYTES = 521, 1 << 20
"""Places in the library's cache for chunks, and room for others than the one that is kept."""

REPACK = "repack it with `h5repack -l CHUNK=65536x3` (`CHUNK=65536` for one axis)"

KNOWN_SIZES, CHECKSUM_BYTES = 4096, 4
SAME_SIZE = {h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}
"""Filters that do not change the size of a chunk, except for a checksum behind it."""

NEVER_WRITTEN = "is empty: its values were never written"
ABSENT, SOUND, IMPOSSIBLE = 0, 1, 2
"""States of the chunks that hold a row: one was never written; all may be read; one has an absurd size."""


def possible_sizes(dataset: Any) -> Callable[[int, int], bool]:
    """Return what tells if a chunk can have a size in the file, given a bit for each filter left out of it.

    The HDF5 library (1.14 and 2.0) believes the sizes in the index of chunks. One too short for its checksum
    ends the process; one that holds too little is filled up with what lies in memory.
    """
    settings = dataset.id.get_create_plist()
    filters = [settings.get_filter(index)[0] for index in range(settings.get_nfilters())]
    whole: int = prod(dataset.chunks) * int(dataset.id.get_type().get_size())

    @lru_cache(KNOWN_SIZES)
    def possible(size: int, left_out: int) -> bool:
        used = {kind for index, kind in enumerate(filters) if not left_out >> index & 1}
        checksum = CHECKSUM_BYTES if h5py.h5z.FILTER_FLETCHER32 in used else 0
        if used - SAME_SIZE == {h5py.h5z.FILTER_DEFLATE}:
            return (size - checksum) * HIGHEST_RATIO >= whole
        return size > checksum if used - SAME_SIZE else size in (whole, whole + checksum)

    return possible


class ChunkIndex(NamedTuple):
    """The chunks of a dataset along its rows, each (n,) and in order.

    Attributes:
        numbers: of the chunks that are in the file.
        states: ABSENT if another one next to it is not.
        offsets: the byte in the file of the first of those side by side.
    """

    numbers: NDArray[np.int64]
    states: NDArray[np.int8]
    offsets: NDArray[np.int64]


def stored_chunks(dataset: Any, axis: int, columns: range) -> ChunkIndex:
    """Read the index of chunks in one pass, as far as it is sound; `columns` are the first ones of chunks.

    The library goes through the index for each single chunk that it is asked for.
    """
    found, possible = array("q"), possible_sizes(dataset)

    def see(chunk: Any) -> None:
        place, sound = (*chunk.chunk_offset, 0), possible(chunk.size, chunk.filter_mask)
        if chunk.byte_offset is not None:
            found.extend(array("q", (place[axis], place[1 - axis], chunk.byte_offset, sound)))

    with suppress(*H5PY_ERRORS):
        dataset.id.chunk_iter(see)
    rows, first, offsets, sound = np.array(found, np.int64).reshape(-1, 4).T
    inside = np.flatnonzero((rows < dataset.shape[axis]) & (first < columns.stop))
    inside = inside[np.lexsort((first[inside], rows[inside]))]
    rows, where, times = np.unique(rows[inside], return_index=True, return_counts=True)
    states = np.where(times == len(columns), SOUND, ABSENT).astype(np.int8)
    if len(where):
        states[np.minimum.reduceat(sound[inside], where) == 0] = IMPOSSIBLE
    return ChunkIndex(rows // dataset.chunks[axis], states, offsets[inside][where])


class TrackRows:
    """Reads rows of a track in order; each HDF5 chunk is unpacked once.

    A block that cannot be read is narrowed down to the HDF5 chunks concerned; their rows, and the rows of
    chunks that were never written, are marked as lost.

    Raises:
        UnreadableError: the dataset's storage is of a kind that cannot be read in parts.
    """

    def __init__(self, source: Hdf5Source, track: Track) -> None:
        self.path, self.row_bytes, self.kept_bytes = track.path, track.width * track.dtype.itemsize, 0
        self._source, self._track = source, track
        self.dataset = source.file[track.path]
        if self.dataset.external or self.dataset.is_virtual:
            raise self._refusal("keeps its values in other files", "copy it into one file with h5repack")
        if track.rows > source.path.stat().st_size * HIGHEST_RATIO:
            raise self._refusal(f"claims {track.rows} rows, more than the file can hold")
        if track.rows == 0 or (self.dataset.chunks is None and self.dataset.id.get_storage_size() == 0):
            raise self._refusal(NEVER_WRITTEN)
        self._chunk_rows, self._columns, self._broken = SMALLEST_LOSS_ROWS, range(1), -1
        self._index: ChunkIndex | None = None
        if self.dataset.chunks is not None:
            self._look_at_chunks()
        self._start = self._stop = 0
        self._values, self._good = np.empty((0, track.width), track.dtype), np.empty(0, np.bool_)

    def _refusal(self, what: str, hint: str = AGAIN) -> UnreadableError:
        return UnreadableError(f"column {self.path} {what}", path=self._source.path, hint=hint)

    def _look_at_chunks(self) -> None:
        """Note the chunks' size and states; keep those unpacked that are larger than a block of rows."""
        chunks, axis, indexes = self.dataset.chunks, self._track.axis, self._source.indexes
        self._chunk_rows = int(chunks[axis])
        if self.dataset.ndim == 2:
            self._columns = range(0, self._track.width, int(chunks[1 - axis]))
        if self.path not in indexes:
            indexes[self.path] = stored_chunks(self.dataset, axis, self._columns)
        self._index = indexes[self.path]
        written = np.count_nonzero(self._index.states) * self._chunk_rows
        if written * MOST_CLAIMED < self._track.rows:
            what = f"claims {self._track.rows} rows, of which only {written} were ever written"
            raise self._refusal(what if written else NEVER_WRITTEN)
        size = prod(chunks) * len(self._columns) * self._track.dtype.itemsize
        if self.dataset.id.get_create_plist().get_nfilters() and size > BLOCK_ROWS * self.row_bytes:
            self.kept_bytes = size
        if self.kept_bytes > REFUSE_ABOVE_BYTES:
            what = f"is packed in chunks of {size >> 20} MB, too large to unpack at once"
            raise self._refusal(what, REPACK)
        access = h5py.h5p.create(h5py.h5p.DATASET_ACCESS)
        access.set_chunk_cache(CACHE_SLOTS, self.kept_bytes + SPARE_CACHE_BYTES, 1.0)
        # A dataset that is open already would stay as it was opened.
        self.dataset = None
        self.dataset = h5py.Dataset(h5py.h5d.open(self._source.file.id, self.path.encode(), access))

    def read(self, start: int, stop: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Return rows start..stop-1, shape (stop - start, width), and flags of those that are not lost."""
        values, good = [], []
        row = start
        while row < stop:
            if not self._start <= row < self._stop:
                self._start, self._stop = self.block(row)
                self._values = np.zeros((self._stop - self._start, self._track.width), self._track.dtype)
                states = self._states(self._start, self._stop)
                self._fill(self._start, self._values, states)
                self._good = states == SOUND
            here = slice(row - self._start, min(stop, self._stop) - self._start)
            values.append(self._values[here])
            good.append(self._good[here])
            row = min(stop, self._stop)
        return (values[0], good[0]) if len(values) == 1 else (np.concatenate(values), np.concatenate(good))

    def block(self, row: int) -> tuple[int, int]:
        """Return the rows to read together with this one: whole HDF5 chunks, or a part of a large one."""
        size = self._chunk_rows
        step = size * max(1, min(BLOCK_ROWS // size, MOST_CHUNKS // len(self._columns)))
        first = row // step * step
        start = first + (row - first) // BLOCK_ROWS * BLOCK_ROWS
        return start, min(start + BLOCK_ROWS, first + step, self._track.rows)

    def _states(self, start: int, stop: int) -> NDArray[np.int8]:
        if self._index is None:
            return np.full(stop - start, SOUND, np.int8)
        size = self._chunk_rows
        first, end = start // size, -(-stop // size)
        here = slice(*np.searchsorted(self._index.numbers, (first, end)))
        states = np.full(end - first, ABSENT, np.int8)
        states[self._index.numbers[here] - first] = self._index.states[here]
        return np.repeat(states, size)[start % size :][: stop - start]

    def chunk_offset(self, row: int) -> int | None:
        """Return the byte in the file of the first of the chunks that hold a row; None if one is missing."""
        if self._index is None:
            return None
        known = self._index.numbers == row // self._chunk_rows
        offsets = self._index.offsets[known & (self._index.states != ABSENT)]
        return int(offsets[0]) if len(offsets) else None

    def _fill(self, start: int, values: NDArray[Any], states: NDArray[np.int8]) -> None:
        """Read rows into `values`; where that fails, halve them along chunk borders, and note what is lost.

        Ends that were never written are not read, which would be slow.
        """
        sound = np.flatnonzero(states == SOUND)
        if not len(sound):
            return
        here = slice(sound[0], sound[-1] + 1)
        start, values, states = start + int(sound[0]), values[here], states[here]
        try:
            if (states == IMPOSSIBLE).any():
                raise OSError("a chunk has a size that its filters cannot have left")
            values[:] = self.fetch(start, start + len(values))
        except H5PY_ERRORS:
            step = max(1, SMALLEST_LOSS_ROWS // self._chunk_rows) * self._chunk_rows
            half = max(1, len(values) // 2 // step) * step
            if half >= len(values):
                states[:], self._broken = ABSENT, start // self._chunk_rows
                return
            self._fill(start, values[:half], states[:half])
            self._fill(start + half, values[half:], states[half:])

    def fetch(self, start: int, stop: int) -> NDArray[Any]:
        """Return rows start..stop-1, (n, width), as h5py gives them. Raises as it does."""
        if self.kept_bytes and start // self._chunk_rows == self._broken:
            raise OSError("the chunk could not be unpacked before")
        part = self.dataset[start:stop] if self._track.axis == 0 else self.dataset[:, start:stop].T
        return np.asarray(part).reshape(-1, self._track.width)


class TextDataset:
    """Rows of a dataset of texts, in order; a block that cannot be read is lost."""

    kept_bytes, row_bytes = 0, 16

    def __init__(self, dataset: Any) -> None:
        self._dataset = dataset

    def chunk_offset(self, row: int) -> int | None:
        """Return None: where texts are stored is not known."""
        return None

    def read(self, start: int, stop: int) -> tuple[Any, NDArray[np.bool_]]:
        """See `RowSource`; bytes that are not UTF-8 are replaced."""
        import pyarrow as pa  # only where texts are read

        try:
            values = self._dataset[start:stop]
        except H5PY_ERRORS:
            return pa.nulls(stop - start, pa.string()), np.zeros(stop - start, np.bool_)
        texts = (one.decode("utf-8", "replace") if isinstance(one, bytes) else str(one) for one in values)
        cells = pa.array([readable(text).strip("\0 ") or None for text in texts], pa.string())
        return cells, np.ones(stop - start, np.bool_)


@contextmanager
def guarded(path: Path, what: str) -> Iterator[None]:
    """Turn whatever h5py raises into an UnreadableError that names the part concerned."""
    try:
        yield
    except H5PY_ERRORS as error:
        hint, what = f"the file is damaged: {AGAIN}", f"the {what} cannot be read ({brief(error)})"
        raise UnreadableError(what, path=path, hint=hint) from error


def as_track(path: str, dataset: Any) -> Track | None:
    """Return a dataset as a track of rows of 1 or 3 numbers, or of texts; None if it cannot be read so."""
    shape, dtype = dataset.shape, dataset.dtype
    if shape is None or any(h5py.h5a.exists(dataset.id, name) for name in (MATLAB_EMPTY, MATLAB_OBJECT)):
        return None
    if len(shape) == 1 and h5py.check_string_dtype(dtype) is not None:
        return Track(path, shape[0], 1, 0, TEXT)
    return track_of_shape(path, shape, dtype)


def all_tracks(file: Any, path: Path) -> tuple[list[Track], list[str], int]:
    """Return datasets of 1 or 3 numbers a row or of texts, paths of objects, and how many nodes are damaged.

    Datasets are those of one group after the other, as they lie in the file: mostly as they were written.
    Objects refer to others, as MATLAB's tables and cells do, or have named fields.
    """
    found: list[tuple[str, int, Track]] = []
    objects: list[str] = []
    damaged = 0
    for name, node in all_nodes(file, path):
        damaged += node is None
        if not isinstance(node, h5py.Dataset):
            continue
        try:
            if track := as_track(name, node):
                found.append((dirname(name), _address(node), track))
            elif h5py.h5a.exists(node.id, MATLAB_OBJECT) or (
                node.dtype.kind in "OV" and h5py.check_string_dtype(node.dtype) is None
            ):
                objects.append(name)
        except H5PY_ERRORS:
            continue
    found.sort(key=lambda one: one[:2])
    return [track for _, _, track in found], sorted(objects), damaged


def _address(node: Any) -> int:
    """Return the byte in the file at which a dataset begins; damaged ones come last."""
    try:
        return int(h5py.h5o.get_info(node.id).addr)
    except H5PY_ERRORS:
        return 1 << 62


def all_nodes(file: Any, path: Path) -> Iterator[tuple[str, Any]]:
    """Yield each group and dataset once, with its path; None for a damaged one."""
    seen: set[int] = set()
    groups = [""]
    while groups:
        parent = groups.pop()
        for name, node in members(file[parent or "/"]):
            if node is not None:
                if (address := hash(node.id)) in seen:
                    continue
                seen.add(address)
                if isinstance(node, h5py.Group) and parent.count("/") < DEEPEST:
                    groups.append(f"{parent}/{name}")
            if len(seen) > MOST_NODES:
                what = f"has more than {MOST_NODES} datasets and groups, as no recording does"
                hint = "copy the recording to a file of its own, as with h5copy"
                raise UnreadableError(what, path=path, hint=hint)
            yield f"{parent}/{name}", node


class Hdf5Source(TrackSource):
    """The datasets of an HDF5 file, which is opened again whenever rows are read.

    Attributes:
        file: the h5py.File while it is open.
        indexes: of the chunks of the datasets that were opened, by path.
    """

    format, repack = "hdf5", REPACK
    file: Any = None

    def __init__(self, path: Path) -> None:
        self.indexes: dict[str, ChunkIndex] = {}
        with open_hdf5(path) as file:
            with guarded(path, "list of columns"):
                tracks, objects, damaged = self._found(file, path)
            with suppress(*H5PY_ERRORS):
                self.missing_bytes = max(0, int(file.id.get_filesize()) - path.stat().st_size)
        super().__init__(path, tracks, objects=objects, damaged=damaged)

    def _found(self, file: Any, path: Path) -> tuple[list[Track], list[str], int]:
        """See `all_tracks`."""
        return all_tracks(file, path)

    @contextmanager
    def opened(self) -> Iterator[OpenRows]:
        """See `TrackSource`."""
        with open_hdf5(self.path) as file, guarded(self.path, "description of the recording"):
            before, self.file = self.file, file
            try:
                yield (
                    lambda track: (
                        TextDataset(file[track.path]) if track.dtype == TEXT else TrackRows(self, track)
                    )
                )
            finally:
                self.file = before

    def own(self, path: str) -> NodeAttributes:
        """Return the attributes of a dataset alone."""
        return NodeAttributes(self.file, [path])

    def around(self, path: str) -> NodeAttributes:
        """Return the attributes of a dataset, then of the groups that hold it, up to the file."""
        return attributes_of(self.file, path)


def open_recording(path: Path, options: ReadOptions) -> TableReader:
    """Open an HDF5 file whose acceleration is an (n, 3) dataset or three of length n.

    Raises:
        UnreadableError: damaged, cut short, or nothing in it is known as acceleration; or the rate, or the
            counts per g, are stated nowhere.
        UsageError: an option names no dataset.
    """
    return open_table(Hdf5Source(path), options)
