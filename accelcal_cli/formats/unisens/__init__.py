"""Unisens recordings: a folder with `unisens.xml` and the signals that it describes; how they are recognised.

Sources: the schema and documentation of Unisens 2.0 (unisens.org), and the package unisensR
(github.com/Unisens/unisensR); what each attribute means to this reader is described in docs/more-devices.md.
"""

from __future__ import annotations

import re
from pathlib import Path

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ONLY_TABLES, TIMES_OF_TABLES, Format, Probe
from accelcal_cli.core.paths import is_file, open_found

DESCRIPTION = "unisens.xml"
ROOT = re.compile(rb"<(?:\w+:)?unisens\b")
MOST_BYTES = 1 << 22
"""Length [bytes] that no description exceeds."""

ENTRY = re.compile(rb"<(?:\w+:)?(\w+Entry)\b([^>]*)>")
_ID = re.compile(rb"""\bid\s*=\s*["']([^"']*)["']""")
_CLASS = re.compile(rb"""\bcontentClass\s*=\s*["']([^"']*)["']""")


def sibling_description(path: Path) -> bytes | None:
    """Return the description in the folder of a file; None if there is none."""
    try:
        with open_found(path.with_name(DESCRIPTION)) as file:
            text = file.read(MOST_BYTES)
    except (OSError, ValueError, UnreadableError):
        return None
    return text if ROOT.search(text) else None


def accelerations(description: bytes) -> list[str]:
    """Return the names of files with signals of class `acc`, in their order, binary ones first."""
    signals = [entry[2] for entry in ENTRY.finditer(description) if entry[1] == b"signalEntry"]
    classes = [(_ID.search(signal), _CLASS.search(signal)) for signal in signals]
    found = [name for name, kind in classes if name and kind and kind[1].lower() == b"acc"]
    names = [name[1].decode("utf-8", "replace") for name in found]
    return sorted(names, key=lambda name: not name.lower().endswith(".bin"))


def belongs_to(path: Path) -> Path | None:
    """Return the file that names the Unisens recording of another file; None if that names itself, or none.

    A folder is named by its accelerations, or by its description if they are missing.
    """
    text = sibling_description(path)
    names = [] if text is None else accelerations(text)
    if text is None or not names or path.name == names[0]:
        return None
    acc = path.with_name(names[0])
    if path.name == DESCRIPTION:
        return acc if is_file(acc) else None
    ids = (_ID.search(entry[2]) for entry in ENTRY.finditer(text))
    return acc if path.name in [match[1].decode("utf-8", "replace") for match in ids if match] else None


def sniff(probe: Probe) -> int:
    """Return 100 for a description; 98 for a binary file of accelerations listed by the one next to it."""
    if probe.head.lstrip(b"\xef\xbb\xbf \r\n\t").startswith(b"<") and ROOT.search(probe.head[:4096]):
        return 100
    if probe.suffix != ".bin":
        return 0
    text = sibling_description(probe.path)
    return 98 if text is not None and probe.path.name in accelerations(text) else 0


FORMAT = Format(
    "unisens",
    "Unisens folder, such as of movisens (unisens.xml)",
    (".bin",),
    sniff,
    reader="accelcal_cli.formats.unisens.reader:open_recording",
    ignores=("columns", *TIMES_OF_TABLES, "layout", "sensor", *ONLY_TABLES),
    belongs_to=belongs_to,
)
