"""Text files of numbers: CSV with any delimiter, header, unit and kind of time (docs/csv-files.md)."""

from __future__ import annotations

from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.formats import HEAD_BYTES, Format, Probe, is_text
from accelcal_cli.formats._not_recordings import names_axes

if TYPE_CHECKING:
    from accelcal_cli.formats.csv.dialect import Dialect

SUFFIXES = (".csv", ".txt", ".tsv", ".log")
VENDORS_SCORE = 90
"""Certainty that an export of a known vendor is one."""

WITHOUT_NUMBERS = 10
"""Certainty that text with columns of x, y and z but without numbers is a table of acceleration."""

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
    """Return 40 to 60 for text with three or more columns of numbers, more for a known vendor's export.

    Text with columns named like axes, but without numbers, scores 10: it is refused when it is opened.
    """
    if probe.head.startswith(OTHER_TEXT) or not is_text(probe.head):
        return 0
    # Only text is worth the import of what understands it.
    from accelcal_cli.formats.csv.vendors import export_description

    if export_description(probe.head) is not None:
        return VENDORS_SCORE
    dialect = _dialect(probe)
    if dialect is None:
        return WITHOUT_NUMBERS if probe.suffix in SUFFIXES and names_axes(probe.head) else 0
    return 40 + 10 * (probe.suffix in SUFFIXES) + 10 * (dialect.names is not None)


def belongs_to(path: Path) -> Path | None:
    """Return the table of accelerations of an export that a file belongs to; None for other files."""
    from accelcal_cli.formats.csv.exports import belongs_to as found

    return found(path)


def refuse_others(probe: Probe) -> None:
    """Raise NoRecordingError for a table of counts or of other quantities, by its head and its names."""
    from accelcal_cli.formats.csv.columns import find_roles
    from accelcal_cli.formats.csv.vendors import export_description, refuse_doubtful

    export, options = export_description(probe.head, probe.path.name), probe.options
    if export is not None:
        refuse_doubtful(export, options, probe.path)
    elif options.columns is None and bids_channels_path(probe.path) is None:
        dialect = _dialect(probe)
        if dialect is not None and dialect.names is not None:
            with suppress(UsageError):
                find_roles(dialect, options, probe.path)


def _dialect(probe: Probe) -> Dialect | None:
    """Return the layout of a table, whose numbers may begin late."""
    dialect = _dialect_of(probe.head)
    return (
        _deep_dialect(probe.path, probe.size)
        if dialect is None and len(probe.head) == HEAD_BYTES
        else dialect
    )


@lru_cache(maxsize=2)
def _dialect_of(head: bytes) -> Dialect | None:
    """Return the layout of a beginning; it is asked for several times."""
    from accelcal_cli.formats.csv.dialect import find_dialect

    return find_dialect(head)


@lru_cache(maxsize=8)
def _deep_dialect(path: Path, _size: int) -> Dialect | None:
    """Return the layout of a table whose numbers begin late; a file is asked about several times."""
    from accelcal_cli.formats.csv.dialect import DEEPEST_BYTES, find_deep_dialect
    from accelcal_cli.formats.csv.lines import LineFile

    try:
        with LineFile(path) as file:
            return find_deep_dialect(file.read(DEEPEST_BYTES))
    except UnreadableError:
        return None


FORMAT = Format(
    "csv",
    "text file (CSV) with a column each for x, y and z",
    SUFFIXES,
    sniff,
    reader="accelcal_cli.formats.csv.reader:open_recording",
    ignores=("layout",),
    belongs_to=belongs_to,
    refuse_others=refuse_others,
)
