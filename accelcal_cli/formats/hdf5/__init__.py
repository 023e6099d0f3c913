"""HDF5 files of laboratories (docs/tables.md) and of APDM Opal sensors (`opal.py` has their layout).

They are recognised without importing h5py, so other formats need not wait for it.
"""

from __future__ import annotations

from accelcal_cli.core.formats import ONLY_TABLES, TIMES_OF_TABLES, Format, Probe

SIGNATURE = b"\x89HDF\r\n\x1a\n"
FIRST_USER_BLOCK = 512


def has_signature(head: bytes) -> bool:
    """Return True if HDF5's signature stands at byte 0, 512, 1024, 2048, ... (HDF5 File Format, II.A)."""
    offset = 0
    while offset < len(head):
        if head.startswith(SIGNATURE, offset):
            return True
        offset = offset * 2 or FIRST_USER_BLOCK
    return False


def sniff_opal(probe: Probe) -> int:
    """Return 100 for an HDF5 file with an Opal version and sensors."""
    if probe.compressed or not has_signature(probe.head):
        return 0
    from accelcal_cli.formats.hdf5 import opal

    return 100 if opal.is_opal(probe.path) else 0


OPAL = Format(
    name="opal",
    title="APDM Opal (HDF5)",
    suffixes=(".h5",),
    sniff=sniff_opal,
    reader="accelcal_cli.formats.hdf5.opal:open_recording",
    ignores=("layout", "columns", *TIMES_OF_TABLES, *ONLY_TABLES),
)


def sniff(probe: Probe) -> int:
    """Return 90 for the signature; a more special format of HDF5 files may claim more."""
    return 90 if has_signature(probe.head) else 0


HDF5 = Format(
    name="hdf5",
    title="HDF5 file with an acceleration dataset",
    suffixes=(".h5", ".hdf5", ".hdf"),
    sniff=sniff,
    reader="accelcal_cli.formats.hdf5.reader:open_recording",
    ignores=("layout", "date_format"),
)


FORMAT = (HDF5, OPAL)
