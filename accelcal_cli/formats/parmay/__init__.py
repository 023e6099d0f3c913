"""Recognises recordings of Parmay Tech's Matrix devices (.BIN), packets with a checksum each.

Source: the vendor's layout as GGIRread reads it (github.com/wadpac/GGIRread, R/readParmayMatrix.R) and its
sample files; docs/more-devices.md says what each field means to the reader.
"""

from __future__ import annotations

from accelcal_cli.core.formats import NOT_FOR_DEVICES, Format, Probe

PACKET_MAGIC = b"MDTCPACK"
HEADER_MAGIC = b"MDTC"
REMARKS_BYTES = 512
HEADER_BYTES = 524


def sniff(probe: Probe) -> int:
    """Return 100 for the header's signature, 97 for a packet's where the header is damaged."""
    if probe.head.startswith(HEADER_MAGIC, REMARKS_BYTES):
        return 100
    return 97 if PACKET_MAGIC in probe.head else 0


FORMAT = Format(
    "parmay",
    "Parmay Matrix (.BIN)",
    (".bin",),
    sniff,
    reader="accelcal_cli.formats.parmay.reader:open_recording",
    ignores=NOT_FOR_DEVICES,
)
