"""Tables of named columns: text, Parquet, Feather, HDF5, NumPy and MATLAB files, and how each is recognised.

All are read by one chain (`header.py` says how it hangs together). They are recognised without importing
numpy, pyarrow or h5py, since every start of the command imports this.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.formats import (
    HEAD_BYTES,
    ONLY_TABLES,
    TIMES_OF_TABLES,
    ZIP_MAGIC,
    Format,
    Probe,
    is_text,
)
from accelcal_cli.formats._not_recordings import names_axes
from accelcal_cli.formats.tables.signatures import (
    CONTINUATION,
    ENCRYPTED_MAGIC,
    FEATHER_MAGIC,
    LARGEST_SCHEMA,
    MAT_BIG,
    MAT_LITTLE,
    MAT_VERSION,
    NAME,
    NAME_LENGTH,
    NPY_SUFFIX,
    OLD_FEATHER_MAGIC,
    PARQUET_MAGIC,
    bids_channels_path,
    has_hdf5_signature,
)

__all__ = ["FORMAT", "bids_channels_path"]

if TYPE_CHECKING:
    from accelcal_cli.formats.tables.text.dialect import Dialect

TEXT_SUFFIXES = (".csv", ".txt", ".tsv", ".log")
VENDORS_SCORE = 90
"""Certainty that an export of a known vendor is one."""

WITHOUT_NUMBERS = 10
"""Certainty that text with columns of x, y and z but without numbers is a table of acceleration."""

OTHER_TEXT = (b"Device Identity", b"<?xml", b"\xef\xbb\xbf<?xml", b"<unisens")
"""Beginnings of text files of other formats."""


def sniff_text(probe: Probe) -> int:
    """Return 40 to 60 for text with three or more columns of numbers, more for a known vendor's export.

    Text with columns named like axes, but without numbers, scores 10: it is refused when it is opened.
    """
    if probe.head.startswith(OTHER_TEXT) or not is_text(probe.head):
        return 0
    # Only text is worth the import of what understands it.
    from accelcal_cli.formats.tables.vendors import Head, export_description, names_description

    if export_description(probe.head) is not None:
        return VENDORS_SCORE
    dialect = _dialect(probe)
    if dialect is None:
        return WITHOUT_NUMBERS if probe.suffix in TEXT_SUFFIXES and names_axes(probe.head) else 0
    if dialect.names is not None and names_description(Head(dialect.names, dialect.cells)) is not None:
        return VENDORS_SCORE
    return 40 + 10 * (probe.suffix in TEXT_SUFFIXES) + 10 * (dialect.names is not None)


def belongs_to(path: Path) -> Path | None:
    """Return the table of accelerations of an export that a file belongs to; None for other files."""
    from accelcal_cli.formats.tables.siblings import belongs_to as found

    return found(path)


def refuse_other_texts(probe: Probe) -> None:
    """Raise NoRecordingError for a table of counts or of other quantities, by its head and its names."""
    from accelcal_cli.formats.tables.header import refuse_doubtful
    from accelcal_cli.formats.tables.text.source import refuse_other_names
    from accelcal_cli.formats.tables.vendors import export_description

    stated, options = export_description(probe.head), probe.options
    if stated is not None:
        refuse_doubtful(stated, options, probe.path)
    elif options.columns is None and bids_channels_path(probe.path) is None:
        dialect = _dialect(probe)
        if dialect is not None and dialect.names is not None:
            with suppress(UsageError):
                refuse_other_names(dialect, options, probe.path)


def _dialect(probe: Probe) -> Dialect | None:
    """Return the layout of a table, whose numbers may begin late."""
    dialect = _dialect_of(probe.head)
    deep = dialect is None and len(probe.head) == HEAD_BYTES
    return _deep_dialect(probe.path, probe.size) if deep else dialect


@lru_cache(maxsize=2)
def _dialect_of(head: bytes) -> Dialect | None:
    """Return the layout of a beginning; it is asked for several times."""
    from accelcal_cli.formats.tables.text.dialect import find_dialect

    return find_dialect(head)


@lru_cache(maxsize=8)
def _deep_dialect(path: Path, _size: int) -> Dialect | None:
    """Return the layout of a table whose numbers begin late; a file is asked about several times."""
    from accelcal_cli.formats.tables.text.dialect import DEEPEST_BYTES, find_deep_dialect
    from accelcal_cli.formats.tables.text.lines import LineFile

    try:
        with LineFile(path) as file:
            return find_deep_dialect(file.read(DEEPEST_BYTES))
    except UnreadableError:
        return None


def sniff_parquet(probe: Probe) -> int:
    """Return 100 for the magic number of Parquet."""
    return 100 if probe.head.startswith((PARQUET_MAGIC, ENCRYPTED_MAGIC)) else 0


def sniff_feather(probe: Probe) -> int:
    """Return 100 for the magic number of a file; 70 for the beginning of a stream, a schema."""
    head = probe.head
    if head.startswith((FEATHER_MAGIC, OLD_FEATHER_MAGIC)):
        return 100
    length, table = (int.from_bytes(head[place : place + 4], "little") for place in (4, 8))
    stream = head.startswith(CONTINUATION) and length % 8 == 0 and 16 <= length <= LARGEST_SCHEMA
    return 70 if stream and 4 <= table < length else 0


def sniff_hdf5(probe: Probe) -> int:
    """Return 90 for the signature; a more special format of HDF5 files may claim more."""
    return 90 if has_hdf5_signature(probe.head) else 0


def sniff_opal(probe: Probe) -> int:
    """Return 100 for an HDF5 file with an Opal version and sensors."""
    if probe.compressed or not has_hdf5_signature(probe.head):
        return 0
    from accelcal_cli.formats.tables.opal import is_opal

    return 100 if is_opal(probe.path) else 0


def sniff_npz(probe: Probe) -> int:
    """Return 100 for a zip file whose first member is an array."""
    if not probe.head.startswith(ZIP_MAGIC):
        return 0
    length = int.from_bytes(probe.head[NAME_LENGTH], "little")
    return 100 if probe.head[NAME : NAME + length].endswith(NPY_SUFFIX) else 0


def sniff_mat(probe: Probe) -> int:
    """Return 90 for the version and the order of bytes of level 5; 100 if the text says so, too."""
    if probe.head[MAT_VERSION] not in (MAT_LITTLE, MAT_BIG):
        return 0
    return 100 if probe.head.startswith(b"MATLAB 5.0 MAT-file") else 90


def _table(
    name: str, title: str, suffixes: tuple[str, ...], sniff: Callable[[Probe], int], opens: str
) -> Format:
    """Return a format of files that hold nothing but tables."""
    reader = f"{__name__}.{opens}"
    return Format(name, title, suffixes, sniff, reader=reader, ignores=("layout",), is_table=True)


CSV = Format(
    "csv",
    "text file (CSV) with a column each for x, y and z",
    TEXT_SUFFIXES,
    sniff_text,
    reader="accelcal_cli.formats.tables.text.source:open_recording",
    ignores=("layout",),
    belongs_to=belongs_to,
    refuse_others=refuse_other_texts,
)
PARQUET = _table(
    "parquet",
    "Parquet file with a column each for x, y and z",
    (".parquet", ".pq"),
    sniff_parquet,
    "arrow:open_parquet",
)
FEATHER = _table(
    "feather",
    "Feather file, or Arrow IPC file or stream, with a column each for x, y and z",
    (".feather", ".arrow", ".arrows", ".ipc"),
    sniff_feather,
    "arrow:open_feather",
)
HDF5 = Format(
    "hdf5",
    "HDF5 file with an acceleration dataset",
    (".h5", ".hdf5", ".hdf"),
    sniff_hdf5,
    reader="accelcal_cli.formats.tables.hdf5:open_recording",
    ignores=("layout",),
)
OPAL = Format(
    "opal",
    "APDM Opal (HDF5)",
    (".h5",),
    sniff_opal,
    reader="accelcal_cli.formats.tables.opal:open_recording",
    ignores=("layout", "columns", *TIMES_OF_TABLES, *ONLY_TABLES),
)
NPZ = _table(
    "npz", "NumPy archive (.npz) with an array of acceleration", (".npz",), sniff_npz, "npz:open_recording"
)
MAT = _table(
    "mat", "MATLAB file (.mat) with an array of acceleration", (".mat",), sniff_mat, "mat:open_recording"
)
FORMAT = (CSV, PARQUET, FEATHER, HDF5, OPAL, NPZ, MAT)
