"""HDF5 files of laboratories: datasets found by name, described by attributes (docs/hdf5-files.md)."""

from __future__ import annotations

from pathlib import Path

from accelcal_cli.core.formats import Format, Probe, ReadOptions
from accelcal_cli.core.recording import Reader
from accelcal_cli.readers._hdf5.signature import has_signature


def sniff(probe: Probe) -> int:
    """90 for the signature; a more special format of HDF5 files may claim more."""
    return 90 if has_signature(probe.head) else 0


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """See `readers/_hdf5/opening.py`, which imports h5py: only what is HDF5 needs it."""
    from accelcal_cli.readers._hdf5 import opening

    return opening.open_recording(path, options)


FORMAT = Format(
    name="hdf5",
    title="HDF5 file with an acceleration dataset",
    suffixes=(".h5", ".hdf5", ".hdf"),
    sniff=sniff,
    open=open_recording,
    ignores=("layout", "date_format"),
)
