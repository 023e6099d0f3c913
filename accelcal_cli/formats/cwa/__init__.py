"""Recognises recordings of Axivity AX3 and AX6 devices (.cwa).

Sources: the vendor's `Docs/ax3/cwa.h`, `ax3-technical.md` and `ax3-auxiliary.md`
(github.com/digitalinteraction/openmovement). Times are the wall clock of the computer that set the
device up, without a zone.
"""

from __future__ import annotations

from accelcal_cli.core.formats import NOT_FOR_DEVICES, Format, Probe

HEADER_BYTES = 1024
HEADER_MAGIC = b"MD" + (HEADER_BYTES - 4).to_bytes(2, "little")
SECTOR_BYTES = 512
SECTOR_MAGIC = b"AX" + (SECTOR_BYTES - 4).to_bytes(2, "little")
"""First four bytes of a data sector: two letters and the length of what follows."""


def sniff(probe: Probe) -> int:
    """Return 100 for the header's signature, 97 for that of a data sector where the header is damaged."""
    if probe.head.startswith(HEADER_MAGIC):
        return 100
    places = range(0, len(probe.head), SECTOR_BYTES)
    return 97 if any(probe.head.startswith(SECTOR_MAGIC, place) for place in places) else 0


FORMAT = Format(
    "cwa",
    "Axivity AX3 and AX6 (.cwa)",
    (".cwa",),
    sniff,
    reader="accelcal_cli.formats.cwa.reader:open_recording",
    ignores=NOT_FOR_DEVICES,
)
