"""APDM Opal recordings: HDF5 files of the vendor's own layout (`readers/_hdf5/opal.py` describes it)."""

from __future__ import annotations

from pathlib import Path

from accelcal_cli.core.formats import Format, Probe, ReadOptions
from accelcal_cli.core.recording import Reader
from accelcal_cli.readers._hdf5.signature import has_signature


def sniff(probe: Probe) -> int:
    """100 for an HDF5 file with an Opal version and sensors."""
    if probe.compressed or not has_signature(probe.head):
        return 0
    from accelcal_cli.readers._hdf5 import opal

    return 100 if opal.is_opal(probe.path) else 0


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """See `readers/_hdf5/opal.py`, which imports h5py: only what is HDF5 needs it."""
    from accelcal_cli.readers._hdf5 import opal

    return opal.open_recording(path, options)


FORMAT = Format(
    name="opal",
    title="APDM Opal (HDF5)",
    suffixes=(".h5",),
    sniff=sniff,
    open=open_recording,
    ignores=("layout", "columns", "time_column", "date_format"),
)
