"""The registry of formats: one folder each, found by listing this one. Nothing registers itself.

Every start of the command imports `formats/NAME/__init__.py` of all formats, for their suffixes and `sniff`,
so these import no more than that takes. The first file that is opened imports the reader (`reader.py`);
`accelcal simulate` imports the writer (`writer.py`).
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import pkgutil
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

from accelcal_cli.core.clock import MICROSECONDS, RESET_US
from accelcal_cli.core.errors import NoFormatError, UnreadableError, UsageError, listed
from accelcal_cli.core.formats import (
    Encoder,
    Format,
    Probe,
    ReadOptions,
    is_text,
    mean_nothing,
    probe_file,
    unused_note,
    without,
)
from accelcal_cli.core.input_files import ARCHIVES, TAR_MAGIC, TAR_MAGIC_AT, files_of, may_be_archive
from accelcal_cli.core.plugins import find_plugin, find_plugins, items_of, named_plugin
from accelcal_cli.core.recording import Reader
from accelcal_cli.core.unpacking import plain_name
from accelcal_cli.formats._not_recordings import known_kind, refuse_not_recordings

SIGNED, CERTAIN = 90, 100
"""Confidences: from the first on a sniffer has seen a signature, and no other format exceeds the second."""

LOOKED_AT, NO_SIGN = 200, {".txt", ".log"}
"""Members of an archive whose names are checked, and suffixes that say nothing of what they are."""

POLAR = re.compile(r".*_acc\.txt")


@cache
def all_formats() -> tuple[Format, ...]:
    """Return every format, by name; a module whose name starts with `_` is a helper, not a format."""
    return tuple(find_plugins(__name__, __path__, "FORMAT"))


def load_all() -> None:
    """Import every reader once, before processes are forked that open files."""
    for module in pkgutil.walk_packages(__path__, f"{__name__}."):
        importlib.import_module(module.name)


def find_format(path: Path, options: ReadOptions) -> Format:
    """Return the format of a file, by its content or as the user named it.

    Raises UsageError if that does not exist, UnreadableError if no format fits or the file cannot be read.
    """
    probe = probe_file(path, options)
    if options.format is not None:
        return named_format(options.format)
    confidence, item = _most_confident(probe)
    if confidence < SIGNED:
        refuse_not_recordings(probe)
    if confidence == 0:
        what, again = "format not recognised", ", or copy it from its device again"
        if is_text(probe.head):
            what, again = "is text without rows of three or more numbers", ""
        hint = f"name its format with --format or in a --layout file{again}"
        raise NoFormatError(what, path=path, hint=hint)
    return item


def _most_confident(probe: Probe) -> tuple[int, Format]:
    """Return the highest confidence and its format; of equal ones the last by name.

    The formats of the file's suffix are tried first, and the others only if none of those is certain.
    """
    # A layout that the user names makes `raw` certain, whatever the suffix.
    is_hint = probe.options.layout is None
    fitting = [item for item in all_formats() if is_hint and probe.suffix in item.suffixes]
    others = [item for item in all_formats() if item not in fitting]
    best: tuple[int, str, Format | None] = (-1, "", None)
    for items in (fitting, others):
        scored = [(item.sniff(probe), item.name, item) for item in items]
        best = max([best, *scored], key=lambda score: score[:2])
        if best[0] == CERTAIN:
            break
    assert best[2] is not None
    return best[0], best[2]


def named_format(name: str) -> Format:
    """Return the format of a name; raises UsageError if there is none."""
    found = find_plugin(__name__, __path__, "FORMAT", name)
    return found or named_plugin(name, all_formats(), "format")


def has_parts(path: Path) -> bool:
    """Return True if a path stands for the parts of one recording: a folder, a pattern, or an archive."""
    if files_of(path) is not None:
        return True
    if not may_be_archive(path):
        return False
    probe = probe_file(path, ReadOptions())
    if probe.head[TAR_MAGIC_AT:].startswith(TAR_MAGIC):
        return True  # whatever its members look like
    if any(item.sniff(probe) for item in all_formats()) or known_kind(probe.head) is not None:
        return False
    from accelcal_cli.formats._parts.archive import is_archive

    return is_archive(path)


def archive_around(path: Path) -> bool | None:
    """Return whether an archive may hold recordings, by the names that a short look shows.

    So may one that shows none: it is damaged, or has too many members. So may one with an archive in it.
    None: it is not an archive.
    """
    if not path.name.lower().endswith(ARCHIVES) or not has_parts(path):
        return None
    from accelcal_cli.formats._parts.archive import first_names

    names = [name.lower() for name in first_names(path, LOOKED_AT)]
    kinds = {suffix for item in all_formats() for suffix in item.suffixes} - NO_SIGN
    plain = [plain_name(name) for name in names]
    known = any(Path(name).suffix in kinds or POLAR.fullmatch(name) for name in plain)
    return not names or known or any(name.endswith(ARCHIVES) for name in names)


def belongs_to(path: Path) -> Path | None:
    """Return the recording that a file belongs to; None for a file that may be one itself.

    So do the further sensors of an export of a phone or a wristband, and the files of a Unisens recording.
    """
    return next((found for item in all_formats() if (found := item.belongs_to(path)) is not None), None)


def is_export(folder: Path) -> bool:
    """Return True for a folder in which all files that belong to another belong to the same."""
    return len({found for one in files_of(folder) or () if (found := belongs_to(one)) is not None}) == 1


def refuse_other_files(probe: Probe) -> None:
    """Raise NoRecordingError for a file that is known to be no recording."""
    refuse_not_recordings(probe)


def refuse_others(form: Format, score: int, probe: Probe) -> None:
    """Raise NoRecordingError if a file that fits a format best, with this score, is not a recording."""
    if score < SIGNED:
        refuse_not_recordings(probe)
    form.refuse_others(probe)


def unused_options(path: Path, options: ReadOptions) -> tuple[str, ...]:
    """Return the options that mean nothing for a file's format; raises what `find_format` raises.

    For parts, the first one decides; options are all used for parts in an archive.
    """
    if not _may_be_unused(options):
        return ()
    path = next(iter(files_of(path) or ()), path)
    return () if has_parts(path) else find_format(path, options).unused(options)


def ignored_options(name: str) -> tuple[str, ...]:
    """Return the reading options that mean nothing to a format; none for a name that no format has."""
    return next((item.ignores for item in all_formats() if item.name == name), ())


def _may_be_unused(options: ReadOptions) -> set[str]:
    return {name for item in all_formats() for name in item.unused(options)}


def refuse_unused(paths: Iterable[Path], options: ReadOptions) -> None:
    """Raise UsageError for an option that means nothing for the format of any of several recordings.

    Files that cannot be read have no format.
    """
    pending, found = _may_be_unused(options), set()
    for path in paths:
        if not pending:
            return
        with contextlib.suppress(UnreadableError):
            item = find_format(next(iter(files_of(path) or ()), path), options)
            found.add(item.name)
            pending &= set(item.ignores)
    if found:
        _refuse_options([name for name in ReadOptions.__dataclass_fields__ if name in pending], sorted(found))


def _refuse_options(names: Sequence[str], formats: Sequence[str], path: Path | None = None) -> None:
    """Raise UsageError if any options are named, which mean nothing for these formats."""
    if names:
        kinds, them = "formats" if len(formats) > 1 else "format", "it" if len(names) == 1 else "them"
        text = f"{mean_nothing(names)} to {kinds} {listed(formats)}"
        hint = f"omit {them}, or name the format with --format if it is another"
        raise UsageError(text, path=path, hint=hint)


def open_recording(
    path: Path,
    options: ReadOptions,
    threads: int = 1,
    unused: tuple[str, ...] = (),
    *,
    session: bool = False,
    joined: bool = False,
) -> Reader:
    """Open a recording of any format, or one in parts, for streaming.

    Args:
        threads: how many may work at a time on reading it.
        unused: options that were given for other recordings and mean nothing for this one; it is noted.
        session: the parts are not stretches of one recording, but recordings of one device at rest.
        joined: the recordings in an archive are parts of one, whatever their names; else an archive around
            several is refused.

    Raises:
        UnreadableError, UsageError: see `find_format` and the format's own `open`; or an option means
            nothing for the format.
        OutputError: there is no room to unpack an archive of parts.
    """
    if has_parts(path):
        from accelcal_cli.formats._parts.reader import PartsReader, SessionReader, open_parts

        def open_part(part: Path) -> Reader:
            return _open_file(part, options, unused)

        kind = SessionReader if session else PartsReader
        reader: Reader = open_parts(
            path, open_part, kind, threads, joined=joined or session, belongs_to=belongs_to
        )
    else:
        reader = _open_file(path, options, unused)
    reader.threads = threads
    return reader


def _open_file(path: Path, options: ReadOptions, unused: tuple[str, ...]) -> Reader:
    options = without(options, unused)
    item = find_format(path, options)
    _refuse_options(item.unused(options), [item.name], path)
    reader = item.open(path, options)
    lasts_s = reader.recording.duration_s
    if lasts_s is not None and not 0 <= lasts_s <= RESET_US / MICROSECONDS:  # its clock was reset
        reader.recording = replace(reader.recording, duration_s=None)
    if unused:
        note = unused_note(unused, item.name)
        reader.recording = replace(reader.recording, notes=(*reader.recording.notes, note))
    return reader


@cache
def all_encoders() -> tuple[Encoder, ...]:
    """Return every writer, by name."""
    found: list[Encoder] = []
    for item in pkgutil.iter_modules(__path__):
        name = f"{__name__}.{item.name}.writer"
        if item.ispkg and importlib.util.find_spec(name):
            found += items_of(importlib.import_module(name), "ENCODER")
    return tuple(sorted(found, key=lambda one: one.name))


def named_encoder(name: str) -> Encoder:
    """Return the writer of a name; raises UsageError if there is none."""
    return named_plugin(name, all_encoders(), "format to write")
