"""HDF5 files of laboratories as tables; docs/hdf5-files.md lists what is understood."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.parallel import thread_pool
from accelcal_cli.formats._tables.description import Plan
from accelcal_cli.formats._tables.plan import plan_of, source_of
from accelcal_cli.formats._tables.reader import TableReader
from accelcal_cli.formats.hdf5 import file as h5
from accelcal_cli.formats.hdf5.datasets import Hdf5Table, all_tracks
from accelcal_cli.formats.hdf5.storage import Stored


def open_recording(path: Path, options: ReadOptions) -> Hdf5Reader:
    """Open an HDF5 file whose acceleration is an (n, 3) dataset or three of length n.

    Raises:
        UnreadableError: damaged, cut short, or nothing in it is known as acceleration; or the rate, or the
            counts per g, are stated nowhere.
        UsageError: an option names no dataset.
    """
    with h5.open_hdf5(path) as file, h5.h5py_guard(path, "list of datasets"):
        tracks, damaged = all_tracks(file)
        table = Hdf5Table(file, path)
        with table.explaining(damaged), table.guard("description of the recording"):
            return Hdf5Reader(plan_of(source_of(table, tracks, options, damaged), "hdf5"))


class Hdf5Reader(TableReader):
    """Streams the rows of a plan."""

    repack = "repack it with `h5repack -l CHUNK=65536x3` (`CHUNK=65536` for one axis)"

    def __init__(self, plan: Plan) -> None:
        super().__init__(plan)
        self._stored: dict[str, Stored | None] = {}

    @contextmanager
    def table(self) -> Iterator[Hdf5Table]:
        """The file; chunks are unpacked ahead where several threads may work."""
        path = self.recording.path
        with h5.open_hdf5(path) as file, thread_pool(self.threads, "hdf5") as pool:
            yield Hdf5Table(file, path, pool, self._stored)
