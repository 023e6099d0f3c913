"""Text files of numbers: CSV with any delimiter, header, unit and kind of time (docs/csv-files.md)."""

from __future__ import annotations

from pathlib import Path

from accelcal_cli.core.formats import Format, Probe

SUFFIXES = (".csv", ".txt", ".tsv", ".log")
VENDORS_SCORE = 90
OTHER_TEXT = (b"Device Identity", b"<?xml", b"\xef\xbb\xbf<?xml", b"<unisens")
MOTION, CHANNELS = "_motion.tsv", "_channels.tsv"


def is_text(head: bytes) -> bool:
    """Whether all bytes are such as text has."""
    return not head.translate(None, b"\t\n\r\f\x1b" + bytes(range(32, 127)) + bytes(range(128, 256)))


def channels_beside(path: Path) -> Path | None:
    """Where the table lies that describes the columns of a file of Motion-BIDS; None for other files."""
    name = path.name[:-3] if path.name.lower().endswith(".gz") else path.name
    return path.with_name(name.removesuffix(MOTION) + CHANNELS) if name.endswith(MOTION) else None


def sniff(probe: Probe) -> int:
    """30 to 60 for text with three or more columns of numbers; more where name and header fit."""
    if probe.head.startswith(OTHER_TEXT) or not is_text(probe.head):
        return 0
    # Only text is worth the import of what understands it.
    from accelcal_cli.formats.csv.dialect import find_dialect
    from accelcal_cli.formats.csv.vendors import export_description

    if export_description(probe.head) is not None:
        return VENDORS_SCORE
    dialect = find_dialect(probe.head)
    if dialect is None:
        return 0
    return 40 + 10 * (probe.suffix in SUFFIXES) + 10 * (dialect.names is not None)


FORMAT = Format(
    "csv",
    "text file (CSV) with a column each for x, y and z",
    SUFFIXES,
    sniff,
    reader="accelcal_cli.formats.csv.reader:open_recording",
    ignores=("layout", "sensor"),
)
