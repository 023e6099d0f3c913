"""Recognises raw dumps of flash memory by their layout files, and finds these.

See docs/layout-files.md.
"""

from __future__ import annotations

from pathlib import Path

from accelcal_cli.core.formats import ONLY_TABLES, TIMES_OF_TABLES, Format, Probe, ReadOptions
from accelcal_cli.core.paths import has_file, is_file
from accelcal_cli.core.unpacking import PACKED_SUFFIXES, plain_name

SUFFIX = ".layout.toml"
FOLDER_NAME = "layout.toml"
DUMP_SUFFIXES = (".raw", ".bin", ".dat")


def named_layout(path: Path) -> Path:
    """Return the path of a dump's own layout: `NAME.layout.toml` for `NAME.bin` or `NAME.bin.gz`."""
    return path.with_name(Path(plain_name(path.name)).stem + SUFFIX)


def folder_layout(path: Path) -> Path:
    """Return the path of the layout of all dumps of a folder."""
    return path.with_name(FOLDER_NAME)


def check_layout(path: Path) -> None:
    """Raise UsageError for a file that is not a readable layout."""
    from accelcal_cli.formats.raw.layout import load_layout  # few recordings have one

    load_layout(path)


def find_layout(path: Path, options: ReadOptions) -> Path | None:
    """Return the layout file of a dump: the one that the user named, else its own, else its folder's."""
    if options.layout is not None:
        return options.layout
    return next((found for found in (named_layout(path), folder_layout(path)) if has_file(found)), None)


def sniff(probe: Probe) -> int:
    """Return how certain a layout makes it that a file is a dump.

    100 if the user named the layout, 95 for the dump's own, 40 for its folder's, so that a dump with a
    signature is read as that format. A file of another suffix scores 35 for a layout of its own, so that
    whatever else its content shows comes first, and 0 for its folder's. A `.raw` file for which rate and
    counts per g are given, but no layout, scores 30.
    """
    options, path = probe.options, probe.path
    if options.layout is not None:
        return 100
    if probe.suffix not in DUMP_SUFFIXES:
        if not is_file(named_layout(path)):
            return 0
        name = named_layout(path).name.removesuffix(SUFFIX)
        dumps = (
            path.with_name(name + end + packed) for end in DUMP_SUFFIXES for packed in ("", *PACKED_SUFFIXES)
        )
        return 0 if any(map(is_file, dumps)) else 35  # the layout is that of a dump next to it
    if is_file(named_layout(path)):
        return 95
    if is_file(folder_layout(path)):
        return 40
    described = options.rate_hz is not None and options.lsb_per_g is not None
    return 30 if described and probe.suffix == ".raw" else 0


FORMAT = Format(
    "raw",
    "raw dump with a layout file (docs/layout-files.md)",
    DUMP_SUFFIXES,
    sniff,
    reader="accelcal_cli.formats.raw.reader:open_recording",
    ignores=("unit", "columns", *TIMES_OF_TABLES, "sensor", *ONLY_TABLES),
)
