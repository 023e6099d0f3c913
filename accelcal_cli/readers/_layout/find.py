"""Where the layout of a raw dump lies. See docs/layout-files.md."""

from __future__ import annotations

from pathlib import Path

from accelcal_cli.core.formats import ReadOptions

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


def find_layout(path: Path, options: ReadOptions) -> Path | None:
    """The layout file of a dump: as the user named it, else its own, else its folder's."""
    if options.layout is not None:
        return options.layout
    return next((found for found in (named_layout(path), folder_layout(path)) if is_file(found)), None)
