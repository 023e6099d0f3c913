"""Reads HDF5 files of laboratories as tables; docs/hdf5-files.md lists what is understood."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.parallel import thread_pool
from accelcal_cli.formats._tables.reader import ReadingPlan, TableReader, plan_of, source_of
from accelcal_cli.formats._tables.table import Attributes, SensorTable, Track, track_of_shape
from accelcal_cli.formats.hdf5.file import (
    H5PY_ERRORS,
    NodeAttributes,
    attributes_of,
    explaining,
    h5py_guard,
    members,
    missing_bytes,
    open_hdf5,
)
from accelcal_cli.formats.hdf5.rows import ChunkIndex, TrackRows

MATLAB_EMPTY = "MATLAB_empty"
"""Attribute of an empty array of MATLAB, whose numbers are the lengths of its axes."""


class Hdf5Table(SensorTable):
    """An open HDF5 file.

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
        self.path, self._file, self._pool, self._indexes = path, file, pool, indexes

    def missing_bytes(self) -> int:
        """Return the number of bytes that a file that was cut short lacks at its end."""
        return missing_bytes(self._file, self.path)

    def own(self, path: str) -> Attributes:
        """Return the attributes of a dataset alone."""
        return NodeAttributes([self._file[path]])

    def stated(self, path: str) -> Attributes:
        """Return the attributes of a dataset, then of the groups that hold it, up to the file."""
        return attributes_of(self._file, path)

    def rows(self, track: Track) -> TrackRows:
        """Return the rows of a dataset."""
        return TrackRows(self._file, track, self.path, self._pool, self._indexes)

    @contextmanager
    def guard(self, what: str) -> Iterator[None]:
        """Turn whatever h5py raises into an UnreadableError that names the part concerned."""
        with h5py_guard(self.path, what):
            yield

    @contextmanager
    def explaining(self, damaged: int = 0) -> Iterator[None]:
        """Add to any error of ours that the file is cut short or damaged, if it is."""
        with explaining(self.path, self.missing_bytes(), damaged):
            yield


def as_track(path: str, dataset: Any) -> Track | None:
    """Return a dataset as a track of rows of 1 or 3 numbers; None if it cannot be read so."""
    if dataset.shape is None or MATLAB_EMPTY in dataset.attrs:
        return None
    return track_of_shape(path, dataset.shape, dataset.dtype)


def all_tracks(file: Any) -> tuple[tuple[Track, ...], int]:
    """Return every dataset that can be read as rows of 1 or 3 numbers, by path, and how many are damaged."""
    found: list[Track] = []
    damaged = 0
    seen: set[int] = set()
    groups = [("", file["/"])]
    while groups:
        parent, group = groups.pop()
        nodes, lost = members(group)
        damaged += lost
        for name, node in nodes:
            address = hash(node.id)
            if address in seen:
                continue
            seen.add(address)
            if isinstance(node, h5py.Group):
                groups.append((f"{parent}/{name}", node))
            elif isinstance(node, h5py.Dataset) and (track := _track(f"{parent}/{name}", node)):
                found.append(track)
    return tuple(sorted(found, key=lambda track: track.path)), damaged


def _track(path: str, dataset: Any) -> Track | None:
    try:
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
    with open_hdf5(path) as file, h5py_guard(path, "list of datasets"):
        tracks, damaged = all_tracks(file)
        table = Hdf5Table(file, path)
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
