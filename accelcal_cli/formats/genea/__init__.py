"""GENEA recordings (.bin), the GENEActiv's predecessor: how they are recognised.

Source: GGIRread (github.com/wadpac/GGIRread, R/readGenea.R) and its sample file; what each field means to
this reader is described in docs/more-devices.md.
"""

from __future__ import annotations

from accelcal_cli.core.formats import GYRO_OPTIONS, Format, Probe

HEADER_MAGIC = b"GENEA/"


def sniff(probe: Probe) -> int:
    """100 by the header's first line."""
    return 100 if probe.head.startswith(HEADER_MAGIC) else 0


FORMAT = Format(
    "genea",
    "GENEA (.bin)",
    (".bin",),
    sniff,
    reader="accelcal_cli.formats.genea.reader:open_recording",
    ignores=("unit", "columns", "time_column", "date_format", "layout", "sensor", *GYRO_OPTIONS),
)
