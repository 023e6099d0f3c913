"""Recognises recordings of GENEA devices (.bin), the GENEActiv's predecessor.

Source: GGIRread (github.com/wadpac/GGIRread, R/readGenea.R) and its sample file; docs/more-devices.md
says what each field means to the reader.
"""

from __future__ import annotations

from accelcal_cli.core.formats import NOT_FOR_DEVICES, Format, Probe

HEADER_MAGIC = b"GENEA/"


def sniff(probe: Probe) -> int:
    """Return 100 for the header's first line."""
    return 100 if probe.head.startswith(HEADER_MAGIC) else 0


FORMAT = Format(
    "genea",
    "GENEA (.bin)",
    (".bin",),
    sniff,
    reader="accelcal_cli.formats.genea.reader:open_recording",
    ignores=NOT_FOR_DEVICES,
)
