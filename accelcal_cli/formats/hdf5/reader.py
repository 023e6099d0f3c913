"""Reads HDF5 files of laboratories as tables; docs/tables.md lists what is understood."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.parallel import thread_pool
from accelcal_cli.formats._tables.reader import ReadingPlan, TableReader, plan_of, source_of
from accelcal_cli.formats._tables.table import (
    TEXT,
    Attributes,
    RowSource,
    SensorTable,
    Track,
    track_of_shape,
)
from accelcal_cli.formats._tables.texts import TextRows, WrittenRows
from accelcal_cli.formats.hdf5.file import (
    H5PY_ERRORS,
    NodeAttributes,
    attributes_of,
    brief,
    members,
    open_hdf5,
)
from accelcal_cli.formats.hdf5.rows import ChunkIndex, TrackRows

MATLAB_EMPTY = "MATLAB_empty"
"""Attribute of an empty array of MATLAB, whose numbers are the lengths of its axes."""

MATLAB_OBJECT = "MATLAB_object_decode"
"""Attribute of a table, a date or another object of MATLAB, whose numbers say where its content is."""


class TextDataset:
    """Rows of a dataset of texts, in order; a block that cannot be read is lost."""

    kept_bytes, row_bytes = 0, 16

    def __init__(self, dataset: Any, path: str) -> None:
        self._dataset, self.path = dataset, path

    def chunk_offset(self, row: int) -> int | None:
        """Return None: where texts are stored is not known."""
        return None

    def read(self, start: int, stop: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Return rows start..stop-1 (n, 1), and flags of those that are not lost."""
        try:
            return np.asarray(self._dataset[start:stop]).reshape(-1, 1), np.ones(stop - start, np.bool_)
        except H5PY_ERRORS:
            return np.full((stop - start, 1), ""), np.zeros(stop - start, np.bool_)


class Hdf5Table(SensorTable):
    """An open HDF5 file.

    Attributes:
        file: the h5py.File.

    Args:
        pool: unpacks ahead where it can; None if one thread does all.
        indexes: indexes of chunks by the paths of datasets.
    """

    word = "dataset"

    def __init__(
        self,
        file: Any,
        path: Path,
        pool: Executor | None = None,
        indexes: dict[str, ChunkIndex | None] | None = None,
    ) -> None:
        self.path, self.file, self._pool, self._indexes = path, file, pool, indexes
        self._numbers: dict[str, dict[str, int]] = {}

    def missing_bytes(self) -> int:
        """Return the number of bytes that a file that was cut short lacks at its end."""
        try:
            return max(0, int(self.file.id.get_filesize()) - self.path.stat().st_size)
        except H5PY_ERRORS:
            return 0

    def own(self, path: str) -> Attributes:
        """Return the attributes of a dataset alone."""
        return NodeAttributes([self.file[path]])

    def stated(self, path: str) -> Attributes:
        """Return the attributes of a dataset, then of the groups that hold it, up to the file."""
        return attributes_of(self.file, path)

    def texts_of(self, track: Track) -> list[str] | None:
        """See `SensorTable`."""
        return list(self._numbers.get(track.path, {})) if track.dtype == TEXT else None

    def rows(self, track: Track) -> RowSource:
        """Return the rows of a dataset."""
        if track.dtype == TEXT:
            texts = TextDataset(self.file[track.path], track.path)
            return TextRows(texts, self._numbers.setdefault(track.path, {}))
        if track.written is not None:
            return WrittenRows(TextDataset(self.file[track.path], track.path), track.written)
        return TrackRows(self.file, track, self.path, self._pool, self._indexes)

    @contextmanager
    def guard(self, what: str) -> Iterator[None]:
        """Turn whatever h5py raises into an UnreadableError that names the part concerned."""
        try:
            yield
        except H5PY_ERRORS as error:
            raise UnreadableError(
                f"the {what} cannot be read ({brief(error)})",
                path=self.path,
                hint="the file is damaged: copy it again from its source",
            ) from error


DEEPEST = 64
"""Groups within groups that are entered; each costs as many steps again as it lies deep."""

MOST_NODES = 100_000
"""Most datasets and groups in a file."""


