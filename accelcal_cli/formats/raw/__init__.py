"""Raw dumps of flash memory without a description of their own, and where their layout files lie.

See docs/layout-files.md.
"""

from __future__ import annotations

from pathlib import Path

from accelcal_cli.core.formats import GYRO_OPTIONS, Format, Probe, ReadOptions

SUFFIX = ".layout.toml"
FOLDER_NAME = "layout.toml"
DUMP_SUFFIXES = (".raw", ".bin", ".dat")


def named_layout(path: Path) -> Path:
    """Where the layout of this one dump lies: `NAME.layout.toml` beside `NAME.bin` or `NAME.bin.gz`."""
    name = path.name[:-3] if path.name.lower().endswith(".gz") else path.name
    return path.with_name(Path(name).stem + SUFFIX)


def folder_layout(path: Path) -> Path:
    """Where the layout of all dumps of a folder lies."""
    return path.with_name(FOLDER_NAME)


def is_file(path: Path) -> bool:
    """Whether a file is there; a folder that may not be looked into has none."""
    try:
        return path.is_file()
    except OSError:
        return False


def check_layout(path: Path) -> None:
    """Raise UsageError for a layout file that cannot be read, or is none."""
    from accelcal_cli.formats.raw.layout import load_layout  # few recordings have one

    load_layout(path)


def find_layout(path: Path, options: ReadOptions) -> Path | None:
    """The layout file of a dump: as the user named it, else its own, else its folder's."""
    if options.layout is not None:
        return options.layout
    return next((found for found in (named_layout(path), folder_layout(path)) if is_file(found)), None)


def _is_of_a_dump(path: Path) -> bool:
    """Whether the layout beside a file is that of a dump with a usual suffix."""
    name = named_layout(path).name.removesuffix(SUFFIX)
    return any(is_file(path.with_name(name + end + gz)) for end in DUMP_SUFFIXES for gz in ("", ".gz"))


def sniff(probe: Probe) -> int:
    """A dump is known by its layout alone: 100 named by the user, 95 its own, 40 its folder's.

    Beside a file of another suffix its own scores 35, so that whatever else its content shows comes first;
    its folder's is for the usual suffixes alone.

    Below 100 unless the user names it, so that a dump with a signature is read as that format. A
    `.raw` file for which rate and counts per g are given, but no layout, scores 30.
    """
    options = probe.options
    if options.layout is not None:
        return 100
    if probe.suffix not in DUMP_SUFFIXES:
        return 35 if is_file(named_layout(probe.path)) and not _is_of_a_dump(probe.path) else 0
    if is_file(named_layout(probe.path)):
        return 95
    if is_file(folder_layout(probe.path)):
        return 40
    described = options.rate_hz is not None and options.lsb_per_g is not None
    return 30 if described and probe.suffix == ".raw" else 0


FORMAT = Format(
    "raw",
    "raw dump with a layout file (docs/layout-files.md)",
    DUMP_SUFFIXES,
    sniff,
    reader="accelcal_cli.formats.raw.reader:open_recording",
    ignores=("unit", "columns", "time_column", "date_format", "sensor", *GYRO_OPTIONS),
)
