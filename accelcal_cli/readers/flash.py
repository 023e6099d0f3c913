"""The flash page format: our own dump of a wrist logger's memory, specified in docs/flash-format.md."""

from __future__ import annotations

from pathlib import Path

from accelcal_cli.core.formats import Format, Probe, ReadOptions
from accelcal_cli.core.recording import Reader
from accelcal_cli.readers._flash.signature import HEADER_MAGIC, PAGE_BYTES, PAGE_MAGIC


def sniff(probe: Probe) -> int:
    """100 by the header's signature; 90 by a valid data page where the header is damaged."""
    if probe.head.startswith(HEADER_MAGIC):
        return 100
    places = range(PAGE_BYTES, len(probe.head), PAGE_BYTES)
    if not any(probe.head.startswith(PAGE_MAGIC, at) for at in places):
        return 0
    # Few files get as far as to need the checksum of a page.
    from accelcal_cli.readers._flash.pages import recording_id_in

    return 90 if recording_id_in(probe.head[PAGE_BYTES:]) is not None else 0


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a dump. What reads is imported only now: every start of the command lists all formats.

    Raises:
        UnreadableError: the header is damaged and rate or counts per g are not given, or no data
            page is valid.
        UsageError: the rates contradict each other.
    """
    from accelcal_cli.readers._flash import opening

    return opening.open_recording(path, options)


FORMAT = Format(
    "flash",
    "flash pages of a wrist logger (docs/flash-format.md)",
    (".bin",),
    sniff,
    open_recording,
    ignores=("unit", "columns", "time_column", "date_format", "layout", "sensor"),
)
