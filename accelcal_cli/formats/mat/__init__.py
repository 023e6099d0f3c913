"""MATLAB files of versions 5 to 7. Files of version 7.3 are HDF5 files, which `formats/hdf5` reads.

Source: MathWorks, "MAT-File Format" (MAT-File Level 5: 116 bytes of text; a version and the letters IM or MI,
by the order of bytes, at byte 124).
"""

from __future__ import annotations

from accelcal_cli.core.formats import Format, Probe

HEAD_BYTES = 128
VERSION = slice(124, 128)
LITTLE, BIG = b"\x00\x01IM", b"\x01\x00MI"


def sniff(probe: Probe) -> int:
    """Return 90 for the version and the order of bytes of level 5; 100 if the text says so, too."""
    if probe.head[VERSION] not in (LITTLE, BIG):
        return 0
    return 100 if probe.head.startswith(b"MATLAB 5.0 MAT-file") else 90


FORMAT = Format(
    name="mat",
    title="MATLAB file (.mat) with an array of acceleration",
    suffixes=(".mat",),
    sniff=sniff,
    reader="accelcal_cli.formats.mat.reader:open_recording",
    ignores=("layout", "date_format"),
    is_table=True,
)
