"""Axivity AX3 and AX6 recordings (.cwa): the device's own file, sector by sector.

Sources: the vendor's `Docs/ax3/cwa.h`, `ax3-technical.md` and `ax3-auxiliary.md`
(github.com/digitalinteraction/openmovement). Times are the wall clock of the computer that set the
device up, without a zone.
"""

from __future__ import annotations

from pathlib import Path

from accelcal_cli.core.formats import Format, Probe, ReadOptions
from accelcal_cli.core.recording import Reader
from accelcal_cli.readers._cwa.signature import HEADER_MAGIC, SECTOR_BYTES, SECTOR_MAGIC


def sniff(probe: Probe) -> int:
    """100 by the header's signature; 97 by that of a data sector where the header is damaged."""
    if probe.head.startswith(HEADER_MAGIC):
        return 100
    places = range(0, len(probe.head), SECTOR_BYTES)
    return 97 if any(probe.head.startswith(SECTOR_MAGIC, at) for at in places) else 0


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a recording. What reads is imported only now: every start of the command lists all formats.

    Raises:
        UnreadableError: it is not of this format, or no data sector is intact.
    """
    from accelcal_cli.readers._cwa import opening

    return opening.open_recording(path, options)


FORMAT = Format(
    "cwa",
    "Axivity AX3 and AX6 (.cwa)",
    (".cwa",),
    sniff,
    open_recording,
    ignores=("unit", "columns", "time_column", "date_format", "layout", "sensor"),
)