def as_track(path: str, dataset: Any) -> Track | None:
    """Return a dataset as a track of rows of 1 or 3 numbers; None if it cannot be read so."""
    if dataset.shape is None or MATLAB_EMPTY in dataset.attrs or MATLAB_OBJECT in dataset.attrs:
        return None
    return track_of_shape(path, dataset.shape, dataset.dtype)


def all_tracks(table: Hdf5Table) -> tuple[tuple[Track, ...], int, list[str]]:
    """Return every dataset of rows of 1 or 3 numbers, or of a text, by path, how many are damaged, and those
    that hold neither numbers nor texts."""
    found: list[Track] = []
    objects: list[str] = []
    damaged = 0
    for path, node in all_nodes(table):
        if node is None:
            damaged += 1
        elif isinstance(node, h5py.Dataset) and (track := _track(path, node)):
            found.append(track)
        elif isinstance(node, h5py.Dataset) and _holds_objects(node):
            objects.append(path)
    return tuple(sorted(found, key=lambda track: track.path)), damaged, sorted(objects)


def all_nodes(table: Hdf5Table) -> Iterator[tuple[str, Any]]:
    """Yield each group and dataset once, with its path; None for a damaged one."""
    seen: set[int] = set()
    groups = [""]
    while groups:
        parent = groups.pop()
        for name, node in members(table.file[parent or "/"]):
            if node is not None:
                if (address := hash(node.id)) in seen:
                    continue
                seen.add(address)
                if isinstance(node, h5py.Group) and parent.count("/") < DEEPEST:
                    groups.append(f"{parent}/{name}")
            if len(seen) > MOST_NODES:
                raise UnreadableError(
                    f"has more than {MOST_NODES} datasets and groups, as no recording does",
                    path=table.path,
                    hint="copy the recording to a file of its own, as with h5copy",
                )
            yield f"{parent}/{name}", node


def _holds_objects(dataset: Any) -> bool:
    """Return True for what refers to other datasets, as MATLAB's tables and cells do, and for rows with named
    fields."""
    try:
        special = dataset.dtype.kind in "OV" and h5py.check_string_dtype(dataset.dtype) is None
        return special or MATLAB_OBJECT in dataset.attrs
    except H5PY_ERRORS:
        return False


def _track(path: str, dataset: Any) -> Track | None:
    try:
        if dataset.ndim == 1 and h5py.check_string_dtype(dataset.dtype) is not None:
            return Track(path, len(dataset), 1, 0, TEXT)
        return as_track(path, dataset)
    except H5PY_ERRORS:
        return None


def open_recording(path: Path, options: ReadOptions) -> Hdf5Reader:
    """Open an HDF5 file whose acceleration is an (n, 3) dataset or three of length n.

    Raises:
        UnreadableError: damaged, cut short, or nothing in it is known as acceleration; or the rate, or the
            counts per g, are stated nowhere.
        UsageError: an option names no dataset.
    """
    with open_hdf5(path) as file:
        table = Hdf5Table(file, path)
        with table.guard("list of datasets"):
            tracks, damaged, table.objects = all_tracks(table)
            table.text_tracks = tuple(track for track in tracks if track.dtype == TEXT)
            tracks = tuple(track for track in tracks if track.dtype != TEXT)
        with table.explaining(damaged), table.guard("description of the recording"):
            return Hdf5Reader(plan_of(source_of(table, tracks, options, damaged), "hdf5"))


class Hdf5Reader(TableReader):
    """Streams the rows of a plan."""

    repack = "repack it with `h5repack -l CHUNK=65536x3` (`CHUNK=65536` for one axis)"

    def __init__(self, plan: ReadingPlan) -> None:
        super().__init__(plan)
        self._indexes: dict[str, ChunkIndex | None] = {}

    @contextmanager
    def table(self) -> Iterator[Hdf5Table]:
        """Open the file; chunks are unpacked ahead where several threads may work."""
        path = self.recording.path
        with open_hdf5(path) as file, thread_pool(self.threads, "hdf5") as pool:
            yield Hdf5Table(file, path, pool, self._indexes)
