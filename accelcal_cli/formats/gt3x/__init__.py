"""How ActiGraph recordings (.gt3x, .agdc) are recognised: zip files with log.bin or activity.bin.

Sources: the vendor's format documents, github.com/actigraph/GT3X-File-Format and
github.com/actigraph/NHANES-GT3X-File-Format; docs/gt3x-files.md says what was decided if they leave
something open. An .agdc, of CentrePoint devices, is the same with calibration.json and the like next to it
(the vendor's reader, github.com/actigraph/pygt3x). Times are the device's clock: local time, or UTC if the
file says so.
"""

from __future__ import annotations

from pathlib import Path

from accelcal_cli.core.formats import ONLY_TABLES, ZIP_MAGIC, Format, Probe
from accelcal_cli.core.paths import has_file

SUFFIXES = (".gt3x", ".agdc")
SAMPLES = ("log.bin", "activity.bin")
"""Names of the parts with samples, one of which is often the first."""


PARTS = ("info.txt", *SAMPLES, "calibration.json", "temperature_calibration.json", "info.json")
RECORD = b"\x1e"
"""First byte of each record, and so of log.bin."""


def unzipped(path: Path) -> tuple[Path, ...]:
    """Return all parts in the folder of a file that is one of an unzipped recording; empty for any other."""
    if path.name.lower() not in PARTS:
        return ()
    spelt = [(name, name.upper(), name.capitalize()) for name in PARTS]
    found = [next(filter(has_file, map(path.with_name, names)), None) for names in spelt]
    parts = tuple(part for part in found if part is not None)
    return parts if any(part.name.lower() in SAMPLES for part in parts) else ()


def belongs_to(path: Path) -> Path | None:
    """Return the samples of the unzipped recording that a file describes; None for other files."""
    samples = [part for part in unzipped(path) if part.name.lower() in SAMPLES]
    return samples[0] if samples and path.name.lower() not in SAMPLES else None


def sniff(probe: Probe) -> int:
    """Return 100 for a zip file with log.bin or activity.bin; 30 for a damaged one with the usual suffix.

    60 for the parts of an unzipped recording: `open_recording` says what to do.
    """
    parts = unzipped(probe.path)
    if len(parts) > 1 or (parts and probe.head.startswith(RECORD)):
        return 60
    by_name = 30 if probe.suffix in SUFFIXES else 0
    if not by_name and ZIP_MAGIC not in probe.head:
        return 0
    first = probe.head[30 : 30 + int.from_bytes(probe.head[26:28], "little")].decode("latin-1").lower()
    if probe.head.startswith(ZIP_MAGIC) and first in SAMPLES:
        return 100
    if probe.head.startswith(ZIP_MAGIC) and first.endswith(SUFFIXES):
        return 0  # a zip file around a recording
    # Only what may be a zip file needs zipfile.
    from accelcal_cli.formats.gt3x.archive import NAMED, directory_names, holds_samples

    try:
        with probe.path.open("rb") as file:
            names = None if probe.compressed else directory_names(file)
    except OSError:
        names = None
    if names is None:  # damaged: the headers of its parts are looked for
        names = [match[2].decode("ascii", "replace") for match in NAMED.finditer(probe.head)]
    if holds_samples(names):
        return 100
    return 0 if any(name.lower().endswith(SUFFIXES) for name in names) else by_name


FORMAT = Format(
    "gt3x",
    "ActiGraph GT3X+, wGT3X-BT, GT9X, LEAP and others (.gt3x, .agdc)",
    SUFFIXES,
    sniff,
    reader="accelcal_cli.formats.gt3x.reader:open_recording",
    ignores=("unit", "columns", "time_column", "layout", *ONLY_TABLES),
    belongs_to=belongs_to,
)
