"""An open HDF5 file as a table: its datasets of one or three numbers a row, and what is stated of them."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py

from accelcal_cli.formats._tables.attributes import Attributes
from accelcal_cli.formats._tables.table import Table
from accelcal_cli.formats._tables.tracks import Track, track_of_shape
from accelcal_cli.formats.hdf5.file import (
    H5PY_ERRORS,
    NodeAttributes,
    attributes_of,
    explaining,
    h5py_guard,
    members,
    missing_bytes,
)
from accelcal_cli.formats.hdf5.rows import TrackRows
from accelcal_cli.formats.hdf5.storage import Stored

MATLAB_EMPTY = "MATLAB_empty"


class Hdf5Table(Table):
    """An open HDF5 file.

    Args:
        pool: unpacks ahead where it can; None if one thread does all.
        stored: of datasets by path, what is known of how they are stored.
    """

    word = "dataset"

    def __init__(
        self,
        file: Any,
        path: Path,
        pool: Executor | None = None,
        stored: dict[str, Stored | None] | None = None,
    ) -> None:
        self.path, self._file, self._pool, self._stored = path, file, pool, stored

    def missing_bytes(self) -> int:
        """How many bytes at the end of a file that was cut short are not there."""
        return missing_bytes(self._file, self.path)

    def own(self, path: str) -> Attributes:
        """The attributes of a dataset alone."""
        return NodeAttributes([self._file[path]])

    def stated(self, path: str) -> Attributes:
        """The attributes of a dataset, then of the groups that hold it, up to the file."""
        return attributes_of(self._file, path)

    def rows(self, track: Track) -> TrackRows:
        """The rows of a dataset."""
        return TrackRows(self._file, track, self.path, self._pool, self._stored)

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
    """How a dataset can be read as rows of 1 or 3 numbers; None if it cannot."""
    if dataset.shape is None or MATLAB_EMPTY in dataset.attrs:  # whose numbers are the lengths of nothing
        return None
    return track_of_shape(path, dataset.shape, dataset.dtype)


def all_tracks(file: Any) -> tuple[tuple[Track, ...], int]:
    """Every dataset that can be read as rows of 1 or 3 numbers, by path; and how many are damaged."""
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
