"""Text files of numbers: CSV with any delimiter, header, unit and kind of time."""

from __future__ import annotations

from pathlib import Path

from accelcal_cli.core.formats import Format, Probe, ReadOptions
from accelcal_cli.core.recording import Reader
from accelcal_cli.readers._csv.text import is_text

SUFFIXES = (".csv", ".txt", ".tsv", ".log")
VENDORS_SCORE = 90
OTHER_TEXT = (b"Device Identity",)


def sniff(probe: Probe) -> int:
    """30 to 60 for text with three or more columns of numbers; more where name and header fit."""
    if probe.head.startswith(OTHER_TEXT) or not is_text(probe.head):
        return 0
    # Only text is worth the import of what understands it.
    from accelcal_cli.readers._csv.dialect import find_dialect
    from accelcal_cli.readers._csv.vendor import known_of

    if known_of(probe.head) is not None:
        return VENDORS_SCORE
    dialect = find_dialect(probe.head)
    if dialect is None:
        return 0
    return 40 + 10 * (probe.suffix in SUFFIXES) + 10 * (dialect.names is not None)


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a text file. What reads is imported only now: every start of the command lists all formats.

    Raises:
        UnreadableError: it holds no rows of numbers, or they can be read in several ways; the
            hint says which option settles it.
        UsageError: an option names no column, or counts come without their scale.
    """
    from accelcal_cli.readers._csv import opening

    return opening.open_recording(path, options)


FORMAT = Format(
    "csv",
    "text file (CSV) with a column each for x, y and z",
    SUFFIXES,
    sniff,
    open_recording,
    ignores=("layout", "sensor"),
)
