"""Text files of numbers: CSV with any delimiter, header, unit and kind of time (docs/csv-files.md)."""

from __future__ import annotations

from pathlib import Path

from accelcal_cli.core.formats import Format, Probe, is_text

SUFFIXES = (".csv", ".txt", ".tsv", ".log")
VENDORS_SCORE = 90
"""Certainty that an export of a known vendor is one."""

OTHER_TEXT = (b"Device Identity", b"<?xml", b"\xef\xbb\xbf<?xml", b"<unisens")
"""Beginnings of text files of other formats."""

BIDS_MOTION, BIDS_CHANNELS = "_motion.tsv", "_channels.tsv"
"""Ends of the names of a recording of Motion-BIDS and of the table of its columns."""


def bids_channels_path(path: Path) -> Path | None:
    """Return the path of the table that describes a file of Motion-BIDS; None for other files."""
    name = path.name[:-3] if path.name.lower().endswith(".gz") else path.name
    return (
        path.with_name(name.removesuffix(BIDS_MOTION) + BIDS_CHANNELS) if name.endswith(BIDS_MOTION) else None
    )


def sniff(probe: Probe) -> int:
    """Return 40 to 60 for text with three or more columns of numbers, more for a known vendor's export."""
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


def belongs_to(path: Path) -> Path | None:
    """Return the table of accelerations of an export that a file belongs to; None for other files."""
    from accelcal_cli.formats.csv.exports import belongs_to as found

    return found(path)


FORMAT = Format(
    "csv",
    "text file (CSV) with a column each for x, y and z",
    SUFFIXES,
    sniff,
    reader="accelcal_cli.formats.csv.reader:open_recording",
    ignores=("layout",),
    belongs_to=belongs_to,
)
