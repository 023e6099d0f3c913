"""The registry of formats: one folder each, found by listing this one. Nothing registers itself.

Every start of the command imports `formats/NAME/__init__.py` of all formats, for their suffixes and `sniff`,
so those import no more than that takes. What reads (`reader.py`) is imported by the first file that is
opened, what writes (`writer.py`) by `accelcal simulate`.
"""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
from dataclasses import replace
from functools import cache
from pathlib import Path

from accelcal_cli.core.clock import FIRST_US, LAST_US
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import Encoder, Format, ReadOptions, probe_file
from accelcal_cli.core.plugins import find_plugin, find_plugins, named_plugin
from accelcal_cli.core.recording import Reader


@cache
def all_formats() -> tuple[Format, ...]:
    """Every format, by name. A module whose name starts with `_` is a helper, not a format."""
    return tuple(find_plugins(__name__, __path__, "FORMAT"))


def load_all() -> None:
    """Import every reader once, before many processes are forked that open files."""
    for module in pkgutil.walk_packages(__path__, f"{__name__}."):
        importlib.import_module(module.name)


def find_format(path: Path, options: ReadOptions) -> Format:
    """The format of a file, by its content, or as the user named it.

    Raises:
        UnreadableError: no format fits, or the file cannot be read.
        UsageError: the named format does not exist.
    """
    probe = probe_file(path, options)
    if options.format is not None:
        return named_format(options.format)
    scored = [(item.sniff(probe), item.name, item) for item in all_formats()]
    best = max(scored, key=lambda score: (score[0], score[1]))
    if best[0] == 0:
        raise UnreadableError(
            "its content matches no known format",
            path=path,
            byte_offset=0,
            hint="name one with --format, or describe a raw dump with --layout",
        )
    return best[2]


def named_format(name: str) -> Format:
    """Look a format up by name; raises UsageError if there is none."""
    found = find_plugin(__name__, __path__, "FORMAT", name)
    return found or named_plugin(name, all_formats(), "format")


def open_recording(path: Path, options: ReadOptions, threads: int = 1) -> Reader:
    """Open a recording of any format for streaming.

    Args:
        threads: how many may work at a time on reading it.

    Raises:
        UnreadableError, UsageError: see `find_format` and the format's own `open`.
    """
    item = find_format(path, options)
    reader = item.open(path, options)
    reader.threads = threads
    if not FIRST_US <= (reader.recording.start_us or 0) <= LAST_US:
        hint = "copy it again from the device, or correct the start time that it is given"
        raise UnreadableError("begins outside the years 1 to 9999", path=path, hint=hint)
    unused = [name for name in item.ignores if getattr(options, name) is not None]
    if unused:
        words = ", ".join("--" + name.replace("_", "-") for name in unused)
        note = f"{words}: means nothing for format {item.name} and was not used"
        reader.recording = replace(reader.recording, notes=(*reader.recording.notes, note))
    return reader


@cache
def all_encoders() -> tuple[Encoder, ...]:
    """All of them, by name."""
    writers = (f"{__name__}.{item.name}.writer" for item in pkgutil.iter_modules(__path__) if item.ispkg)
    return tuple(importlib.import_module(name).ENCODER for name in writers if importlib.util.find_spec(name))


def named_encoder(name: str) -> Encoder:
    """Look one up by name; raises UsageError if there is none."""
    return named_plugin(name, all_encoders(), "format to write")
