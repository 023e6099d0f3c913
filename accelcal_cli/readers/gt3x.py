"""ActiGraph recordings (.gt3x): a zip file with info.txt and log.bin, or activity.bin in the older kind.

Sources: the vendor's format documents, github.com/actigraph/GT3X-File-Format and
github.com/actigraph/NHANES-GT3X-File-Format; docs/gt3x-files.md says what was decided where they leave
something open. Times are the device's clock: local time, or UTC where the file says so.
"""

from __future__ import annotations

from pathlib import Path

from accelcal_cli.core.formats import Format, Probe, ReadOptions
from accelcal_cli.core.recording import Reader
from accelcal_cli.readers._gt3x.signature import MAGIC, holds_samples, names_in

SUFFIXES = (".gt3x",)


def sniff(probe: Probe) -> int:
    """100 for a zip file that holds log.bin or activity.bin; 30 for a damaged one with the usual suffix."""
    if holds_samples(names_in(probe.head)):
        return 100
    by_name = 30 if probe.suffix in SUFFIXES else 0
    if probe.compressed or not (by_name or probe.head.startswith(MAGIC)):
        return by_name
    # Only what may be a zip file needs zipfile.
    from accelcal_cli.readers._gt3x.archive import by_directory

    try:
        with probe.path.open("rb") as file:
            listed, _ = by_directory(file)
    except OSError:
        return by_name
    return 100 if holds_samples(set(listed)) else by_name


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a recording. What reads is imported only now: every start of the command lists all formats.

    Raises:
        UnreadableError: it is not of this format, or holds no samples.
        UsageError: the rates contradict each other, or there is no such sensor.
    """
    from accelcal_cli.readers._gt3x import opening

    return opening.open_recording(path, options)


FORMAT = Format(
    "gt3x",
    "ActiGraph GT3X+, wGT3X-BT, GT9X and others (.gt3x)",
    SUFFIXES,
    sniff,
    open_recording,
    ignores=("unit", "columns", "time_column", "layout"),
)
