"""Raw dumps of flash memory without a description of their own, read through a layout file."""

from __future__ import annotations

from pathlib import Path

from accelcal_cli.core.formats import Format, Probe, ReadOptions
from accelcal_cli.core.recording import Reader
from accelcal_cli.readers._layout.find import DUMP_SUFFIXES, folder_layout, is_file, named_layout


def sniff(probe: Probe) -> int:
    """A dump is known by its layout alone: 100 named by the user, 95 its own, 40 its folder's.

    Below 100 without the user's word, so that a dump with a signature goes to that format. A
    `.raw` file for which rate and counts per g are given, but no layout, scores 30.
    """
    options = probe.options
    if options.layout is not None:
        return 100
    if probe.suffix not in DUMP_SUFFIXES:
        return 0
    if is_file(named_layout(probe.path)):
        return 95
    if is_file(folder_layout(probe.path)):
        return 40
    described = options.rate_hz is not None and options.lsb_per_g is not None
    return 30 if described and probe.suffix == ".raw" else 0


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a dump. What reads is imported only now: every start of the command lists all formats.

    Raises:
        UsageError: a faulty layout.
        UnreadableError: no layout (and not both rate and counts per g), or no page or frame is usable.
    """
    from accelcal_cli.readers._raw import opening

    return opening.open_recording(path, options)


FORMAT = Format(
    "raw",
    "raw dump with a layout file (docs/layout-files.md)",
    DUMP_SUFFIXES,
    sniff,
    open_recording,
    ignores=("unit", "columns", "time_column", "date_format", "sensor"),
)
