"""How the files of tables begin, or what they are called.

Sources: the Apache Parquet format ("File format": `PAR1`, or `PARE` with an encrypted footer, at either end);
the Arrow columnar format ("IPC file format": `ARROW1` and two zero bytes; "Encapsulated message format": a
continuation of four 0xFF, then the length of the metadata in multiples of eight); HDF5 File Format, II.A;
NumPy's documentation, "numpy.lib.format" (a zip file whose members, NAME.npy, are an array each); MathWorks,
"MAT-File Format" (MAT-File Level 5: a version and the letters IM or MI, by the order of bytes, at byte 124).
"""

from __future__ import annotations

from pathlib import Path

from accelcal_cli.core.unpacking import plain_name

BIDS_MOTION, BIDS_CHANNELS = "_motion.tsv", "_channels.tsv"
"""Ends of the names of a recording of Motion-BIDS and of the table of its columns."""

PARQUET_MAGIC, ENCRYPTED_MAGIC = b"PAR1", b"PARE"
FEATHER_MAGIC, OLD_FEATHER_MAGIC = b"ARROW1\0\0", b"FEA1"
CONTINUATION = b"\xff\xff\xff\xff"
LARGEST_SCHEMA = 1 << 24
HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
FIRST_USER_BLOCK = 512
NPY_SUFFIX = b".npy"
NAME_LENGTH, NAME = slice(26, 28), 30
"""Places of the length of the first member's name in a zip file, and of the name."""

MAT_HEAD_BYTES, MAT_VERSION = 128, slice(124, 128)
MAT_LITTLE, MAT_BIG = b"\x00\x01IM", b"\x01\x00MI"


def bids_channels_path(path: Path) -> Path | None:
    """Return the path of the table that describes a file of Motion-BIDS; None for other files."""
    name = plain_name(path.name)
    return (
        path.with_name(name.removesuffix(BIDS_MOTION) + BIDS_CHANNELS) if name.endswith(BIDS_MOTION) else None
    )


def has_hdf5_signature(head: bytes) -> bool:
    """Return True if HDF5's signature stands at byte 0, 512, 1024, 2048, ..."""
    offset = 0
    while offset < len(head):
        if head.startswith(HDF5_SIGNATURE, offset):
            return True
        offset = offset * 2 or FIRST_USER_BLOCK
    return False
