"""The contract of a recording writer: one frozen record that each file in `encode/` binds as ENCODER."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from accelcal_cli.core.recording import Chunk, Recording


@dataclass(frozen=True, slots=True)
class Companion:
    """A text file beside a recording: what its name ends with, and its text."""

    suffix: str
    text: Callable[[Recording], str]


@dataclass(frozen=True, slots=True)
class Encoder:
    """Writes recordings of one format.

    Attributes:
        name: the format's name, as in `--format`; a reader of that name reads it back.
        suffix: what the file name ends with.
        write: writes all chunks to a path that the caller chose (temporary; the caller renames).
        companion: a file that must lie beside the recording, such as a layout; None where the
            recording stands alone.
    """

    name: str
    suffix: str
    write: Callable[[Path, Recording, Iterable[Chunk]], None]
    companion: Companion | None = None
