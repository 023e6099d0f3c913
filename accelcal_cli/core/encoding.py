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
class Sampling:
    """How the device of a format samples.

    Attributes:
        rate_hz: what it makes of the wanted rate: at 66.7 Hz a GENEActiv takes 200 samples in 3 s.
        unit_samples: a recording's number of samples is a multiple of this, such as a page.
    """

    rate_hz: float
    unit_samples: int = 1


def any_sampling(recording: Recording) -> Sampling:
    """Any rate and scale, any number of samples."""
    return Sampling(recording.rate_hz)


@dataclass(frozen=True, slots=True)
class Encoder:
    """Writes recordings of one format.

    Attributes:
        name: the format's name, as in `--format`; a reader of that name reads it back.
        suffix: what the file name ends with.
        write: writes all chunks to a path that the caller chose (temporary; the caller renames).
        companion: a file that must lie beside the recording, such as a layout; None where the
            recording stands alone.
        sampling: how a wanted recording is sampled. Raises UsageError where no device of the
            format has such a rate, scale or range.
    """

    name: str
    suffix: str
    write: Callable[[Path, Recording, Iterable[Chunk]], None]
    companion: Companion | None = None
    sampling: Callable[[Recording], Sampling] = any_sampling
