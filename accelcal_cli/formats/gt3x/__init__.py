"""ActiGraph recordings (.gt3x, .agdc), zip files with info.txt and log.bin or activity.bin: what they are.

Sources: the vendor's format documents, github.com/actigraph/GT3X-File-Format and
github.com/actigraph/NHANES-GT3X-File-Format; docs/gt3x-files.md says what was decided where they leave
something open. .agdc, of CentrePoint devices, is the same with calibration.json and the like beside it (the
vendor's reader, github.com/actigraph/pygt3x). Times are the device's clock: local time, or UTC where the file
says so.
"""

from __future__ import annotations

import re

from accelcal_cli.core.formats import GYRO_OPTIONS, Format, Probe

INFO, LOG, ACTIVITY = "info.txt", "log.bin", "activity.bin"
CALIBRATION, TEMPERATURE_CALIBRATION = "calibration.json", "temperature_calibration.json"
MAGIC = b"PK\x03\x04"
NAMED = re.compile(
    rb"PK\x03\x04.{22}(..)..(info\.txt|log\.bin|activity\.bin|(?:temperature_)?calibration\.json)", re.DOTALL
)
"""A local header of one of the parts; the groups are the length of its name, and the name."""

SUFFIXES = (".gt3x", ".agdc")


def holds_samples(names: set[str]) -> bool:
    """Whether one of the parts of either kind is among them."""
    return not names.isdisjoint((LOG, ACTIVITY))


def sniff(probe: Probe) -> int:
    """100 for a zip file that holds log.bin or activity.bin; 30 for a damaged one with the usual suffix."""
    if holds_samples({found[2].decode() for found in NAMED.finditer(probe.head)}):
        return 100
    by_name = 30 if probe.suffix in SUFFIXES else 0
    if probe.compressed or not (by_name or probe.head.startswith(MAGIC)):
        return by_name
    # Only what may be a zip file needs zipfile.
    from accelcal_cli.formats.gt3x.archive import by_directory

    try:
        with probe.path.open("rb") as file:
            listed, *_ = by_directory(file)
    except OSError:
        return by_name
    return 100 if holds_samples(set(listed)) else by_name


FORMAT = Format(
    "gt3x",
    "ActiGraph GT3X+, wGT3X-BT, GT9X, LEAP and others (.gt3x, .agdc)",
    SUFFIXES,
    sniff,
    reader="accelcal_cli.formats.gt3x.reader:open_recording",
    ignores=("unit", "columns", "time_column", "layout", *GYRO_OPTIONS),
)
