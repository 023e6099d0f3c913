"""Tables of Apache Arrow: Parquet files, and Arrow IPC files and streams, which are also called Feather.

They are recognised without importing pyarrow.

Sources: the Apache Parquet format ("File format": `PAR1`, or `PARE` with an encrypted footer, at either end);
the Arrow columnar format ("IPC file format": `ARROW1` and two zero bytes; "Encapsulated message format": a
continuation of four 0xFF, then the length of the metadata in multiples of eight).
"""

from __future__ import annotations

from accelcal_cli.core.formats import Format, Probe

PARQUET_MAGIC, ENCRYPTED_MAGIC = b"PAR1", b"PARE"
FEATHER_MAGIC, OLD_FEATHER_MAGIC = b"ARROW1\0\0", b"FEA1"
CONTINUATION = b"\xff\xff\xff\xff"
LARGEST_SCHEMA = 1 << 24


def sniff_parquet(probe: Probe) -> int:
    """Return 100 for the magic number of Parquet."""
    return 100 if probe.head.startswith((PARQUET_MAGIC, ENCRYPTED_MAGIC)) else 0


def sniff_feather(probe: Probe) -> int:
    """Return 100 for the magic number of a file; 70 for the beginning of a stream, a schema."""
    head = probe.head
    if head.startswith((FEATHER_MAGIC, OLD_FEATHER_MAGIC)):
        return 100
    length = int.from_bytes(head[4:8], "little")
    table = int.from_bytes(head[8:12], "little")
    stream = head.startswith(CONTINUATION) and length % 8 == 0 and 16 <= length <= LARGEST_SCHEMA
    return 70 if stream and 4 <= table < length else 0


PARQUET = Format(
    name="parquet",
    title="Parquet file with a column each for x, y and z",
    suffixes=(".parquet", ".pq"),
    sniff=sniff_parquet,
    reader="accelcal_cli.formats.arrow.parquet:open_recording",
    ignores=("layout", "date_format"),
    is_table=True,
)
FEATHER = Format(
    name="feather",
    title="Feather file, or Arrow IPC file or stream, with a column each for x, y and z",
    suffixes=(".feather", ".arrow", ".arrows", ".ipc"),
    sniff=sniff_feather,
    reader="accelcal_cli.formats.arrow.ipc:open_recording",
    ignores=("layout", "date_format"),
    is_table=True,
)

FORMAT = (PARQUET, FEATHER)
