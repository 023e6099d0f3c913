"""Which files of a study are not its recordings, and why: by their names, and by their content.

Whatever has the suffix of a device's files, the header of a table of acceleration, or an archive around it
is a recording: it is calibrated, refused, or fails with its reason. Everything else is named with a reason.
"""

from __future__ import annotations

from pathlib import Path

from accelcal_cli.core.errors import AccelcalError, NoRecordingError, UnreadableError
from accelcal_cli.core.formats import Format, Probe, ReadOptions, is_text, probe_file, without
from accelcal_cli.core.input_files import ARCHIVES, files_of
from accelcal_cli.core.reasons import Reason
from accelcal_cli.formats import all_formats, archive_around, named_format, refuse_other_files, refuse_others
from accelcal_cli.studies.records import Item

TABLES = "csv"
"""Name of the one format whose suffixes other files often have."""

UNFINISHED = (
    ".part", ".partial", ".crdownload", ".download", ".filepart", ".opdownload", ".tmp", ".aria2", ".!ut",
    ".icloud", ".swp",
)  # fmt: skip
"""Ends of the names of downloads and copies that are not finished."""


def unfinished(path: Path) -> Reason | None:
    """Return the reason to leave out a download or a copy that is not finished; None for any other file."""
    suffix = path.suffix.lower()
    return Reason.of("unfinished_copy", suffix=suffix) if suffix in UNFINISHED else None


def why_left_out(item: Item, options: ReadOptions, *, asked_for: bool) -> Reason | None:
    """Return why a file is not one of the study's recordings, by content; None for a recording.

    A file that no format fits is one if its suffix is that of a device's files: it is damaged, and must not
    be ignored silently. So is an archive that the disk does not give, and a text with columns named x, y and
    z, whatever follows.

    Args:
        asked_for: the user named its kind with `--include`.
    """
    name = options.format or ("raw" if options.layout is not None else None)
    wanted = all_formats() if name is None else (named_format(name),)
    try:
        if asked_for or files_of(item.source) is not None:
            return None
        if name is None and (packed := archive_around(item.source)) is not None:
            return None if packed else Reason("archive_without_recordings")
        probe = probe_file(item.source, without(options, ("layout",)))
    except UnreadableError as error:
        named = _suffix(item) in _suffixes(all_formats()) or item.source.name.lower().endswith(ARCHIVES)
        return None if named else Reason.of("not_looked_into", fault=error.fault)
    scores = [one.sniff(probe) for one in wanted]
    if (best := max(scores)) > 0:
        return _why_not_this(wanted[scores.index(best)], best, probe, item, options)
    return _why_no_format(wanted, probe, item)


def _why_not_this(form: Format, score: int, probe: Probe, item: Item, options: ReadOptions) -> Reason | None:
    """Return why a file of a format is not a recording; a damaged one may be, and must not be ignored."""
    try:
        refuse_others(form, score, probe)
        if form.is_table:
            form.open(item.source, without(options, form.unused(options))).close()
    except NoRecordingError as error:
        return error.reason
    except AccelcalError:
        pass
    return None


def _why_no_format(wanted: tuple[Format, ...], probe: Probe, item: Item) -> Reason | None:
    """Return what a file is that no format fits; None if its suffix is that of a device's files."""
    if _suffix(item) in _suffixes(tuple(one for one in wanted if one.name != TABLES and not one.is_table)):
        return None
    try:
        refuse_other_files(probe)
    except NoRecordingError as error:
        return error.reason
    return Reason("no_numbers" if is_text(probe.head) else "no_format")


def is_table(item: Item) -> bool:
    """Return True for a file with a suffix that only tables have."""
    return _suffix(item) not in _suffixes(tuple(one for one in all_formats() if one.name != TABLES))


def _suffix(item: Item) -> str:
    return Path(item.source.name.lower().removesuffix(".gz")).suffix


def _suffixes(formats: tuple[Format, ...]) -> set[str]:
    return {suffix for one in formats for suffix in one.suffixes}
